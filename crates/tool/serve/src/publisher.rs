//! A publisher as a whole: opens what it needs, starts the threads, records, and says what it did.

use std::{
    fs,
    net::{SocketAddr, TcpListener},
    path::{Path, PathBuf},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread,
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result};
use serde_json::{Value, json};
use trueup_client::port::PortAddress;

use crate::{
    bridge::BridgeMonitor,
    broker::BrokerConfig,
    clock,
    mqtt::{self, MqttPublisherConfig},
    mtconnect::{adapter::MtconnectAdapter, devices},
    publisher_identity::{self, PublisherIdentity},
    recorder::Recorder,
    shared_state::{self, SharedState},
    snapshot::{BridgeIdentity, BridgeSnapshot},
    sparkplug::node::EdgeNode,
    spool::Spool,
};

/// From one look at the bridges to the next.
const POLL_INTERVAL: Duration = Duration::from_millis(50);
/// How long one try waits for both ends.
const ONCE_TIMEOUT: Duration = Duration::from_secs(5);

/// The ends of a publisher, and how it publishes.
pub struct PublisherOptions {
    /// The bridges.
    pub ports: Vec<PortAddress>,
    /// The name of the edge node.
    pub name: String,
    /// The folder of the spool.
    pub spool: PathBuf,
    /// Maximum bytes of records in it.
    pub spool_bytes: u64,
    /// From one recorded row to the next.
    pub row: Duration,
    /// The broker, if there is one.
    pub broker: Option<BrokerConfig>,
    /// The host application without which nothing is published.
    pub primary_host: Option<String>,
    /// Where agents of MTConnect connect.
    pub mtconnect: Vec<SocketAddr>,
    /// Where `Devices.devices_xml` is written.
    pub devices: Option<PathBuf>,
    /// Try once whether both ends are there, and end.
    pub once: bool,
    /// The version of the program.
    pub version: &'static str,
}

/// The result of a publisher that has ended.
pub struct PublisherSummary {
    /// Every end was there.
    pub is_whole: bool,
    /// The counts, for people and programs.
    pub counts: Value,
}

/// Publishes until `stop` is set.
///
/// # Errors
/// The spool is another process's or cannot be used, or nothing can listen for agents.
pub fn run(
    options: PublisherOptions,
    stop: Arc<AtomicBool>,
    report: impl Fn(&str) + Clone + Send + 'static,
) -> Result<PublisherSummary> {
    let spool = Spool::open(&options.spool, options.spool_bytes)?;
    let now = Instant::now();
    let bridges = options.ports.iter().map(|_| BridgeMonitor::new(now)).collect();
    let shared = SharedState::new(bridges, spool, stop.clone());
    let mut threads = Vec::new();
    for (place, port) in options.ports.iter().enumerate() {
        let port = port.clone();
        threads.push(shared_state::spawn_bridge_thread(shared.clone(), place, move || port.open()));
    }
    let adapter = MtconnectAdapter::default();
    if !options.mtconnect.is_empty() {
        let listener = TcpListener::bind(&options.mtconnect[..])
            .with_context(|| format!("nothing can listen at {:?}", options.mtconnect))?;
        let address = adapter.serve(shared.clone(), listener)?;
        report(&format!("agents of MTConnect reach the bridge at {address}"));
        if !address.ip().is_loopback() {
            report(&format!("warning: every computer that reaches {address} can read the bridge"));
        }
    }
    let has_broker = options.broker.is_some();
    if let Some(broker) = options.broker.clone() {
        if broker.is_unencrypted() {
            report("warning: what is published can be read on the network: use mqtts://");
        }
        threads.push(spawn_mqtt_publisher(&shared, &options, broker, report.clone())?);
    }
    let mut work = MainLoop { options: &options, shared: &shared, adapter, described: None };
    let mut recorder = Recorder::new(&options.name, options.row, has_broker, now, clock::now_ms());
    while !shared.is_stop_requested() {
        let snapshots = shared.snapshots();
        work.update_device_description(&snapshots, &report);
        let at = (Instant::now(), clock::now_ms());
        let events = recorder.record_snapshots(&shared, &snapshots, at, &report);
        work.adapter.update(&snapshots, &events, at.1);
        let is_over = work.is_fully_connected(&snapshots) || now.elapsed() >= ONCE_TIMEOUT;
        if options.once && is_over {
            break;
        }
        thread::sleep(POLL_INTERVAL);
    }
    let is_whole = work.is_fully_connected(&shared.snapshots());
    stop.store(true, Ordering::Relaxed);
    for thread in threads {
        thread.join().ok().context("a thread has panicked")?;
    }
    Ok(PublisherSummary { is_whole, counts: counts_json(&shared) })
}

