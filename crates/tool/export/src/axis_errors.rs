//! The parts of a machine as functions of a position.
//!
//! A [`DriveErrorModel`] is what one drive corrects along its own axis: a pitch table and the backlash, with
//! what a diagnosis has added to them. A gantry with two drives on an axis is two of them, because
//! a CNC that has such an axis has two axes for it, and the beam itself shares the error out in
//! between. A [`CrossAxisError`] is the error of one axis while another moves, straightness and squareness.

use std::borrow::Cow;

use trueup_machine::{
    Machine,
    effect::{BoardTerm, Effect, LawInput, PredictionStage},
    machine_file::{BSpline, Backlash, LinearAxis, PitchErrorTable, Squareness, Term},
    model::{backlash_um, pitch_error_um, spline_value_um, squareness_error_um},
};

use crate::{ExportFormat, ExportOptions, report::ApproachDirection};

/// A period of a periodic error is looked at in this many parts.
const SAMPLES_PER_PERIOD: f64 = 32.0;
/// And a travel in at most this many.
const MAX_TRAVEL_SAMPLES: f64 = 20_000.0;

/// The errors that one drive corrects along its axis.
#[derive(Clone)]
pub(crate) struct DriveErrorModel<'m> {
    pub axis: LinearAxis,
    /// Whether it is the second one of the axis.
    pub is_second: bool,
    pub pitch: Option<&'m PitchErrorTable>,
    backlash: Option<&'m Backlash>,
    /// The terms of a diagnosis that are along the axis, with their number in the file.
    terms: Vec<(usize, &'m Term)>,
    /// The travel, if a part of it goes on and on.
    travel_mm: Option<(f64, f64)>,
}

