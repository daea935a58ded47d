//! The page of every cause that has one number: what differs from cause to cause is an entry of a table.
//!
//! | table | holds |
//! |---|---|
//! | `sensor` | errors of the displacement sensor, and what speed and load add to the growth |
//! | `heat` | constants of the machine's own thermal laws |
//! | `axis` | errors of an axis over its position and direction, and of the clock |

mod axis;
mod sensor;
mod thermal_constants;

pub use axis::{Backlash, PitchScale, PositionDependentBacklash, TimeShift};
pub use sensor::{
    CentrifugalGrowth, CuttingLoad, SensorCurvature, SensorGain, SensorOffset, SensorSaturation,
};
pub use thermal_constants::{
    CoolingAsymmetry, ExpansionConstant, ExpansionSlope, GrowthAmplitude, GrowthRate,
    ReferenceTemperature, ThermalLag,
};

use super::{
    cause_spec::{
        BoardRepresentation, BoardTerm, Candidate, Explanation, FileRepresentation,
        FindingParameter, FitSpec, LawInput, ModelConstants, NonlinearParameter, PhysicalLaw,
        PredictionStage, Target, TermContext, TermEntry, Value, required_number,
        required_positive_number,
    },
    data_view::{DataView, StartValues},
};
use crate::{
    keys::{key::Key, reader::Section},
    location::InputFileError,
    sections::LinearAxis,
};

/// The value of the number that changes nothing.
#[derive(Clone, Copy, Debug, PartialEq)]
enum NeutralValue {
    /// This one.
    At(f64),
    /// That of the machine's own law.
    Believed,
}

/// Effect of an amplitude of 1, at these nonlinear values and inputs.
type LawFn = fn(&[f64], &[f64]) -> f64;

/// A cause with one number. Its functions get that number, or the value that is fitted.
struct ScalarCause {
    name: &'static str,
    target: Target,
    stage: PredictionStage,
    tier: u8,
    is_compensable: bool,
    neutral: NeutralValue,
    /// Whether the number in a file must be above 0.
    is_positive: bool,
    inputs: &'static [LawInput<'static>],
    /// The kind of the number; none: it is an amplitude.
    nonlinear: &'static [NonlinearParameter],
    amplitude_bounds: Option<[f64; 2]>,
    /// None: an amplitude adds nothing by itself.
    law: Option<LawFn>,
    refusal: fn(&TermContext<'_>) -> Option<String>,
    correct: fn(f64, &mut ModelConstants<'_>),
    on_board: fn(f64) -> Vec<BoardTerm>,
    from_board: fn(Option<LinearAxis>, &BoardTerm, &mut f64) -> Option<f64>,
    /// The neutral number and where the search begins; none where the data do not allow the cause.
    propose: fn(&dyn DataView) -> Option<(f64, StartValues)>,
    sentence: fn(f64) -> String,
    next_test: &'static str,
    /// The measurements that distinguish it from others, by their names.
    against: &'static [(&'static str, &'static str)],
    repair: Option<&'static str>,
}

impl ScalarCause {
    /// The entries of most causes.
    const DEFAULT: Self = Self {
        name: "",
        target: Target::Any,
        stage: PredictionStage::Sum,
        tier: 0,
        is_compensable: true,
        neutral: NeutralValue::At(0.0),
        is_positive: false,
        inputs: &[],
        nonlinear: &[],
        amplitude_bounds: None,
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
    };
}

/// A cause with one number, as its table declares it.
trait ScalarCauseDefinition {
    const DEFINITION: ScalarCause;
}

/// A struct with the number of a cause.
trait ScalarParameter: ScalarCauseDefinition + Sized {
    const KEY: Key;
    const NAMES: &'static [&'static str];

    fn number(&self) -> f64;

    fn from_number(number: f64) -> Self;
}

