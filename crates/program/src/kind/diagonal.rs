//! Two axes at once, and the error of the third across them (seed 003): what the whole model leaves,
//! which no measurement of one axis shows.

use trueup_machine::{Machine, file::LinearAxis};

use super::{Plans, capital, measured};
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
/// So many steps on a short one, at least.
const STEPS: f64 = 12.0;

pub(crate) fn plans(machine: &Machine, options: &Options) -> Result<Plans, Refused> {
    let (travels, mut notes) = travels(machine, options)?;
    let mut plans = Vec::new();
    for (n, first) in travels.iter().enumerate() {
        for second in &travels[n + 1..] {
            plans.push(plan(first, second, options)?);
        }
    }
    if plans.is_empty() {
        let one = travels.first().map_or("x", |travel| travel.axis.name());
        return Err(Refused(format!(
            "a diagonal needs two axes, and only the travel of {one} is known or asked for"
        )));
    }
    if travels.len() == 2 {
        notes.push(
            "one plane only: the travel of the third axis is not known or not asked for".into(),
        );
    }
    Ok((plans, notes))
}

fn plan(first: &Travel, second: &Travel, options: &Options) -> Result<Plan, Refused> {
    let feed = options.feed();
    let at = |share: f64| {
        let mut to = [None; 3];
        for travel in [first, second] {
            let [low, high] = travel.inside_mm();
            to[travel.axis.index()] = Some(micrometres(low + share * (high - low)));
        }
        to
    };
    let beyond = |is_high: bool| {
        let mut to = [None; 3];
        for travel in [first, second] {
            let mm = if is_high { travel.high_mm } else { travel.low_mm };
            to[travel.axis.index()] = Some(micrometres(mm));
        }
        to
    };
    let length = [first, second].map(|travel| {
        let [low, high] = travel.inside_mm();
        high - low
    });
    let length = length[0].hypot(length[1]);
    let step = options.step_mm.unwrap_or(STEP_MM.min(length / STEPS));
    let shares: Vec<f64> = even(0.0, length, step)
        .ok_or_else(|| Refused(format!("--step-mm {step} does not fit into {length:.0} mm")))?
        .into_iter()
        .map(|mm| mm / length)
        .collect();
    let go = |to_mm| Step::Move { to_mm, feed_mm_per_min: feed };
    let read = |share: &f64| [go(at(*share)), Step::Read(options.dwell_s)];
    let mut run: Vec<Step> = shares.iter().flat_map(read).collect();
    run.push(go(beyond(true)));
    run.extend(shares.iter().rev().flat_map(read));
    run.push(go(beyond(false)));
    let times = options.repeats.unwrap_or(REPEATS);
    let steps = vec![Step::Rapid(beyond(false)), Step::Repeat { times, steps: run }];
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
        steps,
        columns,
        then: format!("trueup accept --off {name}-off.csv --on {name}-on.csv"),
        records: vec!["off", "on"],
        name,
    })
}
