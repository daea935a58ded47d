//! The random inputs of a node are what they are for: each fault is among them, each for long enough to be
//! seen, and between them all is well.
#![allow(clippy::arithmetic_side_effects)]

mod sensor_bridge;

use sensor_bridge::calibration;
use trueup_canopen::{
    dictionary::EntryContent,
    sdo::{ObjectAccess, ObjectValue},
};
use trueup_core::{
    bridge::Reference,
    cnc::{Flags, Quality},
};
use trueup_node::test_vectors::{FAULT_CYCLE_VECTORS, TestVectorRunner};

/// Returns what is seen of the faults in a millisecond: the CNC is lost, the sensor is dead, no offset is followed,
/// there is no temperature.
fn seen(run: &TestVectorRunner<'_>) -> [bool; 4] {
    let last = run.node().last_output();
    [
        last.flags.contains(Flags::CNC_LOST),
        last.flags.contains(Flags::SENSOR_FAULT),
        last.quality == Quality::Off && !last.flags.contains(Flags::CNC_LOST),
        run.node().read(EntryContent::InputStatus(2)) == Ok(ObjectValue::Number(1)),
    ]
}

/// For how many milliseconds each was seen over all the faults, once the bridge has begun.
fn lengths(faults: bool) -> ([u32; 4], Reference) {
    const BEGUN: u32 = 2_000;
    let mut run = TestVectorRunner::new(calibration(), 1, faults);
    let mut lengths = [0; 4];
    for ms in 0..FAULT_CYCLE_VECTORS {
        run.draw_vector();
        run.receive();
        let frames = run.tick();
        run.update_checksum(&frames);
        let seen = seen(&run).map(|seen| u32::from(seen && ms >= BEGUN));
        lengths.iter_mut().zip(seen).for_each(|(length, seen)| *length += seen);
    }
    (lengths, run.node().reference())
}

#[test]
fn each_fault_lasts_until_it_is_seen_and_goes_again() {
    let (lengths, reference) = lengths(true);
    println!("{lengths:?} ms of {FAULT_CYCLE_VECTORS}");
    assert!(lengths.iter().all(|ms| (1_000..10_000).contains(ms)), "{lengths:?}");
    assert_ne!(reference, Reference::default(), "a zero is among them, and is believed");
}

#[test]
fn without_faults_all_is_well_and_nothing_is_zeroed() {
    assert_eq!(lengths(false), ([0; 4], Reference::default()));
}
