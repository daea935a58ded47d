//! The page of every cause that has one number: what differs from cause to cause is an entry of a table.
//!
//! | table | holds |
//! |---|---|
//! | `sensor` | errors of the displacement sensor, and what speed and load add to the growth |
//! | `heat` | constants of the machine's own thermal laws |
//! | `axis` | errors of an axis over its position and direction, and of the clock |

mod axis;
mod heat;
mod sensor;

pub use axis::{Backlash, PitchScale, PositionDependentBacklash, TimeShift};
pub use heat::{
    CoolingAsymmetry, ExpansionConstant, ExpansionSlope, GrowthAmplitude, GrowthRate,
    ReferenceTemperature, ThermalLag,
};
pub use sensor::{
    CentrifugalGrowth, CuttingLoad, SensorCurvature, SensorGain, SensorOffset, SensorSaturation,
};

use super::{
    cause_spec::{
        CauseSpec, Constants, Definition, Entry, Host, Input, Nonlinear, OnBoard, Parameter, Stage,
        Target, Value, number, positive,
    },
    data_view::{DataView, StartValues},
};
use crate::{
    file::{axis::LinearAxis, key::Key, read::Section},
    location::BadInput,
};

/// The value of the number that changes nothing.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Neutral {
    /// This one.
    At(f64),
    /// That of the machine's own law.
    Believed,
}

/// Effect of an amplitude of 1, at these nonlinear values and inputs.
type Law = fn(&[f64], &[f64]) -> f64;

/// A cause with one number. Its functions get that number, or the value that is fitted.
struct OneNumber {
    name: &'static str,
    home: Target,
    stage: Stage,
    tier: u8,
    is_compensated: bool,
    neutral: Neutral,
    /// Whether the number in a file must be above 0.
    is_positive: bool,
    inputs: &'static [Input<'static>],
    /// The kind of the number; none: it is an amplitude.
    nonlinear: &'static [Nonlinear],
    amplitude_limits: Option<[f64; 2]>,
    /// None: an amplitude adds nothing by itself.
    law: Option<Law>,
    refusal: fn(&Host<'_>) -> Option<String>,
    correct: fn(f64, &mut Constants<'_>),
    on_board: fn(f64) -> Vec<OnBoard>,
    from_board: fn(Option<LinearAxis>, &OnBoard, &mut f64) -> Option<f64>,
    /// The neutral number and where the search begins; none where the data do not allow the cause.
    propose: fn(&dyn DataView) -> Option<(f64, StartValues)>,
    sentence: fn(f64) -> String,
    next_test: &'static str,
    /// The measurements that distinguish it from others, by their names.
    against: &'static [(&'static str, &'static str)],
    repair: Option<&'static str>,
    same_in_one_pass: Option<&'static str>,
}

impl OneNumber {
    /// The entries of most causes.
    const USUAL: Self = Self {
        name: "",
        home: Target::Any,
        stage: Stage::Sum,
        tier: 0,
        is_compensated: true,
        neutral: Neutral::At(0.0),
        is_positive: false,
        inputs: &[],
        nonlinear: &[],
        amplitude_limits: None,
        law: None,
        refusal: |_| None,
        correct: |_, _| {},
        on_board: |_| Vec::new(),
        from_board: |_, _, _| None,
        propose: |_| None,
        sentence: |_| String::new(),
        next_test: "",
        against: &[],
        repair: None,
        same_in_one_pass: None,
    };
}

/// A cause with one number, as its table declares it.
trait Declared {
    const IT: OneNumber;
}

/// A struct with the number of a cause.
trait Single: Declared + Sized {
    const KEY: Key;
    const NAMES: &'static [&'static str];

    fn number(&self) -> f64;

    fn of(number: f64) -> Self;
}

