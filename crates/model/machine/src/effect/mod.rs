//! Why a machine is not as its model says: a cause is one page.
//!
//! A page says all about its cause: what it is called, where it applies, its keys, the columns that
//! it needs, its law in `f64`, where a search for it begins, whether a correction may be built on it,
//! what it is on the board, and what it means to people. All others ask the page: reading, writing,
//! predicting, compiling, showing, diagnosing, exporting. A new cause is a page, or an entry in a table of
//! `scalar_cause`, and a line in the list below, with its `mod` line: `rustfmt` does not look into macros.
//!
//! | file | is |
//! |---|---|
//! | `cause_spec` | what a page answers |
//! | `scalar_cause` | the page of every cause that has one number, and the tables of these causes |
//! | `law` | its law over columns |
//! | `data_view` | what it requires of the data before it proposes itself |
//! | `heat`, `wave` | what several causes have in common |
//!
//! # Order of composition
//! A term changes the prediction p of one quantity. Terms act in the order of their [`PredictionStage`]s,
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
//! `sorted_by_stage` (`machine_file/term.rs`).

mod angular_error;
mod axis_expansion;
mod board_term;
mod category;
mod cause_spec;
mod cross_axis;
mod data_view;
mod dependence;
mod drift;
mod extra_heat_path;
mod feed_dependent_backlash;
mod law_evaluation;
mod nonlinear;
mod one_pass;
mod outliers;
mod periodic_in_time;
mod pitch_error;
mod pitch_periodic;
mod quantity;
mod range_limited;
mod reference_instrument;
mod scalar_cause;
mod sensor_temperature_drift;
mod slow_mode;
mod step;
mod straightness;
mod temperature_columns;
mod thermometer_lag;
mod wave;

use std::ops::{Deref, DerefMut};

pub use board_term::relative_heat_input;
pub use cause_spec::{
    BoardRepresentation, BoardTerm, Candidate, CauseSpec, DelayKind, Explanation, FindingParameter,
    FitSpec, HeatPath, LawInput, ModelConstants, Multiplier, NonlinearParameter, PhysicalLaw,
    PredictionStage, SpeedHeatResponse, Target, TemperatureResponse, TermContext, TermEntry,
    ThermometerDelay, Tilt, Value,
};
pub use data_view::{DataView, SpectrumVariable, StartValues, peak_to_peak};
pub use dependence::DependenceForm;
pub use law_evaluation::ColumnSource;
pub use periodic_in_time::{MIN_CYCLES, MIN_READINGS_PER_PERIOD};
pub use quantity::Quantity;
pub use range_limited::{BoundSide, RangeLimited};
pub use reference_instrument::WaveVariable;
pub use trueup_core::term::SpeedExponent;
pub use wave::Wave;

