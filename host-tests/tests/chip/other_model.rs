//! The same image on another model of the same chip, written by others from the same manuals and kept next to the
//! project: what ours has come to allow, theirs may not.

use std::{fs, path::Path, process::Command};

use trueup_emulator::{process, setup};

use super::parts;

#[test]
#[ignore = "long: builds the other model, and runs the image fourteen times"]
fn a_model_that_others_wrote_finds_nothing_either() {
    let theirs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/chip");
    if !theirs.join("check.sh").is_file() {
        return println!("skipped: no {}", theirs.display());
    }
    let Some((_, image)) = parts() else {
        return println!("skipped: the model of the chip needs a newer compiler");
    };
    // Theirs cannot be written to, and is built where it lies.
    let folder = setup::project_root().join("target/other-chip");
    fs::create_dir_all(&folder).expect("a folder");
    let mut copy = Command::new("cp");
    copy.args(["-r", "--preserve=timestamps", "--no-preserve=mode"]);
    process::run(copy.arg(theirs.join(".")).arg(&folder)).expect("a copy");
    let mut check = Command::new("bash");
    check.arg("check.sh").arg(image).current_dir(&folder).env_remove("CARGO_TARGET_DIR");
    let check = check.output().expect("it runs");
    let stdout = String::from_utf8_lossy(&check.stdout);
    println!("{stdout}");
    assert!(check.status.success(), "{stdout}{}", String::from_utf8_lossy(&check.stderr));
    assert!(stdout.contains("14 passed, 0 failed"), "{stdout}");
}
