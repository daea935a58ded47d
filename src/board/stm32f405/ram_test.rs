//! The test of the RAM, before anything in it is used: MATS+ (van de Goor), which finds every cell that is
//! stuck and every fault of the address decoder.
//!
//! | step | direction | each word |
//! |---|---|---|
//! | 1 | | write the paint |
//! | 2 | up | read the paint, write its complement |
//! | 3 | down | read the complement, write the paint |
//!
//! It spares what outlasts a reset (`.uninit`, and up to 15 bytes on either side), and leaves the
//! paint, by which the stack's high-water mark is found later ([`super::stack`]). It takes 25 ms of the
//! internal oscillator. Nothing else can run yet, so it is written for the core's registers alone. It does
//! not find cells of one word that influence each other, nor what fails later.

#![allow(
    unsafe_code,
    reason = "it runs before anything that Rust knows, and in the core's registers alone"
)]

use core::{
    arch::global_asm,
    mem::MaybeUninit,
    sync::atomic::{AtomicU32, Ordering},
};

/// Content of the RAM after the test, until it is written.
pub const STACK_PAINT_PATTERN: u32 = 0xCCCC_CCCC;

/// An address that failed, to 16 bytes; 0: none did.
#[unsafe(link_section = ".uninit.ram_test")]
static FAILED_ADDRESS: MaybeUninit<AtomicU32> = MaybeUninit::uninit();

/// Returns an address that failed, to 16 bytes, if one did.
pub fn failed_address() -> Option<u32> {
    // SAFETY: any bits are a value of it, and the test has written it.
    let address = unsafe { FAILED_ADDRESS.assume_init_ref() }.load(Ordering::Relaxed);
    (address != 0).then_some(address)
}

global_asm!(
    // The two pieces of the RAM: below what is spared, and above it. Four words at a time. r0: address; r1: end;
    // r2: the last failure; r3: where to return; r4 to r7: the paint; r12: its complement; r8 to r11: what was read.
    ".macro ram_pieces step
        ldr r0, =_ram_start
        ldr r1, =__suninit
        bic r1, r1, #15
        \\step
        ldr r0, =__euninit
        add r0, r0, #15
        bic r0, r0, #15
        ldr r1, =_stack_start
        \\step
    .endm
    .macro ram_pieces_down step
        ldr r1, =__euninit
        add r1, r1, #15
        bic r1, r1, #15
        ldr r0, =_stack_start
        \\step
        ldr r1, =_ram_start
        ldr r0, =__suninit
        bic r0, r0, #15
        \\step
    .endm
    .macro ram_paint
    1:  cmp r0, r1
        bhs 2f
        stmia r0!, {{r4-r7}}
        b 1b
    2:
    .endm
    .macro ram_up
    1:  cmp r0, r1
        bhs 2f
        ldmia r0, {{r8-r11}}
        cmp r8, r4
        ittt eq
        cmpeq r9, r4
        cmpeq r10, r4
        cmpeq r11, r4
        bne 3f
        mvn r8, r4
        mov r9, r8
        mov r10, r8
        mov r11, r8
        stmia r0!, {{r8-r11}}
        b 1b
    3:  mov r2, r0
        adds r0, r0, #16
        b 1b
    2:
    .endm
    .macro ram_down
    1:  cmp r0, r1
        bls 2f
        ldmdb r0!, {{r8-r11}}
        cmp r8, r12
        ittt eq
        cmpeq r9, r12
        cmpeq r10, r12
        cmpeq r11, r12
        it ne
        movne r2, r0
        stmia r0, {{r4-r7}}
        b 1b
    2:
    .endm
    .section .text.__pre_init, \"ax\"
    .global __pre_init
    .type __pre_init, %function
    .thumb_func
    __pre_init:
        mov r3, lr
        ldr r4, ={paint}
        mov r5, r4
        mov r6, r4
        mov r7, r4
        mvn r12, r4
        movs r2, #0
        ram_pieces ram_paint
        ram_pieces ram_up
        ram_pieces_down ram_down
        ldr r0, ={failed}
        str r2, [r0]
        bx r3
        .ltorg
    .size __pre_init, . - __pre_init",
    paint = const STACK_PAINT_PATTERN,
    failed = sym FAILED_ADDRESS,
);
