//! Fourier sums over points at any spacing.
//!
//! ```text
//! S(k) = Σ vⱼ·e^(i·(first + k·step)·xⱼ)      k = 0 … count − 1
//! ```
//!
//! Each point is spread over a regular grid by a narrow Gaussian, the grid is transformed, and what the
//! Gaussian did is divided out (Dutt and Rokhlin 1993; Greengard and Lee 2004): points + count·ln count
//! operations in the place of points · count. With twelve grid points either side and a grid at least
//! twice as fine as the frequencies the error is below 10⁻¹¹ of Σ|vⱼ|.

use std::f64::consts::{PI, TAU};

/// Grid points that a point is spread over, to either side.
const KERNEL_HALF_WIDTH: usize = 12;

/// A complex number.
type Complex = [f64; 2];

fn multiply_complex(a: Complex, b: Complex) -> Complex {
    [a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0]]
}

fn unit_phasor(angle: f64) -> Complex {
    let (sin, cos) = angle.sin_cos();
    [cos, sin]
}

/// S at `count` frequencies from `first` on, `step` apart, of `values` at the points `at`: real and
/// imaginary part. `first` and `step` in radians over the unit of `at`.
///
/// ```
/// let (at, values) = ([0.0, 0.3, 1.1], [1.0, -2.0, 0.5]);
/// let sums = trueup_numerics::fourier::fourier_sums(&at, &values, 2.0, 0.1, 5);
/// let third = at.iter().zip(&values).map(|(x, v)| v * (2.2_f64 * x).cos()).sum::<f64>();
/// assert!((sums[2][0] - third).abs() < 1e-10);
/// ```
#[must_use]
pub fn fourier_sums(
    at: &[f64],
    values: &[f64],
    first: f64,
    step: f64,
    count: usize,
) -> Vec<[f64; 2]> {
    let grid = (2 * count).max(4 * KERNEL_HALF_WIDTH).next_power_of_two();
    let modes = count as f64;
    let ratio = grid as f64 / modes;
    // The width of the Gaussian at which what is cut off of it and what is aliased are equal.
    let width = PI * KERNEL_HALF_WIDTH as f64 / (modes * modes * ratio * (ratio - 0.5));
    let spacing = TAU / grid as f64;
    let reach = KERNEL_HALF_WIDTH as i32;
    let fall: Vec<f64> = (1 - reach..=reach)
        .map(|n| (-(f64::from(n) * spacing).powi(2) / (4.0 * width)).exp())
        .collect();
    // Frequencies about their middle, where what is divided out is least.
    let half = (count / 2) as f64;
    let mut spread = vec![[0.0; 2]; grid];
    for (x, value) in at.iter().zip(values) {
        let angle = (step * x).rem_euclid(TAU);
        let value = multiply_complex([*value, 0.0], unit_phasor((first + half * step) * x));
        let nearest = (angle / spacing).floor();
        let off = angle - nearest * spacing;
        let ratio = (off * spacing / (2.0 * width)).exp();
        let mut height = (-off * off / (4.0 * width)).exp() * ratio.powi(1 - reach);
        let start = nearest as usize + grid + 1 - KERNEL_HALF_WIDTH;
        for (n, fall) in fall.iter().enumerate() {
            let cell = &mut spread[(start + n) % grid];
            cell[0] += value[0] * height * fall;
            cell[1] += value[1] * height * fall;
            height *= ratio;
        }
    }
    fft(&mut spread);
    let scale = (PI / width).sqrt() / grid as f64;
    (0..count)
        .map(|k| {
            let mode = k as f64 - half;
            let cell = spread[(k + grid - count / 2) % grid];
            let scale = scale * (mode * mode * width).exp();
            [cell[0] * scale, cell[1] * scale]
        })
        .collect()
}

/// Σ aₙ·e^(2πi·kn/N) for each k, in the place of a; N a power of two (Cooley and Tukey 1965).
fn fft(a: &mut [Complex]) {
    let count = a.len();
    let bits = count.trailing_zeros();
    for n in 0..count {
        let other = n.reverse_bits() >> (usize::BITS - bits);
        if n < other {
            a.swap(n, other);
        }
    }
    let turns: Vec<Complex> =
        (0..count / 2).map(|n| unit_phasor(TAU * n as f64 / count as f64)).collect();
    let mut half = 1;
    while half < count {
        let stride = count / (2 * half);
        for block in a.chunks_exact_mut(2 * half) {
            let (low, high) = block.split_at_mut(half);
            for ((low, high), turn) in low.iter_mut().zip(high).zip(turns.iter().step_by(stride)) {
                let by = multiply_complex(*high, *turn);
                *high = [low[0] - by[0], low[1] - by[1]];
                *low = [low[0] + by[0], low[1] + by[1]];
            }
        }
        half *= 2;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::RandomGenerator;

    #[test]
    fn sums_are_those_of_plain_sines_at_any_count() {
        let mut generator = RandomGenerator::new(8);
        for (points, count) in [(1, 1), (20, 3), (300, 64), (1200, 900), (3000, 4001)] {
            let at: Vec<f64> = (0..points).map(|_| 700.0 * generator.uniform() - 90.0).collect();
            let values: Vec<f64> = (0..points).map(|_| generator.normal()).collect();
            let (first, step) = (0.013, 0.25 * TAU / 700.0);
            let all = fourier_sums(&at, &values, first, step, count);
            let size: f64 = values.iter().map(|value| value.abs()).sum();
            let mut worst: f64 = 0.0;
            for k in [0, count / 3, count / 2, count - 1] {
                let plain = at.iter().zip(&values).fold([0.0; 2], |sum, (x, value)| {
                    let [cos, sin] = unit_phasor((first + k as f64 * step) * x);
                    [sum[0] + value * cos, sum[1] + value * sin]
                });
                worst = worst.max((all[k][0] - plain[0]).hypot(all[k][1] - plain[1]) / size);
            }
            println!("{points} points, {count} frequencies: {worst:.1e}");
            assert!(worst < 1e-11, "{points} points, {count} frequencies: {worst}");
        }
    }
}
