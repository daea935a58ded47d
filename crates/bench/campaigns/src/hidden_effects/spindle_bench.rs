//! The base of a challenge about elongation: a spindle that is run, what is written of it, and the
//! machine file that is right about it.

use super::{
    cause::HiddenCause,
    effect_shape::PredictedRun,
    model_equations::{WarmupLaw, apply_first_order_lag},
};
use trueup_twin::{
    ambient::{AmbientAir, AmbientConfig},
    noise::RandomStream,
    run_table::RunTable,
    spindle::{OperatingConditions, SimulatedSpindle, SpindleConfig},
};

/// Where the believed elongation comes from.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum ElongationSource {
    /// K₀, V₀, tanβ.
    Sensor { k0_um: f64, zero_counts: f64, um_per_count: f64 },
    /// k·(lagged T − T₀).
    Temperature { k_um_per_c: f64, reference_c: f64, lag_s: f64 },
    /// The warm-up model.
    Warmup(WarmupLaw),
}

/// A spindle that is run, and what the user believes of it.
#[derive(Clone, Debug)]
pub(super) struct SpindleBench {
    pub source: ElongationSource,
    pub max_rpm: f64,
    /// Where the bearing's thermometer is late: by which lag in s, and the bearing's own temperature, run
    /// by run.
    pub late: Option<(f64, Vec<Vec<f64>>)>,
    /// The last one is the hold-out.
    pub runs: Vec<PredictedRun>,
}

/// The kind of source that a bench is to have.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ElongationSourceKind {
    Sensor,
    Temperature,
    Warmup,
}

/// How long the runs are.
#[derive(Clone, Copy, Debug)]
struct RunSampling {
    rows: usize,
    interval_s: f64,
}

impl SpindleBench {
    pub(super) fn draw(
        source_kind: ElongationSourceKind,
        causes: &[HiddenCause],
        stream: &mut RandomStream,
    ) -> Self {
        let has = |cause| causes.contains(&cause);
        let max_rpm = stream.uniform(8.0, 30.0).round() * 1000.0;
        let source = draw_elongation_source(source_kind, causes, stream);
        let hours = stream.uniform(8.0, 24.0);
        let rows = stream.log_uniform(300.0, 3000.0).round() as usize;
        let interval_s = (hours * 3600.0 / rows as f64).round();
        let is_continued = has(HiddenCause::Step) || has(HiddenCause::Drift);
        let training = if !is_continued && stream.bernoulli(0.35) { 2 } else { 1 };
        let with_motor = stream.bernoulli(0.5);
        let with_load = has(HiddenCause::CuttingLoad) || stream.bernoulli(0.6);
        let segment_s = match &source {
            // Long enough to warm up, and at times not quite.
            ElongationSource::Warmup(law) => {
                [1.2 * law.heating_time_constant_s(), 4.0 * law.heating_time_constant_s()]
            }
            _ => [900.0, 6000.0],
        };
        // What a thermometer at the bearing has of the shaft. With a displacement sensor it has little:
        // else it would be the growth itself, and every law of the one a law of the other.
        let (ring_share, slower) = match source_kind {
            ElongationSourceKind::Sensor => (stream.uniform(0.0, 0.1), stream.uniform(1.5, 3.0)),
            _ => (stream.uniform(0.2, 0.6), 1.0),
        };
        let config = SpindleConfig {
            max_rpm,
            housing_j_per_k: slower * SpindleConfig::default().housing_j_per_k,
            // Faster spindles are smaller ones.
            diameter_mm: 90.0 * (24_000.0 / max_rpm).sqrt().min(1.4),
            centrifugal_um_per_krpm2: stream.uniform(2.0, 8.0) / (max_rpm / 1000.0).powi(2),
            viscous_factor: stream.uniform(0.7, 1.5) * (24_000.0 / max_rpm).powf(1.4),
            ..SpindleConfig::default()
        };
        let mut tables = Vec::new();
        let rows_each = rows / training;
        let holdout_rows = (rows / 2).max(200);
        let session = |rows: usize, stream: &mut RandomStream| {
            let length = RunSampling { rows, interval_s };
            let drive = draw_duty_cycle(length, max_rpm, segment_s, with_load, stream);
            simulate_spindle_run(&config, length, &drive, ring_share, with_motor, with_load, stream)
        };
        if is_continued {
            let whole = session(rows + holdout_rows, stream);
            tables.push(slice_rows(&whole, 0, rows));
            tables.push(slice_rows(&whole, rows, rows + holdout_rows));
        } else {
            for _ in 0..training {
                tables.push(session(rows_each, stream));
            }
            tables.push(session(holdout_rows, stream));
        }
        let late = has(HiddenCause::ThermometerLag)
            .then(|| apply_thermometer_lag(&mut tables, interval_s, stream));
        if has(HiddenCause::Dependence) {
            add_coolant_column(&mut tables, stream);
        }
        let runs = tables.into_iter().map(|table| predict_run(&source, table)).collect();
        Self { source, max_rpm, late, runs }
    }

