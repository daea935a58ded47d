//! How far an axis may be sent, and from which end.
//!
//! ```text
//!   travel_mm   |<----------------------------------------------->|
//!   --margin     |<--------------------------------------------->|
//!   --range               |<------------------->|
//!   over-travel            |<-->|  targets |<-->|
//! ```
//!
//! A vertical axis, or one along which the tool points, moves only in a range that the user gave, and begins at
//! the end at which the tool is retracted.

use trueup_machine::{
    Machine,
    machine_file::{LinearAxis, MachineKind},
};

pub(crate) use crate::arc::round_to_micrometres;
use crate::{options::MeasurementOptions, plan::Step, program_error::ProgramError};

/// An axis and where it may move, in mm, whole micrometres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct AxisTravel {
    pub axis: LinearAxis,
    pub low_mm: f64,
    pub high_mm: f64,
    /// Which way retracts the tool: +1, −1; `None`: the axis is neither vertical nor along the tool.
    pub retract: Option<f64>,
}

/// The over-travel of the paper's own program (N10 … X50), in mm: so far an axis goes before it comes
/// back, so that all play is taken up.
const MAX_OVERTRAVEL_MM: f64 = 50.0;
/// A short axis has less: this share of it.
const OVERTRAVEL_FRACTION: f64 = 0.05;
/// The shortest range, in mm: its over-travel of 0.1 mm still takes up the play of a worn axis.
const MIN_MEASURED_RANGE_MM: f64 = 2.0;
/// An axis that turns more than this share of its way into a way along the tool is a tool axis; 1 % is the tilt of
/// a spindle that is out of square by far.
const MIN_TOOL_DIRECTION_COMPONENT: f64 = 0.01;
/// No axis is longer, in mm.
const MAX_POSITION_MM: f64 = 100_000.0;

impl AxisTravel {
    pub fn length_mm(&self) -> f64 {
        self.high_mm - self.low_mm
    }

    /// Returns how far the axis goes beyond a target before it approaches it, in mm.
    pub(crate) fn over_travel_mm(&self) -> f64 {
        round_to_micrometres(MAX_OVERTRAVEL_MM.min(OVERTRAVEL_FRACTION * self.length_mm()))
    }

    /// Returns the ends between which targets may be, in mm.
    pub(crate) fn target_range_mm(&self) -> [f64; 2] {
        let over_mm = self.over_travel_mm();
        [round_to_micrometres(self.low_mm + over_mm), round_to_micrometres(self.high_mm - over_mm)]
    }

    /// Returns true if the axis begins at its upper end.
    pub(crate) fn starts_at_upper_end(&self) -> bool {
        self.retract == Some(1.0)
    }

    /// Returns the ends in the order in which the axis goes to them: the retracted one first.
    pub(crate) fn ends_in_approach_order_mm(&self) -> [f64; 2] {
        self.arrange_in_approach_order([self.low_mm, self.high_mm])
    }

    /// Returns rising places in the order in which the axis goes to them.
    pub(crate) fn arrange_in_approach_order<T: AsMut<[f64]>>(&self, mut rising_mm: T) -> T {
        if self.starts_at_upper_end() {
            rising_mm.as_mut().reverse();
        }
        rising_mm
    }

    /// Returns an approach of this axis.
    pub(crate) fn approach_step(&self, mm: f64) -> Step {
        Step::Approach { axis: self.axis.index(), to_mm: round_to_micrometres(mm) }
    }

    /// Returns targets about `step_mm` apart over the inside, both ends included, rising.
    pub(crate) fn evenly_spaced_targets_mm(&self, step_mm: f64) -> Result<Vec<f64>, ProgramError> {
        let [low, high] = self.target_range_mm();
        evenly_spaced_positions_mm(low, high, step_mm).ok_or_else(|| {
            ProgramError(format!(
                "--step-mm {step_mm} does not fit: {} may be sent from {low} to {high} mm, which gives \
                 2 to {MAX_TARGETS} targets",
                self.axis.name()
            ))
        })
    }

    /// Returns a place of this axis alone.
    pub(crate) fn target_position_mm(&self, mm: f64) -> [Option<f64>; 3] {
        let mut to = [None; 3];
        to[self.axis.index()] = Some(round_to_micrometres(mm));
        to
    }
}

/// The most targets of a run: what `fit pitch` takes for single targets.
const MAX_TARGETS: usize = 2048;

/// From `low` to `high` in steps of at most `step`; `None` where there are too many or no two.
pub(crate) fn evenly_spaced_positions_mm(low: f64, high: f64, step: f64) -> Option<Vec<f64>> {
    // A step that fits but for rounding is no longer one.
    let steps = ((high - low) / step - 1e-9).ceil().max(1.0);
    if !(high > low && steps < MAX_TARGETS as f64) {
        return None;
    }
    let count = steps as usize;
    let at = |n: usize| round_to_micrometres(low + (high - low) * n as f64 / count as f64);
    Some((0..=count).map(at).collect())
}

