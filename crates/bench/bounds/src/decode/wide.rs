//! Instructions of 32 bits (A5.3).

use super::{
    Address, Effect, Flags, Flow, Instruction, Mask, Operand, PC, Register, SP, coprocessor,
    listed, narrow, signed,
};

/// Fills in what the two half-words say.
pub(super) fn decode(one: Instruction, first: u32, second: u32) -> Instruction {
    let all = first << 16 | second;
    match first >> 9 & 0b1111 {
        // 1110 100
        0b0100 if first >> 6 & 1 == 0 => multiple(one, first, second),
        0b0100 => double(one, first, second),
        0b0101 => shifted(one, first, second),
        0b1000..=0b1011 if second >> 15 == 0 => immediate(one, first, second),
        0b1000..=0b1011 => control(one, first, second),
        0b1100 => single(one, first, second),
        0b1101 => by_register(one, first, second),
        _ => coprocessor::decode(one, all),
    }
}

fn field(half: u32, from: u32) -> Register {
    (half >> from & 15) as u8
}

/// `ldm`, `stm`, `push`, `pop`.
fn multiple(one: Instruction, first: u32, second: u32) -> Instruction {
    let (base, count) = (field(first, 0), second.count_ones());
    let writes_back = first >> 5 & 1 != 0;
    let is_load = first >> 4 & 1 != 0;
    let amount = if first >> 7 & 3 == 1 { 4 * count } else { (4 * count).wrapping_neg() };
    let one = if is_load {
        one.load(count, Address::Near(base, 0)).writing(listed(second & 0x7FFF))
    } else {
        one.store(count, Address::Near(base, 0))
    };
    let one =
        if writes_back { narrow::moves_stack(one.writing([base]), base, amount) } else { one };
    match (is_load && second >> 15 != 0, base) {
        (true, SP) => Instruction { flow: Flow::Return, ..one },
        (true, _) => Instruction { flow: Flow::JumpRegister(PC), ..one },
        _ => one,
    }
}

/// `ldrd`, `strd`, exclusive ones, jumps by table.
fn double(one: Instruction, first: u32, second: u32) -> Instruction {
    let (base, to, other) = (field(first, 0), field(second, 12), field(second, 8));
    let is_load = first >> 4 & 1 != 0;
    let offset = 4 * (second & 0xFF);
    let (indexed, writes_back) = (first >> 8 & 1 != 0, first >> 5 & 1 != 0);
    if !indexed && !writes_back {
        // Exclusive, or a table.
        if first >> 4 & 15 == 0b1101 && second >> 5 & 7 == 0 {
            let size = if second >> 4 & 1 == 0 { 1 } else { 2 };
            return Instruction { flow: Flow::Table { size }, cycles: 2, ..one };
        }
        return if is_load {
            one.load(1, Address::Near(base, 0)).writing([to])
        } else {
            let status = if first >> 7 & 1 != 0 { field(second, 0) } else { other };
            one.store(1, Address::Near(base, 0)).writing([status])
        };
    }
    let signed_offset = if first >> 7 & 1 != 0 { offset } else { offset.wrapping_neg() };
    let address = Address::Near(base, if indexed { signed_offset } else { 0 });
    let one = if base == PC {
        one.load(2, Address::Literal).writing([to, other])
    } else if is_load {
        one.load(2, address).writing([to, other])
    } else {
        one.store(2, address)
    };
    if writes_back { one.writing([base]).with(Effect::Add(base, base, signed_offset)) } else { one }
}

/// Arithmetic with a second register that may be shifted.
fn shifted(one: Instruction, first: u32, second: u32) -> Instruction {
    let (from, to, other) = (field(first, 0), field(second, 8), field(second, 0));
    let amount = (second >> 12 & 7) << 2 | second >> 6 & 3;
    let kind = second >> 4 & 3;
    let is_plain = amount == 0 && kind == 0;
    let sets = first >> 4 & 1 != 0;
    let by = if is_plain { Some(Operand::Register(other)) } else { None };
    let (effect, flags) = match first >> 5 & 15 {
        2 if from == PC => (moved(to, other, kind, amount), Flags::Other),
        8 => (
            if is_plain { Effect::Sum(to, from, other) } else { Effect::Other },
            by.map_or(Flags::Other, |by| Flags::Sum(from, by)),
        ),
        13 => (
            if is_plain { Effect::Difference(to, from, other) } else { Effect::Other },
            by.map_or(Flags::Other, |by| Flags::Compare(from, by)),
        ),
        _ => (Effect::Other, Flags::Other),
    };
    result(one, to, sets, effect, flags)
}

