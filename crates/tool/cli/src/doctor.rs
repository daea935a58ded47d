//! `trueup doctor`: what this computer has of what the commands need, and which ports may have a bridge.

use std::{
    env,
    path::PathBuf,
    process::{Command, Stdio},
    time::{Duration, Instant},
};

use anyhow::Result;
use clap::Args;
use serde_json::{Value, json};
use trueup_client::{
    port::PortAddress,
    port_discovery::{self, PortInfo},
    session::Session,
};
use trueup_link::slcan::AdapterMessage;

use crate::{CommandOutcome, VERSION_WITH_COMMIT, output};

/// Looks what this computer has: ports and the permission to open them, QEMU, LinuxCNC, tools that flash a board.
///
/// Nothing is sent to a port unless --port names it.
/// Exit 3: a port cannot be opened, or no bridge answers at --port.
#[derive(Args)]
#[command(after_help = "Examples:
  trueup doctor
  trueup doctor --port /dev/ttyUSB0")]
pub struct DoctorArgs {
    /// Asks whether a bridge answers there.
    #[arg(long, value_name = "PORT")]
    port: Option<String>,
}

/// Programs that some commands need: name, words that make it print its version, and what for.
const EXTERNAL_PROGRAMS: [(&str, &[&str], &str); 5] = [
    ("qemu-system-arm", &["--version"], "trueup virtual; apt install qemu-system-arm"),
    ("linuxcnc", &[], "trueup linuxcnc; apt install linuxcnc-uspace"),
    ("probe-rs", &["--version"], "flashing a board by a probe"),
    ("dfu-util", &["--version"], "flashing a board by USB; apt install dfu-util"),
    ("stm32flash", &["-h"], "flashing a board by its serial line; apt install stm32flash"),
];
/// How long a bridge may take to say a frame.
const FRAME_TIMEOUT: Duration = Duration::from_secs(2);

/// Prints what is here.
pub fn run(args: &DoctorArgs, as_json: bool) -> Result<CommandOutcome> {
    let ports = port_discovery::list_ports();
    let answer = args.port.as_ref().map(|port| probe_port(port));
    let programs = EXTERNAL_PROGRAMS
        .map(|(name, words, what)| (name, query_program_version(name, words), what));
    if as_json {
        let programs: Vec<Value> = programs
            .iter()
            .map(|(name, version, what)| json!({"name": name, "version": version, "for": what}))
            .collect();
        output::print(json!({
            "version": VERSION_WITH_COMMIT, "programs": programs, "ports": ports_json(&ports),
            "bridge": answer.as_ref().map(|answer| match answer { Ok(text) | Err(text) => text }),
        }))?;
    } else {
        output::print(format_args!("trueup           {VERSION_WITH_COMMIT}"))?;
        for (name, version, what) in &programs {
            let version = version.clone().unwrap_or_else(|| format!("not here (for {what})"));
            output::print(format_args!("{name:<16} {version}"))?;
        }
        print_ports(&ports)?;
        match &answer {
            Some(Ok(text)) => output::print(format_args!("bridge           {text}"))?,
            Some(Err(text)) => output::print(format_args!("bridge           none: {text}"))?,
            None => {}
        }
    }
    let is_met =
        ports.iter().all(|port| port.obstacle.is_none()) && !matches!(answer, Some(Err(_)));
    Ok(if is_met { CommandOutcome::Done } else { CommandOutcome::NotMet })
}

/// Prints the ports that may have a bridge, one a line.
pub fn print_ports(ports: &[PortInfo]) -> Result<()> {
    if ports.is_empty() {
        return output::print(
            "ports            none: no serial device and no CAN interface; a virtual bridge is tcp:127.0.0.1:3333",
        );
    }
    for PortInfo { name, what, obstacle } in ports {
        let state = obstacle.as_deref().unwrap_or("can be opened");
        let what = if what.is_empty() { String::new() } else { format!("{what}, ") };
        output::print(format_args!("{name:<16} {what}{state}"))?;
    }
    Ok(())
}

/// Returns the same as JSON.
pub fn ports_json(ports: &[PortInfo]) -> Value {
    let port =
        |port: &PortInfo| json!({"port": port.name, "what": port.what, "obstacle": port.obstacle});
    ports.iter().map(port).collect()
}

/// Returns the first line that a program says of its version; `None`: it is not here.
fn query_program_version(name: &str, words: &[&str]) -> Option<String> {
    let path = find_on_path(name)?;
    if words.is_empty() {
        return Some(path.display().to_string());
    }
    let output = Command::new(&path).args(words).stdin(Stdio::null()).output().ok()?;
    let text = [output.stdout, output.stderr].concat();
    let text = String::from_utf8_lossy(&text);
    let line = text.lines().find(|line| !line.trim().is_empty()).unwrap_or_default();
    Some(trueup_output::escape::escape_line(line))
}

fn find_on_path(name: &str) -> Option<PathBuf> {
    let folders = env::var_os("PATH")?;
    let ending = env::consts::EXE_SUFFIX;
    env::split_paths(&folders)
        .map(|folder| folder.join(format!("{name}{ending}")))
        .find(|path| path.is_file())
}

/// Returns what answers at a port, or why nothing does.
fn probe_port(port: &str) -> Result<String, String> {
    let words = |error: anyhow::Error| format!("{error:#}");
    let port = PortAddress::parse(port).map_err(|error| error.to_string())?;
    let mut session = Session::open(&port).map_err(words)?;
    let deadline = Instant::now() + FRAME_TIMEOUT;
    let found = loop {
        match session.next_event(deadline).map_err(words)? {
            Some(AdapterMessage::Frame(frame)) => {
                break Ok(format!("answers: a frame 0x{:03X}", frame.id()));
            }
            Some(_) => {}
            None => {
                break Err("the channel opens, and no frame comes: is the bus at 1 Mbit/s?".into());
            }
        }
    };
    session.close();
    found
}
