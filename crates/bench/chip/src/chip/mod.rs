//! The chip around the processor: its units, their time, and their interrupt lines.
//!
//! Written from RM0090 (STM32F405/407) and DS8626 alone. It is strict: what silicon ignores, faults on
//! or leaves undefined goes into the report, next to what silicon would do.

mod adc;
mod backup;
mod bus;
mod can;
mod can_bus;
mod convert;
mod crc;
mod dma;
mod flash;
mod gpio;
mod iwdg;
mod outside;
mod play;
mod rcc;
mod rtc;
mod spi;
mod tim;
mod tim11;
mod uart;
mod upset;

use crate::{
    processor::{Lines, Memories, Memory},
    report::{Grade, Report},
    time::NEVER,
    world::World,
};
use adc::{Adc, Adcs};
use backup::Backup;
use can::Can;
use crc::Crc;
use dma::Dma;
use flash::Flash;
use gpio::Gpio;
use iwdg::Iwdg;
use rcc::Rcc;
use spi::Spi;
use std::sync::{
    Arc,
    atomic::{AtomicU64, Ordering},
};
use tim::Tim;
use tim11::Tim11;
use uart::Uart;

/// State that the run loop and the bus share without a lock.
#[derive(Debug, Default)]
pub struct Shared {
    pub now: AtomicU64,
    pub next: AtomicU64,
    /// Ticks in a cycle of the processor.
    pub cycle: AtomicU64,
    /// The flash does not answer before this.
    pub stall: AtomicU64,
    /// FLASH_ACR, and a count of its writes in the upper half.
    pub acr: AtomicU64,
    /// 1: something new in the report; 2: reset wanted; 4: programming was switched on or off.
    pub flag: AtomicU64,
}

