//! The memory protection unit of the core (Armv7-M manual, B3.5): what no task may do ends in a fault.
//!
//! | region | may be | so that |
//! |---|---|---|
//! | 0x0000_0000, 128 MB | nothing | a null pointer is no memory |
//! | flash, the image | read and run | the image is never written |
//! | flash, the store | read | nothing but [`with_store_writable`] writes to it |
//! | flash, the other firmware slot, its records | read | nothing but an update writes to it |
//! | RAM | read and written | data are never run |
//! | 8 KB below the stack | nothing | a stack that overflows stops before it reaches a variable |
//!
//! Memory outside of these is as without it. Faults themselves run without it, so that one on a full
//! stack can still be reported. A later region counts where two overlap.

use core::ops::Range;

use cortex_m::{
    asm,
    peripheral::{MPU, mpu::RegisterBlock},
};

/// The guard below the stack: below [`STACK_RANGE`], and above all variables (`guard.x`).
pub const STACK_GUARD_RANGE: Range<u32> = 0x2000_A000..0x2000_C000;
/// The stack; in a slot its last 16 bytes are what the boot program hands over.
pub const STACK_RANGE: Range<u32> = 0x2000_C000..0x2002_0000;

/// MpuRegion of the store.
const STORE_REGION: MpuRegion = MpuRegion {
    number: 2,
    start: 0x0808_0000,
    log2_size: 19,
    attributes: READ_ONLY | EXECUTE_NEVER,
};
const MPU_REGIONS: [MpuRegion; 5] = [
    MpuRegion { number: 0, start: 0, log2_size: 27, attributes: EXECUTE_NEVER },
    MpuRegion { number: 1, start: 0x0800_0000, log2_size: 20, attributes: READ_ONLY },
    STORE_REGION,
    MpuRegion {
        number: 3,
        start: 0x2000_0000,
        log2_size: 17,
        attributes: READ_WRITE | EXECUTE_NEVER | SHAREABLE,
    },
    MpuRegion {
        number: 4,
        start: STACK_GUARD_RANGE.start,
        log2_size: 13,
        attributes: EXECUTE_NEVER,
    },
];
const _: () = assert!(
    STACK_GUARD_RANGE.end - STACK_GUARD_RANGE.start == 1 << 13
        && STACK_GUARD_RANGE.end == STACK_RANGE.start
);

/// AP 6: read by everybody; C: as flash is cached.
const READ_ONLY: u32 = 6 << 24 | 1 << 17;
/// AP 1: read and written by privileged code, which all of this is.
const READ_WRITE: u32 = 1 << 24 | 1 << 17;
const SHAREABLE: u32 = 1 << 18;
/// XN.
const EXECUTE_NEVER: u32 = 1 << 28;
/// ENABLE and PRIVDEFENA.
const CTRL_ENABLE_PRIVDEFENA: u32 = 1 | 1 << 2;

struct MpuRegion {
    number: u32,
    start: u32,
    /// At least 5; `start` is a multiple of the size.
    log2_size: u32,
    attributes: u32,
}

impl MpuRegion {
    /// Sets it at once: what comes next is held to it.
    #[allow(unsafe_code, reason = "registers of the core")]
    fn apply(&self, mpu: &RegisterBlock) {
        // SAFETY: the regions leave every task what it uses; the start of this one is aligned to its size.
        unsafe {
            mpu.rbar.write(self.start | 1 << 4 | self.number);
            mpu.rasr.write(self.attributes | (self.log2_size - 1) << 1 | 1);
        }
        asm::dsb();
        asm::isb();
    }
}

/// Switches it on.
#[allow(unsafe_code, reason = "registers of the core")]
pub fn enable(mpu: &MPU) {
    MPU_REGIONS.iter().for_each(|region| region.apply(mpu));
    // SAFETY: as above.
    unsafe { mpu.ctrl.write(CTRL_ENABLE_PRIVDEFENA) };
    asm::dsb();
    asm::isb();
}

/// The records of the firmware slots: sectors 2 and 3.
#[cfg(feature = "slots")]
const SLOT_JOURNAL_REGION: MpuRegion = MpuRegion {
    number: 5,
    start: trueup_boot::flash_layout::JOURNAL_START,
    log2_size: 15,
    attributes: READ_ONLY | EXECUTE_NEVER,
};

/// Does `work`, which may write to the records of the firmware slots.
#[cfg(feature = "slots")]
#[allow(unsafe_code, reason = "registers of the core")]
pub fn with_slot_journal_writable<R>(work: impl FnOnce() -> R) -> R {
    // SAFETY: as for the store: this region is changed only here, and by one task.
    let mpu = unsafe { &*MPU::PTR };
    MpuRegion { attributes: READ_WRITE | EXECUTE_NEVER, ..SLOT_JOURNAL_REGION }.apply(mpu);
    let result = work();
    SLOT_JOURNAL_REGION.apply(mpu);
    result
}

/// Does `work`, which may write to the slot that does not run, and to the records.
#[cfg(feature = "slots")]
#[allow(unsafe_code, reason = "registers of the core")]
pub fn with_slot_writable<R>(
    spare: trueup_boot::flash_layout::Slot,
    work: impl FnOnce() -> R,
) -> R {
    use trueup_boot::flash_layout::{FLASH_START, Slot};
    /// Eighths of 32 KB that do not belong to the region: boot program and records lie below slot A.
    const BOOT_SUBREGIONS_DISABLED: u32 = 0b11 << 8;
    let (start, without) = match spare {
        Slot::A => (FLASH_START, BOOT_SUBREGIONS_DISABLED),
        Slot::B => (Slot::B.start(), 0),
    };
    let slot = |attributes| MpuRegion { number: 6, start, log2_size: 18, attributes };
    // SAFETY: as for the store; nothing that runs lies in this slot.
    let mpu = unsafe { &*MPU::PTR };
    slot(READ_WRITE | EXECUTE_NEVER | without).apply(mpu);
    let result = with_slot_journal_writable(work);
    slot(READ_ONLY | EXECUTE_NEVER | without).apply(mpu);
    result
}

/// Does `work`, which may write to the store.
#[allow(unsafe_code, reason = "registers of the core")]
pub fn with_store_writable<R>(work: impl FnOnce() -> R) -> R {
    // SAFETY: after the start only the region of the store is changed, only here, and by one task.
    let mpu = unsafe { &*MPU::PTR };
    MpuRegion { attributes: READ_WRITE | EXECUTE_NEVER, ..STORE_REGION }.apply(mpu);
    let result = work();
    STORE_REGION.apply(mpu);
    result
}
