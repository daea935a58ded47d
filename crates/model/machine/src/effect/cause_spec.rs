//! The interface of a cause's page, a trait for each of its readers, and the types that it uses.
//!
//! | trait | is read by |
//! |---|---|
//! | [`FileRepresentation`] | reader and writer of files |
//! | [`PhysicalLaw`] | the model: where a cause acts, and what it adds |
//! | [`BoardRepresentation`] | compiler, export, and their inverse |
//! | [`Candidate`] | the search |
//! | [`Explanation`] | the report |
//!
//! ```text
//! machine file ─► read ─► a cause with its numbers ─► inputs, law ─► what it adds to the prediction
//!                                  │ on_board ▲                       (predict, diagnose, export)
//!                                  ▼          │ from_board
//!                            the board's form (compile, show)
//! ```
//!
//! A diagnosis works with the neutral value of a cause, which changes nothing, and with a list of
//! numbers next to it: first the [nonlinear](FitSpec::nonlinear) ones (a time constant, a period), then
//! amplitudes, which are 0 where there is no effect. [`Candidate::set_values`] puts the two together.

use trueup_core::term::SpeedExponent;

use super::data_view::{DataView, StartValues};
use crate::{
    keys::{key::Key, plausible_range::PlausibleRange, reader::Section, table::read_or_default},
    location::InputFileError,
    sections::{LinearAxis, PitchErrorTable, Spindle, ThermalLaw},
};

pub use super::board_term::{
    BoardTerm, DelayKind, Multiplier, SpeedHeatResponse, TemperatureResponse, ThermometerDelay,
    Tilt,
};
pub use super::nonlinear::NonlinearParameter;
pub use super::quantity::Quantity;
pub use crate::keys::section::Value;

/// A column that a law reads, one number a row. A missing one is NaN, and so is what follows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LawInput<'a> {
    /// The prediction so far, in µm.
    Predicted,
    /// The elongation by the machine file alone, in µm.
    Believed,
    /// The elongation by the source's own law, without terms, in µm.
    Law,
    /// The run's clock, in s.
    Time,
    /// The number of the repeat.
    Run,
    /// A temperature in °C, behind a first-order lag of this many seconds (0: none).
    Temperature {
        /// Its column, `temp_<name>_c`.
        column: &'a str,
        /// The lag's time constant, in s; at least 0.
        lag_s: f64,
    },
    /// The spindle's speed, in r/min.
    Speed,
    /// A power of the spindle's speed in 1000 r/min, behind a first-order lag that starts at 0.
    SpeedHeat {
        /// Which power.
        power: SpeedExponent,
        /// The lag's time constant, in s; at least 0.
        lag_s: f64,
    },
    /// The axial cutting force, in N; positive where it pushes the tool back.
    Load,
    /// The feed at which the position was approached, in mm/min; missing where the run does not say.
    Feed,
    /// The position of the quantity's own axis, in mm.
    OwnPosition,
    /// The direction in which it was approached: +1 or −1; a missing one is +1.
    OwnDirection,
    /// The position of an axis, in mm.
    Position(LinearAxis),
    /// Any other column of the run.
    Column(&'a str),
    /// Such a column behind a first-order lag.
    Lagged {
        /// Its name.
        column: &'a str,
        /// The lag's time constant, in s; above 0.
        lag_s: f64,
    },
}

/// When a cause acts, in the order in which a prediction is made.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum PredictionStage {
    /// It corrects a constant of the machine's own law.
    Constant,
    /// It gives a lag of the machine's own law another time constant while it falls.
    FallingTimeConstants,
    /// It multiplies the prediction.
    Factor,
    /// It bends the prediction.
    Bend,
    /// It limits the prediction.
    Limit,
    /// It is added, whatever the prediction is.
    Sum,
    /// It moves the whole prediction in time.
    Shift,
}

