//! Circles with drawn faults: each moves a point by the errors of two axes, and a ball bar reads how far it is from the centre.
//! Written from the mechanics, without a line of the fit: play follows its screw, the reading is a distance.

use std::{
    f64::consts::{FRAC_PI_2, PI, TAU},
    fmt::Write as _,
};

use rand::{Rng as _, SeedableRng as _, seq::IndexedRandom as _};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

/// A fault and its size; an axis is 0 or 1.
#[derive(Clone, Debug, PartialEq)]
pub enum CircleFault {
    /// µm/m of the second axis.
    Squareness(f64),
    /// µm/m of the first axis.
    Scale(f64),
    /// An axis, µm.
    Play(usize, f64),
    /// ms that the first axis lags more.
    Servo(f64),
    /// An axis, heights at both ends and in both directions in µm, decay in degrees.
    Spikes(usize, [f64; 4], f64),
    /// An axis, amplitude in µm, period in mm, phase.
    Cyclic(usize, f64, f64, f64),
    /// The axis that moves, bow and S-form in µm, phase of a wave.
    Straightness(usize, [f64; 3]),
    /// µm of radius and centre over the record.
    Drift([f64; 3]),
}

impl CircleFault {
    /// Returns the name that the fit has for it, with the axis in error.
    pub fn name(&self) -> String {
        let axis = |at: usize| ["x", "y"][at];
        match self {
            Self::Squareness(_) => "squareness".into(),
            Self::Scale(_) => "scale-mismatch".into(),
            Self::Play(at, _) => format!("backlash {}", axis(*at)),
            Self::Servo(_) => "servo-mismatch".into(),
            Self::Spikes(at, ..) => format!("reversal-spike {}", axis(*at)),
            Self::Cyclic(at, ..) => format!("cyclic-error {}", axis(*at)),
            Self::Straightness(at, _) => format!("straightness {}", axis(1 - at)),
            Self::Drift(_) => "drift".into(),
        }
    }
}

/// A circle in XY, measured in both directions with overlap.
#[derive(Clone, Debug)]
pub struct Drawn {
    pub faults: Vec<CircleFault>,
    pub radius_mm: f64,
    pub centre_mm: [f64; 2],
    pub feed_mm_per_min: f64,
    pub noise_um: f64,
    /// Correlation of neighbouring readings' noise.
    pub memory: f64,
    pub rows_a_turn: usize,
    pub senses: Vec<f64>,
    /// Radius and centre of the set-up, in µm.
    pub setup_um: [f64; 3],
    pub seed: u64,
}

impl Drawn {
    /// Returns a sound machine of this radius without noise and set-up.
    pub fn ideal(faults: Vec<CircleFault>, radius_mm: f64) -> Self {
        Self {
            faults,
            radius_mm,
            centre_mm: [20.0, -35.0],
            feed_mm_per_min: 1000.0,
            noise_um: 0.01,
            memory: 0.0,
            rows_a_turn: 720,
            senses: vec![1.0, -1.0],
            setup_um: [0.0; 3],
            seed: 1,
        }
    }