fn moved(to: Register, from: Register, kind: u32, amount: u32) -> Effect {
    match (kind, amount) {
        (0, 0) => Effect::Copy(to, from),
        (0, _) => Effect::Shift(to, from, amount as i8),
        (1, 1..) => Effect::Shift(to, from, -(amount as i8)),
        _ => Effect::Other,
    }
}

/// A result that is not kept is a comparison.
fn result(one: Instruction, to: Register, sets: bool, effect: Effect, flags: Flags) -> Instruction {
    let one = Instruction { flags: if sets { flags } else { Flags::Keep }, ..one };
    if to == PC && sets { one } else { one.writing([to]).with(effect) }
}

/// ThumbExpandImm (A5.3.2).
fn expanded(bits: u32) -> u32 {
    let byte = bits & 0xFF;
    match bits >> 8 {
        0 => byte,
        1 => byte << 16 | byte,
        2 => byte << 24 | byte << 8,
        3 => byte * 0x0101_0101,
        _ => (0x80 | bits & 0x7F).rotate_right(bits >> 7),
    }
}

/// Arithmetic with a number.
fn immediate(one: Instruction, first: u32, second: u32) -> Instruction {
    let bits = (first >> 10 & 1) << 11 | (second >> 12 & 7) << 8 | second & 0xFF;
    let (from, to) = (field(first, 0), field(second, 8));
    if first >> 9 & 1 != 0 {
        return plain(one, first, second, bits);
    }
    let number = expanded(bits);
    let sets = first >> 4 & 1 != 0;
    let by = Operand::Number(number);
    let (effect, flags) = match first >> 5 & 15 {
        0 if to == PC => (Effect::Other, Flags::Test(from, number)),
        0 => (Effect::And(to, from, number), Flags::Result(to)),
        1 => (Effect::And(to, from, !number), Flags::Result(to)),
        14 => (Effect::From(to, number, from), Flags::Result(to)),
        2 if from == PC => (Effect::Set(to, number), Flags::Other),
        3 if from == PC => (Effect::Set(to, !number), Flags::Other),
        8 => (Effect::Add(to, from, number), Flags::Sum(from, by)),
        13 => (Effect::Add(to, from, number.wrapping_neg()), Flags::Compare(from, by)),
        _ => (Effect::Other, Flags::Other),
    };
    result(one, to, sets, effect, flags)
}

/// With a plain number of 12 or 16 bits, and bit fields.
fn plain(one: Instruction, first: u32, second: u32, bits: u32) -> Instruction {
    let (from, to) = (field(first, 0), field(second, 8));
    let half = (first & 15) << 12 | bits;
    let effect = match first >> 4 & 31 {
        0 if from == PC => Effect::Set(to, ((one.at + 4) & !3) + bits),
        0 => Effect::Add(to, from, bits),
        4 => Effect::Set(to, half),
        10 if from == PC => Effect::Set(to, ((one.at + 4) & !3).wrapping_sub(bits)),
        10 => Effect::Add(to, from, bits.wrapping_neg()),
        12 => Effect::High(to, half),
        _ => Effect::Other,
    };
    one.writing([to]).with(effect)
}

/// Branches and control (A5.3.4).
fn control(one: Instruction, first: u32, second: u32) -> Instruction {
    let bit = |word: u32, number: u32| (word >> number) & 1;
    let (sign, j1, j2) = (bit(first, 10), bit(second, 13), bit(second, 11));
    let low = (second & 0x7FF) << 1;
    let far = || {
        let (i1, i2) = (1 ^ j1 ^ sign, 1 ^ j2 ^ sign);
        let offset = sign << 24 | i1 << 23 | i2 << 22 | (first & 0x3FF) << 12 | low;
        one.at.wrapping_add(4).wrapping_add(signed(offset, 25))
    };
    match (bit(second, 14), bit(second, 12)) {
        (1, 1) => Instruction { flow: Flow::Call(far()), writes: 1 << 14, ..one },
        (0, 1) => Instruction { flow: Flow::Jump(far()), ..one },
        (0, _) if first >> 7 & 7 != 7 => {
            let near = sign << 20 | j2 << 19 | j1 << 18 | (first & 0x3F) << 12 | low;
            let target = one.at.wrapping_add(4).wrapping_add(signed(near, 21));
            let condition = Some((first >> 6 & 15) as u8);
            Instruction { flow: Flow::Jump(target), condition, ..one }
        }
        _ => system(one, first, second),
    }
}

