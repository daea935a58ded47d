//! The crate's example runs, and reads back what was sent.

#[path = "../examples/read_offsets.rs"]
mod read_offsets;

#[test]
fn the_example_of_a_line_with_offsets_runs() {
    read_offsets::main().expect("the line is whole");
}
