//! Instructions of Thumb-2 as a bound of time needs them (Armv7-M architecture manual, A5 to A7): length, where they
//! lead, which registers they write and with which value, and their cycles without waits.
//!
//! Cycles: Cortex-M4 technical reference manual (ARM DDI 0439), tables 3-1 and 7-1, each at its longest: a load is never
//! pipelined, a divide takes 12, a result of the FPU is waited for. The refill of the pipeline after a taken branch is no
//! part of them. The disassembler of LLVM is the check of lengths and targets (`host-tests/tests/bounds.rs`).

mod coprocessor;
mod thumb16;
mod thumb32;

/// Number of a core register.
pub type RegisterNumber = u8;
/// The stack pointer, the link register, the program counter.
pub(crate) const SP: RegisterNumber = 13;
/// See [`SP`].
pub(crate) const LR: RegisterNumber = 14;
/// See [`SP`].
pub(crate) const PC: RegisterNumber = 15;

/// The place at which an instruction leads on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ControlFlow {
    /// To the next instruction.
    #[default]
    Next,
    /// To an address.
    Jump(u32),
    /// To an address if a register is zero, or if it is not.
    CompareAndBranch {
        /// The register.
        register: RegisterNumber,
        /// The address.
        target: u32,
        /// Taken if it is zero.
        if_zero: bool,
    },
    /// Calls a function.
    Call(u32),
    /// Calls the function whose address is in a register.
    CallRegister(RegisterNumber),
    /// Back to the caller.
    Return,
    /// To an address in a register; `PC`: to one in memory.
    JumpRegister(RegisterNumber),
    /// To one of the places of the table that follows, of bytes or of half-words.
    TableBranch {
        /// Bytes of an entry, 1 or 2.
        size: u32,
    },
    /// Nowhere: it traps.
    Trap,
}

/// The value that an instruction leaves in a register, where that is simple enough.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum RegisterEffect {
    /// None, or one that is not followed; [`Instruction::writes`] has the registers.
    #[default]
    Other,
    /// A number.
    Set(RegisterNumber, u32),
    /// Another register.
    Copy(RegisterNumber, RegisterNumber),
    /// Another register and a number.
    Add(RegisterNumber, RegisterNumber, u32),
    /// Of two registers the sum.
    Sum(RegisterNumber, RegisterNumber, RegisterNumber),
    /// Of two registers the difference.
    Difference(RegisterNumber, RegisterNumber, RegisterNumber),
    /// The upper half is set to a number.
    SetUpperHalf(RegisterNumber, u32),
    /// The word at an address among the code.
    Literal(RegisterNumber, u32),
    /// Another register, shifted to the left or (negative) to the right.
    Shift(RegisterNumber, RegisterNumber, i8),
    /// Another register and a mask.
    And(RegisterNumber, RegisterNumber, u32),
    /// A number less another register.
    ReverseSubtract(RegisterNumber, u32, RegisterNumber),
}

/// The second operand of a comparison.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Operand {
    /// A number.
    Immediate(u32),
    /// A register.
    Register(RegisterNumber),
}

/// The effect of an instruction on the flags.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum FlagEffect {
    /// None.
    #[default]
    Unchanged,
    /// Not followed.
    Other,
    /// Those of a difference.
    Compare(RegisterNumber, Operand),
    /// Those of a sum.
    Sum(RegisterNumber, Operand),
    /// Zero and negative by the register that it writes.
    Result(RegisterNumber),
    /// Zero by a register and a mask.
    Test(RegisterNumber, u32),
}

/// The memory that an instruction reads or writes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MemoryAccess {
    /// Words.
    pub words: u32,
    /// It reads.
    pub is_load: bool,
    /// Its address.
    pub at: AddressingMode,
}

/// An address as the instruction has it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AddressingMode {
    /// Among the code.
    Literal,
    /// A register and a number.
    ImmediateOffset(RegisterNumber, u32),
    /// The sum of two registers.
    RegisterOffset(RegisterNumber, RegisterNumber),
}

/// A change of the mask of interrupts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum InterruptMaskChange {
    /// `cpsid i`.
    Disable,
    /// `cpsie i`, or a write of PRIMASK.
    Enable,
    /// A write of BASEPRI_MAX from a register: raises the ceiling.
    Raise(RegisterNumber),
    /// A write of BASEPRI from a register: restores the ceiling.
    Restore,
}

