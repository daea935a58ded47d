//! A dependence as it stands in a machine file.

use super::{Dependence, DependenceForm, column_values::SWITCH_LEVELS};
use crate::{
    effect::cause_spec::{Multiplier, required_number},
    keys::{
        reader::{Section, is_temperature_column},
        table::read_or_default,
        term::{
            AT, COLUMN, CURVE_UM, FACTOR_PER_UNIT, FORM, FROM, LAG_S, LEVEL_DEFAULT, LEVEL_FACTOR,
            LEVEL_UM, LEVEL_UM_PER_KRPM2, LEVEL_UM_PER_M, LEVEL_UM_PER_UNIT, LEVELS, MINUS,
            REFERENCE, TIMES, TIMES_REFERENCE, UM_PER_UNIT, UM_PER_UNIT_PER_KRPM2,
            UM_PER_UNIT_PER_M, UM_PER_UNIT_PER_UNIT,
        },
    },
    location::InputFileError,
};

/// Keys of a dependence.
pub(super) const DEPENDENCE_KEYS: &[&str] = &[
    COLUMN.name,
    MINUS.name,
    FORM.name,
    TIMES.name,
    LEVELS.name,
    LEVEL_UM.name,
    LEVEL_UM_PER_KRPM2.name,
    LEVEL_FACTOR.name,
    LEVEL_UM_PER_M.name,
    LEVEL_UM_PER_UNIT.name,
    UM_PER_UNIT.name,
    UM_PER_UNIT_PER_KRPM2.name,
    FACTOR_PER_UNIT.name,
    UM_PER_UNIT_PER_M.name,
    UM_PER_UNIT_PER_UNIT.name,
    TIMES_REFERENCE.name,
    LEVEL_DEFAULT.name,
    LAG_S.name,
    REFERENCE.name,
    FROM.name,
    AT.name,
    CURVE_UM.name,
];

/// Reads a dependence.
pub(super) fn read(section: &Section<'_>) -> Result<Dependence, InputFileError> {
    let column = read_or_default::<String>(section, &COLUMN.required())?;
    let times = match section.text(TIMES.name)? {
        None => Multiplier::One,
        Some(name) => match Multiplier::ALL.into_iter().find(|(known, _)| *known == name) {
            Some((_, times)) => times,
            None => {
                let reference = section.number(TIMES_REFERENCE.name)?.unwrap_or(0.0);
                Multiplier::Column { column: name.into(), reference, range: [reference; 2] }
            }
        },
    };
    let minus = section.text(MINUS.name)?.map(String::from);
    if minus
        .as_deref()
        .is_some_and(|minus| ![&column[..], minus].iter().all(|name| is_temperature_column(name)))
    {
        return Err(section.key_error(
            MINUS.name,
            "takes a temperature from another one: both are temp_<name>_c",
        ));
    }
    let lag_s = section.non_negative_number(LAG_S.name)?.unwrap_or(0.0);
    let [slope_key, level_key] = times.keys();
    const FORM_CODES: [(&str, u8); 4] = [("level", 0), ("line", 1), ("hinge", 2), ("curve", 3)];
    let form = match section.required(FORM.name, section.choice(FORM.name, &FORM_CODES)?)? {
        // In a range of a column, which the reader of all causes sees to.
        0 if section.numbers(LEVELS.name)?.is_none() => {
            match read_or_default::<Vec<f64>>(section, &level_key.required())?[..] {
                [added] => DependenceForm::Constant { added },
                _ => return Err(section.key_error(LEVELS.name, "is missing")),
            }
        }
        0 => {
            let levels = read_or_default::<Vec<f64>>(section, &LEVELS.required())?;
            let added = read_or_default::<Vec<f64>>(section, &level_key.required())?;
            let is_repeated = |n: usize| levels[..n].contains(&levels[n]);
            if levels.len() < 2 || (0..levels.len()).any(is_repeated) {
                return Err(section.key_error(LEVELS.name, "takes at least two different values"));
            }
            if added.len() != levels.len() {
                return Err(section.key_error(level_key.name, "takes a value for each of levels"));
            }
            if times == Multiplier::One && added[0] != 0.0 {
                let rule = "begins with 0: the first of levels adds nothing";
                return Err(section.key_error(level_key.name, rule));
            }
            if lag_s != 0.0 && !levels.iter().all(|level| SWITCH_LEVELS.contains(level)) {
                let rule = "belongs to levels of 0 and 1: a condition that acts behind a lag";
                return Err(section.key_error(LAG_S.name, rule));
            }
            let otherwise = section.number(LEVEL_DEFAULT.name)?.unwrap_or(0.0);
            DependenceForm::Level { levels, added, otherwise }
        }
        1 => DependenceForm::Line {
            slope: required_number(section, slope_key)?,
            reference: section.number(REFERENCE.name)?.unwrap_or(0.0),
        },
        3 => read_curve(section, &times)?,
        _ => {
            let from = required_number(section, FROM)?;
            DependenceForm::Hinge {
                slope: required_number(section, slope_key)?,
                from,
                range: [from; 2],
            }
        }
    };
    if lag_s != 0.0 && !matches!(form, DependenceForm::Level { .. } | DependenceForm::Line { .. }) {
        return Err(section.key_error(LAG_S.name, "belongs to a level or a line"));
    }
    Ok(Dependence { column, minus, lag_s, form, times })
}

/// Reads a curve.
fn read_curve(section: &Section<'_>, times: &Multiplier) -> Result<DependenceForm, InputFileError> {
    if *times != Multiplier::One {
        return Err(section.key_error(TIMES.name, "does not belong to a curve"));
    }
    let at = read_or_default::<Vec<f64>>(section, &AT.required())?;
    let added = read_or_default::<Vec<f64>>(section, &CURVE_UM.required())?;
    if at.len() < 2 || !at.windows(2).all(|pair| pair[0] < pair[1]) {
        return Err(section.key_error(AT.name, "takes at least two values that rise"));
    }
    if added.len() != at.len() || added[0] != 0.0 {
        return Err(
            section.key_error(CURVE_UM.name, "takes a value for each of at, and begins with 0")
        );
    }
    Ok(DependenceForm::Curve { at, added })
}
