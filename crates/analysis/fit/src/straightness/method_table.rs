//! The paper's Table 1 of the user's own runs: each [way](CurveMethod) to a curve next to the others, on each curve and
//! on the diagonals that two curves make, with what its corners require of the machine.
//!
//! A run in which one axis moves is a curve. One in which several move along a straight line is a diagonal, and
//! it is not used for a fit: it is held against the sum of the curves,
//! Δz = δz(x) + δz(y) and so on. A correction that follows slope σ at feed v moves its axis at σ·v; where lines
//! meet, that speed jumps, and an axis that follows within a cycle of its control needs the acceleration jump / cycle.

mod html_report;

use trueup_machine::{InputFileError, applied_offsets::UncompensatedRun, machine_file::LinearAxis};
use trueup_page::Provenance;

use super::{
    CurveMethod, ResidualSummary, StraightnessCurve, StraightnessFit, StraightnessFitError,
    StraightnessFitOptions, fit_straightness_run,
    method_comparison::{fit_models, paper_method_residual_steps},
    model::CurveModel,
    run_fit::{error_column_name, moving_axes, resolve_error_axis},
    sites::Sites,
};

/// The length over which the paper's standard counts a deviation, in mm.
const REFERENCE_LENGTH_MM: f64 = 1000.0;
/// A diagonal is straight to this share of its length.
const DIAGONAL_STRAIGHTNESS_TOLERANCE: f64 = 1e-3;
/// Places at which a speed is drawn, and a curvature looked for.
const EVALUATION_INTERVALS: u32 = 800;

/// The request: the quantity, the fit of the curves, the feed and the cycle.
#[derive(Clone, Debug)]
pub struct MethodTableOptions<'q> {
    /// `dx`, `dy`, `dz` where a run measures several errors.
    pub quantity: Option<&'q str>,
    /// How the curves are fitted.
    pub options: StraightnessFitOptions,
    /// Along the way, in mm/min, above 0.
    pub feed_mm_per_min: f64,
    /// How often the control gives its axes a new target, in ms, above 0.
    pub cycle_ms: f64,
}

/// The table.
#[derive(Clone, Debug)]
pub struct MethodTable {
    /// The curves, then the diagonals.
    pub entries: Vec<MethodTableEntry>,
    /// In mm/min, as requested.
    pub feed_mm_per_min: f64,
    /// In ms, as requested.
    pub cycle_ms: f64,
}

/// A curve or a diagonal.
#[derive(Clone, Debug)]
pub struct MethodTableEntry {
    /// `z_of_x`; `dz on the diagonal of x and y`.
    pub name: String,
    /// Different positions along it.
    pub positions: usize,
    /// The measured error without any correction.
    pub without: ResidualDeviation,
    /// Each way's residuals, and its demands on the machine.
    pub rows: Vec<MethodResult>,
    /// A curve by the paper's way: this many control points leave a largest residual of this many µm.
    pub steps: Vec<(usize, f64)>,
}

/// The residual error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ResidualDeviation {
    /// Over the whole way.
    pub residual: ResidualSummary,
    /// The largest range within any metre, in µm: a standard may allow 5.
    pub over_a_metre_um: f64,
    /// The largest change from one position to the next, in µm: small compared with the range where what is left is smooth.
    pub step_um: f64,
}

/// A way on a curve or a diagonal.
#[derive(Clone, Debug)]
pub struct MethodResult {
    /// Which way.
    pub way: CurveMethod,
    /// Coefficients of all curves that it takes.
    pub coefficients: usize,
    /// The residual error.
    pub left: ResidualDeviation,
    /// Largest jump of the correction's speed, in mm/s, at least 0; 0 for what has no corners.
    pub jump_mm_per_s: f64,
    /// The largest acceleration that the correction needs of its axis, in mm/s²: its curvature at this feed,
    /// and a jump within a cycle.
    pub acceleration_mm_per_s2: f64,
    /// The correction's speed over the way, to be drawn: mm, and µm/s.
    pub speed: Vec<[f64; 2]>,
}

