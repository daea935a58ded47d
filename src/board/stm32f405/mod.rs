//! The board that is flashed: an STM32F405RG with a crystal of 8, 12, 16 or 25 MHz.
//!
//! | pin | signal |
//! |---|---|
//! | PA0 | displacement sensor behind its filter and divider, 0 V … VREF+ |
//! | PA1 … PA7, PB0 | linear temperature inputs of channels 0 … 6, 7, where the machine file has them |
//! | PA9, PA10 | serial transmit and receive, 921 600 Bd |
//! | PB10, PB11, PB12 | RS-485 transmit, receive, and drive: high while the board sends |
//! | PC8 … PC11, PB5, PB6 | switches of the RS-485 line to ground: address, speed, parity |
//! | PB7 | service switch to ground: a calibration may require that nothing is written unless it is closed |
//! | PB9, PB8 | CAN transmit and receive, to a transceiver |
//! | PB13, PB14, PB15 | SCK, MISO, MOSI of the temperature converters |
//! | PC0 … PC7 | select the converter of channel 0 … 7: low |
//! | PC12 | lamp, from the supply through a resistor: lit when low |
//! | PC14, PC15, VBAT | crystal of 32.768 kHz, and a battery: what the machine's heat outlasts a power cut by |
//!
//! A dead part must not hold up the others: every wait in this folder has a bound, and a part
//! that does not answer is logged by name and reported in [`Faults`]. Section numbers are those
//! of the reference manual RM0090 (Rev 21), where nothing else is said.

mod backup;
mod brown_out;
mod can;
mod clocks;
mod crash_record;
mod crystal;
mod flash;
mod image_check;
mod linear_inputs;
mod mpu;
#[cfg(feature = "slots")]
mod own_slot;
mod panic;
mod ram_test;
mod register_check;
mod reset_counts;
mod rs485;
mod sampling;
mod self_test;
mod serial;
mod serial_dma;
mod service_switch;
#[cfg(feature = "slots")]
#[path = "../../bin/boot/flash.rs"]
mod slot_flash;
mod stack_watermark;
mod startup_timer;
mod status_led;
mod store;
mod stored_data;
mod thermometers;
mod unique_id;
mod watchdog;

use cortex_m::peripheral::{SCB, SYST, syst::SystClkSource};
use defmt_rtt as _;
use stm32f4xx_hal::{
    pac,
    prelude::*,
    rcc::{Enable as _, Rcc, Reset as _},
};

use super::{CalibrationBuffer, Parts, StartupFaults, retained_ram};
use crate::liveness::{self, Task};
pub use backup::BackupDomain;
pub use brown_out::BrownOutLevel;
pub use can::{CanRx, CanTx};
use clocks::ClockSource;
pub use flash::Flash;
#[cfg(feature = "slots")]
pub use own_slot::OwnSlot;
pub use rs485::{Rs485, SilenceTimer};
pub use sampling::Sampler;
pub use self_test::SelfTest;
pub use serial::{SerialRx, SerialTx};
pub use service_switch::ServiceSwitch;
pub use status_led::StatusLed;
pub use store::Store;
use stored_data::StoredData;
pub use thermometers::Thermometers;
use trueup_core::thermometer::Thermometer;
use trueup_link::status::ResetReason;
use trueup_node::reset_info::{CrashInfo, ResetInfo};
use watchdog::ResetCause;
pub use watchdog::Watchdog;

/// After a power cut it is not known how warm the machine is.
pub const IS_MACHINE_COLD_AT_START: bool = false;

/// Does nothing: the next tick, or the supervisor, raises the transmitter.
pub fn transmit_without_tick() {}

/// Turns of the supervisor in one second.
const SUPERVISOR_HZ: u32 = 100;

