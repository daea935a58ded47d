//! The scenario file (TOML): the machine, the sensors, the instrument, and what is done.
//!
//! Every effect is a size, and a size of 0 is an effect that is off; a key that is left out has the
//! default that its field states. Read strictly: an unknown key, a wrong type, a value out of range is
//! an error with its line and column.

use std::{collections::BTreeMap, path::Path};

use schemars::JsonSchema;
use serde::Deserialize;
use toml::de::DeTable;

use crate::{
    ambient::AmbientConfig,
    axes::{Abbe, AxesConfig, AxisConfig, AxisName, StraightnessConfig},
    instrument::InstrumentConfig,
    path::{Segment, distance_mm},
    rigid_bodies::{self, Body},
    rotary_head,
    scenario_error::{RuleViolation, find_key_offset, find_non_finite, line_and_column},
    sensors::{DisplacementConfig, Spot, ThermometerConfig},
    spindle::SpindleConfig,
    tool::{self, ToolConfig},
};

pub use crate::scenario_error::ScenarioError;

/// The most rows, and the most ways there and back, that a scenario may ask for.
pub(crate) const MAX_SCENARIO_ROWS: f64 = 5e6;
/// The shortest step of the simulation that a scenario may ask for, in s.
pub(crate) const MIN_TIME_STEP_S: f64 = 1e-3;

/// A measured quantity.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename = "Quantity", rename_all = "lowercase")]
pub enum MeasuredQuantity {
    /// How far the tool tip is out of the spindle.
    Elongation,
    /// The error on X.
    Dx,
    /// The error on Y.
    Dy,
    /// The error on Z.
    Dz,
}

impl MeasuredQuantity {
    /// Its name in columns.
    #[must_use]
    pub fn name(self) -> &'static str {
        ["elongation", "dx", "dy", "dz"][self as usize]
    }
}

/// The coolant of the spindle.
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct CoolantConfig {
    /// Its temperature in °C.
    pub temperature_c: f64,
    /// How far it follows the air instead, 0…1.
    pub air_share: f64,
}

impl Default for CoolantConfig {
    fn default() -> Self {
        Self { temperature_c: 20.0, air_share: 0.0 }
    }
}

/// A virtual machine tool and what it does: all that `simulate` needs besides a seed.
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Scenario {
    /// Its title, for the reader.
    pub name: String,
    /// The quantities to measure; a column each.
    pub measure: Vec<MeasuredQuantity>,
    /// From row to row, in s, above 0.
    #[serde(default = "default_interval_s")]
    pub interval_s: f64,
    /// The longest step of the simulation in s, at least 0.001.
    #[serde(default = "default_step_s")]
    pub step_s: f64,
    /// How often the segments are gone through.
    #[serde(default = "default_repeat")]
    pub repeat: u32,
    /// The start of all temperatures, in °C; by default that of the air.
    pub start_c: Option<f64>,
    /// Where the axes start, in mm.
    #[serde(default)]
    pub start_mm: [f64; 3],
    /// From the spindle nose to the tool tip; its length does not count.
    #[serde(default = "default_tool_direction")]
    pub tool_direction: [f64; 3],
    /// The rotary axes that carry the spindle, from the frame to the tool; at most two.
    /// In a run of segments they stand at 0.
    #[serde(default)]
    pub head: Vec<rotary_head::RotaryAxis>,
    /// The air around the machine.
    #[serde(default)]
    pub ambient: AmbientConfig,
    /// The coolant of the spindle.
    #[serde(default)]
    pub coolant: CoolantConfig,
    /// The spindle; without it nothing grows.
    pub spindle: Option<SpindleConfig>,
    /// The tools of its magazine; without them nothing depends on the tool.
    #[serde(default)]
    pub tool: Vec<ToolConfig>,
    /// The displacement sensor in its nose; without it there are no counts.
    pub sensor: Option<DisplacementConfig>,
    /// The thermometers, by the name in their column `temp_<name>_c`.
    #[serde(default)]
    #[schemars(extend("propertyNames" = {"pattern": "^[A-Za-z0-9_]+$"}))]
    pub thermometer: BTreeMap<String, ThermometerConfig>,
    /// The axes; one that is not here is right.
    #[serde(default)]
    #[schemars(extend("propertyNames" = {"enum": crate::axes::AXIS_NAMES}))]
    pub axis: BTreeMap<AxisName, AxisConfig>,
    /// Errors of one axis along another.
    #[serde(default)]
    pub straightness: Vec<StraightnessConfig>,
    /// Angles and arms.
    #[serde(default)]
    pub abbe: Vec<Abbe>,
    /// The bodies that the axes move, from the workpiece to the tool, and how each is turned and shifted; without them
    /// all are right.
    #[serde(default)]
    pub body: Vec<Body>,
    /// From the spindle nose to the tool tip in mm, with all angles at 0, for the arms of the bodies.
    #[serde(default)]
    pub tip_mm: [f64; 3],
    /// The reference instrument; every quantity has one of its own.
    #[serde(default)]
    pub instrument: InstrumentConfig,
    /// The pieces of the run, in this order.
    pub segment: Vec<Segment>,
}

