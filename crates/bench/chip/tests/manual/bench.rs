//! The chip as a bench for the manual's statements: the test is its bus master.

use trueup_chip::{
    board::{Board, TraceOptions},
    chip::{Chip, InjectedFaults},
    processor::Memories,
    report::Severity,
    simulation_time::NEVER,
    world::{StimulusPlan, World},
};

pub const RCC: u32 = 0x4002_3800;
pub const FLASH: u32 = 0x4002_3c00;
pub const GPIOA: u32 = 0x4002_0000;
pub const GPIOB: u32 = 0x4002_0400;
pub const TIM3: u32 = 0x4000_0400;
pub const TIM11: u32 = 0x4001_4800;
pub const ADC1: u32 = 0x4001_2000;
pub const DMA2: u32 = 0x4002_6400;
pub const CAN1: u32 = 0x4000_6400;
pub const USART1: u32 = 0x4001_1000;
pub const IWDG: u32 = 0x4000_3000;

/// A chip whose processor does nothing: the test is its bus master.
pub struct Bench {
    pub board: Board,
    pub now: u64,
}

impl Bench {
    pub fn new() -> Bench {
        Bench::with(InjectedFaults::default())
    }

    pub fn with(faults: InjectedFaults) -> Bench {
        let plan = StimulusPlan {
            code: 1000.0,
            code_after: 1000.0,
            step_at: NEVER,
            noise: 0.0,
            cnc_from: NEVER,
            engage_at: NEVER,
            zero_at: NEVER,
            cnc_until: NEVER,
            rpm: 0,
            says: Vec::new(),
            positions: 0,
            frames: Vec::new(),
        };
        let board = Board::from_memories(
            Memories::new(),
            World::new(plan),
            faults,
            TraceOptions::default(),
        );
        Bench { board, now: 0 }
    }

    pub fn at_once<R>(&self, work: impl FnOnce(&mut Chip) -> R) -> R {
        let now = self.now;
        self.board.with_chip(|chip| {
            chip.advance(now);
            let result = work(chip);
            chip.update_lines_and_next_event();
            result
        })
    }

    pub fn read(&self, address: u32) -> u32 {
        self.at_once(|chip| chip.bus_read(address, 4))
    }

    pub fn write(&self, address: u32, value: u32) {
        self.at_once(|chip| chip.bus_write(address, 4, value));
    }

    pub fn set(&self, address: u32, bits: u32) {
        self.write(address, self.read(address) | bits);
    }

    pub fn pass(&mut self, ticks: u64) {
        self.now += ticks;
        self.at_once(|_| ());
    }

    /// Violations so far that speak of `what`.
    pub fn violations(&self, what: &str) -> usize {
        self.board.with_chip(|chip| {
            let of = |(grade, text): &&(Severity, String)| {
                *grade == Severity::Violation && text.contains(what)
            };
            chip.report.items.keys().filter(of).count()
        })
    }

    /// Programs a word by way of the processor's bus.
    pub fn program(&self, offset: u32, word: u32) {
        self.at_once(|chip| chip.program_flash(offset, &word.to_le_bytes()));
    }

    pub fn unlock_flash(&self) {
        self.write(FLASH + 4, 0x4567_0123);
        self.write(FLASH + 4, 0xcdef_89ab);
    }
}

/// 16 MHz straight from HSI, with the units of these tests clocked.
pub fn clocked() -> Bench {
    let bench = Bench::new();
    bench.set(RCC + 0x30, 1 | 1 << 1 | 1 << 22);
    bench.set(RCC + 0x40, 1 << 1 | 1 << 25);
    bench.set(RCC + 0x44, 1 << 4 | 1 << 8);
    bench
}
