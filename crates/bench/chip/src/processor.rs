//! The processor, and the only file that names its crate: another Cortex-M4F can take its place here.
//!
//! The rest needs little of it: step, sleep, stand still, interrupt lines, and memories that it
//! shares with the DMA. It is `rsemu`'s (Thumb-2, DSP, FPv4-SP, NVIC, SysTick, DWT's cycle counter).

use crate::memory_map::*;
use rsemu::core::space::{
    AccessConstraints, AddressSpace, MappingId, MemAttrs, MemOps, MemResult, Perms, RamStore,
    Region,
};
use rsemu::core::value::Width;
use rsemu::cpu::arm::v7m::{ArmV7m, Config, sys::Exception};
use std::fmt;
use std::sync::Arc;

/// Bytes that the processor and the DMA both reach: `read_at`, `write_at`, `fill`.
pub type Memory = RamStore;

/// Bytes of the flash.
pub const FLASH_SIZE: u64 = 0x10_0000;
/// Bytes of the SRAM on the bus matrix.
pub const SRAM_SIZE: u64 = 0x2_0000;
const CCM_SIZE: u64 = 0x1_0000;
const SYSTEM_MEMORY_SIZE: u64 = 0x1_0000;
/// Where the peripherals are: base and length.
const PERIPHERAL_REGIONS: [(u32, u64); 3] =
    [(PERIPHERAL_BASE, 0x8_0000), (AHB2_PERIPHERAL_BASE, 0x6_1000), (DBGMCU_BASE, 0x400)];

/// The bits of xPSR that hold the state of an IT block (Armv7-M, B1.4.2).
const IT_STATE_MASK: u32 = 0x0600_fc00;
/// SYST_CSR, ENABLE: SysTick counts (Armv7-M, B3.3.3).
const SYST_CSR_ENABLE: u32 = 1 << 0;
/// SYST_CSR, TICKINT: SysTick raises its exception at 0.
const SYST_CSR_TICKINT: u32 = 1 << 1;
/// SYST_CVR, CURRENT: the 24 bits of the counter.
const SYST_CVR_CURRENT_MASK: u32 = 0xff_ffff;

/// A byte of the flash that is erased.
const ERASED_BYTE: u8 = 0xff;
/// A byte of the SRAM before anything is written to it: a choice of the model.
const SRAM_FILL_BYTE: u8 = 0xa5;

/// Exceptions that no unit of the chip raises while its lines are not used, but its program does: name and number (Armv7-M,
/// B1.5.2; RM0090 table 62).
pub const MONITORED_EXCEPTIONS: [(&str, u16); 6] =
    [("SysTick", 15), ("EXTI0", 22), ("EXTI1", 23), ("EXTI2", 24), ("EXTI3", 25), ("EXTI4", 26)];

/// Who answers the processor beyond its memories.
pub trait PeripheralBus: Send + Sync {
    /// Reads 1, 2 or 4 bytes.
    fn read(&self, address: u32, size: u32) -> u32;
    /// A write of 1, 2 or 4 bytes.
    fn write(&self, address: u32, size: u32, value: u32);
    /// A write into the flash, at an offset, while it may be programmed.
    fn program(&self, offset: u32, bytes: &[u8]);
}

struct PeripheralWindow {
    base: u32,
    behind: Arc<dyn PeripheralBus>,
}

struct FlashArray {
    behind: Arc<dyn PeripheralBus>,
    store: Arc<Memory>,
}

impl fmt::Debug for PeripheralWindow {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("peripherals")
    }
}

impl fmt::Debug for FlashArray {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("flash")
    }
}

impl MemOps for PeripheralWindow {
    fn read(&self, offset: u64, to: &mut [u8], _: MemAttrs) -> MemResult {
        let value = self.behind.read(self.base + offset as u32, to.len() as u32);
        to.copy_from_slice(&value.to_le_bytes()[..to.len()]);
        Ok(())
    }