fn system(one: Instruction, first: u32, second: u32) -> Instruction {
    let one = Instruction { cycles: 2, ..one };
    match first >> 4 & 0x7F {
        // msr
        0x38 | 0x39 => {
            let mask = match second & 0xFF {
                16 => Some(Mask::On),
                17 => Some(Mask::Restore),
                18 => Some(Mask::Raise(field(first, 0))),
                _ => None,
            };
            let flags = if second & 0xFF < 4 { Flags::Other } else { Flags::Keep };
            Instruction { mask, flags, ..one }
        }
        // mrs
        0x3E | 0x3F => one.writing([field(second, 8)]),
        // dsb, dmb, isb: at most the store that is on its way, to the slower bus.
        0x3B => Instruction { cycles: 16, ..one },
        0x7F => Instruction { flow: Flow::Stop, ..one },
        _ => one,
    }
}

/// A load or store of one register (A5.3.7 to A5.3.10).
fn single(one: Instruction, first: u32, second: u32) -> Instruction {
    let (base, to) = (field(first, 0), field(second, 12));
    let is_load = first >> 4 & 1 != 0;
    if base == PC && is_load {
        let offset = second & 0xFFF;
        let from = (one.at + 4) & !3;
        let address = if first >> 7 & 1 != 0 { from + offset } else { from.wrapping_sub(offset) };
        let one = one.load(1, Address::Literal);
        return if to == PC {
            Instruction { flow: Flow::JumpRegister(PC), ..one }
        } else if first >> 5 & 3 == 2 {
            one.writing([to]).with(Effect::Literal(to, address))
        } else {
            one.writing([to])
        };
    }
    let small = second & 0xFF;
    let (address, back) = if first >> 7 & 1 != 0 {
        (Address::Near(base, second & 0xFFF), None)
    } else if second >> 11 & 1 == 0 {
        (Address::Sum(base, field(second, 0)), None)
    } else {
        let amount = if second >> 9 & 1 != 0 { small } else { small.wrapping_neg() };
        let indexed = second >> 10 & 1 != 0;
        let back = (second >> 8 & 1 != 0).then_some(amount);
        (Address::Near(base, if indexed { amount } else { 0 }), back)
    };
    let one = match is_load {
        // A hint to read ahead, `pld`.
        true if to == PC && first >> 5 & 3 != 2 => return one,
        true if to == PC => {
            let flow = if base == SP { Flow::Return } else { Flow::JumpRegister(PC) };
            Instruction { flow, ..one.load(1, address) }
        }
        true => one.load(1, address).writing([to]),
        false => one.store(1, address),
    };
    match back {
        Some(amount) => one.writing([base]).with(Effect::Add(base, base, amount)),
        None => one,
    }
}

/// Shifts by register, extensions, products, quotients (A5.3.12 to A5.3.17).
fn by_register(one: Instruction, first: u32, second: u32) -> Instruction {
    let to = field(second, 8);
    if first >> 8 & 1 == 0 {
        let sets = first >> 7 & 1 == 0 && first >> 4 & 1 != 0 && second >> 7 & 1 == 0;
        let flags = if sets { Flags::Other } else { Flags::Keep };
        let is_extension = second >> 7 & 1 != 0 && first & 0x8F == 0x0F;
        let from = field(second, 0);
        let is_straight = second >> 4 & 3 == 0;
        let effect = match first >> 4 & 7 {
            1 if is_extension && is_straight => Effect::And(to, from, 0xFFFF),
            5 if is_extension && is_straight => Effect::And(to, from, 0xFF),
            _ => Effect::Other,
        };
        return Instruction { flags, ..one.writing([to]).with(effect) };
    }
    if first >> 7 & 1 == 0 {
        // mla and mls take two.
        return Instruction { cycles: 2, ..one.writing([to]) };
    }
    match first >> 4 & 7 {
        // sdiv, udiv
        1 | 3 => Instruction { cycles: 12, ..one.writing([to]) },
        _ => Instruction { cycles: 1, ..one.writing([to, field(second, 12)]) },
    }
}
