//! Why a machine is not as its model says: a cause is one page.
//!
//! A page says all about its cause: what it is called, where it applies, its keys, the columns that
//! it needs, its law in `f64`, where a search for it begins, whether a correction may be built on it,
//! what it is on the board, and what it means to people. All others ask the page: reading, writing,
//! predicting, compiling, showing, diagnosing, exporting. A new cause is a page, or an entry in a table of
//! `one_number`, and a line in the list below, with its `mod` line: `rustfmt` does not look into macros.
//!
//! | file | is |
//! |---|---|
//! | `cause_spec` | what a page answers |
//! | `one_number` | the page of every cause that has one number, and the tables of these causes |
//! | `law` | its law over columns |
//! | `data_view` | what it asks of the data before it proposes itself |
//! | `heat`, `wave` | what several causes have in common |
//!
//! # Order of composition
//! A term changes the prediction p of one quantity. Terms act in the order of their [`Stage`]s,
//! whatever their order in the file; of one stage in the order of the file:
//!
//! ```text
//! constants of the laws ─► the source's own law ─► factor, bend, limit ─► + what is added ─► shift in time
//! (lag, slope, rate, …)    (sensor, warm-up, T)    (gain, curvature,      (heat, load, …,
//!                                                   saturation)            constants)
//! ```
//!
//! So the causes of a sensor act on the sensor's law alone: a gain does not scale what speed, load or
//! heat add. Predicting, compiling and diagnosing have this order from
//! [`in_order`](crate::file::in_order).

mod angular_error;
mod axis_expansion;
mod category;
mod cause_spec;
mod cross_axis;
mod data_view;
mod dependence;
mod drift;
mod extra_heat_path;
mod feed_dependent_backlash;
mod forms;
mod heat;
mod law;
mod nonlinear;
mod one_number;
mod outliers;
mod periodic_in_time;
mod pitch_error;
mod pitch_periodic;
mod quantity;
mod reference_instrument;
mod sensor_temperature_drift;
mod slow_mode;
mod step;
mod straightness;
mod thermometer_lag;
mod wave;
mod within;

use std::ops::{Deref, DerefMut};

pub use cause_spec::{
    Angle, CauseSpec, Constants, Entry, Heat, HeatPath, Host, Input, Late, LateForm, Nonlinear,
    OnBoard, Parameter, SpeedHeat, Stage, Target, Tilt, Times, Value,
};
pub use data_view::{DataView, Reading, StartValues, spread};
pub use dependence::Form;
pub use forms::heating;
pub use law::Columns;
pub use periodic_in_time::MIN_GROUPS as MIN_GROUPS_IN_A_PERIOD;
pub use quantity::Quantity;
pub use reference_instrument::Read;
pub use trueup_core::term::SpeedPower;
pub use wave::Wave;
pub use within::{Side, Within};

use crate::{file::axis::LinearAxis, file::read::Section, location::BadInput};
use cause_spec::Definition;