/// Whose error a cause can be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Target {
    /// The tool's growth.
    Elongation,
    /// An axis.
    Axis,
    /// One with a thermometer of its own: the axis if it has one, else the tool's growth.
    OwnThermometer,
    /// A warm one: the tool's growth where there is any, else the axis.
    Heat,
    /// Whatever is measured.
    Any,
}

/// A key of a `[[term]]` and what it is.
pub type TermEntry = (&'static str, Value);

/// A value of a finding, by its name in the table of causes.
#[derive(Clone, Debug, PartialEq)]
pub enum FindingParameter {
    /// A fitted value by its number, with what is to be added to it.
    Fitted(&'static str, usize, f64),
    /// A fixed value, and so certain.
    Fixed(&'static str, f64),
    /// A fitted time by its number, as sharp as its neighbours.
    Instant(&'static str, usize),
    /// `amplitude_um` and, under this name, the period of the largest of these harmonics.
    Waves(&'static str, Vec<u32>),
    /// All fitted values together.
    Record(&'static str, Vec<(&'static str, Option<Value>)>),
    /// A list that has no interval.
    Records(&'static str, Vec<Vec<TermEntry>>),
    /// A value that has no interval.
    Stated(&'static str, Value),
}

/// Heat that arrives by a path of its own.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HeatPath<'a> {
    /// The column of its temperature.
    pub column: &'a str,
    /// Whether the model goes by this column otherwise.
    pub is_second: bool,
    /// Whether it comes late.
    pub has_lag: bool,
}

/// The constants of the machine's own laws that a term may correct.
#[derive(Debug)]
pub struct ModelConstants<'a> {
    /// Of the tool's growth.
    pub spindle: Option<&'a mut Spindle>,
    /// Of the axis.
    pub thermal: Option<&'a mut ThermalLaw>,
    /// The time constant of the lag while it falls; `None`: as while it rises.
    pub falling_s: &'a mut Option<f64>,
}

/// The part of the machine's model that a term applies to.
#[derive(Clone, Copy, Debug)]
pub struct TermContext<'a> {
    /// The quantity that the term changes.
    pub quantity: Quantity,
    /// How the spindle grows.
    pub spindle: &'a Spindle,
    /// How the quantity's axis grows.
    pub thermal: Option<&'a ThermalLaw>,
}

impl TermContext<'_> {
    /// Returns whether the quantity follows a thermometer of its own.
    pub(crate) fn has_thermometer(&self) -> bool {
        match self.quantity.axis() {
            None => self.spindle.source == Some(crate::sections::ElongationSource::Temperature),
            Some(_) => self.thermal.is_some(),
        }
    }

    /// Why no constant of the axis's thermal law can be corrected, if none can.
    pub(crate) fn thermal_constant_rejection_reason(&self) -> Option<String> {
        match self.thermal {
            None => Some("needs [axis.*.thermal] of the quantity's axis".into()),
            Some(thermal) if thermal.table.is_some() => {
                Some("corrects a constant, and there is a table".into())
            }
            Some(_) => None,
        }
    }
}

/// What the search and the fit may do with a cause.
#[derive(Clone, Copy, Debug)]
pub struct FitSpec {
    /// How far away it is: 0 a constant of the model; 1 something else that was recorded; 2 time alone, the instrument.
    pub tier: u8,
    /// Its nonlinear values.
    pub nonlinear: &'static [NonlinearParameter],
    /// Range of its only nonlinear value, where the page itself knows it.
    pub nonlinear_parameter_bounds: Option<[f64; 2]>,
    /// How many amplitudes it has. A law without one adds its column unscaled.
    pub amplitudes: usize,
    /// What an amplitude may be; beyond that it is another machine's.
    pub amplitude_bounds: Option<[f64; 2]>,
    /// How many neighbours are in each of the lists that its values are, if they are.
    pub list_length: Option<usize>,
    /// Whether its reference (a temperature, a start) is its own, and with it a constant.
    pub has_reference: bool,
    /// Whether it is the error of the reference instrument.
    pub is_of_instrument: bool,
}

impl FitSpec {
    /// One amplitude, no nonlinear value.
    pub(crate) const DEFAULT: Self = Self {
        tier: 0,
        nonlinear: &[],
        nonlinear_parameter_bounds: None,
        amplitudes: 1,
        amplitude_bounds: None,
        list_length: None,
        has_reference: false,
        is_of_instrument: false,
    };
}

/// A cause in a machine file: what the reader and the writer of files use.
pub(crate) trait FileRepresentation: Sized {
    /// Its name in files: `thermal-lag`.
    const NAME: &'static str;

    /// Its keys, besides those that all have.
    fn keys(section: &Section<'_>) -> &'static [&'static str];

    /// Returns what stands in `section`, whose keys are known.
    fn read(section: &Section<'_>) -> Result<Self, InputFileError>;

    /// Its keys in a `[[term]]`.
    fn entries(&self) -> Vec<TermEntry>;

    /// Returns the range of the numbers of `key`, if it is another one here than the key's own.
    fn range_override(_key: &str) -> Option<PlausibleRange> {
        None
    }
}

/// The physics of a cause: what prediction and fit use.
pub trait PhysicalLaw {
    /// Whose error it can be.
    fn target(&self) -> Target;

    /// Why it cannot be a cause there, if it cannot: the rule, to be read after its name.
    fn refusal(&self, _host: &TermContext<'_>) -> Option<String> {
        None
    }

    /// When it acts.
    fn stage(&self) -> PredictionStage {
        PredictionStage::Sum
    }

    /// Returns the columns that its law reads, in its order.
    fn inputs<'a>(&'a self, _nonlinear: &[f64]) -> Vec<LawInput<'a>> {
        Vec::new()
    }

    /// The law: calls `add` with what each amplitude of 1 adds, in µm, where the inputs are `x`.
    fn add_unit_effects(&self, _nonlinear: &[f64], _x: &[f64], _add: &mut impl FnMut(usize, f64))
    where
        Self: Sized,
    {
    }

    /// Returns what these values add everywhere and [`set_values`](Candidate::set_values) has no key for, in µm.
    fn constant_um(&self, _values: &[f64]) -> f64 {
        0.0
    }

    /// Corrects the constants of the machine's own laws.
    fn correct_constants(&self, _constants: &mut ModelConstants<'_>) {}

    /// By how much the measurement comes later than the prediction, in s.
    fn time_shift_s(&self) -> f64 {
        0.0
    }

    /// Returns how late the thermometer of the machine's own law is.
    fn thermometer_delay(&self) -> Option<ThermometerDelay> {
        None
    }

    /// Returns the table of its own axis that it is.
    fn pitch_table(&self) -> Option<&PitchErrorTable> {
        None
    }
}

/// A cause in the numbers of the board: what the compiler and its inverse use.
pub trait BoardRepresentation {
    /// Returns whether the board corrects it; what happened once, or is the reference instrument's, is only explained.
    fn is_compensable(&self) -> bool {
        true
    }

    /// Returns what it is on the board, one form after the other; none where it corrects a constant of a law, or
    /// is not corrected.
    fn board_terms(&self) -> Vec<BoardTerm> {
        Vec::new()
    }

    /// Its temperature's part in the prediction, with the reference.
    fn temperature_response_mut(&mut self) -> Option<&mut TemperatureResponse> {
        None
    }

    /// Returns the cause that a form on the board is shown as, if it is this one; it may take the constant
    /// that comes with it.
    fn from_board(
        _own: Option<LinearAxis>,
        _form: &BoardTerm,
        _constant_um: &mut f64,
    ) -> Option<Self>
    where
        Self: Sized,
    {
        None
    }
}

/// A cause as a candidate: what the search uses.
pub trait Candidate {
    /// Returns what the search and the fit may do with it.
    fn fit_spec(&self) -> FitSpec {
        FitSpec::DEFAULT
    }

    /// Its values: nonlinear ones, then amplitudes. [`Candidate::set_values`] with them changes nothing.
    fn values(&self) -> Vec<f64>;

    /// Puts values, as many as there are, into the neutral one.
    fn set_values(&mut self, values: &[f64]);

    /// Returns the path by which it brings heat.
    fn heat_path(&self) -> Option<HeatPath<'_>> {
        None
    }

    /// Proposes what of it the data allow, neutral, with values to begin from.
    fn propose(_survey: &dyn DataView, _with: &mut dyn FnMut(Self, StartValues))
    where
        Self: Sized,
    {
    }
}

/// A cause in words: what a report uses.
pub trait Explanation {
    /// Returns what it means for a person at the machine, in a sentence.
    fn describe(&self, values: &[f64]) -> String;

    /// Returns the measurement that would settle it.
    fn next_test(&self) -> &'static str;

    /// Returns the measurement that would distinguish it from `rival`, a cause's name.
    fn distinguishing_test(_rival: &str) -> Option<&'static str>
    where
        Self: Sized,
    {
        None
    }

    /// Returns what at the machine may be repaired in place of being corrected.
    fn repair_advice(&self) -> Option<&'static str> {
        None
    }

    /// Returns the cause that would look the same where the position only grows with the time, if it is another than a
    /// drift: of a period of the position one of the time, and the other way round.
    fn periodic_rival_in_one_pass(&self) -> Option<&'static str> {
        None
    }

    /// Its values as a finding names them.
    fn parameters(&self, values: &[f64]) -> Vec<FindingParameter>;
}

/// A cause with its numbers, as all of its readers see it.
pub trait CauseSpec: PhysicalLaw + BoardRepresentation + Candidate + Explanation {
    /// Returns [`FitSpec::tier`].
    fn tier(&self) -> u8 {
        self.fit_spec().tier
    }

    /// Returns [`FitSpec::nonlinear`].
    fn nonlinear_parameters(&self) -> &'static [NonlinearParameter] {
        self.fit_spec().nonlinear
    }

    /// Returns [`FitSpec::nonlinear_parameter_bounds`].
    fn nonlinear_parameter_bounds(&self) -> Option<[f64; 2]> {
        self.fit_spec().nonlinear_parameter_bounds
    }

    /// Returns [`FitSpec::amplitudes`].
    fn amplitude_count(&self) -> usize {
        self.fit_spec().amplitudes
    }

    /// Returns [`FitSpec::amplitude_bounds`].
    fn amplitude_bounds(&self) -> Option<[f64; 2]> {
        self.fit_spec().amplitude_bounds
    }

    /// Returns [`FitSpec::list_length`].
    fn list_length(&self) -> Option<usize> {
        self.fit_spec().list_length
    }

    /// Returns [`FitSpec::has_reference`].
    fn has_reference(&self) -> bool {
        self.fit_spec().has_reference
    }

    /// Returns [`FitSpec::is_of_instrument`].
    fn is_instrument_error(&self) -> bool {
        self.fit_spec().is_of_instrument
    }
}

impl<T: PhysicalLaw + BoardRepresentation + Candidate + Explanation> CauseSpec for T {}

/// Returns a number that must be there.
pub(crate) fn required_number(section: &Section<'_>, key: Key) -> Result<f64, InputFileError> {
    section.required(key.name, section.number(key.name)?)
}

/// Returns a number above 0 that must be there.
pub(crate) fn required_positive_number(
    section: &Section<'_>,
    key: Key,
) -> Result<f64, InputFileError> {
    section.required(key.name, section.positive_number(key.name)?)
}

/// Returns an axis that must be there.
pub(crate) fn required_axis(section: &Section<'_>, key: Key) -> Result<LinearAxis, InputFileError> {
    read_or_default(section, &key.required())
}

/// Returns a time for people: 95 s, 12.3 min.
pub(crate) fn format_duration(seconds: f64) -> String {
    if seconds < 120.0 { format!("{seconds:.0} s") } else { format!("{:.1} min", seconds / 60.0) }
}
