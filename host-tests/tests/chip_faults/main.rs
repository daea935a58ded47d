//! Every fault of the flashable image that the list names, provoked on the model of its chip: what becomes of it,
//! within what time, and what the board says after it. The page `docs/faults.md` is printed from the same list.
#![allow(clippy::print_stdout, clippy::print_stderr, reason = "a test prints its figures")]

mod case;
mod list;

use std::{
    fs,
    path::{Path, PathBuf},
    sync::{
        Mutex, OnceLock,
        atomic::{AtomicUsize, Ordering},
    },
    thread,
};

use case::{HISTORY, Seen};
use list::{Image, Run, runs};
use trueup_emulator::{chip, firmware_images, image_check, setup};

/// Of 80 KB (`src/board/stm32f405/guard.x`).
const HALF_A_STACK: u16 = 40 * 1024;
/// Symbol of the word that commands the breaking image, and only it.
const KEY: &str = "TRUEUP_FAULT_KEY";

/// The model and the images; `None`: this compiler is too old for the model.
struct Parts {
    model: PathBuf,
    flashed: PathBuf,
    breaking: PathBuf,
    _folder: tempfile::TempDir,
    unusable: [PathBuf; 2],
}

fn parts() -> Option<&'static Parts> {
    static PARTS: OnceLock<Option<Parts>> = OnceLock::new();
    PARTS
        .get_or_init(|| {
            let model = chip::build_model().expect("the model builds")?;
            let machine = setup::project_root().join("host-tests/tests/chip_faults/machine.toml");
            let flashed =
                firmware_images::build_standalone_image(&machine).expect("the image builds");
            let folder = tempfile::tempdir().expect("a folder");
            let breaking = firmware_images::build_image_with_fault_injection(&machine)
                .expect("the image builds");
            let unusable = [0, 1].map(|kind| spoil(&flashed, &machine, folder.path(), kind));
            Some(Parts { model, flashed, breaking, _folder: folder, unusable })
        })
        .as_ref()
}

/// Returns a copy of the image in this folder whose calibration is damaged (0) or of another schema (1), sealed again.
fn spoil(image: &Path, machine: &Path, folder: &Path, kind: usize) -> PathBuf {
    let machine = trueup_machine::machine_file::MachineFile::read(machine).expect("a machine file");
    let compiled = trueup_machine::compile::compile(&machine).expect("it compiles");
    let blob = compiled.blob();
    let mut bytes = fs::read(image).expect("the image");
    let at = bytes.windows(blob.len()).position(|part| part == blob).expect("it is linked in");
    if kind == 0 {
        bytes[at + blob.len() / 2] ^= 0x10;
    } else {
        let other = other_schema(blob);
        bytes[at..at + other.len()].copy_from_slice(&other);
    }
    let copy = folder.join(format!("unusable-{kind}.elf"));
    fs::write(&copy, bytes).expect("it is written");
    image_check::embed_image_check(&copy).expect("it has a place for it");
    copy
}

/// Returns the same blob, whole, with the next schema's number.
fn other_schema(blob: &[u8]) -> Vec<u8> {
    let mut other = blob.to_vec();
    other[4] = other[4].wrapping_add(1);
    let end = other.len() - 4;
    let crc = crc::Crc::<u32>::new(&crc::CRC_32_AUTOSAR).checksum(&other[..end]);
    other[end..].copy_from_slice(&crc.to_le_bytes());
    other
}

/// Objects that are asked for all the time: state bits, reason of the reset, task.
const ASKED: [(u16, u8); 3] = [(0x2001, 6), (0x2001, 7), (0x2002, 7)];

fn script(run: &Run, key: Option<u32>) -> String {
    let mut script = run.script.clone();
    if let Some(key) = key {
        script = script.replace("KEY", &format!("{key:x}"));
    }
    let mut requested = ASKED.to_vec();
    if run.cases.iter().any(|(_, case)| case.is_history) {
        requested.extend((1..=8).map(|entry| (HISTORY, entry)));
    }
    let requested = requested.into_iter().cycle();
    for (at, (index, subindex)) in (0..run.ms).step_by(10).zip(requested) {
        let [low, high] = index.to_le_bytes();
        let ask = format!("40{low:02x}{high:02x}{subindex:02x}00000000");
        script += &if run.is_serial {
            format!("{at} say t6018{ask}\\r\n")
        } else {
            format!("{at} frame 601 {ask}\n")
        };
    }
    script
}