    /// Returns the machine file that is right but for the hidden effect.
    pub(super) fn machine_file_toml(&self) -> String {
        let head = "[machine]\nname = \"challenge\"\nkind = \"3-axis\"\n\n[spindle]\n";
        match &self.source {
            ElongationSource::Sensor { k0_um, zero_counts, um_per_count } => format!(
                "{head}source = \"sensor\"\n\n[spindle.sensor]\nk0_um = {k0_um:?}\nzero_counts = \
                 {zero_counts:?}\num_per_count = {um_per_count:?}\ntemperature = \"temp_coil_c\"\n"
            ),
            ElongationSource::Temperature { k_um_per_c, reference_c, lag_s } => format!(
                "{head}source = \"temperature\"\n\n[spindle.temperature]\nsensor = \
                 \"temp_front_c\"\nreference_c = {reference_c:?}\nk_um_per_c = {k_um_per_c:?}\n\
                 lag_s = {lag_s:?}\n"
            ),
            ElongationSource::Warmup(law) => {
                let cool =
                    law.cool_s.map_or(String::new(), |cool_s| format!("cool_s = {cool_s:?}\n"));
                format!(
                    "{head}source = \"warmup\"\n\n[spindle.warmup]\nlag_s = {:?}\nwarm_s = {:?}\n\
                     max_um = {:?}\nexponent = {:?}\n{cool}",
                    law.lag_s, law.warm_s, law.max_um, law.exponent
                )
            }
        }
    }
}

fn draw_elongation_source(
    source_kind: ElongationSourceKind,
    causes: &[HiddenCause],
    stream: &mut RandomStream,
) -> ElongationSource {
    let has = |cause| causes.contains(&cause);
    match source_kind {
        ElongationSourceKind::Sensor => ElongationSource::Sensor {
            k0_um: if stream.bernoulli(0.5) { 0.0 } else { stream.uniform(-5.0, 5.0).round() },
            zero_counts: stream.uniform(3000.0, 7000.0).round(),
            um_per_count: 500.0 / 32768.0,
        },
        ElongationSourceKind::Temperature => ElongationSource::Temperature {
            k_um_per_c: (stream.uniform(1.2, 4.0) * 100.0).round() / 100.0,
            reference_c: stream.uniform(18.0, 22.0).round(),
            lag_s: match () {
                () if has(HiddenCause::ThermalLag) || has(HiddenCause::ThermometerLag) => 0.0,
                () if has(HiddenCause::CoolingAsymmetry) => stream.uniform(300.0, 1500.0).round(),
                () if stream.bernoulli(0.5) => 0.0,
                () => stream.uniform(100.0, 900.0).round(),
            },
        },
        ElongationSourceKind::Warmup => {
            let lag_s = stream.uniform(30.0, 180.0).round();
            let exponent = (stream.uniform(2.5, 5.0) * 10.0).round() / 10.0;
            let heating_s = stream.uniform(500.0, 1800.0);
            let always = has(HiddenCause::GrowthRate);
            let cool_s = (always || !has(HiddenCause::CoolingAsymmetry) && stream.bernoulli(0.5))
                .then(|| (heating_s * stream.uniform(0.6, 2.0)).round());
            ElongationSource::Warmup(WarmupLaw {
                lag_s,
                warm_s: (lag_s + heating_s * exponent).round(),
                max_um: stream.uniform(30.0, 110.0).round(),
                exponent,
                cool_s,
            })
        }
    }
}

/// Speeds and loads in pieces of random length: each row's holds since the row before.
fn draw_duty_cycle(
    length: RunSampling,
    max_rpm: f64,
    segment_s: [f64; 2],
    with_load: bool,
    stream: &mut RandomStream,
) -> Vec<(f64, f64)> {
    let mut drive = vec![(0.0, 0.0)];
    let mut stands = true;
    while drive.len() < length.rows {
        let seconds = stream.uniform(segment_s[0], segment_s[1]);
        let rows = (seconds / length.interval_s).ceil().max(2.0) as usize;
        // It runs at first and after each stop.
        let rpm = if !stands && stream.bernoulli(0.35) {
            0.0
        } else {
            (stream.uniform(0.2, 1.0) * max_rpm / 100.0).round() * 100.0
        };
        stands = rpm == 0.0;
        let mut load_n = 0.0;
        for row in 0..rows {
            // A cut takes some rows, and has a mean force of its own.
            if row == 0 || stream.bernoulli(0.12) {
                let cuts = with_load && !stands && stream.bernoulli(0.6);
                load_n = if cuts { stream.uniform(100.0, 2500.0).round() } else { 0.0 };
            }
            drive.push((rpm, load_n));
        }
    }
    drive.truncate(length.rows);
    drive
}

