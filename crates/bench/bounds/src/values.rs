//! The values of registers, as far as the instructions of a function alone say them: a number, or an unknown start and a
//! number. Two values with the same unknown differ by a number that is known.

use std::collections::BTreeSet;

use crate::{
    decode::{Effect, Flags, Flow, Instruction, Operand, PC, SP},
    flow::Graph,
    image::Image,
};

/// The unknown part of a value.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Base {
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
pub struct Value {
    /// The unknown part.
    pub base: Base,
    /// The number, modulo 2³².
    pub offset: u32,
}

impl Value {
    /// A number.
    #[must_use]
    pub fn number(offset: u32) -> Self {
        Self { base: Base::Nothing, offset }
    }

    /// Returns it, if it is a number.
    #[must_use]
    pub(crate) fn as_number(self) -> Option<u32> {
        (self.base == Base::Nothing).then_some(self.offset)
    }

    /// Returns the address of a unit of the chip, if the value is not far behind one.
    #[must_use]
    pub fn unit(self) -> Option<u32> {
        match self.base {
            Base::Unit(unit) => Some(unit),
            _ => None,
        }
    }

    fn plus(self, amount: u32) -> Self {
        Self { offset: self.offset.wrapping_add(amount), ..self }
    }
}

/// What the flags stand for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Flagged {
    /// The first operand.
    pub left: Value,
    /// The second one.
    pub right: Value,
    /// Of a sum, not of a difference.
    pub is_sum: bool,
    /// Only zero and negative are those of the difference.
    is_partial: bool,
}

impl Flagged {
    /// Those of a comparison with zero.
    #[must_use]
    pub fn zero(left: Value) -> Self {
        Self { left, right: Value::number(0), is_sum: false, is_partial: false }
    }

    /// Returns whether a condition says something about the two operands.
    #[must_use]
    pub fn is_known(&self, condition: u8) -> bool {
        !self.is_partial || matches!(condition, 0 | 1 | 4 | 5)
    }

    /// Returns whether a condition holds, if both operands are numbers.
    #[must_use]
    pub fn holds(&self, condition: u8) -> Option<bool> {
        let both = self.left.as_number().zip(self.right.as_number());
        let both = both.filter(|_| self.is_known(condition));
        both.map(|(x, y)| holds(condition, x, y, self.is_sum))
    }
}

/// The values of all registers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct State {
    values: [Value; 16],
    /// What the flags stand for, where that is known.
    flags: Option<Flagged>,
    /// A bit for each register that points into the RAM.
    ram: u16,
}

impl State {
    /// Returns the value of a register.
    #[must_use]
    pub fn of(&self, register: u8) -> Value {
        self.values[usize::from(register)]
    }

    /// Returns whether a register points into the RAM.
    #[must_use]
    pub(crate) fn is_ram(&self, register: u8) -> bool {
        register == SP || self.ram >> register & 1 != 0
    }

    /// Returns that at the entry of a function with these numbers in its first registers; `ram`: a bit for each that
    /// points into the RAM.
    #[must_use]
    pub fn entry(arguments: [Option<u32>; 4], ram: u16) -> Self {
        let values = std::array::from_fn(|register| {
            let unknown = Value { base: Base::Entry(register as u8), offset: 0 };
            arguments.get(register).copied().flatten().map_or(unknown, Value::number)
        });
        Self { values, flags: None, ram: ram | 1 << SP }
    }

    /// Returns what the flags stand for, where that is known.
    #[must_use]
    pub fn flags(&self) -> Option<Flagged> {
        self.flags
    }

    /// An instruction is done, if its condition holds.
    pub fn step(&mut self, image: &Image, one: &Instruction) {
        let is_in_block = one.condition.is_some() && !matches!(one.flow, Flow::Jump(_));
        let holds = self.flags.zip(one.condition).and_then(|(flags, it)| flags.holds(it));
        match holds.filter(|_| is_in_block) {
            Some(false) => {}
            Some(true) => self.done(image, &Instruction { condition: None, ..*one }),
            None => self.done(image, one),
        }
    }

