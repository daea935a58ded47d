//! Terms by tool and by condition for the board, and back: all levels of a term share one binary point.
//!
//! ```text
//! level   m = a·unit·2^shift, rounded; shift the largest with which every m is below 2³⁰
//! ```

use trueup_core::{
    lag::SmoothingFactor,
    term::{CategoryFactor, ConditionLevels, ToolTable},
};

use super::{
    CompileResult, MAX_CHECKED_ELONGATION_UM, MAX_CHECKED_SPEED_RPM, OwnedEffect,
    compile_coefficient,
};
use crate::{
    compile::{
        inputs::{condition_column_name, condition_input_line},
        lag,
    },
    effect::{BoardTerm, DependenceForm, Effect, Multiplier, Quantity},
    inputs::BoardInputs,
    location::InputFileError,
    machine_file::{Machine, Term},
    sections::{ToolGrowth, ToolGrowthList},
    tool_column::TOOL_COLUMN,
    unit_conversion::{
        FINE_UNITS_PER_UM, NM_PER_UM, POSITION_UNITS_PER_MM, round_to_i32, shortest_decimal,
    },
};

/// Positions are held against the model up to this.
const MAX_CHECKED_DISTANCE_MM: f64 = 15_000.0;

/// The table of a tool, with its levels.
#[derive(Clone, Debug)]
pub(super) struct OwnedToolTable {
    levels: Vec<[u8; 8]>,
    other: i32,
    shift: u8,
    times: CategoryFactor,
}

impl OwnedToolTable {
    pub(super) fn view(&self) -> ToolTable<'_> {
        let Self { other, shift, times, .. } = *self;
        ToolTable { levels: &self.levels, other, shift, times }
    }
}

/// Returns the factor on the board, how many of the board's units are one of the user's, and up to what it is checked.
fn compile_multiplier(times: &Multiplier) -> Result<(CategoryFactor, f64, f64), String> {
    Ok(match times {
        Multiplier::One => (CategoryFactor::One, FINE_UNITS_PER_UM, 1.0),
        Multiplier::Speed2 => (
            CategoryFactor::Speed2,
            FINE_UNITS_PER_UM / 1e6,
            MAX_CHECKED_SPEED_RPM * MAX_CHECKED_SPEED_RPM,
        ),
        Multiplier::Growth => {
            (CategoryFactor::Growth, 1.0, MAX_CHECKED_ELONGATION_UM * FINE_UNITS_PER_UM)
        }
        Multiplier::Position => {
            let reach = MAX_CHECKED_DISTANCE_MM * POSITION_UNITS_PER_MM;
            (CategoryFactor::Position, FINE_UNITS_PER_UM / (1000.0 * POSITION_UNITS_PER_MM), reach)
        }
        Multiplier::Column { column, .. } => {
            return Err(format!("is multiplied by {column}, which no board does"));
        }
    })
}

/// Levels with one binary point, the binary places, and the largest rounding in nm.
fn compile_levels(values: &[f64], unit: f64, largest: f64) -> CompileResult<(Vec<i32>, u8)> {
    let exact: Vec<f64> = values.iter().map(|value| value * unit).collect();
    let most = exact.iter().fold(0.0_f64, |most, value| most.max(value.abs()));
    let (stored, _) = compile_coefficient(most, 0.0)?;
    let power = 2_f64.powi(stored.shift.into());
    let mantissas: Option<Vec<i32>> =
        exact.iter().map(|coefficient| round_to_i32((coefficient * power).round())).collect();
    let mantissas = mantissas.ok_or("has levels beyond the board's 2³⁰")?;
    let off = exact
        .iter()
        .zip(&mantissas)
        .map(|(coefficient, m)| (coefficient - f64::from(*m) / power).abs());
    let nm = off.fold(0.0, f64::max) * largest / FINE_UNITS_PER_UM * NM_PER_UM;
    Ok(((mantissas, stored.shift), nm))
}

pub(super) fn compile_tool_table(
    tools: &[(u16, f64)],
    other: f64,
    times: &Multiplier,
) -> CompileResult<OwnedEffect> {
    let (times, unit, largest) = compile_multiplier(times)?;
    let mut sorted = tools.to_vec();
    sorted.sort_by_key(|(number, _)| *number);
    let values: Vec<f64> = sorted.iter().map(|(_, a)| *a).chain([other]).collect();
    let ((mut stored, shift), nm) = compile_levels(&values, unit, largest)?;
    let other = stored.pop().unwrap_or_default();
    let record = |((number, _), level): (&(u16, f64), i32)| {
        let [a, b, c, d] = u32::from(*number).to_le_bytes();
        let [e, f, g, h] = level.to_le_bytes();
        [a, b, c, d, e, f, g, h]
    };
    let levels = sorted.iter().zip(stored).map(record).collect();
    Ok((OwnedEffect::Tools(OwnedToolTable { levels, other, shift, times }), nm))
}