impl MethodTable {
    /// Returns the table as a page, with the speeds of the corrections drawn, made of what `origin` says.
    #[must_use]
    pub fn to_html(&self, origin: &Provenance) -> String {
        html_report::render_html(self, origin)
    }
}

/// Returns the table of `runs`.
///
/// # Errors
/// Those of [`fit_straightness_run`]; a diagonal whose error's own axis moves, that is not straight, or of which a curve is missing.
pub fn build_method_table(
    runs: &[UncompensatedRun<'_>],
    options: &MethodTableOptions<'_>,
) -> Result<MethodTable, InputFileError> {
    let mut curves: Vec<StraightnessCurve> = Vec::new();
    let mut diagonals: Vec<DiagonalRun<'_>> = Vec::new();
    for run in runs {
        let error = resolve_error_axis(run, options.quantity)?;
        let errors = run.require_column(&error_column_name(error))?;
        let axes: Vec<LinearAxis> =
            moving_axes(run, errors).into_iter().map(|(axis, _)| axis).collect();
        if axes.len() < 2 {
            curves.push(fit_straightness_run(run, options.quantity, &options.options)?);
        } else {
            diagonals.push(DiagonalRun { run, error, axes });
        }
    }
    let all: Vec<ModelledCurve<'_>> = curves
        .iter()
        .map(|curve| ModelledCurve { curve, models: fit_models(&curve.fit) })
        .collect();
    let mut entries: Vec<MethodTableEntry> =
        all.iter().map(|curve| build_curve_entry(curve, options)).collect();
    for diagonal in &diagonals {
        entries.push(diagonal.build_entry(&all, options)?);
    }
    Ok(MethodTable {
        entries,
        feed_mm_per_min: options.feed_mm_per_min,
        cycle_ms: options.cycle_ms,
    })
}

/// A curve by each way.
struct ModelledCurve<'c> {
    curve: &'c StraightnessCurve,
    models: Vec<(CurveMethod, CurveModel)>,
}

impl ModelledCurve<'_> {
    fn fit(&self) -> &StraightnessFit {
        &self.curve.fit
    }
}

fn build_curve_entry(
    curve: &ModelledCurve<'_>,
    options: &MethodTableOptions<'_>,
) -> MethodTableEntry {
    let sites = &curve.fit().sites;
    let [low_mm, high_mm] = sites.end_positions_mm();
    let rows = curve.models.iter().map(|(way, model)| {
        let share =
            CurveContribution { model, start_mm: low_mm, cosine: 1.0, ends_mm: [low_mm, high_mm] };
        evaluate_method(*way, &[share], &shift_sites(sites, low_mm), options)
    });
    MethodTableEntry {
        name: curve.curve.section_name(),
        positions: sites.len(),
        without: ResidualDeviation::from_residuals(sites, &sites.y),
        rows: rows.collect(),
        steps: paper_method_residual_steps(curve.fit()),
    }
}

/// Returns the same from 0 on.
fn shift_sites(sites: &Sites, by_mm: f64) -> Sites {
    Sites { x: sites.x.iter().map(|x| x - by_mm).collect(), ..sites.clone() }
}

/// A run in which several axes move.
struct DiagonalRun<'r> {
    run: &'r UncompensatedRun<'r>,
    error: LinearAxis,
    axes: Vec<LinearAxis>,
}

