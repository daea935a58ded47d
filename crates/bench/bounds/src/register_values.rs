//! The values of registers, as far as the instructions of a function alone say them: a number, or an unknown start and a
//! number. Two values with the same unknown differ by a number that is known.

use std::collections::BTreeSet;

use crate::{
    control_flow::ControlFlowGraph,
    decode::{ControlFlow, FlagEffect, Instruction, Operand, PC, RegisterEffect, SP},
    image::FirmwareImage,
};

/// The unknown part of a value.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum SymbolicBase {
    /// None: the value is a number.
    Nothing,
    /// That of a register at the entry of the function.
    Entry(u8),
    /// That which the instruction at this address left in a register.
    Left(u32, u8),
    /// That of a register where paths meet, at the start of a block.
    Met(usize, u8),
    /// A place not far behind this address of a unit of the chip.
    Unit(u32),
}

/// A value: unknown part and number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct SymbolicValue {
    /// The unknown part.
    pub base: SymbolicBase,
    /// The number, modulo 2³².
    pub offset: u32,
}

impl SymbolicValue {
    /// A number.
    #[must_use]
    pub fn constant(offset: u32) -> Self {
        Self { base: SymbolicBase::Nothing, offset }
    }

    /// Returns it, if it is a number.
    #[must_use]
    pub(crate) fn as_constant(self) -> Option<u32> {
        (self.base == SymbolicBase::Nothing).then_some(self.offset)
    }

    /// Returns the address of a unit of the chip, if the value is not far behind one.
    #[must_use]
    pub(crate) fn peripheral_base_address(self) -> Option<u32> {
        match self.base {
            SymbolicBase::Unit(unit) => Some(unit),
            _ => None,
        }
    }

    fn offset_by(self, amount: u32) -> Self {
        Self { offset: self.offset.wrapping_add(amount), ..self }
    }
}

/// What the flags stand for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct FlagOperands {
    /// The first operand.
    pub left: SymbolicValue,
    /// The second one.
    pub right: SymbolicValue,
    /// Of a sum, not of a difference.
    pub is_sum: bool,
    /// Only zero and negative are those of the difference.
    is_partial: bool,
}

impl FlagOperands {
    /// Those of a comparison with zero.
    #[must_use]
    pub(crate) fn from_comparison_with_zero(left: SymbolicValue) -> Self {
        Self { left, right: SymbolicValue::constant(0), is_sum: false, is_partial: false }
    }

    /// Returns whether a condition says something about the two operands.
    #[must_use]
    pub(crate) fn supports_condition(&self, condition: u8) -> bool {
        !self.is_partial || matches!(condition, 0 | 1 | 4 | 5)
    }

    /// Returns whether a condition holds, if both operands are numbers.
    #[must_use]
    pub(crate) fn evaluate_condition(&self, condition: u8) -> Option<bool> {
        let both = self.left.as_constant().zip(self.right.as_constant());
        let both = both.filter(|_| self.supports_condition(condition));
        both.map(|(x, y)| is_condition_met(condition, x, y, self.is_sum))
    }
}

/// The values of all registers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct RegisterState {
    values: [SymbolicValue; 16],
    /// What the flags stand for, where that is known.
    flags: Option<FlagOperands>,
    /// A bit for each register that points into the RAM.
    ram: u16,
}

impl RegisterState {
    /// Returns the value of a register.
    #[must_use]
    pub(crate) fn register_value(&self, register: u8) -> SymbolicValue {
        self.values[usize::from(register)]
    }

    /// Returns whether a register points into the RAM.
    #[must_use]
    pub(crate) fn is_ram_pointer(&self, register: u8) -> bool {
        register == SP || self.ram >> register & 1 != 0
    }

    /// Returns which of the first four registers point into the RAM, a bit each.
    #[must_use]
    pub(crate) fn argument_ram_pointer_mask(&self) -> u16 {
        (0..4).fold(0, |bits, register| bits | u16::from(self.is_ram_pointer(register)) << register)
    }

    /// Returns that at the entry of a function with these numbers in its first registers; `ram`: a bit for each that
    /// points into the RAM.
    #[must_use]
    pub(crate) fn at_function_entry(arguments: [Option<u32>; 4], ram: u16) -> Self {
        let values = std::array::from_fn(|register| {
            let unknown = SymbolicValue { base: SymbolicBase::Entry(register as u8), offset: 0 };
            arguments.get(register).copied().flatten().map_or(unknown, SymbolicValue::constant)
        });
        Self { values, flags: None, ram: ram | 1 << SP }
    }

