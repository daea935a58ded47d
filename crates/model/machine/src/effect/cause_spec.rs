//! The interface of a cause's page, and the types that it uses.
//!
//! ```text
//! machine file ─► read ─► a cause with its numbers ─► inputs, law ─► what it adds to the prediction
//!                                  │ on_board ▲                       (predict, diagnose, export)
//!                                  ▼          │ from_board
//!                            the board's form (compile, show)
//! ```
//!
//! A diagnosis works with the neutral value of a cause, which changes nothing, and with a list of
//! numbers next to it: first the [nonlinear](CauseSpec::nonlinear) ones (a time constant, a period), then
//! amplitudes, which are 0 where there is no effect. [`CauseSpec::set`] puts the two together.

use trueup_core::term::SpeedPower;

use super::data_view::{DataView, StartValues};
use crate::{
    file::read::Section,
    file::{
        axis::{LinearAxis, Pitch, Thermal},
        key::Key,
        spindle::Spindle,
        straightness::BSpline,
        table::value,
    },
    location::BadInput,
};

pub use super::forms::{Angle, Heat, Late, LateForm, SpeedHeat, Tilt, Times};
pub use super::nonlinear::Nonlinear;
pub use super::quantity::Quantity;
pub use crate::file::write::section::Value;

/// A column that a law reads, one number a row. A missing one is NaN, and so is what follows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Input<'a> {
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
        power: SpeedPower,
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
pub enum Stage {
    /// It corrects a constant of the machine's own law.
    Constant,
    /// It gives a lag of the machine's own law another time constant while it falls.
    Falling,
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
pub type Entry = (&'static str, Value);

/// A value of a finding, by its name in the table of causes.
#[derive(Clone, Debug, PartialEq)]
pub enum Parameter {
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
    Records(&'static str, Vec<Vec<Entry>>),
    /// A value that has no interval.
    Said(&'static str, Value),
}

/// The board's forms in the user's units: what a term is compiled to.
#[derive(Clone, Debug, PartialEq)]
pub enum OnBoard {
    /// + µm.
    Offset(f64),
    /// g·p.
    Gain(f64),
    /// + c·p², c in 1/µm.
    Curvature(f64),
    /// At most this many µm.
    Saturation(f64),
    /// + c·(lag_τ(T) − T_ref).
    Heat(Heat),
    /// + c·(lag_τ(T) − T_ref)·P/1000, P of the own axis, c in µm/(m·K).
    HeatSlope(Heat),
    /// + c·lag_τ((n/1000)^power).
    SpeedHeat(SpeedHeat),
    /// + a·(1 − e^(−(t − start)/τ)); 0 before the start.
    Time {
        /// a.
        amplitude_um: f64,
        /// τ, above 0.
        time_constant_s: f64,
        /// In the run's `time_s`; the board's own start where it runs.
        start_s: f64,
    },
    /// + c·(n/1000)², c in µm.
    Speed(f64),
    /// + c·load, c in µm/N.
    Load(f64),
    /// + c·P/1000, P of the own axis, c in µm/m.
    OwnPosition(f64),
    /// + c·P/1000, P of another axis.
    Position {
        /// Of P.
        axis: LinearAxis,
        /// c.
        um_per_m: f64,
    },
    /// + w + c·P/1000 after an approach in the negative direction, P of the own axis.
    Reversed {
        /// w.
        width_um: f64,
        /// c.
        um_per_m: f64,
    },
    /// A table of the own axis.
    Table(Pitch),
    /// A spline over an axis.
    Curve(LinearAxis, BSpline),
    /// The thermal law of the own axis, where it has none.
    Thermal(Thermal),
    /// + θ(P)·(L − L₀)/1000.
    Tilt(Tilt),
    /// + a·sin(2π·h·P/L + φ), P of the own axis.
    Wave {
        /// L, above 0.
        period_mm: f64,
        /// h, at least 1.
        harmonic: u32,
        /// a.
        amplitude_um: f64,
        /// φ.
        phase_deg: f64,
    },
    /// + a·f, a by the number of the tool.
    Tool {
        /// The tools with their a, no number twice.
        tools: Vec<(u16, f64)>,
        /// a of every other tool.
        other: f64,
        /// f.
        times: Times,
    },
    /// + a·f, a by a condition.
    Condition {
        /// The column of the condition.
        column: String,
        /// a while it does not hold.
        off: f64,
        /// a while it holds.
        on: f64,
        /// The time constant by which it acts, in s.
        lag_s: f64,
        /// f.
        times: Times,
    },
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
pub struct Constants<'a> {
    /// Of the tool's growth.
    pub spindle: Option<&'a mut Spindle>,
    /// Of the axis.
    pub thermal: Option<&'a mut Thermal>,
    /// The time constant of the lag while it falls; `None`: as while it rises.
    pub falling_s: &'a mut Option<f64>,
}

/// The part of the machine's model that a term applies to.
#[derive(Clone, Copy, Debug)]
pub struct Host<'a> {
    /// The quantity that the term changes.
    pub quantity: Quantity,
    /// How the spindle grows.
    pub spindle: &'a Spindle,
    /// How the quantity's axis grows.
    pub thermal: Option<&'a Thermal>,
}

impl Host<'_> {
    /// Returns whether the quantity follows a thermometer of its own.
    pub(crate) fn has_thermometer(&self) -> bool {
        match self.quantity.axis() {
            None => {
                self.spindle.source == Some(crate::file::spindle::ElongationSource::Temperature)
            }
            Some(_) => self.thermal.is_some(),
        }
    }

    /// Why no constant of the axis's thermal law can be corrected, if none can.
    pub(crate) fn refuses_thermal_constant(&self) -> Option<String> {
        match self.thermal {
            None => Some("needs [axis.*.thermal] of the quantity's axis".into()),
            Some(thermal) if thermal.table.is_some() => {
                Some("corrects a constant, and there is a table".into())
            }
            Some(_) => None,
        }
    }
}

/// The properties of a cause with its numbers.
pub trait CauseSpec {
    /// Its keys in a `[[term]]`.
    fn entries(&self) -> Vec<Entry>;

    /// Whose error it can be.
    fn home(&self) -> Target;

    /// Why it cannot be a cause there, if it cannot: the rule, to be read after its name.
    fn refusal(&self, _host: &Host<'_>) -> Option<String> {
        None
    }

    /// When it acts.
    fn stage(&self) -> Stage {
        Stage::Sum
    }

    /// Returns whether the board corrects it; what happened once, or is the reference instrument's, is only explained.
    fn is_compensated(&self) -> bool {
        true
    }

    /// Returns how far away it is: 0 a constant of the model; 1 something else that was recorded; 2 time alone, the
    /// instrument.
    fn tier(&self) -> u8 {
        0
    }

    /// Returns the columns that its law reads, in its order.
    fn inputs<'a>(&'a self, _nonlinear: &[f64]) -> Vec<Input<'a>> {
        Vec::new()
    }

