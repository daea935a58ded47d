//! The stack suffices: the deepest chain of calls of every task, read from the linked image, all of them one
//! above the other, takes at most half of what there is.

use std::collections::BTreeSet;

use trueup_emulator::{
    call_graph::{CallGraph, StackDepth},
    firmware_images, setup,
};

/// Bytes of the stack (`src/board/stm32f405/mpu.rs`).
const STACK: u64 = 80 * 1024;
/// Bytes that the core puts there for an interrupt: 26 words with those of the FPU, and one that aligns it (Armv7-M
/// architecture manual, B1.5.7).
const EXCEPTION: u64 = 4 * 27;
/// The tasks, by their interrupts (`src/main.rs`), from the lowest priority on: at most one of each runs.
const PRIORITIES: [&[&str]; 10] = [
    &["EXTI1", "EXTI2"],
    &["SysTick"],
    &["TIM5"],
    &["EXTI3"],
    &["EXTI0"],
    &["DMA2_STREAM7"],
    &["CAN1_RX0", "CAN1_RX1"],
    &["DMA2_STREAM0"],
    &["USART1", "DMA2_STREAM2"],
    &["USART3"],
];
/// Counted apart. Formatting calls through pointers, and a text within a text formats again. A panic is an end:
/// the handler's own panic, which its bounds would allow it, is counted as one more.
const APART: [&str; 2] = ["core3fmt5write", "rust_begin_unwind"];
/// How deep texts stand within texts: an error, what it is made of, its number.
const TEXTS: u64 = 3;
const INIT: &str = "__rtic_init_resources";

/// Returns what calls through a pointer that is not in it: a formatter its output, an output its bytes, both counted
/// apart; `__pre_init` returns to an address that it holds in a register, because it tests the RAM.
fn is_known(name: &str) -> bool {
    name.contains("core3fmt") || name == "__pre_init"
}

#[test]
fn the_deepest_stack_takes_at_most_half_of_what_there_is() {
    let machine = setup::project_root().join("data/paper_spindle.toml");
    let graph =
        CallGraph::read(&firmware_images::build_standalone_image(&machine).unwrap()).unwrap();
    let mut blind = BTreeSet::new();
    let mut of = |name: &str, without: &[&str]| {
        let without: Vec<&str> = APART.iter().chain(without).copied().collect();
        let StackDepth { bytes, chain, blind: more } =
            graph.max_stack_depth(name, &without).unwrap();
        println!("{bytes:6} {name}, {} calls deep", chain.len());
        blind.extend(more);
        bytes
    };
    let start = of("Reset", &[]);
    let idle = of("Reset", &[INIT]);
    assert!(idle < start, "the start is a function of its own");
    let tasks: u64 = PRIORITIES
        .map(|tasks| EXCEPTION + tasks.iter().map(|task| of(task, &[])).max().unwrap_or_default())
        .iter()
        .sum();
    let traps = 2 * EXCEPTION + of("NonMaskableInt", &[]) + of("HardFault", &[]);
    let max_stack_depth_matching =
        |parts: &[&str], without: &[&str]| graph.max_stack_depth_matching(parts, without);
    let text = max_stack_depth_matching(&["core3fmt"], &APART).unwrap().bytes
        + max_stack_depth_matching(&["9write_str", "10write_char"], &APART).unwrap().bytes
        + max_stack_depth_matching(&["core3fmt5write"], &["rust_begin_unwind"]).unwrap().bytes;
    let panic =
        max_stack_depth_matching(&["rust_begin_unwind"], &APART[..1]).map(|depth| depth.bytes);
    let apart = TEXTS * text + 2 * panic.unwrap_or_default();
    let unknown: Vec<_> = blind.iter().filter(|name| !is_known(name)).collect();
    assert!(unknown.is_empty(), "they call what nobody has looked at: {unknown:?}");

    // Interrupts are off during the start.
    let start = start + traps + apart;
    let running = idle + tasks + traps + apart;
    println!("of {STACK} bytes the start takes {start} at most, all tasks at once {running}");
    assert!(start <= STACK / 2 && running <= STACK / 2);
    // A graph that sees nothing would pass.
    assert!(start > 4_096 && running > 4_096);
}