macro_rules! causes {
    ($($module:ident::$CauseSpec:ident $text:literal,)*) => {
        $(pub use $module::$CauseSpec;)*

        /// A cause.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
        pub enum Cause {
            $(#[doc = $text] $CauseSpec,)*
        }

        /// A cause with its numbers.
        #[derive(Clone, Debug, PartialEq)]
        pub enum Effect {
            $(#[doc = $text] $CauseSpec($CauseSpec),)*
            /// A cause that acts only in a range of a recorded input.
            Within(Within),
        }

        impl Cause {
            /// All causes, in the order of the format's table.
            pub const ALL: &[Self] = &[$(Self::$CauseSpec,)*];

            /// Its name in files: `thermal-lag`.
            #[must_use]
            pub fn name(self) -> &'static str {
                match self { $(Self::$CauseSpec => $CauseSpec::NAME,)* }
            }

            /// Returns the keys of this cause in `section`, besides those that all have.
            pub(crate) fn keys(self, section: &Section<'_>) -> &'static [&'static str] {
                match self { $(Self::$CauseSpec => $CauseSpec::keys(section),)* }
            }

            /// This cause as it stands in `section`, whose keys are known.
            pub(crate) fn read(self, section: &Section<'_>) -> Result<Effect, BadInput> {
                Ok(match self { $(Self::$CauseSpec => Effect::$CauseSpec($CauseSpec::read(section)?),)* })
            }

            /// Returns the measurement that would distinguish it from `rival`.
            fn against(self, rival: &str) -> Option<&'static str> {
                match self { $(Self::$CauseSpec => $CauseSpec::against(rival),)* }
            }

            /// Proposes what of it the data allow.
            fn propose(self, survey: &dyn DataView, with: &mut dyn FnMut(Effect, StartValues)) {
                match self {
                    $(Self::$CauseSpec => {
                        $CauseSpec::propose(survey, &mut |page, at| with(Effect::$CauseSpec(page), at));
                    })*
                }
            }
        }

        impl Effect {
            /// Returns the cause that it belongs to.
            #[must_use]
            pub fn cause(&self) -> Cause {
                match self {
                    $(Self::$CauseSpec(_) => Cause::$CauseSpec,)*
                    Self::Within(within) => within.effect.cause(),
                }
            }

            /// Returns what each amplitude of 1 adds at these nonlinear values, in µm: a column an
            /// amplitude, or the only one where there is no amplitude.
            #[must_use]
            pub fn columns(&self, nonlinear: &[f64], source: &dyn Columns) -> Vec<Vec<f64>> {
                match self {
                    $(Self::$CauseSpec(page) => law::columns(page, nonlinear, source),)*
                    Self::Within(within) => within.columns(nonlinear, source),
                }
            }

            /// Returns what it adds with these values, in µm, row by row; an amplitude of 0 adds nothing, whatever its
            /// inputs are.
            #[must_use]
            pub fn sum(&self, values: &[f64], source: &dyn Columns) -> Vec<f64> {
                match self {
                    $(Self::$CauseSpec(page) => law::sum(page, values, source),)*
                    Self::Within(within) => within.sum(values, source),
                }
            }

            /// Returns what it adds with these values where its inputs are `x`, in µm.
            #[must_use]
            pub fn at_row(&self, values: &[f64], x: &[f64]) -> f64 {
                match self {
                    $(Self::$CauseSpec(page) => law::at_row(page, values, x),)*
                    Self::Within(within) => within.at_row(values, x),
                }
            }

            /// Returns the cause that a form on the board is shown as, of an axis or (none) the elongation. It
            /// may take the constant that comes with the form.
            #[must_use]
            pub fn from_board(
                own: Option<LinearAxis>,
                form: &OnBoard,
                constant_um: &mut f64,
            ) -> Option<Self> {
                $(if let Some(page) = $CauseSpec::from_board(own, form, constant_um) {
                    return Some(Self::$CauseSpec(page));
                })*
                None
            }
        }

        impl Deref for Effect {
            type Target = dyn CauseSpec;

            fn deref(&self) -> &(dyn CauseSpec + 'static) {
                match self { $(Self::$CauseSpec(page) => page,)* Self::Within(within) => within }
            }
        }

        impl DerefMut for Effect {
            fn deref_mut(&mut self) -> &mut (dyn CauseSpec + 'static) {
                match self { $(Self::$CauseSpec(page) => page,)* Self::Within(within) => within }
            }
        }
    };
}

causes! {
    one_number::SensorOffset "The zero of the sensor is elsewhere.",
    one_number::SensorGain "The sensor gives more or less for a micrometre.",
    one_number::SensorCurvature "The sensor's characteristic is bent.",
    one_number::SensorSaturation "The sensor's range ends.",
    sensor_temperature_drift::SensorTemperatureDrift "The sensor follows its own temperature.",
    one_number::TimeShift "Two clocks differ.",
    thermometer_lag::ThermometerLag "The thermometer is late.",
    one_number::ThermalLag "Growth follows its thermometer late.",
    slow_mode::SlowMode "A slow part of the growth.",
    extra_heat_path::ExtraHeatPath "Heat that the model does not know.",
    one_number::GrowthAmplitude "It grows more or less than believed.",
    one_number::GrowthRate "It grows faster or slower than believed.",
    one_number::CoolingAsymmetry "It cools at another rate than it heats.",
    axis_expansion::AxisExpansion "The axis grows with a temperature, and the file has no law for it.",
    one_number::ExpansionConstant "All of the axis shifts more or less than believed.",
    one_number::ExpansionSlope "The axis expands more or less than believed.",
    one_number::ReferenceTemperature "The axis is right at another temperature.",
    one_number::CentrifugalGrowth "Speed itself stretches the spindle.",
    one_number::CuttingLoad "The cut pushes the tool back.",
    one_number::PitchScale "The scale or screw is long or short.",
    pitch_error::PitchError "The scale or screw is uneven.",
    pitch_periodic::PitchPeriodic "The error repeats with each turn or graduation.",
    one_number::Backlash "The axis is left behind on reversal.",
    one_number::PositionDependentBacklash "Backlash differs along the axis.",
    feed_dependent_backlash::FeedDependentBacklash "Backlash differs with the feed.",
    straightness::Straightness "The guide is not straight.",
    cross_axis::CrossAxis "Another axis, as it moves, tilts or shifts this one.",
    angular_error::AngularError "An axis tilts as it goes, and the tool is off by its lever.",
    dependence::Dependence "Something depends on a recorded input, by no law with a name.",
    step::Step "Something has slipped, once.",
    drift::Drift "It wanders with time.",
    periodic_in_time::PeriodicInTime "It comes and goes with the clock.",
    outliers::Outliers "Some readings stand alone, far from the rest.",
    reference_instrument::ReferenceInstrument "The reference instrument errs.",
}

impl Cause {
    /// Returns the cause of this name.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.iter().copied().find(|cause| cause.name() == name)
    }
}

