//! A spindle that may be run as one likes, with one thing wrong in the file that its user believes: what a plan for
//! the next measurement is tried on.
//!
//! ```text
//! s = k·lag_τ(T_front − 20) + b·(T_column − 20) + c·(n/1000)² + what wanders
//! T  follows (n/n_rated)^1.2, the front in 40 minutes, the column in 90, the housing in 20
//! ```
//!
//! Every run is of another morning, cold, with the same truth, in a hall that is kept at one temperature: another
//! morning by itself shows nothing.

use trueup_twin::{
    noise::{CorrelatedNoise, RandomStream},
    run_table::RunTable,
};

/// The spindle's rated speed in r/min.
pub const RATED_SPEED_RPM: f64 = 24_000.0;
/// From row to row in s.
const ROW_INTERVAL_S: f64 = 20.0;
/// The hall, in °C.
const AMBIENT_TEMPERATURE_C: f64 = 20.5;
/// Growth by a kelvin of the front bearing, in µm.
const FRONT_BEARING_GROWTH_UM_PER_C: f64 = 4.0;

/// The error in the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SpindleFileDefect {
    /// The growth with the square of the speed is not in it.
    Centrifugal,
    /// The column's own path of heat is not in it.
    Column,
    /// The front's lag is not in it.
    Lag,
    /// It grows more by a kelvin.
    Growth,
}

/// The machine.
#[derive(Clone, Debug)]
pub struct SpindleTrial {
    seed: u64,
    /// The error in the file.
    pub wrong: SpindleFileDefect,
    /// The machine file (TOML) that the user believes.
    pub machine: String,
    front_um_per_c: f64,
    column_um_per_c: f64,
    um_per_krpm2: f64,
    lag_s: f64,
}

impl SpindleTrial {
    /// Returns the machine number `seed`.
    #[must_use]
    pub fn from_seed(seed: u64) -> Self {
        let mut stream = RandomStream::new(seed, "trial");
        let wrong = stream.choose(&[
            SpindleFileDefect::Centrifugal,
            SpindleFileDefect::Column,
            SpindleFileDefect::Lag,
            SpindleFileDefect::Growth,
        ]);
        let size = stream.log_uniform(0.15, 1.0);
        let only = |which: SpindleFileDefect, value: f64| if wrong == which { value } else { 0.0 };
        Self {
            seed,
            wrong,
            machine: format!(
                "[machine]\nname = \"trial\"\nkind = \"3-axis\"\n\n[spindle]\nsource = \"temperature\"\n\n\
                 [spindle.temperature]\nsensor = \"temp_front_c\"\nreference_c = 20.0\n\
                 k_um_per_c = {FRONT_BEARING_GROWTH_UM_PER_C:?}\nlag_s = 0.0\n"
            ),
            front_um_per_c: FRONT_BEARING_GROWTH_UM_PER_C
                * (1.0 + only(SpindleFileDefect::Growth, 0.2 * size)),
            column_um_per_c: only(SpindleFileDefect::Column, 2.0 * size),
            um_per_krpm2: only(SpindleFileDefect::Centrifugal, 0.02 * size),
            lag_s: only(SpindleFileDefect::Lag, 240.0 * size),
        }
    }

    /// Returns the record (CSV) of the morning `day`: pieces of this many r/min for this many minutes.
    #[must_use]
    pub fn simulate_day(&self, pieces: &[(f64, f64)], day: u64) -> String {
        let mut gauge = RandomStream::new(self.seed, &format!("trial gauge {day}"));
        let wander_stream = RandomStream::new(self.seed, &format!("trial wander {day}"));
        let mut wander = CorrelatedNoise::new(wander_stream, 0.1, 0.0);
        let mut parts_c = [AMBIENT_TEMPERATURE_C; 3];
        let mut followed_c = AMBIENT_TEMPERATURE_C;
        let mut table = RunTable::new();
        let speeds = pieces.iter().flat_map(|(rpm, minutes)| {
            let rows = (60.0 * minutes / ROW_INTERVAL_S).round() as usize;
            std::iter::repeat_n(*rpm, rows)
        });
        for (row, rpm) in std::iter::once(0.0).chain(speeds).enumerate() {
            let heat = (rpm / RATED_SPEED_RPM).powf(1.2);
            if row > 0 {
                for (part, [rise_c, constant_s]) in
                    parts_c.iter_mut().zip([[30.0, 2400.0], [12.0, 5400.0], [18.0, 1200.0]])
                {
                    let to = AMBIENT_TEMPERATURE_C + rise_c * heat;
                    *part = to + (*part - to) * (-ROW_INTERVAL_S / constant_s).exp();
                }
            }
            let [front_c, column_c, _] = parts_c;
            followed_c = match self.lag_s > 0.0 {
                true => front_c + (followed_c - front_c) * (-ROW_INTERVAL_S / self.lag_s).exp(),
                false => front_c,
            };
            let krpm = rpm / 1000.0;
            let um = self.front_um_per_c * (followed_c - 20.0)
                + self.column_um_per_c * (column_c - 20.0)
                + self.um_per_krpm2 * krpm * krpm
                + wander.draw_correlated((-ROW_INTERVAL_S / 1800.0).exp());
            table.push_value("time_s", 0, row as f64 * ROW_INTERVAL_S);
            table.push_value("spindle_rpm", 0, rpm);
            for (name, part) in
                ["temp_front_c", "temp_column_c", "temp_housing_c"].iter().zip(parts_c)
            {
                table.push_value(name, 3, part + 0.02 * gauge.standard_normal());
            }
            table.push_value("measured_elongation_um", 2, um + 0.3 * gauge.standard_normal());
        }
        table.to_csv()
    }
}