impl DriveErrorModel<'_> {
    /// `x`, or `x2` for the second drive of X.
    pub fn name(&self) -> String {
        format!("{}{}", self.axis.name(), if self.is_second { "2" } else { "" })
    }

    /// Returns the sections of the machine file that it comes from.
    pub(crate) fn source_sections(&self) -> String {
        let axis = self.axis.name();
        let pitch = match (self.pitch, self.is_second) {
            (None, _) => None,
            (Some(_), false) => Some(format!("axis.{axis}.pitch")),
            (Some(_), true) => Some(format!("axis.{axis}.dual.pitch")),
        };
        let backlash = self.backlash.map(|_| format!("axis.{axis}.backlash"));
        let terms = self.terms.iter().map(|&(index, term)| term_name(index, term));
        pitch.into_iter().chain(backlash).chain(terms).collect::<Vec<_>>().join(" + ")
    }

    /// Its error in µm.
    pub fn error_um(&self, position_mm: f64, approach: ApproachDirection) -> f64 {
        let direction = approach.sign();
        let terms = self.terms.iter().map(|(_, term)| {
            own_axis_effect_um(&term.effect, position_mm, approach) + term.constant_um
        });
        self.pitch.map_or(0.0, |pitch| pitch_error_um(pitch, position_mm, direction))
            + self.backlash.map_or(0.0, |backlash| backlash_um(backlash, direction))
            + terms.sum::<f64>()
    }

    /// Returns whether it has a table for each direction.
    pub(crate) fn is_bidirectional(&self) -> bool {
        let of_terms = self.terms.iter().any(|(_, term)| is_bidirectional(&term.effect));
        of_terms || self.pitch.is_some_and(|pitch| pitch.reverse_um.is_some())
    }

    /// Returns what an approach in the negative direction adds wherever the axis is, in µm; 0 where there
    /// are two tables, which contain it.
    pub fn backlash_um(&self) -> f64 {
        if self.is_bidirectional() {
            return 0.0;
        }
        let terms = self.terms.iter().map(|(_, term)| {
            let is_constant = term.effect.required_inputs() == [LawInput::OwnDirection];
            if is_constant {
                own_axis_effect_um(&term.effect, 0.0, ApproachDirection::Negative)
            } else {
                0.0
            }
        });
        self.backlash.map_or(0.0, |backlash| backlash.width_um) + terms.sum::<f64>()
    }

    /// Returns whether it depends on the position.
    pub(crate) fn is_position_dependent(&self) -> bool {
        !self.breakpoints_mm().is_empty()
    }

    /// Returns whether the error is the same at every position and in both directions.
    pub(crate) fn is_constant(&self) -> bool {
        let first = self.error_um(0.0, ApproachDirection::Positive);
        self.breakpoints_mm().iter().all(|&mm| {
            ApproachDirection::BOTH.iter().all(|&approach| self.error_um(mm, approach) == first)
        }) && self.backlash_um() == 0.0
    }

    /// Its one table, where all of it is linear between that table's points.
    pub(crate) fn single_table(&self) -> Option<&PitchErrorTable> {
        let of_terms = self.terms.iter().filter_map(|(_, term)| term.effect.pitch_table());
        let mut tables = self.pitch.into_iter().chain(of_terms);
        let only = tables.next().filter(|_| self.travel_mm.is_none())?;
        tables.next().is_none().then_some(only)
    }

    /// Returns whether it bends between its points, so that they are a choice.
    pub(crate) fn is_curved(&self) -> bool {
        self.terms.iter().any(|(_, term)| term.effect.has_spatial_period())
    }

    /// Beyond the ends a table is held, as a control's is; what goes on and on is not.
    pub(crate) fn has_constant_extrapolation(&self) -> bool {
        self.travel_mm.is_none()
    }

    /// Returns the points between which it is linear, or nearly where it is curved, in mm, rising; none
    /// where it does not depend on the position.
    pub(crate) fn breakpoints_mm(&self) -> Vec<f64> {
        let mut points = self.pitch.map_or_else(Vec::new, table_positions_mm);
        if let Some((first, last)) = self.travel_mm {
            points.extend([first, last]);
        }
        for (_, term) in &self.terms {
            points.extend(term.effect.pitch_table().into_iter().flat_map(table_positions_mm));
            if let Some((first, last)) = self.travel_mm {
                let of_waves =
                    term.effect.board_terms().into_iter().filter_map(|form| match form {
                        BoardTerm::Wave { period_mm, harmonic, .. } => {
                            let parts = (last - first) / period_mm * f64::from(harmonic);
                            Some((parts * SAMPLES_PER_PERIOD).abs())
                        }
                        _ => None,
                    });
                let Some(parts) = of_waves.reduce(f64::max) else { continue };
                let parts = parts.ceil().clamp(1.0, MAX_TRAVEL_SAMPLES);
                let at = |part: u32| first + (last - first) * f64::from(part) / parts;
                points.extend((0..=parts as u32).map(at));
            }
        }
        points.sort_by(f64::total_cmp);
        // The same point by two ways of counting.
        points.dedup_by(|b, a| (*b - *a).abs() < 1e-9);
        points
    }
}

fn table_positions_mm(pitch: &PitchErrorTable) -> Vec<f64> {
    let at = |index| pitch.start_mm + pitch.step_mm * index as f64;
    (0..pitch.forward_um.len()).map(at).collect()
}

fn term_name(index: usize, term: &Term) -> String {
    format!("term[{index}] ({})", term.effect.name())
}

/// Returns what a term adds along its own axis, in µm.
fn own_axis_effect_um(effect: &Effect, position_mm: f64, approach: ApproachDirection) -> f64 {
    let read = |input: &LawInput<'_>| match input {
        LawInput::OwnPosition => position_mm,
        LawInput::OwnDirection => approach.sign(),
        _ => f64::NAN,
    };
    let x: Vec<f64> = effect.required_inputs().iter().map(read).collect();
    effect.evaluate_at(&effect.values(), &x)
}

/// Returns whether it is another function of the position in either direction.
fn is_bidirectional(effect: &Effect) -> bool {
    let reads = effect.required_inputs();
    reads.contains(&LawInput::OwnPosition) && reads.contains(&LawInput::OwnDirection)
}

/// Returns whether a term goes on and on along its axis, so that a table needs the travel.
fn needs_travel(effect: &Effect) -> bool {
    effect.required_inputs().contains(&LawInput::OwnPosition) && effect.pitch_table().is_none()
}

