//! A thousand bridges as devices of one edge node: what memory and processor the publisher takes, with a real broker.
//!
//! The bridges are frames: the lines to them, a few threads each, are left out. All else is the publisher's own. A campaign
//! measures a line.

use std::{
    fs,
    path::Path,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread,
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result, ensure};
use trueup_client::connection::ConnectionEvent;
use trueup_core::{
    cnc::{OffsetQuality, Output},
    units::Nanometres,
};
use trueup_link::{
    frame::Frame,
    frames,
    layout::SDO_RESPONSE_ID,
    slcan::AdapterMessage,
    status::{StateBits, Status, StatusItem, encode},
};
use trueup_serve::{
    bridge::BridgeMonitor,
    broker::{self, TlsFiles},
    clock,
    mqtt::{self, MqttPublisherConfig},
    mtconnect::adapter::MtconnectAdapter,
    recorder::Recorder,
    shared_state::SharedState,
    sparkplug::node::EdgeNode,
    spool::Spool,
};

use crate::{
    bridge::{self, Switches},
    parts::{Broker, Host, Mosquitto, Start},
};

const BRIDGES: usize = 1_000;
/// The most that they may take.
const MAX_MB: f64 = 300.0;
/// Once it runs evenly it is measured for this long.
const MEASURED: Duration = Duration::from_secs(30);
/// Each bridge says its offsets so often; a real one does so a thousand times a second, in a thread of its own.
const SAID: Duration = Duration::from_millis(250);

/// Lets a bridge say its offset and a part of its status, and answer what it was asked.
fn speak(bridge: &mut BridgeMonitor, place: usize, turn: usize, now: Instant) {
    let deliver = |bridge: &mut BridgeMonitor, frame: Frame| {
        bridge.receive(ConnectionEvent::Received(AdapterMessage::Frame(frame)), now);
    };
    let nm = ((place + turn) % 1_000) as i32 * 10;
    let offset = Some([nm, -nm, 2 * nm].map(Nanometres));
    let output = Output { offset, quality: OffsetQuality::Live, ..Output::default() };
    let counter = turn as u8;
    deliver(bridge, frames::encode_offset_xy(&output, counter));
    deliver(bridge, frames::encode_offset_z(&output, counter));
    let centi_c = [Some(2_000 + ((place + turn) % 100) as i16), Some(2_100)];
    let item = match turn % 3 {
        0 => StatusItem::State(StateBits::default()),
        1 => StatusItem::Temperatures { pair: (turn / 3 % 4) as u8, centi_c },
        _ => StatusItem::Calibration(7),
    };
    deliver(bridge, encode(&Status { last_refused: Default::default(), item }, counter));
    if let Some(request) = bridge.take_due_request(now) {
        let [_, low, high, sub, ..] = *request.data();
        let serial = (place as u32 + 1).to_le_bytes();
        let is_serial = (low, high, sub) == (0x18, 0x10, 4);
        let kind = if is_serial { 0x43 } else { 0x80 };
        let answer = [kind, low, high, sub, serial[0], serial[1], serial[2], serial[3]];
        deliver(bridge, Frame::new(SDO_RESPONSE_ID, &answer).expect("eight bytes"));
    }
}

/// The cost of a process so far.
struct Cost {
    /// Seconds of a processor.
    cpu_s: f64,
    /// The most memory, in MB.
    peak_mb: f64,
    threads: f64,
}

/// Returns the cost of a process, by its number or `self`.
fn cost(process: &str) -> Result<Cost> {
    let stat = fs::read_to_string(format!("/proc/{process}/stat"))?;
    let fields: Vec<&str> = stat.rsplit_once(')').context("a name")?.1.split_whitespace().collect();
    let ticks: f64 = fields[11].parse::<f64>()? + fields[12].parse::<f64>()?;
    let status = fs::read_to_string(format!("/proc/{process}/status"))?;
    let of = |key: &str| -> Result<f64> {
        let line =
            status.lines().find_map(|line| line.strip_prefix(key)).context("Linux has it")?;
        Ok(line.trim_end_matches("kB").trim().parse()?)
    };
    Ok(Cost { cpu_s: ticks / 100.0, peak_mb: of("VmHWM:")? / 1_024.0, threads: of("Threads:")? })
}

/// Returns the bytes of all files in a folder.
fn bytes(folder: &Path) -> Result<u64> {
    let files = fs::read_dir(folder)?.flatten();
    files.map(|entry| Ok(entry.metadata()?.len())).sum()
}

/// `cargo test -p trueup-serve --test live -- --ignored --nocapture a_thousand_bridges`
#[test]
#[ignore = "long: a thousand bridges for 45 s"]
fn a_thousand_bridges_at_one_edge_node_take_little_memory() -> Result<()> {
    let folder = tempfile::tempdir()?;
    let broker = Mosquitto::start(folder.path(), "autosave_interval 30")?;
    a_thousand(folder.path(), &broker)
}

