//! The sections of the machine file that name no cause: each has one page, with its type, its keys, and how it is read and
//! written.
//!
//! The causes are built on these types; `[machine]` and `[[term]]`, which hold causes, are in [`crate::machine_file`].

pub(crate) mod axis;
pub(crate) mod inputs;
pub(crate) mod instrument;
mod kinematic_chain;
mod limits;
pub(crate) mod spindle;
pub(crate) mod straightness;
pub(crate) mod thermal_state;
mod tools;
pub(crate) mod volume;

pub use axis::{
    AxisModel, Backlash, Feedback, LinearAxis, PitchErrorTable, RotaryAxis, SecondDrive,
    ThermalLaw, ThermalMode, ThermalRow,
};
pub use kinematic_chain::AxisChain;
pub use limits::{LearnedChangeLimits, Limits};
pub use spindle::{ElongationSource, SensorModel, Spindle, TemperatureModel, Warmup};
pub use straightness::{Squareness, Straightness};
pub use tools::{ToolGrowth, ToolGrowthList};
pub use volume::{
    AngleProfile, AngularErrorMotion, RotaryLocationErrors, ToolGeometry, VolumetricModel,
};
