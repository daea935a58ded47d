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
    bridge::ReferenceErrors,
    cnc::{OffsetFlags, OffsetQuality},
};
use trueup_node::test_vectors::{TestVectorRunner, VECTORS_PER_FAULT_CYCLE};

/// Returns what is seen of the faults in a millisecond: the CNC is lost, the sensor is dead, no offset is followed,
/// there is no temperature.
fn seen(run: &TestVectorRunner<'_>) -> [bool; 4] {
    let last = run.node().last_output();
    [
        last.flags.contains(OffsetFlags::CNC_LOST),
        last.flags.contains(OffsetFlags::SENSOR_FAULT),
        last.quality == OffsetQuality::Off && !last.flags.contains(OffsetFlags::CNC_LOST),
        run.node().read(EntryContent::InputStatus(2)) == Ok(ObjectValue::Number(1)),
    ]
}

/// For how many milliseconds each was seen over all the faults, once the bridge has begun.
fn lengths(faults: bool) -> ([u32; 4], ReferenceErrors) {
    const BEGUN: u32 = 2_000;
    let mut run = TestVectorRunner::new(calibration(), 1, faults);
    let mut lengths = [0; 4];
    for ms in 0..VECTORS_PER_FAULT_CYCLE {
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
    println!("{lengths:?} ms of {VECTORS_PER_FAULT_CYCLE}");
    assert!(lengths.iter().all(|ms| (1_000..10_000).contains(ms)), "{lengths:?}");
    assert_ne!(reference, ReferenceErrors::default(), "a zero is among them, and is believed");
}

#[test]
fn without_faults_all_is_well_and_nothing_is_zeroed() {
    assert_eq!(lengths(false), ([0; 4], ReferenceErrors::default()));
}