/// Returns the condition of a form, with the default that `[inputs]` states for its bit.
pub(super) fn compile_condition(
    inputs: Option<&BoardInputs>,
    column: &str,
    [off, on]: [f64; 2],
    lag_s: f64,
    times: &Multiplier,
) -> CompileResult<ConditionLevels> {
    let input = inputs.and_then(|inputs| inputs.conditions.get(column)).ok_or_else(|| {
        format!(
            "needs {column}, which [inputs] does not describe: the board must know its bit; add `{}`",
            condition_input_line(inputs, column)
        )
    })?;
    let (times, unit, largest) = compile_multiplier(times)?;
    let ((stored, shift), nm) = compile_levels(&[off, on], unit, largest)?;
    let [off, on] = [stored[0], stored[1]];
    let smoothing = lag::smoothing_factor(lag_s)?;
    // On its way a level is rounded once more.
    let place = 2_f64.powi(-i32::from(shift)) * largest / FINE_UNITS_PER_UM * NM_PER_UM;
    let on_its_way = if smoothing == SmoothingFactor::NO_LAG { 0.0 } else { place };
    let made = ConditionLevels {
        bit: input.bit,
        default: input.default,
        off,
        on,
        shift,
        smoothing,
        times,
    };
    Ok((made, nm + on_its_way))
}

/// Refuses a tool that has a label and no number, which the CNC cannot send.
pub(in crate::compile) fn reject_unnumbered_tools(machine: &Machine) -> Result<(), InputFileError> {
    match machine.spindle.tools.as_ref().and_then(ToolGrowthList::first_unnumbered_label) {
        None => Ok(()),
        Some(label) => {
            let rule =
                "has no number: the CNC sends numbers, and the board could not identify the tool";
            let help = "add `number = N` to it, N as the control calls the tool";
            Err(machine.places.key_error(&format!("spindle.tools.{label}"), rule).with_help(help))
        }
    }
}

/// Returns what a user writes for levels that share a binary point.
fn decompile_levels(stored: &[i32], shift: u8, unit: f64) -> Vec<f64> {
    let power = 2_f64.powi(shift.into());
    let most = stored.iter().map(|m| m.unsigned_abs()).max().unwrap_or(0);
    let of = |m: &i32| {
        let is_same = |value: f64| {
            let shares_point = m.unsigned_abs() < most
                || compile_coefficient(value.abs() * unit, 0.0)
                    .is_ok_and(|(coefficient, _)| coefficient.shift == shift);
            round_to_i32((value * unit * power).round()) == Some(*m) && shares_point
        };
        shortest_decimal(f64::from(*m) / power / unit, is_same)
    };
    stored.iter().map(of).collect()
}

fn decompile_multiplier(factor: CategoryFactor) -> (Multiplier, f64) {
    let times = match factor {
        CategoryFactor::One => Multiplier::One,
        CategoryFactor::Speed2 => Multiplier::Speed2,
        CategoryFactor::Growth => Multiplier::Growth,
        CategoryFactor::Position => Multiplier::Position,
    };
    let unit = self::compile_multiplier(&times).map_or(1.0, |(_, unit, _)| unit);
    (times, unit)
}

pub(super) fn decompile_tool_table(table: &ToolTable<'_>) -> BoardTerm {
    let (times, unit) = decompile_multiplier(table.times);
    let stored: Vec<i32> = table.tool_levels().map(|(_, m)| m).chain([table.other]).collect();
    let mut values = decompile_levels(&stored, table.shift, unit);
    let other = values.pop().unwrap_or_default();
    let number = |number: u32| u16::try_from(number).expect("a blob with another one is refused");
    let tools = table.tool_levels().map(|(tool, _)| number(tool)).zip(values).collect();
    BoardTerm::Tool { tools, other, times }
}

pub(super) fn decompile_condition_levels(it: &ConditionLevels) -> BoardTerm {
    let (times, unit) = decompile_multiplier(it.times);
    let values = decompile_levels(&[it.off, it.on], it.shift, unit);
    BoardTerm::Condition {
        column: condition_column_name(it.bit),
        off: values[0],
        on: values[1],
        lag_s: lag::decompile_time_constant_s(it.smoothing),
        times,
    }
}

/// Returns the list of `[spindle.tools]` that a term is, if it is one.
pub(in crate::compile) fn tool_growths_from_term(term: &Term) -> Option<ToolGrowthList> {
    let Effect::Dependence(it) = &term.effect else { return None };
    let DependenceForm::Level { levels, added, otherwise } = &it.form else { return None };
    let is_list = it.column == TOOL_COLUMN
        && it.lag_s == 0.0
        && it.times == Multiplier::Speed2
        && term.constant_um == 0.0;
    if !is_list || term.quantity != Quantity::Elongation {
        return None;
    }
    let number = |level: f64| round_to_i32(level).and_then(|level| u16::try_from(level).ok());
    let tool = |(level, um): (&f64, &f64)| {
        Some(ToolGrowth { number: Some(number(*level)?), label: None, um_per_krpm2: *um })
    };
    let tools: Option<Vec<ToolGrowth>> = levels.iter().zip(added).map(tool).collect();
    Some(ToolGrowthList { default_um_per_krpm2: *otherwise, tools: tools? })
}
