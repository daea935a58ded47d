//! The base of a challenge about an axis: a path that is run and measured, and the machine file that
//! is right about it.

use std::fmt::Write as _;

use super::{
    cause::HiddenCause,
    effect_shape::PredictedRun,
    model_equations::{
        apply_first_order_lag, fit_line, interpolate_pairs, interpolate_uniform_table,
    },
    path_plan::{PathKind, PathPlan},
};
use trueup_twin::{axes::AXIS_NAMES as AXES, noise::RandomStream, run_table::RunTable};

const MEASURED_QUANTITIES: [&str; 3] = ["dx", "dy", "dz"];

/// The machine file's law of the axis's heat.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct ThermalLaw {
    pub reference_c: f64,
    pub constant_um_per_c: f64,
    pub slope_um_per_m_per_c: f64,
    pub origin_mm: f64,
    pub lag_s: f64,
    /// The lag that the axis has in truth, where that is hidden.
    pub true_lag_s: f64,
    /// tanβ over T, in µm/m, instead of the constants.
    pub table: Option<Vec<(f64, f64)>>,
}

impl ThermalLaw {
    /// ΔK in µm at a temperature that has passed the lag.
    pub(super) fn error_um(&self, temperature_c: f64, position_mm: f64) -> f64 {
        let from_origin_m = (position_mm - self.origin_mm) / 1000.0;
        match &self.table {
            Some(table) => interpolate_pairs(table, temperature_c) * from_origin_m,
            None => {
                let above_c = temperature_c - self.reference_c;
                (self.constant_um_per_c + self.slope_um_per_m_per_c * from_origin_m) * above_c
            }
        }
    }
}

/// A pitch table for both directions.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct PitchTable {
    pub start_mm: f64,
    pub step_mm: f64,
    pub forward_um: Vec<f64>,
}

/// An axis that is measured, and what the user believes of it.
#[derive(Clone, Debug)]
pub(super) struct AxisBench {
    /// `dx`, `dy` or `dz`.
    pub quantity: &'static str,
    /// The axis that is measured.
    pub error: usize,
    /// The axis that runs along the path.
    pub main: usize,
    /// Another one, which takes many positions too.
    pub other: usize,
    /// Where the path begins and ends on the main axis, in mm.
    pub travel_mm: [f64; 2],
    /// The points at which the path stops, where it stops at equal distances: first, step, count.
    pub grid: Option<(f64, f64, usize)>,
    pub thermal: Option<ThermalLaw>,
    pub pitch: Option<PitchTable>,
    pub backlash_um: Option<f64>,
    /// The feeds at which positions are approached, where that is written down; else empty.
    pub feeds_mm_per_min: Vec<f64>,
    /// The last one is the hold-out.
    pub runs: Vec<PredictedRun>,
}

/// Whether a cause is among those of the challenge.
type CausePredicate<'a> = dyn Fn(HiddenCause) -> bool + 'a;

/// Draws the path that shows the causes.
fn draw_path_kind(
    has: &CausePredicate<'_>,
    is_warming: bool,
    stream: &mut RandomStream,
) -> PathKind {
    if has(HiddenCause::PreSliding) {
        PathKind::Stations
    } else if is_warming || has(HiddenCause::PitchError) {
        PathKind::Targets
    } else if [HiddenCause::PitchPeriodic, HiddenCause::CrossAxis, HiddenCause::ReferenceInstrument]
        .iter()
        .any(|&cause| has(cause))
        || stream.bernoulli(0.4)
    {
        PathKind::Anywhere
    } else {
        PathKind::Targets
    }
}

/// Drives the path: the training, in one or two runs, and the hold-out.
fn simulate_runs(
    plan: &PathPlan,
    rows: usize,
    has: &CausePredicate<'_>,
    stream: &mut RandomStream,
) -> Vec<RunTable> {
    let is_continued =
        has(HiddenCause::Step) || has(HiddenCause::Drift) || has(HiddenCause::DriftByRun);
    let holdout_rows = (rows / 2).max(200);
    let mut tables = Vec::new();
    if is_continued {
        let whole = plan.simulate_run(rows + holdout_rows, stream);
        tables.push(slice_rows(&whole, 0, rows));
        tables.push(slice_rows(&whole, rows, rows + holdout_rows));
    } else {
        let two = has(HiddenCause::ReferenceInstrument) || stream.bernoulli(0.3);
        let training = if two { 2 } else { 1 };
        for _ in 0..training {
            tables.push(plan.simulate_run(rows / training, stream));
        }
        tables.push(plan.simulate_run(holdout_rows, stream));
    }
    tables
}

