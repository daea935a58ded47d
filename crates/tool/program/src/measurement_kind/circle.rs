//! A circle in both directions, for a ball bar, a grid plate or an indicator that reads the radius on the way (ISO 230-4).
//!
//! | plane | way | rows of the run file |
//! |---|---|---|
//! | across the tool | two turns in each direction | 450°: from 135° behind the start to as much before the end |
//! | along the tool | 220° in each direction, over the retracted half: below the pivot the spindle would be in its way | all but 2° at both ends |
//!
//! The program goes to the centre and stops, so that the pivot is put under the tool; then to the start, where it stops for
//! the bar. A circle is given from its start alone: no control has machine coordinates in the block of an arc.

use trueup_machine::{
    Machine,
    machine_file::{LinearAxis, MachineKind},
};

use super::{
    COMPENSATION_OFF_PRECAUTION, PlansWithNotes, base_plan, head_zero_precaution, plan_each_pair,
    unused_clearance_note, uppercase_axis_name,
};
use crate::{
    arc::ArcMove,
    options::MeasurementOptions,
    plan::{Column, MeasurementPlan, Step},
    program_error::ProgramError,
    travel::{AxisTravel, resolve_travels, round_to_micrometres},
};

/// Usual lengths of ball bars in mm.
const BALL_BAR_LENGTHS_MM: [f64; 4] = [300.0, 150.0, 100.0, 50.0];
/// A turn takes 38 s: an instrument that reads ten times a second has a reading each degree …
const FEED_RADII_PER_MIN: f64 = 10.0;
/// … but no feed is higher unless it is requested, in mm/min.
const MAX_DEFAULT_FEED_MM_PER_MIN: f64 = 1000.0;
/// How far a part of a circle goes below the pivot, in degrees, so that both reversals are in it.
const ANGLE_BELOW_PIVOT_DEG: f64 = 20.0;
/// An axis with more than this share of the tool direction leads along the tool.
const MIN_TOOL_DIRECTION_COMPONENT: f64 = 0.01;
/// The most by which a circle through whole micrometres is larger, in mm.
const MAX_RADIUS_ROUNDING_MM: f64 = 0.001;
/// The radius within which a control takes the rounding of both ends for a circle, in mm.
const MIN_CIRCLE_RADIUS_MM: f64 = 1.0;

pub(crate) fn create_plans(
    machine: &Machine,
    options: &MeasurementOptions,
) -> Result<PlansWithNotes, ProgramError> {
    if machine.kind == MachineKind::Lathe {
        return Err(ProgramError(
            "a circle around the axis of a lathe has no far side: X and Z of a turret reach half of it at best".into(),
        ));
    }
    let (travels, notes) = resolve_travels(machine, options)?;
    let (mut plans, mut notes) =
        plan_each_pair(&travels, notes, "circle", |pair| create_plan(machine, pair, options))?;
    // All planes are measured first: together they say which axis is in error.
    let runs: Vec<String> = plans.iter().map(|plan| format!("--run {}.csv", plan.name)).collect();
    if let Some(last) = plans.last_mut() {
        last.then = vec![format!("trueup fit circle {}", runs.join(" "))];
    }
    notes.extend(unused_clearance_note(options));
    Ok((plans, notes))
}

/// The way around the centre, for a radius of 1.
struct UnitArc {
    /// Where the first direction starts, in degrees from the first axis of the plane.
    start_deg: f64,
    turn_deg: f64,
    read_deg: [u32; 2],
    /// From where to where both axes go, from the centre.
    extent: [[f64; 2]; 2],
}

impl UnitArc {
    /// Returns the way in the plane of both axes: whole turns, or the retracted half where one is along the tool.
    fn for_plane(machine: &Machine, pair: [&AxisTravel; 2]) -> Self {
        let along = pair.map(|travel| machine.tool_direction[travel.axis.index()]);
        let most = usize::from(along[1].abs() > along[0].abs());
        if along[most].abs() <= MIN_TOOL_DIRECTION_COMPONENT {
            return Self {
                start_deg: 0.0,
                turn_deg: 720.0,
                read_deg: [135, 585],
                extent: [[-1.0, 1.0]; 2],
            };
        }
        let retracted = if along[most] < 0.0 { 1.0 } else { -1.0 };
        let below = ANGLE_BELOW_PIVOT_DEG.to_radians().sin();
        let mut extent = [[-1.0, 1.0]; 2];
        extent[most] = if retracted > 0.0 { [-below, 1.0] } else { [-1.0, below] };
        let top_deg = 90.0 * most as f64 + if retracted > 0.0 { 0.0 } else { 180.0 };
        let half = 90.0 + ANGLE_BELOW_PIVOT_DEG;
        let turn_deg = 2.0 * half;
        Self { start_deg: top_deg - half, turn_deg, read_deg: [2, turn_deg as u32 - 2], extent }
    }
}