/// Brings up every part, the watchdog first; once all are up, the supervisor has to keep it quiet. Until then each part
/// that reads much feeds it: once, or at each record of a store, whose loops are bounded by its size. One that hangs is reset.
pub fn start(
    mut core: cortex_m::Peripherals,
    device: pac::Peripherals,
    buffer: &'static mut CalibrationBuffer,
) -> Parts {
    let mut watchdog = Watchdog::start(device.IWDG, &device.DBGMCU);
    let reset = watchdog::take_reset_cause(&device.RCC);
    defmt::info!("reset by {}", reset);
    let began = take_reset_info(reset);
    mpu::enable(&core.MPU);
    enable_divide_by_zero_trap(&core.SCB);
    let (mut rcc, source) = clocks::start(device.RCC, &device.TIM11, &device.FLASH, &mut core.SYST);
    if source == ClockSource::Internal {
        watchdog.set_slow_clock_timeout();
    }
    watchdog.feed();
    let mut brown_out = BrownOutLevel::new(reset);
    enable_debug_in_sleep_mode(&device.DBGMCU);

    let stored = StoredData::open(device.FLASH, buffer, &mut watchdog);
    if stored.is_new {
        // A new board has no user who waits for its start.
        brown_out.raise_level(&mut watchdog);
    }

    let gpioa = device.GPIOA.split(&mut rcc);
    let gpiob = device.GPIOB.split(&mut rcc);
    let gpioc = device.GPIOC.split(&mut rcc);
    // Before samples are taken: it takes longer than a block.
    let self_test = SelfTest::start(device.CRC, &mut rcc);
    watchdog.feed();
    // Before any of its streams: the converter's and the serial line's.
    enable_dma2(&mut rcc);
    let (serial_in, serial_out) = serial::start(device.USART1, gpioa.pa9, gpioa.pa10, &mut rcc);
    let plc_pins = rs485::Rs485Pins {
        transmit: gpiob.pb10,
        receive: gpiob.pb11,
        drive: gpiob.pb12,
        rate: gpiob.pb5,
        parity: gpiob.pb6,
        address: (gpioc.pc8, gpioc.pc9, gpioc.pc10, gpioc.pc11),
    };
    let plc = rs485::start(device.USART3, device.TIM5, plc_pins, &mut rcc);
    let (can_in, can_out, can_answers) =
        can::start(device.CAN1, gpiob.pb9, gpiob.pb8, source, &mut rcc);
    let selects =
        (gpioc.pc0, gpioc.pc1, gpioc.pc2, gpioc.pc3, gpioc.pc4, gpioc.pc5, gpioc.pc6, gpioc.pc7);
    let known = stored.calibration.as_ref().map(|stored| stored.thermometers).unwrap_or_default();
    let mains = stored.calibration.as_ref().map(|stored| stored.guards.mains).unwrap_or_default();
    let plan = sampling::SamplingTiming::from_bus_clock(rcc.clocks.pclk2().raw());
    let bus = (gpiob.pb13, gpiob.pb14, gpiob.pb15);
    let mut thermometers = thermometers::start(device.SPI2, bus, selects, known, mains, &mut rcc);
    let chain = sampling::SamplingChain {
        tim3: device.TIM3,
        tim2: device.TIM2,
        adc: device.ADC1,
        dma: device.DMA2,
    };
    // Before samples are taken: its registers take 0.3 ms, by which the first tick would be late.
    watchdog.set_run_timeout();
    let samples = sampling::start(chain, gpioa.pa0, &device.ADC_COMMON, &mut rcc);
    // After the first converter's, because a reset is for all of them.
    if known.iter().flatten().any(|thermometer| matches!(thermometer, Thermometer::Linear { .. })) {
        let pins = (
            gpioa.pa1, gpioa.pa2, gpioa.pa3, gpioa.pa4, gpioa.pa5, gpioa.pa6, gpioa.pa7, gpiob.pb0,
        );
        let sampling_time = plan.auxiliary_sampling_time();
        let inputs = linear_inputs::start(device.ADC2, pins, sampling_time, mains, &mut rcc);
        thermometers.set_linear_inputs(inputs);
    }
    let serial_number = unique_id::hashed_serial_number(&device.DBGMCU);
    start_supervisor_timer(&mut core.SYST, rcc.clocks.hclk().raw());
    Parts {
        samples,
        serial_in,
        serial_out,
        plc,
        can_in,
        can_out,
        lamp: StatusLed::new(gpioc.pc12),
        idle: Idle,
        thermometers,
        service_switch: ServiceSwitch::new(gpiob.pb7),
        calibration: stored.calibration,
        references: stored.references,
        faults: startup_faults(source, can_answers, reset, began.reason),
        blob: stored.blob,
        is_older: stored.is_older,
        is_example: stored.is_example,
        retained: retained_ram::take_retained_copies(),
        backup: BackupDomain::start(device.PWR, device.RTC, reset, &mut rcc),
        loading: Some((buffer, stored.store)),
        watchdog,
        brown_out,
        start: began,
        self_test,
        serial_number,
        chip: unique_id::unique_id_words(&device.DBGMCU),
    }
}