/// Returns the terms that no table of a control holds, each with the reason. The constants that a term
/// corrects are none of them: they are in the machine already.
pub(crate) fn unsupported_terms(
    machine: &Machine,
    options: &ExportOptions,
) -> Vec<(String, String)> {
    let mut omitted = Vec::new();
    for (index, term) in machine.terms.iter().enumerate() {
        let axis = term.quantity.axis();
        let by_column = input_column(&term.effect).map(|column| {
            format!("it depends on {column}, which no table of a control knows; the bridge does")
        });
        let reason = match &term.effect {
            effect if !effect.is_compensable() => continue,
            // Folded into the constants of the machine.
            effect if effect.stage() == PredictionStage::Constant => continue,
            effect if is_cross_axis(effect) && axis.is_some() => continue,
            effect if effect.depends_on_own_axis_only() && axis.is_some() => {
                let is_known = axis.is_some_and(|axis| travel_mm(machine, options, axis).is_some());
                if is_known || !needs_travel(effect) {
                    continue;
                }
                "it needs the travel of its axis: give it with --travel"
            }
            effect if has_two_position_inputs(effect) => {
                "it depends on two axes at once, which no table of a control does; the bridge corrects it"
            }
            _ => by_column.as_deref().unwrap_or(
                "it changes while the machine runs, which no table of a control follows; the bridge does",
            ),
        };
        // The growth by tool is the last term.
        let is_list = machine.spindle.tools.is_some() && index + 1 == machine.terms.len();
        let name = if is_list { "spindle.tools".into() } else { term_name(index, term) };
        omitted.push((name, reason.to_string()));
    }
    omitted
}

/// Returns the column that a term depends on where it is none of the model's own: the tool, or a condition.
fn input_column(effect: &Effect) -> Option<&str> {
    effect.required_inputs().into_iter().find_map(|input| match input {
        LawInput::Column(column) | LawInput::Lagged { column, .. } => Some(column),
        _ => None,
    })
}

/// Returns the angles and lines that the tables of a control cannot hold, each with the reason.
pub(crate) fn unsupported_volume_terms(
    machine: &Machine,
    format: ExportFormat,
) -> Vec<(String, String)> {
    let mut omitted = Vec::new();
    const LEVER_ARM_REASON: &str = "an angle acts by its lever along other axes, which no table of one axis holds; the bridge corrects it";
    const LEVER_ARM_REASON_840D: &str = "an angle acts by its lever along other axes, which no $AN_CEC table of one axis holds. The \
                           volumetric compensation of the 840D (VCS) could: no public description of its file was found, \
                           so none is written; the bridge corrects it";
    let by_lever =
        if format == ExportFormat::Siemens840d { LEVER_ARM_REASON_840D } else { LEVER_ARM_REASON };
    const ROTARY_AXIS_REASON: &str = "where the line of a rotary axis is stands in the control's own kinematics (swivel or \
                        transformation data); the bridge corrects it";
    let angles = machine.volume.angular.iter();
    omitted
        .extend(angles.map(|motion| (format!("angular.{}", motion.name()), by_lever.to_string())));
    let lines = machine.volume.rotary.iter().filter(|location| !location.is_error_free());
    omitted.extend(lines.map(|location| {
        (format!("rotary.{}", location.axis.name()), ROTARY_AXIS_REASON.to_string())
    }));
    omitted
}

/// Returns whether it adds a function of two positions and of nothing else.
fn has_two_position_inputs(effect: &Effect) -> bool {
    let reads = effect.required_inputs();
    let is_position =
        |input: &LawInput<'_>| matches!(input, LawInput::Position(_) | LawInput::OwnPosition);
    reads.len() == 2 && reads.iter().all(is_position)
}

/// Returns whether it adds a function of another axis's position alone.
fn is_cross_axis(effect: &Effect) -> bool {
    matches!(effect.required_inputs()[..], [LawInput::Position(_)])
}

/// The error of one axis while another moves.
#[derive(Clone)]
pub(crate) struct CrossAxisError<'m> {
    pub error: LinearAxis,
    pub along: LinearAxis,
    /// Where each comes from, and it.
    splines: Vec<(String, Cow<'m, BSpline>)>,
    /// Where each comes from, and it.
    angles: Vec<(String, f64)>,
    constant_um: f64,
}

