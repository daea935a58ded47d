//! The tools of a magazine: each grows with the speed by a coefficient of its own, where the sensor in the nose does
//! not see it.
//!
//! ```text
//! s_tool = c_k·(n/1000)²        k the tool in the spindle; none, or one that is not here: 0
//! ```
//!
//! A tool comes out of the magazine as cold as the air: at a change tool and holder are at the air's temperature, and
//! follow the nose from there with the holder's time constant ([`crate::spindle`]).

use std::collections::BTreeSet;

use schemars::JsonSchema;
use serde::Deserialize;

use crate::{path::Segment, scenario_error::RuleViolation};

/// A tool.
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ToolConfig {
    /// Its number, from 1; 0 is no tool.
    pub number: u16,
    /// Its growth by speed in µm at 1000 r/min; proportional to the square of the speed.
    pub centrifugal_um_per_krpm2: f64,
}

/// Returns by how much the tool of this number has grown by its speed, in µm.
///
/// ```
/// use trueup_twin::tool::{ToolConfig, growth_um};
/// let tools = [ToolConfig { number: 7, centrifugal_um_per_krpm2: 0.02 }];
/// assert!((growth_um(&tools, 7, 20_000.0) - 8.0).abs() < 1e-12);
/// assert_eq!(growth_um(&tools, 8, 20_000.0), 0.0);
/// ```
#[must_use]
pub fn growth_um(tools: &[ToolConfig], number: u16, spindle_rpm: f64) -> f64 {
    let tool = tools.iter().find(|tool| tool.number == number);
    tool.map_or(0.0, |tool| tool.centrifugal_um_per_krpm2 * (spindle_rpm / 1000.0).powi(2))
}

/// Checks the tools and the pieces that take them. Fails with the first rule that is broken.
pub(crate) fn check(tools: &[ToolConfig], segments: &[Segment]) -> Result<(), RuleViolation> {
    let mut numbers = BTreeSet::new();
    for (index, tool) in tools.iter().enumerate() {
        let broken = |rule: String| Err(RuleViolation::new(&format!("tool[{index}].number"), rule));
        if tool.number == 0 {
            return broken("must be from 1: 0 is no tool".into());
        }
        if !numbers.insert(tool.number) {
            return broken(format!("is {} a second time", tool.number));
        }
    }
    for (index, segment) in segments.iter().enumerate() {
        if let Some(number) = segment.tool.filter(|tool| *tool != 0 && !numbers.contains(tool)) {
            let rule = format!("is {number}, which no [[tool]] has");
            return Err(RuleViolation::new(&format!("segment[{index}].tool"), rule));
        }
    }
    Ok(())
}