/// Switches on the second DMA controller, and resets it.
#[inline(always)]
fn enable_dma2(rcc: &mut Rcc) {
    pac::DMA2::enable(rcc);
    pac::DMA2::reset(rcc);
}

/// Returns the faults of this start.
#[inline(always)]
fn startup_faults(
    source: ClockSource,
    can_answers: bool,
    reset: ResetCause,
    reason: ResetReason,
) -> StartupFaults {
    StartupFaults {
        crystal: !matches!(source, ClockSource::Crystal { .. }),
        pll: source == ClockSource::Internal,
        can: !can_answers,
        watchdog_reset: reset == ResetCause::Watchdog,
        stopped: matches!(
            reason,
            ResetReason::Panic
                | ResetReason::HardFault
                | ResetReason::StackOverflow
                | ResetReason::Registers
        ),
    }
}

/// Returns what is known of how the board came to run, before a task of this start leaves its own mark.
fn take_reset_info(reset: ResetCause) -> ResetInfo {
    let last_words = crash_record::take().filter(|_| reset != ResetCause::PowerOn);
    let reason = watchdog::reset_reason(reset, last_words.as_ref());
    let stop = match &last_words {
        Some(words) => words.stop,
        // No task could leave a record: the one that ran is the one that hung.
        None if reset == ResetCause::Watchdog => {
            CrashInfo { task: liveness::last_running_task_number(), ..CrashInfo::default() }
        }
        None => CrashInfo::default(),
    };
    if let Some(words) = &last_words {
        words.log();
    } else if stop.task != 0 {
        defmt::error!("the watchdog bit in task {=u8}", stop.task);
    }
    liveness::set_background_task(Task::Start);
    ResetInfo { reason, stop, counts: reset_counts::count_reset(reason) }
}

/// A division by zero is a fault, and not 0 (Armv7-M manual, B3.2.8, DIV_0_TRP).
#[allow(unsafe_code, reason = "registers of the core")]
fn enable_divide_by_zero_trap(scb: &SCB) {
    // SAFETY: no other bit changes, and no code here divides by zero on purpose.
    unsafe { scb.ccr.modify(|bits| bits | 1 << 4) };
}

/// SysTick raises its interrupt a hundred times a second, whichever clock the core runs from.
fn start_supervisor_timer(systick: &mut SYST, core_hz: u32) {
    systick.set_clock_source(SystClkSource::Core);
    systick.set_reload(core_hz / SUPERVISOR_HZ - 1);
    systick.clear_current();
    systick.enable_counter();
    systick.enable_interrupt();
}

/// Keeps the clocks of a sleeping core on: without them a debugger loses the chip, and its log,
/// at every `wfi` (section 38.16.1).
fn enable_debug_in_sleep_mode(dbgmcu: &pac::DBGMCU) {
    dbgmcu.cr().modify(|_, w| w.dbg_sleep().set_bit());
}

/// Core cycles in a millisecond at the full clock; a slower clock only waits longer.
const HSI_CYCLES_PER_MS: u32 = 168_000;

/// Returns whether `ready` came true within `polls` polls: the only way to wait on this board.
fn poll_until(polls: u32, mut ready: impl FnMut() -> bool) -> bool {
    (0..polls).any(|_| ready())
}

/// Starts the board anew, as soon as the serial line is silent.
pub fn restart() {
    serial::wait_until_sent();
    SCB::sys_reset()
}

/// Work of the core when no task has any.
pub struct Idle;

impl Idle {
    /// Sleeps until the next interrupt; timers, converter and DMA go on.
    pub fn run(&mut self) -> ! {
        liveness::set_background_task(Task::Idle);
        loop {
            liveness::heartbeat(Task::Idle);
            cortex_m::asm::wfi();
        }
    }
}
