//! A board that runs: the chip and its processor in step, instruction by instruction.

use crate::chip::rcc::registers::{RCC_CSR_PINRSTF, RCC_CSR_SFTRSTF};
use crate::chip::{Chip, InjectedFaults, SharedState};
use crate::chip::{FLAG_NEW_FINDING, FLAG_PROGRAMMING_CHANGED, FLAG_RESET_REQUEST};
use crate::elf;
use crate::flash_accelerator::FlashAccelerator;
use crate::handler_timing::HandlerTimer;
use crate::memory_map::{FLASH_BASE, FLASH_END, SRAM_BASE, SRAM_END, SYSTEM_MEMORY_BASE};
use crate::processor::{
    FLASH_SIZE, MONITORED_EXCEPTIONS, Memories, Memory, PeripheralBus, Processor, SRAM_SIZE,
};
use crate::report::Severity;
use crate::simulation_time::ms_to_ticks;
use crate::world::World;
use std::collections::BTreeMap;
use std::sync::{
    Arc, Mutex, MutexGuard, PoisonError,
    atomic::Ordering::{Relaxed, SeqCst},
};

/// The chip, filled in once the processor is there.
type SharedChip = Arc<Mutex<Option<Chip>>>;

/// The chip as the processor reaches it.
struct ChipAccess {
    chip: SharedChip,
    shared: Arc<SharedState>,
}

impl ChipAccess {
    /// Does something to the chip at the present time.
    fn access_chip<R>(&self, work: impl FnOnce(&mut Chip) -> R) -> R {
        let mut chip = self.chip.lock().unwrap_or_else(PoisonError::into_inner);
        let chip = chip.as_mut().expect("the processor runs after the chip is there");
        chip.advance(self.shared.now.load(Relaxed));
        let result = work(chip);
        chip.update_lines_and_next_event();
        result
    }
}

impl PeripheralBus for ChipAccess {
    fn read(&self, address: u32, size: u32) -> u32 {
        self.access_chip(|chip| chip.bus_read(address, size))
    }

    fn write(&self, address: u32, size: u32, value: u32) {
        self.access_chip(|chip| chip.bus_write(address, size, value));
    }

    fn program(&self, offset: u32, bytes: &[u8]) {
        self.access_chip(|chip| {
            chip.mark_dirty();
            chip.program_flash(offset, bytes);
        });
    }
}

/// A time for which interrupts were held off.
#[derive(Clone, Copy, Debug)]
pub struct MaskedInterval {
    /// For how long, in ticks.
    pub length: u64,
    /// From when.
    pub since: u64,
    /// Where it began.
    pub pc: u32,
}

/// Options of a run: what is watched beyond the chip itself.
#[derive(Clone, Copy, Debug, Default)]
pub struct TraceOptions {
    /// How long interrupts are held off, how long what the program raises waits, and how long handlers take.
    pub masked: bool,
    /// Where the processor is, sampled.
    pub places: bool,
    /// The log of the image (RTT).
    pub log: bool,
    /// CYCCNT counts while the processor sleeps, as it does with a debugger.
    pub awake: bool,
}

/// An image on its board.
pub struct Board {
    chip: SharedChip,
    shared: Arc<SharedState>,
    processor: Processor,
    memories: Memories,
    accelerator: FlashAccelerator,
    acr: u64,
    watch: TraceOptions,
    log_at: Option<u32>,
    log_next: u64,
    upset: (u64, u32),
    now: u64,
    ones: u32,
    checked: u32,
    masked_since: Option<(u64, u32)>,
    pended_since: [Option<u64>; MONITORED_EXCEPTIONS.len()],
    /// The longest that each of [`MONITORED_EXCEPTIONS`] waited for its handler to begin.
    pub pended_longest: [u64; MONITORED_EXCEPTIONS.len()],
    /// How long each handler takes.
    pub turns: HandlerTimer,
    /// Ticks asleep.
    pub asleep: u64,
    /// When it first slept: what comes before is the start.
    pub first_sleep: Option<u64>,
    /// How often it slept.
    pub sleeps: u64,
    /// Instructions and exceptions.
    pub steps: u64,
    /// The log of the image, as a probe reads it.
    pub log: Vec<u8>,
    /// The longest times for which interrupts were held off, in no order.
    pub masks: Vec<MaskedInterval>,
    /// Where the processor was, sampled: program counter and how often.
    pub places: BTreeMap<u32, u64>,
}