/// Gives each run the readings of a reference instrument that runs against the axis.
fn add_reference_instrument_readings(
    tables: &mut [RunTable],
    main: usize,
    travel_mm: [f64; 2],
    stream: &mut RandomStream,
) {
    // Set up again for each run: the same position is not the same reading.
    for table in tables {
        let from_mm = travel_mm[1] + stream.uniform(0.0, 0.3) * (travel_mm[1] - travel_mm[0]);
        let position = table.column(&format!("{}_mm", AXES[main])).unwrap_or_default();
        let reading: Vec<f64> = position.iter().map(|mm| from_mm - mm).collect();
        table.set_column("instrument_mm", 4, reading);
    }
}

/// Gives each cycle a feed, and returns the feeds.
fn assign_feeds(tables: &mut [RunTable], stream: &mut RandomStream) -> Vec<f64> {
    // Each cycle at the next of a few feeds: which comes when has nothing to do with the clock.
    let slowest = 100.0 * stream.uniform_integer(1, 5) as f64;
    let ratio = stream.uniform(2.5, 5.0);
    let count = stream.uniform_integer(2, 4);
    let feeds: Vec<f64> =
        (0..count).map(|n| (slowest * ratio.powi(n as i32) / 10.0).round() * 10.0).collect();
    for table in tables {
        let cycles = table.column("run").unwrap_or_default().iter();
        let feed = cycles.map(|cycle| feeds[*cycle as usize % count]).collect::<Vec<f64>>();
        table.set_column("feed_mm_per_min", 0, feed);
    }
    feeds
}

impl AxisBench {
    pub(super) fn draw(
        is_thermal: bool,
        causes: &[HiddenCause],
        stream: &mut RandomStream,
    ) -> Self {
        let has = |cause| causes.contains(&cause);
        let error = stream.uniform_integer(0, 2);
        let neighbour = (error + stream.uniform_integer(1, 2)) % 3;
        let main = if has(HiddenCause::Straightness) { neighbour } else { error };
        // Its heat shows only over hours.
        let is_warming = is_thermal || has(HiddenCause::AxisExpansion);
        let other = if main == error { neighbour } else { error };
        let length_mm = if has(HiddenCause::PitchPeriodic) || has(HiddenCause::ReferenceInstrument)
        {
            stream.log_uniform(60.0, 500.0).round()
        } else {
            stream.log_uniform(300.0, 4000.0).round()
        };
        let start_mm = if stream.bernoulli(0.6) { 0.0 } else { -(length_mm / 2.0).round() };
        let travel_mm = [start_mm, start_mm + length_mm];

        let path = draw_path_kind(&has, is_warming, stream);
        let count =
            if is_thermal { stream.uniform_integer(5, 9) } else { stream.uniform_integer(10, 30) };
        let step_mm = length_mm / (count - 1) as f64;
        // A table's points are its targets; else they are not quite even, as ISO 230-2 asks.
        let is_even = has(HiddenCause::PitchError);
        let targets_mm = (0..count)
            .map(|i| {
                let off = if is_even { 0.0 } else { 0.3 * stream.uniform(-1.0, 1.0) };
                start_mm + (i as f64 + off).clamp(0.0, (count - 1) as f64) * step_mm
            })
            .collect();
        let rows = stream.log_uniform(if is_even { 600.0 } else { 300.0 }, 3000.0) as usize;
        let cycles = (rows / (2 * count)).max(6);
        let interval_s = stream.uniform(4.0, 15.0).round();
        let pause_s = if is_warming {
            // A cycle now and then over the day.
            let seconds = stream.uniform(8.0, 20.0) * 3600.0 / cycles as f64;
            (seconds - interval_s * (2 * count) as f64).max(10.0).round()
        } else {
            stream.uniform(20.0, 200.0).round()
        };
        let plan = PathPlan {
            path,
            targets_mm,
            travel_mm,
            main,
            interval_s,
            pause_s,
            small_mm: stream.uniform(0.004, 0.015),
        };

        let mut bench = Self {
            quantity: MEASURED_QUANTITIES[error],
            error,
            main,
            other,
            travel_mm,
            grid: is_even.then_some((start_mm, step_mm, count)),
            thermal: is_thermal.then(|| draw_thermal_law(causes, travel_mm, stream)),
            pitch: None,
            backlash_um: None,
            feeds_mm_per_min: Vec::new(),
            runs: Vec::new(),
        };
        // Another axis than the measured one says nothing of these two.
        if main == error && !has(HiddenCause::PitchError) && stream.bernoulli(0.4) {
            let points = stream.uniform_integer(5, 12);
            bench.pitch = Some(PitchTable {
                start_mm,
                step_mm: length_mm / (points - 1) as f64,
                forward_um: draw_detrended_random_walk(points, 1.5, stream)
                    .iter()
                    .map(|um| round_to_tenth(*um))
                    .collect(),
            });
        }
        if has(HiddenCause::PreSliding) || !has(HiddenCause::PitchError) && stream.bernoulli(0.3) {
            bench.backlash_um =
                Some(round_to_tenth(stream.random_sign() * stream.uniform(2.0, 12.0)));
        }

        let mut tables = simulate_runs(&plan, rows, &has, stream);
        if has(HiddenCause::ReferenceInstrument) {
            add_reference_instrument_readings(&mut tables, main, travel_mm, stream);
        }
        if has(HiddenCause::FeedDependentBacklash) {
            bench.feeds_mm_per_min = assign_feeds(&mut tables, stream);
        }
        if has(HiddenCause::DriftByRun) {
            tables = tables.iter().map(|table| without_column(table, "time_s")).collect();
        }
        bench.runs = tables.into_iter().map(|table| bench.predict_run(table)).collect();
        bench
    }

