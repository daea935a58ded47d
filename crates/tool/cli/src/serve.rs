//! `trueup serve`: the command; `trueup-serve` does the work.

use std::{
    fs,
    path::{Path, PathBuf},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};

use anyhow::{Context as _, Result};
use clap::Args;
use trueup_client::port::PortAddress;
use trueup_serve::{
    broker::{BrokerConfig, TlsFiles},
    publisher::{self, PublisherOptions},
};

use crate::{CommandOutcome, UserError, gateway::resolve_listen_addresses, output};

/// Publishes a bridge's state to MQTT as Sparkplug B and to MTConnect, and its records to MQTT without loss, until
/// Ctrl-C.
///
/// It only reads the bridge. Records and events are on the disk before they count, and stay until the broker has
/// them. Topics, data items and what a broker must be set to: the book, "Publish a bridge". Exit 3 with --once: the
/// bridge or the broker is not there.
#[derive(Args)]
pub struct ServeArgs {
    /// Where the bridge is: tcp:HOST:PORT, a serial device, or a CAN interface (can0). Several bridges are devices of
    /// one edge node.
    #[arg(long = "port", value_name = "PORT", required = true)]
    ports: Vec<String>,
    /// The name of the edge node in the group trueup.
    #[arg(long, value_name = "NAME", value_parser = parse_topic_level)]
    name: String,
    /// The folder of the spool: of one publisher alone.
    #[arg(long, value_name = "DIR")]
    spool: PathBuf,
    /// Records that it has at most, in MB; the oldest give way.
    #[arg(long, value_name = "MB", default_value_t = 256, value_parser = clap::value_parser!(u32).range(4..=1_000_000))]
    spool_mb: u32,
    /// From one recorded row to the next, in s; the state is published once a second in any case.
    #[arg(long, value_name = "S", default_value_t = 1.0, value_parser = parse_row_period_s)]
    record_s: f64,
    /// The broker: mqtt://HOST:PORT, or mqtts://HOST:PORT with TLS.
    #[arg(long, value_name = "URL", required_unless_present = "mtconnect")]
    mqtt: Option<String>,
    /// The user that the broker knows.
    #[arg(long, value_name = "USER", requires = "mqtt", requires = "password_file")]
    user: Option<String>,
    /// A file with the password in its first line.
    #[arg(long, value_name = "FILE", requires = "user")]
    password_file: Option<PathBuf>,
    /// The certificates by which the broker is trusted, in PEM. Without this: those of the system.
    #[arg(long, value_name = "PEM", requires = "mqtt")]
    ca: Option<PathBuf>,
    /// The certificate by which the broker knows this publisher, in PEM.
    #[arg(long, value_name = "PEM", requires = "mqtt", requires = "key")]
    cert: Option<PathBuf>,
    /// The key of that certificate, in PEM.
    #[arg(long, value_name = "PEM", requires = "cert")]
    key: Option<PathBuf>,
    /// Publishes only while this host application is online.
    #[arg(long, value_name = "HOST", requires = "mqtt", value_parser = parse_topic_level)]
    primary_host: Option<String>,
    /// Where agents of MTConnect connect. Only this computer's reach it unless you name another address.
    #[arg(long, value_name = "ADDR:PORT")]
    mtconnect: Option<String>,
    /// Where the description for the agent is written. Without this: Devices.xml in the spool's folder.
    #[arg(long, value_name = "FILE", requires = "mtconnect")]
    devices: Option<PathBuf>,
    /// Try once whether all ends are there, say what was done, and end.
    #[arg(long)]
    once: bool,
}

/// Parses a name that is a level of a topic. NATS refuses a topic with a space, and closes the connection.
fn parse_topic_level(text: &str) -> Result<String, String> {
    let is_sound = |c: char| c.is_alphanumeric() || "-_.".contains(c);
    if text.is_empty() || text.len() > 64 || !text.chars().all(is_sound) {
        return Err("has 1 to 64 letters, digits, -, _ or ., and no space".into());
    }
    Ok(text.into())
}

/// Parses the time from one row to the next.
fn parse_row_period_s(text: &str) -> Result<f64, String> {
    let seconds = text.parse().ok().filter(|value| (0.1..=3_600.0).contains(value));
    seconds.ok_or_else(|| "has 0.1 to 3600 s".into())
}

/// Publishes a bridge.
pub fn run(args: &ServeArgs) -> Result<CommandOutcome> {
    let stop = Arc::new(AtomicBool::new(false));
    let flag = stop.clone();
    ctrlc::set_handler(move || flag.store(true, Ordering::Relaxed)).context("signal handler")?;
    let options = publisher_options_from_args(args)?;
    trueup_output::enable_background_output();
    let done = publisher::run(options, stop, |text| trueup_output::write_diagnostic(text))?;
    output::print(&done.counts)?;
    Ok(if done.is_whole || !args.once { CommandOutcome::Done } else { CommandOutcome::NotMet })
}

fn publisher_options_from_args(args: &ServeArgs) -> Result<PublisherOptions> {
    let ports: Result<Vec<PortAddress>, _> =
        args.ports.iter().map(|port| PortAddress::parse(port)).collect();
    let broker = args.mqtt.as_deref().map(|url| broker_from_args(args, url)).transpose()?;
    let addresses = |listen| resolve_listen_addresses("--mtconnect", listen);
    let mtconnect = args.mtconnect.as_deref().map(addresses).transpose()?.unwrap_or_default();
    Ok(PublisherOptions {
        ports: ports?,
        name: args.name.clone(),
        spool: args.spool.clone(),
        spool_bytes: u64::from(args.spool_mb) << 20,
        row: Duration::from_secs_f64(args.record_s),
        broker,
        primary_host: args.primary_host.clone(),
        mtconnect,
        devices: args.devices.clone(),
        once: args.once,
        version: env!("CARGO_PKG_VERSION"),
    })
}

fn broker_from_args(args: &ServeArgs, url: &str) -> Result<BrokerConfig> {
    let login = match (&args.user, &args.password_file) {
        (Some(user), Some(path)) => Some((user.clone(), read_password(path)?)),
        _ => None,
    };
    let own = args.cert.as_deref().zip(args.key.as_deref());
    let files = TlsFiles { ca: args.ca.as_deref(), own };
    Ok(BrokerConfig::from_url(url, login, files)
        .map_err(|error| UserError(format!("{error:#}")))?)
}

fn read_password(path: &Path) -> Result<String, UserError> {
    let place = path.display();
    let text = fs::read_to_string(path).map_err(|error| UserError(format!("{place}: {error}")))?;
    let first = text.lines().next().filter(|line| !line.is_empty());
    first.map(str::to_owned).ok_or_else(|| UserError(format!("{place}: its first line is empty")))
}
