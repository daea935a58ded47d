//! A bare program for a Cortex-M4F: drawn instructions, the registers stored after every sixteen, and all that
//! was stored sent by USART1. Encodings are those of the ARMv7-M Architecture Reference Manual, chapter A7.

/// Where the registers are stored, what it is done on, and how much of both is sent.
const SCRATCH: u32 = 0x2000_1000;
const STORED: u32 = 0x2000_1100;
/// A checkpoint: r0–r7, the flags, FPSCR, s0–s15.
pub const CHECKPOINT: usize = 4 * (8 + 2 + 16);
/// Bytes that come before the checkpoints.
pub const SCRATCH_BYTES: usize = 256;
/// Instructions between two checkpoints.
const GROUP: usize = 16;

/// SplitMix64.
pub struct Draw(pub u64);

impl Draw {
    fn next(&mut self) -> u32 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ z >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        (z ^ z >> 31) as u32
    }

    fn below(&mut self, end: u32) -> u32 {
        self.next() % end
    }

    fn of<T: Copy>(&mut self, all: &[T]) -> T {
        all[self.below(all.len() as u32) as usize]
    }

    /// Returns a number at whose ends things happen more often than elsewhere.
    fn number(&mut self) -> u32 {
        match self.below(4) {
            0 => self.of(&[0, 1, 0x7fff_ffff, 0x8000_0000, 0xffff_ffff, 0x8000, 0xffff_8000]),
            1 => self.below(256),
            _ => self.next(),
        }
    }
}

/// The program as half-words.
struct Code(Vec<u16>);

impl Code {
    fn short(&mut self, half: u32) {
        self.0.push(half as u16);
    }

    fn long(&mut self, first: u32, second: u32) {
        self.short(first);
        self.short(second);
    }

    /// MOVW and MOVT.
    fn load(&mut self, register: u32, value: u32) {
        for (first, half) in [(0xf240, value & 0xffff), (0xf2c0, value >> 16)] {
            let (imm4, i, imm3) = (half >> 12, half >> 11 & 1, half >> 8 & 7);
            self.long(first | i << 10 | imm4, imm3 << 12 | register << 8 | half & 0xff);
        }
    }

    fn store_at(&mut self, address: u32, value: u32) {
        self.load(0, address);
        self.load(1, value);
        self.short(0x6001);
    }
}

/// Returns the ELF file of a program of this many groups.
pub fn image(seed: u64, groups: usize) -> Vec<u8> {
    let mut draw = Draw(seed);
    let mut code = Code(Vec::new());
    set_up(&mut code);
    for register in 0..16 {
        code.load(0, draw.number());
        // VMOV of a core register into s0 to s15.
        code.long(0xee00 | register >> 1, 0x0a10 | (register & 1) << 7);
    }
    code.load(8, SCRATCH);
    for word in 0..SCRATCH_BYTES as u32 / 4 {
        code.load(0, draw.number());
        code.long(0xf8c8, 4 * word);
    }
    code.load(9, STORED);
    for group in 0..groups {
        if group % 8 == 0 {
            (0..8).for_each(|register| code.load(register, draw.number()));
        }
        (0..GROUP).for_each(|_| instruction(&mut code, &mut draw));
        checkpoint(&mut code);
    }
    send(&mut code, SCRATCH, STORED + (CHECKPOINT * groups) as u32);
    elf(&code.0)
}

/// USART1 on PA9 with 16 MHz, and the floating-point unit.
fn set_up(code: &mut Code) {
    for (address, value) in [
        (0x4002_3830, 0x0010_0001),
        (0x4002_3844, 1 << 4),
        (0x4002_0024, 0x770),
        (0x4002_0000, 0xa800_0000 | 2 << 18 | 2 << 20),
        (0x4001_1008, 17),
        (0x4001_100c, 1 << 13 | 1 << 3),
        (0xe000_ed88, 0xf << 20),
    ] {
        code.store_at(address, value);
    }
    // DSB, ISB.
    code.long(0xf3bf, 0x8f4f);
    code.long(0xf3bf, 0x8f6f);
    // VMSR FPSCR, r0 with DN: every NaN is the default one. Without it VSUB of a NaN has another sign in
    // this processor's crate than the manual's FPSub, which nothing in the firmware depends on.
    code.load(0, 1 << 25);
    code.long(0xeee1, 0x0a10);
    // MSR APSR_nzcvqg, r0: after a reset the flags are not known (B1.4.2).
    code.load(0, 0);
    code.long(0xf380, 0x8c00);
}

