//! Instructions of 32 bits (A5.3).

use super::{
    AddressingMode, ControlFlow, FlagEffect, Instruction, InterruptMaskChange, Operand, PC,
    RegisterEffect, RegisterNumber, SP, coprocessor, registers_in_list, sign_extend, thumb16,
};

/// Fills in what the two half-words say.
pub(super) fn decode(one: Instruction, first: u32, second: u32) -> Instruction {
    let all = first << 16 | second;
    match first >> 9 & 0b1111 {
        // 1110 100
        0b0100 if first >> 6 & 1 == 0 => decode_load_store_multiple(one, first, second),
        0b0100 => decode_load_store_dual(one, first, second),
        0b0101 => decode_shifted_register(one, first, second),
        0b1000..=0b1011 if second >> 15 == 0 => decode_modified_immediate(one, first, second),
        0b1000..=0b1011 => decode_branch_and_control(one, first, second),
        0b1100 => decode_load_store_single(one, first, second),
        0b1101 => decode_data_processing_register(one, first, second),
        _ => coprocessor::decode(one, all),
    }
}

fn extract_register(half: u32, from: u32) -> RegisterNumber {
    (half >> from & 15) as u8
}

/// `ldm`, `stm`, `push`, `pop`.
fn decode_load_store_multiple(one: Instruction, first: u32, second: u32) -> Instruction {
    let (base, count) = (extract_register(first, 0), second.count_ones());
    let writes_back = first >> 5 & 1 != 0;
    let is_load = first >> 4 & 1 != 0;
    let amount = if first >> 7 & 3 == 1 { 4 * count } else { (4 * count).wrapping_neg() };
    let one = if is_load {
        one.with_load(count, AddressingMode::ImmediateOffset(base, 0))
            .with_written_registers(registers_in_list(second & 0x7FFF))
    } else {
        one.with_store(count, AddressingMode::ImmediateOffset(base, 0))
    };
    let one = if writes_back {
        thumb16::with_stack_pointer_effect(one.with_written_registers([base]), base, amount)
    } else {
        one
    };
    match (is_load && second >> 15 != 0, base) {
        (true, SP) => Instruction { flow: ControlFlow::Return, ..one },
        (true, _) => Instruction { flow: ControlFlow::JumpRegister(PC), ..one },
        _ => one,
    }
}

/// `ldrd`, `strd`, exclusive ones, jumps by table.
fn decode_load_store_dual(one: Instruction, first: u32, second: u32) -> Instruction {
    let (base, to, other) =
        (extract_register(first, 0), extract_register(second, 12), extract_register(second, 8));
    let is_load = first >> 4 & 1 != 0;
    let offset = 4 * (second & 0xFF);
    let (indexed, writes_back) = (first >> 8 & 1 != 0, first >> 5 & 1 != 0);
    if !indexed && !writes_back {
        // Exclusive, or a table.
        if first >> 4 & 15 == 0b1101 && second >> 5 & 7 == 0 {
            let size = if second >> 4 & 1 == 0 { 1 } else { 2 };
            return Instruction { flow: ControlFlow::TableBranch { size }, cycles: 2, ..one };
        }
        return if is_load {
            one.with_load(1, AddressingMode::ImmediateOffset(base, 0)).with_written_registers([to])
        } else {
            let status = if first >> 7 & 1 != 0 { extract_register(second, 0) } else { other };
            one.with_store(1, AddressingMode::ImmediateOffset(base, 0))
                .with_written_registers([status])
        };
    }
    let signed_offset = if first >> 7 & 1 != 0 { offset } else { offset.wrapping_neg() };
    let address = AddressingMode::ImmediateOffset(base, if indexed { signed_offset } else { 0 });
    let one = if base == PC {
        one.with_load(2, AddressingMode::Literal).with_written_registers([to, other])
    } else if is_load {
        one.with_load(2, address).with_written_registers([to, other])
    } else {
        one.with_store(2, address)
    };
    if writes_back {
        one.with_written_registers([base]).with_register_effect(RegisterEffect::Add(
            base,
            base,
            signed_offset,
        ))
    } else {
        one
    }
}

/// Arithmetic with a second register that may be shifted.
fn decode_shifted_register(one: Instruction, first: u32, second: u32) -> Instruction {
    let (from, to, other) =
        (extract_register(first, 0), extract_register(second, 8), extract_register(second, 0));
    let amount = (second >> 12 & 7) << 2 | second >> 6 & 3;
    let kind = second >> 4 & 3;
    let is_plain = amount == 0 && kind == 0;
    let sets = first >> 4 & 1 != 0;
    let by = if is_plain { Some(Operand::Register(other)) } else { None };
    let (effect, flags) = match first >> 5 & 15 {
        2 if from == PC => (shifted_copy(to, other, kind, amount), FlagEffect::Other),
        8 => (
            if is_plain { RegisterEffect::Sum(to, from, other) } else { RegisterEffect::Other },
            by.map_or(FlagEffect::Other, |by| FlagEffect::Sum(from, by)),
        ),
        13 => (
            if is_plain {
                RegisterEffect::Difference(to, from, other)
            } else {
                RegisterEffect::Other
            },
            by.map_or(FlagEffect::Other, |by| FlagEffect::Compare(from, by)),
        ),
        _ => (RegisterEffect::Other, FlagEffect::Other),
    };
    with_result(one, to, sets, effect, flags)
}

