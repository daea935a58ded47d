//! `angular-error`: an axis tilts as it goes, and the tool is off by the tilt times its lever.
//!
//! ```text
//! p + θ(P)·(L − L₀)/1000          P of the axis that tilts, L of another one
//! θ(P) = c·P/1000, or a spline over P, in µrad
//! ```
//!
//! 10 µrad at a lever of 100 mm are 1 µm. θ is positive where a longer lever makes the error more
//! positive. Of the angles of ISO 230-1 (right-handed: roll, pitch and yaw as turns about X, Y, Z; the
//! displacement of a point is the turn times where it is) it is
//!
//! | error | lever X | lever Y | lever Z |
//! |---|---|---|---|
//! | `dx` | | −C | +B |
//! | `dy` | +C | | −A |
//! | `dz` | −B | +A | |
//!
//! so a lever along the error itself does nothing. L₀, where the tilt has no effect, depends on where
//! the error was set to 0: it is a reference and no finding of its own.

use super::{
    cause_spec::{
        BoardRepresentation, BoardTerm, Candidate, Explanation, FileRepresentation,
        FindingParameter, FitSpec, LawInput, NonlinearParameter, PhysicalLaw, Target, TermContext,
        TermEntry, Tilt, Value, required_axis, required_number,
    },
    data_view::{DataView, StartValues, find_distinct_values, peak_to_peak, uniform_knots},
};
use crate::{
    keys::{
        reader::Section,
        term::{ALONG, CONTROL_URAD, KNOTS_MM, LEVER, ORDER, ORIGIN_MM, URAD_PER_M},
    },
    location::InputFileError,
    sections::{
        AngleProfile, LinearAxis,
        straightness::{SplineKeys, read_spline, spline_entries},
    },
    spline::{BSpline, spline_basis_values},
};

/// An angle that depends on the position of an axis, times a lever.
#[derive(Clone, Debug, PartialEq)]
pub struct AngularError(Tilt);

/// The keys of an angle as a spline.
const SPLINE_KEYS: SplineKeys = [ORDER, KNOTS_MM, CONTROL_URAD];

impl AngularError {
    fn neutral(along: Option<LinearAxis>, lever: LinearAxis, angle: AngleProfile) -> Self {
        Self(Tilt { along, lever, origin_mm: 0.0, angle })
    }
}

impl FileRepresentation for AngularError {
    const NAME: &'static str = "angular-error";

    fn keys(section: &Section<'_>) -> &'static [&'static str] {
        if has_key(section, URAD_PER_M.name) {
            &[ALONG.name, LEVER.name, ORIGIN_MM.name, URAD_PER_M.name]
        } else {
            &[
                ALONG.name,
                LEVER.name,
                ORIGIN_MM.name,
                ORDER.name,
                KNOTS_MM.name,
                CONTROL_URAD.name,
                URAD_PER_M.name,
            ]
        }
    }

    fn read(section: &Section<'_>) -> Result<Self, InputFileError> {
        let along =
            has_key(section, ALONG.name).then(|| required_axis(section, ALONG)).transpose()?;
        let angle = if has_key(section, CONTROL_URAD.name) {
            AngleProfile::Curve(read_spline(section, &SPLINE_KEYS)?)
        } else {
            AngleProfile::Line(required_number(section, URAD_PER_M)?)
        };
        let origin_mm = section.number(ORIGIN_MM.name)?.unwrap_or(0.0);
        Ok(Self(Tilt { along, lever: required_axis(section, LEVER)?, origin_mm, angle }))
    }

    fn entries(&self) -> Vec<TermEntry> {
        let Tilt { along, lever, origin_mm, angle } = &self.0;
        let mut entries = Vec::new();
        entries.extend(along.map(|axis| (ALONG.name, Value::Text(axis.name().into()))));
        entries.push((LEVER.name, Value::Text(lever.name().into())));
        entries.push((ORIGIN_MM.name, Value::Number(*origin_mm)));
        match angle {
            AngleProfile::Line(urad_per_m) => {
                entries.push((URAD_PER_M.name, Value::Number(*urad_per_m)))
            }
            AngleProfile::Curve(spline) => entries.extend(spline_entries(spline, &SPLINE_KEYS)),
        }
        entries
    }
}

impl PhysicalLaw for AngularError {
    fn target(&self) -> Target {
        Target::Axis
    }

    fn refusal(&self, host: &TermContext<'_>) -> Option<String> {
        let own = host.quantity.axis()?;
        let Tilt { along, lever, .. } = self.0;
        if lever == own {
            Some(
                "has its lever along another axis than the one in error: a turn moves nothing \
                  along its own lever"
                    .into(),
            )
        } else {
            (along.unwrap_or(own) == lever)
                .then(|| "has its lever along another axis than the one that tilts".into())
        }
    }

    fn inputs(&self, _: &[f64]) -> Vec<LawInput<'_>> {
        let tilts = self.0.along.map_or(LawInput::OwnPosition, LawInput::Position);
        vec![LawInput::Position(self.0.lever), tilts]
    }

    fn add_unit_effects(&self, nonlinear: &[f64], x: &[f64], add: &mut impl FnMut(usize, f64)) {
        // µrad times mm are nm.
        let lever_m = (x[0] - nonlinear[0]) / 1000.0;
        match &self.0.angle {
            AngleProfile::Line(_) => add(0, x[1] / 1000.0 * lever_m),
            AngleProfile::Curve(spline) => {
                let (first, weights) = spline_basis_values(spline, x[1]);
                for (number, weight) in weights.into_iter().take(spline.order).enumerate() {
                    add(first + number, weight * lever_m);
                }
            }
        }
    }
}

