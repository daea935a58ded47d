//! Options of `program` for circles and for probed artefacts: place, size, stylus.

use clap::Args;
use trueup_machine::machine_file::{LinearAxis, RotaryAxis};
use trueup_program::MeasurementOptions;

use super::motion_args;
use crate::UserError;

/// Place, size and stylus.
#[derive(Args)]
pub struct ArtefactArgs {
    /// Where it is, in mm of the machine. For circle: the centre (default: the middle of the
    /// ranges), and where the axis stands that is not moved. For sphere and plate: where the axes
    /// would stand with the stylus ball in the centre of the ball (of a plate, its first ball). For
    /// square: the corner, and the height of the touches.
    #[arg(long, value_name = "x=MM,y=MM,z=MM", value_delimiter = ',', allow_hyphen_values = true)]
    at: Vec<String>,
    /// circle: the radius in mm. Default: the longest ball bar of 300, 150, 100 and 50 mm that has room.
    #[arg(long, value_name = "MM")]
    radius: Option<f64>,
    /// The length of the tool or stylus in mm, for the run file. Default: length_mm of the machine file. sphere, plate,
    /// square: several, one after the other; --at is for the first.
    #[arg(long, value_name = "MM,MM", value_delimiter = ',')]
    tool_length: Vec<f64>,
    /// sphere, plate, square: the diameter of the stylus ball, in mm.
    #[arg(long, value_name = "MM")]
    stylus: Option<f64>,
    /// sphere, plate, square: how far before a surface a touch begins, and how far behind it ends, in mm. Default: 3.
    #[arg(long, value_name = "MM")]
    search: Option<f64>,
    /// sphere, plate: the diameter of a ball, in mm.
    #[arg(long, value_name = "MM")]
    ball: Option<f64>,
    /// plate: how many balls along X and along Y. Default: 5x5. --step-mm is their distance.
    #[arg(long, value_name = "NxM")]
    balls: Option<String>,
    /// square: the length of both faces, in mm.
    #[arg(long, value_name = "MM")]
    size: Option<f64>,
    /// sphere: the angles of a rotary axis of the table at which it is touched, in degrees; several axes: all combinations.
    #[arg(long, value_name = "c=DEG,DEG", allow_hyphen_values = true)]
    angle: Vec<String>,
}

impl ArtefactArgs {
    /// Puts them into the options of a plan.
    pub fn apply_to(&self, options: &mut MeasurementOptions) -> Result<(), UserError> {
        for entry in &self.at {
            let named = entry.split_once('=').and_then(|(name, mm)| {
                Some((motion_args::parse_axis(name)?, mm.trim().parse().ok()?))
            });
            let (axis, mm): (LinearAxis, f64) = named
                .ok_or_else(|| UserError(format!("--at {entry}: must be like x=400,y=300")))?;
            if options.at_mm[axis.index()].replace(mm).is_some() {
                return Err(UserError(format!("--at {} is given twice", axis.name())));
            }
        }
        for entry in &self.angle {
            let (axis, angles) = parse_axis_angles(entry)
                .ok_or_else(|| UserError(format!("--angle {entry}: must be like c=-60,0,60")))?;
            if !std::mem::replace(&mut options.angles_deg[axis.index()], angles).is_empty() {
                return Err(UserError(format!("--angle {} is given twice", axis.name())));
            }
        }
        options.balls = match &self.balls {
            None => None,
            Some(text) => Some(
                text.split_once('x')
                    .and_then(|(one, other)| Some([one.parse().ok()?, other.parse().ok()?]))
                    .ok_or_else(|| UserError(format!("--balls {text}: must be like 5x5")))?,
            ),
        };
        options.radius_mm = self.radius;
        options.tool_lengths_mm.clone_from(&self.tool_length);
        options.stylus_mm = self.stylus;
        options.search_mm = self.search;
        options.ball_mm = self.ball;
        options.size_mm = self.size;
        Ok(())
    }
}

/// `c=-60,0,60`.
fn parse_axis_angles(text: &str) -> Option<(RotaryAxis, Vec<f64>)> {
    let (name, list) = text.split_once('=')?;
    let axis = RotaryAxis::ALL.into_iter().find(|axis| axis.name() == name.trim())?;
    let angles: Option<Vec<f64>> = list.split(',').map(|deg| deg.trim().parse().ok()).collect();
    Some((axis, angles?))
}