/// r9 goes on by a checkpoint.
fn checkpoint(code: &mut Code) {
    // MRS r10, APSR; VMRS r11, FPSCR; STMIA r9!, {r0-r7, r10, r11}; VSTMIA r9!, {s0-s15}.
    code.long(0xf3ef, 0x8a00);
    code.long(0xeef1, 0xba10);
    code.long(0xe8a9, 0x0cff);
    code.long(0xeca9, 0x0a10);
    // MSR APSR_nzcvqg, r10: STM has no flags, but what is compared is what goes on.
    code.long(0xf38a, 0x8c00);
}

/// All bytes from `at` to `end` by USART1, then nothing more.
fn send(code: &mut Code, at: u32, end: u32) {
    code.load(0, at);
    code.load(1, end);
    code.load(2, 0x4001_1000);
    code.long(0xf810, 0x3b01); // LDRB r3, [r0], #1
    code.short(0x6814); // LDR r4, [r2]: SR
    code.short(0x0624); // LSLS r4, r4, #24: TXE is the sign
    code.short(0xd5fc); // BPL: wait
    code.short(0x6053); // STR r3, [r2, #4]
    code.short(0x4288); // CMP r0, r1
    code.short(0xd1f7); // BNE: the next
    code.short(0xe7fe); // B to itself
}

/// One drawn instruction on r0 to r7, s0 to s15 and the scratch memory.
fn instruction(code: &mut Code, draw: &mut Draw) {
    let (d, n, m, a) = (draw.below(8), draw.below(8), draw.below(8), draw.below(8));
    match draw.below(16) {
        // Data processing, 16 bits, flags set.
        0 => code.short(0x4000 | draw.below(16) << 6 | m << 3 | d),
        1 | 2 => {
            let (op, s) = (draw.of(&OPERATIONS), draw.below(2));
            let (shift, kind) = (draw.below(32), draw.below(4));
            let (imm3, imm2) = (shift >> 2, shift & 3);
            code.long(
                0xea00 | op << 5 | s << 4 | n,
                imm3 << 12 | d << 8 | imm2 << 6 | kind << 4 | m,
            );
        }
        3 => {
            let (op, s, i, imm3) =
                (draw.of(&OPERATIONS), draw.below(2), draw.below(2), draw.below(8));
            let imm8 = 1 + draw.below(255);
            code.long(0xf000 | i << 10 | op << 5 | s << 4 | n, imm3 << 12 | d << 8 | imm8);
        }
        // TST, TEQ, CMN, CMP.
        4 => code.long(0xea10 | draw.of(&[0, 4, 8, 13]) << 5 | n, 0xf00 | m),
        // Shifts by a register.
        5 => code.long(0xfa00 | draw.below(4) << 5 | draw.below(2) << 4 | n, 0xf000 | d << 8 | m),
        // Extensions with an addition.
        6 => {
            let (op, rotation) = (draw.below(6), draw.below(4));
            code.long(0xfa00 | op << 4 | n, 0xf080 | d << 8 | rotation << 4 | m);
        }
        // Parallel additions and subtractions.
        7 => {
            let (op1, op2) = (draw.of(&[0, 1, 2, 4, 5, 6]), draw.of(&[0, 1, 2, 4, 5, 6]));
            code.long(0xfa80 | op1 << 4 | n, 0xf000 | d << 8 | op2 << 4 | m);
        }
        8 => match draw.below(4) {
            // QADD, QDADD, QSUB, QDSUB.
            0 => code.long(0xfa80 | n, 0xf080 | d << 8 | draw.below(4) << 4 | m),
            // REV, REV16, RBIT, REVSH.
            1 => code.long(0xfa90 | m, 0xf080 | d << 8 | draw.below(4) << 4 | m),
            2 => code.long(0xfaa0 | n, 0xf080 | d << 8 | m), // SEL
            _ => code.long(0xfab0 | m, 0xf080 | d << 8 | m), // CLZ
        },
        9 => {
            let (op, op2, has_a) = draw.of(&MULTIPLICATIONS);
            let a = if has_a { a } else { 15 };
            code.long(0xfb00 | op << 4 | n, a << 12 | d << 8 | op2 << 4 | m);
        }
        10 => {
            let (op, op2) = draw.of(&LONG_MULTIPLICATIONS);
            let high = (d + 1 + a % 7) % 8;
            let low = if op2 == 15 { 15 } else { d };
            code.long(0xfb80 | op << 4 | n, low << 12 | high << 8 | op2 << 4 | m);
        }
        11 => bits(code, draw, d, n),
        12 => memory(code, draw, d),
        13 => conditional(code, draw),
        _ => floating(code, draw),
    }
}

