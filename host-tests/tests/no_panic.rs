//! No panic can be reached from what the board does every millisecond, nor from what it does with
//! a frame of the CNC or of a CANopen master, or with a block of a PLC.
//!
//! Shown on the images that are flashed and booted, after the linker: no chain of calls leads from
//! `Node::tick`, `Node::receive`, `Node::service`, `Node::input_block`, `Node::receive_block` or `Node::receive_command` to a function of the
//! panic machinery, to a trap, or to a call through a pointer, behind which anything could stand. So no input whatever (nor a
//! calibration that was loaded) makes them stop there. This does not show that the values are
//! right, that loops end, that the stack suffices; the first two are for the property tests of the
//! core.

use trueup_emulator::{
    call_graph::CallGraph,
    firmware_images::{self, Board},
};

/// Returns what is called with what comes from outside. The virtual board has no line for a PLC.
fn entries(board: Board) -> &'static [&'static str] {
    match board {
        Board::Stm32f405 => {
            const PLC: [&str; 3] =
                ["Node$GT$11input_block", "Node$GT$13receive_block", "Node$GT$15receive_command"];
            &["4Node4tick", "4Node7receive", "4Node18next_service_frame", PLC[0], PLC[1], PLC[2]]
        }
        Board::Virtual => &["4Node4tick", "4Node7receive", "4Node18next_service_frame"],
    }
}

#[test]
fn no_panic_can_be_reached_from_a_tick_or_a_frame() {
    for board in Board::ALL {
        let image = firmware_images::build_board_image(board).unwrap();
        let graph = CallGraph::read(&image).unwrap();
        for entry in entries(board) {
            let reached = graph.reachable_from(entry).unwrap();
            println!(
                "{}: {entry} reaches {} functions",
                board.cargo_feature(),
                reached.names.len()
            );
            assert_eq!(
                reached.potential_panic_sources(),
                [""; 0],
                "{entry} in {}",
                image.display()
            );
        }
    }
}

#[test]
fn a_panic_that_is_there_is_seen() {
    // The benchmark's own `main` has `expect`s.
    let graph = CallGraph::read(&firmware_images::build_benchmark_image().unwrap()).unwrap();
    let reached = graph.reachable_from("__cortex_m_rt_main").unwrap();
    assert!(reached.names.iter().any(|name| name.contains("panic")), "{:?}", reached.names);
}
