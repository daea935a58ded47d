//! Registers of the MAX31865 (data sheet 19-6478, table of the register addresses).

/// Bit of an address byte: the transfer writes.
pub(super) const ADDRESS_WRITE: u8 = 1 << 7;
/// The address itself in an address byte.
pub(super) const ADDRESS_MASK: u8 = 0x7f;
/// Address of the configuration.
pub(super) const CONFIGURATION: u8 = 0;
/// Address of the upper byte of the ratio.
pub(super) const RTD_MSB: u8 = 1;
/// Address of the lower byte of the ratio.
pub(super) const RTD_LSB: u8 = 2;
/// Address of the first byte of the thresholds: high, then low.
pub(super) const HIGH_THRESHOLD_MSB: u8 = 3;
/// Address of the last byte of the thresholds.
pub(super) const LOW_THRESHOLD_LSB: u8 = 6;
/// Address of the fault status, the last register.
pub(super) const FAULT_STATUS: u8 = 7;

/// Configuration, VBIAS: the bias of the thermometer is on.
pub(super) const CONFIG_VBIAS: u8 = 1 << 7;
/// Configuration, conversion mode: one conversion after the other.
pub(super) const CONFIG_AUTO: u8 = 1 << 6;
/// Configuration, 1-shot: starts one conversion, and clears itself.
pub(super) const CONFIG_ONE_SHOT: u8 = 1 << 5;
/// Configuration, fault status clear: clears the faults, and itself.
pub(super) const CONFIG_FAULT_CLEAR: u8 = 1 << 1;
/// Configuration, 50/60 Hz filter: the notch is at 50 Hz.
pub(super) const CONFIG_NOTCH_50_HZ: u8 = 1 << 0;
/// Bits of the configuration that stay as written: the others clear themselves.
pub(super) const CONFIG_STORED_MASK: u8 = 0xd1;

/// Fault status: the ratio has reached the high threshold.
pub(super) const FAULT_HIGH_THRESHOLD: u8 = 1 << 7;
/// Fault status: the ratio has fallen to the low threshold.
pub(super) const FAULT_LOW_THRESHOLD: u8 = 1 << 6;

/// The thresholds after power-on, byte by byte: the highest and the lowest ratio.
pub(super) const THRESHOLD_RESETS: [u8; 4] = [0xff, 0xff, 0, 0];
/// The ratio of a broken wire: the largest of 15 bits.
pub(super) const MAX_RATIO: u16 = 0x7fff;
/// The byte on MISO while there is nothing to read.
pub(super) const MISO_IDLE: u8 = 0xff;