    /// Returns what the flags stand for, where that is known.
    #[must_use]
    pub(crate) fn flag_operands(&self) -> Option<FlagOperands> {
        self.flags
    }

    /// An instruction is done, if its condition holds.
    pub(crate) fn execute_checking_condition(&mut self, image: &FirmwareImage, one: &Instruction) {
        let is_in_block = one.condition.is_some() && !matches!(one.flow, ControlFlow::Jump(_));
        let condition_holds = self
            .flags
            .zip(one.condition)
            .and_then(|(flags, condition)| flags.evaluate_condition(condition));
        match condition_holds.filter(|_| is_in_block) {
            Some(false) => {}
            Some(true) => self.execute_instruction(image, &Instruction { condition: None, ..*one }),
            None => self.execute_instruction(image, one),
        }
    }

    fn execute_instruction(&mut self, image: &FirmwareImage, one: &Instruction) {
        let before = *self;
        if one.writes != 0 {
            // A value of the same name from an earlier pass is another one.
            for (register, value) in self.values.iter_mut().enumerate() {
                if matches!(value.base, SymbolicBase::Left(at, _) if at & !1 == one.at) {
                    *value = SymbolicValue {
                        base: SymbolicBase::Left(one.at | 1, register as u8),
                        offset: 0,
                    };
                }
            }
        }
        for register in (0..15u8).filter(|register| one.writes >> register & 1 != 0) {
            self.values[usize::from(register)] =
                SymbolicValue { base: SymbolicBase::Left(one.at, register), offset: 0 };
        }
        let ram = before.ram_pointer_mask_after(image, one);
        self.ram =
            self.ram & !one.writes | if one.condition.is_some() { ram & before.ram } else { ram };
        if let (Some((to, value)), None) = (before.compute_result(image, one), one.condition)
            && to != PC
        {
            self.values[usize::from(to)] = value;
        }
        // A conditional one leaves the old value or the new one: an unknown, unless they are the same.
        if let (Some((to, value)), Some(_)) = (before.compute_result(image, one), one.condition)
            && to != PC
            && before.register_value(to) == value
        {
            self.values[usize::from(to)] = value;
        }
        self.flags = before.flag_operands_after(one, self);
        // A value of the same name from an earlier pass is another one.
        if one.writes != 0 && one.flags == FlagEffect::Unchanged {
            self.flags = self.flags.filter(|flags| {
                let is_old =
                    |value: SymbolicValue| matches!(value.base, SymbolicBase::Left(at, _) if at & !1 == one.at);
                !is_old(flags.left) && !is_old(flags.right)
            });
        }
    }

    /// What the flags stand for behind an instruction; `self`: before it, `after`: the values behind it.
    fn flag_operands_after(&self, one: &Instruction, after: &Self) -> Option<FlagOperands> {
        let of = |operand| match operand {
            Operand::Immediate(number) => SymbolicValue::constant(number),
            Operand::Register(register) => self.register_value(register),
        };
        let zero = SymbolicValue::constant(0);
        let (left, right, is_sum, is_partial) = match one.flags {
            FlagEffect::Unchanged => return self.flags,
            _ if one.condition.is_some() => return None,
            FlagEffect::Other => return None,
            FlagEffect::Compare(left, right) => {
                (self.register_value(left), of(right), false, false)
            }
            FlagEffect::Sum(left, right) => (self.register_value(left), of(right), true, false),
            FlagEffect::Result(register) => (after.register_value(register), zero, false, true),
            FlagEffect::Test(register, mask) => (
                SymbolicValue::constant(self.register_value(register).as_constant()? & mask),
                zero,
                false,
                true,
            ),
        };
        Some(FlagOperands { left, right, is_sum, is_partial })
    }

    /// The registers that an instruction writes and that then point into the RAM. A sum with an index stays there.
    fn ram_pointer_mask_after(&self, image: &FirmwareImage, one: &Instruction) -> u16 {
        let (to, is_ram) = match one.effect {
            RegisterEffect::Copy(to, from) | RegisterEffect::Add(to, from, _) => {
                (to, self.is_ram_pointer(from))
            }
            RegisterEffect::Sum(to, a, b) => (to, self.is_ram_pointer(a) || self.is_ram_pointer(b)),
            RegisterEffect::Set(to, _)
            | RegisterEffect::SetUpperHalf(to, _)
            | RegisterEffect::Literal(to, _) => {
                let number =
                    self.compute_result(image, one).and_then(|(_, value)| value.as_constant());
                (to, number.is_some_and(is_in_ram))
            }
            _ => return 0,
        };
        u16::from(is_ram) << to
    }

