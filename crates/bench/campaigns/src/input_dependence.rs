//! Days of a mill whose tool is off by a law that no list of causes has: of a switch, a tool, a pressure, two
//! temperatures, or a range of the speed.
//!
//! A spindle grows by its speed, a sensor reads that right, and what is measured next to it has one more effect of
//! recorded inputs. Six switches and six amounts are recorded; those that the effect does not depend on are idle. Both
//! days follow the same law; all inputs change often enough on each to show it.

use std::fmt::Write as _;

use trueup_twin::noise::RandomStream;

/// Rows of a day, and s from one to the next.
const ROWS_PER_DAY: usize = 320;
const SAMPLE_INTERVAL_S: f64 = 60.0;
/// Noise of the gauge in µm.
const GAUGE_NOISE_UM: f64 = 0.4;
/// µm of the sensor for one count, and its count at 0 µm.
const SENSOR_UM_PER_COUNT: f64 = 0.015_258_789_062_5;
const SENSOR_ZERO_COUNTS: f64 = 5048.0;
/// Speeds of the spindle in r/min, two of them about the bound of the ranges.
const SPINDLE_SPEEDS_RPM: [f64; 9] =
    [0.0, 3000.0, 6000.0, 8000.0, 10_000.0, 11_000.0, 14_000.0, 18_000.0, 24_000.0];
/// The bound of the ranges of the speed in r/min.
const SPEED_RANGE_LIMIT_RPM: f64 = 10_500.0;

/// A hidden law: its name, and the columns that it depends on.
#[derive(Clone, Copy, Debug)]
pub struct DependenceKind {
    /// For the table of a campaign.
    pub name: &'static str,
    /// Columns of the run file.
    pub columns: &'static [&'static str],
    law: fn(&InputState) -> f64,
}

/// All kinds; the first hides nothing.
pub const DEPENDENCE_KINDS: &[DependenceKind] = &[
    dependence_kind("nothing", &[], |_| 0.0),
    dependence_kind("switch", &["door_open"], |s| 4.0 * s.switches[0]),
    dependence_kind("late switch", &["door_open"], |s| 6.0 * s.late_door),
    dependence_kind("line", &["coolant_bar"], |s| 0.2 * s.amounts[0]),
    dependence_kind("late line", &["coolant_bar"], |s| 0.35 * s.late_bar),
    dependence_kind("curve", &["coolant_bar"], |s| {
        7.0 * (1.0 - (-(s.amounts[0] - 2.0) / 12.0).exp())
    }),
    dependence_kind("hinge", &["coolant_bar"], |s| 0.4 * (s.amounts[0] - 35.0).max(0.0)),
    dependence_kind("range", &["coolant_bar"], |s| if s.amounts[0] > 38.3 { 5.0 } else { 0.0 }),
    dependence_kind("tool", &["tool"], |s| [4.0, 0.0, -3.0][s.tool]),
    dependence_kind("tool by speed", &["tool", "spindle_rpm"], |s| {
        [0.03, 0.0, 0.012][s.tool] * s.speed_squared_krpm2()
    }),
    dependence_kind("tool by pressure", &["tool", "coolant_bar"], |s| {
        [0.1, 0.0, -0.15][s.tool] * s.amounts[0]
    }),
    dependence_kind("one tool and heat", &["tool", "temp_room_c"], |s| {
        if s.tool == 2 { 3.0 * (s.room_c - 20.0) } else { 0.0 }
    }),
    dependence_kind("switch by growth", &["chiller_on"], |s| 0.3 * s.grown_um * s.switches[1]),
    dependence_kind("heat while off", &["chiller_on", "temp_room_c"], |s| {
        3.0 * (s.room_c - 20.0) * (1.0 - s.switches[1])
    }),
    dependence_kind("pressure by speed", &["coolant_bar", "spindle_rpm"], |s| {
        3e-4 * s.amounts[0] * s.speed_squared_krpm2()
    }),
    dependence_kind("product", &["coolant_bar", "air_flow"], |s| {
        0.03 * s.amounts[0] * (s.amounts[1] - 3.0)
    }),
    dependence_kind("bend over a temperature", &["temp_room_c"], |s| {
        4.0 * (s.room_c - 21.0).max(0.0)
    }),
    dependence_kind("difference", &["temp_left_c", "temp_right_c"], |s| {
        2.5 * (s.left_c - s.right_c)
    }),
    dependence_kind("late difference", &["temp_left_c", "temp_right_c"], |s| {
        4.0 * s.late_difference_c
    }),
    dependence_kind("speed range", &["spindle_rpm"], |s| {
        if s.rpm > SPEED_RANGE_LIMIT_RPM { 4.0 } else { 0.0 }
    }),
    dependence_kind("growth in a speed range", &["spindle_rpm"], |s| {
        if s.rpm > SPEED_RANGE_LIMIT_RPM { 0.02 * s.speed_squared_krpm2() } else { 0.0 }
    }),
    dependence_kind("bend over the speed", &["spindle_rpm"], |s| {
        0.8 * ((s.rpm - SPEED_RANGE_LIMIT_RPM) / 1000.0).max(0.0)
    }),
];

