//! Which dependences the recorded columns allow, and where a search begins.

use super::{
    Dependence, DependenceForm,
    column_values::{
        CURVE_KNOT_COUNTS, SWITCH_LEVELS, choose_knots, choose_reference_value,
        find_frequent_tools, find_levels, hinge_start_values,
    },
    multiplier::{LOAD_COLUMN, SPEED_COLUMN},
};
use crate::{
    effect::{
        cause_spec::Multiplier,
        data_view::{DataView, StartValues, TIME_CONSTANT_GRID_POINTS, peak_to_peak},
    },
    sections::ElongationSource,
    tool_column::TOOL_COLUMN,
};

/// Proposes what the recorded columns allow.
pub(super) fn propose(survey: &dyn DataView, with: &mut dyn FnMut(Dependence, StartValues)) {
    let mut times = vec![Multiplier::One];
    if survey.is_varying(SPEED_COLUMN) {
        times.push(Multiplier::Speed2);
    }
    let is_sensed = survey.elongation_source() == Some(ElongationSource::Sensor);
    if is_sensed
        && survey.quantity().axis().is_none()
        && peak_to_peak(survey.source_elongation_um()) > 0.0
    {
        times.push(Multiplier::Growth);
    }
    if survey.has_own_axis_moved() {
        times.push(Multiplier::Position);
    }
    let all: Vec<(&str, &[f64])> = survey
        .unknown_columns()
        .into_iter()
        .filter_map(|name| varying_column(survey, name))
        .collect();
    let known = survey.temperature_columns().into_iter().chain([LOAD_COLUMN]);
    let known: Vec<(&str, &[f64])> =
        known.filter_map(|name| varying_column(survey, name)).collect();
    propose_temperature_dependences(survey, with);
    propose_speed_dependences(survey, with);
    for (number, &(column, values)) in all.iter().enumerate() {
        let levels =
            if column == TOOL_COLUMN { find_frequent_tools(values) } else { find_levels(values) };
        // A product is the same the other way round; a category is never the second factor.
        let later = all.iter().enumerate().filter(|(n, (name, values))| {
            let is_amount = *name != TOOL_COLUMN && self::find_levels(values).is_none();
            (levels.is_some() && *n != number || *n > number) && is_amount
        });
        let second = known.iter().chain(later.map(|(_, later)| later)).map(|(name, values)| {
            let reference = choose_reference_value(values);
            Multiplier::Column { column: (*name).into(), reference, range: [reference; 2] }
        });
        for mut times in times.iter().cloned().chain(second) {
            let is_alone = times == Multiplier::One;
            let is_second = times.column().is_some();
            let late = || survey.time_constant_start_values(TIME_CONSTANT_GRID_POINTS);
            let of = |lag_s, form, times: &Multiplier| Dependence {
                lag_s,
                form,
                times: times.clone(),
                ..Dependence::from_column(column)
            };
            if levels.is_some() {
                // A tool that never turned says nothing of what it does at speed.
                let acting = active_values(survey, values, &times);
                let levels = if column == TOOL_COLUMN {
                    find_frequent_tools(&acting)
                } else {
                    self::find_levels(&acting)
                };
                let Some(levels) = levels else { continue };
                let added = vec![0.0; levels.len()];
                let is_switch = levels == SWITCH_LEVELS;
                let form = DependenceForm::Level { levels, added, otherwise: 0.0 };
                if let Some(starts) = times.enable_reference_fit(survey) {
                    with(of(0.0, form, &times), starts);
                    continue;
                }
                if is_switch && is_alone {
                    with(of(1.0, form.clone(), &times), late());
                }
                with(of(0.0, form, &times), StartValues::linear_only());
                continue;
            }
            // The number of a tool is no amount.
            if column == TOOL_COLUMN {
                continue;
            }
            let reference = choose_reference_value(values);
            with(
                of(0.0, DependenceForm::Line { slope: 0.0, reference }, &times),
                StartValues::linear_only(),
            );
            if is_alone {
                with(of(1.0, DependenceForm::Line { slope: 0.0, reference }, &times), late());
                for curve in curve_forms(values) {
                    with(of(0.0, curve, &times), StartValues::linear_only());
                }
            }
            if let Some((hinge, hinge_candidates)) = hinge_form(values).filter(|_| !is_second) {
                with(of(0.0, hinge, &times), hinge_candidates);
            }
        }
    }
}