    fn done(&mut self, image: &Image, one: &Instruction) {
        let before = *self;
        if one.writes != 0 {
            // A value of the same name from an earlier pass is another one.
            for (register, value) in self.values.iter_mut().enumerate() {
                if matches!(value.base, Base::Left(at, _) if at & !1 == one.at) {
                    *value = Value { base: Base::Left(one.at | 1, register as u8), offset: 0 };
                }
            }
        }
        for register in (0..15u8).filter(|register| one.writes >> register & 1 != 0) {
            self.values[usize::from(register)] =
                Value { base: Base::Left(one.at, register), offset: 0 };
        }
        let ram = before.ram_after(image, one);
        self.ram =
            self.ram & !one.writes | if one.condition.is_some() { ram & before.ram } else { ram };
        if let (Some((to, value)), None) = (before.result(image, one), one.condition)
            && to != PC
        {
            self.values[usize::from(to)] = value;
        }
        // A conditional one leaves the old value or the new one: an unknown, unless they are the same.
        if let (Some((to, value)), Some(_)) = (before.result(image, one), one.condition)
            && to != PC
            && before.of(to) == value
        {
            self.values[usize::from(to)] = value;
        }
        self.flags = before.flags_after(one, self);
        // A value of the same name from an earlier pass is another one.
        if one.writes != 0 && one.flags == Flags::Keep {
            self.flags = self.flags.filter(|flags| {
                let is_old =
                    |value: Value| matches!(value.base, Base::Left(at, _) if at & !1 == one.at);
                !is_old(flags.left) && !is_old(flags.right)
            });
        }
    }

    /// What the flags stand for behind an instruction; `self`: before it, `after`: the values behind it.
    fn flags_after(&self, one: &Instruction, after: &Self) -> Option<Flagged> {
        let of = |operand| match operand {
            Operand::Number(number) => Value::number(number),
            Operand::Register(register) => self.of(register),
        };
        let zero = Value::number(0);
        let (left, right, is_sum, is_partial) = match one.flags {
            Flags::Keep => return self.flags,
            _ if one.condition.is_some() => return None,
            Flags::Other => return None,
            Flags::Compare(left, right) => (self.of(left), of(right), false, false),
            Flags::Sum(left, right) => (self.of(left), of(right), true, false),
            Flags::Result(register) => (after.of(register), zero, false, true),
            Flags::Test(register, mask) => {
                (Value::number(self.of(register).as_number()? & mask), zero, false, true)
            }
        };
        Some(Flagged { left, right, is_sum, is_partial })
    }

    /// The registers that an instruction writes and that then point into the RAM. A sum with an index stays there.
    fn ram_after(&self, image: &Image, one: &Instruction) -> u16 {
        let (to, is_ram) = match one.effect {
            Effect::Copy(to, from) | Effect::Add(to, from, _) => (to, self.is_ram(from)),
            Effect::Sum(to, a, b) => (to, self.is_ram(a) || self.is_ram(b)),
            Effect::Set(to, _) | Effect::High(to, _) | Effect::Literal(to, _) => {
                let number = self.result(image, one).and_then(|(_, value)| value.as_number());
                (to, number.is_some_and(is_in_ram))
            }
            _ => return 0,
        };
        u16::from(is_ram) << to
    }

    fn result(&self, image: &Image, one: &Instruction) -> Option<(u8, Value)> {
        let numbers = |a: u8, b: u8| (self.of(a), self.of(b));
        Some(match one.effect {
            Effect::Other => return None,
            Effect::Set(to, number) => (to, Value::number(number)),
            Effect::Copy(to, from) => (to, self.of(from)),
            Effect::Add(to, from, amount) => (to, self.of(from).plus(amount)),
            Effect::Sum(to, a, b) => match numbers(a, b) {
                (value, Value { base: Base::Nothing, offset })
                | (Value { base: Base::Nothing, offset }, value)
                    if !matches!(value.base, Base::Left(..) | Base::Met(..) | Base::Entry(_))
                        || !is_unit(offset) =>
                {
                    (to, value.plus(offset))
                }
                (Value { base: Base::Nothing, offset }, _)
                | (_, Value { base: Base::Nothing, offset }) => {
                    (to, Value { base: Base::Unit(offset), offset: 0 })
                }
                (Value { base: Base::Unit(unit), .. }, _)
                | (_, Value { base: Base::Unit(unit), .. }) => {
                    (to, Value { base: Base::Unit(unit), offset: 0 })
                }
                _ => return None,
            },
            Effect::Difference(to, a, b) => match numbers(a, b) {
                (a, b) if a.base == b.base && !matches!(a.base, Base::Unit(_)) => {
                    (to, Value::number(a.offset.wrapping_sub(b.offset)))
                }
                (a, Value { base: Base::Nothing, offset }) => (to, a.plus(offset.wrapping_neg())),
                _ => return None,
            },
            Effect::High(to, half) => {
                let low = self.of(to).as_number()?;
                (to, Value::number(half << 16 | low & 0xFFFF))
            }
            Effect::Literal(to, address) => (to, Value::number(image.constant(address)?)),
            Effect::Shift(to, from, by) => {
                let number = self.of(from).as_number()?;
                let shifted = if by > 0 { number << by } else { number >> -by };
                (to, Value::number(shifted))
            }
            Effect::From(to, number, from) => {
                (to, Value::number(number.wrapping_sub(self.of(from).as_number()?)))
            }
            Effect::And(to, from, mask) => (to, Value::number(self.of(from).as_number()? & mask)),
        })
    }
}