fn default_interval_s() -> f64 {
    10.0
}

fn default_step_s() -> f64 {
    5.0
}

fn default_repeat() -> u32 {
    1
}

fn default_tool_direction() -> [f64; 3] {
    [0.0, 0.0, -1.0]
}

impl Scenario {
    /// Reads the scenario `text`, the content of `file` (which names it in errors and is not opened).
    ///
    /// # Errors
    /// Invalid TOML, an unknown or missing key, a value of the wrong type or out of its range, or
    /// something measured that is not there; with its place and the rule.
    pub fn parse(text: &str, file: &Path) -> Result<Self, ScenarioError> {
        let text = text.strip_prefix('\u{feff}').unwrap_or(text);
        let bad = |offset: usize, rule: String| {
            let (line, column) = line_and_column(text, offset);
            // One line, whatever the user wrote.
            let rule = rule.trim().replace(['\n', '\r'], " ");
            ScenarioError { file: file.to_path_buf(), line, column, rule }
        };
        let document = DeTable::parse(text).map_err(|error| {
            let offset = error.span().map_or(0, |span| span.start);
            bad(offset, format!("not valid TOML: {}", error.message()))
        })?;
        if let Some((offset, key)) = find_non_finite("", document.get_ref()) {
            return Err(bad(offset, format!("{key} must be a finite number")));
        }
        let scenario: Self = toml::from_str(text).map_err(|error| {
            bad(error.span().map_or(0, |span| span.start), error.message().to_string())
        })?;
        scenario.check().map_err(|broken| {
            let offset = find_key_offset(document.get_ref(), &broken.key);
            bad(offset, format!("{} {}", broken.key, broken.rule))
        })?;
        Ok(scenario)
    }

    /// Returns the axes, as what moves them takes them.
    #[must_use]
    pub(crate) fn axes_config(&self) -> AxesConfig {
        AxesConfig {
            axes: self.axis.clone(),
            straightness: self.straightness.clone(),
            abbe: self.abbe.clone(),
        }
    }