impl BoardRepresentation for AngularError {
    fn board_terms(&self) -> Vec<BoardTerm> {
        vec![BoardTerm::Tilt(self.0.clone())]
    }

    fn from_board(_: Option<LinearAxis>, form: &BoardTerm, _: &mut f64) -> Option<Self> {
        if let BoardTerm::Tilt(tilt) = form { Some(Self(tilt.clone())) } else { None }
    }
}

impl Candidate for AngularError {
    fn fit_spec(&self) -> FitSpec {
        let list_length = match &self.0.angle {
            AngleProfile::Line(_) => None,
            AngleProfile::Curve(spline) => Some(spline.control_um.len()),
        };
        let amplitudes = list_length.unwrap_or(1);
        FitSpec {
            tier: 1,
            nonlinear: &[NonlinearParameter::Origin],
            amplitudes,
            list_length,
            ..FitSpec::DEFAULT
        }
    }

    fn values(&self) -> Vec<f64> {
        let origin = [self.0.origin_mm];
        match &self.0.angle {
            AngleProfile::Line(urad_per_m) => [origin, [*urad_per_m]].concat(),
            AngleProfile::Curve(spline) => [&origin, &spline.control_um[..]].concat(),
        }
    }

    fn set_values(&mut self, values: &[f64]) {
        self.0.origin_mm = values[0];
        match &mut self.0.angle {
            AngleProfile::Line(urad_per_m) => *urad_per_m = values[1],
            AngleProfile::Curve(spline) => spline.control_um = values[1..].to_vec(),
        }
    }

    fn propose(survey: &dyn DataView, with: &mut dyn FnMut(Self, StartValues)) {
        let others = survey.other_moving_axes();
        for &lever in &others {
            let of = |axis: LinearAxis| survey.column(&axis.column_name());
            let lever_mm = of(lever).unwrap_or(&[]);
            let own = survey.own_position_mm().filter(|mm| peak_to_peak(mm) > 0.0);
            let across = others.iter().filter(|&&axis| axis != lever);
            let across = across.map(|&axis| (Some(axis), of(axis).unwrap_or(&[])));
            for (along, mm) in own.map(|mm| (None, mm)).into_iter().chain(across) {
                // Of two axes across, c·P·L is the same whichever of them tilts.
                if along.is_none_or(|axis| axis < lever) {
                    let angle = AngleProfile::Line(0.0);
                    with(Self::neutral(along, lever, angle), lever_zero_start_values(lever_mm));
                }
                let at = find_distinct_values(mm, 1e-3);
                for controls in [5, 8, 12] {
                    if at.len() >= controls + 2 && survey.group_count() >= 5 * controls {
                        let control_um = vec![0.0; controls];
                        let knots_mm = uniform_knots(&at, controls);
                        let angle = AngleProfile::Curve(BSpline { order: 4, knots_mm, control_um });
                        with(Self::neutral(along, lever, angle), lever_zero_start_values(lever_mm));
                    }
                }
            }
        }
    }
}

impl Explanation for AngularError {
    fn describe(&self, values: &[f64]) -> String {
        let tilts = self
            .0
            .along
            .map_or("The axis".into(), |axis| format!("The {} axis", axis.name().to_uppercase()));
        let lever = self.0.lever.name().to_uppercase();
        match &self.0.angle {
            AngleProfile::Line(_) => format!(
                "{tilts} tilts by {:+.2} µrad for each metre; the error is that angle times the \
                 lever along {lever}.",
                values[1]
            ),
            AngleProfile::Curve(_) => format!(
                "{tilts} tilts by up to {:.1} µrad as it goes; the error is that angle times the \
                 lever along {lever}.",
                values[1..].iter().fold(0.0_f64, |most, urad| most.max(urad.abs()))
            ),
        }
    }

    fn next_test(&self) -> &'static str {
        "Measure the same line at two levers far apart, or the angle itself with a level or an \
         autocollimator. The error differs by the angle times the distance."
    }

    fn parameters(&self, values: &[f64]) -> Vec<FindingParameter> {
        let mut parameters = match &self.0.angle {
            AngleProfile::Line(_) => vec![FindingParameter::Fitted("urad_per_m", 1, 0.0)],
            AngleProfile::Curve(_) => {
                let mut fitted = self.clone();
                fitted.set_values(values);
                let of_spline = |name: &str| SPLINE_KEYS.iter().any(|key| key.name == name);
                let entries = fitted.entries().into_iter().filter(|(name, _)| of_spline(name));
                let spline = entries.map(|(key, value)| (key, Some(value))).collect();
                vec![FindingParameter::Record("spline", spline)]
            }
        };
        parameters.push(FindingParameter::Fitted("origin_mm", 0, 0.0));
        let stated = self.0.along.map(|axis| ("along", axis)).into_iter();
        parameters.extend(
            stated
                .chain([("lever", self.0.lever)])
                .map(|(key, axis)| FindingParameter::Stated(key, Value::Text(axis.name().into()))),
        );
        parameters
    }
}

fn has_key(section: &Section<'_>, key: &str) -> bool {
    section.keys().contains(&key)
}

/// Where the lever may have its zero, to begin from: the machine's own, the ends and the middle.
fn lever_zero_start_values(lever_mm: &[f64]) -> StartValues {
    let finite = lever_mm.iter().copied().filter(|mm| mm.is_finite());
    let low = finite.fold(f64::INFINITY, f64::min);
    let length = peak_to_peak(lever_mm);
    StartValues::from_values([0.0, low, low + 0.5 * length, low + length])
}