    fn compute_result(
        &self,
        image: &FirmwareImage,
        one: &Instruction,
    ) -> Option<(u8, SymbolicValue)> {
        let numbers = |a: u8, b: u8| (self.register_value(a), self.register_value(b));
        Some(match one.effect {
            RegisterEffect::Other => return None,
            RegisterEffect::Set(to, number) => (to, SymbolicValue::constant(number)),
            RegisterEffect::Copy(to, from) => (to, self.register_value(from)),
            RegisterEffect::Add(to, from, amount) => {
                (to, self.register_value(from).offset_by(amount))
            }
            RegisterEffect::Sum(to, a, b) => match numbers(a, b) {
                (value, SymbolicValue { base: SymbolicBase::Nothing, offset })
                | (SymbolicValue { base: SymbolicBase::Nothing, offset }, value)
                    if !matches!(
                        value.base,
                        SymbolicBase::Left(..) | SymbolicBase::Met(..) | SymbolicBase::Entry(_)
                    ) || !is_peripheral_address(offset) =>
                {
                    (to, value.offset_by(offset))
                }
                (SymbolicValue { base: SymbolicBase::Nothing, offset }, _)
                | (_, SymbolicValue { base: SymbolicBase::Nothing, offset }) => {
                    (to, SymbolicValue { base: SymbolicBase::Unit(offset), offset: 0 })
                }
                (SymbolicValue { base: SymbolicBase::Unit(unit), .. }, _)
                | (_, SymbolicValue { base: SymbolicBase::Unit(unit), .. }) => {
                    (to, SymbolicValue { base: SymbolicBase::Unit(unit), offset: 0 })
                }
                _ => return None,
            },
            RegisterEffect::Difference(to, a, b) => match numbers(a, b) {
                (a, b) if a.base == b.base && !matches!(a.base, SymbolicBase::Unit(_)) => {
                    (to, SymbolicValue::constant(a.offset.wrapping_sub(b.offset)))
                }
                (a, SymbolicValue { base: SymbolicBase::Nothing, offset }) => {
                    (to, a.offset_by(offset.wrapping_neg()))
                }
                _ => return None,
            },
            RegisterEffect::SetUpperHalf(to, half) => {
                let low = self.register_value(to).as_constant()?;
                (to, SymbolicValue::constant(half << 16 | low & 0xFFFF))
            }
            RegisterEffect::Literal(to, address) => {
                (to, SymbolicValue::constant(image.flash_word(address)?))
            }
            RegisterEffect::Shift(to, from, by) => {
                let number = self.register_value(from).as_constant()?;
                let shifted = if by > 0 { number << by } else { number >> -by };
                (to, SymbolicValue::constant(shifted))
            }
            RegisterEffect::ReverseSubtract(to, number, from) => (
                to,
                SymbolicValue::constant(
                    number.wrapping_sub(self.register_value(from).as_constant()?),
                ),
            ),
            RegisterEffect::And(to, from, mask) => {
                (to, SymbolicValue::constant(self.register_value(from).as_constant()? & mask))
            }
        })
    }
}

/// Returns whether an address is in one of the two RAMs.
fn is_in_ram(address: u32) -> bool {
    (0x2000_0000..0x2002_0000).contains(&address) || (0x1000_0000..0x1001_0000).contains(&address)
}

/// Returns whether an address is that of a unit of the chip.
fn is_peripheral_address(address: u32) -> bool {
    (0x4000_0000..0x6000_0000).contains(&address) || address >= 0xE000_0000
}

/// How often a block may be looked at until a value that stays through a loop counts as unknown there.
const VISITS_BEFORE_WIDENING: u32 = 64;

/// Returns the values at the start of each block.
///
/// A value is the same on all paths that lead to the block, or it is [`SymbolicBase::Met`]. What a register holds since an
/// earlier pass of the place that its value is named by gets a name of its own.
#[must_use]
pub(crate) fn compute_block_entry_states(
    image: &FirmwareImage,
    graph: &ControlFlowGraph,
    arguments: [Option<u32>; 4],
    ram: u16,
) -> Vec<RegisterState> {
    let order = reverse_postorder_numbers(graph);
    let count = graph.blocks.len();
    let (mut starts, mut ends): (Vec<Option<RegisterState>>, Vec<Option<RegisterState>>) =
        (vec![None; count], vec![None; count]);
    let mut looked = vec![0; count];
    let entry = RegisterState::at_function_entry(arguments, ram);
    let mut open = BTreeSet::from([(order[0], 0)]);
    while let Some((_, number)) = open.pop_first() {
        looked[number] += 1;
        let mut all: Vec<RegisterState> =
            graph.before[number].iter().filter_map(|before| ends[*before]).collect();
        if number == 0 {
            all.push(entry);
        }
        let old = starts[number].filter(|_| looked[number] < VISITS_BEFORE_WIDENING);
        let state = meet_states(&all, old.as_ref(), starts[number].as_ref(), number);
        starts[number] = Some(state);
        let mut end = state;
        execute_block(image, graph, number, &mut end);
        if ends[number] != Some(end) {
            ends[number] = Some(end);
            open.extend(graph.blocks[number].next.iter().map(|edge| (order[edge.to], edge.to)));
        }
    }
    starts.into_iter().map(|state| state.unwrap_or(entry)).collect()
}