    fn check(&self) -> Result<(), RuleViolation> {
        for (key, value) in [
            ("interval_s", self.interval_s),
            ("step_s", self.step_s),
            ("ambient.wander_s", self.ambient.wander_s),
        ] {
            if value <= 0.0 {
                return Err(RuleViolation::new(key, format!("must be above 0, not {value}")));
            }
        }
        RuleViolation::require_non_negative(&[("ambient.wander_c", self.ambient.wander_c)])?;
        RuleViolation::require_fraction("coolant.air_share", self.coolant.air_share)?;
        if self.measure.is_empty() {
            return Err(RuleViolation::new("measure", "must name at least one quantity".into()));
        }
        for (index, quantity) in self.measure.iter().enumerate() {
            let key = format!("measure[{index}]");
            if self.measure[..index].contains(quantity) {
                return Err(RuleViolation::new(
                    &key,
                    format!("is {} a second time", quantity.name()),
                ));
            }
            if *quantity == MeasuredQuantity::Elongation && self.spindle.is_none() {
                return Err(RuleViolation::new(
                    &key,
                    "is elongation, but there is no [spindle]".into(),
                ));
            }
        }
        if self.tool_direction.iter().all(|component| *component == 0.0) {
            return Err(RuleViolation::new("tool_direction", "has no length".into()));
        }
        if self.head.len() > rotary_head::MAX_HEAD_AXES {
            let rule = format!("has more than {} axes", rotary_head::MAX_HEAD_AXES);
            return Err(RuleViolation::new("head", rule));
        }
        if let Some(spindle) = &self.spindle {
            spindle.check().map_err(|rule| rule.in_section("spindle"))?;
        }
        if let Some(sensor) = &self.sensor {
            sensor.check().map_err(|rule| rule.in_section("sensor"))?;
            if self.spindle.is_none() {
                return Err(RuleViolation::new("sensor", "needs a [spindle] to sit in".into()));
            }
        }
        for (name, thermometer) in &self.thermometer {
            let section = format!("thermometer.{name}");
            if name.is_empty() || !name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_') {
                return Err(RuleViolation::new(
                    &section,
                    "must be named by letters, digits and _".into(),
                ));
            }
            thermometer.check().map_err(|rule| rule.in_section(&section))?;
            let axis = match thermometer.at {
                Spot::ScrewX | Spot::ScaleX => Some((AxisName::X, "x")),
                Spot::ScrewY | Spot::ScaleY => Some((AxisName::Y, "y")),
                Spot::ScrewZ | Spot::ScaleZ => Some((AxisName::Z, "z")),
                _ => None,
            };
            let missing = match axis {
                Some((axis, name)) if !self.axis.contains_key(&axis) => format!("axis.{name}"),
                None if thermometer.at.is_on_spindle() && self.spindle.is_none() => {
                    "spindle".to_string()
                }
                _ => continue,
            };
            let rule = format!("needs [{missing}], which is missing");
            return Err(RuleViolation::new("at", rule).in_section(&section));
        }
        for (&name, axis) in &self.axis {
            let section = format!("axis.{}", crate::axes::AXIS_NAMES[name.index()]);
            axis.check().map_err(|rule| rule.in_section(&section))?;
        }
        rigid_bodies::check(&self.body, &self.head)?;
        for (index, curve) in self.straightness.iter().enumerate() {
            if curve.error == curve.along {
                let rule = "must be another axis than error".to_string();
                return Err(
                    RuleViolation::new("along", rule).in_section(&format!("straightness[{index}]"))
                );
            }
        }
        self.instrument.check().map_err(|rule| rule.in_section("instrument"))?;
        self.check_segments()
    }

    /// Checks what the machine does, and how many rows come of it.
    fn check_segments(&self) -> Result<(), RuleViolation> {
        if self.segment.is_empty() {
            return Err(RuleViolation::new(
                "segment",
                "must be there: it is what the machine does".into(),
            ));
        }
        for (index, segment) in self.segment.iter().enumerate() {
            segment.check().map_err(|rule| rule.in_section(&format!("segment[{index}]")))?;
        }
        tool::check(&self.tool, &self.segment)?;
        if self.repeat == 0 {
            return Err(RuleViolation::new("repeat", "must be at least 1, not 0".into()));
        }
        // A step costs time whether or not a row comes of it.
        if self.step_s < MIN_TIME_STEP_S {
            let rule = format!("must be at least {MIN_TIME_STEP_S}, not {}", self.step_s);
            return Err(RuleViolation::new("step_s", rule));
        }
        let ways = |segment: &Segment| 2.0 * f64::from(segment.cycles.unwrap_or(1));
        let ways = f64::from(self.repeat) * self.segment.iter().map(ways).sum::<f64>();
        let rows = self.estimated_row_count().max(ways);
        if rows > MAX_SCENARIO_ROWS {
            let rule = format!("comes to {rows:.0} rows or ways, more than {MAX_SCENARIO_ROWS:.0}");
            return Err(RuleViolation::new("repeat", rule));
        }
        Ok(())
    }

    /// Returns how many rows there will be, nearly.
    #[must_use]
    pub fn estimated_row_count(&self) -> f64 {
        let mut at_mm = self.start_mm;
        let mut rows = 0.0;
        for segment in &self.segment {
            rows += match (segment.to_mm, segment.targets, segment.duration_s) {
                (Some(to_mm), ..) => {
                    let feed_mm_per_s = segment.feed_mm_per_min.unwrap_or(1.0) / 60.0;
                    let seconds = distance_mm(at_mm, to_mm) / feed_mm_per_s;
                    match segment.cycles {
                        Some(cycles) => {
                            2.0 * f64::from(cycles) * (seconds / self.interval_s).min(1.0)
                        }
                        None => {
                            at_mm = to_mm;
                            (seconds / self.interval_s).ceil()
                        }
                    }
                }
                (_, Some(targets), _) => {
                    2.0 * f64::from(targets) * f64::from(segment.cycles.unwrap_or(1))
                }
                (.., duration_s) => (duration_s.unwrap_or(0.0) / self.interval_s).ceil(),
            };
        }
        rows * f64::from(self.repeat)
    }
}
