//! The kinds of terms of a model: a cause as its page has it, with its fitted values next to it; or a curve,
//! which is no cause.
//!
//! The values are first those that enter nonlinearly (a time constant, a period, a limit), then
//! amplitudes, all of which are 0 where there is no effect.

use trueup_machine::{
    effect::{Effect, HeatPath, Nonlinear, OnBoard, Stage, Target},
    file::{Pitch, Quantity, Thermal},
};

#[cfg(test)]
use trueup_machine::effect::Heat;

use crate::data::{Data, Stated};

/// A cause, neutral, with what is fixed about it; or one of the machine file; or a test of structure.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Kind {
    Cause(Effect),
    /// A term that the machine file has, with the values that the file says.
    Stated(Stated),
    Curve(Curve),
}

/// A test of structure and no cause: a curve over a column.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Curve {
    pub column: String,
    pub knots: Vec<f64>,
    pub by_direction: bool,
    /// The curve grows with this column.
    pub times: Option<String>,
}

/// A cause and its values.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Part {
    pub kind: Kind,
    pub values: Vec<f64>,
}

impl Part {
    /// Replaces the cause by its form that needs no feed.
    pub(crate) fn forget_feed(&mut self) {
        let Some(cause) = self.kind.cause() else { return };
        let whole = cause.with(&self.values);
        let held = whole.without_feed();
        if held != whole {
            self.values = held.values();
            let neutral = held.with(&vec![0.0; held.degrees()]);
            self.kind = Kind::Cause(neutral);
        }
    }
}

impl Kind {
    /// Returns the cause, neutral or as the machine file says, if it is one.
    pub(crate) fn cause(&self) -> Option<&Effect> {
        match self {
            Self::Cause(effect) | Self::Stated(Stated { effect, .. }) => Some(effect),
            Self::Curve(_) => None,
        }
    }

