//! A year of a small shop: what `trueup learn` is judged by.
//!
//! ```text
//! spindle  s  = k(t)·lag₉₀₀(T_front − 20) + 1.5·(T_column − 20)      k another one after a new bearing
//! axis     dx = m(t)·(T_screw − 20)·x/1000 + w(t) where it comes from above    w from 4 to 9 µm over the year
//! reading     = error + step of the reference + drift of the probe + 2 µm of noise; 5 % are bad
//! ```
//!
//! The machine file is right on the first day. The hall goes from 15 °C in winter to 29 °C in summer; the machine works ten
//! hours on five days a week, and is probed twice a day. In a year with events a part is changed in spring, a thermometer
//! is moved in early summer (it shows a share of its rise over the air), and a crash moves the reference in autumn. The error of
//! a day does not contain the step: after a crash the tool is touched off again.

use std::f64::consts::TAU;

use trueup_twin::{
    noise::{CorrelatedNoise, RandomStream},
    run_table::RunTable,
};

/// A machine of the shop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MachineKind {
    /// A spindle that grows with its front bearing and its column.
    Spindle,
    /// An axis with a screw that warms, and a nut that wears.
    Axis,
}

/// The events and disturbances of a year, and the checks of the probe.
#[derive(Clone, Copy, Debug, Default)]
pub struct YearConfig {
    /// A part changed, a thermometer moved, a crash, wear.
    pub events: bool,
    /// The probe drifts by 6 µm a year.
    pub drift: bool,
    /// The probe is checked every fourth week.
    pub checks: bool,
}

/// An event of the year.
#[derive(Clone, Debug)]
pub struct PlannedEvent {
    /// The name that it should get.
    pub name: &'static str,
    /// The clock at which it happens, in s.
    pub at_s: f64,
    /// Its size: µm of a step, shares of a constant, the share that a thermometer shows.
    pub size: f64,
    /// By how much each reading after it differs from what is right for the state before it, in µm.
    pub effect_um: Vec<f64>,
}

/// A year.
#[derive(Clone, Debug)]
pub struct SimulatedYear {
    /// The machine file (TOML), right on the first day.
    pub machine: String,
    /// The quantity that is measured.
    pub quantity: &'static str,
    /// The days of work.
    pub days: Vec<SimulatedDay>,
    /// The events, in their order.
    pub events: Vec<PlannedEvent>,
}

/// A day of work, a row each ten minutes.
#[derive(Clone, Debug)]
pub struct SimulatedDay {
    /// The run file (CSV).
    pub csv: String,
    /// The error in each row, in µm.
    pub truth_um: Vec<f64>,
}

const SECONDS_PER_DAY: f64 = 86_400.0;
const ROW_INTERVAL_S: f64 = 600.0;
const ROWS_PER_DAY: usize = 60;
const PROBE_NOISE_UM: f64 = 2.0;
const OUTLIER_FRACTION: f64 = 0.05;
const FRONT_BEARING_GROWTH_UM_PER_C: f64 = 2.4;
const COLUMN_EXPANSION_UM_PER_C: f64 = 1.5;
const SCREW_EXPANSION_UM_PER_M_PER_C: f64 = 11.0;
const BACKLASH_WIDTH_UM: f64 = 4.0;
const WORN_BACKLASH_WIDTH_UM: f64 = 9.0;

/// Returns the year of `seed`; one reading in twenty is bad.
#[must_use]
pub fn simulate_year(seed: u64, kind: MachineKind, happens: YearConfig) -> SimulatedYear {
    simulate_year_with_outliers(seed, kind, happens, OUTLIER_FRACTION)
}

