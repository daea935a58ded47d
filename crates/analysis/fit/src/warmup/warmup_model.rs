//! The growth of a warming spindle as a separable model: the size is linear, the times are not.
//!
//! It is the model's own state, `trueup_machine::model::WarmupState`, stepped through the rows, so
//! that what is fitted and what is predicted later cannot differ.

use trueup_machine::{machine_file::Warmup, model::WarmupState};

use trueup_numerics::least_squares::{
    NonlinearFit, SeparableModel, SolverOptions, fit_separable, separable::geometric_sequence,
};

/// An exponent at which the end of the growth, 1 − e^(−k), is 1: it never ends by itself.
const ASYMPTOTIC_EXPONENT: f64 = 40.0;

/// Which constants are searched. τ = (t₂ − t₁)/k always is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct FreeParameters {
    pub(super) lag: bool,
    /// Whether the growth ends at t₂, with a kink; else it approaches its end for ever.
    pub(super) ends: bool,
    pub(super) speed: bool,
    pub(super) cool: bool,
    /// Whether each file has an arbitrary zero.
    pub(super) zero: bool,
}

/// The constants, those that are not searched at their set values.
#[derive(Clone, Copy, Debug)]
pub(super) struct WarmupParameters {
    pub(super) lag_s: f64,
    pub(super) tau_s: f64,
    pub(super) exponent: f64,
    pub(super) speed_exponent: f64,
    /// `None`: τ serves both.
    pub(super) cool_s: Option<f64>,
}

/// The runs as the model sees them.
#[derive(Clone, Copy)]
pub(super) struct WarmupRecord<'a> {
    pub(super) time_s: &'a [f64],
    /// Missing: it runs from the first row.
    pub(super) spindle_rpm: Option<&'a [f64]>,
    /// Where the state starts again.
    pub(super) starts: &'a [bool],
    /// The file of each row.
    pub(super) files: &'a [usize],
    /// The speed for which the size holds; with a fixed exponent where it is not searched.
    pub(super) rated_rpm: Option<f64>,
    pub(super) set_speed_exponent: f64,
    pub(super) set_cool_s: Option<f64>,
}

pub(super) struct WarmupModel<'a> {
    pub(super) record: WarmupRecord<'a>,
    pub(super) free: FreeParameters,
    /// A slower rise than this is a straight line as far as the record goes.
    pub(super) longest_tau_s: f64,
}