/// How many steps between two looks at the processor's faults.
const FAULT_CHECK_INTERVAL_STEPS: u32 = 1024;
/// This many single cycles in a row may be a processor that sleeps.
const SLEEP_DETECTION_STEPS: u32 = 12;

impl Board {
    /// Returns a board with an image in its flash, before its first instruction.
    ///
    /// # Panics
    /// The file is no image for this flash.
    #[must_use]
    pub fn new(
        image: &[u8],
        memories: Memories,
        world: World,
        faults: InjectedFaults,
        watch: TraceOptions,
    ) -> Board {
        for (at, bytes) in elf::parse_loadable_segments(image) {
            let offset = u64::from(at - FLASH_BASE);
            memories.flash.write_at(offset, &bytes).expect("an image for the flash");
        }
        let log_at = elf::SymbolTable::parse(image).find_address("_SEGGER_RTT");
        Board { log_at, ..Board::from_memories(memories, world, faults, watch) }
    }

    /// Returns a board with what is in its flash already, before its first instruction.
    #[must_use]
    pub fn from_memories(
        memories: Memories,
        world: World,
        faults: InjectedFaults,
        watch: TraceOptions,
    ) -> Board {
        let shared = Arc::new(SharedState::default());
        let chip: SharedChip = Arc::new(Mutex::new(None));
        let behind = Arc::new(ChipAccess { chip: chip.clone(), shared: shared.clone() });
        let processor = Processor::new(&memories, behind);
        let fresh =
            Chip::new(processor.interrupt_lines(), shared.clone(), memories.clone(), world, faults);
        *chip.lock().unwrap_or_else(PoisonError::into_inner) = Some(fresh);
        Board {
            chip,
            shared,
            processor,
            memories,
            accelerator: FlashAccelerator::default(),
            acr: 0,
            watch,
            log_at: None,
            log_next: 0,
            upset: faults.upset,
            now: 0,
            ones: 0,
            checked: 0,
            masked_since: None,
            pended_since: [None; MONITORED_EXCEPTIONS.len()],
            pended_longest: [0; MONITORED_EXCEPTIONS.len()],
            turns: HandlerTimer::default(),
            asleep: 0,
            first_sleep: None,
            sleeps: 0,
            steps: 0,
            log: Vec::new(),
            masks: Vec::new(),
            places: BTreeMap::new(),
        }
    }

    /// Has the image start as after the chip's own loader: on a PLL from the internal oscillator, with the
    /// loader's vectors and the flash unlocked (AN2606, section on STM32F40xxx; RM0090 2.4).
    pub fn set_bootloader_state(&self) {
        self.processor.set_vector_table(SYSTEM_MEMORY_BASE);
        self.with_chip(|chip| {
            chip.set_bootloader_state();
            chip.update_lines_and_next_event();
        });
    }

    /// Has the lowest bit of that word of the SRAM stuck at 1.
    pub fn inject_stuck_bit(&mut self, address: u32) {
        self.processor.inject_stuck_bit(&self.memories, address);
    }

    /// Looks at the chip, or changes it.
    pub fn with_chip<R>(&self, work: impl FnOnce(&mut Chip) -> R) -> R {
        work(self.lock_chip().as_mut().expect("it is there"))
    }

    fn lock_chip(&self) -> MutexGuard<'_, Option<Chip>> {
        self.chip.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns the time, in ticks since power-on.
    #[must_use]
    pub fn now(&self) -> u64 {
        self.now
    }

    /// Where the processor is.
    #[must_use]
    pub fn pc(&self) -> u32 {
        self.processor.pc()
    }

    /// Returns the memories, which outlast a reset.
    #[must_use]
    pub fn memories(&self) -> &Memories {
        &self.memories
    }

