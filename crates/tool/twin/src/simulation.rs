//! A scenario that is run: truth steps on, sensors and instruments look at it, rows are written.
//!
//! ```text
//! path ─► machine ─► sensor_counts, temp_<name>_c
//!            └─► elongation, tip error ─► instruments ─► measured_<quantity>_um
//! ```

use crate::{
    axes::AXIS_NAMES,
    instrument::Instrument,
    machine::{DriveCommand, SimulatedMachine},
    path::{PathLeg, build_legs},
    run_table::RunTable,
    scenario::{MeasuredQuantity, Scenario},
};

/// Returns what the virtual machine tool measures in `scenario` under `seed`, in the form of a run file.
/// `row_done` learns of every row.
#[must_use]
pub fn simulate(scenario: &Scenario, seed: u64, mut row_done: impl FnMut()) -> RunTable {
    let mut run = Simulation::new(scenario, seed);
    let mut table = RunTable::new();
    let Scenario { segment, repeat, start_mm, interval_s, .. } = scenario;
    let legs = build_legs(segment, *repeat, *start_mm, *interval_s, seed);
    for leg in &legs {
        run.simulate_leg(leg);
        if let Some(number) = leg.row_of_run {
            run.append_row(number, leg, &mut table);
            row_done();
        }
    }
    table
}

/// The machine, and those who measure it.
struct Simulation<'s> {
    scenario: &'s Scenario,
    machine: SimulatedMachine,
    has_positions: bool,
    has_tools: bool,
    instruments: Vec<(MeasuredQuantity, Instrument)>,
}

impl<'s> Simulation<'s> {
    fn new(scenario: &'s Scenario, seed: u64) -> Self {
        let instruments = scenario.measure.iter().map(|&quantity| {
            let config = &scenario.instrument;
            (quantity, Instrument::new(config, quantity.name(), seed))
        });
        Self {
            scenario,
            machine: SimulatedMachine::new(scenario, seed),
            has_positions: scenario
                .measure
                .iter()
                .any(|quantity| *quantity != MeasuredQuantity::Elongation)
                || scenario
                    .segment
                    .iter()
                    .any(|segment| segment.to_mm.is_some() || segment.axis.is_some()),
            has_tools: scenario.segment.iter().any(|segment| segment.tool.is_some()),
            instruments: instruments.collect(),
        }
    }

    /// Goes along `leg`, in steps that are short enough.
    fn simulate_leg(&mut self, leg: &PathLeg) {
        let parts = (leg.seconds / self.scenario.step_s).ceil();
        let from_mm = self.machine.axes().position_mm();
        let mut part = 0.0;
        while part < parts {
            part += 1.0;
            let share = part / parts;
            let on_way = |i: usize| from_mm[i] + (leg.to_mm[i] - from_mm[i]) * share;
            // Its end exactly: a last digit that the next leg takes back would be a reversal.
            let position_mm = if part < parts { [0, 1, 2].map(on_way) } else { leg.to_mm };
            let PathLeg { spindle_rpm, load_n, tool, .. } = *leg;
            let command =
                DriveCommand { position_mm, spindle_rpm, load_n, tool, ..DriveCommand::default() };
            self.machine.step(leg.seconds / parts, &command);
        }
    }

    /// Writes one row: what is measured at the end of `leg`.
    fn append_row(&mut self, run: u32, leg: &PathLeg, table: &mut RunTable) {
        table.push_value("time_s", 3, self.machine.time_s());
        table.push_value("run", 0, f64::from(run));
        if let Some(counts) = self.machine.read_sensor_counts() {
            table.push_value("sensor_counts", 0, counts);
        }
        if self.machine.has_spindle() {
            table.push_value("spindle_rpm", 3, leg.spindle_rpm);
            table.push_value("load_n", 3, leg.load_n);
        }
        if self.has_tools {
            table.push_value("tool", 0, leg.tool.into());
        }
        for (column, shown_c) in self.machine.read_temperatures_c() {
            // Four decimals hold a sixteenth of a kelvin exactly.
            table.push_value(column, 4, shown_c);
        }
        let position_mm = self.machine.axes().position_mm();
        if self.has_positions {
            for (name, mm) in AXIS_NAMES.iter().zip(position_mm) {
                table.push_value(&format!("{name}_mm"), 4, mm);
            }
            for (name, direction) in AXIS_NAMES.iter().zip(self.machine.axes().directions()) {
                table.push_value(&format!("dir_{name}"), 0, direction);
            }
        }
        for axis in &self.scenario.head {
            table.push_value(axis.angle_column(), 4, 0.0);
        }
        let elongation_um = self.machine.elongation_um();
        let error_um = self.machine.tip_error_um();
        for (quantity, instrument) in &mut self.instruments {
            let (value_um, reading_um) = match *quantity {
                MeasuredQuantity::Elongation => (elongation_um, elongation_um),
                on_axis => {
                    let axis = on_axis as usize - 1;
                    let value_um = error_um[axis];
                    (value_um, position_mm[axis] * 1000.0 + value_um)
                }
            };
            let shown_um = instrument.read(self.machine.time_s(), value_um, reading_um);
            table.push_value(&format!("measured_{}_um", quantity.name()), 4, shown_um);
        }
    }
}
