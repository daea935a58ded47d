//! The service switch on PB7: pulled up, closed to ground.

use embedded_hal::digital::InputPin;
use stm32f4xx_hal::gpio::{Input, PB7};

/// The switch.
pub struct ServiceSwitch(PB7<Input>);

impl ServiceSwitch {
    /// Sets its pin up.
    pub fn new(pin: PB7) -> Self {
        Self(pin.into_pull_up_input())
    }

    /// Returns whether it is closed now; contacts bounce.
    pub fn is_closed(&mut self) -> bool {
        let Ok(is_low) = InputPin::is_low(&mut self.0);
        is_low
    }
}
