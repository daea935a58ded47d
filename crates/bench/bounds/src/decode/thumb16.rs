//! Instructions of 16 bits (A5.2).

use super::{
    AddressingMode, ControlFlow, FlagEffect, Instruction, InterruptMaskChange, LR, Operand, PC,
    RegisterEffect, SP, registers_in_list, sign_extend,
};

/// Fills in what the half-word says.
pub(super) fn decode(one: Instruction, half: u32) -> Instruction {
    match half >> 12 {
        0..=3 => decode_arithmetic(one, half),
        4 if half >> 10 == 0b01_0000 => decode_data_processing(one, half),
        4 if half >> 10 == 0b01_0001 => decode_special_data(one, half),
        4 => {
            let to = extract_bit_field(half, 8, 3);
            let address = ((one.at + 4) & !3) + 4 * (half & 0xFF);
            one.with_load(1, AddressingMode::Literal)
                .with_written_registers([to])
                .with_register_effect(RegisterEffect::Literal(to, address))
        }
        5..=9 => decode_load_store_single(one, half),
        10 => {
            let (to, amount) = (extract_bit_field(half, 8, 3), 4 * (half & 0xFF));
            let effect = if half >> 11 & 1 == 0 {
                RegisterEffect::Set(to, ((one.at + 4) & !3) + amount)
            } else {
                RegisterEffect::Add(to, SP, amount)
            };
            one.with_written_registers([to]).with_register_effect(effect)
        }
        11 => decode_miscellaneous(one, half),
        12 => {
            let (base, list) = (extract_bit_field(half, 8, 3), half & 0xFF);
            let is_load = half >> 11 & 1 != 0;
            let address = AddressingMode::ImmediateOffset(base, 0);
            if is_load {
                one.with_load(list.count_ones(), address)
                    .with_written_registers(registers_in_list(list))
                    .with_written_registers([base])
            } else {
                one.with_store(list.count_ones(), address).with_written_registers([base])
            }
        }
        13 => decode_conditional_branch(one, half),
        _ => Instruction {
            flow: ControlFlow::Jump(branch_target(&one, sign_extend(half & 0x7FF, 11) << 1)),
            ..one
        },
    }
}

fn extract_bit_field(half: u32, from: u32, count: u32) -> u8 {
    (half >> from & ((1 << count) - 1)) as u8
}

fn branch_target(one: &Instruction, offset: u32) -> u32 {
    one.at.wrapping_add(4).wrapping_add(offset)
}

/// Within an IT block these set no flags.
fn with_flags_outside_it_block(one: Instruction, flags: FlagEffect) -> Instruction {
    if one.condition.is_some() { one } else { Instruction { flags, ..one } }
}

fn decode_arithmetic(one: Instruction, half: u32) -> Instruction {
    let (low, high) = (extract_bit_field(half, 0, 3), extract_bit_field(half, 3, 3));
    let (long_to, byte) = (extract_bit_field(half, 8, 3), half & 0xFF);
    let third = extract_bit_field(half, 6, 3);
    let small = u32::from(third);
    let shift = (half >> 6 & 31) as i8;
    match half >> 9 {
        0b1100 => with_flags_outside_it_block(
            one.with_written_registers([low])
                .with_register_effect(RegisterEffect::Sum(low, high, third)),
            FlagEffect::Sum(high, Operand::Register(third)),
        ),
        0b1101 => with_flags_outside_it_block(
            one.with_written_registers([low])
                .with_register_effect(RegisterEffect::Difference(low, high, third)),
            FlagEffect::Compare(high, Operand::Register(third)),
        ),
        0b1110 => with_flags_outside_it_block(
            one.with_written_registers([low])
                .with_register_effect(RegisterEffect::Add(low, high, small)),
            FlagEffect::Sum(high, Operand::Immediate(small)),
        ),
        0b1111 => with_flags_outside_it_block(
            one.with_written_registers([low]).with_register_effect(RegisterEffect::Add(
                low,
                high,
                small.wrapping_neg(),
            )),
            FlagEffect::Compare(high, Operand::Immediate(small)),
        ),
        _ => match half >> 11 {
            0 if shift == 0 => with_flags_outside_it_block(
                one.with_written_registers([low])
                    .with_register_effect(RegisterEffect::Copy(low, high)),
                FlagEffect::Result(low),
            ),
            0 => {
                let one = one
                    .with_written_registers([low])
                    .with_register_effect(RegisterEffect::Shift(low, high, shift));
                with_flags_outside_it_block(one, FlagEffect::Result(low))
            }
            1 if shift != 0 => {
                let one = one
                    .with_written_registers([low])
                    .with_register_effect(RegisterEffect::Shift(low, high, -shift));
                with_flags_outside_it_block(one, FlagEffect::Result(low))
            }
            1 | 2 => {
                with_flags_outside_it_block(one.with_written_registers([low]), FlagEffect::Other)
            }
            4 => with_flags_outside_it_block(
                one.with_written_registers([long_to])
                    .with_register_effect(RegisterEffect::Set(long_to, byte)),
                FlagEffect::Result(long_to),
            ),
            // cmp sets flags in an IT block as well.
            5 => {
                Instruction { flags: FlagEffect::Compare(long_to, Operand::Immediate(byte)), ..one }
            }
            6 => with_flags_outside_it_block(
                one.with_written_registers([long_to])
                    .with_register_effect(RegisterEffect::Add(long_to, long_to, byte)),
                FlagEffect::Sum(long_to, Operand::Immediate(byte)),
            ),
            _ => {
                with_flags_outside_it_block(
                    one.with_written_registers([long_to]).with_register_effect(
                        RegisterEffect::Add(long_to, long_to, byte.wrapping_neg()),
                    ),
                    FlagEffect::Compare(long_to, Operand::Immediate(byte)),
                )
            }
        },
    }
}