/// A temperature that nothing but itself drives: it is drawn to `mean_c`, or to a warm level while
/// something is switched on.
struct SwitchedLagProcess {
    temperature_c: f64,
    mean_c: f64,
    warm_c: f64,
    is_warm: bool,
    lag_s: f64,
}

impl SwitchedLagProcess {
    fn step(&mut self, dt_s: f64, surroundings_c: f64, stream: &mut RandomStream) -> f64 {
        // Switched every one and a half time constants on the average.
        if stream.bernoulli(1.0 - (-dt_s / (1.5 * self.lag_s)).exp()) {
            self.is_warm = !self.is_warm;
        }
        let to_c = self.mean_c + surroundings_c + if self.is_warm { self.warm_c } else { 0.0 };
        self.temperature_c = to_c + (self.temperature_c - to_c) * (-dt_s / self.lag_s).exp();
        self.temperature_c
    }
}

/// Computes the columns of a run but for those that depend on what is believed; next to them, not to be
/// written, `growth_um`: what a sensor in the nose would see.
fn simulate_spindle_run(
    config: &SpindleConfig,
    length: RunSampling,
    drive: &[(f64, f64)],
    ring_share: f64,
    with_motor: bool,
    with_load: bool,
    stream: &mut RandomStream,
) -> RunTable {
    let start_c = stream.uniform(18.0, 23.0);
    let air = AmbientConfig {
        mean_c: start_c,
        amplitude_c: stream.uniform(0.5, 3.0),
        warmest_h: stream.uniform(0.0, 24.0),
        trend_c_per_h: 0.0,
        wander_c: stream.uniform(0.1, 0.5),
        wander_s: 2400.0,
    };
    let mut ambient = AmbientAir::new(&air, stream.clone());
    let mut spindle = SimulatedSpindle::new(config, ambient.temperature_c());
    let mut node = |mean_c: f64, warm_c: f64, lag_s: [f64; 2]| SwitchedLagProcess {
        temperature_c: mean_c,
        mean_c,
        warm_c,
        is_warm: stream.bernoulli(0.5),
        lag_s: stream.uniform(lag_s[0], lag_s[1]),
    };
    let mut table_node = node(0.0, 6.0, [900.0, 2500.0]);
    table_node.temperature_c = ambient.temperature_c();
    let mut coil = node(4.0, 7.0, [500.0, 1500.0]);
    coil.temperature_c = ambient.temperature_c() + 4.0;
    let mut cabinet = node(28.0, 5.0, [700.0, 2500.0]);
    let mut humidity = node(45.0, 8.0, [1500.0, 4000.0]);
    let mut table = RunTable::new();
    for (row, &(rpm, load_n)) in drive.iter().enumerate() {
        let dt_s = if row == 0 { 0.0 } else { length.interval_s };
        let parts = (dt_s / 15.0).ceil() as usize;
        for _ in 0..parts {
            let ambient_c = ambient.step(dt_s / parts as f64);
            let drive =
                OperatingConditions { spindle_rpm: rpm, load_n, ambient_c, coolant_c: start_c };
            spindle.step(dt_s / parts as f64, &drive);
        }
        let (air_c, inside) = (ambient.temperature_c(), spindle.temperatures());
        table.push_value("time_s", 1, row as f64 * length.interval_s);
        table.push_value("growth_um", 9, spindle.growth().growth_at_sensor_um());
        table.push_value("spindle_rpm", 0, rpm);
        if with_load {
            table.push_value("load_n", 0, load_n);
        }
        // In the outer ring and in the stator: what is warm there is not only the shaft.
        let ring_c = ring_share * inside.front_c + (1.0 - ring_share) * inside.housing_c;
        table.push_value("temp_front_c", 2, ring_c + 0.02 * stream.standard_normal());
        if with_motor {
            let stator_c = 0.3 * inside.motor_c + 0.7 * inside.housing_c;
            table.push_value("temp_motor_c", 2, stator_c + 0.02 * stream.standard_normal());
        }
        let warmed_c = 0.15 * (inside.nose_c - air_c) + air_c;
        table.push_value("temp_coil_c", 2, coil.step(dt_s, warmed_c, stream));
        table.push_value("temp_table_c", 2, table_node.step(dt_s, air_c, stream));
        table.push_value("temp_ambient_c", 2, air_c + 0.02 * stream.standard_normal());
        table.push_value("temp_cabinet_c", 2, cabinet.step(dt_s, 0.0, stream));
        let moist = humidity.step(dt_s, 0.0, stream) + 0.3 * stream.standard_normal();
        table.push_value(
            "humidity_percent",
            1,
            if stream.bernoulli(0.01) { f64::NAN } else { moist },
        );
    }
    table
}