const fn dependence_kind(
    name: &'static str,
    columns: &'static [&'static str],
    law: fn(&InputState) -> f64,
) -> DependenceKind {
    DependenceKind { name, columns, law }
}

/// A machine file and two days.
#[derive(Clone, Debug)]
pub struct TrainingAndTestDays {
    /// The user's machine file: a sensor that reads the growth right.
    pub machine: String,
    /// A run file to learn from.
    pub first: String,
    /// Another day.
    pub second: String,
}

/// Names of the switches (0, 1) and of the amounts.
const SWITCH_COLUMN_NAMES: [&str; 6] =
    ["door_open", "chiller_on", "mist_on", "clamp_closed", "air_on", "pallet_in"];
const CONTINUOUS_INPUT_NAMES: [&str; 6] =
    ["coolant_bar", "air_flow", "humidity", "oil_bar", "supply_v", "vibration"];
/// Their means, standard deviations and memories in rows.
const CONTINUOUS_INPUT_STATISTICS: [[f64; 3]; 6] = [
    [32.0, 14.0, 16.0],
    [5.0, 1.5, 10.0],
    [50.0, 4.0, 50.0],
    [60.0, 2.0, 30.0],
    [230.0, 2.0, 5.0],
    [1.0, 0.2, 3.0],
];

/// All inputs at one row.
#[derive(Clone, Debug)]
struct InputState {
    rpm: f64,
    grown_um: f64,
    tool: usize,
    switches: [f64; 6],
    amounts: [f64; 6],
    room_c: f64,
    left_c: f64,
    right_c: f64,
    hall_c: f64,
    late_door: f64,
    late_bar: f64,
    late_difference_c: f64,
}

impl InputState {
    /// Returns the square of the speed, in (1000 r/min)².
    fn speed_squared_krpm2(&self) -> f64 {
        (self.rpm / 1000.0).powi(2)
    }

    /// Returns the morning of a day: all lags have settled.
    fn draw_steady_state(chance: &mut RandomStream) -> Self {
        let amounts = CONTINUOUS_INPUT_STATISTICS.map(|[mean, ..]| mean);
        let warm_c = 20.0 + chance.uniform(-1.0, 1.0);
        Self {
            rpm: 0.0,
            grown_um: 0.0,
            tool: chance.uniform_integer(0, 2),
            switches: std::array::from_fn(|_| f64::from(u8::from(chance.bernoulli(0.5)))),
            amounts,
            room_c: warm_c,
            left_c: warm_c,
            right_c: warm_c,
            hall_c: warm_c,
            late_door: f64::NAN,
            late_bar: f64::NAN,
            late_difference_c: f64::NAN,
        }
    }