use crate::{
    keys::{plausible_range::PlausibleRange, reader::Section},
    location::InputFileError,
    sections::LinearAxis,
};
use cause_spec::FileRepresentation;

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
            RangeLimited(RangeLimited),
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

            /// Returns the range of the numbers of `key`, if it is another one of this cause than the key's own.
            pub(crate) fn range_override(self, key: &str) -> Option<PlausibleRange> {
                match self { $(Self::$CauseSpec => $CauseSpec::range_override(key),)* }
            }

            /// This cause as it stands in `section`, whose keys are known.
            pub(crate) fn read(self, section: &Section<'_>) -> Result<Effect, InputFileError> {
                Ok(match self { $(Self::$CauseSpec => Effect::$CauseSpec($CauseSpec::read(section)?),)* })
            }

            /// Returns the measurement that would distinguish it from `rival`.
            fn distinguishing_test(self, rival: &str) -> Option<&'static str> {
                match self { $(Self::$CauseSpec => $CauseSpec::distinguishing_test(rival),)* }
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
                    Self::RangeLimited(within) => within.effect.cause(),
                }
            }

            /// Returns its keys in a `[[term]]`.
            #[must_use]
            pub fn entries(&self) -> Vec<TermEntry> {
                match self {
                    $(Self::$CauseSpec(page) => page.entries(),)*
                    Self::RangeLimited(within) => within.entries(),
                }
            }

            /// Returns what each amplitude of 1 adds at these nonlinear values, in µm: a column an
            /// amplitude, or the only one where there is no amplitude.
            #[must_use]
            pub fn unit_effect_columns(&self, nonlinear: &[f64], source: &dyn ColumnSource) -> Vec<Vec<f64>> {
                match self {
                    $(Self::$CauseSpec(page) => law_evaluation::unit_effect_columns(page, nonlinear, source),)*
                    Self::RangeLimited(within) => within.unit_effect_columns(nonlinear, source),
                }
            }

            /// Returns what it adds with these values, in µm, row by row; an amplitude of 0 adds nothing, whatever its
            /// inputs are.
            #[must_use]
            pub fn sum_effects(&self, values: &[f64], source: &dyn ColumnSource) -> Vec<f64> {
                match self {
                    $(Self::$CauseSpec(page) => law_evaluation::sum_effects(page, values, source),)*
                    Self::RangeLimited(within) => within.sum_effects(values, source),
                }
            }

            /// Returns what it adds with these values where its inputs are `x`, in µm.
            #[must_use]
            pub fn evaluate_at(&self, values: &[f64], x: &[f64]) -> f64 {
                match self {
                    $(Self::$CauseSpec(page) => law_evaluation::evaluate_at(page, values, x),)*
                    Self::RangeLimited(within) => within.evaluate_at(values, x),
                }
            }

            /// Returns the cause that a form on the board is shown as, of an axis or (none) the elongation. It
            /// may take the constant that comes with the form.
            #[must_use]
            pub fn from_board(
                own: Option<LinearAxis>,
                form: &BoardTerm,
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
                match self { $(Self::$CauseSpec(page) => page,)* Self::RangeLimited(within) => within }
            }
        }

        impl DerefMut for Effect {
            fn deref_mut(&mut self) -> &mut (dyn CauseSpec + 'static) {
                match self { $(Self::$CauseSpec(page) => page,)* Self::RangeLimited(within) => within }
            }
        }
    };
}

causes! {
    scalar_cause::SensorOffset "The zero of the sensor is elsewhere.",
    scalar_cause::SensorGain "The sensor gives more or less for a micrometre.",
    scalar_cause::SensorCurvature "The sensor's characteristic is bent.",
    scalar_cause::SensorSaturation "The sensor's range ends.",
    sensor_temperature_drift::SensorTemperatureDrift "The sensor follows its own temperature.",
    scalar_cause::TimeShift "Two clocks differ.",
    thermometer_lag::ThermometerLag "The thermometer is late.",
    scalar_cause::ThermalLag "Growth follows its thermometer late.",
    slow_mode::SlowMode "A slow part of the growth.",
    extra_heat_path::ExtraHeatPath "Heat that the model does not know.",
    scalar_cause::GrowthAmplitude "It grows more or less than believed.",
    scalar_cause::GrowthRate "It grows faster or slower than believed.",
    scalar_cause::CoolingAsymmetry "It cools at another rate than it heats.",
    axis_expansion::AxisExpansion "The axis grows with a temperature, and the file has no law for it.",
    scalar_cause::ExpansionConstant "All of the axis shifts more or less than believed.",
    scalar_cause::ExpansionSlope "The axis expands more or less than believed.",
    scalar_cause::ReferenceTemperature "The axis is right at another temperature.",
    scalar_cause::CentrifugalGrowth "Speed itself stretches the spindle.",
    scalar_cause::CuttingLoad "The cut pushes the tool back.",
    scalar_cause::PitchScale "The scale or screw is long or short.",
    pitch_error::PitchError "The scale or screw is uneven.",
    pitch_periodic::PitchPeriodic "The error repeats with each turn or graduation.",
    scalar_cause::Backlash "The axis is left behind on reversal.",
    scalar_cause::PositionDependentBacklash "Backlash differs along the axis.",
    feed_dependent_backlash::FeedDependentBacklash "Backlash differs with the feed.",
    straightness::Straightness "The guide is not straight.",
    cross_axis::CrossAxis "Another axis, as it moves, tilts or shifts this one.",
    angular_error::AngularError "An axis tilts as it goes, and the tool is off by its lever.",
    dependence::Dependence "Something depends on a recorded input, by no law with a name.",
    step::Step "Something has slipped, once.",
    drift::Drift "It wanders with time.",
    periodic_in_time::PeriodicInTime "It is periodic in time.",
    outliers::Outliers "Some readings stand alone, far from the rest.",
    reference_instrument::ReferenceInstrument "The reference instrument errs.",
}

