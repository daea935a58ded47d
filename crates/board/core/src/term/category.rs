//! Terms by category: the tool in the spindle, and conditions that hold or do not (coolant on, door open).
//!
//! ```text
//! tool        m(tool)·f                          m of a tool that is not in the table: `other`
//! condition   (m₀ + (m₁ − m₀)·lag_τ(s))·f        s = 1 while the condition holds, else 0
//! f           1, n² of the spindle in (r/min)², the growth by the source's own law, or P of the own axis
//! ```
//!
//! All m of a term share one binary point, that of the largest. They are chosen when the CNC says another tool or
//! condition, not in the tick, where one product remains. Without `Conditions` from the CNC each term has its stated
//! default. The effect of a change goes through the slew limit, as everything does.
//!
//! m is below 2³⁰. Worst error against `f64`: half of the last place of m, which is 2⁻³⁰ of the largest m times f, one
//! more such place while a lag is on its way, and half of 1/256 nm for the product (`category/tests.rs` measures it).

use crate::{
    cnc::MachineConditions,
    fixed_point::{ScaledCoefficient, rounding_shift_right, saturate_to_i32, widening_mul},
    lag::SmoothingFactor,
};

/// 1 of what a term over time, or a condition behind its lag, follows.
pub const UNIT_STEP: i32 = 1 << 30;

/// The factor that a level is multiplied by. The numbers are those of a blob.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u8)]
pub enum CategoryFactor {
    /// 1: the level is a length.
    #[default]
    One = 0,
    /// n², n in r/min.
    Speed2 = 1,
    /// The growth by the source's own law, without terms; of an elongation alone.
    Growth = 2,
    /// P of the own axis; of an axis alone.
    Position = 3,
}

impl CategoryFactor {
    /// Returns the factor of this number.
    #[must_use]
    pub const fn from_number(number: u8) -> Option<Self> {
        Some(match number {
            0 => Self::One,
            1 => Self::Speed2,
            2 => Self::Growth,
            3 => Self::Position,
            _ => return None,
        })
    }
}

/// A level for each tool.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ToolTable<'a> {
    /// `u32` number of the tool and `i32` m, little-endian; numbers rising.
    pub levels: &'a [[u8; 8]],
    /// m of every other tool, and while no tool is known.
    pub other: i32,
    /// Binary places of every m.
    pub shift: u8,
    /// f.
    pub times: CategoryFactor,
}

impl ToolTable<'_> {
    /// Returns the number and m of each tool.
    pub fn tool_levels(&self) -> impl Iterator<Item = (u32, i32)> {
        self.levels.iter().map(|&[a, b, c, d, e, f, g, h]| {
            (u32::from_le_bytes([a, b, c, d]), i32::from_le_bytes([e, f, g, h]))
        })
    }

    /// Returns m while the CNC says this.
    #[must_use]
    pub fn level(&self, conditions: Option<MachineConditions>) -> i32 {
        let tool = conditions.map(|conditions| u32::from(conditions.tool));
        let found = self.tool_levels().find(|(number, _)| Some(*number) == tool);
        found.map_or(self.other, |(_, level)| level)
    }
}

/// A level while a condition holds, and one while it does not.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ConditionLevels {
    /// The condition's bit, 0…15.
    pub bit: u8,
    /// Whether the condition counts as holding while the CNC does not say.
    pub default: bool,
    /// m₀.
    pub off: i32,
    /// m₁.
    pub on: i32,
    /// Binary places of both.
    pub shift: u8,
    /// α of the lag of s, per step of 100 ms.
    pub smoothing: SmoothingFactor,
    /// f.
    pub times: CategoryFactor,
}

impl ConditionLevels {
    /// Returns s in parts of [`UNIT_STEP`] while the CNC says this.
    #[must_use]
    pub fn lag_input(&self, conditions: Option<MachineConditions>) -> i32 {
        if conditions.map_or(self.default, |conditions| conditions.is_set(self.bit)) {
            UNIT_STEP
        } else {
            0
        }
    }

    /// Returns m where s, behind its lag, is `input`.
    #[must_use]
    pub fn level(&self, input: i32) -> i32 {
        let way = i64::from(self.on).wrapping_sub(self.off.into());
        // Below 2³¹ · 2³⁰, and s ends at the exact levels.
        let share =
            rounding_shift_right(way.wrapping_mul(input.into()), UNIT_STEP.trailing_zeros());
        saturate_to_i32(i64::from(self.off).wrapping_add(share))
    }
}

/// Returns m·f in 1/256 nm; `x` is f.
pub(super) fn scale_level(level: i32, shift: u8, x: i64) -> i32 {
    ScaledCoefficient { mantissa: level, shift }.multiply(x)
}

/// n² in (r/min)².
pub(super) fn speed_squared(rpm: u16) -> i64 {
    widening_mul(rpm.into(), rpm.into())
}

#[cfg(test)]
mod tests;
