//! The seam: what the tasks require of a board, and nothing more. Two boards stand behind it.
//!
//! | part | `stm32f405` | `virtual` |
//! |---|---|---|
//! | [`Sampler`] | TIM3 → ADC1 → DMA2, 20 codes a block; VREFINT between them | blocks by semihosting from the host |
//! | [`SerialRx`], [`SerialTx`] | USART1, 921 600 Bd, by DMA | USART1 of the emulator, by polling |
//! | [`Rs485`], [`SilenceTimer`] | USART3, bytes by interrupt; TIM5 | none |
//! | [`CanRx`], [`CanTx`] | bxCAN, 1 Mbit/s, PB8/PB9 | frames in the same stream as the samples |
//! | [`Thermometers`] | 8 MAX31865 on SPI2, linear inputs by ADC2 | come with the samples |
//! | [`Flash`] | two sectors of the flash | a file of the host |
//! | [`Store`] of a new calibration | two more sectors | a file of the host |
//! | [`Watchdog`] | IWDG, 100 ms | none: the host watches |
//! | [`BrownOutLevel`] | level 3, in the option bytes | none |
//! | [`SelfTest`] | RAM, image, registers, stack | none |
//! | [`StatusLed`] | LED | none |
//! | [`ServiceSwitch`] | PB7 to ground | comes with the samples |
//! | calibration | linked into the image, or loaded over it | a file of the host, or loaded over it |
//! | RAM that outlasts a reset | `.uninit` | the same |
//! | [`BackupDomain`], what outlasts a power cut | backup SRAM and RTC behind VBAT | none |
//! | [`restart`] | reset | reset of the emulator at the end of a batch |
//!
//! Both boards raise the same interrupts, so the tasks cannot distinguish them:
//! `DMA2_STREAM0` with a block of samples (one millisecond of the sample clock), `CAN1_RX0` and
//! `CAN1_RX1` with frames from the bus (on `virtual` all by the first), `USART1` with bytes from the
//! serial line, `DMA2_STREAM7` when there is room for more (`DMA2_STREAM2`: as `USART1`), `USART3` with bytes from
//! the PLC and room for more, `TIM5` when it has been silent, `SysTick` every 10 ms. On `virtual` it is the samples
//! that make time pass, so `SysTick` comes with every tenth block.

use trueup_canopen::emergency::Fault;
use trueup_core::{
    calibration::Calibration,
    thermometer::RawTemperatureReading,
    units::{AdcCode, Rpm},
};
use trueup_modbus::rtu::FrameTiming;
use trueup_node::reset_info::ResetInfo;
use trueup_store::{calibration::BlobError, reference::ReferenceStore, retained_state};

#[cfg(all(feature = "stm32f405", feature = "virtual"))]
compile_error!("choose one board: --features stm32f405 or --features virtual");
#[cfg(not(any(feature = "stm32f405", feature = "virtual")))]
compile_error!("choose a board: --features stm32f405 or --features virtual");

pub mod reference_store;
mod retained_ram;
#[cfg(feature = "stm32f405")]
mod stm32f405;
#[cfg(feature = "stm32f405")]
pub use stm32f405::*;

#[cfg(feature = "virtual")]
mod r#virtual;
#[cfg(feature = "virtual")]
pub use r#virtual::*;

/// Where a calibration is gathered.
pub type CalibrationBuffer = [u8; trueup_store::calibration::MAX_BLOB_SIZE];

/// From which commit of the source the image was built: the first 32 bits of its hash; 0: it is not known.
pub const COMMIT_HASH_PREFIX: u32 = match u32::from_str_radix(env!("TRUEUP_COMMIT"), 16) {
    Ok(commit) => commit,
    Err(_) => 0,
};

/// Conversions in one block: one millisecond at 20 kS/s.
pub const CODES_PER_BLOCK: usize = 20;
/// Temperature channels.
pub const TEMPERATURE_CHANNEL_COUNT: usize = 8;

/// The codes of a block: they are read into the place where they are used.
pub type BlockCodes = [AdcCode; CODES_PER_BLOCK];

/// One millisecond of samples, in addition to its codes.
pub struct Block {
    /// The spindle speed, where the board itself knows it; a fresh one from the CNC wins.
    pub speed: Option<Rpm>,
    /// Readings of the temperature channels, where they come with the samples and not from
    /// [`Thermometers`]. A channel that nothing is wired to is [`RawTemperatureReading::NONE`].
    pub temperatures: Option<[RawTemperatureReading; TEMPERATURE_CHANNEL_COUNT]>,
}

