//! `axis-expansion`: the axis grows with a temperature, and the machine file says nothing of it.
//!
//! ```text
//! p + c·(lag_τ(T) − T_ref)·(P − P₀)/1000          τ may be 0
//! ```
//!
//! T_ref and P₀ are fitted with c: about any two references T₁ and P₁ the same is
//!
//! ```text
//! c·(T − T₁)·(P − P₁)/1000 + a·(P − P₁)/1000 + b·(T − T₁) + constant
//! T_ref = T₁ − a/c          P₀ = P₁ − 1000·b/c          constant = a·b/c
//! ```
//!
//! which is linear in c, a and b. So a start from cold, a scale that is right at another temperature
//! and a shift of the whole axis with its temperature are in the term, and need none next to it.

use super::{
    cause_spec::{
        BoardRepresentation, BoardTerm, Candidate, Explanation, FileRepresentation,
        FindingParameter, FitSpec, LawInput, NonlinearParameter, PhysicalLaw, Target, TermContext,
        TermEntry, Value, format_duration,
    },
    data_view::{DataView, StartValues, TIME_CONSTANT_GRID_POINTS},
    temperature_columns,
};
use crate::{
    keys::{
        reader::Section,
        table::{Table, entries, table},
        term::{COLUMN, ORIGIN_MM, REFERENCE_C, TIME_CONSTANT_S, UM_PER_M_PER_C},
    },
    location::InputFileError,
    sections::{ThermalLaw, ThermalMode},
};

table! {
    /// The growth of an axis that has no `[axis.*.thermal]`.
    #[derive(Clone, Debug, PartialEq)]
    pub struct AxisExpansion {
        /// The column of T, `temp_<name>_c`.
        column: String = COLUMN.with_value_type(Column).required();
        /// c, in µm/(m·K); positive where the warm axis goes too far.
        um_per_m_per_c: f64 = UM_PER_M_PER_C.required();
        /// τ in s; 0: no lag.
        time_constant_s: f64 = TIME_CONSTANT_S.with_default("0.0");
        /// T_ref in °C.
        reference_c: f64 = REFERENCE_C.required();
        /// P₀ in mm.
        origin_mm: f64 = ORIGIN_MM.with_default("0.0");
    }
}

impl AxisExpansion {
    fn has_lag(&self) -> bool {
        self.time_constant_s != 0.0
    }

    /// c, a and b of these values.
    fn amplitudes_from_values(values: &[f64]) -> [f64; 3] {
        let first = values.len() - 3;
        [values[first], values[first + 1], values[first + 2]]
    }
}

impl FileRepresentation for AxisExpansion {
    const NAME: &'static str = "axis-expansion";

    fn keys(_: &Section<'_>) -> &'static [&'static str] {
        Self::NAMES
    }

    fn read(section: &Section<'_>) -> Result<Self, InputFileError> {
        Table::read(section)
    }

    fn entries(&self) -> Vec<TermEntry> {
        entries(self)
    }
}

impl PhysicalLaw for AxisExpansion {
    fn target(&self) -> Target {
        Target::Axis
    }

    fn refusal(&self, host: &TermContext<'_>) -> Option<String> {
        host.thermal.map(|_| "belongs to an axis without [axis.*.thermal], its law is there".into())
    }

    fn inputs(&self, nonlinear: &[f64]) -> Vec<LawInput<'_>> {
        let lag_s = nonlinear.first().copied().unwrap_or(0.0);
        vec![LawInput::Temperature { column: &self.column, lag_s }, LawInput::OwnPosition]
    }

    fn add_unit_effects(&self, _: &[f64], x: &[f64], add: &mut impl FnMut(usize, f64)) {
        let (above_c, way_m) = (x[0] - self.reference_c, (x[1] - self.origin_mm) / 1000.0);
        add(0, above_c * way_m);
        add(1, way_m);
        add(2, above_c);
    }

    fn constant_um(&self, values: &[f64]) -> f64 {
        let [c, a, b] = Self::amplitudes_from_values(values);
        if c == 0.0 { 0.0 } else { -a * b / c }
    }
}

