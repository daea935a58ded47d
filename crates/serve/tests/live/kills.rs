//! Publisher and broker are killed at drawn instants: each record arrives, with one identifier however often, and the state is right again at once.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::Path,
    thread,
    time::{Duration, Instant},
};

use anyhow::{Result, ensure};
use serde_json::json;
use trueup_serve::spool::segment::{decode, scan};

use crate::{
    bridge::{self, Switches},
    parts::{Host, Mosquitto, PATIENCE, Start},
};

/// After a restart the state must be right within this time.
const RIGHT: Duration = Duration::from_secs(2);

/// Numbers that look drawn, the same for the same seed.
struct Draw(u64);

impl Draw {
    fn below(&mut self, end: u64) -> u64 {
        // Knuth's MMIX.
        self.0 =
            self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) % end
    }
}

/// Adds the identifiers of all whole records of a spool whose publisher is dead, with their payloads.
fn note(folder: &Path, recorded: &mut BTreeMap<String, Vec<u8>>) -> Result<()> {
    for path in fs::read_dir(folder)?.flatten().map(|it| it.path()) {
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let Some(id) = name.strip_suffix(".spool").and_then(|it| it.split_once('-')) else {
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

/// Kills by this many schedules; returns how many records there were, and the longest time until the state was right.
fn schedules(count: u32, seed: u64) -> Result<(usize, Duration)> {
    let folder = tempfile::tempdir()?;
    let mut broker = Mosquitto::start(folder.path(), "")?;
    let host = Host::start(broker.port)?;
    // Its session is on the broker's disk before it is killed.
    thread::sleep(Duration::from_millis(1_500));
    let mut start = Start {
        bridge: bridge::start(Switches::default()),
        name: "n".into(),
        spool: folder.path().join("spool"),
        url: broker.url(),
        more: json!({ "row_ms": 100 }),
    };
    start.name = "n".into();
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
            broker.kill();
            thread::sleep(Duration::from_millis(draw.below(1_500)));
            broker.restart()?;
        }
        let restarted = Instant::now();
        if what != 1 {
            publisher = start.spawn()?;
            let (at, _) = host.wait_since(restarted, "the state after a restart", |it| {
                it["what"] == "DBIRTH" && it["metrics"]["Offset/Z"].is_f64()
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
    let end = Instant::now() + PATIENCE;
    loop {
        let said = host.said();
        let came: BTreeSet<&str> = said.iter().filter_map(|(_, it)| it["id"].as_str()).collect();
        let missing: Vec<&String> =
            recorded.keys().filter(|id| !came.contains(id.as_str())).collect();
        if missing.is_empty() {
            break;
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
    Ok((recorded.len(), longest))
}

#[test]
fn nothing_that_was_recorded_is_lost_in_three_schedules() -> Result<()> {
    let (records, longest) = schedules(3, 3)?;
    println!("3 schedules: {records} recorded, 0 lost; state right after {longest:?} at most");
    assert!(records > 20, "{records}");
    Ok(())
}

#[test]
#[ignore = "long: 12 schedules of kills, a minute"]
fn nothing_that_was_recorded_is_lost_in_twelve_schedules() -> Result<()> {
    let (records, longest) = schedules(12, 44)?;
    println!("12 schedules: {records} recorded, 0 lost; state right after {longest:?} at most");
    Ok(())
}

/// 50 schedules of kills, four minutes.
#[test]
#[ignore = "campaign: cargo test -p trueup-serve --test live campaign_ -- --ignored --nocapture"]
fn campaign_nothing_is_lost_in_fifty_schedules_of_kills() -> Result<()> {
    let (records, longest) = schedules(50, 2_026)?;
    println!("50 schedules: {records} recorded, 0 lost; state right after {longest:?} at most");
    Ok(())
}