/// How a CAN controller is on its bus (ISO 11898-1, fault confinement).
#[derive(Clone, Copy, Default)]
pub struct CanErrorState {
    /// One of its error counters is at 96 or above.
    pub warning: bool,
    /// One is at 128 or above: it no longer destroys what others send.
    pub passive: bool,
    /// It takes no part: bus-off, or a bus that is never quiet.
    pub off: bool,
}

/// State of the bytes that wait for the serial line.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum TransmitState {
    /// None waits.
    Idle,
    /// A piece is going out, or is held up; an interrupt comes at its end.
    Busy,
    /// More waits, and no interrupt requests it.
    MorePending,
}

/// Faults that a board found at start-up.
#[derive(Clone, Copy, Default, defmt::Format)]
pub struct StartupFaults {
    /// The crystal did not start: the CPU runs from the internal oscillator, CAN stays silent.
    pub crystal: bool,
    /// The PLL did not lock: the CPU runs at 16 MHz.
    pub pll: bool,
    /// The CAN controller did not leave its reset state.
    pub can: bool,
    /// The last reset came from the watchdog.
    pub watchdog_reset: bool,
    /// The last start stopped itself.
    pub stopped: bool,
}

impl StartupFaults {
    /// Returns whether the board runs on a fall-back.
    pub fn uses_fallback(&self) -> bool {
        self.crystal || self.pll || self.can
    }

    /// Those that are there.
    pub fn active_faults(&self) -> impl Iterator<Item = Fault> {
        let all = [
            (self.crystal, Fault::Crystal),
            (self.pll, Fault::Pll),
            (self.can, Fault::Can),
            (self.watchdog_reset, Fault::WatchdogReset),
            (self.stopped, Fault::Stopped),
        ];
        all.into_iter().filter_map(|(is_there, fault)| is_there.then_some(fault))
    }
}

/// Returns the serial number folded to 16 bits, as `N` answers it on the serial line. Two boards of a shop have the
/// same one once in 65 536 pairs.
pub const fn short_serial_number(serial_number: u32) -> u16 {
    (serial_number >> 16) as u16 ^ serial_number as u16
}

/// The line for a PLC, in parts, and how it is set.
pub struct PlcInterface {
    /// Its address, 1 to 247.
    pub unit: u8,
    pub timing: FrameTiming,
    pub line: Rs485,
    pub silence: SilenceTimer,
}

/// A board that is up, in parts, each for one task.
pub struct Parts {
    pub samples: Sampler,
    pub serial_in: SerialRx,
    pub serial_out: SerialTx,
    pub plc: PlcInterface,
    /// One for each interrupt.
    pub can_in: [CanRx; 2],
    pub can_out: CanTx,
    pub watchdog: Watchdog,
    /// Pending change of the supply's lowest level.
    pub brown_out: BrownOutLevel,
    pub lamp: StatusLed,
    pub idle: Idle,
    pub thermometers: Thermometers,
    pub service_switch: ServiceSwitch,
    pub calibration: Result<Calibration<'static>, BlobError>,
    /// The store of references and writes, and what it holds for the start.
    pub references: (ReferenceStore<Flash>, reference_store::StoredReferenceState),
    pub faults: StartupFaults,
    /// How the board came to run.
    pub start: ResetInfo,
    pub self_test: SelfTest,
    /// A hash of the number that the chip has from its factory.
    pub serial_number: u32,
    /// The number that the chip has from its factory, the lowest word first.
    pub chip: [u32; 3],
    /// The bytes of the calibration in use; empty without one.
    pub blob: &'static [u8],
    /// The calibration that was loaded last is damaged, and this is an older one.
    pub is_older: bool,
    /// The calibration is the example's: another machine's spindle.
    pub is_example: bool,
    /// State that outlasts a reset, unless the power was gone.
    pub retained: &'static mut retained_state::RetainedCopies,
    /// Memory that outlasts a power cut as well.
    pub backup: BackupDomain,
    /// Where a new calibration is gathered and stored; `None` on a board that cannot store one.
    pub loading: Option<(&'static mut [u8], Store)>,
}