/// Faults outside the processor, for checks of the fall-backs.
#[derive(Clone, Copy, Default, Debug)]
pub struct Faults {
    pub hse_dead: bool,
    /// When the crystal stops; 0: never.
    pub hse_stops: u64,
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

#[derive(Default)]
pub struct Exti {
    pub(crate) imr: u32,
    pub(crate) emr: u32,
    pub(crate) rtsr: u32,
    pub(crate) ftsr: u32,
    pub(crate) pr: u32,
}

pub struct Chip {
    pub lines: Lines,
    pub shared: Arc<Shared>,
    pub sram: Arc<Memory>,
    pub rom: Arc<Memory>,
    pub now: u64,
    pub report: Report,
    pub faults: Faults,
    pub rcc: Rcc,
    pub sys_hz: u64,
    pub hclk: u64,
    pub pclk1: u64,
    pub pclk2: u64,
    pub tclk1: u64,
    pub tclk2: u64,
    pub pwr_cr: u32,
    pub backup: Backup,
    pub flash: Flash,
    pub crc: Crc,
    pub gpio: [Gpio; 9],
    pub tims: Vec<Tim>,
    pub tim11: Tim11,
    pub adc: Adcs,
    pub dma: [Dma; 2],
    pub can: Can,
    /// As [`uart::UNITS`] names them.
    pub uart: [Uart; 2],
    pub spi: Spi,
    pub iwdg: Iwdg,
    pub(crate) exti: Exti,
    pub(crate) syscfg: [u32; 9],
    pub(crate) dbgmcu: [u32; 4],
    pub irqs: [bool; 82],
    pub irq_counts: [u64; 82],
    /// Since when each line is up, and the longest that it was up: the wait for its handler, and its service.
    irq_since: [u64; 82],
    pub irq_longest: [u64; 82],
    pub world: World,
    pub reset_cause: u32,
    pub resets: Vec<(u64, &'static str)>,
    /// Something may have changed that the interrupt lines or the next event depend on.
    pub(crate) dirty: bool,
}

/// The events that lie ahead.
#[derive(Clone, Copy, Debug)]
enum Ev {
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
    pub fn new(
        lines: Lines,
        shared: Arc<Shared>,
        memories: Memories,
        world: World,
        faults: Faults,
    ) -> Chip {
        let mut c = Chip {
            lines,
            shared,
            sram: memories.sram,
            rom: memories.flash,
            now: 0,
            report: Report::default(),
            faults,
            rcc: Rcc::default(),
            sys_hz: 16_000_000,
            hclk: 0,
            pclk1: 0,
            pclk2: 0,
            tclk1: 0,
            tclk2: 0,
            pwr_cr: 0,
            backup: Backup::default(),
            flash: Flash::default(),
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
        c.reset(1 << 27 | 1 << 26 | 1 << 25);
        c
    }

    /// Every register to what RM0090 gives as its reset value; the memories stay.
    pub fn reset(&mut self, cause: u32) {
        let csr = self.rcc.csr & 0xfe00_0000;
        self.rcc = Rcc {
            cr: 0x0000_8083,
            pllcfgr: 0x2400_3010,
            enr: [0x0010_0000, 0, 0, 0, 0],
            lpenr: [0x7e67_91ff, 0xf1, 1, 0x36fe_c9ff, 0x0007_5f33],
            csr: csr | cause,
            plli2s: 0x2000_3000,
            hse_at: NEVER,
            pll_at: NEVER,
            lsi_at: NEVER,
            ..Rcc::default()
        };
        self.pwr_cr = 0x4000;
        self.backup.rtc.system_reset(self.now);
        self.gpio = Default::default();
        self.gpio[0] = Gpio {
            moder: 0xa800_0000,
            ospeedr: 0x0c00_0000,
            pupdr: 0x6400_0000,
            ..Gpio::default()
        };
        self.gpio[1] = Gpio { moder: 0x280, ospeedr: 0xc0, pupdr: 0x100, ..Gpio::default() };
        let options = self.flash.optcr | 1;
        self.flash = Flash::reset(self.flash.stats);
        self.flash.optcr = options;
        self.crc = Crc::default();
        self.tims = Tim::all();
        self.tim11 = Tim11::default();
        self.adc = Adcs { unit: self.adc.unit.each_ref().map(Adc::reset), ..Adcs::default() };
        self.dma = Default::default();
        self.can = Can::reset();
        self.uart = [Uart::reset(), Uart::reset()];
        self.spi = Spi::reset();
        self.iwdg = Iwdg {
            rlr: 0xfff,
            count: 0xfff,
            expire: NEVER,
            longest: self.iwdg.longest,
            ..Iwdg::default()
        };
        self.exti = Exti::default();
        self.syscfg = [0; 9];
        for n in 0..82 {
            self.lines.interrupt(n, false);
        }
        self.irqs = [false; 82];
        self.dirty = true;
        self.tell_acr(1 << 11);
        self.clocks();
    }

    pub fn violation(&mut self, text: String) {
        self.say(Grade::Violation, text);
    }
    pub fn say(&mut self, grade: Grade, text: String) {
        self.report.say(self.now, grade, text);
        if self.report.has_fresh() {
            self.shared.flag.fetch_or(1, Ordering::Relaxed);
        }
    }
    /// Returns a register's new value: only writable bits change, and a try at the others is reported.
    pub fn set(&mut self, name: &str, old: u32, new: u32, writable: u32) -> u32 {
        let wrong = (old ^ new) & !writable;
        if wrong != 0 {
            self.violation(format!("{name}: {new:#010x} written, which would change the reserved or read-only bits {wrong:#x}"));
        }
        (old & !writable) | (new & writable)
    }

    fn next_event(&self) -> (u64, Ev) {
        let mut best = (self.rcc.hse_at, Ev::Hse);
        let mut take = |t: u64, e: Ev| {
            if t < best.0 {
                best = (t, e)
            }
        };
        take(self.rcc.pll_at, Ev::Pll);
        if self.faults.hse_stops > 0 {
            take(self.faults.hse_stops, Ev::HseStop);
        }
        take(self.rcc.lsi_at, Ev::Lsi);
        for (i, t) in self.tims.iter().enumerate() {
            if t.running() {
                take(t.update_at, Ev::TimUp(i));
                for (ch, at) in t.cc_at.iter().enumerate() {
                    take(*at, Ev::TimCc(i, ch));
                }
            }
        }
        for (n, adc) in self.adc.unit.iter().enumerate() {
            if !adc.stalled {
                take(adc.end_at, Ev::Adc(n));
            }
        }
        take(self.can.end_at, Ev::CanEnd);
        take(self.can.mode_at, Ev::CanMode);
        if self.can.end_at == NEVER {
            take(self.world.can_ready(), Ev::CanStart);
        }
        for (n, uart) in self.uart.iter().enumerate() {
            take(uart.tx_at, Ev::UartTx(n));
            take(uart.rx_at, Ev::UartRx(n));
            take(uart.idle_at, Ev::UartIdle(n));
        }
        take(self.spi.end_at, Ev::Spi);
        take(self.iwdg.expire, Ev::Iwdg);
        take(self.flash.done_at, Ev::Flash);
        take(self.world.next_at, Ev::World);
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
                Ev::Hse => {
                    self.rcc.hse_at = NEVER;
                    self.rcc.cr |= 1 << 17;
                    self.try_switch()
                }
                Ev::HseStop => self.hse_stop(),
                Ev::Pll => {
                    self.rcc.pll_at = NEVER;
                    self.rcc.cr |= 1 << 25;
                    self.try_switch()
                }
                Ev::Lsi => {
                    self.rcc.lsi_at = NEVER;
                    self.rcc.csr |= 2
                }
                Ev::TimUp(i) => self.tim_update(i),
                Ev::TimCc(i, ch) => self.tim_compare(i, ch),
                Ev::Adc(n) => self.adc_end(n),
                Ev::CanEnd => self.can_end(),
                Ev::CanStart => self.can_start(),
                Ev::CanMode => self.can_mode(),
                Ev::UartTx(n) => self.uart_tx_end(n),
                Ev::UartRx(n) => self.uart_rx_end(n),
                Ev::UartIdle(n) => self.uart_idle(n),
                Ev::Spi => self.spi_end(),
                Ev::Iwdg => {
                    self.iwdg.expire = NEVER;
                    self.want_reset(1 << 29 | 1 << 26, "IWDG")
                }
                Ev::Flash => self.flash_done(),
                Ev::World => self.world_step(),
            }
        }
        self.now = self.now.max(to);
    }

