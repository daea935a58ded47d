//! A scenario that is run: truth steps on, sensors and instruments look at it, rows are written.
//!
//! ```text
//! path ─► spindle ─► growth ─► displacement sensor ─► sensor_counts
//!    │       └─► temperatures ─► thermometers ──────► temp_<name>_c
//!    └──► axes ─► errors ┬─► instruments ───────────► measured_<quantity>_um
//!             growth·V ──┘
//! ```

use crate::{
    ambient::Ambient,
    axes::{Axes, AxisName, NAMES},
    instrument::Instrument,
    noise::Stream,
    path::{Leg, legs},
    scenario::{Quantity, Scenario},
    sensors::{Displacement, Spot, Thermometer},
    spindle::{Drive, Growth, Spindle, SpindleTemperatures},
    table::Table,
};

/// What the virtual machine tool measures in `scenario` under `seed`, in the form of a run file.
/// `row_done` hears of every row.
#[must_use]
pub fn simulate(scenario: &Scenario, seed: u64, mut row_done: impl FnMut()) -> Table {
    let mut machine = Machine::new(scenario, seed);
    let mut table = Table::new();
    let Scenario { segment, repeat, start_mm, interval_s, .. } = scenario;
    let legs = legs(segment, *repeat, *start_mm, *interval_s, seed);
    for leg in &legs {
        machine.go(leg);
        if let Some(run) = leg.row_of_run {
            machine.write(run, leg, &mut table);
            row_done();
        }
    }
    table
}

/// Everything that has a state.
struct Machine<'s> {
    scenario: &'s Scenario,
    time_s: f64,
    ambient: Ambient,
    spindle: Option<Spindle>,
    axes: Axes,
    has_positions: bool,
    sensor: Option<Displacement>,
    thermometers: Vec<(String, Thermometer)>,
    instruments: Vec<(Quantity, Instrument)>,
    tool_direction: [f64; 3],
}

impl<'s> Machine<'s> {
    fn new(scenario: &'s Scenario, seed: u64) -> Self {
        let ambient = Ambient::new(&scenario.ambient, Stream::new(seed, "ambient"));
        let start_c = scenario.start_c.unwrap_or(ambient.temperature_c());
        let [x, y, z] = scenario.tool_direction;
        let length = (x * x + y * y + z * z).sqrt();
        let mut machine = Self {
            scenario,
            time_s: 0.0,
            ambient,
            spindle: scenario.spindle.as_ref().map(|config| Spindle::new(config, start_c)),
            axes: Axes::new(&scenario.axes(), scenario.start_mm, start_c),
            has_positions: scenario.measure.iter().any(|it| *it != Quantity::Elongation)
                || scenario.segment.iter().any(|it| it.to_mm.is_some() || it.axis.is_some()),
            sensor: scenario.sensor.as_ref().map(|config| Displacement::new(config, seed)),
            thermometers: scenario
                .thermometer
                .iter()
                .map(|(name, config)| {
                    (format!("temp_{name}_c"), Thermometer::new(config, name, seed))
                })
                .collect(),
            instruments: scenario
                .measure
                .iter()
                .map(|&quantity| {
                    let config = &scenario.instrument;
                    (quantity, Instrument::new(config, quantity.name(), seed))
                })
                .collect(),
            tool_direction: scenario.tool_direction.map(|component| component / length),
        };
        machine.look(0.0);
        machine
    }

    /// Goes along `leg`, in steps that are short enough.
    fn go(&mut self, leg: &Leg) {
        let parts = (leg.seconds / self.scenario.step_s).ceil();
        let from_mm = self.axes.position_mm();
        let mut part = 0.0;
        while part < parts {
            part += 1.0;
            let dt_s = leg.seconds / parts;
            let share = part / parts;
            let ambient_c = self.ambient.step(dt_s);
            let coolant = &self.scenario.coolant;
            let coolant_c =
                coolant.temperature_c * (1.0 - coolant.air_share) + ambient_c * coolant.air_share;
            if let Some(spindle) = &mut self.spindle {
                let Leg { spindle_rpm, load_n, .. } = *leg;
                spindle.step(dt_s, &Drive { spindle_rpm, load_n, ambient_c, coolant_c });
            }
            let now_mm = [0, 1, 2].map(|i| from_mm[i] + (leg.to_mm[i] - from_mm[i]) * share);
            self.axes.step(dt_s, now_mm, ambient_c);
            self.time_s += dt_s;
            self.look(dt_s);
        }
    }

