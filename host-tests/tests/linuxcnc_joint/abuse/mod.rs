//! `cargo xtask linuxcnc abuse`: events drawn by a seed happen to the real LinuxCNC with offsets that act, and every
//! servo cycle is judged.
//!
//! | file | has |
//! |---|---|
//! | `rig` | the ways of entering, and how all is brought in order after an event |
//! | `events` | what happens |
//! | `judge` | what no cycle may show |
//! | `verdict` | the table |
//!
//! A seed draws the same events again; when they meet the servo thread depends on the computer.

mod events;
mod judge;
mod rig;
mod verdict;

use std::{
    env,
    str::FromStr,
    thread,
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result, ensure};
use trueup_emulator::setup::{self, LockedLinuxCnc};

use super::MAX_ACCELERATION;

use self::{
    events::{Kind, Measured},
    rig::{Abused, Way},
    verdict::Outcome,
};

/// Settings, by the environment: `TRUEUP_ABUSE_…`.
struct Settings {
    seed: u64,
    cycles: u64,
    events: usize,
    ways: Vec<Way>,
}

impl Settings {
    /// Reads them; few events where nothing is asked for.
    fn read() -> Result<Self> {
        fn number<T: FromStr>(name: &str, without: T) -> Result<T> {
            let Ok(text) = env::var(name) else { return Ok(without) };
            text.parse().ok().with_context(|| format!("{name} is \"{text}\": a number is needed"))
        }
        let ways = env::var("TRUEUP_ABUSE_WAYS").unwrap_or("joint,eoffset,no-board".into());
        Ok(Self {
            seed: number("TRUEUP_ABUSE_SEED", 1)?,
            cycles: number("TRUEUP_ABUSE_CYCLES", 60_000)?,
            events: number("TRUEUP_ABUSE_EVENTS", 60)?,
            ways: ways.split(',').map(Way::parse).collect::<Result<_>>()?,
        })
    }
}

#[test]
#[ignore = "campaign: cargo xtask linuxcnc abuse"]
fn campaign_abuse() -> Result<()> {
    let Settings { seed, cycles, events, ways } = Settings::read()?;
    let each = ways.len();
    println!("seed {seed}: {cycles} servo cycles and {events} events, by {each} ways of entering");
    let (mut outcomes, mut version) = (Vec::new(), String::new());
    for (way, seed) in ways.iter().zip(seed..) {
        let Some(control) = setup::install_and_lock_linuxcnc()? else {
            println!("skipped: this distribution has no package of LinuxCNC");
            return Ok(());
        };
        let share = (cycles.div_ceil(each as u64), events.div_ceil(each));
        outcomes.push(abuse(*way, control, seed, share, &mut version)?);
    }
    println!("seed {seed}\n{}", verdict::text(&outcomes, &version));
    let failures = outcomes.iter().map(|outcome| outcome.failures().len()).sum::<usize>();
    ensure!(failures == 0, "{failures} requirements are not reached: see above");
    Ok(())
}

/// Abuses one for at least these numbers of cycles and events.
fn abuse(
    way: Way,
    control: LockedLinuxCnc,
    seed: u64,
    (cycles, events): (u64, usize),
    version: &mut String,
) -> Result<Outcome> {
    let mut rig = Abused::start(way, control, seed)?;
    *version = rig.version()?;
    let begun = Instant::now();
    // A servo cycle is a millisecond; a busy computer is late.
    let timeout = Duration::from_secs(120 + cycles / 500 + 5 * events as u64);
    let (mut happened, mut lost, mut ended) = (Vec::new(), Vec::new(), None);
    let (mut off_um, mut most) = ([0.0_f64; 3], Measured::default());
    while rig.judge.cycles < cycles || happened.len() < events {
        if begun.elapsed() > timeout {
            ended = Some(format!("it was not done after {} s", timeout.as_secs()));
            break;
        }
        let kind = Kind::draw(&mut rig);
        happened.push(kind);
        let number = happened.len();
        rig.cnc.send_request_with_argument("mark", "scenario", number)?;
        match kind.happen(&mut rig).and_then(|measured| Ok((measured, rig.settle()?))) {
            Ok((measured, off)) => {
                most.take(&measured);
                off_um = std::array::from_fn(|axis| off_um[axis].max(off[axis].abs()));
            }
            Err(error) => {
                let error = format!("{error:#}");
                let first = error.lines().next().unwrap_or_default();
                lost.push(format!("event {number}, {}: {first}", kind.name()));
                println!("lost: {}", lost[lost.len() - 1]);
                println!("{}", rig.state().unwrap_or_else(|error| format!("{error:#}")));
                if let Err(error) = rig.recover() {
                    ended = Some(format!("it cannot be brought in order again: {error:#}"));
                }
            }
        }
        rig.judge();
        if number.is_multiple_of(50) {
            let minutes = begun.elapsed().as_secs_f64() / 60.0;
            println!(
                "{}: {number} events, {} cycles, {minutes:.1} min",
                way.name(),
                rig.judge.cycles
            );
        }
        if ended.is_some() {
            break;
        }
    }
    // What the recorder holds back for a moment.
    thread::sleep(Duration::from_millis(300));
    rig.judge();
    rig.cnc.close()?;
    Ok(Outcome {
        way,
        full_acceleration: MAX_ACCELERATION,
        judge: rig.judge,
        events: happened,
        off_um,
        probed_um: most.probed_um,
        beyond_limit_um: most.beyond_limit_um,
        lost,
        ended,
        seconds: begun.elapsed().as_secs_f64(),
    })
}