    /// Returns the name of the cause.
    pub(crate) fn name(&self) -> &'static str {
        self.cause().map_or("structure", Effect::name)
    }

    /// Returns the column that the cause hangs on, where there is a choice.
    pub(crate) fn column(&self) -> Option<String> {
        match self {
            Self::Curve(curve) => Some(curve.column.clone()),
            _ => self.cause().and_then(Effect::column),
        }
    }

    /// Returns its name with the column that it hangs on.
    pub(crate) fn title(&self) -> String {
        match self.column() {
            Some(column) => format!("{} of {column}", self.name()),
            None => self.name().into(),
        }
    }

    /// Returns whether a board may correct it: not what only happened once, nor what is not the machine's.
    pub(crate) fn is_compensated(&self) -> bool {
        self.cause().is_none_or(|effect| effect.is_compensated())
    }

    /// Its nonlinear values.
    pub(crate) fn nonlinear(&self) -> &'static [Nonlinear] {
        self.cause().map_or(&[], |effect| effect.nonlinear())
    }

    /// Returns whether the value of this number is varied by ratios.
    pub(crate) fn is_logarithmic(&self, number: usize) -> bool {
        self.nonlinear().get(number).is_some_and(|value| value.is_logarithmic())
    }

    /// Returns whether its first value is a time constant.
    pub(crate) fn has_time_constant(&self) -> bool {
        self.cause().is_some_and(Effect::has_time_constant)
    }

    /// Returns whether it settles from the start of the record on, whatever is measured next to it.
    pub(crate) fn is_from_the_start(&self) -> bool {
        self.has_time_constant() && self.cause().is_some_and(Effect::is_in_time)
    }

    /// Returns whether it goes with something that was measured or commanded next to the quantity: not with time
    /// alone, nor bent with the prediction, nor a constant.
    pub(crate) fn has_own_input(&self) -> bool {
        self.cause().is_none_or(|effect| {
            let is_of_clock = effect.is_in_time() && !effect.has_time_constant();
            !is_of_clock && !effect.is_constant() && effect.stage() != Stage::Bend
        })
    }

    /// Returns whether it may be a part of `open`, a term that is not settled. What has no input of its own may be part of
    /// any: what that one lacks goes with time and with the prediction as well. A path of heat may be part of another:
    /// thermometers of one machine go alike, and with other rows of the same record another one is open.
    pub(crate) fn may_be_of(&self, open: &Self) -> bool {
        let is_path = |kind: &Self| kind.tier() > 0 && kind.heat_path().is_some();
        !open.is_of_instrument() && !self.has_own_input() || is_path(open) && is_path(self)
    }

    /// Returns whether its first value is a time that is searched, not fitted.
    pub(crate) fn has_instant(&self) -> bool {
        self.cause().is_some_and(Effect::has_instant)
    }

    /// Returns how many amplitudes it has.
    pub(crate) fn amplitudes(&self) -> usize {
        match self {
            Self::Cause(effect) | Self::Stated(Stated { effect, .. }) => effect.amplitudes(),
            Self::Curve(curve) => curve.knots.len() * if curve.by_direction { 2 } else { 1 },
        }
    }

    /// Returns how many neighbours are in each of the lists that its values are, if they are.
    pub(crate) fn list_length(&self) -> Option<usize> {
        match self {
            Self::Cause(effect) | Self::Stated(Stated { effect, .. }) => effect.list_length(),
            Self::Curve(curve) => Some(curve.knots.len()),
        }
    }

    /// Returns what it counts for where simplicity counts.
    pub(crate) fn degrees(&self) -> usize {
        self.nonlinear().len() + self.amplitudes()
    }

    /// 0: a constant of the machine's own model, or of the axis's; 1: something else that was
    /// recorded; 2: time alone, or the instrument; 3: no cause.
    pub(crate) fn tier(&self) -> u8 {
        match self {
            // What the file has is a part of the machine's own model.
            Self::Stated(_) => 0,
            _ => self.cause().map_or(3, |effect| effect.tier()),
        }
    }

    /// Returns the term of the machine file that it is, if it is one.
    pub(crate) fn stated(&self) -> Option<&Stated> {
        match self {
            Self::Stated(stated) => Some(stated),
            _ => None,
        }
    }

    /// Returns whether its reference (a temperature, a start) is its own, and with it a constant. That of a
    /// term of the machine file is the file's.
    pub(crate) fn has_reference(&self) -> bool {
        self.stated().is_none() && self.cause().is_some_and(|effect| effect.has_reference())
    }

    /// When it acts.
    pub(crate) fn stage(&self) -> Stage {
        self.cause().map_or(Stage::Sum, |effect| effect.stage())
    }

    /// Returns whether it may change the constants of the machine's own model, or the source's law.
    pub(crate) fn corrects(&self) -> bool {
        matches!(self.stage(), Stage::Constant | Stage::Falling)
    }

    /// Returns whether it multiplies the prediction.
    pub(crate) fn is_factor(&self) -> bool {
        self.stage() == Stage::Factor
    }

    /// Returns whether it only adds its columns, whatever the rest of the model is.
    pub(crate) fn is_added(&self) -> bool {
        self.stage() == Stage::Sum
    }

    /// Returns whether it moves all of the model in time.
    pub(crate) fn is_shift(&self) -> bool {
        self.stage() == Stage::Shift
    }

    /// Returns whether it changes the elongation, which then goes along the tool; else the axis.
    pub(crate) fn is_of_elongation(&self, data: &Data) -> bool {
        if data.quantity == Quantity::Elongation {
            return true;
        }
        if let Self::Stated(stated) = self {
            return stated.is_of_elongation;
        }
        match self.cause().map(|effect| effect.home()) {
            Some(Target::Elongation) => true,
            Some(Target::OwnThermometer) => own_thermal(data).is_none(),
            Some(Target::Heat) => {
                data.has_elongation && data.along.iter().any(|along| *along != 0.0)
            }
            Some(Target::Axis | Target::Any) | None => false,
        }
    }

    /// Returns the path by which it brings heat.
    pub(crate) fn heat_path(&self) -> Option<HeatPath<'_>> {
        self.cause().and_then(|effect| effect.heat_path())
    }

    /// Returns the same heat by a path of its own, neutral.
    pub(crate) fn as_own_path(&self, has_lag: bool) -> Option<Self> {
        let Self::Cause(effect) = self else { return None };
        let mut effect = effect.clone();
        let heat = effect.heat_mut()?;
        heat.um_per_c = 0.0;
        heat.time_constant_s = if has_lag { 1.0 } else { 0.0 };
        Self::of_form(None, &OnBoard::Heat(heat.clone()))
    }

    /// Returns the table of the own axis that it is, and the machine file has not.
    pub(crate) fn table(&self) -> Option<&Pitch> {
        let Self::Cause(effect) = self else { return None };
        effect.table()
    }

    /// Returns whether it is a wave of a period that is fitted.
    pub(crate) fn is_wave(&self) -> bool {
        self.cause().is_some_and(Effect::is_wave)
    }

    /// Returns whether it is a wave, over the position or the time.
    pub(crate) fn has_phase(&self) -> bool {
        self.cause().is_some_and(Effect::has_phase)
    }

    /// Returns whether it comes and goes with the clock: next to a law that is missing, it follows whatever drives
    /// that.
    pub(crate) fn is_by_the_clock(&self) -> bool {
        matches!(self.cause(), Some(Effect::PeriodicInTime(_)))
    }

    /// Returns whether it takes two recorded inputs together.
    pub(crate) fn is_composed(&self) -> bool {
        self.cause().is_some_and(Effect::is_composed)
    }

    /// Returns whether it is the error of the reference instrument.
    pub(crate) fn is_of_instrument(&self) -> bool {
        self.cause().is_some_and(|effect| effect.is_of_instrument())
    }

    /// Returns the cause that a form stands for, of an axis or (none) the elongation.
    pub(crate) fn of_form(
        own: Option<trueup_machine::file::LinearAxis>,
        form: &OnBoard,
    ) -> Option<Self> {
        Effect::from_board(own, form, &mut 0.0).map(Self::Cause)
    }

    /// Heat of a column by a path of its own, neutral.
    #[cfg(test)]
    pub(crate) fn heat_of(column: &str, has_lag: bool) -> Self {
        let time_constant_s = if has_lag { 1.0 } else { 0.0 };
        let column = column.to_string();
        let heat = Heat { column, um_per_c: 0.0, time_constant_s, reference_c: 0.0 };
        Self::of_form(None, &OnBoard::Heat(heat)).expect("a form of the board")
    }

    /// Returns the measurement that would settle what is open about it, against a rival where there is one.
    pub(crate) fn next_test(&self, rival: Option<&str>) -> &'static str {
        self.cause().map_or("Vary this column alone.", |effect| effect.next_test(rival))
    }

    /// Returns a measurement with what at the machine may be repaired in place of being corrected.
    pub(crate) fn with_repair(&self, next_test: String) -> String {
        match self.cause().and_then(|effect| effect.repair()) {
            Some(repair) => format!("{next_test} {repair}"),
            None => next_test,
        }
    }
}

impl Part {
    /// Returns a term of the machine file as it stands there.
    pub(crate) fn stated(stated: &Stated) -> Self {
        Self { values: stated.effect.values(), kind: Kind::Stated(stated.clone()) }
    }

    /// Returns the cause with its values.
    pub(crate) fn cause(&self) -> Option<Effect> {
        self.kind.cause().map(|effect| effect.with(&self.values))
    }

    /// Returns the cause in a sentence.
    pub(crate) fn sentence(&self) -> String {
        match &self.kind {
            Kind::Cause(effect) | Kind::Stated(Stated { effect, .. }) => {
                effect.sentence(&self.values)
            }
            Kind::Curve(curve) => format!("Something goes with {}.", curve.column),
        }
    }
}

/// Returns the thermal section of the quantity's own axis.
pub(crate) fn own_thermal(data: &Data) -> Option<&Thermal> {
    data.quantity.axis().and_then(|axis| data.machine.axes[axis.index()].thermal.as_ref())
}