/// Returns whether an address is in one of the two RAMs.
fn is_in_ram(address: u32) -> bool {
    (0x2000_0000..0x2002_0000).contains(&address) || (0x1000_0000..0x1001_0000).contains(&address)
}

/// Returns whether an address is that of a unit of the chip.
fn is_unit(address: u32) -> bool {
    (0x4000_0000..0x6000_0000).contains(&address) || address >= 0xE000_0000
}

/// How often a block may be looked at until a value that stays through a loop counts as unknown there.
const PATIENCE: u32 = 64;

/// Returns the values at the start of each block.
///
/// A value is the same on all paths that lead to the block, or it is [`Base::Met`]. What a register holds since an
/// earlier pass of the place that its value is named by gets a name of its own.
#[must_use]
pub(crate) fn at_starts(
    image: &Image,
    graph: &Graph,
    arguments: [Option<u32>; 4],
    ram: u16,
) -> Vec<State> {
    let order = order(graph);
    let count = graph.blocks.len();
    let (mut starts, mut ends): (Vec<Option<State>>, Vec<Option<State>>) =
        (vec![None; count], vec![None; count]);
    let mut looked = vec![0; count];
    let entry = State::entry(arguments, ram);
    let mut open = BTreeSet::from([(order[0], 0)]);
    while let Some((_, number)) = open.pop_first() {
        looked[number] += 1;
        let mut all: Vec<State> =
            graph.before[number].iter().filter_map(|before| ends[*before]).collect();
        if number == 0 {
            all.push(entry);
        }
        let old = starts[number].filter(|_| looked[number] < PATIENCE);
        let state = meet(&all, old.as_ref(), starts[number].as_ref(), number);
        starts[number] = Some(state);
        let mut end = state;
        through(image, graph, number, &mut end);
        if ends[number] != Some(end) {
            ends[number] = Some(end);
            open.extend(graph.blocks[number].next.iter().map(|edge| (order[edge.to], edge.to)));
        }
    }
    starts.into_iter().map(|state| state.unwrap_or(entry)).collect()
}

/// The place of each block in an order in which loops alone lead back.
fn order(graph: &Graph) -> Vec<usize> {
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
pub fn through(image: &Image, graph: &Graph, number: usize, state: &mut State) {
    let block = &graph.blocks[number];
    for one in &block.instructions {
        state.step(image, one);
    }
    if block.call.is_some() {
        state.step(image, &Instruction::call(block.last().at));
    }
}

/// `stays`: the values so far, which a path may bring back unchanged; `before`: those so far, for what is unknown for good.
fn meet(all: &[State], stays: Option<&State>, before: Option<&State>, block: usize) -> State {
    let values = std::array::from_fn(|register| {
        let unknown = Value { base: Base::Met(block, register as u8), offset: 0 };
        let is_met = |value: &Value| matches!(value.base, Base::Met(at, _) if at == block);
        if before.is_some_and(|before| before.values[register] == unknown) {
            return unknown;
        }
        let mut values = all.iter().map(|state| state.values[register]);
        let others: Vec<Value> = match stays {
            Some(old) if all.len() > 1 => {
                let changed: Vec<Value> =
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
    let is_met = |value: Value| matches!(value.base, Base::Met(at, _) if at == block);
    let flags = flags.filter(|flags| {
        all.iter().all(|state| state.flags == Some(*flags))
            && !is_met(flags.left)
            && !is_met(flags.right)
    });
    State { values, flags, ram: before.map_or(ram, |before| ram & before.ram) }
}

/// Returns whether a condition holds behind a comparison, or behind a sum (A7.3.1).
pub(crate) fn holds(condition: u8, x: u32, y: u32, is_sum: bool) -> bool {
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
