//! A Sparkplug host that others wrote reads the publisher, from the birth to the death.

use std::{
    sync::atomic::Ordering,
    thread,
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result};
use serde_json::{Value, json};

use crate::{
    bridge::{self, Switches},
    parts::{Host, Mosquitto, Start},
};

/// The growth of the paper's spindle 100 codes above its zero.
const GROWN_UM: f64 = 12.3;

fn is(kind: &str) -> impl Fn(&Value) -> bool + '_ {
    move |message| message["what"] == kind
}

#[test]
fn a_host_that_others_wrote_sees_births_data_rebirth_and_deaths() -> Result<()> {
    let folder = tempfile::tempdir()?;
    let broker = Mosquitto::start(folder.path(), "")?;
    let mut host = Host::start(broker.port)?;
    let switches = Switches::default();
    let start = Start {
        bridge: bridge::start(switches.clone()),
        name: "mill-7".into(),
        spool: folder.path().join("spool"),
        url: broker.url(),
        ..Start::default()
    };
    let mut publisher = start.spawn()?;

    let (_, birth) = host.wait("the node's birth", is("NBIRTH"))?;
    assert_eq!((&birth["node"], &birth["seq"]), (&json!("mill-7"), &json!(0)));
    let number = birth["metrics"]["bdSeq"].clone();
    assert!(number.is_u64(), "{birth}");
    let (_, device) = host.wait("the device's birth", is("DBIRTH"))?;
    let id = device["device"].as_str().context("a serial number")?.to_owned();
    assert_eq!((id.len(), &device["metrics"]["Bridge/Up"]), (8, &json!(true)));
    let (_, units) = host.wait("units", is("units"))?;
    assert_eq!(units["units"]["Offset/Z"], "µm");
    assert_eq!(units["units"]["Temperature/0"], "°C");

    let near = |value: &Value| value.as_f64().is_some_and(|z| (z - GROWN_UM).abs() < 0.5);
    host.wait("the offset of the grown spindle", |message| {
        message["what"] == "DDATA" && near(&message["metrics"]["Offset/Z"])
    })?;
    host.wait("a row of it, recorded", |message| {
        message["topic"] == format!("trueup/mill-7/{id}/record")
            && near(&message["metrics"]["Offset/Z"])
    })?;

    // A word that has changed does not wait for the second to pass.
    let changed = Instant::now();
    switches.is_disengaged.store(true, Ordering::Relaxed);
    let (at, _) = host.wait_since(changed, "another quality", |message| {
        message["what"] == "DDATA" && message["metrics"]["Bridge/Quality"] == "ramping-out"
    })?;
    println!("a quality arrives after {} ms", (at - changed).as_millis());
    host.wait_since(changed, "the event of it", |message| {
        message["topic"] == format!("trueup/mill-7/{id}/event")
            && message["metrics"]["Event/Code"] == "quality"
            && message["metrics"]["Event/About"] == "ramping-out"
    })?;

    let requested_at = Instant::now();
    host.send_line("rebirth mill-7")?;
    let (_, again) = host.wait_since(requested_at, "a second birth", is("NBIRTH"))?;
    assert_eq!((&again["seq"], &again["metrics"]["bdSeq"]), (&json!(0), &number));
    host.wait_since(requested_at, "and of the device", is("DBIRTH"))?;

    let off = Instant::now();
    switches.is_off.store(true, Ordering::Relaxed);
    let (_, death) = host.wait_since(off, "the death of the device", is("DDEATH"))?;
    assert_eq!(death["device"], id);
    let on = Instant::now();
    switches.is_off.store(false, Ordering::Relaxed);
    host.wait_since(on, "it is there again", is("DBIRTH"))?;

    let killed = Instant::now();
    publisher.kill();
    let (_, death) = host.wait_since(killed, "the will", is("NDEATH"))?;
    assert_eq!(death["metrics"]["bdSeq"], number, "of this connection");

    // Each message of the device and of the node has the next number.
    let messages = host.messages();
    let mut expected = None;
    for (_, it) in messages.iter().filter(|(_, message)| message["seq"].is_u64()) {
        let seq = it["seq"].as_u64();
        let is_birth = it["what"] == "NBIRTH";
        assert!(is_birth || seq == expected, "{it} after {expected:?}");
        expected = seq.map(|seq| (seq + 1) % 256);
    }

    // It only reads, and while it does the bridge's thousand pairs a second come, each one. What is older than 200 ms is left
    // out on purpose: then this computer has held up the publisher, and the bridge, which is here too.
    assert_eq!(*switches.written.lock().expect("whole"), [], "it writes nothing to the bridge");
    let frames = |message: &Value| message["metrics"]["Bridge/Lost frames"].as_u64();
    let lost = messages.iter().filter_map(|(_, message)| frames(message)).max();
    let late_ms = switches.late_ms.load(Ordering::Relaxed);
    println!(
        "{lost:?} of a thousand pairs a second were lost; the bridge was held up for {late_ms} ms"
    );
    let allowed = if late_ms <= 20 { 0 } else { 100 };
    assert!(lost.is_some_and(|lost| lost <= allowed), "{lost:?}, held up for {late_ms} ms");

    // A new connection has a new number, and who comes late sees the state.
    let restarted = Instant::now();
    let _publisher = start.spawn()?;
    let (_, birth) = host.wait_since(restarted, "a new birth", is("NBIRTH"))?;
    let next = number.as_u64().map(|sequence| (sequence + 1) % 256);
    assert_eq!(birth["metrics"]["bdSeq"].as_u64(), next);
    host.wait_since(restarted, "the device", is("DBIRTH"))?;
    thread::sleep(Duration::from_millis(300));
    check_retained_state(&Host::start(broker.port)?, &id)
}

/// Checks that a host which has just subscribed is sent the device's state.
fn check_retained_state(host: &Host, id: &str) -> Result<()> {
    let (_, state) = host.wait("the retained state", |message| {
        message["topic"] == format!("trueup/mill-7/{id}/state") && message["retained"] == true
    })?;
    assert_eq!(state["metrics"]["Bridge/Up"], true);
    Ok(())
}

#[test]
fn without_its_primary_host_nothing_is_published_and_records_wait() -> Result<()> {
    let folder = tempfile::tempdir()?;
    let broker = Mosquitto::start(folder.path(), "")?;
    let mut host = Host::start(broker.port)?;
    let start = Start {
        bridge: bridge::start(Switches::default()),
        name: "n".into(),
        spool: folder.path().join("spool"),
        url: broker.url(),
        more: json!({ "primary_host": "scada", "row_ms": 100 }),
    };
    let _publisher = start.spawn()?;
    thread::sleep(Duration::from_secs(3));
    let all = host.messages();
    assert!(all.iter().all(|(_, message)| message["what"] == "connected"), "{all:?}");

    host.send_line("online scada")?;
    host.wait("a birth", is("DBIRTH"))?;
    let first = |message: &Value| message["id"].as_str().is_some_and(|id| id.ends_with("-1"));
    host.wait("the first record, from before", first)?;
    let left = Instant::now();
    host.send_line("offline scada")?;
    let (died, _) = host.wait_since(left, "the death of the node", is("NDEATH"))?;
    thread::sleep(Duration::from_secs(2));
    let later = host.messages();
    let later = later.iter().filter(|(at, message)| *at > died && message["what"] != "NDEATH");
    assert_eq!(later.filter(|(at, _)| *at - died > Duration::from_millis(300)).count(), 0);
    host.send_line("online scada")?;
    host.wait_since(died, "a new birth", is("NBIRTH"))?;
    Ok(())
}
