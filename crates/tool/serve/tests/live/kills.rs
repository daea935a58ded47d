//! Publisher and broker are killed at drawn instants: each record arrives, with one identifier however often, and the state is right again at once.

use std::{
    collections::{BTreeMap, BTreeSet},
    env, fs,
    path::Path,
    process::Command,
    thread,
    time::{Duration, Instant},
};

use anyhow::{Result, ensure};
use serde_json::json;
use trueup_serve::spool::segment::{decode, scan};

use crate::{
    bridge::{self, Switches},
    parts::{Broker, Host, Mosquitto, Start, TIMEOUT},
};

/// After a restart the state must be right within this time.
const RIGHT: Duration = Duration::from_secs(2);

/// Numbers that look drawn, the same for the same seed.
pub struct Draw(pub u64);

impl Draw {
    pub fn below(&mut self, end: u64) -> u64 {
        // Knuth's MMIX.
        self.0 =
            self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) % end
    }
}

/// Adds the identifiers of all whole records of a spool, with their payloads.
fn note(folder: &Path, recorded: &mut BTreeMap<String, Vec<u8>>) -> Result<()> {
    for path in fs::read_dir(folder)?.flatten().map(|entry| entry.path()) {
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let Some(id) = name.strip_suffix(".spool").and_then(|rest| rest.split_once('-')) else {
            continue;
        };
        let (id, bytes) = (u64::from_str_radix(id.1, 16)?, fs::read(&path)?);
        for entry in scan(id, &bytes).0 {
            let (record, _) = decode(id, &bytes[entry.at as usize..]).expect("whole");
            let key = format!("{id:016x}-{}", record.number);
            let old = recorded.insert(key, record.payload.clone());
            ensure!(old.is_none_or(|old| old == record.payload), "one identifier, two records");
        }
    }
    Ok(())
}

/// Waits until each of these records has come to a host.
fn all_come(host: &Host, recorded: &BTreeMap<String, Vec<u8>>, start: &Start) -> Result<()> {
    let end = Instant::now() + TIMEOUT;
    loop {
        let messages = host.messages();
        let came: BTreeSet<&str> =
            messages.iter().filter_map(|(_, message)| message["id"].as_str()).collect();
        let missing: Vec<&String> =
            recorded.keys().filter(|id| !came.contains(id.as_str())).collect();
        if missing.is_empty() {
            return Ok(());
        }
        ensure!(
            Instant::now() < end,
            "{} of {} never came, such as {:?}\n{}",
            missing.len(),
            recorded.len(),
            missing.first(),
            start.log()
        );
        thread::sleep(Duration::from_millis(50));
    }
}

/// Stops a process where it is.
fn stop(process: &str) -> Result<()> {
    let ended = Command::new("sh").args(["-c", &format!("kill -STOP {process}")]).status()?;
    ensure!(ended.success(), "process {process} cannot be stopped");
    Ok(())
}

/// Kills by this many schedules; returns the records that there were, and the longest time until the state was right.
pub fn schedules(
    count: u32,
    seed: u64,
    folder: &Path,
    broker: &mut dyn Broker,
) -> Result<(BTreeSet<String>, Duration)> {
    let host = Host::start(broker.port())?;
    // Its session is on the broker's disk before it is killed.
    thread::sleep(Duration::from_millis(1_500));
    let start = Start {
        bridge: bridge::start(Switches::default()),
        name: "n".into(),
        spool: folder.join("spool"),
        url: format!("mqtt://127.0.0.1:{}", broker.port()),
        more: json!({ "row_ms": 100 }),
    };
    let (mut draw, mut recorded, mut longest) = (Draw(seed), BTreeMap::new(), Duration::ZERO);
    let mut publisher = start.spawn()?;
    for schedule in 0..count {
        thread::sleep(Duration::from_millis(300 + draw.below(1_700)));
        let what = draw.below(3);
        if what != 1 {
            publisher.kill();
            note(&start.spool, &mut recorded)?;
        }
        if what != 0 {
            // What is sent meanwhile is at the broker and is not acknowledged.
            if draw.below(2) == 0 {
                stop(&broker.process())?;
                thread::sleep(Duration::from_millis(100 + draw.below(400)));
            }
            broker.kill(Duration::from_millis(draw.below(1_500)))?;
        }
        let restarted = Instant::now();
        if what == 1 {
            // A publisher that is started again sends all that it has; this one must do so too.
            note(&start.spool, &mut recorded)?;
            all_come(&host, &recorded, &start)?;
        } else {
            publisher = start.spawn()?;
            let (at, _) = host.wait_since(restarted, "the state after a restart", |message| {
                message["what"] == "DBIRTH" && message["metrics"]["Offset/Z"].is_f64()
            })?;
            // After the broker was killed the host itself needs a second to come back.
            if what == 0 {
                longest = longest.max(at - restarted);
                ensure!(at - restarted <= RIGHT, "schedule {schedule}: {:?}", at - restarted);
            }
        }
    }
    thread::sleep(Duration::from_secs(1));
    publisher.kill();
    note(&start.spool, &mut recorded)?;
    let _publisher = start.spawn()?;
    all_come(&host, &recorded, &start)?;
    Ok((recorded.into_keys().collect(), longest))
}