/// Declares the struct of a cause with its number, and the number's key in the file.
macro_rules! define_scalar_cause {
    ($(#[$attribute:meta])* $Name:ident { $(#[$doc:meta])* $key:ident = $KEY:ident }) => {
        $(#[$attribute])*
        #[derive(Clone, Debug, PartialEq)]
        pub struct $Name {
            $(#[$doc])*
            pub $key: f64,
        }

        impl Default for $Name {
            fn default() -> Self {
                match <Self as $crate::effect::scalar_cause::ScalarCauseDefinition>::DEFINITION.neutral {
                    $crate::effect::scalar_cause::NeutralValue::At($key) => Self { $key },
                    $crate::effect::scalar_cause::NeutralValue::Believed => Self { $key: 0.0 },
                }
            }
        }

        impl $crate::effect::scalar_cause::ScalarParameter for $Name {
            const KEY: $crate::keys::key::Key = $crate::keys::term::$KEY;
            const NAMES: &'static [&'static str] = &[Self::KEY.name];

            fn number(&self) -> f64 {
                self.$key
            }

            fn from_number($key: f64) -> Self {
                Self { $key }
            }
        }
    };
}

use define_scalar_cause;

impl<T: ScalarParameter> FileRepresentation for T {
    const NAME: &'static str = T::DEFINITION.name;

    fn keys(_: &Section<'_>) -> &'static [&'static str] {
        T::NAMES
    }

    fn read(section: &Section<'_>) -> Result<Self, InputFileError> {
        let read =
            if T::DEFINITION.is_positive { required_positive_number } else { required_number };
        read(section, T::KEY).map(T::from_number)
    }

    fn entries(&self) -> Vec<TermEntry> {
        vec![(T::KEY.name, Value::Number(self.number()))]
    }
}

impl<T: ScalarParameter> PhysicalLaw for T {
    fn target(&self) -> Target {
        T::DEFINITION.target
    }

    fn refusal(&self, host: &TermContext<'_>) -> Option<String> {
        (T::DEFINITION.refusal)(host)
    }

    fn stage(&self) -> PredictionStage {
        T::DEFINITION.stage
    }

    fn inputs<'a>(&'a self, _: &[f64]) -> Vec<LawInput<'a>> {
        T::DEFINITION.inputs.to_vec()
    }

    fn add_unit_effects(&self, nonlinear: &[f64], x: &[f64], add: &mut impl FnMut(usize, f64)) {
        if let Some(law) = T::DEFINITION.law {
            add(0, law(nonlinear, x));
        }
    }

    fn correct_constants(&self, constants: &mut ModelConstants<'_>) {
        (T::DEFINITION.correct)(self.number(), constants);
    }

    fn time_shift_s(&self) -> f64 {
        if T::DEFINITION.nonlinear == [NonlinearParameter::Shift] { self.number() } else { 0.0 }
    }
}

impl<T: ScalarParameter> BoardRepresentation for T {
    fn is_compensable(&self) -> bool {
        T::DEFINITION.is_compensable
    }

    fn board_terms(&self) -> Vec<BoardTerm> {
        (T::DEFINITION.on_board)(self.number())
    }

    fn from_board(
        own: Option<LinearAxis>,
        form: &BoardTerm,
        constant_um: &mut f64,
    ) -> Option<Self> {
        (T::DEFINITION.from_board)(own, form, constant_um).map(T::from_number)
    }
}

impl<T: ScalarParameter> Candidate for T {
    fn fit_spec(&self) -> FitSpec {
        FitSpec {
            tier: T::DEFINITION.tier,
            nonlinear: T::DEFINITION.nonlinear,
            amplitudes: 1 - T::DEFINITION.nonlinear.len(),
            amplitude_bounds: T::DEFINITION.amplitude_bounds,
            ..FitSpec::DEFAULT
        }
    }

    fn values(&self) -> Vec<f64> {
        match T::DEFINITION.neutral {
            NeutralValue::At(neutral) => vec![self.number() - neutral],
            // What is added to the believed one, which is its own.
            NeutralValue::Believed => vec![0.0],
        }
    }

    fn set_values(&mut self, values: &[f64]) {
        *self = T::from_number(match T::DEFINITION.neutral {
            NeutralValue::At(0.0) => values[0],
            NeutralValue::At(neutral) => neutral + values[0],
            NeutralValue::Believed => self.number() + values[0],
        });
    }

    fn propose(survey: &dyn DataView, with: &mut dyn FnMut(Self, StartValues)) {
        if let Some((neutral, starts)) = (T::DEFINITION.propose)(survey) {
            with(T::from_number(neutral), starts);
        }
    }
}

impl<T: ScalarParameter> Explanation for T {
    fn describe(&self, values: &[f64]) -> String {
        (T::DEFINITION.sentence)(values[0])
    }

    fn next_test(&self) -> &'static str {
        T::DEFINITION.next_test
    }

    fn distinguishing_test(alternative: &str) -> Option<&'static str> {
        T::DEFINITION.against.iter().find(|(name, _)| *name == alternative).map(|(_, test)| *test)
    }

    fn repair_advice(&self) -> Option<&'static str> {
        T::DEFINITION.repair
    }

    fn parameters(&self, _: &[f64]) -> Vec<FindingParameter> {
        let neutral = match T::DEFINITION.neutral {
            NeutralValue::At(neutral) => neutral,
            NeutralValue::Believed => self.number(),
        };
        vec![FindingParameter::Fitted(T::KEY.name, 0, neutral)]
    }
}