    /// A row later; `taus_s` are the time constants of what is late.
    fn step(&mut self, chance: &mut RandomStream, taus_s: [f64; 3]) {
        for switch in &mut self.switches {
            if chance.bernoulli(0.045) {
                *switch = 1.0 - *switch;
            }
        }
        if chance.bernoulli(0.06) {
            self.tool = chance.uniform_integer(0, 2);
        }
        if chance.bernoulli(0.07) {
            self.rpm = chance.choose(&SPINDLE_SPEEDS_RPM);
        }
        for (amount, [mean, deviation, rows]) in
            self.amounts.iter_mut().zip(CONTINUOUS_INPUT_STATISTICS)
        {
            let stays = (-1.0 / rows).exp();
            let new = deviation * (1.0 - stays * stays).sqrt() * chance.standard_normal();
            *amount = mean + stays * (*amount - mean) + new;
        }
        self.amounts[0] = self.amounts[0].clamp(2.0, 70.0);
        let rooms = [&mut self.room_c, &mut self.left_c, &mut self.right_c, &mut self.hall_c];
        for (room_c, (mean_c, back, noise_c)) in rooms.into_iter().zip([
            (21.0, 0.02, 0.16),
            (22.0, 0.03, 0.15),
            (22.0, 0.03, 0.15),
            (21.0, 0.02, 0.1),
        ]) {
            *room_c += back * (mean_c - *room_c) + noise_c * chance.standard_normal();
        }
        self.grown_um += (self.rpm / 400.0 - self.grown_um) / 40.0;
        let late = [&mut self.late_door, &mut self.late_bar, &mut self.late_difference_c];
        let now = [self.switches[0], self.amounts[0], self.left_c - self.right_c];
        for ((late, now), tau_s) in late.into_iter().zip(now).zip(taus_s) {
            let share = 1.0 - (-SAMPLE_INTERVAL_S / tau_s).exp();
            *late = if late.is_nan() { now } else { *late + share * (now - *late) };
        }
    }
}

/// Draws the two days of `kind`.
#[must_use]
pub fn draw(kind: DependenceKind, seed: u64) -> TrainingAndTestDays {
    let mut chance = RandomStream::new(seed, kind.name);
    let size = chance.random_sign() * chance.uniform(0.8, 1.4);
    let taus_s = [
        chance.uniform(400.0, 1500.0),
        chance.uniform(600.0, 2400.0),
        chance.uniform(600.0, 2400.0),
    ];
    let mut day = || {
        let mut csv = String::from(
            "time_s,sensor_counts,spindle_rpm,tool,temp_room_c,temp_left_c,temp_right_c,temp_hall_c",
        );
        SWITCH_COLUMN_NAMES
            .iter()
            .chain(&CONTINUOUS_INPUT_NAMES)
            .for_each(|name| csv.extend([",", name]));
        csv.push_str(",measured_elongation_um\n");
        let mut state = InputState::draw_steady_state(&mut chance);
        for row in 0..ROWS_PER_DAY {
            state.step(&mut chance, taus_s);
            let counts = (SENSOR_ZERO_COUNTS
                + state.grown_um / SENSOR_UM_PER_COUNT
                + 3.0 * chance.standard_normal())
            .round();
            let measured_um = state.grown_um
                + size * (kind.law)(&state)
                + GAUGE_NOISE_UM * chance.standard_normal();
            let _ = write!(
                csv,
                "{},{counts},{},{},{:.2},{:.2},{:.2},{:.2}",
                SAMPLE_INTERVAL_S * row as f64,
                state.rpm,
                state.tool + 1,
                state.room_c,
                state.left_c,
                state.right_c,
                state.hall_c
            );
            for value in state.switches {
                let _ = write!(csv, ",{value}");
            }
            for value in state.amounts {
                let _ = write!(csv, ",{value:.2}");
            }
            let _ = writeln!(csv, ",{measured_um:.3}");
        }
        csv
    };
    let (first, second) = (day(), day());
    let machine = format!(
        "[machine]\nname = \"mill\"\nkind = \"3-axis\"\n[spindle]\nsource = \"sensor\"\n[spindle.sensor]\n\
         k0_um = 0.0\nzero_counts = {SENSOR_ZERO_COUNTS:?}\num_per_count = {SENSOR_UM_PER_COUNT:?}\n"
    );
    TrainingAndTestDays { machine, first, second }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn days_are_drawn_again_to_the_byte_and_differ_from_each_other() {
        let [a, b] = [draw(DEPENDENCE_KINDS[1], 3), draw(DEPENDENCE_KINDS[1], 3)];
        assert_eq!((&a.first, &a.second), (&b.first, &b.second));
        assert_ne!(a.first, a.second);
        assert_ne!(a.first, draw(DEPENDENCE_KINDS[1], 4).first);
        for kind in DEPENDENCE_KINDS {
            let days = draw(*kind, 1);
            let head = days.first.lines().next().unwrap_or_default();
            assert!(kind.columns.iter().all(|column| head.split(',').any(|name| name == *column)));
        }
    }
}
