//! The stack that a function of an image takes, and the addresses of functions that it holds: read from its
//! instructions (Armv7-M architecture manual, A7.7).
//!
//! Every instruction that moves the stack pointer down counts, wherever in the function it stands: one that has
//! two ways in counts both, so the sum is never too small.

/// Stack and pointers of a function, as its instructions say.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct StackFrame {
    /// Bytes of the stack.
    pub bytes: u64,
    /// It moves the stack pointer by what a register says: how far is not known.
    pub is_open: bool,
    /// The odd words that it holds, in its constants or in two halves: addresses of functions are among them.
    pub pointers: Vec<u64>,
}

/// Returns the frame of a function whose bytes begin at `start`.
pub(crate) fn analyse_stack_frame(
    code: &[u8],
    start: u64,
    is_data: impl Fn(u64) -> bool,
) -> StackFrame {
    let mut frame = StackFrame::default();
    let halves: Vec<u16> =
        code.chunks_exact(2).map(|two| u16::from_le_bytes([two[0], two[1]])).collect();
    let mut low_halves = [0; 16];
    let mut number = 0;
    while let Some(&first) = halves.get(number) {
        let at = start + 2 * number as u64;
        number += 1;
        let second = u32::from(halves.get(number).copied().unwrap_or_default());
        let first = u32::from(first);
        if is_data(at) {
            let word = second << 16 | first;
            if at.is_multiple_of(4) && word & 1 == 1 {
                frame.pointers.push(word.into());
            }
        } else if first >> 11 >= 0b11101 {
            number += 1;
            frame.bytes += wide_stack_adjustment(first, second);
            // sub.w sp, sp, register.
            frame.is_open |= first == 0xEBAD && second >> 8 & 15 == 13;
            if let Some((register, half, is_high)) = decode_movw_movt(first, second) {
                let low = &mut low_halves[register];
                if is_high && *low & 1 == 1 {
                    frame.pointers.push((half << 16 | *low).into());
                } else if !is_high {
                    *low = half;
                }
            }
        } else if first >> 9 == 0b101_1010 {
            // push, and the link register with it.
            frame.bytes += 4 * u64::from((first & 0x1FF).count_ones());
        } else if first >> 7 == 0b1_0110_0001 {
            // sub sp, #…
            frame.bytes += 4 * u64::from(first & 0x7F);
        }
    }
    frame
}

/// Returns how far an instruction of 32 bits moves the stack pointer down.
fn wide_stack_adjustment(first: u32, second: u32) -> u64 {
    let to_sp = second >> 8 & 15 == 13;
    match first {
        // push.w
        0xE92D => 4 * u64::from(second.count_ones()),
        // vpush: this many words, singles or doubles.
        _ if first & 0xFFBF == 0xED2D && second >> 9 & 7 == 5 => 4 * u64::from(second & 0xFF),
        // str r, [sp, #-n]!
        0xF84D if second >> 8 & 15 == 0b1101 => (second & 0xFF).into(),
        // strd r, r, [sp, #-n]!
        0xE96D => 4 * u64::from(second & 0xFF),
        // sub.w sp, sp, #…
        _ if first & 0xFBFF == 0xF1AD && to_sp => {
            expand_thumb_immediate(decode_imm12(first, second)).into()
        }
        // subw sp, sp, #…
        _ if first & 0xFBFF == 0xF2AD && to_sp => decode_imm12(first, second).into(),
        _ => 0,
    }
}

/// Returns the 12 bits i:imm3:imm8.
fn decode_imm12(first: u32, second: u32) -> u32 {
    (first >> 10 & 1) << 11 | (second >> 12 & 7) << 8 | second & 0xFF
}

/// ThumbExpandImm (A5.3.2).
fn expand_thumb_immediate(bits: u32) -> u32 {
    let byte = bits & 0xFF;
    match bits >> 8 {
        0 => byte,
        1 => byte << 16 | byte,
        2 => byte << 24 | byte << 8,
        3 => byte * 0x0101_0101,
        _ => (0x80 | bits & 0x7F).rotate_right(bits >> 7),
    }
}

/// `movw` or `movt`: register, 16 bits, and whether they are the upper ones.
fn decode_movw_movt(first: u32, second: u32) -> Option<(usize, u32, bool)> {
    let is_high = match first & 0xFBF0 {
        0xF240 => false,
        0xF2C0 => true,
        _ => return None,
    };
    let register = (second >> 8 & 15) as usize;
    (second >> 15 == 0).then_some((
        register,
        (first & 15) << 12 | decode_imm12(first, second),
        is_high,
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(halves: &[u16]) -> StackFrame {
        let bytes: Vec<u8> = halves.iter().flat_map(|half| half.to_le_bytes()).collect();
        analyse_stack_frame(&bytes, 0x0800_0000, |_| false)
    }

    #[test]
    fn frames_are_what_the_disassembler_says() {
        // push {r4, r5, r6, r7, lr}; push.w {r8, r9, r11}; vpush {d8-d9}; sub sp, #24.
        assert_eq!(of(&[0xB5F0, 0xE92D, 0x0B00, 0xED2D, 0x8B04, 0xB086]).bytes, 20 + 12 + 16 + 24);
        // sub.w sp, sp, #4096; subw sp, sp, #1028; str.w r11, [sp, #-4]!; strd r0, r1, [sp, #-8]!.
        assert_eq!(of(&[0xF5AD, 0x5D80, 0xF2AD, 0x4D04]).bytes, 4096 + 1028);
        assert_eq!(of(&[0xF84D, 0xBD04, 0xE96D, 0x0102]).bytes, 4 + 8);
        // add sp, #24; pop.w; sub.w r0, sp, #8; str r0, [sp, #4] take nothing.
        assert_eq!(of(&[0xB006, 0xE8BD, 0x0B00, 0xF1AD, 0x0008, 0x9001]).bytes, 0);
        assert!(of(&[0xEBAD, 0x0D04]).is_open, "sub.w sp, sp, r4");
    }

    #[test]
    fn an_address_in_two_halves_or_in_a_constant_is_seen() {
        // movw r3, #0x1235; movt r3, #0x0801.
        assert_eq!(of(&[0xF241, 0x2335, 0xF6C0, 0x0301]).pointers, [0x0801_1235]);
        let constant = analyse_stack_frame(&0x0800_4321_u32.to_le_bytes(), 0x0800_0000, |_| true);
        assert_eq!(constant.pointers, [0x0800_4321]);
    }
}
