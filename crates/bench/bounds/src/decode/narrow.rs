//! Instructions of 16 bits (A5.2).

use super::{Address, Effect, Flags, Flow, Instruction, LR, Mask, Operand, PC, SP, listed, signed};

/// Fills in what the half-word says.
pub(super) fn decode(one: Instruction, half: u32) -> Instruction {
    match half >> 12 {
        0..=3 => arithmetic(one, half),
        4 if half >> 10 == 0b01_0000 => processing(one, half),
        4 if half >> 10 == 0b01_0001 => special(one, half),
        4 => {
            let to = bits(half, 8, 3);
            let address = ((one.at + 4) & !3) + 4 * (half & 0xFF);
            one.load(1, Address::Literal).writing([to]).with(Effect::Literal(to, address))
        }
        5..=9 => memory(one, half),
        10 => {
            let (to, amount) = (bits(half, 8, 3), 4 * (half & 0xFF));
            let effect = if half >> 11 & 1 == 0 {
                Effect::Set(to, ((one.at + 4) & !3) + amount)
            } else {
                Effect::Add(to, SP, amount)
            };
            one.writing([to]).with(effect)
        }
        11 => miscellaneous(one, half),
        12 => {
            let (base, list) = (bits(half, 8, 3), half & 0xFF);
            let is_load = half >> 11 & 1 != 0;
            let address = Address::Near(base, 0);
            if is_load {
                one.load(list.count_ones(), address).writing(listed(list)).writing([base])
            } else {
                one.store(list.count_ones(), address).writing([base])
            }
        }
        13 => branch(one, half),
        _ => Instruction { flow: Flow::Jump(target(&one, signed(half & 0x7FF, 11) << 1)), ..one },
    }
}

fn bits(half: u32, from: u32, count: u32) -> u8 {
    (half >> from & ((1 << count) - 1)) as u8
}

fn target(one: &Instruction, offset: u32) -> u32 {
    one.at.wrapping_add(4).wrapping_add(offset)
}

/// Within an IT block these set no flags.
fn flags(one: Instruction, flags: Flags) -> Instruction {
    if one.condition.is_some() { one } else { Instruction { flags, ..one } }
}

fn arithmetic(one: Instruction, half: u32) -> Instruction {
    let (low, high) = (bits(half, 0, 3), bits(half, 3, 3));
    let (long_to, byte) = (bits(half, 8, 3), half & 0xFF);
    let third = bits(half, 6, 3);
    let small = u32::from(third);
    let shift = (half >> 6 & 31) as i8;
    match half >> 9 {
        0b1100 => flags(
            one.writing([low]).with(Effect::Sum(low, high, third)),
            Flags::Sum(high, Operand::Register(third)),
        ),
        0b1101 => flags(
            one.writing([low]).with(Effect::Difference(low, high, third)),
            Flags::Compare(high, Operand::Register(third)),
        ),
        0b1110 => flags(
            one.writing([low]).with(Effect::Add(low, high, small)),
            Flags::Sum(high, Operand::Number(small)),
        ),
        0b1111 => flags(
            one.writing([low]).with(Effect::Add(low, high, small.wrapping_neg())),
            Flags::Compare(high, Operand::Number(small)),
        ),
        _ => match half >> 11 {
            0 if shift == 0 => {
                flags(one.writing([low]).with(Effect::Copy(low, high)), Flags::Result(low))
            }
            0 => {
                let one = one.writing([low]).with(Effect::Shift(low, high, shift));
                flags(one, Flags::Result(low))
            }
            1 if shift != 0 => {
                let one = one.writing([low]).with(Effect::Shift(low, high, -shift));
                flags(one, Flags::Result(low))
            }
            1 | 2 => flags(one.writing([low]), Flags::Other),
            4 => flags(
                one.writing([long_to]).with(Effect::Set(long_to, byte)),
                Flags::Result(long_to),
            ),
            // cmp sets flags in an IT block as well.
            5 => Instruction { flags: Flags::Compare(long_to, Operand::Number(byte)), ..one },
            6 => flags(
                one.writing([long_to]).with(Effect::Add(long_to, long_to, byte)),
                Flags::Sum(long_to, Operand::Number(byte)),
            ),
            _ => flags(
                one.writing([long_to]).with(Effect::Add(long_to, long_to, byte.wrapping_neg())),
                Flags::Compare(long_to, Operand::Number(byte)),
            ),
        },
    }
}

fn processing(one: Instruction, half: u32) -> Instruction {
    let (to, from) = (bits(half, 0, 3), bits(half, 3, 3));
    match half >> 6 & 15 {
        // tst, cmn
        8 => Instruction { flags: Flags::Other, ..one },
        11 => Instruction { flags: Flags::Sum(to, Operand::Register(from)), ..one },
        10 => Instruction { flags: Flags::Compare(to, Operand::Register(from)), ..one },
        9 => flags(one.writing([to]).with(Effect::From(to, 0, from)), Flags::Result(to)),
        _ => flags(one.writing([to]), Flags::Other),
    }
}