/// Returns which way of `axis` retracts the tool (+1, −1), if it is a vertical or tool axis. Z counts as vertical
/// on every machine, X of a lathe as one that leads to the work.
pub(crate) fn retract_direction(machine: &Machine, axis: LinearAxis) -> Option<f64> {
    let along = machine.tool_direction[axis.index()];
    if along.abs() > MIN_TOOL_DIRECTION_COMPONENT {
        return Some(-along.signum());
    }
    // On a lathe X+ leads away from the work.
    let is_towards_work =
        axis == LinearAxis::Z || machine.kind == MachineKind::Lathe && axis == LinearAxis::X;
    is_towards_work.then_some(1.0)
}

/// Returns where an axis may move, or a sentence that says why it may not.
///
/// # Errors
/// A range leaves the travel of the machine file.
pub(crate) fn resolve_travel(
    machine: &Machine,
    options: &MeasurementOptions,
    axis: LinearAxis,
) -> Result<Result<AxisTravel, String>, ProgramError> {
    let name = axis.name();
    if machine.kind == MachineKind::Lathe && axis == LinearAxis::Y {
        return Ok(Err("programs of a lathe move X and Z only".into()));
    }
    let known = machine.axes[axis.index()].travel_mm;
    let range = options.range_mm[axis.index()];
    let retract = retract_direction(machine, axis);
    let leads = match machine.kind {
        MachineKind::Lathe => "leads to the work",
        _ => "is vertical or along the tool",
    };
    if let (Some([low_mm, high_mm]), Some([low, high])) = (range, known)
        && (low_mm < low || high_mm > high)
    {
        return Err(ProgramError(format!(
            "--range {name}={low_mm}:{high_mm} is outside the machine file's travel_mm of {low} to \
             {high} mm"
        )));
    }
    let Some([low, high]) = range.or(known) else {
        return Ok(Err(missing_travel_message(name, retract)));
    };
    if retract.is_some() && range.is_none() {
        return Ok(Err(format!(
            "{name} {leads}, and moves only in a stated range: give --range \
             {name}=LOW:HIGH in mm, inside travel_mm of {low} to {high}"
        )));
    }
    // Where no travel is known, its ends may be those of the range.
    let [first, last] = known.unwrap_or([low, high]);
    let margin_mm = options.margin_mm;
    // A hundredth of a micrometre is rounding.
    let low_mm = (low.max(first + margin_mm) * 1000.0 - 0.01).ceil() / 1000.0;
    let high_mm = (high.min(last - margin_mm) * 1000.0 + 0.01).floor() / 1000.0;
    if first.abs().max(last.abs()) > MAX_POSITION_MM {
        return Ok(Err(format!("{name} would be sent beyond {MAX_POSITION_MM} mm")));
    }
    if high_mm - low_mm < MIN_MEASURED_RANGE_MM {
        return Ok(Err(format!(
            "{name} from {low} to {high} mm leaves less than {MIN_MEASURED_RANGE_MM} mm within the \
             margin of {margin_mm} mm to the ends of travel. Give a longer --range \
             {name}=LOW:HIGH or a smaller --margin"
        )));
    }
    Ok(Ok(AxisTravel { axis, low_mm, high_mm, retract }))
}

/// Returns the requested axes that may move, and a note for each that may not.
///
/// # Errors
/// A range leaves the travel of the machine file, or no axis is left.
pub(crate) fn resolve_travels(
    machine: &Machine,
    options: &MeasurementOptions,
) -> Result<(Vec<AxisTravel>, Vec<String>), ProgramError> {
    let (mut travels, mut reasons) = (Vec::new(), Vec::new());
    for axis in LinearAxis::ALL {
        let is_meant = match machine.kind {
            MachineKind::Lathe if options.axes.is_empty() => axis != LinearAxis::Y,
            _ => options.axes.is_empty() || options.axes.contains(&axis),
        };
        if is_meant {
            match resolve_travel(machine, options, axis)? {
                Ok(travel) => travels.push(travel),
                Err(why) => reasons.push((axis, why)),
            }
        }
    }
    if travels.is_empty() {
        let reasons: Vec<String> = reasons.into_iter().map(|(_, why)| why).collect();
        return Err(ProgramError(reasons.join("; ")));
    }
    let note = |(axis, why): (LinearAxis, String)| format!("no program for {}: {why}", axis.name());
    Ok((travels, reasons.into_iter().map(note).collect()))
}

fn missing_travel_message(axis: &str, retract: Option<f64>) -> String {
    if retract.is_some() {
        return format!(
            "the travel of {axis} is not known. Write travel_mm under [axis.{axis}] of the \
             machine file, and give --range {axis}=LOW:HIGH, as it is vertical or along the tool"
        );
    }
    format!(
        "the travel of {axis} is not known: write travel_mm = [0.0, 1000.0] under [axis.{axis}] of the \
         machine file, or give --range {axis}=0:1000"
    )
}
