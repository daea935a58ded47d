//! The paper's Table 1 for the user's own data: five ways to a curve side by side.
//!
//! A line through every point leaves nothing at the points, whatever lies between them. Therefore
//! each way is also fitted to every second position and judged at the others.

use std::fmt;

use super::{
    FitMethod, StraightnessFit, StraightnessFitOptions,
    knot_selection::{MAX_KNOT_SEARCH_SITES, SelectedSpline},
    model::{ChebyshevSeries, CurveModel},
    paper_method,
    residual::ResidualSummary,
    sites::Sites,
};

/// The feed of the paper's cut, at which corners are printed, in mm/min.
const PAPER_FEED_MM_PER_MIN: f64 = 1000.0;

/// A way to a curve.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CurveMethod {
    /// A B-spline through points that the paper's rule chooses, with the paper's coefficients.
    Paper,
    /// A B-spline in the paper's knots, its coefficients by least squares.
    PapersPoints,
    /// A B-spline, knots and coefficients by least squares.
    LeastSquares,
    /// A polynomial of degree 7.
    Polynomial,
    /// Straight lines from reading to reading.
    Lines,
}

impl CurveMethod {
    /// All of them, in the order of the table.
    pub(super) const ALL: [Self; 5] =
        [Self::Paper, Self::PapersPoints, Self::LeastSquares, Self::Polynomial, Self::Lines];

    /// Returns the way of a fit by `method`.
    #[must_use]
    pub(crate) fn from_fit_method(method: FitMethod) -> Self {
        match method {
            FitMethod::Paper => Self::Paper,
            FitMethod::LeastSquares => Self::LeastSquares,
        }
    }
}

impl fmt::Display for CurveMethod {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Paper => "paper's way",
            Self::PapersPoints => "paper's points, least squares",
            Self::LeastSquares => "least squares",
            Self::Polynomial => "polynomial of degree 7",
            Self::Lines => "straight lines",
        })
    }
}

/// One way to a curve, and how it does.
#[derive(Clone, Debug, PartialEq)]
pub struct MethodPerformance {
    /// Which it is.
    pub way: CurveMethod,
    /// Coefficients that describe the curve.
    pub coefficients: usize,
    /// At the positions of the fit.
    pub residual: ResidualSummary,
    /// Fitted to every second position, at the others; `None` where these are fewer than 8.
    pub held_out: Option<ResidualSummary>,
    /// Largest absolute slope in µm/mm: speed of the correction for a feed of 1 mm/s.
    pub slope_um_per_mm: f64,
    /// Largest absolute curvature in µm/mm². For straight lines a bend over half the distance to
    /// both neighbours, which is as sharp as the data can say.
    pub curvature_um_per_mm2: f64,
    /// Largest jump of the slope at a corner, in µm/mm: at a feed of 1 mm/s the correction's speed jumps by as
    /// many µm/s. 0 for what has no corners.
    pub corner_um_per_mm: f64,
}

impl fmt::Display for MethodPerformance {
    /// One line that begins with the way's name, ASCII alone: terminals and TOML comments take it.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ResidualSummary { range_um, mean_um, mean_square_um2, largest_um, .. } = self.residual;
        write!(
            f,
            "{}: {} coefficients; residual: range {range_um:.2} µm, mean {:.2} µm, mean square \
             {mean_square_um2:.3} µm², largest {largest_um:.2} µm",
            self.way,
            self.coefficients,
            // + 0.0 turns -0 into 0.
            (mean_um * 100.0).round() / 100.0 + 0.0
        )?;
        if let Some(left) = &self.held_out {
            write!(f, "; at held-out positions {:.2} µm RMS", left.rms_um)?;
        }
        write!(
            f,
            "; slope up to {:.4} µm/mm, curvature up to {:.2e} µm/mm2",
            self.slope_um_per_mm, self.curvature_um_per_mm2
        )?;
        if self.corner_um_per_mm > 0.0 {
            let um_per_s = self.corner_um_per_mm * PAPER_FEED_MM_PER_MIN / 60.0;
            write!(f, "; corners of {um_per_s:.2} µm/s at {PAPER_FEED_MM_PER_MIN} mm/min")?;
        }
        Ok(())
    }
}

pub(super) fn compare_methods(fit: &StraightnessFit) -> Vec<MethodPerformance> {
    const MIN_HELD_OUT_SITES: usize = 8;
    let halves = [0, 1].map(|from| fit.sites.every_second(from));
    fit_models(fit)
        .into_iter()
        .map(|(way, model)| {
            let held_out = (halves[1].len() >= MIN_HELD_OUT_SITES).then(|| {
                let [_, last] = halves[0].end_positions_mm();
                let half = fit_model(fit, way, &halves[0]);
                let inside = halves[1].points().filter(|&(x, ..)| x <= last);
                let left: Vec<f64> = inside.map(|(x, y, _)| y - half.evaluate(x)).collect();
                ResidualSummary::from_residuals(&left)
            });
            let (slope_um_per_mm, curvature_um_per_mm2) = model.max_slope_and_curvature();
            MethodPerformance {
                way,
                coefficients: model.coefficient_count(),
                residual: model.residual_summary(&fit.sites),
                held_out,
                slope_um_per_mm,
                curvature_um_per_mm2,
                corner_um_per_mm: model.max_slope_jump(),
            }
        })
        .collect()
}

