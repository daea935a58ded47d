//! The laws that errors over an axis are drawn by.
//!
//! | law | a curve is |
//! |---|---|
//! | polynomials | a bow, an S and finer forms to the sixth degree, each smaller: smooth from end to end |
//! | waves | four sines with lengths from half a travel to three, and phases of their own |
//! | walk | a random walk in 24 steps, smooth between them: no form of it can be known between two balls |
//!
//! All have the same size (mean square over the travel) and the same slopes.

use rand::Rng as _;
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use trueup_twin::cubic_spline::CubicSpline;

/// Steps of a walk, and pieces of the other curves' splines.
const STEPS: u32 = 24;

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Law {
    Polynomials,
    Waves,
    Walk,
}

impl Law {
    /// Returns the law with this name.
    pub fn named(name: &str) -> Option<Self> {
        Some(match name {
            "polynomials" => Self::Polynomials,
            "waves" => Self::Waves,
            "walk" => Self::Walk,
            _ => return None,
        })
    }

    /// Draws a function over 0…`length`: its form has about `size` RMS, its slope `slope_per_m` for each metre, standard deviation.
    pub fn form(
        self,
        random: &mut ChaCha8Rng,
        length: f64,
        size: f64,
        slope_per_m: f64,
    ) -> CubicSpline {
        match self {
            Self::Polynomials => polynomials(random, length, size, slope_per_m),
            Self::Waves => waves(random, length, size, slope_per_m),
            Self::Walk => walk(random, length, size, slope_per_m),
        }
    }
}

pub fn normal(random: &mut ChaCha8Rng) -> f64 {
    random.sample(StandardNormal)
}

fn polynomials(random: &mut ChaCha8Rng, length: f64, size: f64, slope_per_m: f64) -> CubicSpline {
    let amounts: [f64; 5] =
        std::array::from_fn(|n| size * normal(random) / (n as f64 + 1.0).powi(2));
    let slope = slope_per_m * normal(random);
    let points = (0..=12).map(|n| {
        let s = f64::from(n) / 6.0 - 1.0;
        let legendre = [
            (3.0 * s * s - 1.0) / 2.0,
            (5.0 * s.powi(3) - 3.0 * s) / 2.0,
            (35.0 * s.powi(4) - 30.0 * s * s + 3.0) / 8.0,
            (63.0 * s.powi(5) - 70.0 * s.powi(3) + 15.0 * s) / 8.0,
            (231.0 * s.powi(6) - 315.0 * s.powi(4) + 105.0 * s * s - 5.0) / 16.0,
        ];
        // Each with mean square 1/5, 1/7, …; the bow of `size` RMS.
        let um: f64 = amounts.iter().zip(legendre).map(|(a, p)| 2.2 * a * p).sum();
        [length * f64::from(n) / 12.0, um + slope * length / 2000.0 * s]
    });
    CubicSpline::from_points(points.collect()).expect("they rise")
}

fn waves(random: &mut ChaCha8Rng, length: f64, size: f64, slope_per_m: f64) -> CubicSpline {
    let sines: [[f64; 3]; 4] = std::array::from_fn(|_| {
        // Of a travel: from half to three, as often between one and two as between two and four.
        let long = 0.5 * 6.0_f64.powf(random.random());
        // Short waves are lower, as a guide bends less over a short way.
        [size * normal(random) * long.min(1.0), long, random.random_range(0.0..1.0)]
    });
    let slope = slope_per_m * normal(random);
    curve(length, |share| {
        let um: f64 = sines
            .iter()
            .map(|[um, long, phase]| um * (std::f64::consts::TAU * (share / long + phase)).sin())
            .sum();
        um / 2.0 * std::f64::consts::SQRT_2 + slope * length / 1000.0 * (share - 0.5)
    })
}

fn walk(random: &mut ChaCha8Rng, length: f64, size: f64, slope_per_m: f64) -> CubicSpline {
    // Tied at both ends its mean square over the travel is a sixth of all steps together.
    let step = size * (6.0 / f64::from(STEPS)).sqrt();
    let mut places = vec![0.0];
    for n in 0..STEPS as usize {
        places.push(places[n] + step * normal(random));
    }
    let (slope, end) = (slope_per_m * normal(random), places[STEPS as usize]);
    curve(length, |share| {
        let at = (share * f64::from(STEPS)).round() as usize;
        places[at] - end * share + slope * length / 1000.0 * (share - 0.5)
    })
}

fn curve(length: f64, um: impl Fn(f64) -> f64) -> CubicSpline {
    let points = (0..=STEPS).map(|n| {
        let share = f64::from(n) / f64::from(STEPS);
        [length * share, um(share)]
    });
    CubicSpline::from_points(points.collect()).expect("they rise")
}
