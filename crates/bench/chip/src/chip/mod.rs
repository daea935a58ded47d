//! The chip around the processor: its units, their time, and their interrupt lines.
//!
//! Written from RM0090 (STM32F405/407) and DS8626 alone. It is strict: what silicon ignores, faults on
//! or leaves undefined goes into the report, next to what silicon would do.

mod adc;
mod adc_conversion;
mod backup_domain;
mod bus_access;
mod can;
mod can_bus;
mod crc;
mod dma;
mod fault_injection;
mod flash;
mod gpio;
mod iwdg;
pub(crate) mod rcc;
mod rtc;
mod script_playback;
mod spi;
mod tim;
mod tim11;
mod uart;
mod world_step;

use crate::{
    processor::{InterruptLines, Memories, Memory},
    report::{Severity, SimulationReport},
    simulation_time::NEVER,
    world::World,
};
use adc::{Adc, Adcs};
use backup_domain::{BackupDomain, registers::PWR_CR_RESET};
use can::Can;
use crc::Crc;
use dma::Dma;
use flash::{
    FlashModel,
    registers::{ACR_ICRST, OPTCR_OPTLOCK},
};
use gpio::{Gpio, registers::*};
use iwdg::{Iwdg, registers::RLR_RESET};
use rcc::{HSI_HZ, Rcc, registers::*};
use spi::Spi;
use std::sync::{
    Arc,
    atomic::{AtomicU64, Ordering},
};
use tim::{Tim, registers::SR_INTERRUPT_FLAGS as TIM_INTERRUPT_FLAGS};
use tim11::Tim11;
use uart::Uart;

/// Bit of [`SharedState::flag`]: there is something new in the report.
pub const FLAG_NEW_FINDING: u64 = 1 << 0;
/// Bit of [`SharedState::flag`]: a reset is requested.
pub const FLAG_RESET_REQUEST: u64 = 1 << 1;
/// Bit of [`SharedState::flag`]: programming of the flash was switched on or off.
pub const FLAG_PROGRAMMING_CHANGED: u64 = 1 << 2;

/// State that the run loop and the bus share without a lock.
#[derive(Debug, Default)]
pub struct SharedState {
    /// The present time, in ticks since power-on.
    pub now: AtomicU64,
    /// When the next event of the chip is due.
    pub next: AtomicU64,
    /// Ticks in a cycle of the processor.
    pub cycle: AtomicU64,
    /// The flash does not answer before this.
    pub stall: AtomicU64,
    /// FLASH_ACR, and a count of its writes in the upper half.
    pub acr: AtomicU64,
    /// Requests to the run loop, as bits: [`FLAG_NEW_FINDING`], [`FLAG_RESET_REQUEST`], [`FLAG_PROGRAMMING_CHANGED`].
    pub flag: AtomicU64,
}

/// Faults outside the processor, for checks of the fall-backs.
#[derive(Clone, Copy, Default, Debug)]
pub struct InjectedFaults {
    /// The crystal does not swing.
    pub hse_dead: bool,
    /// When the crystal stops; 0: never.
    pub hse_stops: u64,
    /// The PLL does not lock.
    pub pll_dead: bool,
    /// The 32 kHz crystal does not swing.
    pub lse_dead: bool,
    /// When a converter stops in the middle of a conversion, for as long as it is on; 0: never.
    pub adc_stalls: u64,
    /// No node acknowledges on the bus.
    pub can_alone: bool,
    /// Every frame is destroyed.
    pub can_short: bool,
    /// TIM11 captures nothing.
    pub capture_dead: bool,
    /// The CRC unit takes nothing, and reads as 0.
    pub crc_dead: bool,
    /// The streams of the serial line take their enable and move nothing.
    pub serial_dma_stuck: bool,
    /// When something writes to the flash that has not been unlocked for it; 0: never.
    pub stray_write: u64,
    /// When the program counter is upset, and to what; 0: never.
    pub upset: (u64, u32),
    /// The receive pin is held low: the chip never sees a quiet bus.
    pub can_stuck: bool,
}

/// The registers of EXTI.
#[derive(Default)]
pub struct Exti {
    pub(crate) imr: u32,
    pub(crate) emr: u32,
    pub(crate) rtsr: u32,
    pub(crate) ftsr: u32,
    pub(crate) pr: u32,
}