    /// Draws a machine with one to four faults, or a sound one; each second sound one has noise with a memory.
    pub fn new(seed: u64, is_sound: bool) -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let radius_mm = *[50.0, 100.0, 150.0].choose(&mut random).expect("three");
        let feed_mm_per_min = *[500.0, 1000.0, 3000.0].choose(&mut random).expect("three");
        let count = if is_sound { 0 } else { random.random_range(1..=4) };
        let mut kinds: Vec<usize> = (0..12).collect();
        let mut faults = Vec::new();
        for _ in 0..count {
            let kind = kinds.swap_remove(random.random_range(0..kinds.len()));
            faults.push(fault(kind, radius_mm, feed_mm_per_min, &mut random));
        }
        let around = |random: &mut ChaCha8Rng| random.random_range(-200.0..200.0);
        Self {
            faults,
            radius_mm,
            centre_mm: [around(&mut random), around(&mut random)],
            feed_mm_per_min,
            noise_um: random.random_range(0.1..0.6),
            memory: if is_sound && seed.is_multiple_of(2) { 0.9 } else { 0.0 },
            rows_a_turn: random.random_range(700..1000),
            senses: vec![1.0, -1.0],
            setup_um: [0; 3].map(|_| 8.0 * random.sample::<f64, _>(StandardNormal)),
            seed,
        }
    }

    /// Returns the run file.
    pub fn csv(&self) -> String {
        let mut text = String::from("time_s,x_mm,y_mm,feed_mm_per_min,measured_dr_um\n");
        let mut random = ChaCha8Rng::seed_from_u64(self.seed ^ 0x5eed);
        let turn_s = TAU * self.radius_mm * 60.0 / self.feed_mm_per_min;
        let whole_s = 2.0 * turn_s * 1.1 + 5.0;
        let (mut noise, mut time_s) = (0.0, 0.0);
        for (pass, &sense) in self.senses.iter().enumerate() {
            let begin = FRAC_PI_2 * pass as f64 - 0.3 * sense;
            let count = self.rows_a_turn * 11 / 10;
            let angles: Vec<f64> = (0..count)
                .map(|n| begin + sense * TAU * n as f64 / self.rows_a_turn as f64)
                .collect();
            let errors = self.errors(&angles, sense);
            for (angle, [u, v]) in angles.iter().zip(&errors) {
                time_s += turn_s / self.rows_a_turn as f64;
                let [x, y] = self.at(*angle);
                let (sin, cos) = angle.sin_cos();
                let [x_off, y_off] =
                    [u / 1e3 + self.radius_mm * cos, v / 1e3 + self.radius_mm * sin];
                let mut um = (x_off.hypot(y_off) - self.radius_mm) * 1e3;
                let [radius, a, b] = self.setup_um;
                um +=
                    radius + a * cos + b * sin + self.along_radius(*angle, sense, time_s / whole_s);
                let white: f64 = random.sample(StandardNormal);
                noise = self.memory * noise + (1.0 - self.memory * self.memory).sqrt() * white;
                um += self.noise_um * noise;
                let _ =
                    writeln!(text, "{time_s:.4},{x:.5},{y:.5},{},{um:.3}", self.feed_mm_per_min);
            }
            time_s += 5.0;
        }
        text
    }

    fn at(&self, angle: f64) -> [f64; 2] {
        let [u, v] = self.centre_mm;
        [u + self.radius_mm * angle.cos(), v + self.radius_mm * angle.sin()]
    }

    /// Returns the error of each axis along a pass, in µm.
    pub fn errors(&self, angles: &[f64], sense: f64) -> Vec<[f64; 2]> {
        let at: Vec<[f64; 2]> = angles.iter().map(|angle| self.at(*angle)).collect();
        let mut errors = vec![[0.0; 2]; at.len()];
        for fault in &self.faults {
            match *fault {
                CircleFault::Squareness(c) => {
                    errors.iter_mut().zip(&at).for_each(|(e, at)| e[0] += c * at[1] / 1e3);
                }
                CircleFault::Scale(k) => {
                    errors.iter_mut().zip(&at).for_each(|(e, at)| e[0] += k * at[0] / 1e3);
                }
                CircleFault::Play(axis, width) => {
                    let positions: Vec<f64> = at.iter().map(|at| at[axis]).collect();
                    let left_behind = left_behind(&positions, width);
                    errors.iter_mut().zip(left_behind).for_each(|(e, um)| e[axis] += um);
                }
                CircleFault::Servo(ms) => {
                    let um_per_ms = self.feed_mm_per_min / 60.0;
                    let lag = |angle: &f64| sense * um_per_ms * angle.sin() * ms;
                    errors.iter_mut().zip(angles).for_each(|(e, angle)| e[0] += lag(angle));
                }
                CircleFault::Cyclic(axis, um, period, phase) => {
                    let of = |mm: f64| um * (TAU * mm / period + phase).sin();
                    errors.iter_mut().zip(&at).for_each(|(e, at)| e[axis] += of(at[axis]));
                }
                CircleFault::Straightness(axis, form) => {
                    let share = |at: &[f64; 2]| (at[axis] - self.centre_mm[axis]) / self.radius_mm;
                    let of = without_line(form);
                    errors.iter_mut().zip(&at).for_each(|(e, at)| e[1 - axis] += of(share(at)));
                }
                CircleFault::Spikes(..) | CircleFault::Drift(_) => {}
            }
        }
        errors
    }

    /// Returns what shows along the radius alone.
    fn along_radius(&self, angle: f64, sense: f64, share_of_time: f64) -> f64 {
        let of = |fault: &CircleFault| match fault {
            CircleFault::Spikes(axis, heights, decay_deg) => {
                let of_end = |(index, height): (usize, &f64)| {
                    let [is_negative, is_back] = [index / 2 == 1, index % 2 == 1];
                    let end = FRAC_PI_2 * *axis as f64 + if is_negative { PI } else { 0.0 };
                    let since = (sense * (angle - end) + PI).rem_euclid(TAU) - PI;
                    let decay = decay_deg.to_radians();
                    if (sense < 0.0) != is_back || since < 0.0 {
                        return 0.0;
                    }
                    height * (-since / decay).exp() * (1.0 - (-10.0 * since / decay).exp())
                };
                heights.iter().enumerate().map(of_end).sum()
            }
            CircleFault::Drift([radius, u, v]) => {
                share_of_time * (radius + u * angle.cos() + v * angle.sin())
            }
            _ => 0.0,
        };
        self.faults.iter().map(of).sum()
    }
}

