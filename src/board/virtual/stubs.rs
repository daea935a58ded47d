//! Parts that an emulated board does not need.

use trueup_modbus::rtu::RxByte;
use trueup_store::retained_state::RetainedCopies;

/// The host watches over its emulator.
pub struct Watchdog;

impl Watchdog {
    pub fn feed(&mut self) {}
}

/// An emulator has no battery: it is cold when its process starts.
pub struct BackupDomain;

impl BackupDomain {
    pub fn restore(&mut self, _copies: &mut RetainedCopies) -> u32 {
        0
    }

    pub fn now_s(&mut self) -> Option<u32> {
        None
    }

    pub fn store(&mut self, _copies: &mut RetainedCopies) {}
}

/// An emulator has no supply.
pub struct BrownOutLevel;

impl BrownOutLevel {
    pub fn raise_level_when_idle(&mut self, _gives_offset: bool, _watchdog: &mut Watchdog) {}
}

/// An emulator is never damaged.
pub struct SelfTest;

impl SelfTest {
    pub fn run_step(&mut self) {}

    pub fn is_damaged(&self) -> bool {
        false
    }

    /// Not known.
    pub fn scan_unused_stack_bytes(&mut self) -> u16 {
        u16::MAX
    }
}

/// No line for a PLC.
pub struct Rs485;

impl Rs485 {
    pub fn receive_byte(&mut self) -> Option<RxByte> {
        None
    }

    pub fn send(&mut self, _next: impl FnMut() -> Option<u8>) {}
}

/// No silence is waited for.
pub struct SilenceTimer;

impl SilenceTimer {
    pub fn now_us(&mut self) -> u32 {
        0
    }
}

/// No lamp.
pub struct StatusLed;

impl StatusLed {
    pub fn set(&mut self, _on: bool) {}
}
