//! A seeded guideway: waves and bumps at random scales, kinks where a foundation's blocks meet, and
//! the noise of a laser on what is measured of it. It knows nothing of any fit.

use std::f64::consts::TAU;

use rand::Rng as _;
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng as _};
use rand_distr::{Distribution as _, Normal};

/// Name, travel in mm, spacing of the readings in mm, range in µm, the paper's residual in µm
/// (`docs/physics.md` section 4; the spacing is ours, the paper does not say it).
pub const CURVES: [(&str, f64, f64, f64, f64); 6] = [
    ("z_of_x", 14_300.0, 100.0, 200.0, 8.3),
    ("y_of_x", 14_300.0, 100.0, 79.0, 4.8),
    ("z_of_y", 3_000.0, 50.0, 52.0, 2.8),
    ("x_of_y", 3_000.0, 50.0, 25.0, 2.4),
    ("x_of_z", 2_500.0, 50.0, 20.0, 1.6),
    ("y_of_z", 2_500.0, 50.0, 35.0, 2.2),
];

/// Standard deviation of a reading, in µm.
pub const LASER_UM: f64 = 0.2;

/// An axis's true error.
pub struct Guideway {
    pub travel_mm: f64,
    /// Cycles over the travel, phase, height.
    waves: Vec<(f64, f64, f64)>,
    /// Place and width as shares of the travel, height.
    bumps: Vec<(f64, f64, f64)>,
    /// Place as a share of the travel, half the change of slope.
    kinks: Vec<(f64, f64)>,
    scale: f64,
    /// The line that is taken off so that both ends are 0.
    line: (f64, f64),
}

impl Guideway {
    /// Returns the guideway number `seed`, with a range of `range_um` over its travel.
    pub fn new(seed: u64, travel_mm: f64, range_um: f64) -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let height = Normal::new(0.0, 1.0).expect("finite");
        let mut waves = Vec::new();
        for _ in 0..random.random_range(3..6) {
            let cycles = 0.5 * 16_f64.powf(random.random());
            let phase = random.random_range(0.0..TAU);
            waves.push((cycles, phase, height.sample(&mut random) / cycles));
        }
        let mut bumps = Vec::new();
        for _ in 0..random.random_range(2..6) {
            let width = 0.03 * 8_f64.powf(random.random());
            bumps.push((random.random(), width, height.sample(&mut random) * width.sqrt()));
        }
        let kinks = (0..random.random_range(1..4))
            .map(|_| (random.random(), 2.0 * height.sample(&mut random)))
            .collect();
        let mut way = Self { travel_mm, waves, bumps, kinks, scale: 1.0, line: (0.0, 0.0) };
        let (first, last) = (way.at(0.0), way.at(travel_mm));
        way.line = (first, last - first);
        let values: Vec<f64> =
            (0..=2_000).map(|n| way.at(travel_mm * f64::from(n) / 2e3)).collect();
        let high = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let low = values.iter().copied().fold(f64::INFINITY, f64::min);
        way.scale = range_um / (high - low);
        way
    }

    /// Its error at a position, in µm.
    pub fn at(&self, x_mm: f64) -> f64 {
        let u = x_mm / self.travel_mm;
        let waves: f64 = self.waves.iter().map(|(n, at, a)| a * (TAU * n * u + at).sin()).sum();
        let bumps: f64 =
            self.bumps.iter().map(|(at, w, a)| a * (-0.5 * ((u - at) / w).powi(2)).exp()).sum();
        let kinks: f64 = self.kinks.iter().map(|(at, slope)| slope * (u - at).abs()).sum();
        self.scale * (waves + bumps + kinks - self.line.0 - self.line.1 * u)
    }

    /// Positions every `step_mm`, and what a laser reads there.
    pub fn measured(&self, seed: u64, step_mm: f64) -> (Vec<f64>, Vec<f64>) {
        let mut random = ChaCha8Rng::seed_from_u64(!seed);
        let noise = Normal::new(0.0, LASER_UM).expect("finite");
        let count = (self.travel_mm / step_mm).round() as usize;
        (0..=count)
            .map(|n| n as f64 * step_mm)
            .map(|x| (x, self.at(x) + noise.sample(&mut random)))
            .unzip()
    }
}
