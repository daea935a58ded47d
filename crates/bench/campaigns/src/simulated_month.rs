//! A month of a machine that ages: what `trueup learn` is tried on.
//!
//! A spindle grows with its front bearing, late, with its column, at once, and with the square of its
//! speed. The machine file is right about it on the first day. Then, in a month that ages,
//!
//! ```text
//! s = a(t)·lag₉₀₀(T_front − 20) + b(t)·(T_column − 20) + c·(n/1000)² + what wanders
//! a, b       grow by 30 % over the month: a straight line plus a random walk
//! bearing    replaced on a day: it runs cooler, and what the front grows by a kelvin jumps
//! sensor     the front's thermometer is moved away from the heat on another day: it shows a share only
//! ```
//!
//! In a month without a fault none of this happens. In both the machine works from seven to five on five
//! days a week and stands still on the others, is switched off now and then and is homed a little
//! elsewhere, and probes its tool every half hour; one reading in twenty is bad: a chip, coolant, a
//! tool that slipped. On every fourth day of work nothing is probed: these days say what was learned.

use trueup_twin::{
    noise::{CorrelatedNoise, RandomStream},
    run_table::RunTable,
};

/// The seeds that the learner is judged by. They and this file are older than the learner.
pub const EVALUATION_SEEDS: std::ops::Range<u64> = 0..20;

/// Days of the month.
const DAYS_PER_MONTH: usize = 30;
/// Days of work in the middle of the month on which it is probed.
const PROBED_DAYS: [usize; 8] = [7, 9, 10, 11, 15, 16, 17, 21];
/// Minutes from one probing to the next.
const PROBE_INTERVAL_MIN: usize = 30;
/// The spindle's rated speed in r/min.
const RATED_SPEED_RPM: f64 = 24_000.0;
/// Growth by a kelvin of the front bearing and of the column, and at 1000 r/min, on the first day.
const FRONT_BEARING_GROWTH_UM_PER_C: f64 = 5.0;
const COLUMN_EXPANSION_UM_PER_C: f64 = 1.5;
const CENTRIFUGAL_GROWTH_UM_PER_KRPM2: f64 = 0.02;
/// By how much the growth by a kelvin has grown when the month is over.
const RELATIVE_GROWTH_INCREASE_PER_MONTH: f64 = 0.3;

/// The user's machine file, and the days of work.
#[derive(Clone, Debug)]
pub struct SimulatedMonth {
    /// The machine file (TOML), right on the first day.
    pub machine: String,
    /// The days of work, in their order.
    pub days: Vec<WorkDay>,
}

/// A day of work, a row a minute.
#[derive(Clone, Debug)]
pub struct WorkDay {
    /// The run file (CSV): clock, speed, temperatures, and what was probed.
    pub csv: String,
    /// The growth at the tool in each row, in µm.
    pub truth_um: Vec<f64>,
    /// Whether the spindle turns in the row: where it stands there is no work.
    pub works: Vec<bool>,
    /// Whether it was probed.
    pub is_probed: bool,
    /// How many of its readings are bad.
    pub bad: usize,
}

/// The true parameters of the machine at a time.
struct TrueParameters {
    front_um_per_c: f64,
    column_um_per_c: f64,
    /// How warm the front bearing becomes at the rated speed, in K.
    heat_c: f64,
    /// The share of its rise over the air that the front's thermometer shows.
    shown: f64,
}

/// Returns the month of `seed`, of a machine that ages or of one without a fault.
#[must_use]
pub fn simulate_month(seed: u64, ages: bool) -> SimulatedMonth {
    let mut stream = RandomStream::new(seed, "month");
    // Who repairs a machine probes it on the same day: of one that was not measured since nothing can
    // be known.
    let bearing_day = stream.choose(&PROBED_DAYS[..4]);
    let bearing = [stream.uniform(0.65, 0.85), stream.uniform(0.9, 1.1)];
    let moved_day = stream.choose(&PROBED_DAYS[4..]);
    let moved = stream.uniform(0.8, 0.9);
    let mut walk = [0.0; 2];
    let mut wander = CorrelatedNoise::new(RandomStream::new(seed, "month wander"), 0.6, 0.0);
    let mut probe = RandomStream::new(seed, "month probe");
    let mut zero_um = 0.0;
    let mut days = Vec::new();
    for day in 0..DAYS_PER_MONTH {
        for walk in &mut walk {
            *walk += 0.01 * stream.standard_normal();
        }
        if day % 7 >= 5 {
            continue;
        }
        let is_probed = days.len() % 4 != 2;
        let past = day as f64 / DAYS_PER_MONTH as f64;
        let aged = |walk: f64| {
            if ages { 1.0 + RELATIVE_GROWTH_INCREASE_PER_MONTH * past + walk } else { 1.0 }
        };
        let has_bearing = ages && day >= bearing_day;
        let truth = TrueParameters {
            front_um_per_c: FRONT_BEARING_GROWTH_UM_PER_C
                * aged(walk[0])
                * if has_bearing { bearing[1] } else { 1.0 },
            column_um_per_c: COLUMN_EXPANSION_UM_PER_C * aged(walk[1]),
            heat_c: 30.0 * if has_bearing { bearing[0] } else { 1.0 },
            shown: if ages && day >= moved_day { moved } else { 1.0 },
        };
        days.push(simulate_day(
            day,
            is_probed,
            &truth,
            &mut zero_um,
            &mut stream,
            &mut wander,
            &mut probe,
        ));
    }
    let machine = format!(
        "[machine]\nname = \"month\"\nkind = \"3-axis\"\n\n[spindle]\nsource = \"temperature\"\n\n\
         [spindle.temperature]\nsensor = \"temp_front_c\"\nreference_c = 20.0\n\
         k_um_per_c = {FRONT_BEARING_GROWTH_UM_PER_C:?} # by the maker's data\nlag_s = 900.0\n\n\
         [[term]]\ncause = \"extra-heat-path\"\nquantity = \"elongation\"\ncolumn = \"temp_column_c\"\n\
         um_per_c = {COLUMN_EXPANSION_UM_PER_C:?}\ntime_constant_s = 0.0\nreference_c = 20.0\n\n\
         [[term]]\ncause = \"centrifugal-growth\"\nquantity = \"elongation\"\n\
         um_per_krpm2 = {CENTRIFUGAL_GROWTH_UM_PER_KRPM2}\n"
    );
    SimulatedMonth { machine, days }
}

