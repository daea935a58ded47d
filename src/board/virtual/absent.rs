//! Parts that an emulated board does not need.

use trueup_modbus::rtu::RxByte;
use trueup_store::retained::Copies;

/// The host watches over its emulator.
pub struct Watchdog;

impl Watchdog {
    pub fn feed(&mut self) {}
}

/// An emulator has no battery: it is cold when its process starts.
pub struct Backup;

impl Backup {
    pub fn restore(&mut self, _copies: &mut Copies) -> u32 {
        0
    }

    pub fn now_s(&mut self) -> Option<u32> {
        None
    }

    pub fn store(&mut self, _copies: &mut Copies) {}
}

/// An emulator has no supply.
pub struct BrownOut;

impl BrownOut {
    pub fn turn(&mut self, _gives_offset: bool, _watchdog: &mut Watchdog) {}
}

/// An emulator is never damaged.
pub struct SelfTest;

impl SelfTest {
    pub fn turn(&mut self) {}

    pub fn is_damaged(&self) -> bool {
        false
    }

    /// Not known.
    pub fn free_stack(&mut self) -> u16 {
        u16::MAX
    }
}

/// No line for a PLC.
pub struct Rs485;

impl Rs485 {
    pub fn take(&mut self) -> Option<RxByte> {
        None
    }

    pub fn send(&mut self, _next: impl FnMut() -> Option<u8>) {}
}

/// No silence is waited for.
pub struct Silence;

impl Silence {
    pub fn now_us(&mut self) -> u32 {
        0
    }
}

/// No lamp.
pub struct Lamp;

impl Lamp {
    pub fn set(&mut self, _on: bool) {}
}
