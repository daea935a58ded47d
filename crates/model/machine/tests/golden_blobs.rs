//! The bytes of a compiled calibration are part of the contract: boards and stored references know
//! it by its CRC. A changed number here means that every board counts its stored reference as one of
//! another machine.
//!
//! Those of the divider 0.328 are the bytes of the divider 0.33, known since the first version, with slope and
//! zero worked out by hand (`compile/tests.rs`) and a CRC taken by another program. Those of `gantry` differ from
//! its first ones in the sign of a backlash, which its machine file has positive since, and in the full scale of the counts of
//! a linear input, which no board could reach without it; no board runs on an example.

use std::path::Path;

use trueup_machine::{MachineFile, compile};
use trueup_store::calibration::identity;

#[test]
fn the_shipped_machine_files_compile_to_the_bytes_they_always_did() {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../data");
    for (name, length, crc) in [("gantry", 2_126, 0x0CFD_D30C), ("paper_spindle", 613, 0xFD4A_DB36)]
    {
        let machine =
            MachineFile::read(&data.join(name).with_extension("toml")).expect("it is shipped");
        let compiled = compile(&machine).expect("it fits the board");
        let blob = compiled.blob();
        assert_eq!((blob.len(), identity(blob)), (length, crc), "{name}");
    }
}