impl DiagonalRun<'_> {
    fn build_entry(
        &self,
        curves: &[ModelledCurve<'_>],
        options: &MethodTableOptions<'_>,
    ) -> Result<MethodTableEntry, InputFileError> {
        let error = self.error.name();
        let names: Vec<&str> = self.axes.iter().map(|axis| axis.name()).collect();
        let names = names.join(" and ");
        let column = error_column_name(self.error);
        let bad = |rule: String| self.run.value_error(0, &column, rule);
        if self.axes.contains(&self.error) {
            return Err(bad(format!(
                "is measured while {names} move: a diagonal of the table measures an axis that stands still"
            )));
        }
        let its: Vec<&ModelledCurve<'_>> = self
            .axes
            .iter()
            .map(|axis| {
                let is_it = |curve: &&ModelledCurve<'_>| {
                    curve.curve.error == self.error && curve.curve.along == *axis
                };
                curves.iter().find(is_it).ok_or_else(|| {
                    bad(format!(
                        "is a diagonal of {names}: give the run of {error} over {} alone by --run as well",
                        axis.name()
                    ))
                })
            })
            .collect::<Result<_, _>>()?;
        let PathReadings { mut sites, starts_mm, cosines } = self.path_readings(&bad)?;
        sites.subtract_reference_line(options.options.reference);
        let mut rows = Vec::new();
        for way in CurveMethod::ALL {
            let mut shares = Vec::new();
            for (n, curve) in its.iter().enumerate() {
                let own = curve.models.iter().filter(|model| model.0 == way);
                shares.extend(own.map(|(_, model)| CurveContribution {
                    model,
                    start_mm: starts_mm[n],
                    cosine: cosines[n],
                    ends_mm: curve.fit().sites.end_positions_mm(),
                }));
            }
            rows.push(evaluate_method(way, &shares, &sites, options));
        }
        Ok(MethodTableEntry {
            name: format!("d{error} on the diagonal of {names}"),
            positions: sites.len(),
            without: ResidualDeviation::from_residuals(&sites, &sites.y),
            rows,
            steps: Vec::new(),
        })
    }

    /// Returns the readings over the way from the end at which the first axis stands lowest.
    fn path_readings(
        &self,
        bad: &dyn Fn(String) -> InputFileError,
    ) -> Result<PathReadings, InputFileError> {
        let errors = self.run.require_column(&error_column_name(self.error))?;
        let positions: Vec<&[f64]> = self
            .axes
            .iter()
            .map(|axis| self.run.require_column(&axis.column_name()))
            .collect::<Result<_, _>>()?;
        let there: Vec<usize> = (0..errors.len())
            .filter(|&row| {
                !errors[row].is_nan() && positions.iter().all(|position| !position[row].is_nan())
            })
            .collect();
        let by_first = |a: &&usize, b: &&usize| positions[0][**a].total_cmp(&positions[0][**b]);
        let ends = there.iter().min_by(by_first).zip(there.iter().max_by(by_first));
        let (&low, &high) = ends.ok_or_else(|| bad("has no row with all positions".into()))?;
        let starts_mm: Vec<f64> = positions.iter().map(|position| position[low]).collect();
        let ways: Vec<f64> =
            positions.iter().map(|position| position[high] - position[low]).collect();
        let length = ways.iter().map(|way| way * way).sum::<f64>().sqrt();
        let cosines: Vec<f64> = ways.iter().map(|way| way / length).collect();
        let mut along = Vec::new();
        for &row in &there {
            let from: Vec<f64> = positions
                .iter()
                .zip(&starts_mm)
                .map(|(position, start)| position[row] - start)
                .collect();
            let d = from.iter().zip(&cosines).map(|(from, cosine)| from * cosine).sum::<f64>();
            let off = from.iter().zip(&cosines).map(|(from, cosine)| (from - d * cosine).abs());
            let off = off.fold(0.0, f64::max);
            if off > DIAGONAL_STRAIGHTNESS_TOLERANCE * length {
                return Err(self.run.value_error(
                    row,
                    &format!("{}_mm", self.axes[0].name()),
                    format_args!(
                        "is {off:.1} mm off the straight line between the ends: a diagonal goes straight"
                    ),
                ));
            }
            along.push(d);
        }
        let errors: Vec<f64> = there.iter().map(|&row| errors[row]).collect();
        let sites = Sites::from_readings(&along, &errors)
            .map_err(|fault: StraightnessFitError| bad(fault.to_string()))?;
        Ok(PathReadings { sites, starts_mm, cosines })
    }
}