/// Proposes a bend and curves over the speed.
fn propose_speed_dependences(survey: &dyn DataView, with: &mut dyn FnMut(Dependence, StartValues)) {
    let values = survey.column(SPEED_COLUMN).unwrap_or(&[]);
    if let Some((form, hinge_candidates)) =
        hinge_form(values).filter(|_| survey.includes_elongation())
    {
        with(Dependence { form, ..Dependence::from_column(SPEED_COLUMN) }, hinge_candidates);
    }
    for form in curve_forms(values) {
        with(
            Dependence { form, ..Dependence::from_column(SPEED_COLUMN) },
            StartValues::linear_only(),
        );
    }
}

/// Proposes what depends on temperatures and is not proportional to one of them.
fn propose_temperature_dependences(
    survey: &dyn DataView,
    with: &mut dyn FnMut(Dependence, StartValues),
) {
    let all: Vec<(&str, &[f64])> = survey
        .temperature_columns()
        .into_iter()
        .filter_map(|name| varying_column(survey, name))
        .collect();
    for (number, &(column, values)) in all.iter().enumerate() {
        if let Some((form, hinge_candidates)) = hinge_form(values) {
            with(Dependence { form, ..Dependence::from_column(column) }, hinge_candidates);
        }
        for &(minus, of_minus) in &all[number + 1..] {
            let reference = values
                .iter()
                .zip(of_minus)
                .map(|(a, b)| a - b)
                .find(|difference| difference.is_finite());
            let form = DependenceForm::Line { slope: 0.0, reference: reference.unwrap_or(0.0) };
            let minus = Some(minus.to_string());
            let at_once = Dependence { minus, form, ..Dependence::from_column(column) };
            with(
                Dependence { lag_s: 1.0, ..at_once.clone() },
                survey.time_constant_start_values(TIME_CONSTANT_GRID_POINTS),
            );
            with(at_once, StartValues::linear_only());
        }
    }
}

/// Returns a line from a value on, with values to begin from.
fn hinge_form(values: &[f64]) -> Option<(DependenceForm, StartValues)> {
    let hinge_candidates = hinge_start_values(values);
    let [low, .., high] = hinge_candidates[..] else { return None };
    Some((
        DependenceForm::Hinge { slope: 0.0, from: low, range: [low, high] },
        StartValues::from_values(hinge_candidates),
    ))
}

/// Returns curves of few and of more places.
fn curve_forms(values: &[f64]) -> impl Iterator<Item = DependenceForm> {
    let all = CURVE_KNOT_COUNTS.map(|count| choose_knots(values, count)).into_iter();
    all.flatten().map(|at| DependenceForm::Curve { added: vec![0.0; at.len()], at })
}

/// Returns the values of a column in the rows in which what it is multiplied by is not 0.
fn active_values(survey: &dyn DataView, values: &[f64], times: &Multiplier) -> Vec<f64> {
    let factor = match times {
        Multiplier::Speed2 => survey.column(SPEED_COLUMN),
        Multiplier::Growth => Some(survey.source_elongation_um()),
        _ => None,
    };
    let acts = |row: usize| factor.is_none_or(|factor| factor[row] != 0.0);
    values.iter().enumerate().filter(|(row, _)| acts(*row)).map(|(_, value)| *value).collect()
}

/// Returns a column that has different values.
fn varying_column<'s>(survey: &'s dyn DataView, name: &'s str) -> Option<(&'s str, &'s [f64])> {
    survey.column(name).filter(|values| peak_to_peak(values) > 0.0).map(|values| (name, values))
}
