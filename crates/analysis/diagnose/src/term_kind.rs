//! The kinds of terms of a model: a cause as its page has it, with its fitted values next to it; or a curve,
//! which is no cause.
//!
//! The values are first those that enter nonlinearly (a time constant, a period, a limit), then
//! amplitudes, all of which are 0 where there is no effect.

use trueup_machine::{
    effect::{BoardTerm, Effect, HeatPath, LawInput, NonlinearParameter, PredictionStage, Target},
    machine_file::{PitchErrorTable, Quantity, ThermalLaw},
};

#[cfg(test)]
use trueup_machine::effect::TemperatureResponse;

use crate::data::{DataTable, StatedTerm, is_position_column};

/// A cause, neutral, with what is fixed about it; or one of the machine file; or a test of structure.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum TermKind {
    Cause(Effect),
    /// A term that the machine file has, with the values that the file says.
    StatedTerm(StatedTerm),
    Curve(LackOfFitCurve),
}

/// A test of structure and no cause: a curve over a column.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct LackOfFitCurve {
    pub column: String,
    pub knots: Vec<f64>,
    pub by_direction: bool,
    /// The curve grows with this column.
    pub times: Option<String>,
}

/// A cause and its values.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ModelPart {
    pub kind: TermKind,
    pub values: Vec<f64>,
}

impl ModelPart {
    /// Replaces the cause by its form that needs no feed.
    pub(crate) fn remove_feed_dependence(&mut self) {
        let Some(cause) = self.kind.cause() else { return };
        let whole = cause.with_values(&self.values);
        let held = whole.without_feed_dependence();
        if held != whole {
            self.values = held.values();
            let neutral = held.with_values(&vec![0.0; held.parameter_count()]);
            self.kind = TermKind::Cause(neutral);
        }
    }
}

impl TermKind {
    /// Returns the cause, neutral or as the machine file says, if it is one.
    pub(crate) fn cause(&self) -> Option<&Effect> {
        match self {
            Self::Cause(effect) | Self::StatedTerm(StatedTerm { effect, .. }) => Some(effect),
            Self::Curve(_) => None,
        }
    }