impl<'m> CrossAxisError<'m> {
    fn new(error: LinearAxis, along: LinearAxis) -> Self {
        Self { error, along, splines: Vec::new(), angles: Vec::new(), constant_um: 0.0 }
    }

    /// Returns the sections of the machine file that it comes from.
    pub(crate) fn source_sections(&self) -> String {
        let splines = self.splines.iter().map(|(name, _)| name.clone());
        splines
            .chain(self.angles.iter().map(|(name, _)| name.clone()))
            .collect::<Vec<_>>()
            .join(" + ")
    }

    /// Its error in µm.
    pub fn error_um(&self, along_mm: f64) -> f64 {
        let (error, along) = (self.error, self.along);
        let angles = self.angles.iter().map(|&(_, um_per_m)| {
            squareness_error_um(&Squareness { error, along, um_per_m }, along_mm)
        });
        self.splines.iter().map(|(_, spline)| spline_value_um(spline, along_mm)).sum::<f64>()
            + angles.sum::<f64>()
            + self.constant_um
    }

    /// From where to where it must be exported: over the knots, and an angle over the travel;
    /// `None`: an angle, and no travel is known.
    pub fn range_mm(&self, machine: &Machine, options: &ExportOptions) -> Option<(f64, f64)> {
        let travel = if self.has_constant_extrapolation() {
            None
        } else {
            Some(travel_mm(machine, options, self.along)?)
        };
        let knots = self.splines.iter().filter_map(|(_, spline)| knot_range_mm(spline));
        knots.chain(travel).reduce(|(a, b), (c, d)| (a.min(c), b.max(d)))
    }

    /// Where the curve may turn.
    pub(crate) fn knot_positions_mm(&self) -> Vec<f64> {
        let mut knots: Vec<f64> =
            self.splines.iter().flat_map(|(_, spline)| spline.knots_mm.iter().copied()).collect();
        knots.sort_by(f64::total_cmp);
        knots.dedup();
        knots
    }

    /// Returns whether it bends between its ends.
    pub(crate) fn is_curved(&self) -> bool {
        !self.splines.is_empty()
    }

    /// Beyond the ends a spline is held, as a table is; an angle goes on, and no table can.
    pub(crate) fn has_constant_extrapolation(&self) -> bool {
        self.angles.is_empty()
    }

    /// Its curves and its angle one by one, for a control that adds tables up: an angle is two
    /// points then, and a curve ends where its knots end.
    pub(crate) fn split_into_terms(&self) -> Vec<CrossAxisError<'m>> {
        let empty = || Self::new(self.error, self.along);
        let splines =
            self.splines.iter().map(|spline| Self { splines: vec![spline.clone()], ..empty() });
        let angle =
            (!self.angles.is_empty()).then(|| Self { angles: self.angles.clone(), ..empty() });
        let mut apart: Vec<_> = splines.chain(angle).collect();
        if let Some(first) = apart.first_mut() {
            first.constant_um = self.constant_um;
        }
        apart
    }
}

/// Returns every drive that has an error, X before Y before Z and the first before the second.
pub(crate) fn collect_drive_errors<'m>(
    machine: &'m Machine,
    options: &ExportOptions,
) -> Vec<DriveErrorModel<'m>> {
    let mut drives = Vec::new();
    for axis in LinearAxis::ALL {
        let of = &machine.axes[axis.index()];
        let travel = travel_mm(machine, options, axis);
        let terms = machine.terms.iter().enumerate().filter(|(_, term)| {
            term.quantity.axis() == Some(axis)
                && term.effect.depends_on_own_axis_only()
                && (travel.is_some() || !needs_travel(&term.effect))
        });
        let terms: Vec<(usize, &Term)> = terms.collect();
        let goes_on = terms.iter().any(|(_, term)| needs_travel(&term.effect));
        let first = DriveErrorModel {
            axis,
            is_second: false,
            pitch: of.pitch.as_ref(),
            backlash: of.backlash.as_ref(),
            terms,
            travel_mm: travel.filter(|_| goes_on),
        };
        let second = of.dual.as_ref().map(|dual| DriveErrorModel {
            is_second: true,
            pitch: Some(&dual.pitch),
            ..first.clone()
        });
        if first.pitch.is_some() || first.backlash.is_some() || !first.terms.is_empty() {
            drives.push(first);
        }
        drives.extend(second);
    }
    drives
}