/// Publishes a thousand bridges to a broker, and prints the cost of both.
pub fn a_thousand(folder: &Path, broker: &dyn Broker) -> Result<()> {
    let url = format!("mqtt://127.0.0.1:{}", broker.port());
    let stop = Arc::new(AtomicBool::new(false));
    let now = Instant::now();
    let mut bridges: Vec<BridgeMonitor> = (0..BRIDGES).map(|_| BridgeMonitor::new(now)).collect();
    bridges.iter_mut().for_each(|bridge| _ = bridge.receive(ConnectionEvent::Up, now));
    let spool = Spool::open(&folder.join("spool"), 512 << 20)?;
    let shared = SharedState::new(bridges, spool, stop.clone());
    let feeding = shared.clone();
    let feed = thread::spawn(move || {
        for turn in 0.. {
            let began = Instant::now();
            for place in 0..BRIDGES {
                if let Some(mut bridge) = feeding.lock_bridge(place) {
                    speak(&mut bridge, place, turn, Instant::now());
                }
            }
            if feeding.is_stop_requested() {
                return;
            }
            thread::sleep(SAID.saturating_sub(began.elapsed()));
        }
    });
    let publisher = MqttPublisherConfig {
        broker: broker::BrokerConfig::from_url(&url, None, TlsFiles::default())?,
        name: "shop".into(),
        id: "trueup-shop".into(),
        primary_host: None,
        keep_bd_seq: Box::new(|_| ()),
        report: Box::new(|text| println!("{text}")),
    };
    let publishing = shared.clone();
    let mqtt = thread::spawn(move || {
        let mut node = EdgeNode::new("shop", "me", "0.0.0", 0);
        mqtt::run(&publishing, &publisher, &mut node);
    });
    let adapter = MtconnectAdapter::default();
    let mut recorder = Recorder::new("shop", Duration::from_secs(1), true, now, clock::now_ms());
    let (mut begun, mut longest) = (None, Duration::ZERO);
    while now.elapsed() < MEASURED + Duration::from_secs(15) {
        let at = Instant::now();
        if begun.is_none() && now.elapsed() > Duration::from_secs(10) {
            let acknowledged = shared.counts().acknowledged.load(Ordering::Relaxed);
            begun = Some((at, cost("self")?, cost(&broker.process())?, acknowledged));
        }
        let snapshots = shared.snapshots();
        let events =
            recorder.record_snapshots(&shared, &snapshots, (at, clock::now_ms()), &|line| {
                println!("{line}")
            });
        adapter.update(&snapshots, &events, clock::now_ms());
        longest = longest.max(at.elapsed());
        thread::sleep(Duration::from_millis(50));
    }
    let (begun, own_begun, broker_begun, acknowledged) = begun.context("it has begun")?;
    let (own, of_broker) = (cost("self")?, cost(&broker.process())?);
    let passed_s = begun.elapsed().as_secs_f64();
    let percent = |from: &Cost, to: &Cost| 100.0 * (to.cpu_s - from.cpu_s) / passed_s;
    let peak_mb = own.peak_mb;
    let counts = shared.counts();
    let sent = counts.acknowledged.load(Ordering::Relaxed) - acknowledged;
    let recorded = counts.recorded.load(Ordering::Relaxed);
    let waiting = shared.lock_spool().unacknowledged_count();
    println!(
        "{BRIDGES} bridges: {peak_mb:.0} MB at most, {:.0} % of a core, {:.0} records a second acknowledged, \
         {recorded} recorded of {} bytes each, {waiting} waiting, the longest turn {longest:?}; \
         the broker: {:.0} MB, {:.0} % of a core",
        percent(&own_begun, &own),
        sent as f64 / passed_s,
        bytes(&folder.join("spool"))? / recorded.max(1),
        of_broker.peak_mb,
        percent(&broker_begun, &of_broker),
    );
    stop.store(true, Ordering::Relaxed);
    mqtt.join().ok().context("the publisher")?;
    feed.join().ok().context("the bridges")?;
    ensure!(peak_mb <= MAX_MB, "{peak_mb} MB");
    ensure!(sent as f64 >= 0.8 * BRIDGES as f64 * passed_s, "{sent} in {passed_s} s");
    Ok(())
}

/// Returns what a publisher with this number of bridges, a thousand offsets a second each, uses of a core, and its cost.
fn with_lines(count: usize) -> Result<(f64, Cost)> {
    const SETTLED: Duration = Duration::from_secs(5);
    const MEASURED: Duration = Duration::from_secs(20);
    let folder = tempfile::tempdir()?;
    let broker = Mosquitto::start(folder.path(), "")?;
    let host = Host::start(broker.port)?;
    let bridges: Vec<String> = (0..count).map(|_| bridge::start(Switches::default())).collect();
    let start = Start {
        bridge: bridges.join(","),
        name: "n".into(),
        spool: folder.path().join("spool"),
        url: broker.url(),
        ..Start::default()
    };
    let publisher = start.spawn()?;
    let process = publisher.0.id().to_string();
    host.wait("a birth", |message| message["what"] == "DBIRTH")?;
    thread::sleep(SETTLED);
    let (begun, before) = (Instant::now(), cost(&process)?);
    thread::sleep(MEASURED);
    let after = cost(&process)?;
    let used = (after.cpu_s - before.cpu_s) / begun.elapsed().as_secs_f64();
    Ok((used, after))
}

/// The lines to the bridges, which the thousand above do without.
#[test]
#[ignore = "campaign: cargo test -p trueup-serve --test live campaign_a_line -- --ignored --nocapture"]
fn campaign_a_line_takes_little_of_a_core() -> Result<()> {
    const MORE: usize = 8;
    let (one, of_one) = with_lines(1)?;
    let (all, of_all) = with_lines(1 + MORE)?;
    let of_line = |one: f64, all: f64| (all - one) / MORE as f64;
    println!(
        "one bridge: {:.1} % of a core, {:.1} MB, {} threads; each more: {:.1} %, {:.2} MB, {:.1} threads",
        100.0 * one,
        of_one.peak_mb,
        of_one.threads,
        100.0 * of_line(one, all),
        of_line(of_one.peak_mb, of_all.peak_mb),
        of_line(of_one.threads, of_all.threads)
    );
    ensure!(of_one.peak_mb < 50.0, "{} MB", of_one.peak_mb);
    Ok(())
}