impl WarmupModel<'_> {
    /// Returns the constants of q, whose order is τ, t₁, k, p, τ of cooling.
    pub(super) fn decode_parameters(&self, q: &[f64]) -> WarmupParameters {
        let mut q = q.iter().copied();
        let mut next = |is_free: bool, set: f64| {
            if is_free { q.next().unwrap_or(f64::NAN) } else { set }
        };
        let tau_s = next(true, 0.0);
        let lag_s = next(self.free.lag, 0.0);
        let exponent = next(self.free.ends, ASYMPTOTIC_EXPONENT);
        let speed_exponent = next(self.free.speed, self.record.set_speed_exponent);
        let cool_s = next(self.free.cool, self.record.set_cool_s.unwrap_or(tau_s));
        let cool_s = (self.free.cool || self.record.set_cool_s.is_some()).then_some(cool_s);
        WarmupParameters { lag_s, tau_s, exponent, speed_exponent, cool_s }
    }

    /// Returns the place of each constant in q: τ, t₁, k, p, τ of cooling.
    pub(super) fn parameter_indices(&self) -> [Option<usize>; 5] {
        let free = self.free;
        let mut next = 0;
        [true, free.lag, free.ends, free.speed, free.cool].map(|is_free| {
            next += usize::from(is_free);
            is_free.then(|| next - 1)
        })
    }

    /// Points to search from. `longest_s` is the longest time without a break that it ran.
    pub(super) fn start_grid(&self, interval_s: f64, longest_s: f64) -> Vec<Vec<f64>> {
        let mut grid = Vec::new();
        let taus =
            geometric_sequence((longest_s / 200.0).max(0.5 * interval_s), 3.0 * longest_s, 12);
        let lags: Vec<f64> = [0.005, 0.02, 0.05, 0.1, 0.2].map(|share| share * longest_s).to_vec();
        let lags = if self.free.lag { lags } else { vec![0.0] };
        for &lag_s in &lags {
            let mut shapes: Vec<Vec<f64>> = Vec::new();
            if self.free.ends {
                for share in [0.2, 0.35, 0.5, 0.65, 0.8, 0.95] {
                    for exponent in [0.2, 1.0, 2.0, 3.0, 5.0] {
                        let warm_s = share * longest_s;
                        if warm_s > lag_s {
                            shapes.push(vec![(warm_s - lag_s) / exponent, exponent]);
                        }
                    }
                }
            } else {
                shapes.extend(taus.iter().map(|tau| vec![*tau]));
            }
            for shape in shapes {
                let tau_s = shape[0];
                let mut base = vec![tau_s];
                base.extend(self.free.lag.then_some(lag_s));
                base.extend(shape.get(1));
                let speeds: &[f64] = if self.free.speed { &[0.5, 1.0, 2.0] } else { &[0.0] };
                let cools: &[f64] = if self.free.cool { &[0.4, 1.0, 2.5] } else { &[0.0] };
                for speed in speeds {
                    for cool in cools {
                        let mut q = base.clone();
                        q.extend(self.free.speed.then_some(*speed));
                        q.extend(self.free.cool.then_some(cool * tau_s));
                        grid.push(q);
                    }
                }
            }
        }
        grid
    }

    /// Returns the best fit from `grid`.
    pub(super) fn fit(&self, y: &[f64], grid: &[Vec<f64>]) -> Option<NonlinearFit> {
        // The kinks at t₁ and t₂ move from row to row: digits beyond these are not there.
        let options = SolverOptions {
            patience: 200,
            first_steps: vec![1.0, 0.01],
            tolerance: 1e-10,
            ..SolverOptions::default()
        };
        fit_separable(self, y, grid, &options).ok()
    }

    /// Returns the model's values at these parameters, q and then the linear ones.
    pub(super) fn evaluate(&self, parameters: &[f64], rows: usize) -> Vec<f64> {
        let (q, c) = parameters.split_at(self.nonlinear_count());
        let mut columns = vec![vec![0.0; rows]; c.len()];
        if !self.basis(q, &mut columns) {
            return vec![f64::NAN; rows];
        }
        (0..rows)
            .map(|row| c.iter().zip(&columns).map(|(c, column)| c * column[row]).sum())
            .collect()
    }
}

impl SeparableModel for WarmupModel<'_> {
    fn nonlinear_count(&self) -> usize {
        self.parameter_indices().iter().flatten().count()
    }

    fn linear_count(&self) -> usize {
        let files = self.record.files.iter().copied().max().unwrap_or(0) + 1;
        1 + if self.free.zero { files } else { 0 }
    }

    fn basis(&self, q: &[f64], columns: &mut [Vec<f64>]) -> bool {
        let WarmupParameters { lag_s, tau_s, exponent, speed_exponent, cool_s } =
            self.decode_parameters(q);
        let is_possible = tau_s > 0.0
            && tau_s < self.longest_tau_s
            && lag_s >= 0.0
            && exponent > 0.0
            && speed_exponent >= 0.0
            && cool_s.is_none_or(|cool_s| cool_s > 0.0);
        if !is_possible {
            return false;
        }
        let warm_s = lag_s + exponent * tau_s;
        let WarmupRecord { rated_rpm, time_s, starts, files, .. } = self.record;
        let model =
            Warmup { lag_s, warm_s, max_um: 1.0, exponent, cool_s, rated_rpm, speed_exponent };
        let mut state = WarmupState::default();
        for (row, value) in columns[0].iter_mut().enumerate() {
            if starts[row] {
                state = WarmupState::default();
            }
            let running = rated_rpm.unwrap_or(1.0);
            let rpm = self.record.spindle_rpm.map_or(running, |rpm| rpm[row]);
            *value = state.step(&model, time_s[row], rpm);
        }
        for (file, column) in columns[1..].iter_mut().enumerate() {
            column
                .iter_mut()
                .zip(files)
                .for_each(|(one, of)| *one = f64::from(u8::from(*of == file)));
        }
        true
    }
}