/// Returns the curve of the same readings by each way.
pub(super) fn fit_models(fit: &StraightnessFit) -> Vec<(CurveMethod, CurveModel)> {
    let is_own = fit.method == FitMethod::LeastSquares;
    let model = |way| match way {
        // It is there already.
        CurveMethod::LeastSquares if is_own => CurveModel::Spline(fit.spline.clone()),
        _ => fit_model(fit, way, &fit.sites),
    };
    CurveMethod::ALL.into_iter().map(|way| (way, model(way))).collect()
}

/// Returns how the largest residual falls as points join by the paper's way: control points, and µm.
pub(super) fn paper_method_residual_steps(fit: &StraightnessFit) -> Vec<(usize, f64)> {
    paper_method::fit(
        &fit.sites.merge_neighbours(MAX_KNOT_SEARCH_SITES),
        paper_method_tolerance_um(fit),
        paper_method::ControlValueRule::Readings,
    )
    .steps
}

/// Returns what the paper's rule takes for its ε: the tolerance, else what the fit has left.
fn paper_method_tolerance_um(fit: &StraightnessFit) -> f64 {
    fit.tolerance_um.unwrap_or(fit.residual.largest_um)
}

fn fit_model(fit: &StraightnessFit, way: CurveMethod, sites: &Sites) -> CurveModel {
    let options = StraightnessFitOptions {
        tolerance_um: fit.tolerance_um,
        method: FitMethod::LeastSquares,
        reference: fit.reference,
        most_coefficients: fit.most_coefficients,
    };
    let papers = |control| {
        CurveModel::Spline(
            paper_method::fit(
                &sites.merge_neighbours(MAX_KNOT_SEARCH_SITES),
                paper_method_tolerance_um(fit),
                control,
            )
            .spline,
        )
    };
    match way {
        CurveMethod::Paper => papers(paper_method::ControlValueRule::Readings),
        CurveMethod::PapersPoints => papers(paper_method::ControlValueRule::LeastSquares),
        CurveMethod::LeastSquares => {
            CurveModel::Spline(SelectedSpline::select(sites, &options).spline)
        }
        CurveMethod::Polynomial => CurveModel::Polynomial(ChebyshevSeries::fit(sites, 7)),
        CurveMethod::Lines => CurveModel::Lines { x: sites.x.clone(), y: sites.y.clone() },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_jump_in_speed_at_their_corners_and_nothing_else_does() {
        // A roof of 1 µm in 100 mm up and down: the slope goes from 0.01 to −0.01 µm/mm, so at 1 mm/s the
        // speed jumps by 0.02 µm/s; of an axis that follows in a millisecond that requires 20 µm/s².
        let lines = CurveModel::Lines { x: vec![0.0, 100.0, 200.0], y: vec![0.0, 1.0, 0.0] };
        assert!((lines.max_slope_jump() - 0.02).abs() < 1e-12);
        let x: Vec<f64> = (0..60).map(|k| 10.0 * f64::from(k)).collect();
        let y: Vec<f64> = x.iter().map(|x| 5.0 * (x / 40.0).sin()).collect();
        let fit =
            super::super::fit(&x, &y, &StraightnessFitOptions::default()).expect("sound data");
        for row in fit.compare_methods() {
            assert_eq!(row.corner_um_per_mm > 0.0, row.way == CurveMethod::Lines, "{row}");
        }
    }

    #[test]
    fn a_row_of_the_comparison_is_one_line_with_all_its_figures() {
        let residual = ResidualSummary::from_residuals(&[1.0, -1.0]);
        let row = MethodPerformance {
            way: CurveMethod::Lines,
            coefficients: 9,
            residual,
            held_out: Some(residual),
            slope_um_per_mm: 0.5,
            curvature_um_per_mm2: 0.00123,
            corner_um_per_mm: 0.06,
        };
        assert_eq!(
            row.to_string(),
            "straight lines: 9 coefficients; residual: range 2.00 µm, mean 0.00 µm, mean square 1.000 µm², \
             largest 1.00 µm; at held-out positions 1.00 µm RMS; slope up to 0.5000 µm/mm, \
             curvature up to 1.23e-3 µm/mm2; corners of 1.00 µm/s at 1000 mm/min"
        );
    }

    #[test]
    fn a_residuals_figures_are_what_the_hand_finds() {
        let residual = ResidualSummary::from_residuals(&[1.0, 3.0, -2.0, 2.0]);
        assert_eq!((residual.range_um, residual.mean_um, residual.largest_um), (5.0, 1.0, 3.0));
        assert_eq!((residual.mean_square_um2, residual.rms_um), (3.5, 4.5_f64.sqrt()));
    }
}