/// The same with mosquitto; returns how many records there were.
fn with_mosquitto(count: u32, seed: u64) -> Result<usize> {
    let folder = tempfile::tempdir()?;
    let mut broker = Mosquitto::start(folder.path(), "")?;
    let (records, longest) = schedules(count, seed, folder.path(), &mut broker)?;
    let records = records.len();
    println!(
        "{count} schedules: {records} recorded, 0 lost; state right after {longest:?} at most"
    );
    Ok(records)
}

#[test]
fn nothing_that_was_recorded_is_lost_in_three_schedules() -> Result<()> {
    let records = with_mosquitto(3, 3)?;
    assert!(records > 20, "{records}");
    Ok(())
}

#[test]
#[ignore = "long: 12 schedules of kills, a minute"]
fn nothing_that_was_recorded_is_lost_in_twelve_schedules() -> Result<()> {
    with_mosquitto(12, 44).map(|_| ())
}

/// 50 schedules of kills, four minutes.
#[test]
#[ignore = "campaign: cargo test -p trueup-serve --test live campaign_ -- --ignored --nocapture"]
fn campaign_nothing_is_lost_in_fifty_schedules_of_kills() -> Result<()> {
    with_mosquitto(50, 2_026).map(|_| ())
}

/// Kills a publisher so often, at drawn instants, and starts it again at once; returns the times until its state was right.
fn restarts(host: &Host, start: &Start, count: u64, mut draw: Draw) -> Result<Vec<Duration>> {
    let wait = |since| {
        host.wait_since(since, "the state after a restart", |message| {
            message["what"] == "DBIRTH"
                && message["node"] == start.name.as_str()
                && message["metrics"]["Offset/Z"].is_f64()
        })
    };
    let begun = Instant::now();
    let mut publisher = start.spawn()?;
    wait(begun)?;
    let mut times = Vec::new();
    for _ in 0..count {
        thread::sleep(Duration::from_millis(draw.below(300)));
        publisher.kill();
        let restarted = Instant::now();
        publisher = start.spawn()?;
        times.push(wait(restarted)?.0 - restarted);
    }
    Ok(times)
}

/// `TRUEUP_RESTARTS` is another number than 1,000.
#[test]
#[ignore = "campaign: cargo test -p trueup-serve --test live campaign_the_state -- --ignored --nocapture"]
fn campaign_the_state_is_right_after_each_of_a_thousand_restarts() -> Result<()> {
    const PUBLISHERS: u64 = 4;
    let expected: u64 = env::var("TRUEUP_RESTARTS").map_or(Ok(1_000), |text| text.parse())?;
    let folder = tempfile::tempdir()?;
    let broker = Mosquitto::start(folder.path(), "")?;
    let host = Host::start(broker.port)?;
    let one = |number: u64| {
        let name = format!("n{number}");
        let start = Start {
            bridge: bridge::start(Switches::default()),
            spool: folder.path().join(&name),
            name,
            url: broker.url(),
            ..Start::default()
        };
        restarts(&host, &start, expected.div_ceil(PUBLISHERS), Draw(number + 1))
    };
    let times: Vec<Result<Vec<Duration>>> = thread::scope(|scope| {
        let one = &one;
        let threads: Vec<_> =
            (0..PUBLISHERS).map(|index| scope.spawn(move || one(index))).collect();
        threads.into_iter().map(|thread| thread.join().expect("no thread panics")).collect()
    });
    let mut times = times.into_iter().collect::<Result<Vec<_>>>()?.concat();
    times.sort();
    let (count, late) = (times.len(), times.iter().filter(|time| **time > RIGHT).count());
    let of = |share: usize| times[(count - 1) * share / 1_000];
    println!(
        "{count} restarts of {PUBLISHERS} publishers: state right after {:?} in the median, {:?} in 99 of 100, \
         {:?} at most; {late} above {RIGHT:?}",
        of(500),
        of(990),
        of(1_000)
    );
    ensure!(late == 0, "{late} of {count} above {RIGHT:?}");
    Ok(())
}