fn spawn_mqtt_publisher(
    shared: &SharedState,
    options: &PublisherOptions,
    broker: BrokerConfig,
    report: impl Fn(&str) + Send + 'static,
) -> Result<thread::JoinHandle<()>> {
    let PublisherIdentity { id, bd_seq } = publisher_identity::read_or_create(&options.spool)?;
    let (folder, retained) = (options.spool.clone(), id.clone());
    let publisher = MqttPublisherConfig {
        broker,
        name: options.name.clone(),
        id: format!("trueup-{}-{id}", options.name),
        primary_host: options.primary_host.clone(),
        // If it is lost, the numbers begin anew.
        keep_bd_seq: Box::new(move |bd_seq| {
            publisher_identity::write(&folder, &PublisherIdentity { id: retained.clone(), bd_seq })
                .ok();
        }),
        report: Box::new(report),
    };
    let mut node = EdgeNode::new(&options.name, &id, options.version, bd_seq);
    let shared = shared.clone();
    Ok(thread::spawn(move || mqtt::run(&shared, &publisher, &mut node)))
}

/// The work of the main thread in each turn.
struct MainLoop<'a> {
    options: &'a PublisherOptions,
    shared: &'a SharedState,
    adapter: MtconnectAdapter,
    /// The bridges that `Devices.devices_xml` describes.
    described: Option<Vec<BridgeIdentity>>,
}

impl MainLoop<'_> {
    /// Writes `Devices.devices_xml` when it is known who the bridges are, and when that changes.
    fn update_device_description(&mut self, bridges: &[BridgeSnapshot], report: &dyn Fn(&str)) {
        if self.options.mtconnect.is_empty() && self.options.devices.is_none() {
            return;
        }
        let identities: Vec<BridgeIdentity> =
            bridges.iter().map(|bridge| bridge.identity.clone()).collect();
        if self.described.as_ref() == Some(&identities) {
            return;
        }
        let path = self.options.devices.clone();
        let path = path.unwrap_or_else(|| self.options.spool.join("Devices.xml"));
        let time = clock::format_utc(clock::now_ms());
        let xml = devices::devices_xml(&self.options.name, &identities, &time);
        if let Err(error) = replace_file(&path, &xml)
            && self.described.is_none()
        {
            report(&format!("warning: {}: {error}", path.display()));
        }
        self.described = Some(identities);
    }

    /// Returns whether every bridge is there, and the broker if there is one.
    fn is_fully_connected(&self, bridges: &[BridgeSnapshot]) -> bool {
        let is_online = self.shared.counts().is_online.load(Ordering::Relaxed);
        let are_there =
            bridges.iter().all(|bridge| bridge.is_up && bridge.identity.serial.is_some());
        are_there && (self.options.broker.is_none() || is_online)
    }
}

/// Writes a file as a whole, or leaves the one that is there.
fn replace_file(path: &Path, text: &str) -> std::io::Result<()> {
    let new = path.with_extension("new");
    fs::write(&new, text)?;
    fs::rename(&new, path)
}

/// Returns what was done since the beginning.
fn counts_json(shared: &SharedState) -> Value {
    let counts = shared.counts();
    let of = |count: &std::sync::atomic::AtomicU64| count.load(Ordering::Relaxed);
    json!({
        "recorded": of(&counts.recorded),
        "not_recorded": of(&counts.not_recorded),
        "acknowledged": of(&counts.acknowledged),
        "waiting": shared.lock_spool().unacknowledged_count(),
        "lost": of(&counts.lost),
        "ignored_messages": of(&counts.hostile),
        "lost_frames": shared.snapshots().iter().map(|snapshot| snapshot.lost_frames).sum::<u32>(),
    })
}
