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
    file::{Kind, LinearAxis},
};

use super::{Plans, WITHOUT_CORRECTION, capital, head_at_zero, without_clearance};
use crate::{
    arc::Arc,
    options::Options,
    plan::{Column, Plan, Step},
    refused::Refused,
    travel::{Travel, micrometres, travels},
};

/// Usual lengths of ball bars in mm.
const BARS_MM: [f64; 4] = [300.0, 150.0, 100.0, 50.0];
/// A turn takes 38 s: an instrument that reads ten times a second has a reading each degree …
const RADII_A_MIN: f64 = 10.0;
/// … but no feed is higher unless it is asked for, in mm/min.
const MAX_FEED_MM_PER_MIN: f64 = 1000.0;
/// How far a part of a circle goes below the pivot, in degrees, so that both reversals are in it.
const BELOW_DEG: f64 = 20.0;
/// An axis with more than this share of the tool direction leads along the tool.
const ALONG_TOOL: f64 = 0.01;
/// The most by which a circle through whole micrometres is larger, in mm.
const ROUNDING_MM: f64 = 0.001;
/// The radius within which a control takes the rounding of both ends for a circle, in mm.
const MIN_RADIUS_MM: f64 = 1.0;

pub(crate) fn plans(machine: &Machine, options: &Options) -> Result<Plans, Refused> {
    if machine.kind == Kind::Lathe {
        return Err(Refused(
            "a circle around the axis of a lathe has no far side: X and Z of a turret reach half of it at best".into(),
        ));
    }
    let (travels, mut notes) = travels(machine, options)?;
    let mut plans = Vec::new();
    for (n, first) in travels.iter().enumerate() {
        for second in &travels[n + 1..] {
            match plan(machine, [first, second], options) {
                Ok(plan) => plans.push(plan),
                Err(why) => notes.push(why.0),
            }
        }
    }
    if let [one] = &travels[..] {
        let name = one.axis.name();
        notes.insert(
            0,
            format!("a circle needs two axes, and only {name} may move or is asked for"),
        );
    }
    if plans.is_empty() {
        return Err(Refused(notes.join("; ")));
    }
    // All planes are measured first: together they say which axis is in error.
    let runs: Vec<String> = plans.iter().map(|plan| format!("--run {}.csv", plan.name)).collect();
    if let Some(last) = plans.last_mut() {
        last.then = vec![format!("trueup fit circle {}", runs.join(" "))];
    }
    notes.extend(without_clearance(options));
    Ok((plans, notes))
}

/// The way around the centre, for a radius of 1.
struct Way {
    /// Where the first direction starts, in degrees from the first axis of the plane.
    start_deg: f64,
    turn_deg: f64,
    read_deg: [u32; 2],
    /// From where to where both axes go, from the centre.
    extent: [[f64; 2]; 2],
}

impl Way {
    /// Returns the way in the plane of both axes: whole turns, or the retracted half where one is along the tool.
    fn of(machine: &Machine, pair: [&Travel; 2]) -> Self {
        let along = pair.map(|travel| machine.tool_direction[travel.axis.index()]);
        let most = usize::from(along[1].abs() > along[0].abs());
        if along[most].abs() <= ALONG_TOOL {
            return Self {
                start_deg: 0.0,
                turn_deg: 720.0,
                read_deg: [135, 585],
                extent: [[-1.0, 1.0]; 2],
            };
        }
        let retracted = if along[most] < 0.0 { 1.0 } else { -1.0 };
        let below = BELOW_DEG.to_radians().sin();
        let mut extent = [[-1.0, 1.0]; 2];
        extent[most] = if retracted > 0.0 { [-below, 1.0] } else { [-1.0, below] };
        let top_deg = 90.0 * most as f64 + if retracted > 0.0 { 0.0 } else { 180.0 };
        let half = 90.0 + BELOW_DEG;
        let turn_deg = 2.0 * half;
        Self { start_deg: top_deg - half, turn_deg, read_deg: [2, turn_deg as u32 - 2], extent }
    }
}

/// Returns both axes in the order of the plane: X to Y, Y to Z, Z to X.
fn in_order([first, second]: [&Travel; 2]) -> [&Travel; 2] {
    match (first.axis, second.axis) {
        (LinearAxis::X, LinearAxis::Z) => [second, first],
        _ => [first, second],
    }
}

/// Returns the radius, and the centre of both axes; each place is in its range.
fn circle(pair: [&Travel; 2], way: &Way, options: &Options) -> Result<(f64, [f64; 2]), Refused> {
    let room = |n: usize, radius: f64| -> [f64; 2] {
        let [low, high] = way.extent[n];
        [pair[n].low_mm - low * radius + ROUNDING_MM, pair[n].high_mm - high * radius - ROUNDING_MM]
    };
    let centre = |n: usize, radius: f64| {
        let [low, high] = room(n, radius);
        options.at_mm[pair[n].axis.index()].unwrap_or(micrometres((low + high) / 2.0))
    };
    let fits = |n: usize, radius: f64| {
        let [low, high] = room(n, radius);
        (low..=high).contains(&centre(n, radius))
    };
    let found = match options.radius_mm {
        Some(radius) => Some(micrometres(radius)),
        None => BARS_MM.into_iter().find(|radius| (0..2).all(|n| fits(n, *radius))),
    };
    let radius = found.unwrap_or(BARS_MM[BARS_MM.len() - 1]);
    if let Some(n) = (0..2).find(|n| !fits(*n, radius)) {
        let name = pair[n].axis.name();
        let [low, high] = way.extent[n].map(|it| micrometres(centre(n, radius) + it * radius));
        return Err(Refused(format!(
            "a circle of {radius} mm would send {name} from {low} to {high} mm, and it may move from {} to {} mm: give a smaller \
             --radius, another centre by --at, or a longer --range {name}=LOW:HIGH",
            pair[n].low_mm, pair[n].high_mm
        )));
    }
    if radius < MIN_RADIUS_MM {
        return Err(Refused(format!("--radius {radius}: at least {MIN_RADIUS_MM} mm")));
    }
    Ok((radius, [0, 1].map(|n| centre(n, radius))))
}

