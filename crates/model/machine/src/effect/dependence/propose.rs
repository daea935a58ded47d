//! Which dependences the recorded columns allow, and where a search begins.

use super::{
    Dependence, Form,
    times::{LOAD, SPEED},
    values::{KNOTS, SWITCH, bends, knots, levels, tools, zero_of},
};
use crate::{
    effect::{
        cause_spec::Times,
        data_view::{DataView, StartValues, TIME_CONSTANTS, spread},
    },
    file::spindle::ElongationSource,
    tool::TOOL_COLUMN,
};

/// Proposes what the recorded columns allow.
pub(super) fn propose(survey: &dyn DataView, with: &mut dyn FnMut(Dependence, StartValues)) {
    let mut times = vec![Times::One];
    if survey.varies(SPEED) {
        times.push(Times::Speed2);
    }
    let is_sensed = survey.source() == Some(ElongationSource::Sensor);
    if is_sensed && survey.quantity().axis().is_none() && spread(survey.law()) > 0.0 {
        times.push(Times::Growth);
    }
    if survey.moves() {
        times.push(Times::Position);
    }
    let all: Vec<(&str, &[f64])> =
        survey.others().into_iter().filter_map(|name| varying(survey, name)).collect();
    let known = survey.temperatures().into_iter().chain([LOAD]);
    let known: Vec<(&str, &[f64])> = known.filter_map(|name| varying(survey, name)).collect();
    of_temperatures(survey, with);
    of_speed(survey, with);
    for (number, &(column, values)) in all.iter().enumerate() {
        let levels = if column == TOOL_COLUMN { tools(values) } else { levels(values) };
        // A product is the same the other way round; a category is never the second factor.
        let later = all.iter().enumerate().filter(|(n, (name, values))| {
            let is_amount = *name != TOOL_COLUMN && self::levels(values).is_none();
            (levels.is_some() && *n != number || *n > number) && is_amount
        });
        let second = known.iter().chain(later.map(|(_, it)| it)).map(|(name, values)| {
            let reference = zero_of(values);
            Times::Column { column: (*name).into(), reference, range: [reference; 2] }
        });
        for mut times in times.iter().cloned().chain(second) {
            let is_alone = times == Times::One;
            let is_second = times.column().is_some();
            let late = || survey.time_constants(TIME_CONSTANTS);
            let of = |lag_s, form, times: &Times| Dependence {
                lag_s,
                form,
                times: times.clone(),
                ..Dependence::of(column)
            };
            if levels.is_some() {
                // A tool that never turned says nothing of what it does at speed.
                let acting = acting(survey, values, &times);
                let levels =
                    if column == TOOL_COLUMN { tools(&acting) } else { self::levels(&acting) };
                let Some(levels) = levels else { continue };
                let added = vec![0.0; levels.len()];
                let is_switch = levels == SWITCH;
                let form = Form::Level { levels, added, otherwise: 0.0 };
                if let Some(starts) = times.free_reference(survey) {
                    with(of(0.0, form, &times), starts);
                    continue;
                }
                if is_switch && is_alone {
                    with(of(1.0, form.clone(), &times), late());
                }
                with(of(0.0, form, &times), StartValues::none());
                continue;
            }
            // The number of a tool is no amount.
            if column == TOOL_COLUMN {
                continue;
            }
            let reference = zero_of(values);
            with(of(0.0, Form::Line { slope: 0.0, reference }, &times), StartValues::none());
            if is_alone {
                with(of(1.0, Form::Line { slope: 0.0, reference }, &times), late());
                for curve in curves(values) {
                    with(of(0.0, curve, &times), StartValues::none());
                }
            }
            if let Some((hinge, bends)) = hinge(values).filter(|_| !is_second) {
                with(of(0.0, hinge, &times), bends);
            }
        }
    }
}

/// Proposes a bend and curves over the speed.
fn of_speed(survey: &dyn DataView, with: &mut dyn FnMut(Dependence, StartValues)) {
    let values = survey.column(SPEED).unwrap_or(&[]);
    if let Some((form, bends)) = hinge(values).filter(|_| survey.grows()) {
        with(Dependence { form, ..Dependence::of(SPEED) }, bends);
    }
    for form in curves(values) {
        with(Dependence { form, ..Dependence::of(SPEED) }, StartValues::none());
    }
}

/// Proposes what goes with temperatures and is not proportional to one of them.
fn of_temperatures(survey: &dyn DataView, with: &mut dyn FnMut(Dependence, StartValues)) {
    let all: Vec<(&str, &[f64])> =
        survey.temperatures().into_iter().filter_map(|name| varying(survey, name)).collect();
    for (number, &(column, values)) in all.iter().enumerate() {
        if let Some((form, bends)) = hinge(values) {
            with(Dependence { form, ..Dependence::of(column) }, bends);
        }
        for &(minus, of_minus) in &all[number + 1..] {
            let reference =
                values.iter().zip(of_minus).map(|(a, b)| a - b).find(|it| it.is_finite());
            let form = Form::Line { slope: 0.0, reference: reference.unwrap_or(0.0) };
            let minus = Some(minus.to_string());
            let at_once = Dependence { minus, form, ..Dependence::of(column) };
            with(
                Dependence { lag_s: 1.0, ..at_once.clone() },
                survey.time_constants(TIME_CONSTANTS),
            );
            with(at_once, StartValues::none());
        }
    }
}

/// Returns a line from a value on, with values to begin from.
fn hinge(values: &[f64]) -> Option<(Form, StartValues)> {
    let bends = bends(values);
    let [low, .., high] = bends[..] else { return None };
    Some((Form::Hinge { slope: 0.0, from: low, range: [low, high] }, StartValues::at(bends)))
}

/// Returns curves of few and of more places.
fn curves(values: &[f64]) -> impl Iterator<Item = Form> {
    let all = KNOTS.map(|count| knots(values, count)).into_iter();
    all.flatten().map(|at| Form::Curve { added: vec![0.0; at.len()], at })
}

/// Returns the values of a column in the rows in which what it is multiplied by is not 0.
fn acting(survey: &dyn DataView, values: &[f64], times: &Times) -> Vec<f64> {
    let factor = match times {
        Times::Speed2 => survey.column(SPEED),
        Times::Growth => Some(survey.law()),
        _ => None,
    };
    let acts = |row: usize| factor.is_none_or(|factor| factor[row] != 0.0);
    values.iter().enumerate().filter(|(row, _)| acts(*row)).map(|(_, value)| *value).collect()
}

/// Returns a column that has different values.
fn varying<'s>(survey: &'s dyn DataView, name: &'s str) -> Option<(&'s str, &'s [f64])> {
    survey.column(name).filter(|values| spread(values) > 0.0).map(|values| (name, values))
}
