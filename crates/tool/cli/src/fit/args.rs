//! The command line of `trueup fit`.

use std::path::PathBuf;

use clap::{Args, Subcommand};
use trueup_fit::{
    pitch::TableMode,
    straightness::{self, FitMethod, ReferenceLine},
};
use trueup_machine::machine_file::{ElongationSource, ThermalMode};

use crate::choice::described_choice_parser;

/// Fits a section of the machine file to measured runs, and says how well.
///
/// Exit 3: the runs say that it should not be compensated, and nothing is written; or a tolerance
/// is not reached.
#[derive(Args)]
pub struct FitArgs {
    #[command(subcommand)]
    pub kind: FitKind,
}

#[derive(Subcommand)]
pub enum FitKind {
    /// [straightness.z_of_x]: how an axis errs while another moves.
    Straightness(StraightnessArgs),
    /// [axis.x.pitch], and [axis.x.backlash] where it gains: an axis's position errors. The figures of ISO 230-2
    /// are written next to it as a page, OUT.html.
    Pitch(PitchArgs),
    /// [axis.x.backlash] alone; the figures of ISO 230-2 as a page, OUT.html.
    Backlash(BacklashArgs),
    /// [spindle.sensor] or [spindle.temperature]: the spindle's growth.
    Elongation(ElongationArgs),
    /// [spindle.warmup]: the growth over time, from cold; one run for each speed.
    Warmup(WarmupArgs),
    /// [axis.x.thermal]: an axis's growth with a temperature.
    Thermal(ThermalArgs),
    /// `[squareness]`, `[axis.x.backlash]`, `[axis.x.pitch]` and `[straightness.y_of_x]` by a ball
    /// bar or an indicator on a circle. Gives the causes of its form, the figures of ISO 230-4, and
    /// the polar plot as a page.
    Circle(CircleArgs),
    /// The 21 errors of three axes and the lines of rotary axes, from any mix of balls, step
    /// diagonals, circles, straight edges and lengths. Writes `[axis.x.pitch]`, `[straightness]`,
    /// `[squareness]`, `[angular]`, `[rotary]`.
    Volume(VolumeArgs),
    /// B-spline, polynomial and lines side by side on your straightness runs: nothing is fitted for the bridge.
    Table1(Table1Args),
}

impl FitKind {
    /// Returns the fits of positions, whose figures are those of ISO 230-2: their name, and which readings.
    pub fn position_args(&self) -> Option<(&'static str, &PositionArgs)> {
        match self {
            Self::Pitch(args) => Some(("pitch", &args.positions)),
            Self::Backlash(args) => Some(("backlash", &args.positions)),
            _ => None,
        }
    }
}

/// The runs, and the machine file.
#[derive(Args)]
pub struct FitInputArgs {
    /// A run file.
    #[arg(long, value_name = "RUN.csv", required = true)]
    pub run: Vec<PathBuf>,
    /// The machine file: by it what a bridge in the runs had applied is taken off, and into it a section is
    /// put. Without it only the section is written.
    #[arg(long, value_name = "M.toml")]
    pub machine: Option<PathBuf>,
}

#[derive(Args)]
pub struct CommonArgs {
    #[command(flatten)]
    pub measured: FitInputArgs,
    /// Where to write the machine file or the section.
    #[arg(long, value_name = "OUT.toml")]
    pub output: PathBuf,
}

/// Which error of an axis.
#[derive(Args)]
pub struct AxisErrorArgs {
    /// The error: dx, dy or dz; not needed where each run measures one only.
    #[arg(long, value_name = "dx|dy|dz")]
    quantity: Option<String>,
    /// The axis that errs: x is the same as --quantity dx.
    #[arg(long, value_name = "x|y|z", conflicts_with = "quantity", value_parser = ["x", "y", "z"])]
    axis: Option<String>,
}

impl AxisErrorArgs {
    /// Returns the quantity, or that of the axis.
    pub fn quantity(&self) -> Option<String> {
        self.axis.as_ref().map(|axis| format!("d{axis}")).or_else(|| self.quantity.clone())
    }
}

/// Options of a curve of straightness.
#[derive(Args)]
pub struct CurveArgs {
    #[command(flatten)]
    pub error: AxisErrorArgs,
    /// Take as many coefficients as it needs to keep every residual within this. Default: as many
    /// as the noise allows.
    #[arg(long, value_name = "UM")]
    pub tolerance_um: Option<f64>,
    /// The straight line from which the error counts.
    #[arg(long, default_value = "as-measured", value_parser = described_choice_parser(REFERENCE_LINES))]
    pub reference: ReferenceLine,
}

