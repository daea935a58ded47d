//! Reads a line of the bridge as a CNC does: `cargo run -p trueup-link --example read_offsets`.
#![allow(clippy::print_stdout, reason = "an example prints")]

use trueup_core::{cnc::Output, units::Nanometres};
use trueup_link::{frames, slcan};

/// Prints the line with an offset of Z, and what is read back from it.
pub fn main() -> Result<(), Box<dyn std::error::Error>> {
    let offset = Some([Nanometres(0), Nanometres(0), Nanometres(12_340)]);
    let line =
        slcan::encode_line(&frames::encode_offset_z(&Output { offset, ..Output::default() }, 7));
    println!("{}", line.trim_end());
    // A damaged frame is an error here: its CRC is part of the frame.
    let frame = slcan::decode_line(line.trim_end().as_bytes())?;
    let read = frames::decode_offset_z(&frame)?;
    println!(
        "Z {:?}, quality {:?}, counter {}",
        read.offset,
        read.quality,
        frames::e2e_counter(&frame)
    );
    assert_eq!(read.offset, Some(Nanometres(12_340)));
    Ok(())
}
