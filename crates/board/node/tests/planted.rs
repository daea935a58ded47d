//! The simulator tried on itself: faults planted in the code one by one, each in a copy of it, and each
//! has to be found.
//!
//! Planted are only faults that cargo-mutants does not make: `cargo xtask mutants --simulator` tries those that it makes in
//! the same functions. Of twenty planted faults, two were among its mutants (version 27.1.0: a match arm deleted, a function
//! replaced with `()`), and are left to it. It changes operators, match arms, fields and whole function bodies. None of
//! its mutants does what the other eighteen do:
//!
//! | change | planted |
//! |---|---|
//! | an argument or a value by a factor or a summand | 6 |
//! | an argument, a value or a condition replaced by a constant, a call omitted from an expression | 7 |
//! | a declared constant | 2 |
//! | a statement omitted, or added | 3 |

use std::{
    fs,
    path::{Path, PathBuf},
    process::{Command, Stdio},
};

/// Where, what is replaced, and by what.
const PLANTED: [(&str, &str, &str); 18] = [
    (
        "core/src/limits.rs",
        "MaxStep::from_slew_rate(limits.slew_nm_per_s, elapsed_ms)",
        "MaxStep::from_slew_rate(limits.slew_nm_per_s.saturating_mul(2), elapsed_ms)",
    ),
    ("core/src/bridge.rs", "Mode::Hold => {}", "Mode::Hold => state.applied = Default::default(),"),
    (
        "core/src/bridge.rs",
        "status = state.applied.step(limits, [Nanometres::ZERO; 3], elapsed_ms);",
        "status = state.applied.step(limits, [Nanometres::ZERO; 3], 1 << 30);",
    ),
    (
        "core/src/bridge.rs",
        "offset: (quality != OffsetQuality::Fault).then(|| state.applied.offset()),",
        "offset: Some(state.applied.offset()),",
    ),
    ("core/src/bridge.rs", ".rounded().saturating_neg()", ".rounded()"),
    ("core/src/bridge.rs", "state.believable = clean.is_some();", "state.believable = true;"),
    ("core/src/bridge/state.rs", "        self.starved_age = Age::ZERO;\n", ""),
    (
        "core/src/bridge/state.rs",
        "if self.age.is_older_than(timeout_ms) { None }",
        "if self.age.is_older_than(timeout_ms.saturating_mul(4)) { None }",
    ),
    (
        "core/src/bridge/state.rs",
        "!age.is_older_than(hold_ms)",
        "!age.is_older_than(hold_ms.saturating_mul(3))",
    ),
    (
        "core/src/bridge/source_selection.rs",
        "state.joint.shift = Nanometres::saturating_from(shift);",
        "state.joint.shift = Nanometres::saturating_from(shift.wrapping_mul(0));",
    ),
    (
        "core/src/sensor_health.rs",
        "pub const HIGH_RAIL: AdcCode = AdcCode(4087);",
        "pub const HIGH_RAIL: AdcCode = AdcCode(5087);",
    ),
    (
        "core/src/sensor_health.rs",
        "pub const FROZEN_AFTER_CODES: u16 = 4_000;",
        "pub const FROZEN_AFTER_CODES: u16 = 60_000;",
    ),
    (
        "link/src/frames.rs",
        "OFFSET_Z.insert(&mut data, z);",
        "OFFSET_Z.insert(&mut data, z.wrapping_add(1));",
    ),
    ("store/src/retained_state.rs", "    crc::write_crc(copy);\n", ""),
    (
        "node/src/node.rs",
        "frames::encode_offset_z(&output, counter)]",
        "frames::encode_offset_z(&output, counter.wrapping_add(1))]",
    ),
    ("node/src/node/restart.rs", "if behind_ms < elapsed_ms {", "if behind_ms < u32::MAX {"),
    (
        "node/src/node/master.rs",
        "self.is_started |= self.released >= MIN_CONSECUTIVE_FRAMES && !self.is_doubtful;",
        "self.is_started = true;",
    ),
    (
        "node/src/node/master.rs",
        "if self.run == MIN_CONSECUTIVE_FRAMES { EdgeOutcome::Yes } else { EdgeOutcome::No }",
        "if self.run == 1 { EdgeOutcome::Yes } else { EdgeOutcome::No }",
    ),
];