/// Readings over the way, and the way by axis.
struct PathReadings {
    sites: Sites,
    /// Where the way begins, by axis, in mm.
    starts_mm: Vec<f64>,
    /// How far each axis goes for 1 mm of the way, −1…1.
    cosines: Vec<f64>,
}

/// The share of one curve in a correction along a straight way.
struct CurveContribution<'m> {
    model: &'m CurveModel,
    start_mm: f64,
    cosine: f64,
    /// Where it was measured: outside, the end values are held.
    ends_mm: [f64; 2],
}

impl CurveContribution<'_> {
    /// Returns the position of its axis, and whether the curve was measured there.
    fn clamped_axis_position_mm(&self, way_mm: f64) -> (f64, bool) {
        let [low, high] = self.ends_mm;
        let x = self.start_mm + self.cosine * way_mm;
        (x.clamp(low, high), (low..=high).contains(&x))
    }

    fn value_um(&self, way_mm: f64) -> f64 {
        self.model.evaluate(self.clamped_axis_position_mm(way_mm).0)
    }

    /// For 1 mm of the way: µm/mm and µm/mm².
    fn slope_and_curvature(&self, way_mm: f64) -> [f64; 2] {
        let (x, is_inside) = self.clamped_axis_position_mm(way_mm);
        if !is_inside {
            return [0.0; 2];
        }
        let [slope, curvature] = self.model.slope_and_curvature(x);
        [self.cosine * slope, self.cosine * self.cosine * curvature]
    }
}

fn evaluate_method(
    way: CurveMethod,
    shares: &[CurveContribution<'_>],
    sites: &Sites,
    options: &MethodTableOptions<'_>,
) -> MethodResult {
    let value = |at: f64| shares.iter().map(|share| share.value_um(at)).sum::<f64>();
    let left: Vec<f64> = sites.points().map(|(at, um, _)| um - value(at)).collect();
    let feed_mm_per_s = options.feed_mm_per_min / 60.0;
    let [first, last] = sites.end_positions_mm();
    let mut speed = Vec::new();
    let mut curvature_most = 0.0_f64;
    for n in 0..=EVALUATION_INTERVALS {
        let at = first + (last - first) * f64::from(n) / f64::from(EVALUATION_INTERVALS);
        let each = shares.iter().map(|share| share.slope_and_curvature(at));
        let [slope, curvature] = each.fold([0.0; 2], |[a, b], [c, d]| [a + c, b + d]);
        speed.push([at, slope * feed_mm_per_s]);
        curvature_most = curvature_most.max(curvature.abs());
    }
    let jumps = shares.iter().map(|share| share.model.max_slope_jump() * share.cosine.abs());
    let jump_mm_per_s = 1e-3 * feed_mm_per_s * jumps.fold(0.0, f64::max);
    let bent = 1e-3 * curvature_most * feed_mm_per_s * feed_mm_per_s;
    MethodResult {
        way,
        coefficients: shares.iter().map(|share| share.model.coefficient_count()).sum(),
        left: ResidualDeviation::from_residuals(sites, &left),
        jump_mm_per_s,
        acceleration_mm_per_s2: bent.max(jump_mm_per_s / (1e-3 * options.cycle_ms)),
        speed,
    }
}

impl ResidualDeviation {
    fn from_residuals(sites: &Sites, left_um: &[f64]) -> Self {
        let mut over_a_metre_um = 0.0_f64;
        for (n, &from) in sites.x.iter().enumerate() {
            let within =
                sites.x[n..].iter().take_while(|&&x| x - from <= REFERENCE_LENGTH_MM).count();
            let (mut low, mut high) = (left_um[n], left_um[n]);
            for &um in &left_um[n..n + within] {
                (low, high) = (low.min(um), high.max(um));
            }
            over_a_metre_um = over_a_metre_um.max(high - low);
        }
        let steps = left_um.windows(2).map(|pair| (pair[1] - pair[0]).abs());
        let step_um = steps.fold(0.0, f64::max);
        Self { residual: ResidualSummary::from_residuals(left_um), over_a_metre_um, step_um }
    }
}