    /// Returns what the machine file says of each row.
    fn predict_run(&self, table: RunTable) -> PredictedRun {
        let column = |name: String| table.column(&name).unwrap_or_default().to_vec();
        let position_mm = column(format!("{}_mm", AXES[self.error]));
        let direction = column(format!("dir_{}", AXES[self.error]));
        let (time_s, screw_c) = (column("time_s".into()), column("temp_screw_c".into()));
        let lag_s = self.thermal.as_ref().map_or(0.0, |law| law.lag_s);
        let followed_c = apply_first_order_lag(&time_s, &screw_c, lag_s, lag_s);
        let believed_um = (0..position_mm.len())
            .map(|row| {
                let at_mm = position_mm[row];
                let heat =
                    self.thermal.as_ref().map_or(0.0, |law| law.error_um(followed_c[row], at_mm));
                let pitch = self.pitch.as_ref().map_or(0.0, |law| {
                    interpolate_uniform_table(law.start_mm, law.step_mm, &law.forward_um, at_mm)
                });
                let lash = if direction[row] < 0.0 { self.backlash_um.unwrap_or(0.0) } else { 0.0 };
                heat + pitch + lash
            })
            .collect();
        PredictedRun { table, believed_um }
    }

    /// Returns the machine file that is right but for the hidden effect.
    pub(super) fn machine_file_toml(&self) -> String {
        let name = AXES[self.error];
        let mut text = "[machine]\nname = \"challenge\"\nkind = \"3-axis\"\n".to_string();
        let mut add = |section: &str, keys: String| {
            write!(text, "\n[axis.{name}{section}]\n{keys}").expect("a String takes all text");
        };
        add("", "feedback = \"screw\"\n".into());
        if let Some(law) = &self.thermal {
            let mode = if law.constant_um_per_c == 0.0 { "position" } else { "both" };
            let mut keys = format!(
                "mode = \"{mode}\"\nsensor = \"temp_screw_c\"\nreference_c = {:?}\n\
                 constant_um_per_c = {:?}\nslope_um_per_m_per_c = {:?}\norigin_mm = {:?}\n\
                 lag_s = {:?}\n",
                law.reference_c,
                law.constant_um_per_c,
                law.slope_um_per_m_per_c,
                law.origin_mm,
                law.lag_s
            );
            if let Some(table) = &law.table {
                let rows: Vec<String> =
                    table.iter().map(|(c, slope)| format!("[{c:?}, 0.0, {slope:?}]")).collect();
                keys.push_str(&format!("table = [{}]\n", rows.join(", ")));
            }
            add(".thermal", keys);
        }
        if let Some(law) = &self.pitch {
            let keys = format!(
                "start_mm = {:?}\nstep_mm = {:?}\nforward_um = {:?}\n",
                law.start_mm, law.step_mm, law.forward_um
            );
            add(".pitch", keys);
        }
        if let Some(width_um) = self.backlash_um {
            add(".backlash", format!("width_um = {width_um:?}\n"));
        }
        text
    }
}