fn fault(kind: usize, radius_mm: f64, feed: f64, random: &mut ChaCha8Rng) -> CircleFault {
    let sign = if random.random() { 1.0 } else { -1.0 };
    let mut size = |low: f64, high: f64| sign * random.random_range(low..high);
    // An amplitude at the radius, as µm/m.
    let per_m = 2e3 / radius_mm;
    match kind {
        0 => CircleFault::Squareness(per_m * size(1.0, 8.0)),
        1 => CircleFault::Scale(per_m * size(1.0, 8.0)),
        2 | 3 => CircleFault::Play(kind - 2, size(2.0, 15.0)),
        4 => CircleFault::Servo(size(2.0, 10.0) * 2.0 / (feed / 60.0)),
        5 | 6 => {
            let heights = [0; 4].map(|_| size(3.0, 12.0));
            CircleFault::Spikes(kind - 5, heights, random.random_range(1.5..6.0))
        }
        7 | 8 => {
            let period = *[4.0, 5.0, 8.0, 10.0, 16.0, 20.0].choose(random).expect("six");
            CircleFault::Cyclic(
                kind - 7,
                random.random_range(1.0..5.0),
                period,
                random.random_range(0.0..TAU),
            )
        }
        9 | 10 => {
            let bow = size(3.0, 12.0);
            CircleFault::Straightness(
                kind - 9,
                [bow, random.random_range(-3.0..3.0), random.random_range(0.0..PI)],
            )
        }
        _ => CircleFault::Drift([0; 3].map(|_| 4.0 * random.sample::<f64, _>(StandardNormal))),
    }
}

/// Returns how far a table is left behind its screw with this play, in µm: it follows when the play is taken up.
fn left_behind(positions_mm: &[f64], width_um: f64) -> Vec<f64> {
    let width = width_um.abs();
    let first = positions_mm.get(1).map_or(0.0, |next| next - positions_mm[0]);
    let mut behind = if first > 0.0 { 0.0 } else { width };
    let mut before = positions_mm[0];
    let mut all = Vec::new();
    for mm in positions_mm {
        behind = (behind - (mm - before) * 1e3).clamp(0.0, width);
        before = *mm;
        // A control that compensates too much has the opposite.
        all.push(width_um.signum() * behind);
    }
    all
}

/// Returns a form over −1…1 without its straight line of least squares.
fn without_line([bow, s_form, phase]: [f64; 3]) -> impl Fn(f64) -> f64 {
    let form =
        move |t: f64| bow * t * t + s_form * t.powi(3) + 0.15 * bow * (2.2 * t + phase).sin();
    let samples: Vec<f64> = (-200..=200).map(|n| f64::from(n) / 200.0).collect();
    let squares: f64 = samples.iter().map(|t| t * t).sum();
    let slope = samples.iter().map(|t| t * form(*t)).sum::<f64>() / squares;
    let mean = samples.iter().map(|t| form(*t)).sum::<f64>() / samples.len() as f64;
    move |t| form(t) - mean - slope * t
}
