//! What nobody waits for: the soak, the fuzzing, the mutants. A command each, niced by whoever likes,
//! with the figures of `docs/robustness.md` as their last lines.

use anyhow::Result;
use trueup_emulator::process;

use crate::cargo;

/// Lets the simulator run for so many ticks, from this seed on, on all cores; a failure prints the seed
/// that repeats it.
///
/// # Errors
/// It does not build, or something did not hold.
pub fn soak(ticks: u64, seed: u32) -> Result<()> {
    let mut test = cargo::locked("test");
    test.args(["--profile", "soak", "-p", "trueup-node", "--test", "simulator", "--"])
        .args(["--ignored", "--exact", "campaign_soak", "--nocapture"])
        .env("TRUEUP_SOAK_TICKS", ticks.to_string())
        .env("TRUEUP_SOAK_SEED", seed.to_string());
    process::run(&mut test)
}