fn decode_data_processing(one: Instruction, half: u32) -> Instruction {
    let (to, from) = (extract_bit_field(half, 0, 3), extract_bit_field(half, 3, 3));
    match half >> 6 & 15 {
        // tst, cmn
        8 => Instruction { flags: FlagEffect::Other, ..one },
        11 => Instruction { flags: FlagEffect::Sum(to, Operand::Register(from)), ..one },
        10 => Instruction { flags: FlagEffect::Compare(to, Operand::Register(from)), ..one },
        9 => with_flags_outside_it_block(
            one.with_written_registers([to])
                .with_register_effect(RegisterEffect::ReverseSubtract(to, 0, from)),
            FlagEffect::Result(to),
        ),
        _ => with_flags_outside_it_block(one.with_written_registers([to]), FlagEffect::Other),
    }
}

/// On high registers, and branches by register.
fn decode_special_data(one: Instruction, half: u32) -> Instruction {
    let to = extract_bit_field(half, 0, 3) | extract_bit_field(half, 7, 1) << 3;
    let from = extract_bit_field(half, 3, 4);
    match half >> 8 & 3 {
        0 if to == PC => Instruction { flow: ControlFlow::JumpRegister(PC), ..one },
        0 => {
            one.with_written_registers([to]).with_register_effect(RegisterEffect::Sum(to, to, from))
        }
        1 => Instruction { flags: FlagEffect::Compare(to, Operand::Register(from)), ..one },
        2 if to == PC && from == LR => Instruction { flow: ControlFlow::Return, ..one },
        2 if to == PC => Instruction { flow: ControlFlow::JumpRegister(from), ..one },
        2 => one.with_written_registers([to]).with_register_effect(RegisterEffect::Copy(to, from)),
        _ if half >> 7 & 1 != 0 => Instruction { flow: ControlFlow::CallRegister(from), ..one },
        _ if from == LR => Instruction { flow: ControlFlow::Return, ..one },
        _ => Instruction { flow: ControlFlow::JumpRegister(from), ..one },
    }
}