    pub fn want_reset(&mut self, cause: u32, why: &'static str) {
        self.reset_cause = cause;
        self.resets.push((self.now, why));
        self.shared.flag.fetch_or(2, Ordering::Relaxed);
    }

    /// Returns whether any interrupt line is up.
    pub fn interrupts(&self) -> bool {
        self.irqs.iter().any(|line| *line)
    }

    pub fn touch(&mut self) {
        self.dirty = true;
    }

    /// After anything has changed: the interrupt lines, and the time of the next event.
    pub fn settle(&mut self) {
        if !self.dirty {
            return;
        }
        self.dirty = false;
        let mut want = [false; 82];
        for t in &self.tims {
            want[t.irq] |= t.sr & t.dier & 0x5f != 0;
        }
        want[18] = self.adc.unit.iter().any(Adc::line);
        self.dma_lines(&mut want);
        self.can_lines(&mut want);
        want[37] = self.uart_line(0);
        want[39] = self.uart_line(1);
        want[36] = self.spi_line();
        self.lines.nmi(self.rcc.cir & 0x80 != 0);
        want[4] = self.flash.line();
        want[5] = self.rcc.cir & self.rcc.cir >> 8 & 0x3f != 0;
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
                self.lines.interrupt(n as u16, on);
            }
        }
        self.shared.next.store(self.next_event().0, Ordering::Relaxed);
    }
}