/// Returns the year of `seed`, of whose readings the share `bad` is bad.
#[must_use]
pub fn simulate_year_with_outliers(
    seed: u64,
    kind: MachineKind,
    happens: YearConfig,
    bad: f64,
) -> SimulatedYear {
    let is_spindle = kind == MachineKind::Spindle;
    let mut stream = RandomStream::new(seed, if is_spindle { "year spindle" } else { "year axis" });
    let mut probe = RandomStream::new(seed, "year probe");
    let mut wander = CorrelatedNoise::new(RandomStream::new(seed, "year wander"), 0.4, 0.0);
    let part = 1.0 + stream.random_sign() * stream.uniform(0.2, 0.3);
    let shown = stream.uniform(0.7, 0.8);
    let step_um = stream.random_sign() * stream.uniform(12.0, 20.0);
    let days_at =
        [(55, 100), (140, 190), (235, 285)].map(|(from, to)| stream.uniform_integer(from, to));
    let at = days_at.map(|day| day as f64 * SECONDS_PER_DAY);
    let mut year = SimulatedYear {
        machine: machine_file_toml(kind),
        quantity: if is_spindle { "elongation" } else { "dx" },
        days: Vec::new(),
        events: Vec::new(),
    };
    if happens.events {
        year.events = plan_events(at, [part - 1.0, shown, step_um]);
    }
    let is_after = |index: usize, day: usize| happens.events && day >= days_at[index];
    let mut next_check = 0;
    for day in (0..365).filter(|day| day % 7 < 5) {
        let mut truth_um = Vec::new();
        let mut table = RunTable::new();
        let probed = [stream.uniform_integer(6, 28), stream.uniform_integer(32, 58)];
        let hall_c =
            22.0 - 7.0 * (TAU * (day as f64 - 20.0) / 365.0).cos() + stream.standard_normal();
        let (mut rise_c, mut column_c, mut lagged_c) = (0.0, hall_c, None);
        let mut load = 0.5;
        for row in 0..ROWS_PER_DAY {
            let time_s = day as f64 * SECONDS_PER_DAY + 7.0 * 3600.0 + row as f64 * ROW_INTERVAL_S;
            let past_day = row as f64 / ROWS_PER_DAY as f64;
            let air_c = hall_c + 1.5 * (past_day * std::f64::consts::PI).sin();
            if row % 6 == 0 {
                load = if stream.bernoulli(0.15) { 0.0 } else { stream.uniform(0.3, 1.0) };
            }
            let full_load_c = if is_spindle { 24.0 } else { 12.0 };
            step_first_order_lag(&mut rise_c, full_load_c * load, 2400.0);
            step_first_order_lag(&mut column_c, air_c + 8.0 * load, 5400.0);
            let share = if is_after(1, day) { shown } else { 1.0 };
            let hundredth = |c: f64| (c * 100.0).round() / 100.0;
            let (hot_c, column) = (air_c + rise_c, hundredth(column_c));
            let shown_c = hundredth(air_c + share * rise_c);
            let part = if is_after(0, day) { part } else { 1.0 };
            let wandered_um = wander.draw_correlated(0.7);
            let past = day as f64 / 365.0;
            let (mut x_mm, mut direction) = (0.0, 1.0);
            let um = match kind {
                MachineKind::Spindle => {
                    let lagged = lagged_c.get_or_insert(hot_c);
                    step_first_order_lag(lagged, hot_c, 900.0);
                    part * FRONT_BEARING_GROWTH_UM_PER_C * (*lagged - 20.0)
                        + COLUMN_EXPANSION_UM_PER_C * (column - 20.0)
                }
                MachineKind::Axis => {
                    let is_probed = probed.contains(&row);
                    [x_mm, direction] = draw_position_and_direction(&mut stream, is_probed);
                    let worn = if happens.events { past } else { 0.0 };
                    part * SCREW_EXPANSION_UM_PER_M_PER_C * (hot_c - 20.0) * x_mm / 1000.0
                        + backlash_um(direction, worn)
                }
            } + wandered_um;
            let drift_um = if happens.drift { 6.0 * past } else { 0.0 };
            let zero_um = if is_after(2, day) { step_um } else { 0.0 };
            let mut read_um = f64::NAN;
            if probed.contains(&row) {
                read_um = simulate_reading(um + zero_um + drift_um, &mut probe, bad);
                let warm_c = lagged_c.unwrap_or(hot_c);
                let effects = event_effects_um(kind, x_mm, [warm_c, air_c], [part, shown, step_um]);
                for ((event, since), effect_um) in year.events.iter_mut().zip(days_at).zip(effects)
                {
                    if day >= since {
                        event.effect_um.push(effect_um);
                    }
                }
            }
            let mut check_um = f64::NAN;
            if happens.checks && day >= next_check && row == 2 {
                check_um = drift_um + 0.5 * probe.standard_normal();
                next_check = day + 28;
            }
            table.push_value("time_s", 0, time_s);
            push_input_values(&mut table, kind, [shown_c, column], [x_mm, direction]);
            table.push_value("temp_air_c", 2, hundredth(air_c));
            if happens.checks {
                table.push_value("check_um", 2, check_um);
            }
            table.push_value(&format!("measured_{}_um", year.quantity), 2, read_um);
            truth_um.push(um);
        }
        year.days.push(SimulatedDay { csv: table.to_csv(), truth_um });
    }
    year
}

