//! Registers of a port (RM0090 section 8.4).

/// Offset of GPIOx_MODER, the modes of the pins (8.4.1).
pub(super) const MODER_OFFSET: u32 = 0x00;
/// Offset of GPIOx_OTYPER, push-pull or open drain (8.4.2).
pub(super) const OTYPER_OFFSET: u32 = 0x04;
/// Offset of GPIOx_OSPEEDR, the output speeds (8.4.3).
pub(super) const OSPEEDR_OFFSET: u32 = 0x08;
/// Offset of GPIOx_PUPDR, the pull-ups and pull-downs (8.4.4).
pub(super) const PUPDR_OFFSET: u32 = 0x0c;
/// Offset of GPIOx_IDR, the levels at the pins (8.4.5).
pub(super) const IDR_OFFSET: u32 = 0x10;
/// Offset of GPIOx_ODR, the output levels (8.4.6).
pub(super) const ODR_OFFSET: u32 = 0x14;
/// Offset of GPIOx_BSRR, which sets and resets output levels (8.4.7).
pub(crate) const BSRR_OFFSET: u32 = 0x18;
/// Offset of GPIOx_LCKR, the lock of the configuration (8.4.8).
pub(super) const LCKR_OFFSET: u32 = 0x1c;
/// Offset of GPIOx_AFRL, the alternate functions of pins 0 to 7 (8.4.9).
pub(super) const AFRL_OFFSET: u32 = 0x20;
/// Offset of GPIOx_AFRH, the alternate functions of pins 8 to 15 (8.4.10).
pub(super) const AFRH_OFFSET: u32 = 0x24;

/// The two bits of a pin in GPIOx_MODER, GPIOx_OSPEEDR or GPIOx_PUPDR, shifted down.
pub(crate) const PIN_FIELD_MASK: u32 = 0x3;
/// GPIOx_MODER: the pin is a general-purpose output.
pub(crate) const MODE_OUTPUT: u32 = 1;
/// GPIOx_MODER: the pin carries an alternate function.
pub(super) const MODE_ALTERNATE: u32 = 2;
/// GPIOx_MODER: the pin is analog.
pub(crate) const MODE_ANALOG: u32 = 3;
/// GPIOx_PUPDR: the pin has its pull-up.
pub(super) const PULL_UP: u32 = 1;
/// The four bits of a pin in GPIOx_AFRL or GPIOx_AFRH, shifted down.
pub(super) const AF_FIELD_MASK: u32 = 0xf;
/// GPIOx_BSRR: position of the bits that reset an output.
pub(super) const BSRR_BR_SHIFT: u32 = 16;
/// One bit for each of the 16 pins.
pub(super) const PINS_MASK: u32 = 0xffff;

/// GPIOA_MODER: position of the fields of PA13 and PA14, which carry the debug port after a reset.
pub(super) const MODER_DEBUG_SHIFT: u32 = 26;
/// GPIOA_MODER: the two fields of the debug port, shifted down.
pub(super) const MODER_DEBUG_MASK: u32 = 0xf;
/// GPIOA_MODER: both pins of the debug port carry their alternate function.
pub(super) const MODER_DEBUG_ALTERNATE: u32 = 0b1010;

/// Value of GPIOA_MODER after a reset: the debug port on PA13, PA14 and PA15 (8.4.1).
pub(crate) const GPIOA_MODER_RESET: u32 = 0xa800_0000;
/// Value of GPIOA_OSPEEDR after a reset (8.4.3).
pub(crate) const GPIOA_OSPEEDR_RESET: u32 = 0x0c00_0000;
/// Value of GPIOA_PUPDR after a reset: the pulls of the debug port (8.4.4).
pub(crate) const GPIOA_PUPDR_RESET: u32 = 0x6400_0000;
/// Value of GPIOB_MODER after a reset: the debug port on PB3 and PB4 (8.4.1).
pub(crate) const GPIOB_MODER_RESET: u32 = 0x280;
/// Value of GPIOB_OSPEEDR after a reset (8.4.3).
pub(crate) const GPIOB_OSPEEDR_RESET: u32 = 0xc0;
/// Value of GPIOB_PUPDR after a reset: the pull-up of PB4 (8.4.4).
pub(crate) const GPIOB_PUPDR_RESET: u32 = 0x100;