/// AND, BIC, ORR, ORN, EOR, ADD, ADC, SBC, SUB, RSB.
const OPERATIONS: [u32; 10] = [0, 1, 2, 3, 4, 8, 10, 11, 13, 14];

/// MLA, MUL, MLS, SMLAxy, SMULxy, SMLAD, SMUAD, SMLAWy, SMLSD, SMMLA, SMMUL, SMMLS, USADA8, USAD8.
const MULTIPLICATIONS: [(u32, u32, bool); 20] = [
    (0, 0, true),
    (0, 0, false),
    (0, 1, true),
    (1, 0, true),
    (1, 1, true),
    (1, 2, false),
    (1, 3, false),
    (2, 0, true),
    (2, 1, true),
    (2, 0, false),
    (3, 0, true),
    (3, 1, false),
    (4, 0, true),
    (4, 1, false),
    (5, 0, true),
    (5, 1, true),
    (5, 0, false),
    (6, 1, true),
    (7, 0, true),
    (7, 0, false),
];

/// SMULL, SDIV, UMULL, UDIV, SMLAL, SMLALxy, SMLALD, SMLSLD, UMLAL, UMAAL.
const LONG_MULTIPLICATIONS: [(u32, u32); 14] = [
    (0, 0),
    (1, 15),
    (2, 0),
    (3, 15),
    (4, 0),
    (4, 8),
    (4, 9),
    (4, 10),
    (4, 11),
    (4, 12),
    (4, 13),
    (5, 12),
    (6, 0),
    (6, 6),
];

/// SBFX, UBFX, BFI, BFC, SSAT, USAT.
fn bits(code: &mut Code, draw: &mut Draw, d: u32, n: u32) {
    let low = draw.below(32);
    let width = draw.below(32 - low);
    let place = (low >> 2) << 12 | d << 8 | (low & 3) << 6;
    match draw.below(6) {
        0 => code.long(0xf340 | n, place | width),
        1 => code.long(0xf3c0 | n, place | width),
        2 => code.long(0xf360 | n, place | (low + width)),
        3 => code.long(0xf36f, place | (low + width)),
        4 => code.long(0xf300 | n, place | draw.below(32)),
        _ => code.long(0xf380 | n, place | draw.below(32)),
    }
}

/// Loads and stores of all widths in the scratch memory, aligned or not.
fn memory(code: &mut Code, draw: &mut Draw, d: u32) {
    let kind = draw.of(&[0xf8c0, 0xf8d0, 0xf8d0, 0xf890, 0xf8b0, 0xf990, 0xf9b0, 0xf880, 0xf8a0]);
    code.long(kind | 8, d << 12 | draw.below(SCRATCH_BYTES as u32 - 3));
}

