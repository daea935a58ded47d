//! A dependence as it stands in a machine file.

use super::{Dependence, Form, values::SWITCH};
use crate::{
    effect::cause_spec::{Times, number},
    file::read::{Section, is_temperature_column},
    location::BadInput,
};

/// Reads a dependence.
pub(super) fn read(section: &Section<'_>) -> Result<Dependence, BadInput> {
    let column = section.required("column", section.text("column")?)?.to_string();
    let times = match section.text("times")? {
        None => Times::One,
        Some(name) => match Times::ALL.into_iter().find(|(known, _)| *known == name) {
            Some((_, times)) => times,
            None => {
                let reference = section.number("times_reference")?.unwrap_or(0.0);
                Times::Column { column: name.into(), reference, range: [reference; 2] }
            }
        },
    };
    let minus = section.text("minus")?.map(String::from);
    if minus
        .as_deref()
        .is_some_and(|minus| ![&column[..], minus].iter().all(|it| is_temperature_column(it)))
    {
        return Err(
            section.bad("minus", "takes a temperature from another one: both are temp_<name>_c")
        );
    }
    let lag_s = section.not_negative("lag_s")?.unwrap_or(0.0);
    let [slope_key, level_key] = times.keys();
    const FORMS: [(&str, u8); 4] = [("level", 0), ("line", 1), ("hinge", 2), ("curve", 3)];
    let form = match section.required("form", section.choice("form", &FORMS)?)? {
        // In a range of a column, which the reader of all causes sees to.
        0 if section.numbers("levels")?.is_none() => {
            match section.required(level_key, section.numbers(level_key)?)?[..] {
                [added] => Form::Constant { added },
                _ => return Err(section.bad("levels", "is missing")),
            }
        }
        0 => {
            let levels = section.required("levels", section.numbers("levels")?)?;
            let added = section.required(level_key, section.numbers(level_key)?)?;
            let is_repeated = |n: usize| levels[..n].contains(&levels[n]);
            if levels.len() < 2 || (0..levels.len()).any(is_repeated) {
                return Err(section.bad("levels", "takes at least two different values"));
            }
            if added.len() != levels.len() {
                return Err(section.bad(level_key, "takes a value for each of levels"));
            }
            if times == Times::One && added[0] != 0.0 {
                let rule = "begins with 0: the first of levels adds nothing";
                return Err(section.bad(level_key, rule));
            }
            if lag_s != 0.0 && !levels.iter().all(|level| SWITCH.contains(level)) {
                let rule = "belongs to levels of 0 and 1: a condition that acts behind a lag";
                return Err(section.bad("lag_s", rule));
            }
            let otherwise = section.number("level_default")?.unwrap_or(0.0);
            Form::Level { levels, added, otherwise }
        }
        1 => Form::Line {
            slope: number(section, slope_key)?,
            reference: section.number("reference")?.unwrap_or(0.0),
        },
        3 => curve(section, &times)?,
        _ => {
            let from = number(section, "from")?;
            Form::Hinge { slope: number(section, slope_key)?, from, range: [from; 2] }
        }
    };
    if lag_s != 0.0 && !matches!(form, Form::Level { .. } | Form::Line { .. }) {
        return Err(section.bad("lag_s", "belongs to a level or a line"));
    }
    Ok(Dependence { column, minus, lag_s, form, times })
}

/// Reads a curve.
fn curve(section: &Section<'_>, times: &Times) -> Result<Form, BadInput> {
    if *times != Times::One {
        return Err(section.bad("times", "does not belong to a curve"));
    }
    let at = section.required("at", section.numbers("at")?)?;
    let added = section.required("curve_um", section.numbers("curve_um")?)?;
    if at.len() < 2 || !at.windows(2).all(|pair| pair[0] < pair[1]) {
        return Err(section.bad("at", "takes at least two values that rise"));
    }
    if added.len() != at.len() || added[0] != 0.0 {
        return Err(section.bad("curve_um", "takes a value for each of at, and begins with 0"));
    }
    Ok(Form::Curve { at, added })
}
