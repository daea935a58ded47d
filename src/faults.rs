//! A board that breaks on command (feature `faults`): for the tests of what becomes of it, never for a machine.
//!
//! The key is a word of RAM that a debugger, or the model of the chip, writes: the number of a task, which then hangs
//! in its next turn, or one of those in [`inject_fault`], which the supervisor does.

use core::{
    arch::asm,
    hint::black_box,
    ptr::{read_volatile, write_volatile},
    sync::atomic::{AtomicU32, Ordering},
};

#[unsafe(export_name = "TRUEUP_FAULT_KEY")]
#[allow(unsafe_code, reason = "a name that the tests know")]
static FAULT_KEY: AtomicU32 = AtomicU32::new(0);

/// The task with that number hangs, if it is the key.
#[inline(never)]
pub fn hang_if_selected(task: u32) {
    while FAULT_KEY.load(Ordering::Relaxed) == task {}
}

/// Does what the key says, once.
#[inline(never)]
#[allow(unsafe_code, reason = "what no code should do, on purpose")]
pub fn inject_fault() {
    let key = FAULT_KEY.load(Ordering::Relaxed);
    if key < 32 {
        return;
    }
    FAULT_KEY.store(0, Ordering::Relaxed);
    // SAFETY: none of this is sound; each ends this start, which is what it is for.
    unsafe {
        match key {
            32 => panic!("on purpose"),
            33 => asm!("udiv {0}, {0}, {1}", inout(reg) 1 => _, in(reg) 0),
            34 => _ = read_volatile(0x3000_0000 as *const u32),
            35 => asm!("ldrd {0}, {1}, [{2}]", out(reg) _, out(reg) _, in(reg) 0x2000_0001),
            36 => overflow_stack(0),
            37 => _ = read_volatile(black_box(0x10) as *const u32),
            38 => write_volatile(0x0808_0000 as *mut u32, 0),
            39 => write_volatile(0x0800_0000 as *mut u32, 0),
            40 => execute_from_ram(),
            41 => asm!("udf #0"),
            _ => {}
        }
    }
}

/// Calls itself until there is no more stack.
#[inline(never)]
fn overflow_stack(depth: u32) {
    let mut room = [depth; 16];
    if black_box(&mut room)[0] < u32::MAX {
        overflow_stack(depth + 1);
    }
    black_box(&mut room);
}

#[allow(unsafe_code, reason = "what no code should do, on purpose")]
unsafe fn execute_from_ram() {
    // BX LR.
    static RAM_CODE: AtomicU32 = AtomicU32::new(0x4770_4770);
    let entry = RAM_CODE.as_ptr() as usize | 1;
    // SAFETY: it is not run: the memory protection forbids it.
    let function: extern "C" fn() = unsafe { core::mem::transmute(entry) };
    function();
}
