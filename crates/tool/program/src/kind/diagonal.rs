//! Two axes at once, and the error of the third across them (paper 3): what the whole model leaves,
//! which no measurement of one axis shows.

use trueup_machine::{
    Machine,
    file::{Kind, LinearAxis},
};

use super::{Plans, capital, head_at_zero, measured, without_clearance};
use crate::{
    options::Options,
    plan::{Column, Plan, Step},
    refused::Refused,
    travel::{Travel, even, micrometres, travels},
};

/// There and back so often.
const REPEATS: u32 = 3;
/// From target to target along the diagonal, in mm: the length of the paper's slide.
const STEP_MM: f64 = 240.0;
/// This many steps on a short one, at least.
const STEPS: f64 = 12.0;

pub(crate) fn plans(machine: &Machine, options: &Options) -> Result<Plans, Refused> {
    if machine.kind == Kind::Lathe {
        return Err(Refused(
            "a diagonal is measured across a third axis, which a lathe has not".into(),
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
            format!("a diagonal needs two axes, and only {name} may move or is asked for"),
        );
    }
    if plans.is_empty() {
        return Err(Refused(notes.join("; ")));
    }
    if travels.len() == 2 {
        notes.push("one plane only: the third axis may not move or is not asked for".into());
    }
    notes.extend(without_clearance(options));
    Ok((plans, notes))
}

/// Returns the ends of both axes, where the diagonal begins and where it ends. A tool axis begins where it is
/// retracted; an axis that may begin at either end begins at the same one as the other, so that both rise.
fn corners(pair: [&Travel; 2], ends_mm: impl Fn(&Travel) -> [f64; 2]) -> [[f64; 2]; 2] {
    let starts_high = |n: usize| match pair[n].retract {
        Some(_) => pair[n].starts_high(),
        None => pair[1 - n].starts_high(),
    };
    let [first, second] = [0, 1].map(|n| {
        let [low, high] = ends_mm(pair[n]);
        if starts_high(n) { [high, low] } else { [low, high] }
    });
    [[first[0], second[0]], [first[1], second[1]]]
}

fn plan(machine: &Machine, pair: [&Travel; 2], options: &Options) -> Result<Plan, Refused> {
    let [first, second] = pair;
    let feed = options.feed();
    let to = |mm: [f64; 2]| {
        let mut to = [None; 3];
        for (travel, mm) in pair.into_iter().zip(mm) {
            to[travel.axis.index()] = Some(micrometres(mm));
        }
        to
    };
    let [near, far] = corners(pair, |travel| [travel.low_mm, travel.high_mm]);
    let [from, until] = corners(pair, Travel::inside_mm);
    let at = |share: f64| [0, 1].map(|n| from[n] + share * (until[n] - from[n]));
    let length = (until[0] - from[0]).hypot(until[1] - from[1]);
    let step = options.step_mm.unwrap_or(STEP_MM.min(length / STEPS));
    let shares: Vec<f64> = even(0.0, length, step)
        .ok_or_else(|| Refused(format!("--step-mm {step} does not fit into {length:.0} mm")))?
        .into_iter()
        // A length that is rounded to whole micrometres is not 1.
        .map(|mm| (mm / length).min(1.0))
        .collect();
    let go = |mm| Step::Move { to_mm: to(mm), feed_mm_per_min: feed };
    let read = |share: &f64| [go(at(*share)), Step::Read(options.dwell_s)];
    let mut run: Vec<Step> = shares.iter().flat_map(read).collect();
    run.push(go(far));
    run.extend(shares.iter().rev().flat_map(read));
    run.push(go(near));
    let times = options.repeats.unwrap_or(REPEATS);
    // The tool is retracted before the other axis moves.
    let mut order = [0, 1];
    order.sort_by_key(|n| pair[*n].retract.is_none());
    let mut steps = order.map(|n| pair[n].approach(near[n])).to_vec();
    steps.push(Step::Repeat { times, steps: run });
    let across = LinearAxis::ALL
        .into_iter()
        .find(|axis| *axis != first.axis && *axis != second.axis)
        .expect("two of three axes are taken");
    let mut columns = vec![Column::Run];
    columns.extend([first, second].map(|travel| Column::Position(travel.axis.index())));
    columns.extend([first, second].map(|travel| Column::Direction(travel.axis.index())));
    columns.push(Column::Empty(measured(across)));
    let name = format!("diagonal-{}{}", first.axis.name(), second.axis.name());
    Ok(Plan {
        notes: vec![format!(
            "{} and {} go together across the plane; {} is measured. Run it without compensation and with.",
            capital(first.axis),
            capital(second.axis),
            capital(across)
        )],
        precautions: head_at_zero(machine).into_iter().collect(),
        approach_mm_per_min: options.approach_mm_per_min,
        steps,
        columns,
        then: vec![format!("trueup accept --off {name}-off.csv --on {name}-on.csv")],
        is_lathe: false,
        records: vec!["off", "on"],
        name,
    })
}