/// The place of each block in an order in which loops alone lead back.
fn reverse_postorder_numbers(graph: &ControlFlowGraph) -> Vec<usize> {
    let (mut order, mut seen) = (vec![0; graph.blocks.len()], vec![false; graph.blocks.len()]);
    let mut next = graph.blocks.len();
    let mut stack = vec![(0, 0)];
    seen[0] = true;
    while let Some((number, edge)) = stack.pop() {
        match graph.blocks[number].next.get(edge) {
            Some(after) => {
                stack.push((number, edge + 1));
                if !std::mem::replace(&mut seen[after.to], true) {
                    stack.push((after.to, 0));
                }
            }
            None => {
                next -= 1;
                order[number] = next;
            }
        }
    }
    order
}

/// Takes the values through a block, its call included.
pub(crate) fn execute_block(
    image: &FirmwareImage,
    graph: &ControlFlowGraph,
    number: usize,
    state: &mut RegisterState,
) {
    let block = &graph.blocks[number];
    for one in &block.instructions {
        state.execute_checking_condition(image, one);
    }
    if block.call.is_some() {
        state.execute_checking_condition(
            image,
            &Instruction::call_clobbers(block.last_instruction().at),
        );
    }
}

/// `stays`: the values so far, which a path may bring back unchanged; `before`: those so far, for what is unknown for good.
fn meet_states(
    all: &[RegisterState],
    stays: Option<&RegisterState>,
    before: Option<&RegisterState>,
    block: usize,
) -> RegisterState {
    let values = std::array::from_fn(|register| {
        let unknown = SymbolicValue { base: SymbolicBase::Met(block, register as u8), offset: 0 };
        let is_met =
            |value: &SymbolicValue| matches!(value.base, SymbolicBase::Met(at, _) if at == block);
        if before.is_some_and(|before| before.values[register] == unknown) {
            return unknown;
        }
        let mut values = all.iter().map(|state| state.values[register]);
        let others: Vec<SymbolicValue> = match stays {
            Some(old) if all.len() > 1 => {
                let changed: Vec<SymbolicValue> =
                    values.clone().filter(|value| *value != old.values[register]).collect();
                if changed.is_empty() { values.collect() } else { changed }
            }
            _ => values.by_ref().collect(),
        };
        match others.first() {
            Some(first) if others.iter().all(|value| value == first) && !is_met(first) => *first,
            _ => unknown,
        }
    });
    let ram = all.iter().fold(u16::MAX, |ram, state| ram & state.ram);
    let flags = all.first().and_then(|state| state.flags);
    let is_met =
        |value: SymbolicValue| matches!(value.base, SymbolicBase::Met(at, _) if at == block);
    let flags = flags.filter(|flags| {
        all.iter().all(|state| state.flags == Some(*flags))
            && !is_met(flags.left)
            && !is_met(flags.right)
    });
    RegisterState { values, flags, ram: before.map_or(ram, |before| ram & before.ram) }
}

/// Returns whether a condition holds behind a comparison, or behind a sum (A7.3.1).
pub(crate) fn is_condition_met(condition: u8, x: u32, y: u32, is_sum: bool) -> bool {
    let (result, carry, overflow) = if is_sum {
        let (result, carry) = x.overflowing_add(y);
        (result, carry, x.cast_signed().overflowing_add(y.cast_signed()).1)
    } else {
        let (result, borrow) = x.overflowing_sub(y);
        (result, !borrow, x.cast_signed().overflowing_sub(y.cast_signed()).1)
    };
    let (zero, negative) = (result == 0, result >> 31 != 0);
    let is_so = match condition >> 1 {
        0 => zero,
        1 => carry,
        2 => negative,
        3 => overflow,
        4 => carry && !zero,
        5 => negative == overflow,
        6 => !zero && negative == overflow,
        _ => true,
    };
    is_so != (condition & 1 != 0)
}
