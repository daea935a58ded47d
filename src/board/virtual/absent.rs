//! What an emulated board has no need of.

/// The host watches over its emulator.
pub struct Watchdog;

impl Watchdog {
    pub fn feed(&mut self) {}
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

/// No lamp.
pub struct Lamp;

impl Lamp {
    pub fn set(&mut self, _on: bool) {}
}