/// The chip without its processor.
pub struct Chip {
    /// The interrupt lines to the processor.
    pub lines: InterruptLines,
    /// State shared by the run loop and the bus.
    pub shared: Arc<SharedState>,
    /// The SRAM on the bus matrix.
    pub sram: Arc<Memory>,
    /// The flash array.
    pub rom: Arc<Memory>,
    /// The present time, in ticks since power-on.
    pub now: u64,
    /// Findings about the image.
    pub report: SimulationReport,
    /// Faults from outside.
    pub faults: InjectedFaults,
    /// Reset and clock control.
    pub rcc: Rcc,
    /// Frequency of SYSCLK, in Hz.
    pub sys_hz: u64,
    /// Ticks in a cycle of HCLK.
    pub hclk: u64,
    /// Ticks in a cycle of PCLK1.
    pub pclk1: u64,
    /// Ticks in a cycle of PCLK2.
    pub pclk2: u64,
    /// Ticks in a cycle of the clock of the timers on APB1.
    pub tclk1: u64,
    /// Ticks in a cycle of the clock of the timers on APB2.
    pub tclk2: u64,
    /// PWR_CR, the power control register.
    pub pwr_cr: u32,
    /// The backup domain.
    pub backup: BackupDomain,
    /// The flash interface.
    pub flash: FlashModel,
    /// The CRC unit.
    pub crc: Crc,
    /// The ports A to I.
    pub gpio: [Gpio; 9],
    /// The timers, as `Tim::timers_after_reset` orders them.
    pub tims: Vec<Tim>,
    /// TIM11, which measures the crystal.
    pub tim11: Tim11,
    /// The three converters.
    pub adc: Adcs,
    /// DMA1 and DMA2.
    pub dma: [Dma; 2],
    /// CAN 1.
    pub can: Can,
    /// As [`uart::UNITS`] names them.
    pub uart: [Uart; 2],
    /// SPI2.
    pub spi: Spi,
    /// The independent watchdog.
    pub iwdg: Iwdg,
    pub(crate) exti: Exti,
    pub(crate) syscfg: [u32; 9],
    pub(crate) dbgmcu: [u32; 4],
    /// The interrupt lines that are up.
    pub irqs: [bool; 82],
    /// Rises of each interrupt line.
    pub irq_counts: [u64; 82],
    /// Since when each interrupt line is up.
    irq_since: [u64; 82],
    /// The longest that each interrupt line was up, in ticks: the wait for its handler, and its service.
    pub irq_longest: [u64; 82],
    /// Surroundings of the chip.
    pub world: World,
    /// The cause of the reset that is requested, as flags of RCC_CSR.
    pub reset_cause: u32,
    /// The resets so far: when, and why.
    pub resets: Vec<(u64, &'static str)>,
    /// Something may have changed that the interrupt lines or the next event depend on.
    pub(crate) dirty: bool,
}

/// The events that lie ahead.
#[derive(Clone, Copy, Debug)]
enum ChipEvent {
    Hse,
    HseStop,
    Pll,
    Lsi,
    TimUp(usize),
    TimCc(usize, usize),
    Adc(usize),
    CanEnd,
    CanStart,
    CanMode,
    UartTx(usize),
    UartRx(usize),
    UartIdle(usize),
    Spi,
    Iwdg,
    Flash,
    World,
}

impl Chip {
    /// Returns a chip after power-on.
    pub fn new(
        lines: InterruptLines,
        shared: Arc<SharedState>,
        memories: Memories,
        world: World,
        faults: InjectedFaults,
    ) -> Chip {
        let mut c = Chip {
            lines,
            shared,
            sram: memories.sram,
            rom: memories.flash,
            now: 0,
            report: SimulationReport::default(),
            faults,
            rcc: Rcc::default(),
            sys_hz: HSI_HZ,
            hclk: 0,
            pclk1: 0,
            pclk2: 0,
            tclk1: 0,
            tclk2: 0,
            pwr_cr: 0,
            backup: BackupDomain::default(),
            flash: FlashModel::after_reset(flash::FlashStats::default()),
            crc: Crc::default(),
            gpio: Default::default(),
            tims: Vec::new(),
            tim11: Tim11::default(),
            adc: Adcs::default(),
            dma: Default::default(),
            can: Can::default(),
            uart: Default::default(),
            spi: Spi::default(),
            iwdg: Iwdg::default(),
            exti: Exti::default(),
            syscfg: [0; 9],
            dbgmcu: [0; 4],
            irqs: [false; 82],
            irq_counts: [0; 82],
            irq_since: [0; 82],
            irq_longest: [0; 82],
            world,
            reset_cause: 0,
            resets: Vec::new(),
            dirty: true,
        };
        c.reset(RCC_CSR_PORRSTF | RCC_CSR_PINRSTF | RCC_CSR_BORRSTF);
        c
    }