/// Returns both axes in the order of the plane: X to Y, Y to Z, Z to X.
fn order_by_plane([first, second]: [&AxisTravel; 2]) -> [&AxisTravel; 2] {
    match (first.axis, second.axis) {
        (LinearAxis::X, LinearAxis::Z) => [second, first],
        _ => [first, second],
    }
}

/// Returns the radius, and the centre of both axes; each place is in its range.
fn place_circle(
    pair: [&AxisTravel; 2],
    way: &UnitArc,
    options: &MeasurementOptions,
) -> Result<(f64, [f64; 2]), ProgramError> {
    let room = |n: usize, radius: f64| -> [f64; 2] {
        let [low, high] = way.extent[n];
        [
            pair[n].low_mm - low * radius + MAX_RADIUS_ROUNDING_MM,
            pair[n].high_mm - high * radius - MAX_RADIUS_ROUNDING_MM,
        ]
    };
    let centre = |n: usize, radius: f64| {
        let [low, high] = room(n, radius);
        options.at_mm[pair[n].axis.index()].unwrap_or(round_to_micrometres((low + high) / 2.0))
    };
    let fits = |n: usize, radius: f64| {
        let [low, high] = room(n, radius);
        (low..=high).contains(&centre(n, radius))
    };
    let found = match options.radius_mm {
        Some(radius) => Some(round_to_micrometres(radius)),
        None => BALL_BAR_LENGTHS_MM.into_iter().find(|radius| (0..2).all(|n| fits(n, *radius))),
    };
    let radius = found.unwrap_or(BALL_BAR_LENGTHS_MM[BALL_BAR_LENGTHS_MM.len() - 1]);
    if let Some(n) = (0..2).find(|n| !fits(*n, radius)) {
        let name = pair[n].axis.name();
        let [low, high] =
            way.extent[n].map(|end| round_to_micrometres(centre(n, radius) + end * radius));
        return Err(ProgramError(format!(
            "a circle of {radius} mm would send {name} from {low} to {high} mm, and it may move \
             from {} to {} mm. Give a smaller --radius, another centre by --at, or a longer \
             --range {name}=LOW:HIGH",
            pair[n].low_mm, pair[n].high_mm
        )));
    }
    if radius < MIN_CIRCLE_RADIUS_MM {
        return Err(ProgramError(format!("--radius {radius}: at least {MIN_CIRCLE_RADIUS_MM} mm")));
    }
    Ok((radius, [0, 1].map(|n| centre(n, radius))))
}

