//! Instructions of a servo period of the bridge without a board, and the absence of panics in its library.
//!
//! The static library that a release has is linked to a small program in C. Callgrind counts the instructions of each of
//! the last periods; the linker's symbols show that no panic and no allocation is left in it. Time is not measured here:
//! this kernel is not a realtime one.
#![cfg(feature = "emulator")]
#![allow(clippy::print_stdout, reason = "a test prints its figures")]

use std::{fs, path::Path, process::Command};

use anyhow::{Context as _, Result, ensure};
use trueup_emulator::{host_programs, setup};
use trueup_machine::{MachineFile, compile};
use trueup_servo::component::COMPONENT_C_HEADER;

/// Most instructions of a servo period.
const MAX_INSTRUCTIONS: u64 = 30_000;
/// Periods that are counted one by one: all that comes every 100 ms comes four times, and the heat is saved in the last.
const COUNTED: usize = 400;
/// A gantry at its joints, every axis on its way, spindle turning.
const HARNESS: &str = r#"
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include "trueup_servo.h"
static uint8_t memory[TRUEUP_SERVO_BYTES] __attribute__((aligned(16)));
static uint8_t blob[32768];
static struct trueup_settings settings;
static struct trueup_inputs in;
static struct trueup_outputs out;
static uint8_t copies[TRUEUP_RETAINED_BYTES];
static int step(uint64_t period) { int n = trueup_servo_step(memory, &in, &out, period); trueup_servo_retain(memory, copies); return n; }
__attribute__((noinline)) int counted(uint64_t period) { int n = step(period); __asm__ volatile("" ::: "memory"); return n; }
int main(int argc, char **argv) {
    if (argc != 3) return 2;
    FILE *file = fopen(argv[1], "rb");
    size_t length = fread(blob, 1, sizeof blob, file);
    uint64_t period = strtoull(argv[2], 0, 10);
    settings.mm_per_unit = 1; settings.codes_per_v = 407.1; settings.resolution_v = 0.0003; settings.sends_rotary = 1;
    for (int i = 0; i < TRUEUP_JOINTS; i++) { settings.joint_axis[i] = i < 4 ? i % 3 : -1; settings.joint_min[i] = -1e4; settings.joint_max[i] = 1e4; }
    int n = trueup_servo_start(memory, sizeof memory, blob, length, &settings, period);
    if (n) { fputs(trueup_servo_reason(n), stderr); return 1; }
    int all = (int)(6000000000ull / period);
    for (int k = 0; k < all; k++) {
        double t = k * (double)period * 1e-9;
        for (int i = 0; i < 3; i++) in.position[i] = 1000 + 400 * sin(t * (0.3 + 0.1 * i));
        for (int i = 0; i < 4; i++) { in.joint_command[i] = in.position[i % 3]; in.joint_now[i] = out.joint_offset[i]; }
        for (int i = 0; i < TRUEUP_TEMPERATURES; i++) in.temperature_c[i] = 22 + 0.001 * t + 0.0001 * (k % 7);
        in.sensor_v = 2 + 0.01 * t + 0.002 * sin(k * 1.7);
        in.spindle_rpm = 18000 + (k / 500) * 10; in.angles_deg[0] = 40 * sin(t); in.angles_deg[1] = 30 * sin(1.3 * t); in.tool = 7; in.bits = TRUEUP_ENABLE | TRUEUP_MACHINE_ON | TRUEUP_HOMED;
        if (k >= all - COUNTED ? counted(period) : step(period)) return 1;
    }
    printf("quality %d offset %.3f %.3f %.3f\n", out.quality, out.offset_um[0], out.offset_um[1], out.offset_um[2]);
    return 0;
}
"#;

fn run(command: &mut Command) -> Result<String> {
    let done = command.output()?;
    let stderr = String::from_utf8_lossy(&done.stderr);
    ensure!(done.status.success(), "{command:?}: {}\n{stderr}", done.status);
    Ok(String::from_utf8(done.stdout)?)
}

/// Builds the program in this folder.
fn harness(folder: &Path) -> Result<()> {
    let library = host_programs::build_servo_library()?;
    fs::write(folder.join("harness.c"), HARNESS)?;
    fs::write(folder.join("trueup_servo.h"), COMPONENT_C_HEADER)?;
    let mut gcc = Command::new("gcc");
    gcc.current_dir(folder).args(["-O2", "-g", &format!("-DCOUNTED={COUNTED}"), "-o", "harness"]);
    run(gcc.arg("harness.c").arg(library).args(["-Wl,--gc-sections", "-lm"]))?;
    let gantry = setup::project_root().join("data/gantry.toml");
    let machine = MachineFile::parse(&fs::read_to_string(&gantry)?, &gantry)?;
    fs::write(folder.join("calibration.bin"), compile(&machine)?.blob())?;
    Ok(())
}

/// Returns the instructions of each counted period.
fn instructions(folder: &Path, period_ns: u64) -> Result<Vec<u64>> {
    let mut valgrind = Command::new("valgrind");
    valgrind.current_dir(folder).args([
        "--tool=callgrind",
        "--toggle-collect=counted",
        "--dump-after=counted",
        &format!("--callgrind-out-file=count.{period_ns}"),
        "./harness",
        "calibration.bin",
        &period_ns.to_string(),
    ]);
    let message = run(&mut valgrind)?;
    ensure!(message.starts_with("quality 1 "), "it has to correct while it is counted: {message}");
    let mut all = Vec::new();
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        if name.starts_with(&format!("count.{period_ns}.")) {
            let text = fs::read_to_string(path)?;
            let totals = text.lines().find_map(|line| line.strip_prefix("totals: "));
            all.push(totals.context("callgrind writes totals")?.trim().parse()?);
        }
    }
    all.retain(|count: &u64| *count > 0);
    all.sort_unstable();
    Ok(all)
}

#[test]
#[ignore = "long: callgrind"]
fn a_servo_period_costs_at_most_30000_instructions_and_its_library_has_no_panic() -> Result<()> {
    setup::ensure_linuxcnc_dev()?;
    setup::ensure_valgrind()?;
    let folder = tempfile::tempdir()?;
    harness(folder.path())?;
    for period_ns in [500_000, 1_000_000, 2_000_000, 4_000_000] {
        let all = instructions(folder.path(), period_ns)?;
        ensure!(all.len() == COUNTED, "{} periods were counted", all.len());
        let (middle, most) = (all[all.len() / 2], all[all.len() - 1]);
        println!("{} ms: median {middle}, largest {most} instructions", period_ns as f64 / 1e6);
        ensure!(most <= MAX_INSTRUCTIONS, "{period_ns} ns: {most} instructions");
    }
    let symbols = run(Command::new("nm").arg("-C").arg(folder.path().join("harness")))?;
    let is_bridge = symbols.contains("trueup_servo_step") && symbols.contains("trueup_node");
    ensure!(is_bridge, "the symbols are those of the bridge");
    for word in ["panic", "rust_alloc", " malloc", "calloc", "unwind", "begin_unwind"] {
        let found: Vec<&str> = symbols.lines().filter(|line| line.contains(word)).collect();
        ensure!(found.is_empty(), "{word}: {found:?}");
    }
    Ok(())
}