    /// Its nonlinear values.
    fn nonlinear(&self) -> &'static [Nonlinear] {
        &[]
    }

    /// Range of its only nonlinear value, where the page itself knows it.
    fn nonlinear_limits(&self) -> Option<[f64; 2]> {
        None
    }

    /// Returns how many amplitudes it has. A law without one adds its column as it is.
    fn amplitudes(&self) -> usize {
        1
    }

    /// Returns what an amplitude may be; beyond that it is another machine's.
    fn amplitude_limits(&self) -> Option<[f64; 2]> {
        None
    }

    /// Returns how many neighbours are in each of the lists that its values are, if they are.
    fn list_length(&self) -> Option<usize> {
        None
    }

    /// Its values: nonlinear ones, then amplitudes. [`CauseSpec::set`] with them changes nothing.
    fn values(&self) -> Vec<f64>;

    /// Puts values, as many as there are, into the neutral one.
    fn set(&mut self, values: &[f64]);

    /// Returns what these values add everywhere and [`set`](Self::set) has no key for, in µm.
    fn constant_um(&self, _values: &[f64]) -> f64 {
        0.0
    }

    /// Corrects the constants of the machine's own laws.
    fn correct(&self, _constants: &mut Constants<'_>) {}

    /// By how much the measurement comes later than the prediction, in s.
    fn shift_s(&self) -> f64 {
        0.0
    }

    /// Returns how late the thermometer of the machine's own law is.
    fn late(&self) -> Option<Late> {
        None
    }

    /// Returns what it is on the board, one form after the other; none where it corrects a constant of a law, or
    /// is not corrected.
    fn on_board(&self) -> Vec<OnBoard> {
        Vec::new()
    }

    /// Returns whether its reference (a temperature, a start) is its own, and with it a constant.
    fn has_reference(&self) -> bool {
        false
    }

    /// Its temperature's part in the prediction, with the reference.
    fn heat_mut(&mut self) -> Option<&mut Heat> {
        None
    }

    /// Returns the path by which it brings heat.
    fn heat_path(&self) -> Option<HeatPath<'_>> {
        None
    }

    /// Returns the table of its own axis that it is.
    fn table(&self) -> Option<&Pitch> {
        None
    }

    /// Returns whether it is the error of the reference instrument.
    fn is_of_instrument(&self) -> bool {
        false
    }

    /// Returns what it means for a person at the machine, in a sentence.
    fn sentence(&self, values: &[f64]) -> String;

    /// Returns the measurement that would settle it.
    fn next_test(&self) -> &'static str;

    /// Returns what at the machine may be repaired in place of being corrected.
    fn repair(&self) -> Option<&'static str> {
        None
    }

    /// Returns the cause that would look the same where the position only grows with the time: of one over the position
    /// one over the time, and the other way round.
    fn same_in_one_pass(&self) -> Option<&'static str> {
        None
    }

    /// Its values as a finding names them.
    fn parameters(&self, values: &[f64]) -> Vec<Parameter>;
}