impl CurveArgs {
    pub fn to_options(&self) -> straightness::StraightnessFitOptions {
        straightness::StraightnessFitOptions {
            tolerance_um: self.tolerance_um,
            reference: self.reference,
            ..straightness::StraightnessFitOptions::default()
        }
    }
}

/// Which readings of an axis's positions.
#[derive(Args)]
pub struct PositionArgs {
    #[command(flatten)]
    pub error: AxisErrorArgs,
    /// Only the repeats with these numbers in the column run.
    #[arg(long, value_name = "1,2,3", value_delimiter = ',')]
    pub repeats: Option<Vec<f64>>,
}

/// Finds the causes of circles that a ball bar, a 2D indicator or a contour record has measured.
///
/// A run has x_mm, y_mm (or the two positions of another plane) and measured_dr_um, actual minus nominal radius. Its direction
/// is that of the order of its rows, or of the column dir (+1 counter-clockwise, -1 clockwise). Measure both directions.
///
/// Exit 3: nothing is claimed, and something is left that is no noise.
#[derive(Args)]
#[command(mut_arg("run", |run| run.help("A run file; may be given several times: both directions, up to three planes")))]
pub struct CircleArgs {
    #[command(flatten)]
    pub common: CommonArgs,
    /// The folder for report.html and circle.json. Default: no folder, the page is OUT.html.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
}

/// Finds the errors of the whole volume.
///
/// Each row has x_mm, y_mm, z_mm (a_deg, b_deg, c_deg, tool_length_mm, setup) and a measurement. A
/// ball: measured_dx_um with measured_dy_um and measured_dz_um. A diagonal: measured_diagonal_um. A
/// circle: measured_dr_um. A gauge on a straight edge, a length: one of measured_dx_um,
/// measured_dy_um, measured_dz_um. It says which errors are known, and which measurement would
/// settle the rest.
///
/// Exit 3: no correction is better on held-out readings by more than the standard error, and nothing is written.
#[derive(Args)]
pub struct VolumeArgs {
    /// A run file; may be given several times: all instruments and set-ups.
    #[arg(long, value_name = "RUN.csv", required = true)]
    pub run: Vec<PathBuf>,
    /// The machine file with the chain: what it predicts is taken off, and the errors are added to it.
    #[arg(long, value_name = "M.toml")]
    pub machine: PathBuf,
    /// Where to write the machine file.
    #[arg(short, long, value_name = "OUT.toml")]
    pub output: PathBuf,
    /// Standard uncertainty of a reading. Default: half of what the machine file states for the instrument, else from the readings alone.
    #[arg(long, value_name = "UM", value_parser = crate::diagnose::parse_positive)]
    pub instrument_um: Option<f64>,
    /// Standard uncertainty of the scale of artefact and laser. Without it the mean scale of the axes stays unknown.
    #[arg(long, value_name = "UM/M", value_parser = crate::diagnose::parse_positive)]
    pub scale_um_per_m: Option<f64>,
    /// Standard uncertainty of a point of the artefact. Without it balls count as exact, and the form of a straight edge stays unknown.
    #[arg(long, value_name = "UM", value_parser = crate::diagnose::parse_positive)]
    pub artefact_um: Option<f64>,
}

#[derive(Args)]
pub struct StraightnessArgs {
    #[command(flatten)]
    pub common: CommonArgs,
    #[command(flatten)]
    pub curve: CurveArgs,
    /// How the curve is found.
    #[arg(long, default_value = "least-squares", value_parser = described_choice_parser(FIT_METHODS))]
    pub method: FitMethod,
}

/// The table of the paper on straightness for your own runs. It says what a B-spline, a polynomial
/// of degree 7 and straight lines leave of each curve and diagonal. The columns are range, mean,
/// mean square, and within any metre. Also how much the correction's speed jumps at the corners of
/// lines, and what that requires of the axis.
///
/// A run in which one axis moves is a curve; one in which two move is a diagonal, and needs the curves of both.
#[derive(Args)]
#[command(mut_arg("run", |run| run.help("A run file, one for each curve and each diagonal")))]
pub struct Table1Args {
    #[command(flatten)]
    pub measured: FitInputArgs,
    #[command(flatten)]
    pub curve: CurveArgs,
    /// The feed along the way, in mm/min.
    #[arg(long, value_name = "MM/MIN", default_value_t = 1000.0, value_parser = crate::diagnose::parse_positive)]
    pub feed: f64,
    /// How often the control gives its axes a new target, in ms.
    #[arg(long, value_name = "MS", default_value_t = 1.0, value_parser = crate::diagnose::parse_positive)]
    pub cycle_ms: f64,
    /// The page with the table and the speeds, drawn.
    #[arg(short, long, value_name = "TABLE.html")]
    pub output: PathBuf,
}