    /// Every register to what RM0090 gives as its reset value; the memories stay.
    pub fn reset(&mut self, cause: u32) {
        let csr = self.rcc.csr & RCC_CSR_CAUSES_MASK;
        self.rcc = Rcc {
            cr: RCC_CR_RESET,
            pllcfgr: RCC_PLLCFGR_RESET,
            enr: RCC_ENR_RESETS,
            lpenr: RCC_LPENR_RESETS,
            csr: csr | cause,
            plli2s: RCC_PLLI2SCFGR_RESET,
            hse_at: NEVER,
            pll_at: NEVER,
            lsi_at: NEVER,
            ..Rcc::default()
        };
        self.pwr_cr = PWR_CR_RESET;
        self.backup.rtc.apply_system_reset(self.now);
        self.gpio = Default::default();
        self.gpio[0] = Gpio {
            moder: GPIOA_MODER_RESET,
            ospeedr: GPIOA_OSPEEDR_RESET,
            pupdr: GPIOA_PUPDR_RESET,
            ..Gpio::default()
        };
        self.gpio[1] = Gpio {
            moder: GPIOB_MODER_RESET,
            ospeedr: GPIOB_OSPEEDR_RESET,
            pupdr: GPIOB_PUPDR_RESET,
            ..Gpio::default()
        };
        let options = self.flash.optcr | OPTCR_OPTLOCK;
        self.flash = FlashModel::after_reset(self.flash.stats);
        self.flash.optcr = options;
        self.crc = Crc::default();
        self.tims = Tim::timers_after_reset();
        self.tim11 = Tim11::default();
        self.adc =
            Adcs { unit: self.adc.unit.each_ref().map(Adc::to_reset_state), ..Adcs::default() };
        self.dma = Default::default();
        self.can = Can::after_reset();
        self.uart = [Uart::after_reset(), Uart::after_reset()];
        self.spi = Spi::after_reset();
        self.iwdg = Iwdg {
            rlr: RLR_RESET,
            count: RLR_RESET,
            expire: NEVER,
            longest: self.iwdg.longest,
            ..Iwdg::default()
        };
        self.exti = Exti::default();
        self.syscfg = [0; 9];
        for n in 0..82 {
            self.lines.set_interrupt_line(n, false);
        }
        self.irqs = [false; 82];
        self.dirty = true;
        self.update_accelerator(ACR_ICRST);
        self.update_clocks();
    }

    /// Records what silicon would not do, or what the manual forbids.
    pub fn report_violation(&mut self, text: String) {
        self.record_finding(Severity::Violation, text);
    }
    /// Records a finding; for a new one, requests its program counter from the run loop.
    pub fn record_finding(&mut self, grade: Severity, text: String) {
        self.report.record_finding(self.now, grade, text);
        if self.report.has_findings_without_pc() {
            self.shared.flag.fetch_or(FLAG_NEW_FINDING, Ordering::Relaxed);
        }
    }
    /// Returns a register's new value: only writable bits change, and a try at the others is reported.
    pub fn apply_write_mask(&mut self, name: &str, old: u32, new: u32, writable: u32) -> u32 {
        let wrong = (old ^ new) & !writable;
        if wrong != 0 {
            self.report_violation(format!("{name}: {new:#010x} written, which would change the reserved or read-only bits {wrong:#x}"));
        }
        (old & !writable) | (new & writable)
    }

    fn next_event(&self) -> (u64, ChipEvent) {
        let mut best = (self.rcc.hse_at, ChipEvent::Hse);
        let mut take = |t: u64, e: ChipEvent| {
            if t < best.0 {
                best = (t, e)
            }
        };
        take(self.rcc.pll_at, ChipEvent::Pll);
        if self.faults.hse_stops > 0 {
            take(self.faults.hse_stops, ChipEvent::HseStop);
        }
        take(self.rcc.lsi_at, ChipEvent::Lsi);
        for (i, t) in self.tims.iter().enumerate() {
            if t.is_running() {
                take(t.update_at, ChipEvent::TimUp(i));
                for (ch, at) in t.cc_at.iter().enumerate() {
                    take(*at, ChipEvent::TimCc(i, ch));
                }
            }
        }
        for (n, adc) in self.adc.unit.iter().enumerate() {
            if !adc.stalled {
                take(adc.end_at, ChipEvent::Adc(n));
            }
        }
        take(self.can.end_at, ChipEvent::CanEnd);
        take(self.can.mode_at, ChipEvent::CanMode);
        if self.can.end_at == NEVER {
            take(self.world.next_can_frame_time(), ChipEvent::CanStart);
        }
        for (n, uart) in self.uart.iter().enumerate() {
            take(uart.tx_at, ChipEvent::UartTx(n));
            take(uart.rx_at, ChipEvent::UartRx(n));
            take(uart.idle_at, ChipEvent::UartIdle(n));
        }
        take(self.spi.end_at, ChipEvent::Spi);
        take(self.iwdg.expire, ChipEvent::Iwdg);
        take(self.flash.done_at, ChipEvent::Flash);
        take(self.world.next_at, ChipEvent::World);
        best
    }