    fn write(&self, offset: u64, from: &[u8], _: MemAttrs) -> MemResult {
        let mut word = [0; 4];
        word[..from.len()].copy_from_slice(from);
        self.behind.write(self.base + offset as u32, from.len() as u32, u32::from_le_bytes(word));
        Ok(())
    }
}

/// A word of the SRAM whose lowest bit is stuck at 1.
struct StuckBitWord {
    store: Arc<Memory>,
    base: u64,
}

impl fmt::Debug for StuckBitWord {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("stuck")
    }
}

impl MemOps for StuckBitWord {
    fn read(&self, offset: u64, to: &mut [u8], _: MemAttrs) -> MemResult {
        self.store.read_at(self.base + offset, to)?;
        if offset == 0 {
            to[0] |= 1;
        }
        Ok(())
    }

    fn write(&self, offset: u64, from: &[u8], _: MemAttrs) -> MemResult {
        self.store.write_at(self.base + offset, from)
    }

    fn constraints(&self) -> AccessConstraints {
        AccessConstraints::ANY
    }
}

impl MemOps for FlashArray {
    fn read(&self, offset: u64, to: &mut [u8], _: MemAttrs) -> MemResult {
        self.store.read_at(offset, to)
    }

    fn write(&self, offset: u64, from: &[u8], _: MemAttrs) -> MemResult {
        self.behind.program(offset as u32, from);
        Ok(())
    }

    fn constraints(&self) -> AccessConstraints {
        AccessConstraints::ANY
    }
}

/// The interrupt lines into the processor.
pub struct InterruptLines(Arc<ArmV7m>);

impl InterruptLines {
    /// Line `number`, 0 to 81.
    pub fn set_interrupt_line(&self, number: u16, on: bool) {
        self.0.set_irq(number, on);
    }

    /// The line that cannot be masked.
    pub fn set_nmi_line(&self, on: bool) {
        self.0.set_nmi(on);
    }
}

/// The memories of the chip.
#[derive(Clone)]
pub struct Memories {
    /// The flash, 1 MB, erased.
    pub flash: Arc<Memory>,
    /// The SRAM of the bus matrix, with what it may hold at power-on.
    pub sram: Arc<Memory>,
}

impl Memories {
    /// As from the factory.
    #[must_use]
    pub fn new() -> Memories {
        let flash = Arc::new(Memory::new(FLASH_SIZE));
        let sram = Arc::new(Memory::new(SRAM_SIZE));
        flash.fill(0, FLASH_SIZE, ERASED_BYTE).expect("all of it");
        sram.fill(0, SRAM_SIZE, SRAM_FILL_BYTE).expect("all of it");
        Memories { flash, sram }
    }
}

impl Default for Memories {
    fn default() -> Memories {
        Memories::new()
    }
}

/// Returns the system memory: the identity of this chip (RM0090 section 39.1), the size of its flash, and the
/// factory's calibration of the converter (DS8626, internal reference voltage calibration values: VREFINT at 3.3 V).
fn build_system_memory() -> Memory {
    const UNIQUE_DEVICE_ID: [u8; 12] =
        [0x31, 0, 0x2a, 0, 0x0b, 0x47, 0x33, 0x32, 0x36, 0x35, 0x39, 0x35];
    const VREFINT_CAL: u16 = 1502;
    const FLASH_KILOBYTES: u16 = 1024;
    /// Offsets in the system memory: the identity (39.1), the size of the flash (39.2), the calibration (DS8626).
    const UNIQUE_DEVICE_ID_OFFSET: u64 = 0x7a10;
    const FLASH_SIZE_OFFSET: u64 = 0x7a22;
    const VREFINT_CAL_OFFSET: u64 = 0x7a2a;
    let system = Memory::new(SYSTEM_MEMORY_SIZE);
    system.fill(0, SYSTEM_MEMORY_SIZE, ERASED_BYTE).expect("all of it");
    system.write_at(UNIQUE_DEVICE_ID_OFFSET, &UNIQUE_DEVICE_ID).expect("within");
    system.write_at(FLASH_SIZE_OFFSET, &FLASH_KILOBYTES.to_le_bytes()).expect("within");
    system.write_at(VREFINT_CAL_OFFSET, &VREFINT_CAL.to_le_bytes()).expect("within");
    system
}