impl Effect {
    /// Its name in files.
    #[must_use]
    pub fn name(&self) -> &'static str {
        self.cause().name()
    }

    /// It with these values in place of the neutral ones.
    #[must_use]
    pub fn with(&self, values: &[f64]) -> Self {
        let mut with = self.clone();
        with.set(values);
        with
    }

    /// All causes that the data allow, neutral, each with values to begin from.
    pub fn propose(survey: &dyn DataView, with: &mut dyn FnMut(Self, StartValues)) {
        Cause::ALL.iter().for_each(|cause| cause.propose(survey, with));
        within::propose(survey, with);
    }

    /// Why it cannot be a cause there, if it cannot: the rule, with its name.
    pub(crate) fn refused(&self, host: &Host<'_>) -> Option<String> {
        let elsewhere = match (self.home(), host.quantity.axis()) {
            (Target::Axis, None) => Some("belongs to dx, dy or dz"),
            (Target::Elongation, Some(_)) => Some("belongs to the elongation"),
            _ => None,
        };
        let rule = self.refusal(host).or(elsewhere.map(String::from))?;
        Some(format!("\"{}\" {rule}", self.name()))
    }

    /// Returns whether it takes two recorded inputs together (the difference of two, a range of one), or bends or lags
    /// behind one so that it imitates other laws.
    #[must_use]
    pub fn is_composed(&self) -> bool {
        match self {
            Self::Within(_) => true,
            Self::Dependence(page) => page.is_composed(),
            _ => false,
        }
    }

    /// Returns the cause without the range in which it acts.
    pub(crate) fn everywhere_mut(&mut self) -> &mut Self {
        match self {
            Self::Within(within) => &mut within.effect,
            other => other,
        }
    }

    /// Returns the range in which alone it acts.
    #[must_use]
    pub fn within(&self) -> Option<&Within> {
        if let Self::Within(within) = self { Some(within) } else { None }
    }

    /// Returns the column of the run that it hangs on, if it is one.
    #[must_use]
    pub fn column(&self) -> Option<String> {
        let first = self.reads().first().copied()?;
        match first {
            Input::Temperature { column, .. } => Some(column.into()),
            Input::Speed | Input::SpeedHeat { .. } => Some("spindle_rpm".into()),
            Input::Load => Some("load_n".into()),
            Input::Feed => Some(feed_dependent_backlash::FEED.into()),
            Input::Position(axis) => Some(format!("{}_mm", axis.name())),
            Input::Column(column) | Input::Lagged { column, .. } => Some(column.into()),
            _ => None,
        }
    }

    /// Returns the columns that a run must have for it, but for directions.
    pub(crate) fn needed_columns(&self, quantity: Quantity) -> Vec<String> {
        let position = |axis: LinearAxis| format!("{}_mm", axis.name());
        let mut columns = Vec::new();
        for input in self.reads() {
            match input {
                Input::Time => columns.push("time_s".into()),
                // A record that is of no run is of the middle one, and one that does not say its feed is at
                // that which is corrected.
                Input::Run | Input::Feed => {}
                Input::Temperature { column, lag_s } => {
                    columns.push(column.into());
                    columns.extend((lag_s != 0.0).then(|| "time_s".into()));
                }
                Input::Speed => columns.push("spindle_rpm".into()),
                Input::SpeedHeat { lag_s, .. } => {
                    columns.push("spindle_rpm".into());
                    columns.extend((lag_s != 0.0).then(|| "time_s".into()));
                }
                Input::Load => columns.push("load_n".into()),
                Input::OwnPosition => columns.extend(quantity.axis().map(position)),
                Input::Position(axis) => columns.push(position(axis)),
                Input::Column(column) => columns.push(column.into()),
                Input::Lagged { column, .. } => columns.extend([column.into(), "time_s".into()]),
                Input::Predicted | Input::Law | Input::Believed | Input::OwnDirection => {}
            }
        }
        columns
    }

    /// Returns the columns that its law reads with its own values.
    #[must_use]
    pub fn reads(&self) -> Vec<Input<'_>> {
        let mut nonlinear = self.values();
        nonlinear.truncate(self.nonlinear().len());
        self.inputs(&nonlinear)
    }

    /// Returns the column of the temperature that it follows, if it does.
    #[must_use]
    pub fn temperature(&self) -> Option<String> {
        self.reads().into_iter().find_map(|input| match input {
            Input::Temperature { column, .. } => Some(column.into()),
            _ => None,
        })
    }

    /// Returns how many values it has.
    #[must_use]
    pub fn degrees(&self) -> usize {
        self.nonlinear().len() + self.amplitudes()
    }

    /// Returns whether its only amplitude adds the same wherever and whenever it is.
    #[must_use]
    pub fn is_constant(&self) -> bool {
        self.stage() == Stage::Sum && self.amplitudes() == 1 && self.reads().is_empty()
    }

    /// Returns whether it adds a function of its own axis's position and direction, and of nothing else.
    #[must_use]
    pub fn is_along_own_axis(&self) -> bool {
        let inputs = self.reads();
        let is_own = |input: &Input<'_>| matches!(input, Input::OwnPosition | Input::OwnDirection);
        self.home() == Target::Axis && !inputs.is_empty() && inputs.iter().all(is_own)
    }

    /// Returns whether it goes with the direction in which its own axis was approached.
    #[must_use]
    pub fn is_by_direction(&self) -> bool {
        self.reads().contains(&Input::OwnDirection)
    }

    /// Returns the part of it that a machine runs without the feed, which no control or board knows while it corrects:
    /// the width of one feed where it goes with the feed, else all of it.
    #[must_use]
    pub fn without_feed(&self) -> Self {
        if !self.reads().contains(&Input::Feed) {
            return self.clone();
        }
        let forms = self.on_board();
        let held = forms.iter().find_map(|form| Self::from_board(None, form, &mut 0.0));
        held.unwrap_or_else(|| self.clone())
    }

    /// Returns whether its law reads the clock.
    #[must_use]
    pub fn is_in_time(&self) -> bool {
        self.reads().contains(&Input::Time)
    }

    /// Returns whether it is looked for at a time that is searched, not fitted.
    #[must_use]
    pub fn has_instant(&self) -> bool {
        self.nonlinear().contains(&Nonlinear::Instant)
    }

    /// Returns whether it is a wave of a period that is fitted.
    #[must_use]
    pub fn is_wave(&self) -> bool {
        self.nonlinear().contains(&Nonlinear::Period)
    }

    /// Returns whether its amplitudes are the sines and cosines of waves, whose sizes and phases are reported.
    #[must_use]
    pub fn has_phase(&self) -> bool {
        self.is_wave() || self.nonlinear().contains(&Nonlinear::TimePeriod)
    }

    /// Returns whether its first value is a time constant.
    #[must_use]
    pub fn has_time_constant(&self) -> bool {
        let first = self.nonlinear().first();
        matches!(first, Some(Nonlinear::TimeConstant | Nonlinear::FallingTimeConstant))
    }

    /// Returns the measurement that would settle it, against a rival's name where there is one.
    #[must_use]
    pub fn next_test(&self, rival: Option<&str>) -> &'static str {
        // Of the two the later one in the list speaks first: it is farther away.
        let pair = rival.and_then(Cause::named).and_then(|rival| {
            let (a, b) = (self.cause().max(rival), self.cause().min(rival));
            a.against(b.name()).or_else(|| b.against(a.name()))
        });
        pair.unwrap_or_else(|| self.deref().next_test())
    }
}
