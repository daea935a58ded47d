//! The path of a challenge about an axis, and the columns that are written of it.

use trueup_twin::{axes::AXIS_NAMES as AXES, noise::RandomStream, run_table::RunTable};

/// How the main axis moves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum PathKind {
    /// To targets one after the other, up and down, as ISO 230-2 has it.
    Targets,
    /// Anywhere, from row to row.
    Anywhere,
    /// A few stations, with small steps up and down at each.
    Stations,
}

/// A path with its times.
pub(super) struct PathPlan {
    pub path: PathKind,
    /// The targets of [`PathKind::Targets`], in mm; else empty.
    pub targets_mm: Vec<f64>,
    pub travel_mm: [f64; 2],
    pub main: usize,
    /// From row to row, in s.
    pub interval_s: f64,
    /// From cycle to cycle, in s.
    pub pause_s: f64,
    /// The way of a small step, in mm.
    pub small_mm: f64,
}

impl PathPlan {
    /// Returns the positions of the main axis, and the number of the cycle, row by row.
    fn draw_positions(&self, rows: usize, stream: &mut RandomStream) -> Vec<(f64, usize)> {
        let mut all = Vec::with_capacity(rows);
        let mut cycle = 0;
        while all.len() < rows {
            cycle += 1;
            match self.path {
                PathKind::Targets => {
                    let up = self.targets_mm.iter();
                    let down = self.targets_mm.iter().rev();
                    all.extend(up.chain(down).map(|&mm| (mm, cycle)));
                }
                PathKind::Anywhere => {
                    let [low, high] = self.travel_mm;
                    all.extend((0..40).map(|_| (stream.uniform(low, high), cycle)));
                }
                PathKind::Stations => {
                    let [low, high] = self.travel_mm;
                    let at = low + (high - low) * stream.uniform(0.1, 0.9);
                    let up = (0..12).map(|i| (at + f64::from(i) * self.small_mm, cycle));
                    let down = (0..11).rev().map(|i| (at + f64::from(i) * self.small_mm, cycle));
                    all.extend(up.chain(down));
                }
            }
        }
        all.truncate(rows);
        all
    }

    /// Returns one run: all columns but the measured one.
    pub(super) fn simulate_run(&self, rows: usize, stream: &mut RandomStream) -> RunTable {
        let mut table = RunTable::new();
        let air_c = stream.uniform(18.0, 23.0);
        let wave_c = stream.uniform(0.3, 1.5);
        let day = stream.uniform(0.0, std::f64::consts::TAU);
        let most_c = stream.uniform(6.0, 18.0);
        let screw_s = stream.uniform(900.0, 2400.0);
        let (mut screw_c, mut activity, mut left_s) = (air_c, stream.uniform(0.3, 1.0), 3600.0);
        let mut cabinet_c = 29.0;
        let mut cabinet_to_c = 29.0;
        let mut levels = [0.0; 3].map(|_: f64| stream.uniform(0.0, 400.0).round());
        let mut before = [f64::NAN; 3];
        let mut direction = [1.0; 3];
        let mut time_s = 0.0;
        let mut cycle_before = 1;
        for (row, (mm, cycle)) in self.draw_positions(rows, stream).into_iter().enumerate() {
            let mut dt_s = if row == 0 { 0.0 } else { self.interval_s };
            if cycle != cycle_before && self.path != PathKind::Anywhere {
                dt_s += self.pause_s;
            }
            if cycle != cycle_before || self.path == PathKind::Anywhere && stream.bernoulli(0.3) {
                levels = levels.map(|_| stream.uniform(0.0, 400.0).round());
            }
            cycle_before = cycle;
            time_s += dt_s;
            left_s -= dt_s;
            if left_s < 0.0 {
                left_s = stream.uniform(0.7, 3.0) * screw_s;
                activity = if stream.bernoulli(0.35) { 0.0 } else { stream.uniform(0.2, 1.0) };
            }
            if stream.bernoulli(1.0 - (-dt_s / 1800.0).exp()) {
                cabinet_to_c = stream.uniform(26.0, 33.0);
            }
            let ambient_c =
                air_c + wave_c * (std::f64::consts::TAU * time_s / 86_400.0 + day).sin();
            let to_c = ambient_c + most_c * activity;
            screw_c = to_c + (screw_c - to_c) * (-dt_s / screw_s).exp();
            cabinet_c = cabinet_to_c + (cabinet_c - cabinet_to_c) * (-dt_s / 900.0).exp();

            let mut position = levels;
            position[self.main] = mm;
            table.push_value("time_s", 1, time_s);
            table.push_value("run", 0, cycle as f64);
            for axis in 0..3 {
                let decimals = 4;
                table.push_value(&format!("{}_mm", AXES[axis]), decimals, position[axis]);
                let way = position[axis] - before[axis];
                if way != 0.0 && !way.is_nan() {
                    direction[axis] = way.signum();
                }
                before[axis] = position[axis];
            }
            for axis in 0..3 {
                table.push_value(&format!("dir_{}", AXES[axis]), 0, direction[axis]);
            }
            table.push_value("temp_screw_c", 2, screw_c);
            table.push_value("temp_ambient_c", 2, ambient_c + 0.02 * stream.standard_normal());
            table.push_value("temp_cabinet_c", 2, cabinet_c);
            let humidity =
                45.0 + 3.0 * (time_s / 5000.0 + day).cos() + 0.3 * stream.standard_normal();
            table.push_value(
                "humidity_percent",
                1,
                if stream.bernoulli(0.01) { f64::NAN } else { humidity },
            );
        }
        table
    }
}