fn decode_load_store_single(one: Instruction, half: u32) -> Instruction {
    let (to, base) = (extract_bit_field(half, 0, 3), extract_bit_field(half, 3, 3));
    let by_register = AddressingMode::RegisterOffset(base, extract_bit_field(half, 6, 3));
    let small = half >> 6 & 31;
    let (is_load, to, address) = match half >> 11 {
        // str, strh, strb; ldrsb, ldr, ldrh, ldrb, ldrsh
        0b01010 | 0b01011 => (half >> 9 & 7 > 2, to, by_register),
        0b01100 => (false, to, AddressingMode::ImmediateOffset(base, 4 * small)),
        0b01101 => (true, to, AddressingMode::ImmediateOffset(base, 4 * small)),
        0b01110 => (false, to, AddressingMode::ImmediateOffset(base, small)),
        0b01111 => (true, to, AddressingMode::ImmediateOffset(base, small)),
        0b10000 => (false, to, AddressingMode::ImmediateOffset(base, 2 * small)),
        0b10001 => (true, to, AddressingMode::ImmediateOffset(base, 2 * small)),
        0b10010 => (
            false,
            extract_bit_field(half, 8, 3),
            AddressingMode::ImmediateOffset(SP, 4 * (half & 0xFF)),
        ),
        _ => (
            true,
            extract_bit_field(half, 8, 3),
            AddressingMode::ImmediateOffset(SP, 4 * (half & 0xFF)),
        ),
    };
    if is_load {
        one.with_load(1, address).with_written_registers([to])
    } else {
        one.with_store(1, address)
    }
}

fn decode_miscellaneous(one: Instruction, half: u32) -> Instruction {
    match half >> 8 & 15 {
        0 => {
            let amount = 4 * (half & 0x7F);
            let amount = if half >> 7 & 1 == 0 { amount } else { amount.wrapping_neg() };
            one.with_written_registers([SP])
                .with_register_effect(RegisterEffect::Add(SP, SP, amount))
        }
        1 | 3 | 9 | 11 => {
            let offset = (half >> 9 & 1) << 6 | (half >> 3 & 31) << 1;
            let (register, if_zero) = (extract_bit_field(half, 0, 3), half >> 11 & 1 == 0);
            let flow = ControlFlow::CompareAndBranch {
                register,
                target: branch_target(&one, offset),
                if_zero,
            };
            Instruction { flow, ..one }
        }
        4 | 5 => {
            let list = half & 0xFF | (half >> 8 & 1) << 14;
            let count = list.count_ones();
            let down = RegisterEffect::Add(SP, SP, (4 * count).wrapping_neg());
            one.with_store(count, AddressingMode::ImmediateOffset(SP, 0))
                .with_written_registers([SP])
                .with_register_effect(down)
        }
        12 | 13 => {
            let list = half & 0xFF;
            let returns = half >> 8 & 1;
            let count = list.count_ones() + returns;
            let up = RegisterEffect::Add(SP, SP, 4 * count);
            let one = one
                .with_load(count, AddressingMode::ImmediateOffset(SP, 0))
                .with_written_registers(registers_in_list(list))
                .with_written_registers([SP]);
            let flow = if returns == 1 { ControlFlow::Return } else { ControlFlow::Next };
            Instruction { flow, ..one.with_register_effect(up) }
        }
        // cps: of the two masks only PRIMASK.
        6 if half & 0xFFE0 == 0xB660 => {
            let mask = if half >> 4 & 1 != 0 {
                InterruptMaskChange::Disable
            } else {
                InterruptMaskChange::Enable
            };
            Instruction { mask: (half & 2 != 0).then_some(mask), cycles: 2, ..one }
        }
        2 => {
            let (to, from) = (extract_bit_field(half, 0, 3), extract_bit_field(half, 3, 3));
            let effect = match half >> 6 & 3 {
                2 => RegisterEffect::And(to, from, 0xFFFF),
                3 => RegisterEffect::And(to, from, 0xFF),
                _ => RegisterEffect::Other,
            };
            one.with_written_registers([to]).with_register_effect(effect)
        }
        10 => one.with_written_registers([extract_bit_field(half, 0, 3)]),
        14 => Instruction { flow: ControlFlow::Trap, ..one },
        15 if half & 0xF != 0 => Instruction { it: half as u8, ..one },
        _ => one,
    }
}

fn decode_conditional_branch(one: Instruction, half: u32) -> Instruction {
    match half >> 8 & 15 {
        14 => Instruction { flow: ControlFlow::Trap, ..one },
        15 => one.with_written_registers([0, 1, 2, 3, 12]),
        condition => Instruction {
            flow: ControlFlow::Jump(branch_target(&one, sign_extend(half & 0xFF, 8) << 1)),
            condition: Some(condition as u8),
            ..one
        },
    }
}

/// A load of several words with the stack pointer as its base moves that one by a known amount.
pub(super) fn with_stack_pointer_effect(one: Instruction, base: u8, amount: u32) -> Instruction {
    if base == SP { one.with_register_effect(RegisterEffect::Add(SP, SP, amount)) } else { one }
}