impl Cause {
    /// Returns the cause of this name.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
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
    pub fn with_values(&self, values: &[f64]) -> Self {
        let mut with = self.clone();
        with.set_values(values);
        with
    }

    /// All causes that the data allow, neutral, each with values to begin from.
    pub fn propose(survey: &dyn DataView, with: &mut dyn FnMut(Self, StartValues)) {
        Cause::ALL.iter().for_each(|cause| cause.propose(survey, with));
        range_limited::propose(survey, with);
    }

    /// Why it cannot be a cause there, if it cannot: the rule, with its name.
    pub(crate) fn rejection_reason(&self, host: &TermContext<'_>) -> Option<String> {
        let elsewhere = match (self.target(), host.quantity.axis()) {
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
    pub fn is_flexible(&self) -> bool {
        match self {
            Self::RangeLimited(_) => true,
            Self::Dependence(page) => page.is_flexible(),
            _ => false,
        }
    }

    /// Returns the cause without the range in which it acts.
    pub(crate) fn unrestricted_mut(&mut self) -> &mut Self {
        match self {
            Self::RangeLimited(within) => &mut within.effect,
            other => other,
        }
    }

    /// Returns the range in which alone it acts.
    #[must_use]
    pub fn as_range_limited(&self) -> Option<&RangeLimited> {
        if let Self::RangeLimited(within) = self { Some(within) } else { None }
    }

    /// Returns the column of the run that it depends on, if it is one.
    #[must_use]
    pub fn input_column(&self) -> Option<String> {
        let first = self.required_inputs().first().copied()?;
        match first {
            LawInput::Temperature { column, .. } => Some(column.into()),
            LawInput::Speed | LawInput::SpeedHeat { .. } => Some("spindle_rpm".into()),
            LawInput::Load => Some("load_n".into()),
            LawInput::Feed => Some(feed_dependent_backlash::FEED_COLUMN.into()),
            LawInput::Position(axis) => Some(axis.column_name()),
            LawInput::Column(column) | LawInput::Lagged { column, .. } => Some(column.into()),
            _ => None,
        }
    }

    /// Returns the columns that a run must have for it, but for directions.
    pub(crate) fn required_columns(&self, quantity: Quantity) -> Vec<String> {
        let position = |axis: LinearAxis| axis.column_name();
        let mut columns = Vec::new();
        for input in self.required_inputs() {
            match input {
                LawInput::Time => columns.push("time_s".into()),
                // A record that is of no run is of the middle one, and one that does not say its feed is at
                // that which is corrected.
                LawInput::Run | LawInput::Feed => {}
                LawInput::Temperature { column, lag_s } => {
                    columns.push(column.into());
                    columns.extend((lag_s != 0.0).then(|| "time_s".into()));
                }
                LawInput::Speed => columns.push("spindle_rpm".into()),
                LawInput::SpeedHeat { lag_s, .. } => {
                    columns.push("spindle_rpm".into());
                    columns.extend((lag_s != 0.0).then(|| "time_s".into()));
                }
                LawInput::Load => columns.push("load_n".into()),
                LawInput::OwnPosition => columns.extend(quantity.axis().map(position)),
                LawInput::Position(axis) => columns.push(position(axis)),
                LawInput::Column(column) => columns.push(column.into()),
                LawInput::Lagged { column, .. } => columns.extend([column.into(), "time_s".into()]),
                LawInput::Predicted
                | LawInput::Law
                | LawInput::Believed
                | LawInput::OwnDirection => {}
            }
        }
        columns
    }

    /// Returns the columns that its law reads with its own values.
    #[must_use]
    pub fn required_inputs(&self) -> Vec<LawInput<'_>> {
        let mut nonlinear = self.values();
        nonlinear.truncate(self.nonlinear_parameters().len());
        self.inputs(&nonlinear)
    }

    /// Returns the column of the temperature that it follows, if it does.
    #[must_use]
    pub fn temperature_column(&self) -> Option<String> {
        self.required_inputs().into_iter().find_map(|input| match input {
            LawInput::Temperature { column, .. } => Some(column.into()),
            _ => None,
        })
    }

    /// Returns how many values it has.
    #[must_use]
    pub fn parameter_count(&self) -> usize {
        self.nonlinear_parameters().len() + self.amplitude_count()
    }

    /// Returns whether its only amplitude adds the same wherever and whenever it is.
    #[must_use]
    pub fn is_constant(&self) -> bool {
        self.stage() == PredictionStage::Sum
            && self.amplitude_count() == 1
            && self.required_inputs().is_empty()
    }

    /// Returns whether it adds a function of its own axis's position and direction, and of nothing else.
    #[must_use]
    pub fn depends_on_own_axis_only(&self) -> bool {
        let inputs = self.required_inputs();
        let is_own =
            |input: &LawInput<'_>| matches!(input, LawInput::OwnPosition | LawInput::OwnDirection);
        self.target() == Target::Axis && !inputs.is_empty() && inputs.iter().all(is_own)
    }

    /// Returns whether it depends on the direction in which its own axis was approached.
    #[must_use]
    pub fn depends_on_direction(&self) -> bool {
        self.required_inputs().contains(&LawInput::OwnDirection)
    }

    /// Returns the part of it that a machine runs without the feed, which no control or board knows while it corrects:
    /// the width of one feed where it depends on the feed, else all of it.
    #[must_use]
    pub fn without_feed_dependence(&self) -> Self {
        if !self.required_inputs().contains(&LawInput::Feed) {
            return self.clone();
        }
        let forms = self.board_terms();
        let held = forms.iter().find_map(|form| Self::from_board(None, form, &mut 0.0));
        held.unwrap_or_else(|| self.clone())
    }

    /// Returns whether its law reads the clock.
    #[must_use]
    pub fn depends_on_time(&self) -> bool {
        self.required_inputs().contains(&LawInput::Time)
    }

    /// Returns whether it is looked for at a time that is searched, not fitted.
    #[must_use]
    pub fn has_instant(&self) -> bool {
        self.nonlinear_parameters().contains(&NonlinearParameter::Instant)
    }

    /// Returns whether it is a wave of a period that is fitted.
    #[must_use]
    pub fn has_spatial_period(&self) -> bool {
        self.nonlinear_parameters().contains(&NonlinearParameter::Period)
    }

    /// Returns whether its amplitudes are the sines and cosines of waves, whose sizes and phases are reported.
    #[must_use]
    pub fn has_phase(&self) -> bool {
        self.has_spatial_period()
            || self.nonlinear_parameters().contains(&NonlinearParameter::TimePeriod)
    }

    /// Returns whether its first value is a time constant.
    #[must_use]
    pub fn has_time_constant(&self) -> bool {
        let first = self.nonlinear_parameters().first();
        matches!(
            first,
            Some(NonlinearParameter::TimeConstant | NonlinearParameter::FallingTimeConstant)
        )
    }

    /// Returns the measurement that would settle it, against a rival's name where there is one.
    #[must_use]
    pub fn next_test(&self, alternative: Option<&str>) -> &'static str {
        // Of the two the later one in the list speaks first: it is farther away.
        let pair = alternative.and_then(Cause::from_name).and_then(|alternative| {
            let (a, b) = (self.cause().max(alternative), self.cause().min(alternative));
            a.distinguishing_test(b.name()).or_else(|| b.distinguishing_test(a.name()))
        });
        pair.unwrap_or_else(|| self.deref().next_test())
    }
}