/// A Cortex-M4F with its memory map.
pub struct Processor {
    core: Arc<ArmV7m>,
    space: Arc<AddressSpace>,
    /// The flash as it is while it may be programmed: it sees writes. Otherwise it is fast and read-only.
    writable: Arc<Region>,
    over: Option<MappingId>,
    bus_faults: u64,
}

fn create_core(space: &Arc<AddressSpace>) -> Arc<ArmV7m> {
    let mut settings = Config::CORTEX_M4F;
    settings.priority_bits = 4;
    let core = Arc::new(ArmV7m::new(settings));
    core.attach_space(space.clone());
    core
}

impl Processor {
    /// Out of reset, with the boot pin low: the flash begins at 0 as well.
    pub fn new(memories: &Memories, behind: Arc<dyn PeripheralBus>) -> Processor {
        let space = AddressSpace::new("f405", 32);
        let array = FlashArray { behind: behind.clone(), store: memories.flash.clone() };
        let writable = Arc::new(Region::io("flash", FLASH_SIZE, Arc::new(array)));
        {
            let mut map = space.topology();
            let flash = |name| Region::ram(name, memories.flash.clone());
            map.map_with_perms(flash("boot"), 0, Perms::RX).expect("free");
            map.map_with_perms(flash("flash"), FLASH_BASE.into(), Perms::RX).expect("free");
            let ccm = Region::ram("ccm", Arc::new(Memory::new(CCM_SIZE)));
            map.map(ccm, CCM_BASE.into()).expect("free");
            let system = Region::ram("system", Arc::new(build_system_memory()));
            map.map(system, SYSTEM_MEMORY_BASE.into()).expect("free");
            map.map(Region::ram("sram", memories.sram.clone()), SRAM_BASE.into()).expect("free");
            for (base, length) in PERIPHERAL_REGIONS {
                let window = PeripheralWindow { base, behind: behind.clone() };
                let region = Region::io("peripherals", length, Arc::new(window));
                map.map(region, base.into()).expect("free");
            }
        }
        let space = Arc::new(space);
        Processor { core: create_core(&space), space, writable, over: None, bus_faults: 0 }
    }

    /// Its interrupt lines; those of before a reset lead nowhere.
    #[must_use]
    pub fn interrupt_lines(&self) -> InterruptLines {
        InterruptLines(self.core.clone())
    }

    /// A reset: registers as the manual has them, memories as they are.
    pub fn reset(&mut self) {
        self.core = create_core(&self.space);
        self.bus_faults = 0;
    }

    /// Executes one instruction or one exception. Returns where it was, and its cycles.
    #[must_use]
    pub fn step(&self) -> (u32, u64) {
        let before = self.core.regs();
        let cycles = self.core.step();
        let (pc, it_state) = (before.r[15], before.xpsr & IT_STATE_MASK);
        if it_state != 0 {
            self.patch_stacked_it_state(pc, it_state);
        }
        (pc, cycles)
    }