/// IT with one or two, then or else, of additions and moves that set no flags.
fn conditional(code: &mut Code, draw: &mut Draw) {
    let (condition, count) = (draw.below(14), 1 + draw.below(2));
    let second = (condition & 1) ^ draw.below(2);
    let mask = if count == 1 { 8 } else { second << 3 | 4 };
    code.short(0xbf00 | condition << 4 | mask);
    for _ in 0..count {
        let (d, n, m) = (draw.below(8), draw.below(8), draw.below(8));
        code.long(0xea00 | draw.of(&OPERATIONS) << 5 | n, d << 8 | m);
    }
}

/// Arithmetic, comparisons and conversions of single precision, and moves both ways.
fn floating(code: &mut Code, draw: &mut Draw) {
    let (d, n, m) = (draw.below(16), draw.below(16), draw.below(16));
    let three = |first: u32, second: u32| {
        let (vd, vn, vm) = (d >> 1, n >> 1, m >> 1);
        let second = second | vd << 12 | (n & 1) << 7 | (m & 1) << 5 | vm;
        (first | (d & 1) << 6 | vn, second)
    };
    // Of these the second operand's place is part of the operation.
    let two = |first: u32, second: u32| {
        (first | (d & 1) << 6, second | (d >> 1) << 12 | (m & 1) << 5 | m >> 1)
    };
    let (first, second) = match draw.below(24) {
        0 | 1 => three(0xee30, 0x0a00),
        2 | 3 => three(0xee30, 0x0a40),
        4 | 5 => three(0xee20, 0x0a00),
        6 => three(0xee20, 0x0a40),
        7 => three(0xee00, 0x0a00),
        8 => three(0xee00, 0x0a40),
        9 => three(0xee10, 0x0a00),
        10 => three(0xee80, 0x0a00),
        11 => three(0xeea0, 0x0a00),
        12 => three(0xeea0, 0x0a40),
        13 => three(0xee90, 0x0a00),
        14 => two(0xeeb0, 0x0ac0),
        15 => two(0xeeb1, 0x0a40),
        16 => two(0xeeb1, 0x0ac0),
        17 => two(0xeeb4, 0x0a40),
        18 => two(0xeebd, 0x0ac0),
        19 => two(0xeebc, 0x0ac0),
        20 => two(0xeeb8, 0x0ac0),
        21 => two(0xeeb8, 0x0a40),
        // VMRS APSR_nzcv, FPSCR.
        22 => (0xeef1, 0xfa10),
        _ => {
            let register = draw.below(8);
            (0xee00 | draw.below(2) << 4 | n >> 1, register << 12 | 0x0a10 | (n & 1) << 7)
        }
    };
    code.long(first, second);
}

/// Returns one segment at the start of the flash: stack pointer, reset vector, code.
fn elf(code: &[u16]) -> Vec<u8> {
    const AT: u32 = 0x0800_0000;
    const VECTORS: u32 = 0x40;
    let mut body: Vec<u8> = Vec::new();
    body.extend(0x2001_0000_u32.to_le_bytes());
    // Whatever goes wrong ends where nothing is sent.
    (1..VECTORS / 4).for_each(|_| body.extend((AT + VECTORS + 1).to_le_bytes()));
    code.iter().for_each(|half| body.extend(half.to_le_bytes()));
    let length = body.len() as u32;
    let mut file = vec![0x7f, b'E', b'L', b'F', 1, 1, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0];
    [2_u16, 40].iter().for_each(|half| file.extend(half.to_le_bytes()));
    [1, AT + VECTORS + 1, 52, 0, 0x0500_0000]
        .iter()
        .for_each(|word: &u32| file.extend(word.to_le_bytes()));
    [52_u16, 32, 1, 40, 0, 0].iter().for_each(|half| file.extend(half.to_le_bytes()));
    [1, 84, AT, AT, length, length, 5, 4]
        .iter()
        .for_each(|word: &u32| file.extend(word.to_le_bytes()));
    file.extend(body);
    file
}
