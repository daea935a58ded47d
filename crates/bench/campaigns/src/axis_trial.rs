//! An axis that may be sent where one likes, with one thing wrong in the file that its user believes: what a plan for
//! the next measurement is tried on.
//!
//! The axis is that of [`trueup_twin::machine`]: a screw of a metre that warms by being moved, in a hall a few kelvin above
//! the temperature at which the axis is right. Every run is of another morning, cold, with the same truth.

use std::path::Path;

use trueup_twin::{
    instrument::Instrument,
    machine::{DriveCommand, SimulatedMachine},
    noise::RandomStream,
    run_table::RunTable,
    scenario::Scenario,
};

/// The travel in mm.
pub const AXIS_TRAVEL_MM: [f64; 2] = [0.0, 1000.0];
/// The longest step of the simulation, in s.
const MAX_TIME_STEP_S: f64 = 1.0;
/// Expansion of the screw in µm/(m·K).
const SCREW_EXPANSION_UM_PER_M_PER_C: f64 = 11.5;

/// The error in the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AxisFileDefect {
    /// The screw's expansion is not in it.
    Expansion,
    /// The screw's pitch is not what its drawing says.
    Scale,
    /// The screw grows more by a kelvin than the file says.
    Slope,
    /// The axis is right at another temperature than the file says.
    Reference,
    /// The backlash is not in it.
    Backlash,
    /// Nor is it, and it grows along the axis.
    BacklashAlong,
}

/// Something that is done.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TrialStep {
    /// The axis goes there, in mm, at a feed in mm/min.
    MoveTo(f64, f64),
    /// The axis stands for this many seconds and is read at their end.
    Read(f64),
    /// The axis stands for this many seconds.
    Wait(f64),
}

/// The machine.
#[derive(Clone, Debug)]
pub struct AxisTrial {
    seed: u64,
    /// The error in the file.
    pub wrong: AxisFileDefect,
    /// The machine file (TOML) that the user believes.
    pub machine: String,
    scenario: Scenario,
}

impl AxisTrial {
    /// Returns the machine number `seed`.
    ///
    /// # Panics
    /// Never: its scenario is one.
    #[must_use]
    pub fn from_seed(seed: u64) -> Self {
        let mut stream = RandomStream::new(seed, "axis trial");
        let wrong = stream.choose(&[
            AxisFileDefect::Expansion,
            AxisFileDefect::Scale,
            AxisFileDefect::Slope,
            AxisFileDefect::Reference,
            AxisFileDefect::Backlash,
            AxisFileDefect::BacklashAlong,
        ]);
        let size = stream.log_uniform(0.3, 1.0);
        let hall_c = stream.uniform(21.5, 24.0);
        let only = |which: AxisFileDefect, value: f64| if wrong == which { value } else { 0.0 };
        let slope =
            SCREW_EXPANSION_UM_PER_M_PER_C * (1.0 + only(AxisFileDefect::Slope, 0.5 * size));
        let reference_c = 20.0 + only(AxisFileDefect::Reference, 3.0 * size);
        let scale = only(AxisFileDefect::Scale, 40.0 * size);
        let width = only(AxisFileDefect::Backlash, 12.0 * size)
            + only(AxisFileDefect::BacklashAlong, 4.0 * size);
        let along = only(AxisFileDefect::BacklashAlong, 8.0 * size);
        // Who knows nothing of the screw's heat, or of its scale, has a file without it.
        let is_bare = matches!(wrong, AxisFileDefect::Expansion | AxisFileDefect::Scale);
        let thermal = format!(
            "[axis.x.thermal]\nmode = \"position\"\nsensor = \"temp_screw_c\"\nreference_c = 20.0\n\
             slope_um_per_m_per_c = {SCREW_EXPANSION_UM_PER_M_PER_C:?}\n"
        );
        // A screw that is not believed to grow does not, where its scale alone is wrong.
        let slope = if wrong == AxisFileDefect::Scale { 0.0 } else { slope };
        let scenario = format!(
            "name = \"axis trial\"\nmeasure = [\"dx\"]\n\
             [ambient]\nmean_c = {hall_c:?}\nwander_c = 0.1\n\
             [thermometer.screw]\nat = \"screw_x\"\nnoise_c = 0.02\n\
             [thermometer.bed]\nat = \"ambient\"\nlag_s = 3600.0\nnoise_c = 0.02\n\
             [axis.x]\nscrew_um_per_m_per_c = {slope:?}\nreference_c = {reference_c:?}\n\
             pitch_um_per_m = {scale:?}\nbacklash_um = {width:?}\nbacklash_um_per_m = {along:?}\n\
             [instrument]\nnoise_um = 0.3\ncorrelated_um = 0.1\n\
             [[segment]]\nkind = \"spindle\"\nduration_s = 60.0\n"
        );
        Self {
            seed,
            wrong,
            machine: format!(
                "[machine]\nname = \"axis trial\"\nkind = \"3-axis\"\n[axis.x]\ntravel_mm = {AXIS_TRAVEL_MM:?}\n{}",
                if is_bare { "" } else { &thermal }
            ),
            scenario: Scenario::parse(&scenario, Path::new("axis-trial.toml"))
                .expect("the trial's own scenario"),
        }
    }

    /// Returns the record (CSV) of the morning `day`, and how many minutes it took.
    #[must_use]
    pub fn simulate_day(&self, acts: &[TrialStep], day: u64) -> (String, f64) {
        let seed = self.seed.wrapping_mul(1000).wrapping_add(day);
        let mut machine = SimulatedMachine::new(&self.scenario, seed);
        let mut instrument = Instrument::new(&self.scenario.instrument, "dx", seed);
        let mut at_mm = self.scenario.start_mm[0];
        let mut direction = 0.0;
        let mut feed = 0.0;
        let mut table = RunTable::new();
        for act in acts {
            let (to_mm, seconds) = match *act {
                TrialStep::MoveTo(to_mm, feed_mm_per_min) => {
                    feed = feed_mm_per_min;
                    (to_mm, 60.0 * (to_mm - at_mm).abs() / feed_mm_per_min)
                }
                TrialStep::Read(seconds) | TrialStep::Wait(seconds) => (at_mm, seconds),
            };
            if to_mm != at_mm {
                direction = (to_mm - at_mm).signum();
            }
            let steps = (seconds / MAX_TIME_STEP_S).ceil().max(1.0);
            for step in 1..=steps as u32 {
                let share = f64::from(step) / steps;
                let x_mm = at_mm + share * (to_mm - at_mm);
                let position_mm = [x_mm, 0.0, 0.0];
                let command = DriveCommand { position_mm, ..DriveCommand::default() };
                machine.step((seconds / steps).max(1e-3), &command);
            }
            at_mm = to_mm;
            if matches!(act, TrialStep::Read(_)) {
                let error_um = machine.tip_error_um()[0];
                table.push_value("time_s", 1, machine.time_s());
                table.push_value("x_mm", 3, at_mm);
                table.push_value("dir_x", 0, direction);
                table.push_value("feed_mm_per_min", 0, feed);
                for (name, celsius) in machine.read_temperatures_c() {
                    table.push_value(name, 2, celsius);
                }
                table.push_value(
                    "measured_dx_um",
                    2,
                    instrument.read(machine.time_s(), error_um, at_mm),
                );
            }
        }
        (table.to_csv(), machine.time_s() / 60.0)
    }
}