fn shifted_copy(
    to: RegisterNumber,
    from: RegisterNumber,
    kind: u32,
    amount: u32,
) -> RegisterEffect {
    match (kind, amount) {
        (0, 0) => RegisterEffect::Copy(to, from),
        (0, _) => RegisterEffect::Shift(to, from, amount as i8),
        (1, 1..) => RegisterEffect::Shift(to, from, -(amount as i8)),
        _ => RegisterEffect::Other,
    }
}

/// A result that is not kept is a comparison.
fn with_result(
    one: Instruction,
    to: RegisterNumber,
    sets: bool,
    effect: RegisterEffect,
    flags: FlagEffect,
) -> Instruction {
    let one = Instruction { flags: if sets { flags } else { FlagEffect::Unchanged }, ..one };
    if to == PC && sets {
        one
    } else {
        one.with_written_registers([to]).with_register_effect(effect)
    }
}

/// ThumbExpandImm (A5.3.2).
fn thumb_expand_imm(bits: u32) -> u32 {
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
fn decode_modified_immediate(one: Instruction, first: u32, second: u32) -> Instruction {
    let bits = (first >> 10 & 1) << 11 | (second >> 12 & 7) << 8 | second & 0xFF;
    let (from, to) = (extract_register(first, 0), extract_register(second, 8));
    if first >> 9 & 1 != 0 {
        return decode_plain_binary_immediate(one, first, second, bits);
    }
    let number = thumb_expand_imm(bits);
    let sets = first >> 4 & 1 != 0;
    let by = Operand::Immediate(number);
    let (effect, flags) = match first >> 5 & 15 {
        0 if to == PC => (RegisterEffect::Other, FlagEffect::Test(from, number)),
        0 => (RegisterEffect::And(to, from, number), FlagEffect::Result(to)),
        1 => (RegisterEffect::And(to, from, !number), FlagEffect::Result(to)),
        14 => (RegisterEffect::ReverseSubtract(to, number, from), FlagEffect::Result(to)),
        2 if from == PC => (RegisterEffect::Set(to, number), FlagEffect::Other),
        3 if from == PC => (RegisterEffect::Set(to, !number), FlagEffect::Other),
        8 => (RegisterEffect::Add(to, from, number), FlagEffect::Sum(from, by)),
        13 => (RegisterEffect::Add(to, from, number.wrapping_neg()), FlagEffect::Compare(from, by)),
        _ => (RegisterEffect::Other, FlagEffect::Other),
    };
    with_result(one, to, sets, effect, flags)
}

/// With a plain number of 12 or 16 bits, and bit fields.
fn decode_plain_binary_immediate(
    one: Instruction,
    first: u32,
    second: u32,
    bits: u32,
) -> Instruction {
    let (from, to) = (extract_register(first, 0), extract_register(second, 8));
    let half = (first & 15) << 12 | bits;
    let effect = match first >> 4 & 31 {
        0 if from == PC => RegisterEffect::Set(to, ((one.at + 4) & !3) + bits),
        0 => RegisterEffect::Add(to, from, bits),
        4 => RegisterEffect::Set(to, half),
        10 if from == PC => RegisterEffect::Set(to, ((one.at + 4) & !3).wrapping_sub(bits)),
        10 => RegisterEffect::Add(to, from, bits.wrapping_neg()),
        12 => RegisterEffect::SetUpperHalf(to, half),
        _ => RegisterEffect::Other,
    };
    one.with_written_registers([to]).with_register_effect(effect)
}

/// Branches and control (A5.3.4).
fn decode_branch_and_control(one: Instruction, first: u32, second: u32) -> Instruction {
    let bit = |word: u32, number: u32| (word >> number) & 1;
    let (sign, j1, j2) = (bit(first, 10), bit(second, 13), bit(second, 11));
    let low = (second & 0x7FF) << 1;
    let far = || {
        let (i1, i2) = (1 ^ j1 ^ sign, 1 ^ j2 ^ sign);
        let offset = sign << 24 | i1 << 23 | i2 << 22 | (first & 0x3FF) << 12 | low;
        one.at.wrapping_add(4).wrapping_add(sign_extend(offset, 25))
    };
    match (bit(second, 14), bit(second, 12)) {
        (1, 1) => Instruction { flow: ControlFlow::Call(far()), writes: 1 << 14, ..one },
        (0, 1) => Instruction { flow: ControlFlow::Jump(far()), ..one },
        (0, _) if first >> 7 & 7 != 7 => {
            let near = sign << 20 | j2 << 19 | j1 << 18 | (first & 0x3F) << 12 | low;
            let target = one.at.wrapping_add(4).wrapping_add(sign_extend(near, 21));
            let condition = Some((first >> 6 & 15) as u8);
            Instruction { flow: ControlFlow::Jump(target), condition, ..one }
        }
        _ => decode_system(one, first, second),
    }
}

fn decode_system(one: Instruction, first: u32, second: u32) -> Instruction {
    let one = Instruction { cycles: 2, ..one };
    match first >> 4 & 0x7F {
        // msr
        0x38 | 0x39 => {
            let mask = match second & 0xFF {
                16 => Some(InterruptMaskChange::Enable),
                17 => Some(InterruptMaskChange::Restore),
                18 => Some(InterruptMaskChange::Raise(extract_register(first, 0))),
                _ => None,
            };
            let flags = if second & 0xFF < 4 { FlagEffect::Other } else { FlagEffect::Unchanged };
            Instruction { mask, flags, ..one }
        }
        // mrs
        0x3E | 0x3F => one.with_written_registers([extract_register(second, 8)]),
        // dsb, dmb, isb: at most the store that is on its way, to the slower bus.
        0x3B => Instruction { cycles: 16, ..one },
        0x7F => Instruction { flow: ControlFlow::Trap, ..one },
        _ => one,
    }
}

/// A load or store of one register (A5.3.7 to A5.3.10).
fn decode_load_store_single(one: Instruction, first: u32, second: u32) -> Instruction {
    let (base, to) = (extract_register(first, 0), extract_register(second, 12));
    let is_load = first >> 4 & 1 != 0;
    if base == PC && is_load {
        let offset = second & 0xFFF;
        let from = (one.at + 4) & !3;
        let address = if first >> 7 & 1 != 0 { from + offset } else { from.wrapping_sub(offset) };
        let one = one.with_load(1, AddressingMode::Literal);
        return if to == PC {
            Instruction { flow: ControlFlow::JumpRegister(PC), ..one }
        } else if first >> 5 & 3 == 2 {
            one.with_written_registers([to])
                .with_register_effect(RegisterEffect::Literal(to, address))
        } else {
            one.with_written_registers([to])
        };
    }
    let small = second & 0xFF;
    let (address, back) = if first >> 7 & 1 != 0 {
        (AddressingMode::ImmediateOffset(base, second & 0xFFF), None)
    } else if second >> 11 & 1 == 0 {
        (AddressingMode::RegisterOffset(base, extract_register(second, 0)), None)
    } else {
        let amount = if second >> 9 & 1 != 0 { small } else { small.wrapping_neg() };
        let indexed = second >> 10 & 1 != 0;
        let back = (second >> 8 & 1 != 0).then_some(amount);
        (AddressingMode::ImmediateOffset(base, if indexed { amount } else { 0 }), back)
    };
    let one = match is_load {
        // A hint to read ahead, `pld`.
        true if to == PC && first >> 5 & 3 != 2 => return one,
        true if to == PC => {
            let flow = if base == SP { ControlFlow::Return } else { ControlFlow::JumpRegister(PC) };
            Instruction { flow, ..one.with_load(1, address) }
        }
        true => one.with_load(1, address).with_written_registers([to]),
        false => one.with_store(1, address),
    };
    match back {
        Some(amount) => one
            .with_written_registers([base])
            .with_register_effect(RegisterEffect::Add(base, base, amount)),
        None => one,
    }
}

/// Shifts by register, extensions, products, quotients (A5.3.12 to A5.3.17).
fn decode_data_processing_register(one: Instruction, first: u32, second: u32) -> Instruction {
    let to = extract_register(second, 8);
    if first >> 8 & 1 == 0 {
        let sets = first >> 7 & 1 == 0 && first >> 4 & 1 != 0 && second >> 7 & 1 == 0;
        let flags = if sets { FlagEffect::Other } else { FlagEffect::Unchanged };
        let is_extension = second >> 7 & 1 != 0 && first & 0x8F == 0x0F;
        let from = extract_register(second, 0);
        let is_straight = second >> 4 & 3 == 0;
        let effect = match first >> 4 & 7 {
            1 if is_extension && is_straight => RegisterEffect::And(to, from, 0xFFFF),
            5 if is_extension && is_straight => RegisterEffect::And(to, from, 0xFF),
            _ => RegisterEffect::Other,
        };
        return Instruction {
            flags,
            ..one.with_written_registers([to]).with_register_effect(effect)
        };
    }
    if first >> 7 & 1 == 0 {
        // mla and mls take two.
        return Instruction { cycles: 2, ..one.with_written_registers([to]) };
    }
    match first >> 4 & 7 {
        // sdiv, udiv
        1 | 3 => Instruction { cycles: 12, ..one.with_written_registers([to]) },
        _ => Instruction {
            cycles: 1,
            ..one.with_written_registers([to, extract_register(second, 12)])
        },
    }
}
