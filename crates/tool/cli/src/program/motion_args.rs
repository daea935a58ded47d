//! How far and how fast a program may move an axis: the options that `program`, `commission` and `diagnose --next`
//! have in common.

use clap::Args;
use trueup_machine::machine_file::LinearAxis;
use trueup_program::MeasurementOptions;

use crate::UserError;

/// Range, clearance, approach and margin.
#[derive(Args, Clone)]
pub struct MotionArgs {
    /// Where an axis may move, in mm of the machine: inside travel_mm, or in its place where the machine file has
    /// none. A vertical or tool axis moves only in a range that is given.
    #[arg(
        long,
        alias = "travel",
        value_name = "z=LOW:HIGH",
        value_delimiter = ',',
        allow_hyphen_values = true
    )]
    range: Vec<String>,
    /// backlash with a dial: another axis that makes room for it, and by how far, in mm. Without it the axis reverses
    /// within the stroke of the dial.
    #[arg(long, value_name = "y=MM", allow_hyphen_values = true)]
    clearance: Option<String>,
    /// The feed of every move before the measurement, in mm/min.
    #[arg(long, value_name = "MM_PER_MIN", allow_hyphen_values = true,
          default_value_t = MeasurementOptions::default().approach_mm_per_min)]
    approach: f64,
    /// How far each axis stays away from the ends of its travel, in mm.
    #[arg(long, value_name = "MM", allow_hyphen_values = true,
          default_value_t = MeasurementOptions::default().margin_mm)]
    margin: f64,
}

impl MotionArgs {
    /// Returns the options of a plan.
    pub fn to_options(&self) -> Result<MeasurementOptions, UserError> {
        let mut options = MeasurementOptions {
            approach_mm_per_min: self.approach,
            margin_mm: self.margin,
            ..MeasurementOptions::default()
        };
        for entry in &self.range {
            let named = entry
                .split_once('=')
                .and_then(|(name, range)| Some((parse_axis(name)?, parse_range(range)?)));
            let (axis, ends) = named.ok_or_else(|| {
                UserError(format!("--range {entry}: must be like z=-120:-20, the smaller first"))
            })?;
            let name = axis.name();
            if options.range_mm[axis.index()].replace(ends).is_some() {
                return Err(UserError(format!("--range {name} is given twice")));
            }
        }
        let clearance = self.clearance.as_ref().map(|entry| {
            let named = entry
                .split_once('=')
                .and_then(|(name, mm)| Some((parse_axis(name)?, mm.trim().parse().ok()?)));
            named.ok_or_else(|| UserError(format!("--clearance {entry}: must be like y=50")))
        });
        options.clearance_mm = clearance.transpose()?;
        Ok(options)
    }

    /// Returns the words that give these options to a command of this tool.
    pub fn command_words(&self) -> Vec<String> {
        let mut words: Vec<String> =
            self.range.iter().flat_map(|range| ["--range".to_string(), range.clone()]).collect();
        words.extend(
            self.clearance.iter().flat_map(|clearance| ["--clearance".into(), clearance.clone()]),
        );
        let default = MeasurementOptions::default();
        if self.approach != default.approach_mm_per_min {
            words.extend(["--approach".into(), self.approach.to_string()]);
        }
        if self.margin != default.margin_mm {
            words.extend(["--margin".into(), self.margin.to_string()]);
        }
        words
    }
}

/// `x`, `y` or `z`.
pub fn parse_axis(name: &str) -> Option<LinearAxis> {
    LinearAxis::ALL.into_iter().find(|axis| axis.name() == name.trim())
}

/// `0:1000`, the smaller first.
pub fn parse_range(text: &str) -> Option<[f64; 2]> {
    let (low, high) = text.split_once(':')?;
    let ends: [f64; 2] = [low.trim().parse().ok()?, high.trim().parse().ok()?];
    (ends.iter().all(|end| end.is_finite()) && ends[0] < ends[1]).then_some(ends)
}
