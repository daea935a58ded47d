//! Every servo cycle of a run, and what no offset may do in any of them.

use std::{
    fs::File,
    io::{Read as _, Seek as _, SeekFrom},
    path::Path,
};

use anyhow::{Context as _, Result, ensure};

/// One servo cycle. Lengths in mm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Counts cycles; a gap is a cycle that was not recorded.
    pub number: u64,
    /// Which test it belongs to.
    pub scenario: i32,
    /// Where the joints are sent: what moves the machine.
    pub joint: [f64; 3],
    /// Where the axes are sent, without the offset.
    pub command: [f64; 3],
    /// The offset that is applied.
    pub eoffset: [f64; 3],
    /// The offset that is asked for.
    pub request: [f64; 3],
    /// Motion is enabled.
    pub on: bool,
    /// All joints are homed.
    pub homed: bool,
}

/// Reads what `halsampler -t` has written behind `from`, which moves on.
pub fn read(path: &Path, from: &mut u64) -> Result<Vec<Sample>> {
    let mut file = File::open(path)?;
    file.seek(SeekFrom::Start(*from))?;
    let mut text = String::new();
    file.read_to_string(&mut text)?;
    let mut samples = Vec::new();
    // The last line may be half written.
    let whole = text.rsplit_once('\n').map_or("", |(whole, _)| whole);
    if !whole.is_empty() {
        *from += whole.len() as u64 + 1;
    }
    for line in whole.lines() {
        ensure!(!line.contains("overrun"), "the recorder was overrun");
        let mut words = line.split_whitespace();
        let mut next = || words.next().context("a line of the recorder is too short");
        let number = next()?.parse()?;
        let scenario = next()?.parse()?;
        let mut three =
            || -> Result<[f64; 3]> { Ok([next()?.parse()?, next()?.parse()?, next()?.parse()?]) };
        let (joint, command, eoffset, request) = (three()?, three()?, three()?, three()?);
        let (on, homed) = (next()? == "1", next()? == "1");
        samples.push(Sample { number, scenario, joint, command, eoffset, request, on, homed });
    }
    Ok(samples)
}

/// The largest steps over a stretch of cycles.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Steps {
    /// Number of servo cycles.
    pub cycles: usize,
    /// The largest step of a joint beyond what its axis was commanded around that cycle, in nm.
    pub joint_nm: f64,
    /// The largest step of what the component asked for, away from where the offset stands, in nm.
    pub request_nm: f64,
}

/// A command reaches its joint through LinuxCNC's interpolator, which spreads a step over this many
/// cycles.
const SPREAD: usize = 5;

/// Returns the largest steps in these cycles.
///
/// # Errors
/// Cycles are missing: then nothing is known.
pub fn steps(samples: &[Sample]) -> Result<Steps> {
    let mut seen = Steps { cycles: samples.len(), ..Steps::default() };
    for pair in samples.windows(2) {
        let gap = pair[1].number - pair[0].number;
        ensure!(gap == 1, "{gap} cycles between two that follow each other");
    }
    for axis in 0..3 {
        let commanded: Vec<f64> = samples
            .windows(2)
            .map(|pair| (pair[1].command[axis] - pair[0].command[axis]).abs())
            // Switching on takes the offset into the position: the joint stays where it is.
            .zip(samples.windows(2).map(|pair| pair[0].on && pair[1].on))
            .map(|(step, on)| if on { step } else { 0.0 })
            .collect();
        for (index, pair) in samples.windows(2).enumerate() {
            let around = index.saturating_sub(SPREAD)..(index + SPREAD + 1).min(commanded.len());
            let largest = commanded[around].iter().copied().fold(0.0, f64::max);
            let joint = (pair[1].joint[axis] - pair[0].joint[axis]).abs();
            seen.joint_nm = seen.joint_nm.max((joint - largest) * 1e6);
            let request = (pair[1].request[axis] - pair[0].request[axis]).abs() * 1e6;
            let lead = |sample: &Sample| (sample.request[axis] - pair[1].eoffset[axis]).abs();
            // Machine on sets it to 0, and at a soft limit it is taken back to where the offset
            // stands: neither moves anything.
            if pair[0].on && pair[1].on && lead(&pair[1]) > lead(&pair[0]) {
                seen.request_nm = seen.request_nm.max(request);
            }
        }
    }
    Ok(seen)
}