/// Declares the struct of a cause with its number, and the number's key in the file.
macro_rules! one_number {
    ($(#[$attribute:meta])* $Name:ident { $(#[$doc:meta])* $key:ident = $KEY:ident }) => {
        $(#[$attribute])*
        #[derive(Clone, Debug, PartialEq)]
        pub struct $Name {
            $(#[$doc])*
            pub $key: f64,
        }

        impl Default for $Name {
            fn default() -> Self {
                match <Self as $crate::effect::one_number::Declared>::IT.neutral {
                    $crate::effect::one_number::Neutral::At($key) => Self { $key },
                    $crate::effect::one_number::Neutral::Believed => Self { $key: 0.0 },
                }
            }
        }

        impl $crate::effect::one_number::Single for $Name {
            const KEY: $crate::file::key::Key = $crate::file::keys::term::$KEY;
            const NAMES: &'static [&'static str] = &[Self::KEY.name];

            fn number(&self) -> f64 {
                self.$key
            }

            fn of($key: f64) -> Self {
                Self { $key }
            }
        }
    };
}

use one_number;

impl<T: Single> CauseSpec for T {
    fn entries(&self) -> Vec<Entry> {
        vec![(T::KEY.name, Value::Number(self.number()))]
    }

    fn home(&self) -> Target {
        T::IT.home
    }

    fn refusal(&self, host: &Host<'_>) -> Option<String> {
        (T::IT.refusal)(host)
    }

    fn stage(&self) -> Stage {
        T::IT.stage
    }

    fn is_compensated(&self) -> bool {
        T::IT.is_compensated
    }

    fn tier(&self) -> u8 {
        T::IT.tier
    }

    fn inputs<'a>(&'a self, _: &[f64]) -> Vec<Input<'a>> {
        T::IT.inputs.to_vec()
    }

    fn nonlinear(&self) -> &'static [Nonlinear] {
        T::IT.nonlinear
    }

    fn amplitudes(&self) -> usize {
        1 - T::IT.nonlinear.len()
    }

    fn amplitude_limits(&self) -> Option<[f64; 2]> {
        T::IT.amplitude_limits
    }

    fn values(&self) -> Vec<f64> {
        match T::IT.neutral {
            Neutral::At(neutral) => vec![self.number() - neutral],
            // What is added to the believed one, which is its own.
            Neutral::Believed => vec![0.0],
        }
    }

    fn set(&mut self, values: &[f64]) {
        *self = T::of(match T::IT.neutral {
            Neutral::At(0.0) => values[0],
            Neutral::At(neutral) => neutral + values[0],
            Neutral::Believed => self.number() + values[0],
        });
    }

    fn correct(&self, constants: &mut Constants<'_>) {
        (T::IT.correct)(self.number(), constants);
    }

    fn shift_s(&self) -> f64 {
        if T::IT.nonlinear == [Nonlinear::Shift] { self.number() } else { 0.0 }
    }

    fn on_board(&self) -> Vec<OnBoard> {
        (T::IT.on_board)(self.number())
    }

    fn sentence(&self, values: &[f64]) -> String {
        (T::IT.sentence)(values[0])
    }

    fn next_test(&self) -> &'static str {
        T::IT.next_test
    }

    fn repair(&self) -> Option<&'static str> {
        T::IT.repair
    }

    fn same_in_one_pass(&self) -> Option<&'static str> {
        T::IT.same_in_one_pass
    }

    fn parameters(&self, _: &[f64]) -> Vec<Parameter> {
        let neutral = match T::IT.neutral {
            Neutral::At(neutral) => neutral,
            Neutral::Believed => self.number(),
        };
        vec![Parameter::Fitted(T::KEY.name, 0, neutral)]
    }
}

impl<T: Single> Definition for T {
    const NAME: &'static str = T::IT.name;

    fn keys(_: &Section<'_>) -> &'static [&'static str] {
        T::NAMES
    }

    fn read(section: &Section<'_>) -> Result<Self, BadInput> {
        let read = if T::IT.is_positive { positive } else { number };
        read(section, T::KEY).map(T::of)
    }

    fn law(&self, nonlinear: &[f64], x: &[f64], add: &mut impl FnMut(usize, f64)) {
        if let Some(law) = T::IT.law {
            add(0, law(nonlinear, x));
        }
    }

    fn from_board(own: Option<LinearAxis>, form: &OnBoard, constant_um: &mut f64) -> Option<Self> {
        (T::IT.from_board)(own, form, constant_um).map(T::of)
    }

    fn propose(survey: &dyn DataView, with: &mut dyn FnMut(Self, StartValues)) {
        if let Some((neutral, starts)) = (T::IT.propose)(survey) {
            with(T::of(neutral), starts);
        }
    }

    fn against(rival: &str) -> Option<&'static str> {
        T::IT.against.iter().find(|(name, _)| *name == rival).map(|(_, test)| *test)
    }
}