    /// Puts the state of an IT block into the frame of an exception that has come before the instruction at `pc`. 0.0.7 of the
    /// crate takes it from there at the return and does not put it in: the rest of the block would have no condition
    /// (Armv7-M, B1.5.6).
    fn patch_stacked_it_state(&self, pc: u32, it_state: u32) {
        const STACKED_RETURN_ADDRESS_OFFSET: u32 = 24;
        const STACKED_XPSR_OFFSET: u32 = 28;
        const EXC_RETURN_PSP: u32 = 1 << 2;
        /// The upper four bits of an EXC_RETURN (Armv7-M, B1.5.8).
        const EXC_RETURN_PREFIX: u32 = 0xf;
        let after = self.core.regs();
        let exc_return = after.r[14];
        if after.exception() == Exception::THREAD || exc_return >> 28 != EXC_RETURN_PREFIX {
            return;
        }
        let frame = if exc_return & EXC_RETURN_PSP == 0 { after.msp } else { after.psp };
        let attributes = MemAttrs::DEFAULT;
        let read = |offset: u32| self.space.read(u64::from(frame + offset), Width::U32, attributes);
        // Otherwise the instruction was done: a return into an outer handler, or the last of its block.
        if read(STACKED_RETURN_ADDRESS_OFFSET) == Ok(pc.into())
            && let Ok(stacked) = read(STACKED_XPSR_OFFSET)
        {
            let whole = stacked | u64::from(it_state);
            let _ = self.space.write(
                u64::from(frame + STACKED_XPSR_OFFSET),
                Width::U32,
                whole,
                attributes,
            );
        }
    }

    /// Has it go on at another place, as an upset would.
    pub fn set_pc(&self, pc: u32) {
        self.core.set_pc(pc);
    }

    /// Sets the table of its vectors, as a program that ran before would have.
    pub fn set_vector_table(&self, address: u32) {
        self.core.with_sys(|system| system.vtor = address);
    }

    /// Where it is.
    #[must_use]
    pub fn pc(&self) -> u32 {
        self.core.pc()
    }

    /// Returns whether interrupts are held off by PRIMASK.
    #[must_use]
    pub fn are_interrupts_masked(&self) -> bool {
        self.core.regs().primask
    }

    /// Returns whether each exception of [`MONITORED_EXCEPTIONS`] is pending: raised, and its handler not yet begun.
    #[must_use]
    pub fn exception_pending_flags(&self) -> [bool; MONITORED_EXCEPTIONS.len()] {
        self.core.with_sys(|system| {
            MONITORED_EXCEPTIONS.map(|(_, number)| system.is_pending(Exception(number)))
        })
    }

    /// Returns the number of the exception that is handled; 0: none.
    #[must_use]
    pub fn active_exception(&self) -> u16 {
        self.core.current_exception().0
    }

    /// Returns whether the handler of an exception has begun and not ended.
    #[must_use]
    pub fn is_active(&self, exception: u16) -> bool {
        self.core.with_sys(|system| system.is_active(Exception(exception)))
    }

    /// Returns whether it waits for an interrupt.
    #[must_use]
    pub fn is_asleep(&self) -> bool {
        self.core.is_asleep()
    }

    /// Lets cycles go by in which no instruction is done. `counted`: CYCCNT counts them.
    /// Gives whether SysTick has come.
    pub fn advance_idle_cycles(&self, cycles: u64, counted: bool) -> bool {
        self.core.with_sys(|system| {
            if counted {
                system.tick_cyccnt(cycles);
            }
            let ticked = system.tick_systick(cycles) && system.syst_csr & SYST_CSR_TICKINT != 0;
            if ticked {
                system.set_pending(Exception::SYSTICK, true);
            }
            ticked
        })
    }

    /// Cycles until SysTick comes, if it runs and interrupts.
    #[must_use]
    pub fn cycles_until_systick(&self) -> Option<u64> {
        self.core.with_sys(|system| {
            let left = u64::from(system.syst_cvr & SYST_CVR_CURRENT_MASK).max(1);
            (system.syst_csr & (SYST_CSR_TICKINT | SYST_CSR_ENABLE)
                == SYST_CSR_TICKINT | SYST_CSR_ENABLE)
                .then_some(left)
        })
    }

    /// Returns whether it has asked for a reset (SYSRESETREQ).
    #[must_use]
    pub fn is_reset_requested(&self) -> bool {
        self.core.reset_requested()
    }

