//! The bytes of a compiled calibration are part of the contract: boards and stored references know
//! it by its CRC. A changed number here means that every board counts its stored reference as one of
//! another machine.

use std::path::Path;

use trueup_machine::{MachineFile, compile};
use trueup_store::calibration::identity;

#[test]
fn the_shipped_machine_files_compile_to_the_bytes_they_always_did() {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../data");
    for (name, length, crc) in [("gantry", 2_126, 0x3477_4B8E), ("paper_spindle", 613, 0x561B_4913)]
    {
        let machine =
            MachineFile::read(&data.join(name).with_extension("toml")).expect("it is shipped");
        let compiled = compile(&machine).expect("it fits the board");
        let blob = compiled.blob();
        assert_eq!((blob.len(), identity(blob)), (length, crc), "{name}");
    }
}