    /// Returns the name of the cause.
    pub(crate) fn name(&self) -> &'static str {
        self.cause().map_or("structure", Effect::name)
    }

    /// Returns the column that the cause depends on, where there is a choice.
    pub(crate) fn column(&self) -> Option<String> {
        match self {
            Self::Curve(curve) => Some(curve.column.clone()),
            _ => self.cause().and_then(Effect::input_column),
        }
    }

    /// Returns its name with the column that it depends on.
    pub(crate) fn name_with_column(&self) -> String {
        match self.column() {
            Some(column) => format!("{} of {column}", self.name()),
            None => self.name().into(),
        }
    }

    /// Returns whether a board may correct it: not what only happened once, nor what is not the machine's.
    pub(crate) fn is_compensable(&self) -> bool {
        self.cause().is_none_or(|effect| effect.is_compensable())
    }

    /// Its nonlinear values.
    pub(crate) fn nonlinear_parameters(&self) -> &'static [NonlinearParameter] {
        self.cause().map_or(&[], |effect| effect.nonlinear_parameters())
    }

    /// Returns whether the value of this number is varied by ratios.
    pub(crate) fn is_log_scaled(&self, number: usize) -> bool {
        self.nonlinear_parameters().get(number).is_some_and(|value| value.is_log_scaled())
    }

    /// Returns whether its first value is a time constant.
    pub(crate) fn has_time_constant(&self) -> bool {
        self.cause().is_some_and(Effect::has_time_constant)
    }

    /// Returns whether it settles from the start of the record on, whatever is measured next to it.
    pub(crate) fn is_settling_from_start(&self) -> bool {
        self.has_time_constant() && self.cause().is_some_and(Effect::depends_on_time)
    }

    /// Returns whether it depends on something that was measured or commanded next to the quantity: not on time
    /// alone, nor bent with the prediction, nor a constant.
    pub(crate) fn has_own_input(&self) -> bool {
        self.cause().is_none_or(|effect| {
            let is_of_clock = effect.depends_on_time() && !effect.has_time_constant();
            !is_of_clock && !effect.is_constant() && effect.stage() != PredictionStage::Bend
        })
    }

    /// Returns whether it depends on where the axes are, and on nothing else.
    pub(crate) fn depends_on_positions_alone(&self) -> bool {
        let is_position = |input: &LawInput<'_>| match input {
            LawInput::Position(_) | LawInput::OwnPosition | LawInput::OwnDirection => true,
            LawInput::Column(column) => is_position_column(column),
            _ => false,
        };
        match self {
            Self::Curve(curve) => is_position_column(&curve.column) && curve.times.is_none(),
            _ => self.cause().is_some_and(|effect| {
                let inputs = effect.required_inputs();
                !inputs.is_empty() && inputs.iter().all(is_position)
            }),
        }
    }

    /// Returns whether it may be a part of `open`, a term that is not settled. What has no input of its own may be part of
    /// any: what that one lacks is correlated with time and with the prediction as well. A path of heat may be part of another:
    /// thermometers of one machine are correlated, and with other rows of the same record another one is open.
    pub(crate) fn may_be_part_of(&self, open: &Self) -> bool {
        let is_path = |kind: &Self| kind.tier() > 0 && kind.heat_path().is_some();
        !open.is_instrument_error() && !self.has_own_input() || is_path(open) && is_path(self)
    }

    /// Returns whether its first value is a time that is searched, not fitted.
    pub(crate) fn has_instant(&self) -> bool {
        self.cause().is_some_and(Effect::has_instant)
    }

    /// Returns how many amplitudes it has.
    pub(crate) fn amplitude_count(&self) -> usize {
        match self {
            Self::Cause(effect) | Self::StatedTerm(StatedTerm { effect, .. }) => {
                effect.amplitude_count()
            }
            Self::Curve(curve) => curve.knots.len() * if curve.by_direction { 2 } else { 1 },
        }
    }

    /// Returns how many neighbours are in each of the lists that its values are, if they are.
    pub(crate) fn list_length(&self) -> Option<usize> {
        match self {
            Self::Cause(effect) | Self::StatedTerm(StatedTerm { effect, .. }) => {
                effect.list_length()
            }
            Self::Curve(curve) => Some(curve.knots.len()),
        }
    }

    /// Returns what it counts for where simplicity counts.
    pub(crate) fn degrees_of_freedom(&self) -> usize {
        self.nonlinear_parameters().len() + self.amplitude_count()
    }

    /// 0: a constant of the machine's own model, or of the axis's; 1: something else that was
    /// recorded; 2: time alone, or the instrument; 3: no cause.
    pub(crate) fn tier(&self) -> u8 {
        match self {
            // What the file has is a part of the machine's own model.
            Self::StatedTerm(_) => 0,
            _ => self.cause().map_or(3, |effect| effect.tier()),
        }
    }

    /// Returns the term of the machine file that it is, if it is one.
    pub(crate) fn as_stated_term(&self) -> Option<&StatedTerm> {
        match self {
            Self::StatedTerm(stated) => Some(stated),
            _ => None,
        }
    }

    /// Returns whether its reference (a temperature, a start) is its own, and with it a constant. That of a
    /// term of the machine file is the file's.
    pub(crate) fn has_reference(&self) -> bool {
        self.as_stated_term().is_none() && self.cause().is_some_and(|effect| effect.has_reference())
    }

    /// When it acts.
    pub(crate) fn prediction_stage(&self) -> PredictionStage {
        self.cause().map_or(PredictionStage::Sum, |effect| effect.stage())
    }

    /// Returns whether it may change the constants of the machine's own model, or the source's law.
    pub(crate) fn is_constant_correction(&self) -> bool {
        matches!(
            self.prediction_stage(),
            PredictionStage::Constant | PredictionStage::FallingTimeConstants
        )
    }

    /// Returns whether it multiplies the prediction.
    pub(crate) fn is_multiplicative(&self) -> bool {
        self.prediction_stage() == PredictionStage::Factor
    }

    /// Returns whether it only adds its columns, whatever the rest of the model is.
    pub(crate) fn is_additive(&self) -> bool {
        self.prediction_stage() == PredictionStage::Sum
    }

    /// Returns whether it moves all of the model in time.
    pub(crate) fn is_time_shift(&self) -> bool {
        self.prediction_stage() == PredictionStage::Shift
    }

    /// Returns whether it changes the elongation, which then goes along the tool; else the axis.
    pub(crate) fn affects_elongation(&self, data: &DataTable) -> bool {
        if data.setting.quantity == Quantity::Elongation {
            return true;
        }
        if let Self::StatedTerm(stated) = self {
            return stated.is_of_elongation;
        }
        match self.cause().map(|effect| effect.target()) {
            Some(Target::Elongation) => true,
            Some(Target::OwnThermometer) => own_axis_thermal_law(data).is_none(),
            Some(Target::Heat) => {
                data.setting.has_elongation
                    && data.predicted.along.iter().any(|along| *along != 0.0)
            }
            Some(Target::Axis | Target::Any) | None => false,
        }
    }

    /// Returns the path by which it brings heat.
    pub(crate) fn heat_path(&self) -> Option<HeatPath<'_>> {
        self.cause().and_then(|effect| effect.heat_path())
    }

    /// Returns the same heat by a path of its own, neutral.
    pub(crate) fn to_separate_heat_path(&self, has_lag: bool) -> Option<Self> {
        let Self::Cause(effect) = self else { return None };
        let mut effect = effect.clone();
        let heat = effect.temperature_response_mut()?;
        heat.um_per_c = 0.0;
        heat.time_constant_s = if has_lag { 1.0 } else { 0.0 };
        Self::from_board_term(None, &BoardTerm::Heat(heat.clone()))
    }

    /// Returns the table of the own axis that it is, and the machine file has not.
    pub(crate) fn as_pitch_table(&self) -> Option<&PitchErrorTable> {
        let Self::Cause(effect) = self else { return None };
        effect.pitch_table()
    }

    /// Returns whether it is a wave of a period that is fitted.
    pub(crate) fn has_spatial_period(&self) -> bool {
        self.cause().is_some_and(Effect::has_spatial_period)
    }

    /// Returns whether it is a wave, over the position or the time.
    pub(crate) fn is_periodic(&self) -> bool {
        self.cause().is_some_and(Effect::has_phase)
    }

    /// Returns whether it is periodic in time: next to a law that is missing, it follows whatever drives
    /// that.
    pub(crate) fn is_periodic_in_time(&self) -> bool {
        matches!(self.cause(), Some(Effect::PeriodicInTime(_)))
    }

    /// Returns whether it takes two recorded inputs together.
    pub(crate) fn is_flexible(&self) -> bool {
        self.cause().is_some_and(Effect::is_flexible)
    }

    /// Returns whether it is the error of the reference instrument.
    pub(crate) fn is_instrument_error(&self) -> bool {
        self.cause().is_some_and(|effect| effect.is_instrument_error())
    }

    /// Returns the cause that a form stands for, of an axis or (none) the elongation.
    pub(crate) fn from_board_term(
        own: Option<trueup_machine::machine_file::LinearAxis>,
        form: &BoardTerm,
    ) -> Option<Self> {
        Effect::from_board(own, form, &mut 0.0).map(Self::Cause)
    }

    /// Heat of a column by a path of its own, neutral.
    #[cfg(test)]
    pub(crate) fn heat_of(column: &str, has_lag: bool) -> Self {
        let time_constant_s = if has_lag { 1.0 } else { 0.0 };
        let column = column.to_string();
        let heat = TemperatureResponse { column, um_per_c: 0.0, time_constant_s, reference_c: 0.0 };
        Self::from_board_term(None, &BoardTerm::Heat(heat)).expect("a form of the board")
    }

    /// Returns the measurement that would settle what is open about it, against a rival where there is one.
    pub(crate) fn next_test(&self, rival: Option<&str>) -> &'static str {
        self.cause().map_or("Vary this column alone.", |effect| effect.next_test(rival))
    }

    /// Returns a measurement with what at the machine may be repaired in place of being corrected.
    pub(crate) fn append_repair_advice(&self, next_test: String) -> String {
        match self.cause().and_then(|effect| effect.repair_advice()) {
            Some(repair) => format!("{next_test} {repair}"),
            None => next_test,
        }
    }
}

impl ModelPart {
    /// Returns a term of the machine file as it stands there.
    pub(crate) fn from_stated_term(stated: &StatedTerm) -> Self {
        Self { values: stated.effect.values(), kind: TermKind::StatedTerm(stated.clone()) }
    }

    /// Returns the cause with its values.
    pub(crate) fn cause(&self) -> Option<Effect> {
        self.kind.cause().map(|effect| effect.with_values(&self.values))
    }

    /// Returns the cause in a sentence.
    pub(crate) fn sentence(&self) -> String {
        match &self.kind {
            TermKind::Cause(effect) | TermKind::StatedTerm(StatedTerm { effect, .. }) => {
                effect.describe(&self.values)
            }
            TermKind::Curve(curve) => format!("The error depends on {}.", curve.column),
        }
    }
}

/// Returns the thermal section of the quantity's own axis.
pub(crate) fn own_axis_thermal_law(data: &DataTable) -> Option<&ThermalLaw> {
    data.setting
        .quantity
        .axis()
        .and_then(|axis| data.setting.machine.axes[axis.index()].thermal.as_ref())
}
