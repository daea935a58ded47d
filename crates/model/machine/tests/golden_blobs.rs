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
use trueup_store::calibration::calibration_crc;

#[test]
fn the_shipped_machine_files_compile_to_the_bytes_they_always_did() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../..");
    for (name, length, crc) in [
        ("data/gantry", 2_126, 0x0CFD_D30C),
        ("data/paper_spindle", 613, 0xFD4A_DB36),
        ("data/mill/mill", 612, 0x694D_4946),
        ("data/mill/volume", 612, 0xF0F7_69C0),
        ("integrations/linuxcnc/trueup_gantry", 702, 0xF77C_C8FC),
        ("integrations/linuxcnc/trueup_lathe", 639, 0xA2CA_CDD8),
        ("host-tests/corpus/toml/all", 678, 0x4B50_B9CF),
        ("host-tests/tests/chip_faults/machine", 634, 0xBBC2_338C),
        ("crates/bench/emulator/src/linuxcnc/base", 626, 0xD53E_3EE6),
    ] {
        let machine =
            MachineFile::read(&root.join(name).with_extension("toml")).expect("it is shipped");
        let compiled = compile(&machine).expect("it fits the board");
        let blob = compiled.blob();
        assert_eq!((blob.len(), calibration_crc(blob)), (length, crc), "{name}");
    }
}