/// Simulates one day, from seven in the morning on.
fn simulate_day(
    day: usize,
    is_probed: bool,
    truth: &TrueParameters,
    zero_um: &mut f64,
    stream: &mut RandomStream,
    wander: &mut CorrelatedNoise,
    probe: &mut RandomStream,
) -> WorkDay {
    const WORKDAY_MINUTES: usize = 600;
    let air_c = stream.uniform(20.0, 23.0);
    let off_at = if stream.bernoulli(0.2) { stream.uniform_integer(120, 480) } else { usize::MAX };
    let off_for = stream.uniform_integer(5, 15);
    let (mut front_c, mut column_c, mut followed_c) = (air_c, air_c, None);
    let (mut rpm, mut until) = (0.0, 0);
    let mut it =
        WorkDay { csv: String::new(), truth_um: Vec::new(), works: Vec::new(), is_probed, bad: 0 };
    let mut table = RunTable::new();
    for minute in 0..WORKDAY_MINUTES {
        if minute >= until {
            rpm = if stream.bernoulli(0.15) {
                0.0
            } else {
                1000.0 * stream.uniform_integer(6, 24) as f64
            };
            until = minute + stream.uniform_integer(10, 50);
        }
        let is_off = (off_at..off_at.saturating_add(off_for)).contains(&minute);
        if minute == off_at {
            *zero_um = 0.5 * stream.standard_normal();
        }
        let turning_rpm = if is_off { 0.0 } else { rpm };
        let ambient_c = air_c + 1.5 * (minute as f64 / 600.0 * std::f64::consts::PI).sin();
        let load = (turning_rpm / RATED_SPEED_RPM).powf(1.2);
        step_lag_by_one_minute(&mut front_c, ambient_c + truth.heat_c * load, 2400.0);
        step_lag_by_one_minute(&mut column_c, ambient_c + 12.0 * load, 5400.0);
        let wandered_um = wander.draw_correlated((-60.0_f64 / 3600.0).exp());
        if is_off {
            continue;
        }
        // The thermometers, as they are written down: the day is what they say.
        let hundredth = |c: f64| (c * 100.0).round() / 100.0;
        let front_shown_c = hundredth(ambient_c + truth.shown * (front_c - ambient_c));
        let column_shown_c = hundredth(column_c);
        let settled_c = hundredth(front_c);
        // After a stop the bearing has gone on cooling in the meantime.
        let gap_min = if minute == off_at.saturating_add(off_for) { off_for + 1 } else { 1 };
        let followed = followed_c.get_or_insert(settled_c);
        let left = (-60.0 * gap_min as f64 / 900.0).exp();
        *followed = settled_c + (*followed - settled_c) * left;
        let krpm = turning_rpm / 1000.0;
        let um = truth.front_um_per_c * (*followed - 20.0)
            + truth.column_um_per_c * (column_shown_c - 20.0)
            + CENTRIFUGAL_GROWTH_UM_PER_KRPM2 * krpm * krpm
            + wandered_um
            + *zero_um;
        let mut read_um = f64::NAN;
        if minute % PROBE_INTERVAL_MIN == PROBE_INTERVAL_MIN - 1 && is_probed {
            read_um = um + 0.8 * probe.standard_normal();
            if probe.bernoulli(0.05) {
                read_um += probe.random_sign() * probe.uniform(8.0, 60.0);
                it.bad += 1;
            }
        }
        table.push_value("time_s", 0, (day * 86_400 + 7 * 3600 + minute * 60) as f64);
        table.push_value("spindle_rpm", 0, turning_rpm);
        table.push_value("temp_front_c", 2, front_shown_c);
        table.push_value("temp_column_c", 2, column_shown_c);
        table.push_value("measured_elongation_um", 2, read_um);
        it.truth_um.push(um);
        it.works.push(turning_rpm > 0.0);
    }
    it.csv = table.to_csv();
    it
}

/// A minute on the way to `to`, with this time constant in s.
fn step_lag_by_one_minute(value: &mut f64, to: f64, constant_s: f64) {
    *value = to + (*value - to) * (-60.0 / constant_s).exp();
}
