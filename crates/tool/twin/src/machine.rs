//! The machine as a whole: commanded step by step, it answers with what its sensors
//! say and what its tool tip really does.
//!
//! ```text
//! Command ─► spindle ─► growth ─► displacement sensor ─► sensor_volts, sensor_counts
//!    │          └─► temperatures ─► thermometers ──────► temperatures_c
//!    ├─────► head ─► tool direction V ─┐
//!    └─────► axes ─► errors ───────────┴─► tip_error_um = errors + of the bodies + growth·V
//! ```
//!
//! `crate::simulation` plays a scenario with it, row by row; a control in the loop may step it with
//! whatever it has just commanded.

use crate::{
    ambient::AmbientAir,
    axes::{AxisName, SimulatedAxes},
    noise::RandomStream,
    rigid_bodies::{self, Body},
    rotary_head,
    scenario::{CoolantConfig, Scenario},
    sensors::{DisplacementSensor, Spot, Thermometer},
    spindle::{GrowthComponents, OperatingConditions, SimulatedSpindle, SpindleTemperatures},
    tool::{ToolConfig, growth_um},
};

/// The command to the drives for one step: where it ends, and what holds during it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DriveCommand {
    /// Where X, Y and Z are driven to, in mm.
    pub position_mm: [f64; 3],
    /// Where the rotary axes of the head are turned to, in degrees, in the scenario's order.
    pub head_deg: [f64; 2],
    /// Speed of the spindle in r/min.
    pub spindle_rpm: f64,
    /// Axial cutting force in N; positive pushes the tool back.
    pub load_n: f64,
    /// Number of the tool in the spindle; 0: none.
    pub tool: u16,
}

/// A machine on its way.
#[derive(Clone, Debug)]
pub struct SimulatedMachine {
    time_s: f64,
    ambient: AmbientAir,
    coolant: CoolantConfig,
    spindle: Option<SimulatedSpindle>,
    tools: Vec<ToolConfig>,
    axes: SimulatedAxes,
    bodies: Vec<Body>,
    tip_mm: [f64; 3],
    sensor: Option<DisplacementSensor>,
    thermometers: Vec<(String, Thermometer)>,
    head: Vec<rotary_head::RotaryAxis>,
    /// From the spindle nose to the tool tip, a unit vector; at all angles 0, and now.
    straight: [f64; 3],
    direction: [f64; 3],
    command: DriveCommand,
}

impl SimulatedMachine {
    /// Returns the machine of `scenario`, cold, its axes at the scenario's start, with chance of its own
    /// under `seed`.
    #[must_use]
    pub fn new(scenario: &Scenario, seed: u64) -> Self {
        let ambient = AmbientAir::new(&scenario.ambient, RandomStream::new(seed, "ambient"));
        let start_c = scenario.start_c.unwrap_or(ambient.temperature_c());
        let [x, y, z] = scenario.tool_direction;
        let length = (x * x + y * y + z * z).sqrt();
        let straight = scenario.tool_direction.map(|component| component / length);
        let thermometers = scenario
            .thermometer
            .iter()
            .map(|(name, config)| (format!("temp_{name}_c"), Thermometer::new(config, name, seed)));
        let mut machine = Self {
            time_s: 0.0,
            ambient,
            coolant: scenario.coolant.clone(),
            spindle: scenario.spindle.as_ref().map(|config| SimulatedSpindle::new(config, start_c)),
            tools: scenario.tool.clone(),
            axes: SimulatedAxes::new(&scenario.axes_config(), scenario.start_mm, start_c),
            bodies: scenario.body.clone(),
            tip_mm: scenario.tip_mm,
            sensor: scenario.sensor.as_ref().map(|config| DisplacementSensor::new(config, seed)),
            thermometers: thermometers.collect(),
            head: scenario.head.clone(),
            straight,
            direction: straight,
            command: DriveCommand {
                position_mm: scenario.start_mm,
                tool: scenario.segment.first().and_then(|segment| segment.tool).unwrap_or(0),
                ..DriveCommand::default()
            },
        };
        machine.update_sensors(0.0);
        machine
    }

    /// Steps on by `dt_s`, above 0.
    pub fn step(&mut self, dt_s: f64, command: &DriveCommand) {
        let is_changed = self.command.tool != command.tool;
        self.command = *command;
        let ambient_c = self.ambient.step(dt_s);
        let coolant_c = self.coolant_temperature_c(ambient_c);
        if let Some(spindle) = &mut self.spindle {
            if is_changed {
                spindle.load_cold_tool(ambient_c);
            }
            let DriveCommand { spindle_rpm, load_n, .. } = *command;
            spindle.step(dt_s, &OperatingConditions { spindle_rpm, load_n, ambient_c, coolant_c });
        }
        self.axes.step(dt_s, command.position_mm, ambient_c);
        self.direction =
            rotary_head::rotate_tool_direction(&self.head, command.head_deg, self.straight);
        self.time_s += dt_s;
        self.update_sensors(dt_s);
    }

    /// Seconds since the start.
    #[must_use]
    pub fn time_s(&self) -> f64 {
        self.time_s
    }

