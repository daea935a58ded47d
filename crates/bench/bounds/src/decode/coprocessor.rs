//! Instructions of the FPU (A6): their cycles, their accesses, and what they write of the core's registers.
//!
//! A result that the next instruction needs is one cycle late (DDI 0439, table 7-1): it is always counted.

use super::{AddressingMode, FlagEffect, Instruction, RegisterEffect, RegisterNumber};

/// Fills in what the word says.
pub(super) fn decode(one: Instruction, all: u32) -> Instruction {
    let unit = all >> 8 & 15;
    if unit & 0b1110 != 0b1010 {
        return Instruction { cycles: 2, ..one };
    }
    let base = (all >> 16 & 15) as RegisterNumber;
    let to = (all >> 12 & 15) as RegisterNumber;
    match all >> 24 & 15 {
        // vmov of two registers of the core
        12 if all >> 21 & 0b111 == 0b010 => {
            let one = Instruction { cycles: 3, ..one };
            if all >> 20 & 1 != 0 { one.with_written_registers([to, base]) } else { one }
        }
        12 | 13 => decode_load_store(one, all, base),
        14 if all >> 4 & 1 == 0 => Instruction { cycles: 1 + arithmetic_cycles(all), ..one },
        // vmov, vmsr, vmrs
        14 => {
            let one = Instruction { cycles: 2, ..one };
            match (all >> 20 & 1 != 0, to) {
                (true, 15) => Instruction { flags: FlagEffect::Other, ..one },
                (true, _) => one.with_written_registers([to]),
                _ => one,
            }
        }
        _ => Instruction { cycles: 3, ..one },
    }
}

fn arithmetic_cycles(all: u32) -> u32 {
    let (high, low) = (all >> 23 & 1, all >> 20 & 3);
    match (high, low) {
        // vdiv
        (1, 0) => 14,
        // vmla, vmls, vnmla, vnmls; vfma and its kin
        (0, 0 | 1) | (1, 1 | 2) => 3,
        // vsqrt
        (1, 3) if all >> 16 & 15 == 1 && all >> 6 & 3 == 3 => 14,
        _ => 1,
    }
}

/// `vldr`, `vstr`, `vldm`, `vstm`, `vpush`, `vpop`: this many words.
fn decode_load_store(one: Instruction, all: u32, base: RegisterNumber) -> Instruction {
    let is_load = all >> 20 & 1 != 0;
    let writes_back = all >> 21 & 1 != 0;
    let is_single_access = all >> 24 & 1 != 0 && !writes_back;
    let is_up = all >> 23 & 1 != 0;
    let number = all & 0xFF;
    let (words, offset) = if is_single_access {
        (1 + (all >> 8 & 1), if is_up { 4 * number } else { (4 * number).wrapping_neg() })
    } else {
        (number, 0)
    };
    let address = if base == 15 {
        AddressingMode::Literal
    } else {
        AddressingMode::ImmediateOffset(base, offset)
    };
    let one = if is_load { one.with_load(words, address) } else { one.with_store(words, address) };
    if writes_back {
        let amount = if is_up { 4 * number } else { (4 * number).wrapping_neg() };
        one.with_written_registers([base])
            .with_register_effect(RegisterEffect::Add(base, base, amount))
    } else {
        one
    }
}
