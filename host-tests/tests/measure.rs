//! The board computes what the host computes, in few instructions.

use std::{collections::BTreeSet, path::Path};

use trueup_emulator::benchmark;
use trueup_machine::{MachineFile, compile};
use trueup_node::test_vectors::{TestVectorRunner, VECTORS_PER_FAULT_CYCLE};

#[test]
fn board_and_host_send_the_same_frames_and_a_tick_takes_few_instructions() {
    let measured = benchmark::run_benchmark(VECTORS_PER_FAULT_CYCLE).unwrap();
    println!("{}", measured.table);
    assert!(measured.identical);
    assert_eq!(measured.json["host_vectors_identical"], VECTORS_PER_FAULT_CYCLE);
    let number = |pointer: &str| measured.json.pointer(pointer).unwrap().as_u64().unwrap();
    // What watches every source, in use or not, costs some seventy of them, the run-out some twenty.
    assert!(number("/tick_instructions/median") <= 1_680);
    assert!(number("/tick_instructions/max") <= 2_260);
    // Four terms by tool and condition.
    let [with, without] =
        ["/tick_by_tool_instructions/median", "/tick_instructions/median"].map(number);
    assert!(with - without <= 150, "{with} {without}");
    assert!(number("/millisecond_instructions/median") <= 5_300);
    assert!(number("/millisecond_instructions/max") <= 6_700);
    // All nine angles as curves, and two rotary axes under the workpiece.
    assert!(number("/millisecond_volume_instructions/median") <= 6_200);
    let [with, without] = ["/parts/moved_volume", "/parts/moved"].map(number);
    assert!(with - without <= 600, "{with} {without}");
    assert!(number("/spline_eval/ours") <= 40);
    assert!(number("/spline_eval/ours_max") <= 56);
}

#[test]
fn the_vectors_lead_through_every_quality() {
    let gantry = Path::new(env!("CARGO_MANIFEST_DIR")).join("../data/gantry.toml");
    let machine = compile(&MachineFile::read(&gantry).unwrap()).unwrap();
    let mut run = TestVectorRunner::new(machine.calibration(), 1, true);
    let qualities: BTreeSet<u8> = (0..VECTORS_PER_FAULT_CYCLE)
        .map(|_| {
            run.draw_vector();
            run.receive();
            run.tick();
            run.node().last_output().quality as u8
        })
        .collect();
    println!("qualities: {qualities:?}");
    // The warm-up model (3) is behind a thermometer that would have to fail with the sensor.
    assert!([0, 1, 2, 4, 5, 6].iter().all(|quality| qualities.contains(quality)));
}