    /// Runs until that time, in ticks since power-on.
    pub fn run_until(&mut self, end: u64) {
        while self.now < end {
            let began = self.now;
            let (pc, cycles) = self.processor.step();
            self.steps += 1;
            self.advance_time(cycles);
            if let Some(offset) =
                pc.checked_sub(FLASH_BASE).filter(|at| u64::from(*at) < FLASH_SIZE)
            {
                self.apply_flash_wait_states(offset);
            }
            if self.watch.masked {
                self.track_interrupt_delays();
            }
            self.stall_for_flash();
            if self.watch.masked {
                let (exception, pc) = (self.processor.active_exception(), self.processor.pc());
                let is_active = |exception| self.processor.is_active(exception);
                self.turns.record_step(exception, pc, self.now - began, self.now, is_active);
            }
            if self.now >= self.shared.next.load(Relaxed) {
                self.advance_chip();
            }
            self.ones = if cycles == 1 { self.ones + 1 } else { 0 };
            if self.ones >= SLEEP_DETECTION_STEPS {
                self.ones = 0;
                self.sleep_until_event(end);
            }
            self.finish_step();
        }
    }

    fn advance_time(&mut self, cycles: u64) {
        self.now += cycles * self.shared.cycle.load(Relaxed);
        self.shared.now.store(self.now, Relaxed);
    }

    /// The wait states of the instruction that was executed. Time goes on, for SysTick and CYCCNT as well.
    fn apply_flash_wait_states(&mut self, offset: u32) {
        let acr = self.shared.acr.load(Relaxed);
        if acr != self.acr {
            self.acr = acr;
            self.accelerator.write_acr(acr as u32);
        }
        let waits = self.accelerator.fetch_wait_cycles(offset, acr as u32);
        if waits > 0 {
            self.processor.advance_idle_cycles(waits, true);
            self.advance_time(waits);
        }
    }

    fn advance_chip(&self) {
        let now = self.now;
        self.with_chip(|chip| {
            chip.advance(now);
            chip.update_lines_and_next_event();
        });
    }

    fn track_interrupt_delays(&mut self) {
        let pended =
            self.processor.exception_pending_flags().into_iter().zip(&mut self.pended_since);
        for ((is, since), longest) in pended.zip(&mut self.pended_longest) {
            match (is, *since) {
                (true, None) => *since = Some(self.now),
                (false, Some(from)) => {
                    *longest = (*longest).max(self.now - from);
                    *since = None;
                }
                _ => {}
            }
        }
        match (self.processor.are_interrupts_masked(), self.masked_since) {
            (true, None) => self.masked_since = Some((self.now, self.processor.pc())),
            (false, Some((since, pc))) => {
                self.masked_since = None;
                self.masks.push(MaskedInterval { length: self.now - since, since, pc });
                if self.masks.len() > 4096 {
                    self.masks.sort_by_key(|masked| std::cmp::Reverse(masked.length));
                    self.masks.truncate(64);
                }
            }
            _ => {}
        }
    }

    /// The flash gives no instruction while it is programmed or erased (RM0090 section 3.6).
    fn stall_for_flash(&mut self) {
        let until = self.shared.stall.load(Relaxed);
        if until > self.now && (FLASH_BASE..FLASH_END).contains(&self.processor.pc()) {
            let cycles = (until - self.now).div_ceil(self.shared.cycle.load(Relaxed));
            self.processor.advance_idle_cycles(cycles, true);
            self.advance_time(cycles);
        }
    }

    /// On to the next event. The processor's clock stands; FCLK and with it SysTick go on.
    fn sleep_until_event(&mut self, end: u64) {
        while self.processor.is_asleep() && self.now < end {
            let cycle = self.shared.cycle.load(Relaxed);
            let next = self.shared.next.load(Relaxed).min(end);
            let mut cycles = next.saturating_sub(self.now).div_ceil(cycle).max(1);
            if let Some(left) = self.processor.cycles_until_systick() {
                cycles = cycles.min(left);
            }
            if self.first_sleep.is_none() {
                self.first_sleep = Some(self.now);
                // What was held off while the image began is no wait of a task.
                self.masks.clear();
                self.pended_longest.fill(0);
                self.turns = HandlerTimer::default();
                self.with_chip(|chip| chip.irq_longest.fill(0));
            }
            let woken = self.processor.advance_idle_cycles(cycles, self.watch.awake);
            self.advance_time(cycles);
            self.asleep += cycles * cycle;
            self.sleeps += 1;
            self.advance_chip();
            let interrupted = self.with_chip(|chip| chip.has_pending_interrupt());
            if woken || interrupted || self.shared.flag.load(Relaxed) & FLAG_RESET_REQUEST != 0 {
                break;
            }
        }
    }