/// Plays a run; gives what was not as the list says.
fn play(parts: &Parts, run: &Run) -> Vec<String> {
    let image = match run.image {
        Image::Flashed => &parts.flashed,
        Image::Breaking => &parts.breaking,
        Image::NoCalibration => &parts.unusable[0],
        Image::OtherSchema => &parts.unusable[1],
    };
    let key = image_check::find_symbol_address(image, KEY).expect("an image");
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("script");
    fs::write(&file, script(run, key)).expect("it is written");
    let mut options: Vec<String> = run.options.iter().map(|option| (*option).into()).collect();
    options.extend(["--ms".into(), run.ms.to_string(), "--script".into()]);
    options.push(file.to_str().expect("a plain name").into());
    let report = chip::run(&parts.model, image, &options).expect("the model runs");
    let seen = Seen::of(&report.events);
    let mut wrong = Vec::new();
    for (how, case) in &run.cases {
        for missing in case.missing(&seen) {
            wrong.push(format!("{}: {}, {how}: {missing}", run.name, case.fault));
        }
    }
    // A stack that was never used by more than half, in any of these lives.
    wrong.extend(
        seen.free_stack
            .iter()
            .filter(|free| **free < HALF_A_STACK)
            .map(|free| format!("{}: {free} bytes of the stack were never used", run.name)),
    );
    // Resets that no case asks for.
    let requested = run.cases.iter().filter(|(_, case)| case.restart.is_some()).count();
    if seen.resets.len() != requested {
        wrong.push(format!("{}: {} resets at {:?}", run.name, seen.resets.len(), seen.resets));
    }
    if !wrong.is_empty() && std::env::var_os("TRUEUP_FAULTS_LOG").is_some() {
        eprintln!("== {}\n{}\n{}", run.name, report.stdout, report.log.join("\n"));
    }
    wrong
}

#[test]
fn faults_of_the_core_end_as_the_list_says() {
    play_those(|run| run.name == "core");
}

/// With `TRUEUP_FAULTS_ONLY=crystal` those lives alone that have it in their name.
#[test]
#[ignore = "long: 48 s of the board, in 28 lives"]
fn every_fault_of_the_list_ends_as_it_says() {
    let only = std::env::var("TRUEUP_FAULTS_ONLY").unwrap_or_default();
    play_those(|run| run.name.contains(&only));
}

fn play_those(is_meant: impl Fn(&Run) -> bool) {
    let Some(parts) = parts() else {
        println!("skipped: the model of the chip needs a newer compiler");
        return;
    };
    let runs: Vec<Run> = runs().into_iter().filter(is_meant).collect();
    let (next, wrong) = (AtomicUsize::new(0), Mutex::new(Vec::new()));
    thread::scope(|scope| {
        for _ in 0..2 {
            scope.spawn(|| {
                while let Some(run) = runs.get(next.fetch_add(1, Ordering::Relaxed)) {
                    wrong.lock().expect("nobody panics").extend(play(parts, run));
                }
            });
        }
    });
    let wrong = wrong.into_inner().expect("nobody panics");
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn only_the_breaking_image_accepts_the_command_to_break() {
    let machine = setup::project_root().join("host-tests/tests/chip_faults/machine.toml");
    let breaking = firmware_images::build_image_with_fault_injection(&machine).expect("it builds");
    assert!(image_check::find_symbol_address(&breaking, KEY).expect("an image").is_some());
    for board in firmware_images::Board::ALL {
        let image = firmware_images::build_board_image(board).expect("it builds");
        assert_eq!(
            image_check::find_symbol_address(&image, KEY).expect("an image"),
            None,
            "{}",
            board.cargo_feature()
        );
    }
}

/// With `TRUEUP_WRITE_FAULTS=1` it writes the page instead.
#[test]
fn the_page_is_what_the_list_says() {
    let runs = runs();
    let count: usize = runs.iter().map(|run| run.cases.len()).sum();
    let mut page = HEAD.replace("COUNT", &count.to_string());
    for run in &runs {
        run.cases.iter().for_each(|(how, case)| page += &case.line(how));
    }
    let path = setup::project_root().join("docs/faults.md");
    if std::env::var_os("TRUEUP_WRITE_FAULTS").is_some() {
        fs::write(&path, &page).expect("the folder of the documentation");
    }
    println!("{count} cases in {} runs", runs.len());
    assert!(count >= 40, "{count}");
    let file = fs::read_to_string(&path).expect("the page");
    assert!(
        file == page,
        "write it again: TRUEUP_WRITE_FAULTS=1 cargo test … --test chip_faults page"
    );
}

const HEAD: &str = "\
# Faults of the flashable image

Each of these COUNT faults is provoked in the image that is flashed, on the model of its chip (`crates/bench/chip`).
It ends as its line says. The command is
`cargo test -p trueup-host-tests --features emulator --test chip_faults -- --include-ignored`. The board was engaged
before, where the fault does not come at the start. A board that starts anew is \"not available\" (quality 6) until it
is engaged again, and `trueup bridge info` names the last column. Without a crystal there is no CAN, and an emergency
comes before the serial line has been opened. The history of errors, object 0x1003, keeps it. Nothing of this has been
seen on hardware.

| fault | how it comes | quality | flag | state | emergency | within ms | named after the restart |
|---|---|---|---|---|---|---|---|
";
