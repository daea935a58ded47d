//! A real bed: the mean X profile of a mesh of 101 × 101 heights (bed form and guides together),
//! fitted at the even points, tested at the odd ones. Figures:
//! `cargo test -p trueup-fit --test fit straightness_bed -- --show-output`.

use trueup_fit::straightness::{StopReason, StraightnessFit, StraightnessFitOptions, fit};
use trueup_machine::model::spline_value_um;

/// Positions in mm; heights in µm of the mean over the rows, and of each row.
type Mesh = (Vec<f64>, Vec<f64>, Vec<Vec<f64>>);

/// Returns the mesh; `None` where the data are not there.
fn mesh() -> Option<Mesh> {
    let path = trueup_measured_data::find_measured_file("bed_mesh_troodon/mesh_101x101_mm.csv")?;
    let text = std::fs::read_to_string(path).expect("a text file");
    let um = |value: &str| 1e3 * value.trim().parse::<f64>().expect("a height");
    let rows: Vec<Vec<f64>> = text.lines().map(|line| line.split(',').map(um).collect()).collect();
    let columns = rows[0].len();
    let mean = |n: usize| rows.iter().map(|row| row[n]).sum::<f64>() / rows.len() as f64;
    let x = (0..columns).map(|n| 30.0 + 290.0 * n as f64 / (columns - 1) as f64).collect();
    Some((x, (0..columns).map(mean).collect(), rows))
}

fn every_second(values: &[f64], from: usize) -> Vec<f64> {
    values.iter().skip(from).step_by(2).copied().collect()
}

/// Returns the fit at the even points, and its RMS error at the odd ones.
fn even_and_odd(x: &[f64], y: &[f64], options: &StraightnessFitOptions) -> (StraightnessFit, f64) {
    let fit = fit(&every_second(x, 0), &every_second(y, 0), options).expect("sound data");
    let odd = every_second(x, 1).into_iter().zip(every_second(y, 1));
    let squares: Vec<f64> =
        odd.map(|(x, y)| (y - spline_value_um(&fit.spline, x)).powi(2)).collect();
    let rms_um = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
    (fit, rms_um)
}

#[test]
fn the_mean_profile_is_predicted_within_0_62_um_by_at_most_12_coefficients() {
    let Some((x, y, _)) = mesh() else { return };
    println!("tolerance  coefficients  even RMS  even largest  odd RMS");
    for tolerance_um in [None, Some(4.0), Some(2.5), Some(1.5), Some(1.0), Some(0.5)] {
        let options = StraightnessFitOptions { tolerance_um, ..StraightnessFitOptions::default() };
        let (fit, odd_um) = even_and_odd(&x, &y, &options);
        let tolerance = tolerance_um.map_or("none".into(), |um: f64| um.to_string());
        println!(
            "{tolerance:>9}  {:>12}  {:>8.3}  {:>12.3}  {odd_um:>7.3}  {}",
            fit.spline.control_um.len(),
            fit.residual.rms_um,
            fit.residual.largest_um,
            fit.stopped
        );
        if fit.stopped != StopReason::Tolerance {
            assert!(fit.spline.control_um.len() <= 12 && odd_um <= 0.62, "{odd_um} µm");
        }
    }
}

#[test]
fn one_row_is_followed_down_to_its_noise_and_no_further() {
    let Some((x, _, rows)) = mesh() else { return };
    // One row's readings scatter by 1.46 µm about a smooth curve.
    let mut odd: Vec<f64> = Vec::new();
    for row in rows.iter().step_by(10) {
        let (fit, odd_um) = even_and_odd(&x, row, &StraightnessFitOptions::default());
        println!(
            "{} coefficients, even {:.2} µm, odd {odd_um:.2} µm",
            fit.spline.control_um.len(),
            fit.residual.rms_um
        );
        odd.push(odd_um);
    }
    odd.sort_by(f64::total_cmp);
    println!("median RMS at the odd points of one row: {:.2} µm", odd[odd.len() / 2]);
    assert!(odd[odd.len() / 2] < 2.0);
}