    fn growth(&self) -> Growth {
        self.spindle.as_ref().map(Spindle::growth).unwrap_or_default()
    }

    /// Lets the sensors that have a memory see the truth.
    fn look(&mut self, dt_s: f64) {
        let growth_um = self.growth().at_sensor_um();
        if let Some(sensor) = &mut self.sensor {
            sensor.step(dt_s, growth_um);
        }
        let ambient_c = self.ambient.temperature_c();
        let coolant = &self.scenario.coolant;
        let coolant_c =
            coolant.temperature_c * (1.0 - coolant.air_share) + ambient_c * coolant.air_share;
        let spindle = self.spindle.as_ref().map(Spindle::temperatures);
        for (_, thermometer) in &mut self.thermometers {
            let spot_c = match thermometer.spot() {
                Spot::Ambient => ambient_c,
                Spot::Coolant => coolant_c,
                Spot::ScrewX => self.axes.screw_c(AxisName::X),
                Spot::ScrewY => self.axes.screw_c(AxisName::Y),
                Spot::ScrewZ => self.axes.screw_c(AxisName::Z),
                Spot::ScaleX => self.axes.scale_c(AxisName::X),
                Spot::ScaleY => self.axes.scale_c(AxisName::Y),
                Spot::ScaleZ => self.axes.scale_c(AxisName::Z),
                // A scenario with a thermometer on a spindle has one.
                on_spindle => spindle.map_or(f64::NAN, |it| on(&it, on_spindle)),
            };
            thermometer.step(dt_s, spot_c);
        }
    }

    /// One row.
    fn write(&mut self, run: u32, leg: &Leg, table: &mut Table) {
        table.push("time_s", 3, self.time_s);
        table.push("run", 0, f64::from(run));
        if let Some(sensor) = &mut self.sensor {
            let coil_c = self.spindle.as_ref().map_or(f64::NAN, |it| it.temperatures().coil_c);
            table.push("sensor_counts", 0, sensor.read(coil_c, leg.spindle_rpm != 0.0));
        }
        if self.spindle.is_some() {
            table.push("spindle_rpm", 3, leg.spindle_rpm);
            table.push("load_n", 3, leg.load_n);
        }
        for (column, thermometer) in &mut self.thermometers {
            // Four decimals hold a sixteenth of a kelvin exactly.
            table.push(column, 4, thermometer.read());
        }
        let position_mm = self.axes.position_mm();
        if self.has_positions {
            for (name, mm) in NAMES.iter().zip(position_mm) {
                table.push(&format!("{name}_mm"), 4, mm);
            }
            for (name, direction) in NAMES.iter().zip(self.axes.directions()) {
                table.push(&format!("dir_{name}"), 0, direction);
            }
        }
        let elongation_um = self.growth().at_tip_um();
        let error_um = self.axes.error_um();
        for (quantity, instrument) in &mut self.instruments {
            let (value_um, reading_um) = match *quantity {
                Quantity::Elongation => (elongation_um, elongation_um),
                on_axis => {
                    let axis = on_axis as usize - 1;
                    let value_um = error_um[axis] + elongation_um * self.tool_direction[axis];
                    (value_um, position_mm[axis] * 1000.0 + value_um)
                }
            };
            let shown_um = instrument.read(self.time_s, value_um, reading_um);
            table.push(&format!("measured_{}_um", quantity.name()), 4, shown_um);
        }
    }
}

/// The temperature at a spot on the spindle; NaN for one that is elsewhere.
fn on(spindle: &SpindleTemperatures, spot: Spot) -> f64 {
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