/// Draws the position in mm at which an axis is read, and the direction from which it comes.
fn draw_position_and_direction(stream: &mut RandomStream, is_probed: bool) -> [f64; 2] {
    // The probe's references stand at two places; work is anywhere.
    let anywhere = (stream.uniform(0.0, 1000.0) / 10.0).round() * 10.0;
    let x_mm = if is_probed { stream.choose(&[400.0, 900.0]) } else { anywhere };
    [x_mm, stream.random_sign()]
}

/// Returns the backlash in µm of an axis that comes from `direction`, after the share `worn` of the wear of a year.
fn backlash_um(direction: f64, worn: f64) -> f64 {
    let width = BACKLASH_WIDTH_UM + worn * (WORN_BACKLASH_WIDTH_UM - BACKLASH_WIDTH_UM);
    if direction < 0.0 { width } else { 0.0 }
}

/// Returns the effect of each event on a reading in µm, from the temperatures of the part and of the air.
fn event_effects_um(
    kind: MachineKind,
    x_mm: f64,
    [warm_c, air_c]: [f64; 2],
    [part, shown, step_um]: [f64; 3],
) -> [f64; 3] {
    let per_c = match kind {
        MachineKind::Spindle => part * FRONT_BEARING_GROWTH_UM_PER_C,
        MachineKind::Axis => part * SCREW_EXPANSION_UM_PER_M_PER_C * x_mm / 1000.0,
    };
    let constant_um = per_c * (1.0 - 1.0 / part) * (warm_c - 20.0);
    [constant_um, per_c * (1.0 - shown) * (warm_c - air_c), step_um]
}

/// Reads a value as a probe does: with noise, and the share `bad` badly.
fn simulate_reading(um: f64, probe: &mut RandomStream, bad: f64) -> f64 {
    let read_um = um + PROBE_NOISE_UM * probe.standard_normal();
    if probe.bernoulli(bad) {
        read_um + probe.random_sign() * probe.uniform(10.0, 60.0)
    } else {
        read_um
    }
}

/// Returns the events of the year at these times.
fn plan_events(at: [f64; 3], sizes: [f64; 3]) -> Vec<PlannedEvent> {
    let names = ["constant-changed", "thermometer-moved", "zero-step"];
    let all = names.into_iter().zip(at).zip(sizes);
    all.map(|((name, at_s), size)| PlannedEvent { name, at_s, size, effect_um: Vec::new() })
        .collect()
}

/// Writes what the law of the kind reads: the two temperatures of a spindle; temperature, position and direction of an axis.
fn push_input_values(
    table: &mut RunTable,
    kind: MachineKind,
    temperatures_c: [f64; 2],
    position: [f64; 2],
) {
    let [shown_c, column_c] = temperatures_c;
    let [x_mm, direction] = position;
    match kind {
        MachineKind::Spindle => {
            table.push_value("temp_front_c", 2, shown_c);
            table.push_value("temp_column_c", 2, column_c);
        }
        MachineKind::Axis => {
            table.push_value("temp_screw_c", 2, shown_c);
            table.push_value("x_mm", 0, x_mm);
            table.push_value("dir_x", 0, direction);
        }
    }
}

fn machine_file_toml(kind: MachineKind) -> String {
    match kind {
        MachineKind::Spindle => format!(
            "[machine]\nname = \"year\"\nserial = \"S1\"\nkind = \"3-axis\"\n\n[spindle]\nsource = \"temperature\"\n\n\
             [spindle.temperature]\nsensor = \"temp_front_c\"\nreference_c = 20.0\nk_um_per_c = {FRONT_BEARING_GROWTH_UM_PER_C}\n\
             lag_s = 900.0\n\n[[term]]\ncause = \"extra-heat-path\"\nquantity = \"elongation\"\ncolumn = \"temp_column_c\"\n\
             um_per_c = {COLUMN_EXPANSION_UM_PER_C:?}\ntime_constant_s = 0.0\nreference_c = 20.0\n"
        ),
        MachineKind::Axis => format!(
            "[machine]\nname = \"year\"\nserial = \"A1\"\nkind = \"3-axis\"\n\n[axis.x]\nfeedback = \"screw\"\n\n\
             [axis.x.thermal]\nmode = \"position\"\nsensor = \"temp_screw_c\"\nreference_c = 20.0\n\
             slope_um_per_m_per_c = {SCREW_EXPANSION_UM_PER_M_PER_C:?}\norigin_mm = 0.0\n\n[axis.x.backlash]\nwidth_um = {BACKLASH_WIDTH_UM:?}\n"
        ),
    }
}

/// A row on the way to `to`, with this time constant in s.
fn step_first_order_lag(value: &mut f64, to: f64, constant_s: f64) {
    *value = to + (*value - to) * (-ROW_INTERVAL_S / constant_s).exp();
}
