//! The crate's example runs, and finds what it says.

#[path = "../examples/sensor_and_pt100.rs"]
mod sensor_and_pt100;

#[test]
fn the_example_of_a_sensor_and_a_pt100_runs() {
    sensor_and_pt100::main();
}
