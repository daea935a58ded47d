//! The lamp on PC12, which shines when the pin is low.

use embedded_hal::digital::OutputPin;
use stm32f4xx_hal::gpio::{Output, PC12, PinState};

/// The lamp.
pub struct StatusLed(PC12<Output>);

impl StatusLed {
    /// Returns the lamp, dark.
    pub fn new(pin: PC12) -> Self {
        Self(pin.into_push_pull_output_in_state(PinState::High))
    }

    /// Lights it, or not.
    pub fn set(&mut self, on: bool) {
        let lit_when_low = (!on).into();
        let Ok(()) = OutputPin::set_state(&mut self.0, lit_when_low);
    }
}