    /// Lets everything happen that happens until then.
    pub fn advance(&mut self, to: u64) {
        loop {
            let (t, ev) = self.next_event();
            if t > to {
                break;
            }
            self.now = self.now.max(t);
            self.dirty = true;
            match ev {
                ChipEvent::Hse => {
                    self.rcc.hse_at = NEVER;
                    self.rcc.cr |= RCC_CR_HSERDY;
                    self.try_clock_switch()
                }
                ChipEvent::HseStop => self.inject_hse_failure(),
                ChipEvent::Pll => {
                    self.rcc.pll_at = NEVER;
                    self.rcc.cr |= RCC_CR_PLLRDY;
                    self.try_clock_switch()
                }
                ChipEvent::Lsi => {
                    self.rcc.lsi_at = NEVER;
                    self.rcc.csr |= RCC_CSR_LSIRDY
                }
                ChipEvent::TimUp(i) => self.handle_tim_update_event(i),
                ChipEvent::TimCc(i, ch) => self.handle_tim_compare_match(i, ch),
                ChipEvent::Adc(n) => self.end_adc_conversion(n),
                ChipEvent::CanEnd => self.end_can_frame(),
                ChipEvent::CanStart => self.start_can_frame(),
                ChipEvent::CanMode => self.update_can_mode(),
                ChipEvent::UartTx(n) => self.finish_uart_transmission(n),
                ChipEvent::UartRx(n) => self.finish_uart_reception(n),
                ChipEvent::UartIdle(n) => self.handle_uart_idle(n),
                ChipEvent::Spi => self.finish_spi_transfer(),
                ChipEvent::Iwdg => {
                    self.iwdg.expire = NEVER;
                    self.request_reset(RCC_CSR_IWDGRSTF | RCC_CSR_PINRSTF, "IWDG")
                }
                ChipEvent::Flash => self.complete_flash_operation(),
                ChipEvent::World => self.step_world(),
            }
        }
        self.now = self.now.max(to);
    }

    /// Requests a reset from the run loop; `cause`: flags of RCC_CSR.
    pub fn request_reset(&mut self, cause: u32, why: &'static str) {
        self.reset_cause = cause;
        self.resets.push((self.now, why));
        self.shared.flag.fetch_or(FLAG_RESET_REQUEST, Ordering::Relaxed);
    }

    /// Returns whether any interrupt line is up.
    pub fn has_pending_interrupt(&self) -> bool {
        self.irqs.iter().any(|line| *line)
    }

    /// Has the interrupt lines and the next event computed anew.
    pub fn mark_dirty(&mut self) {
        self.dirty = true;
    }

    /// After anything has changed: the interrupt lines, and the time of the next event.
    pub fn update_lines_and_next_event(&mut self) {
        if !self.dirty {
            return;
        }
        self.dirty = false;
        let mut want = [false; 82];
        for t in &self.tims {
            want[t.irq] |= t.sr & t.dier & TIM_INTERRUPT_FLAGS != 0;
        }
        want[18] = self.adc.unit.iter().any(Adc::is_irq_asserted);
        self.collect_dma_interrupt_lines(&mut want);
        self.collect_can_interrupt_lines(&mut want);
        want[37] = self.is_uart_irq_asserted(0);
        want[39] = self.is_uart_irq_asserted(1);
        want[36] = self.is_spi_irq_asserted();
        self.lines.set_nmi_line(self.rcc.cir & RCC_CIR_CSSF != 0);
        want[4] = self.flash.is_irq_asserted();
        want[5] = self.rcc.cir & self.rcc.cir >> RCC_CIR_ENABLE_SHIFT & RCC_CIR_READY_FLAGS != 0;
        for (n, on) in want.into_iter().enumerate() {
            if on != self.irqs[n] {
                self.irqs[n] = on;
                self.irq_counts[n] += u64::from(on);
                if on {
                    self.irq_since[n] = self.now;
                } else {
                    let up = self.now - self.irq_since[n];
                    self.irq_longest[n] = self.irq_longest[n].max(up);
                }
                self.lines.set_interrupt_line(n as u16, on);
            }
        }
        self.shared.next.store(self.next_event().0, Ordering::Relaxed);
    }
}