    /// Returns the counts that the displacement sensor shows now: NaN where one is missing, `None` without
    /// a sensor. Each call is a reading of its own, with noise of its own.
    pub fn read_sensor_counts(&mut self) -> Option<f64> {
        let coil_c =
            self.spindle.as_ref().map_or(f64::NAN, |spindle| spindle.temperatures().coil_c);
        let turns = self.command.spindle_rpm != 0.0;
        self.sensor.as_mut().map(|sensor| sensor.read(coil_c, turns))
    }

    /// Returns the same as the voltage at the sensor's output, which is 10 V at its full scale.
    pub fn read_sensor_volts(&mut self) -> Option<f64> {
        let full_scale = self.sensor.as_ref()?.full_scale_counts();
        self.read_sensor_counts().map(|counts| counts * 10.0 / full_scale)
    }

    /// Returns what the thermometers show now, in °C, by the names of their columns; NaN where missing.
    /// Each call is a reading of its own.
    pub fn read_temperatures_c(&mut self) -> Vec<(&str, f64)> {
        let all = self.thermometers.iter_mut();
        all.map(|(column, thermometer)| (column.as_str(), thermometer.read())).collect()
    }

    /// Returns how far the tool tip is out of the spindle, in µm.
    #[must_use]
    pub fn elongation_um(&self) -> f64 {
        self.growth().growth_at_tip_um()
    }

    /// Returns the error of the tool tip on X, Y and Z, actual minus commanded, in µm: the axes' errors,
    /// those of the bodies that they move, and the elongation along the tool.
    #[must_use]
    pub fn tip_error_um(&self) -> [f64; 3] {
        let (axes, elongation_um) = (self.axes.error_um(), self.elongation_um());
        let mut angle_deg = [0.0; 3];
        for (axis, angle) in self.head.iter().zip(self.command.head_deg) {
            angle_deg[*axis as usize] = angle;
        }
        let position_mm = self.axes.position_mm();
        let bodies = rigid_bodies::error_um(&self.bodies, self.tip_mm, position_mm, angle_deg);
        std::array::from_fn(|axis| axes[axis] + bodies[axis] + elongation_um * self.direction[axis])
    }

    /// Returns the linear axes, with their present errors.
    #[must_use]
    pub fn axes(&self) -> &SimulatedAxes {
        &self.axes
    }

    /// Returns whether there is a spindle.
    #[must_use]
    pub(crate) fn has_spindle(&self) -> bool {
        self.spindle.is_some()
    }

    /// From the spindle nose to the tool tip, a unit vector, as the head stands now.
    #[must_use]
    pub fn tool_direction(&self) -> [f64; 3] {
        self.direction
    }

    fn coolant_temperature_c(&self, ambient_c: f64) -> f64 {
        let CoolantConfig { temperature_c, air_share } = self.coolant;
        temperature_c * (1.0 - air_share) + ambient_c * air_share
    }

    fn growth(&self) -> GrowthComponents {
        let Some(spindle) = &self.spindle else { return GrowthComponents::default() };
        let DriveCommand { tool, spindle_rpm, .. } = self.command;
        GrowthComponents { tool_um: growth_um(&self.tools, tool, spindle_rpm), ..spindle.growth() }
    }

    /// Lets the sensors that have a memory see the truth.
    fn update_sensors(&mut self, dt_s: f64) {
        let growth_um = self.growth().growth_at_sensor_um();
        if let Some(sensor) = &mut self.sensor {
            sensor.step(dt_s, growth_um);
        }
        let ambient_c = self.ambient.temperature_c();
        let coolant_c = self.coolant_temperature_c(ambient_c);
        let spindle = self.spindle.as_ref().map(SimulatedSpindle::temperatures);
        for (_, thermometer) in &mut self.thermometers {
            let spot_c = match thermometer.spot() {
                Spot::Ambient => ambient_c,
                Spot::Coolant => coolant_c,
                Spot::ScrewX => self.axes.screw_temperature_c(AxisName::X),
                Spot::ScrewY => self.axes.screw_temperature_c(AxisName::Y),
                Spot::ScrewZ => self.axes.screw_temperature_c(AxisName::Z),
                Spot::ScaleX => self.axes.scale_temperature_c(AxisName::X),
                Spot::ScaleY => self.axes.scale_temperature_c(AxisName::Y),
                Spot::ScaleZ => self.axes.scale_temperature_c(AxisName::Z),
                // A scenario with a thermometer on a spindle has one.
                on_spindle => spindle
                    .map_or(f64::NAN, |spindle| spindle_spot_temperature_c(&spindle, on_spindle)),
            };
            thermometer.step(dt_s, spot_c);
        }
    }
}

/// Returns the temperature at a spot on the spindle; NaN for one that is elsewhere.
fn spindle_spot_temperature_c(spindle: &SpindleTemperatures, spot: Spot) -> f64 {
    match spot {
        Spot::Front => spindle.front_c,
        Spot::Rear => spindle.rear_c,
        Spot::Motor => spindle.motor_c,
        Spot::Nose => spindle.nose_c,
        Spot::Housing => spindle.housing_c,
        Spot::Holder => spindle.holder_c,
        Spot::Coil => spindle.coil_c,
        _ => f64::NAN,
    }
}