    fn finish_step(&mut self) {
        if self.upset.0 > 0 && self.now >= self.upset.0 {
            self.processor.set_pc(self.upset.1);
            self.upset = (0, 0);
        }
        let flag = self.shared.flag.swap(0, SeqCst);
        if flag & FLAG_PROGRAMMING_CHANGED != 0 {
            let on = self.with_chip(|chip| chip.flash.is_programming());
            self.processor.set_flash_writable(on);
        }
        if flag & FLAG_NEW_FINDING != 0 {
            let pc = self.processor.pc();
            self.with_chip(|chip| chip.report.assign_pc_to_new_findings(pc));
        }
        self.checked += 1;
        if self.checked == FAULT_CHECK_INTERVAL_STEPS || flag & FLAG_RESET_REQUEST != 0 {
            self.checked = 0;
            self.handle_processor_events(flag & FLAG_RESET_REQUEST != 0);
        }
        if self.watch.log && self.now >= self.log_next {
            self.log_next = self.now + ms_to_ticks(1);
            if let Some(at) = self.log_at {
                drain_rtt_buffer(&self.memories.sram, at, &mut self.log);
            }
        }
    }

    fn handle_processor_events(&mut self, reset: bool) {
        let pc = self.processor.pc();
        if self.watch.places {
            *self.places.entry(pc).or_default() += 1;
        }
        let trouble = self.processor.take_fault_messages();
        let software = self.processor.is_reset_requested();
        let now = self.now;
        self.with_chip(|chip| {
            for text in trouble {
                chip.record_finding(Severity::Violation, text);
                chip.report.assign_pc_to_new_findings(pc);
            }
        });
        if software || reset {
            self.processor.reset();
            let lines = self.processor.interrupt_lines();
            self.with_chip(|chip| {
                chip.lines = lines;
                if software {
                    chip.resets.push((now, "software"));
                }
                // RM0090 7.3.21: SFTRSTF, and PINRSTF, which every reset of the chip sets.
                let cause =
                    if software { RCC_CSR_SFTRSTF | RCC_CSR_PINRSTF } else { chip.reset_cause };
                chip.reset(cause);
                chip.update_lines_and_next_event();
            });
            // The reset has ended programming.
            self.shared.flag.fetch_or(FLAG_PROGRAMMING_CHANGED, Relaxed);
        }
    }
}

/// Takes what the image has logged, as a probe does.
fn drain_rtt_buffer(sram: &Memory, at: u32, out: &mut Vec<u8>) {
    let at = u64::from(at - SRAM_BASE);
    let word = |offset: u64| {
        let mut bytes = [0; 4];
        sram.read_at(offset, &mut bytes).expect("in the SRAM");
        u32::from_le_bytes(bytes)
    };
    let mut id = [0; 10];
    sram.read_at(at, &mut id).expect("in the SRAM");
    let (buffer, size, write, mut read) =
        (word(at + 28), word(at + 32), word(at + 36), word(at + 40));
    let within = (SRAM_BASE..SRAM_END).contains(&buffer) && (1..SRAM_SIZE as u32).contains(&size);
    if &id != b"SEGGER RTT" || !within || write >= size || read >= size {
        return;
    }
    while read != write {
        let mut byte = [0];
        sram.read_at(u64::from(buffer - SRAM_BASE + read), &mut byte).expect("in the SRAM");
        out.push(byte[0]);
        read = (read + 1) % size;
    }
    sram.write_at(at + 40, &read.to_le_bytes()).expect("in the SRAM");
}
