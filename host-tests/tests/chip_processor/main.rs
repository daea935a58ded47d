//! The processor of the chip's model against QEMU's: the same drawn instructions, and after every sixteen the
//! same registers, flags and memory. Neither knows the other, nor our firmware.

mod stream;

use std::{
    fs,
    process::{Command, Stdio},
    thread::sleep,
    time::{Duration, Instant},
};

use trueup_emulator::{chip, setup};

/// Groups of 16 instructions in a run.
const GROUPS: usize = 200;
/// Each draws other instructions.
const SEEDS: [u64; 3] = [2, 3, 4];
/// Names of a checkpoint's words.
const WORDS: [&str; 10] = ["r0", "r1", "r2", "r3", "r4", "r5", "r6", "r7", "APSR", "FPSCR"];

/// Returns what differs first, as words: where, and both values.
fn difference(model: &[u8], qemu: &[u8]) -> Option<String> {
    let at = model.iter().zip(qemu).position(|(one, other)| one != other)?;
    let word = |bytes: &[u8]| {
        let at = at / 4 * 4;
        u32::from_le_bytes(bytes[at..at + 4].try_into().expect("four bytes"))
    };
    let place = at.checked_sub(stream::SCRATCH_BYTES).map(|at| {
        let word = at % stream::CHECKPOINT / 4;
        let name = WORDS
            .get(word)
            .map_or(format!("s{}", word - WORDS.len().min(word)), |name| (*name).into());
        format!("{name} after group {}", at / stream::CHECKPOINT)
    });
    let place = place.unwrap_or_else(|| format!("memory at {at}"));
    Some(format!("{place}: {:#010x} on the model, {:#010x} in QEMU", word(model), word(qemu)))
}

#[test]
fn the_models_processor_does_what_qemus_does_instruction_by_instruction() {
    let Some(model) = chip::build_model().expect("the model builds") else {
        return println!("skipped: the model of the chip needs a newer compiler");
    };
    let qemu = setup::ensure_qemu().expect("QEMU");
    let folder = tempfile::tempdir().expect("a folder");
    let length = stream::SCRATCH_BYTES + GROUPS * stream::CHECKPOINT;
    for seed in SEEDS {
        let image = folder.path().join("stream.elf");
        fs::write(&image, stream::image(seed, GROUPS)).expect("it is written");
        // Files of their own for each seed: what is waited for is a file's length.
        let file = |name: &str| folder.path().join(format!("{name}-{seed}"));
        let [ours, theirs] = ["model", "qemu"].map(file);
        let status = Command::new(&model)
            .arg(&image)
            .args(["--ms", "400", "--no-cnc", "--quiet", "--serial-out"])
            .arg(&ours)
            .stdout(Stdio::null())
            .status();
        // 1: it has a remark on the rate of this bare program's line.
        assert!(status.expect("the model runs").code().is_some_and(|code| code < 2));
        let mut emulator = Command::new(&qemu)
            .args(["-M", "netduinoplus2", "-nographic", "-monitor", "none", "-serial"])
            .arg(format!("file:{}", theirs.display()))
            .arg("-kernel")
            .arg(&image)
            .stdin(Stdio::null())
            .spawn()
            .expect("QEMU starts");
        let end = Instant::now() + Duration::from_secs(60);
        let size = || fs::metadata(&theirs).map_or(0, |metadata| metadata.len()) as usize;
        while size() < length && Instant::now() < end {
            sleep(Duration::from_millis(20));
        }
        emulator.kill().ok();
        emulator.wait().ok();
        let [model, qemu] = [ours, theirs].map(|file| fs::read(file).expect("what it has sent"));
        assert_eq!((model.len(), qemu.len()), (length, length), "seed {seed}");
        if let Some(what) = difference(&model, &qemu) {
            panic!("seed {seed}: {what}");
        }
    }
    println!("{} instructions, the same on both", SEEDS.len() * GROUPS * 16);
}
