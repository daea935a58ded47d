//! Calibrations on the flashable image: one that is loaded while the power goes, and what the start makes of
//! slots that are damaged. Whatever happens, the board runs on one of the calibrations that were made, or says
//! that it has none.
#![allow(clippy::print_stdout, reason = "a test prints its figures")]

#[path = "../support/sdo_script.rs"]
mod sdo_script;
#[path = "../support/sectors.rs"]
mod sectors;
#[path = "../support/mod.rs"]
mod support;

mod master;
mod slots;

use std::sync::{
    Mutex, OnceLock,
    atomic::{AtomicUsize, Ordering},
};

use anyhow::{Context as _, Result, ensure};
use master::Received;
use support::{FAST_MACHINE, chip::Chip};
use trueup_machine::{CompiledCalibration, MachineFile, compile};
use trueup_store::calibration::calibration_crc;

/// Where the transfer begins: the board has reported its start.
const LOAD_MS: f64 = 130.0;
/// A board is received within this time of every start.
const START_MS: f64 = 200.0;

/// Returns the fast machine, with growth times `gain`.
fn compiled(gain: f64) -> CompiledCalibration {
    let by = 0.015_258_789_062_5 * gain;
    let text = FAST_MACHINE.replace("0.0152587890625", &by.to_string());
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("machine.toml");
    std::fs::write(&path, text).expect("it is written");
    compile(&MachineFile::read(&path).expect("a machine file")).expect("it compiles")
}

fn chip() -> Option<&'static Chip> {
    static CHIP: OnceLock<Option<Chip>> = OnceLock::new();
    CHIP.get_or_init(|| Chip::of_machine(FAST_MACHINE).expect("model and image build")).as_ref()
}

/// Lets many lives pass, two at a time; panics with what was wrong in any of them.
fn all(lives: &[String], live: impl Fn(&str) -> Result<()> + Sync) {
    let (next, wrong) = (AtomicUsize::new(0), Mutex::new(Vec::new()));
    std::thread::scope(|scope| {
        for _ in 0..2 {
            scope.spawn(|| {
                while let Some(what) = lives.get(next.fetch_add(1, Ordering::Relaxed)) {
                    if let Err(error) = live(what) {
                        wrong.lock().expect("nobody panics").push(format!("{what}: {error:#}"));
                    }
                }
            });
        }
    });
    let wrong = wrong.into_inner().expect("nobody panics");
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// Loads half the growth; `fault` is what the script does to it. Gives the number of words that were programmed.
fn load(chip: &Chip, fault: &str) -> Result<u32> {
    let (old, new) = (compiled(1.0), compiled(0.5));
    let (transfer, end) = master::load(new.blob(), LOAD_MS);
    let ask = end + 60.0 + START_MS;
    let script = format!(
        "0 flags 10\n{transfer}{fault}\n{} reset_if_uncut power\n{}",
        end + 60.0,
        master::questions(ask)
    );
    let report = chip.live((ask + 40.0) as u32, &script, &[])?;
    ensure!(report.clean, "a violation:\n{}", report.stdout);
    let received = Received::of(&report.events);
    let [reset] = received.resets[..] else { anyhow::bail!("resets at {:?}", received.resets) };
    let first_offset =
        received.offsets.iter().find(|time| **time > reset).context("it is never heard again")?;
    ensure!(first_offset - reset < START_MS, "silent for {} ms", first_offset - reset);

    let running = received.object((0x2100, 3), reset).context("it does not say what it runs on")?;
    let is_new = running == calibration_crc(new.blob());
    ensure!(is_new || running == calibration_crc(old.blob()), "it runs on {running:08x}");
    // The answer to the last segment is a promise.
    ensure!(is_new || !received.is_accepted(reset), "it has accepted what it does not run on");
    let state = received.object((0x2001, 6), reset).context("it does not say how it is")?;
    // A torn CRC of the head, its fourth word, cannot be distinguished from a damaged one.
    let torn = cut_in(new.blob().len() as u32 / 4 + 4);
    let is_requested = state & 1 << 2 != 0;
    ensure!(
        !is_requested || fault == torn,
        "a load that was cut counts as damaged: state {state:#x}"
    );
    report
        .stdout
        .split(" words programmed")
        .next()
        .and_then(|count_text| count_text.rsplit(' ').next()?.parse().ok())
        .context("it says how many words were programmed")
}

/// The power goes while that word is written.
fn cut_in(word: u32) -> String {
    format!("{LOAD_MS} cut {word}")
}

fn cuts(words: impl Iterator<Item = u32>) -> Vec<String> {
    words.map(cut_in).collect()
}

#[test]
fn a_power_cut_in_a_load_leaves_the_old_or_the_new_calibration() {
    let Some(chip) = chip() else { return };
    // The first word, the middle and the last of the blob's 153, the head's first and last, the write log.
    all(&cuts([1, 77, 153, 154, 157, 160].into_iter()), |fault| load(chip, fault).map(drop));
}

#[test]
#[ignore = "long: a power cut in each sixth of 173 words"]
fn a_power_cut_in_many_words_of_a_load_leaves_the_old_or_the_new_calibration() {
    every(6);
}

#[test]
#[ignore = "campaign: cargo test -p trueup-host-tests --features emulator --test chip_load campaign_a_power_cut -- --ignored"]
fn campaign_a_power_cut_in_any_word_of_a_load_leaves_the_old_or_the_new_calibration() {
    every(1);
}

/// A cut in each `step`th word of a load.
fn every(step: usize) {
    let Some(chip) = chip() else { return };
    // A cut far beyond the end: the power goes when all is written.
    let words = load(chip, &cut_in(100_000)).expect("a whole load");
    println!("{words} words");
    all(&cuts((1..=words).step_by(step)), |fault| load(chip, fault).map(drop));
}

#[test]
fn a_brown_out_while_a_calibration_is_loaded_leaves_the_old_or_the_new_one() {
    let Some(chip) = chip() else { return };
    let (_, end) = master::load(compiled(0.5).blob(), LOAD_MS);
    // In the transfer, and as the supervisor stores what has come.
    let lives: Vec<String> =
        [-50.0, 2.0, 5.0, 9.0].map(|after| format!("{} reset brown_out", end + after)).into();
    all(&lives, |fault| load(chip, &format!("{LOAD_MS} cut 100000\n{fault}")).map(drop));
}