/// On high registers, and branches by register.
fn special(one: Instruction, half: u32) -> Instruction {
    let to = bits(half, 0, 3) | bits(half, 7, 1) << 3;
    let from = bits(half, 3, 4);
    match half >> 8 & 3 {
        0 if to == PC => Instruction { flow: Flow::JumpRegister(PC), ..one },
        0 => one.writing([to]).with(Effect::Sum(to, to, from)),
        1 => Instruction { flags: Flags::Compare(to, Operand::Register(from)), ..one },
        2 if to == PC && from == LR => Instruction { flow: Flow::Return, ..one },
        2 if to == PC => Instruction { flow: Flow::JumpRegister(from), ..one },
        2 => one.writing([to]).with(Effect::Copy(to, from)),
        _ if half >> 7 & 1 != 0 => Instruction { flow: Flow::CallRegister(from), ..one },
        _ if from == LR => Instruction { flow: Flow::Return, ..one },
        _ => Instruction { flow: Flow::JumpRegister(from), ..one },
    }
}

fn memory(one: Instruction, half: u32) -> Instruction {
    let (to, base) = (bits(half, 0, 3), bits(half, 3, 3));
    let by_register = Address::Sum(base, bits(half, 6, 3));
    let small = half >> 6 & 31;
    let (is_load, to, address) = match half >> 11 {
        // str, strh, strb; ldrsb, ldr, ldrh, ldrb, ldrsh
        0b01010 | 0b01011 => (half >> 9 & 7 > 2, to, by_register),
        0b01100 => (false, to, Address::Near(base, 4 * small)),
        0b01101 => (true, to, Address::Near(base, 4 * small)),
        0b01110 => (false, to, Address::Near(base, small)),
        0b01111 => (true, to, Address::Near(base, small)),
        0b10000 => (false, to, Address::Near(base, 2 * small)),
        0b10001 => (true, to, Address::Near(base, 2 * small)),
        0b10010 => (false, bits(half, 8, 3), Address::Near(SP, 4 * (half & 0xFF))),
        _ => (true, bits(half, 8, 3), Address::Near(SP, 4 * (half & 0xFF))),
    };
    if is_load { one.load(1, address).writing([to]) } else { one.store(1, address) }
}

fn miscellaneous(one: Instruction, half: u32) -> Instruction {
    match half >> 8 & 15 {
        0 => {
            let amount = 4 * (half & 0x7F);
            let amount = if half >> 7 & 1 == 0 { amount } else { amount.wrapping_neg() };
            one.writing([SP]).with(Effect::Add(SP, SP, amount))
        }
        1 | 3 | 9 | 11 => {
            let offset = (half >> 9 & 1) << 6 | (half >> 3 & 31) << 1;
            let (register, if_zero) = (bits(half, 0, 3), half >> 11 & 1 == 0);
            let flow = Flow::Zero { register, target: target(&one, offset), if_zero };
            Instruction { flow, ..one }
        }
        4 | 5 => {
            let list = half & 0xFF | (half >> 8 & 1) << 14;
            let count = list.count_ones();
            let down = Effect::Add(SP, SP, (4 * count).wrapping_neg());
            one.store(count, Address::Near(SP, 0)).writing([SP]).with(down)
        }
        12 | 13 => {
            let list = half & 0xFF;
            let returns = half >> 8 & 1;
            let count = list.count_ones() + returns;
            let up = Effect::Add(SP, SP, 4 * count);
            let one = one.load(count, Address::Near(SP, 0)).writing(listed(list)).writing([SP]);
            let flow = if returns == 1 { Flow::Return } else { Flow::Next };
            Instruction { flow, ..one.with(up) }
        }
        // cps: of the two masks only PRIMASK.
        6 if half & 0xFFE0 == 0xB660 => {
            let mask = if half >> 4 & 1 != 0 { Mask::Off } else { Mask::On };
            Instruction { mask: (half & 2 != 0).then_some(mask), cycles: 2, ..one }
        }
        2 => {
            let (to, from) = (bits(half, 0, 3), bits(half, 3, 3));
            let effect = match half >> 6 & 3 {
                2 => Effect::And(to, from, 0xFFFF),
                3 => Effect::And(to, from, 0xFF),
                _ => Effect::Other,
            };
            one.writing([to]).with(effect)
        }
        10 => one.writing([bits(half, 0, 3)]),
        14 => Instruction { flow: Flow::Stop, ..one },
        15 if half & 0xF != 0 => Instruction { it: half as u8, ..one },
        _ => one,
    }
}

fn branch(one: Instruction, half: u32) -> Instruction {
    match half >> 8 & 15 {
        14 => Instruction { flow: Flow::Stop, ..one },
        15 => one.writing([0, 1, 2, 3, 12]),
        condition => Instruction {
            flow: Flow::Jump(target(&one, signed(half & 0xFF, 8) << 1)),
            condition: Some(condition as u8),
            ..one
        },
    }
}

/// A load of several words with the stack pointer as its base moves that one by a known amount.
pub(super) fn moves_stack(one: Instruction, base: u8, amount: u32) -> Instruction {
    if base == SP { one.with(Effect::Add(SP, SP, amount)) } else { one }
}