/// The properties of a cause as such.
pub(crate) trait Definition: CauseSpec + Sized {
    /// Its name in files: `thermal-lag`.
    const NAME: &'static str;

    /// Its keys, besides those that all have.
    fn keys(section: &Section<'_>) -> &'static [&'static str];

    /// Returns what stands in `section`, whose keys are known.
    fn read(section: &Section<'_>) -> Result<Self, BadInput>;

    /// The law: calls `add` with what each amplitude of 1 adds, in µm, where the inputs are `x`.
    fn law(&self, _nonlinear: &[f64], _x: &[f64], _add: &mut impl FnMut(usize, f64)) {}

    /// Returns the cause that a form on the board is shown as, if it is this one; it may take the constant
    /// that comes with it.
    fn from_board(
        _own: Option<LinearAxis>,
        _form: &OnBoard,
        _constant_um: &mut f64,
    ) -> Option<Self> {
        None
    }

    /// Proposes what of it the data allow, neutral, with values to begin from.
    fn propose(_survey: &dyn DataView, _with: &mut dyn FnMut(Self, StartValues)) {}

    /// Returns the measurement that would distinguish it from `rival`, a cause's name.
    fn against(_rival: &str) -> Option<&'static str> {
        None
    }
}

/// Returns a number that must be there.
pub(crate) fn number(section: &Section<'_>, key: Key) -> Result<f64, BadInput> {
    section.required(key.name, section.number(key.name)?)
}

/// Returns a number above 0 that must be there.
pub(crate) fn positive(section: &Section<'_>, key: Key) -> Result<f64, BadInput> {
    section.required(key.name, section.positive(key.name)?)
}

/// Returns an axis that must be there.
pub(crate) fn axis(section: &Section<'_>, key: Key) -> Result<LinearAxis, BadInput> {
    value(section, &key.required())
}

/// Returns a time for people: 95 s, 12.3 min.
pub(crate) fn minutes(seconds: f64) -> String {
    if seconds < 120.0 { format!("{seconds:.0} s") } else { format!("{:.1} min", seconds / 60.0) }
}