fn draw_thermal_law(
    causes: &[HiddenCause],
    travel_mm: [f64; 2],
    stream: &mut RandomStream,
) -> ThermalLaw {
    let has = |cause| causes.contains(&cause);
    let slope = round_to_tenth(stream.uniform(8.0, 15.0));
    let mut law = ThermalLaw {
        reference_c: stream.uniform(18.0, 22.0).round(),
        constant_um_per_c: if stream.bernoulli(0.5) {
            0.0
        } else {
            round_to_tenth(stream.uniform(0.5, 2.5))
        },
        slope_um_per_m_per_c: slope,
        origin_mm: if stream.bernoulli(0.7) { 0.0 } else { travel_mm[1] },
        lag_s: if has(HiddenCause::ThermalLag) || stream.bernoulli(0.5) {
            0.0
        } else {
            stream.uniform(100.0, 900.0).round()
        },
        true_lag_s: 0.0,
        table: None,
    };
    let hidden_s = stream.log_uniform(300.0, 2500.0).round();
    law.true_lag_s = if has(HiddenCause::ThermalLag) { hidden_s } else { law.lag_s };
    // Where tanβ is straight over T, another reference is the same as another pitch; a table that
    // bends distinguishes the two.
    if has(HiddenCause::ReferenceTemperature) && stream.bernoulli(0.5) {
        let (low, high) =
            (round_to_tenth(stream.uniform(3.0, 6.0)), round_to_tenth(stream.uniform(13.0, 20.0)));
        law.table = Some(vec![
            (10.0, -10.0 * low),
            (20.0, 0.0),
            (26.0, 6.0 * low),
            (46.0, round_to_tenth(6.0 * low + 20.0 * high)),
        ]);
        law.constant_um_per_c = 0.0;
    }
    // Only what the file says can be wrong.
    if has(HiddenCause::ExpansionConstant) && law.constant_um_per_c == 0.0 {
        law.constant_um_per_c = round_to_tenth(stream.random_sign() * stream.uniform(0.5, 2.5));
    }
    law
}

/// `points` values of a random walk without its mean and its slope.
pub(super) fn draw_detrended_random_walk(
    points: usize,
    step: f64,
    stream: &mut RandomStream,
) -> Vec<f64> {
    let mut at = 0.0;
    let walked: Vec<f64> = (0..points)
        .map(|_| {
            at += step * stream.standard_normal();
            at
        })
        .collect();
    let places: Vec<f64> = (0..points).map(|i| i as f64).collect();
    let (level, slope) = fit_line(&places, &walked);
    walked.iter().enumerate().map(|(i, um)| um - level - slope * i as f64).collect()
}

fn round_to_tenth(value: f64) -> f64 {
    (value * 10.0).round() / 10.0
}

fn without_column(whole: &RunTable, column: &str) -> RunTable {
    let mut rest = RunTable::new();
    for name in whole.column_names().filter(|name| *name != column) {
        rest.set_column(name, 9, whole.column(name).unwrap_or_default().iter().copied());
    }
    rest
}

fn slice_rows(whole: &RunTable, from: usize, to: usize) -> RunTable {
    let mut part = RunTable::new();
    for name in whole.column_names() {
        let values = whole.column(name).unwrap_or_default();
        part.set_column(name, 9, values[from..to].iter().copied());
    }
    part
}