/// Puts the bearing's thermometer behind a lag, and gives that back with what it would have shown.
fn apply_thermometer_lag(
    tables: &mut [RunTable],
    interval_s: f64,
    stream: &mut RandomStream,
) -> (f64, Vec<Vec<f64>>) {
    // Longer than a few rows, and long enough to show above the thermometer's own noise.
    let lag_s = stream.log_uniform(200.0, 900.0).max(2.5 * interval_s).round();
    let mut parts = Vec::new();
    for table in tables {
        let part_c = table.column("temp_front_c").unwrap_or_default().to_vec();
        let time_s = table.column("time_s").unwrap_or_default().to_vec();
        let shown = apply_first_order_lag(&time_s, &part_c, lag_s, lag_s);
        let noisy: Vec<f64> = shown.iter().map(|c| c + 0.02 * stream.standard_normal()).collect();
        table.set_column("temp_front_c", 2, noisy);
        parts.push(part_c);
    }
    (lag_s, parts)
}

/// The column of the coolant's pressure, in bar.
pub(super) const COOLANT_PRESSURE_COLUMN: &str = "coolant_bar";
/// The column of the coolant's valve, 0 or 1.
pub(super) const COOLANT_VALVE_COLUMN: &str = "coolant_on";

/// Coolant by its pressure, which wanders between 5 and 70 bar, or by its valve, switched every 25 rows or so.
fn add_coolant_column(tables: &mut [RunTable], stream: &mut RandomStream) {
    let has_pressure = stream.bernoulli(0.5);
    for table in tables {
        let rows = table.row_count();
        let (mut bar, mut is_on) = (stream.uniform(10.0, 50.0), false);
        let mut values = Vec::with_capacity(rows);
        for _ in 0..rows {
            bar = (bar + 3.0 * stream.standard_normal()).clamp(5.0, 70.0);
            is_on ^= stream.bernoulli(0.04);
            values.push(if has_pressure { bar } else { f64::from(u8::from(is_on)) });
        }
        let (name, decimals) =
            if has_pressure { (COOLANT_PRESSURE_COLUMN, 1) } else { (COOLANT_VALVE_COLUMN, 0) };
        table.set_column(name, decimals, values);
    }
}

/// Returns the rows `from..to` as a table of their own.
fn slice_rows(whole: &RunTable, from: usize, to: usize) -> RunTable {
    let mut part = RunTable::new();
    for name in whole.column_names() {
        let values = whole.column(name).unwrap_or_default();
        part.set_column(name, 9, values[from..to].iter().copied());
    }
    part
}

/// Returns the written run, and what the machine file says of it.
fn predict_run(source: &ElongationSource, table: RunTable) -> PredictedRun {
    let column = |name: &str| table.column(name).unwrap_or_default().to_vec();
    let (time_s, growth_um) = (column("time_s"), column("growth_um"));
    let mut written = RunTable::new();
    for name in table.column_names() {
        let is_for_sensor = name == "growth_um" || name == "temp_coil_c";
        match source {
            ElongationSource::Sensor { k0_um, zero_counts, um_per_count }
                if name == "growth_um" =>
            {
                let counts = growth_um.iter().map(|um| (um - k0_um) / um_per_count + zero_counts);
                written.set_column("sensor_counts", 0, counts);
            }
            ElongationSource::Sensor { .. } => written.set_column(name, 9, column(name)),
            _ if is_for_sensor => {}
            _ => written.set_column(name, 9, column(name)),
        }
    }
    let seen = |name: &str| written.column(name).unwrap_or_default();
    let believed_um = match source {
        ElongationSource::Sensor { k0_um, zero_counts, um_per_count } => {
            let counts = seen("sensor_counts").iter();
            counts.map(|counts| k0_um + (counts - zero_counts) * um_per_count).collect()
        }
        ElongationSource::Temperature { k_um_per_c, reference_c, lag_s } => {
            let followed = apply_first_order_lag(&time_s, seen("temp_front_c"), *lag_s, *lag_s);
            followed.iter().map(|c| k_um_per_c * (c - reference_c)).collect()
        }
        ElongationSource::Warmup(law) => law.growth_um(&time_s, seen("spindle_rpm")),
    };
    PredictedRun { table: written, believed_um }
}