fn plan(machine: &Machine, pair: [&Travel; 2], options: &Options) -> Result<Plan, Refused> {
    let pair = in_order(pair);
    let axes = pair.map(|travel| travel.axis.index());
    let way = Way::of(machine, pair);
    let (radius, centre_mm) = circle(pair, &way, options)?;
    let still = LinearAxis::ALL[3 - axes[0] - axes[1]];
    let (sin, cos) = way.start_deg.to_radians().sin_cos();
    let start_mm = [cos, sin].map(|it| it * radius);
    let start_mm = [0, 1].map(|n| micrometres(centre_mm[n] + start_mm[n]));
    let own_feed = (RADII_A_MIN * radius).min(MAX_FEED_MM_PER_MIN);
    let feed = options.feeds_mm_per_min.first().copied().unwrap_or(own_feed);
    let read_deg = way.read_deg;
    let arc = |turn_deg| Arc { axes, centre_mm, turn_deg, read_deg, feed_mm_per_min: feed };
    let extent_mm = arc(way.turn_deg).extent_mm(start_mm);
    // What leads along the tool or is vertical goes to its retracted end first.
    let retracted = |n: usize| {
        let [low, high] = extent_mm[n];
        pair[n].retract.map(|way| if way > 0.0 { high } else { low })
    };
    let retract = || (0..2).filter_map(|n| Some(pair[n].approach(retracted(n)?)));
    // Last of all it goes to its place.
    let mut order = [0, 1];
    order.sort_by_key(|n| pair[*n].retract.is_some());
    let to = |mm: [f64; 2]| order.map(|n| pair[n].approach(mm[n]));
    let mut steps: Vec<Step> = retract().collect();
    steps.extend(to(centre_mm));
    steps.push(Step::Stop(at_centre(pair, still, machine)));
    steps.extend(retract());
    steps.extend(to(start_mm));
    steps.push(Step::Stop(at_start(pair, radius, &way, feed)));
    // Should somebody have jogged, the circle begins at the right place all the same.
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
    let mut precautions: Vec<String> = head_at_zero(machine).into_iter().collect();
    if let Some(mm) = options.at_mm[still.index()] {
        precautions.push(format!("{} stands at {mm} mm.", capital(still)));
    }
    precautions.push("No ball bar yet: the program stops for it.".into());
    Ok(Plan {
        notes: notes(&name, radius, centre_mm, still, options),
        name: format!("circle-{name}"),
        precautions,
        approach_mm_per_min: options.approach_mm_per_min,
        steps,
        columns,
        then: Vec::new(),
        is_lathe: false,
        records: Vec::new(),
    })
}

fn notes(
    plane: &str,
    radius: f64,
    centre_mm: [f64; 2],
    still: LinearAxis,
    options: &Options,
) -> Vec<String> {
    let [u, v] = centre_mm;
    let mut notes = vec![
        WITHOUT_CORRECTION.to_string(),
        "A reading is the radius, actual minus nominal, plus outward; a row for each degree."
            .into(),
        format!(
            "The table of an instrument that has angles becomes a run file by: trueup import TABLE.csv --radius {radius} \
             --centre {u},{v} --plane {plane} --direction ccw -o ccw.csv; for the other direction cw."
        ),
    ];
    let name = still.name();
    if options.at_mm[still.index()].is_none() {
        notes.push(format!(
            "trueup fit volume needs to know where {0} stands, which trueup fit circle does not: --at {name}=MM.",
            capital(still)
        ));
    }
    notes
}

/// Returns the instructions for the operator at the centre.
fn at_centre(pair: [&Travel; 2], still: LinearAxis, machine: &Machine) -> Vec<String> {
    let [u, v] = pair.map(|travel| capital(travel.axis));
    let mut text = vec![
        format!(
            "Here is the centre. Jog {0} alone: set the pivot of the bar, or the zero of the instrument, under the tool.",
            capital(still)
        ),
        format!(
            "Fix it, and jog {0} clear of it. {u} and {v} go to the start next.",
            capital(still)
        ),
    ];
    if pair.iter().any(|travel| machine.tool_direction[travel.axis.index()].abs() > ALONG_TOOL) {
        text[1] =
            format!("Fix it, and take the tool ball out of it. {u} and {v} go to the start next.");
    }
    text
}

/// Returns the instructions for the operator at the start.
fn at_start(pair: [&Travel; 2], radius: f64, way: &Way, feed: f64) -> Vec<String> {
    let [u, v] = pair.map(|travel| capital(travel.axis));
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