fn create_plan(
    machine: &Machine,
    pair: [&AxisTravel; 2],
    options: &MeasurementOptions,
) -> Result<MeasurementPlan, ProgramError> {
    let pair = order_by_plane(pair);
    let axes = pair.map(|travel| travel.axis.index());
    let way = UnitArc::for_plane(machine, pair);
    let (radius, centre_mm) = place_circle(pair, &way, options)?;
    let still = LinearAxis::ALL[3 - axes[0] - axes[1]];
    let (sin, cos) = way.start_deg.to_radians().sin_cos();
    let start_mm = [cos, sin].map(|component| component * radius);
    let start_mm = [0, 1].map(|n| round_to_micrometres(centre_mm[n] + start_mm[n]));
    let own_feed = (FEED_RADII_PER_MIN * radius).min(MAX_DEFAULT_FEED_MM_PER_MIN);
    let feed = options.feeds_mm_per_min.first().copied().unwrap_or(own_feed);
    let read_deg = way.read_deg;
    let arc = |turn_deg| ArcMove { axes, centre_mm, turn_deg, read_deg, feed_mm_per_min: feed };
    let extent_mm = arc(way.turn_deg).extent_mm(start_mm);
    // What leads along the tool or is vertical goes to its retracted end first.
    let retracted = |n: usize| {
        let [low, high] = extent_mm[n];
        pair[n].retract.map(|way| if way > 0.0 { high } else { low })
    };
    let retract = || (0..2).filter_map(|n| Some(pair[n].approach_step(retracted(n)?)));
    // Last of all it goes to its place.
    let mut order = [0, 1];
    order.sort_by_key(|n| pair[*n].retract.is_some());
    let to = |mm: [f64; 2]| order.map(|n| pair[n].approach_step(mm[n]));
    let mut steps: Vec<Step> = retract().collect();
    steps.extend(to(centre_mm));
    steps.push(Step::Stop(circle_centre_instructions(pair, still, machine)));
    steps.extend(retract());
    steps.extend(to(start_mm));
    steps.push(Step::Stop(circle_start_instructions(pair, radius, &way, feed)));
    // If the axes were jogged, the circle begins at the right place all the same.
    steps.extend(to(start_mm));
    let both = [arc(way.turn_deg), arc(-way.turn_deg)].map(Step::Arc);
    let [there, back] = both;
    steps.extend([there, Step::Dwell(options.dwell_s), back]);
    let name = pair.map(|travel| travel.axis.name()).concat();
    let mut columns = vec![Column::Constant("setup", 1.0)];
    columns.extend(LinearAxis::ALL.into_iter().filter_map(|axis| match axis == still {
        false => Some(Column::Position(axis.index())),
        true => Some(Column::Stands(axis.index(), options.at_mm[axis.index()]?)),
    }));
    let length_mm = options.tool_lengths_mm.first();
    columns.extend(length_mm.map(|mm| Column::Constant("tool_length_mm", *mm)));
    columns.extend([Column::Sense, Column::Feed, Column::Empty("measured_dr_um".into())]);
    let mut precautions = head_zero_precaution(machine);
    if let Some(mm) = options.at_mm[still.index()] {
        precautions.push(format!("{} stands at {mm} mm.", uppercase_axis_name(still)));
    }
    precautions.push("No ball bar yet: the program stops for it.".into());
    Ok(MeasurementPlan {
        notes: collect_notes(&name, radius, centre_mm, still, options),
        name: format!("circle-{name}"),
        precautions,
        steps,
        columns,
        ..base_plan(machine, options)
    })
}

fn collect_notes(
    plane: &str,
    radius: f64,
    centre_mm: [f64; 2],
    still: LinearAxis,
    options: &MeasurementOptions,
) -> Vec<String> {
    let [u, v] = centre_mm;
    let mut notes = vec![
        COMPENSATION_OFF_PRECAUTION.to_string(),
        "A reading is the radius, actual minus nominal, plus outward; a row for each degree."
            .into(),
        format!(
            "The table of an instrument that has angles becomes a run file by: trueup import \
             TABLE.csv --radius {radius} --centre {u},{v} --plane {plane} --direction ccw -o \
             ccw.csv. For the other direction use cw."
        ),
    ];
    let name = still.name();
    if options.at_mm[still.index()].is_none() {
        notes.push(format!(
            "trueup fit volume needs to know where {0} stands, which trueup fit circle does not: --at {name}=MM.",
            uppercase_axis_name(still)
        ));
    }
    notes
}

/// Returns the instructions for the operator at the centre.
fn circle_centre_instructions(
    pair: [&AxisTravel; 2],
    still: LinearAxis,
    machine: &Machine,
) -> Vec<String> {
    let [u, v] = pair.map(|travel| uppercase_axis_name(travel.axis));
    let mut text = vec![
        format!(
            "Here is the centre. Jog {0} alone: set the pivot of the bar, or the zero of the instrument, under the tool.",
            uppercase_axis_name(still)
        ),
        format!(
            "Fix it, and jog {0} clear of it. {u} and {v} go to the start next.",
            uppercase_axis_name(still)
        ),
    ];
    if pair.iter().any(|travel| {
        machine.tool_direction[travel.axis.index()].abs() > MIN_TOOL_DIRECTION_COMPONENT
    }) {
        text[1] =
            format!("Fix it, and take the tool ball out of it. {u} and {v} go to the start next.");
    }
    text
}

/// Returns the instructions for the operator at the start.
fn circle_start_instructions(
    pair: [&AxisTravel; 2],
    radius: f64,
    way: &UnitArc,
    feed: f64,
) -> Vec<String> {
    let [u, v] = pair.map(|travel| uppercase_axis_name(travel.axis));
    let what = match way.turn_deg > 360.0 {
        true => "two turns counter-clockwise, then two clockwise",
        false => "220 degrees counter-clockwise, then back",
    };
    vec![
        format!("Set the bar of {radius} mm, or the instrument. Start its record."),
        format!(
            "{u} and {v} make {what}, at {feed} mm/min, from {u} to {v}. All within {radius} mm must be clear."
        ),
    ]
}
