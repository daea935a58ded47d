//! The board computes what the host computes, in few instructions.

use trueup_emulator::measure;

#[test]
fn board_and_host_send_the_same_frames_and_a_curve_takes_few_instructions() {
    let measured = measure::run(10_000).unwrap();
    println!("{}", measured.table);
    assert!(measured.identical);
    assert_eq!(measured.json["host_vectors_identical"], 10_000);
    let number = |pointer: &str| measured.json.pointer(pointer).unwrap().as_u64().unwrap();
    // The aim is 1,500; this holds what is reached.
    assert!(number("/tick_instructions/median") <= 5_000);
    assert!(number("/spline_eval/ours") <= 40);
    assert!(number("/spline_eval/ours_max") <= 56);
}