const REFERENCE_LINES: [(ReferenceLine, &str, &str); 3] = [
    (ReferenceLine::AsMeasured, "as-measured", "None: the readings are errors already"),
    (ReferenceLine::EndPoints, "end-points", "Through the means at both ends"),
    (ReferenceLine::LeastSquares, "least-squares", "The least squares line"),
];

const FIT_METHODS: [(FitMethod, &str, &str); 2] = [
    (FitMethod::LeastSquares, "least-squares", "Knots where they are needed"),
    (FitMethod::Paper, "paper", "Points as control points, the worst one joins"),
];

#[derive(Args)]
#[command(mut_arg("run", |run| run.help("A run file; of a gantry axis one for each drive")))]
pub struct PitchArgs {
    #[command(flatten)]
    pub common: CommonArgs,
    #[command(flatten)]
    pub positions: PositionArgs,
    /// The step of the table. Default: that of the measured positions.
    #[arg(long, value_name = "MM")]
    pub step_mm: Option<f64>,
    /// One table, or one for each direction.
    #[arg(long, default_value = "automatic", value_parser = described_choice_parser(TABLE_MODES))]
    pub ways: TableMode,
}

const TABLE_MODES: [(TableMode, &str, &str); 3] = [
    (TableMode::Automatic, "automatic", "The choice that gains on held-out repeats"),
    (TableMode::One, "one", "One table, and also a backlash if that gains"),
    (TableMode::Both, "both", "One table for each direction"),
];

#[derive(Args)]
pub struct BacklashArgs {
    #[command(flatten)]
    pub common: CommonArgs,
    #[command(flatten)]
    pub positions: PositionArgs,
    /// The feed that parts are cut at, where the run has several and backlash depends on it. Default:
    /// the slowest.
    #[arg(long, value_name = "MM/MIN")]
    pub feed: Option<f64>,
}

#[derive(Args)]
#[command(mut_arg("run", |run| run.help("A run file; may be given several times")))]
pub struct ElongationArgs {
    #[command(flatten)]
    pub common: CommonArgs,
    /// The input that the growth depends on. Default: the machine file's source, else the run's columns.
    #[arg(long, value_parser = described_choice_parser(ELONGATION_SOURCES))]
    pub source: Option<ElongationSource>,
    /// The temperature that explains it.
    #[arg(long, value_name = "temp_<name>_c")]
    pub temperature: Option<String>,
}

const ELONGATION_SOURCES: [(ElongationSource, &str, &str); 2] = [
    (ElongationSource::Sensor, "sensor", "The displacement sensor"),
    (ElongationSource::Temperature, "temperature", "A temperature of the run"),
];

#[derive(Args)]
#[command(mut_arg("run", |run| run.help("A run file, one for each speed")))]
pub struct WarmupArgs {
    #[command(flatten)]
    pub common: CommonArgs,
}

#[derive(Args)]
#[command(mut_arg("run", |run| run.help("A run file; may be given several times")))]
pub struct ThermalArgs {
    #[command(flatten)]
    pub common: CommonArgs,
    #[command(flatten)]
    pub error: AxisErrorArgs,
    /// The terms of the model. Default: those of the machine file, else those that the run shows.
    #[arg(long, value_parser = described_choice_parser(THERMAL_MODES))]
    pub mode: Option<ThermalMode>,
    /// The temperature that explains it.
    #[arg(long, value_name = "temp_<name>_c")]
    pub temperature: Option<String>,
    /// Write a table over the temperature, with this many rows.
    #[arg(long, value_name = "ROWS", value_parser = clap::value_parser!(u16).range(2..=1000))]
    pub table: Option<u16>,
}

const THERMAL_MODES: [(ThermalMode, &str, &str); 3] = [
    (ThermalMode::Constant, "constant", "The same at every position"),
    (ThermalMode::Position, "position", "In proportion to the position"),
    (
        ThermalMode::Both,
        "both",
        "A part that is the same everywhere, and one in proportion to the position",
    ),
];