/// An instruction.
#[derive(Clone, Copy, Debug, Default)]
pub struct Instruction {
    /// Its address.
    pub at: u32,
    /// Its bytes, 2 or 4.
    pub size: u32,
    /// The place at which it leads on.
    pub flow: ControlFlow,
    /// The value that it leaves.
    pub effect: RegisterEffect,
    /// The registers that it writes, a bit each.
    pub writes: u16,
    /// Its effect on the flags.
    pub flags: FlagEffect,
    /// Its condition, 0 to 13; `None`: always.
    pub condition: Option<u8>,
    /// Its cycles at the longest, without waits and refill.
    pub cycles: u32,
    /// Its access to memory.
    pub access: Option<MemoryAccess>,
    /// Its change of the mask of interrupts.
    pub mask: Option<InterruptMaskChange>,
    /// The state of an IT block that begins behind it.
    pub it: u8,
}

impl Instruction {
    /// Returns the address behind it.
    #[must_use]
    pub(crate) fn end_address(&self) -> u32 {
        self.at + self.size
    }

    /// Returns what the caller finds changed behind a call at this address (procedure call standard, AAPCS 6.1.1).
    #[must_use]
    pub(crate) fn call_clobbers(at: u32) -> Self {
        Self { at, writes: 0b0101_0000_0000_1111, flags: FlagEffect::Other, ..Self::default() }
    }

    fn with_load(mut self, words: u32, at: AddressingMode) -> Self {
        self.access = Some(MemoryAccess { words, is_load: true, at });
        self.cycles = 1 + words;
        self
    }

    fn with_store(mut self, words: u32, at: AddressingMode) -> Self {
        self.access = Some(MemoryAccess { words, is_load: false, at });
        self.cycles = 1 + words;
        self
    }

    fn with_written_registers(
        mut self,
        registers: impl IntoIterator<Item = RegisterNumber>,
    ) -> Self {
        for register in registers {
            self.writes |= 1 << register;
        }
        self
    }

    fn with_register_effect(mut self, effect: RegisterEffect) -> Self {
        self.effect = effect;
        self
    }
}

/// The state of an IT block (A7.3.3).
#[derive(Clone, Copy, Default)]
struct ItState(u8);

impl ItState {
    fn condition(self) -> Option<u8> {
        (self.0 & 0xF != 0).then_some(self.0 >> 4)
    }

    fn advance(self) -> Self {
        if self.0 & 7 == 0 { Self(0) } else { Self(self.0 & 0xE0 | self.0 << 1 & 0x1F) }
    }
}

/// Returns the instructions of a piece of code that begins at `start`, one after the other.
#[must_use]
pub fn decode(code: &[u8], start: u32) -> Vec<Instruction> {
    let halves: Vec<u32> =
        code.chunks_exact(2).map(|two| u16::from_le_bytes([two[0], two[1]]).into()).collect();
    let (mut all, mut number, mut block) = (Vec::new(), 0, ItState::default());
    while let Some(&first) = halves.get(number) {
        let at = start + 2 * number as u32;
        let is_wide = first >> 11 >= 0b11101;
        let second = halves.get(number + 1).copied().unwrap_or_default();
        let condition = block.condition();
        let plain = Instruction {
            at,
            size: if is_wide { 4 } else { 2 },
            cycles: 1,
            condition,
            ..Instruction::default()
        };
        let one = if is_wide {
            thumb32::decode(plain, first, second)
        } else {
            thumb16::decode(plain, first)
        };
        block = if one.it != 0 { ItState(one.it) } else { block.advance() };
        number += one.size as usize / 2;
        all.push(one);
    }
    all
}

/// Returns the low `bits` bits as a number with a sign.
fn sign_extend(value: u32, bits: u32) -> u32 {
    let unused = 32 - bits;
    ((value << unused).cast_signed() >> unused).cast_unsigned()
}

/// Returns the registers of a list of 16 bits.
fn registers_in_list(list: u32) -> impl Iterator<Item = RegisterNumber> {
    (0..16).filter(move |bit| list >> bit & 1 != 0)
}