impl BoardRepresentation for AxisExpansion {
    fn board_terms(&self) -> Vec<BoardTerm> {
        vec![BoardTerm::Thermal(ThermalLaw {
            mode: ThermalMode::Position,
            sensor: self.column.clone(),
            reference_c: self.reference_c,
            constant_um_per_c: 0.0,
            slope_um_per_m_per_c: self.um_per_m_per_c,
            origin_mm: self.origin_mm,
            lag_s: self.time_constant_s,
            table: None,
        })]
    }
}

impl Candidate for AxisExpansion {
    fn fit_spec(&self) -> FitSpec {
        FitSpec {
            // A scale that is off is nearer: an expansion has room for it, and must do more.
            tier: 1,
            nonlinear: if self.has_lag() { &[NonlinearParameter::TimeConstant] } else { &[] },
            amplitudes: 3,
            has_reference: true,
            ..FitSpec::DEFAULT
        }
    }

    fn values(&self) -> Vec<f64> {
        let lag_s = self.has_lag().then_some(self.time_constant_s);
        lag_s.into_iter().chain([self.um_per_m_per_c, 0.0, 0.0]).collect()
    }

    fn set_values(&mut self, values: &[f64]) {
        if self.has_lag() {
            self.time_constant_s = values[0];
        }
        let [c, a, b] = Self::amplitudes_from_values(values);
        self.um_per_m_per_c = c;
        // Without a growth it has no references.
        if c != 0.0 {
            self.reference_c -= a / c;
            self.origin_mm -= 1000.0 * b / c;
        }
    }

    fn propose(survey: &dyn DataView, with: &mut dyn FnMut(Self, StartValues)) {
        let is_open = survey.thermal_law().is_none()
            && !survey.has_cause(Self::NAME)
            && survey.has_own_axis_moved();
        let Some(position_mm) = survey.own_position_mm().filter(|_| is_open) else { return };
        let there = position_mm.iter().copied().filter(|mm| mm.is_finite());
        let [low, high] = there.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], mm| {
            [low.min(mm), high.max(mm)]
        });
        for (column, _) in temperature_columns::candidate_temperature_columns(survey) {
            let neutral = |time_constant_s: f64| Self {
                column: column.into(),
                um_per_m_per_c: 0.0,
                time_constant_s,
                reference_c: survey.reference_temperature_c(column),
                origin_mm: (low + high) / 2.0,
            };
            with(neutral(0.0), StartValues::linear_only());
            with(neutral(1.0), survey.time_constant_start_values(TIME_CONSTANT_GRID_POINTS));
        }
    }
}

impl Explanation for AxisExpansion {
    fn describe(&self, values: &[f64]) -> String {
        let [c, ..] = Self::amplitudes_from_values(values);
        let behind = if self.has_lag() {
            format!(", behind a time constant of {}", format_duration(values[0]))
        } else {
            String::new()
        };
        format!(
            "The axis grows with {} by {c:+.3} µm/(m·K){behind}, and the machine file has no \
             [axis.*.thermal] for it.",
            self.column
        )
    }

    fn next_test(&self) -> &'static str {
        "Measure the axis at both ends, cold and after a warm-up of at least 5 K."
    }

    fn distinguishing_test(alternative: &str) -> Option<&'static str> {
        match alternative {
            "pitch-scale" | "extra-heat-path" => Some(
                "Measure the axis at both ends, cold and warm. A scale does not change, heat by \
                 another path moves both ends alike, an expansion moves them apart.",
            ),
            _ => None,
        }
    }

    fn parameters(&self, values: &[f64]) -> Vec<FindingParameter> {
        let mut fitted = self.clone();
        fitted.set_values(values);
        let time_constant = if self.has_lag() {
            FindingParameter::Fitted("time_constant_s", 0, 0.0)
        } else {
            FindingParameter::Fixed("time_constant_s", 0.0)
        };
        vec![
            FindingParameter::Fitted("um_per_m_per_c", values.len() - 3, 0.0),
            time_constant,
            FindingParameter::Stated("reference_c", Value::Number(fitted.reference_c)),
            FindingParameter::Stated("origin_mm", Value::Number(fitted.origin_mm)),
        ]
    }
}