/// Returns every pair of axes of which one is in error along the other.
pub(crate) fn collect_cross_axis_errors(machine: &Machine) -> Vec<CrossAxisError<'_>> {
    let mut cross_axis_errors: Vec<CrossAxisError<'_>> = Vec::new();
    for curve in &machine.straightness {
        let named = (format!("straightness.{}", curve.name()), Cow::Borrowed(&curve.spline));
        find_or_insert_axis_pair(&mut cross_axis_errors, curve.error, curve.along)
            .splines
            .push(named);
    }
    for angle in machine.squareness.iter().filter(|angle| angle.um_per_m != 0.0) {
        let named = (format!("squareness.{}", angle.name()), angle.um_per_m);
        find_or_insert_axis_pair(&mut cross_axis_errors, angle.error, angle.along)
            .angles
            .push(named);
    }
    for (index, term) in machine.terms.iter().enumerate() {
        let Some(error) = term.quantity.axis() else { continue };
        let name = term_name(index, term);
        for form in term.effect.board_terms() {
            match form {
                BoardTerm::Curve(along, spline) => {
                    let pair = find_or_insert_axis_pair(&mut cross_axis_errors, error, along);
                    pair.splines.push((name.clone(), Cow::Owned(spline)));
                    pair.constant_um += term.constant_um;
                }
                BoardTerm::Position { axis, um_per_m } => {
                    let pair = find_or_insert_axis_pair(&mut cross_axis_errors, error, axis);
                    pair.angles.push((name.clone(), um_per_m));
                    pair.constant_um += term.constant_um;
                }
                _ => {}
            }
        }
    }
    cross_axis_errors
}

/// Returns the pair in the list, put there if it is not.
fn find_or_insert_axis_pair<'c, 'm>(
    cross_axis_errors: &'c mut Vec<CrossAxisError<'m>>,
    error: LinearAxis,
    along: LinearAxis,
) -> &'c mut CrossAxisError<'m> {
    let found =
        cross_axis_errors.iter().position(|cross| (cross.error, cross.along) == (error, along));
    let index = found.unwrap_or_else(|| {
        cross_axis_errors.push(CrossAxisError::new(error, along));
        cross_axis_errors.len() - 1
    });
    &mut cross_axis_errors[index]
}

/// Returns the travel of `axis`: as given, else as far as tables and knots reach.
pub(crate) fn travel_mm(
    machine: &Machine,
    options: &ExportOptions,
    axis: LinearAxis,
) -> Option<(f64, f64)> {
    if let Some(travel) = options.travel_mm[axis.index()] {
        return Some(travel);
    }
    let of = &machine.axes[axis.index()];
    let tables = of.pitch.iter().chain(of.dual.as_ref().map(|dual| &dual.pitch));
    let own = machine.terms.iter().filter(|term| term.quantity.axis() == Some(axis));
    let of_terms = own.filter_map(|term| term.effect.pitch_table());
    let tables = tables.chain(of_terms).filter_map(|pitch| {
        let points = table_positions_mm(pitch);
        Some((*points.first()?, *points.last()?))
    });
    let curves = machine.straightness.iter().filter(|curve| curve.along == axis);
    let curves = curves.map(|curve| &curve.spline);
    let of_terms: Vec<BSpline> = machine
        .terms
        .iter()
        .flat_map(|term| term.effect.board_terms())
        .filter_map(|form| match form {
            BoardTerm::Curve(along, spline) if along == axis => Some(spline),
            _ => None,
        })
        .collect();
    tables
        .chain(curves.chain(&of_terms).filter_map(knot_range_mm))
        .reduce(|(a, b), (c, d)| (a.min(c), b.max(d)))
        .filter(|(first, last)| first < last)
}

fn knot_range_mm(spline: &BSpline) -> Option<(f64, f64)> {
    Some((*spline.knots_mm.first()?, *spline.knots_mm.last()?))
}