/// Where they are.
const ROOM: &str = "crates/board";

const CRATES: [&str; 5] = ["core", "link", "canopen", "store", "node"];

fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).expect("a folder of ours");
    for entry in fs::read_dir(from).expect("the project's own folder").flatten() {
        let (name, path) = (entry.file_name(), entry.path());
        if path.is_dir() {
            copy(&path, &to.join(name));
        } else {
            fs::copy(&path, to.join(name)).expect("a file of ours");
        }
    }
}

/// Returns whether the simulator passes on the code in this folder; and its output.
fn passes(folder: &Path) -> (bool, String) {
    let run = |arguments: &[&str]| {
        Command::new(env!("CARGO"))
            .args(["test", "--offline", "-p", "trueup-node", "--test", "simulator"])
            .args(arguments)
            .current_dir(folder)
            .env("CARGO_TARGET_DIR", folder.join("target"))
            .stdin(Stdio::null())
            .output()
            .expect("cargo runs")
    };
    let built = run(&["--no-run"]);
    assert!(built.status.success(), "{}", String::from_utf8_lossy(&built.stderr));
    let ran = run(&["whatever"]);
    (ran.status.success(), String::from_utf8_lossy(&ran.stdout).into_owned())
}

/// A fault whose place has another text now would be found by nobody until the campaign is run.
#[test]
fn every_planted_fault_has_its_place_in_the_code() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../..").join(ROOM);
    for (file, from, _) in PLANTED {
        let text = fs::read_to_string(root.join(file)).expect("a file of the project");
        assert!(text.contains(from), "{file} has no {from}");
    }
}

#[test]
#[ignore = "campaign: cargo test -p trueup-node --test planted -- --ignored --nocapture"]
fn campaign_every_planted_fault_is_found_by_the_simulator() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../..");
    let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("planted");
    if folder.exists() {
        fs::remove_dir_all(folder.join(ROOM)).expect("a folder of ours");
    }
    for name in CRATES {
        copy(&root.join(ROOM).join(name), &folder.join(ROOM).join(name));
    }
    let whole = fs::read_to_string(root.join("Cargo.toml")).expect("the workspace");
    // The workspace without the rest of it.
    let deps =
        whole.split("[workspace.package]").nth(1).and_then(|part| part.split("[package]").next());
    let members = CRATES.map(|name| format!("\"{ROOM}/{name}\"")).join(", ");
    let own = format!(
        "[workspace]\nresolver = \"3\"\nmembers = [{members}]\n[workspace.package]{}\n\
         [profile.dev]\nopt-level = 1\n",
        deps.expect("in its order")
    );
    fs::write(folder.join("Cargo.toml"), own).expect("a folder of ours");
    fs::copy(root.join("Cargo.lock"), folder.join("Cargo.lock")).expect("a folder of ours");
    let (is_sound, output_text) = passes(&folder);
    assert!(is_sound, "without a fault: {output_text}");
    let mut missed = Vec::new();
    for (number, (file, from, to)) in (1..).zip(PLANTED) {
        let path = folder.join(ROOM).join(file);
        let sound = fs::read_to_string(&path).expect("it was copied");
        assert!(sound.contains(from), "{number}: {file} has no {from}");
        fs::write(&path, sound.replacen(from, to, 1)).expect("a folder of ours");
        let (is_missed, output_text) = passes(&folder);
        let why =
            output_text.lines().find(|line| line.contains("seed ")).unwrap_or("not as it was");
        println!("{number:2} {file}: {}", if is_missed { "MISSED" } else { why.trim() });
        missed.extend(is_missed.then_some(number));
        fs::write(&path, sound).expect("a folder of ours");
    }
    assert!(missed.is_empty(), "not found: {missed:?}");
}