    /// Has the lowest bit of a word of the SRAM stuck at 1, as the processor sees it.
    pub fn inject_stuck_bit(&self, memories: &Memories, address: u32) {
        let stuck =
            StuckBitWord { store: memories.sram.clone(), base: u64::from(address - SRAM_BASE) };
        let region = Arc::new(Region::io("stuck", 4, Arc::new(stuck)));
        let mut map = self.space.topology();
        map.map_with_priority(region, u64::from(address), 1).expect("in the SRAM");
    }

    /// Lets it write into the flash, or not.
    pub fn set_flash_writable(&mut self, on: bool) {
        let mut map = self.space.topology();
        match (on, self.over.take()) {
            (true, None) => {
                let over = map.map_with_priority(self.writable.clone(), FLASH_BASE.into(), 1);
                self.over = Some(over.expect("its own place"));
            }
            (false, Some(over)) => {
                map.unmap(over).expect("it is mapped");
            }
            (_, over) => self.over = over,
        }
    }

    /// Returns what has gone wrong in it since the last time.
    pub fn take_fault_messages(&mut self) -> Vec<String> {
        let mut messages = Vec::new();
        let (count, address) = self.core.bus_faults();
        if count != self.bus_faults {
            self.bus_faults = count;
            messages.push(format!("bus fault at {address:#010x}"));
        }
        if self.core.is_locked_up() {
            messages.push("the processor is locked up".into());
        }
        const FAULT_EXCEPTIONS: [Exception; 4] = [
            Exception::HARD_FAULT,
            Exception::BUS_FAULT,
            Exception::USAGE_FAULT,
            Exception::MEM_MANAGE,
        ];
        if FAULT_EXCEPTIONS.contains(&self.core.current_exception()) {
            messages.push(self.core.with_sys(|system| {
                format!(
                    "a fault handler runs: CFSR {:#x}, HFSR {:#x}, BFAR {:#x}",
                    system.cfsr, system.hfsr, system.bfar
                )
            }));
        }
        messages
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Nobody;

    impl PeripheralBus for Nobody {
        fn read(&self, _: u32, _: u32) -> u32 {
            0
        }

        fn write(&self, _: u32, _: u32, _: u32) {}

        fn program(&self, _: u32, _: &[u8]) {}
    }

    /// A loop around an IT block whose four instructions must not be done, and SysTick, which comes at each place of it.
    #[test]
    fn an_exception_within_an_it_block_leaves_the_condition_of_the_rest() {
        const PROGRAM: [u16; 11] = [
            0x2001, // movs r0, #1
            0x2100, // movs r1, #0
            0x2200, // movs r2, #0
            0x2800, // loop: cmp r0, #0
            0xbf01, // itttt eq
            0x3101, 0x3101, 0x3101, 0x3101, // addeq r1, #1
            0x3201, // adds r2, #1
            0xe7f7, // b loop
        ];
        const HANDLER: [u16; 2] = [0x3401, 0x4770]; // adds r4, #1; bx lr
        let memories = Memories::new();
        let put = |at: u64, bytes: &[u8]| memories.flash.write_at(at, bytes).expect("within");
        let words =
            |halves: &[u16]| halves.iter().flat_map(|half| half.to_le_bytes()).collect::<Vec<_>>();
        put(0, &0x2000_1000_u32.to_le_bytes());
        put(4, &0x101_u32.to_le_bytes());
        put(15 * 4, &0x141_u32.to_le_bytes());
        put(0x100, &words(&PROGRAM));
        put(0x140, &words(&HANDLER));
        let processor = Processor::new(&memories, Arc::new(Nobody));
        let _ = processor.step();
        processor.core.with_sys(|system| (system.syst_rvr, system.syst_csr) = (40, 0b111));
        for _ in 0..20_000 {
            let _ = processor.step();
        }
        let [_, done, rounds, _, ticks, ..] = processor.core.regs().r;
        assert!(rounds > 500 && ticks > 500, "{rounds} rounds, {ticks} exceptions");
        assert_eq!(done, 0, "instructions whose condition does not hold, in {rounds} rounds");
    }
}
