//! Where the jobs of a fleet are: a folder, or a NATS server.

use std::{
    env, fmt, io,
    path::{Path, PathBuf},
};

use anyhow::Result;
use clap::Args;
use trueup_fleet::{
    nats::{ConnectionSettings, RemoteFleet},
    store::FleetStore,
    worker::{self, FleetStatus},
};
use trueup_output::escape::shell_quote;
use trueup_serve::broker::is_loopback;

use crate::{UserError, report};

/// The variables with the name and the password for a server: every user of the computer sees a command line.
pub const NATS_USER_ENV_VAR: &str = "TRUEUP_NATS_USER";
pub const NATS_PASSWORD_ENV_VAR: &str = "TRUEUP_NATS_PASSWORD";

#[derive(Args)]
pub struct FleetLocationArgs {
    /// The folder of the fleet; `submit` makes it.
    #[arg(long, value_name = "DIR", required_unless_present = "nats")]
    dir: Option<PathBuf>,
    /// The NATS server of the fleet, nats://HOST:PORT or tls://HOST:PORT, in the place of a folder. Name and password:
    /// TRUEUP_NATS_USER and TRUEUP_NATS_PASSWORD.
    #[arg(long, value_name = "URL", conflicts_with = "dir")]
    nats: Option<String>,
    /// The certificate of the authority that the server's certificate is of, in PEM.
    #[arg(long, value_name = "CA.pem", requires = "nats")]
    nats_ca: Option<PathBuf>,
}

/// A place that is open.
pub enum FleetBackend {
    Folder(FleetStore),
    Server(Box<RemoteFleet>),
}

impl FleetLocationArgs {
    /// Opens a place for a first job, and makes what is missing there.
    pub fn create_backend(&self) -> Result<FleetBackend> {
        let Some(dir) = &self.dir else {
            let remote =
                RemoteFleet::create(&self.connection_settings()?).map_err(to_user_error)?;
            return Ok(FleetBackend::Server(Box::new(remote)));
        };
        let named = |error| UserError(format!("{}: cannot be made: {error}", dir.display()));
        Ok(FleetBackend::Folder(FleetStore::create(dir).map_err(named)?))
    }

    /// Opens a place that has jobs.
    pub fn open_backend(&self) -> Result<FleetBackend> {
        let Some(dir) = &self.dir else {
            let remote = RemoteFleet::open(&self.connection_settings()?).map_err(to_user_error)?;
            return Ok(FleetBackend::Server(Box::new(remote)));
        };
        let rule = "is no folder of a fleet: trueup fleet submit makes it";
        let store =
            FleetStore::open(dir).ok_or_else(|| UserError(format!("{}: {rule}", dir.display())))?;
        Ok(FleetBackend::Folder(store))
    }

    fn connection_settings(&self) -> Result<ConnectionSettings, UserError> {
        resolve_server_connection(self.nats.as_deref().unwrap_or_default(), self.nats_ca.as_deref())
    }

    /// Returns the options that name the place, for a line to be typed.
    pub fn command_options(&self) -> String {
        let mut words = match (&self.dir, &self.nats) {
            (Some(dir), _) => format!("--dir {}", shell_quote(&dir.to_string_lossy())),
            (None, url) => format!("--nats {}", shell_quote(url.as_deref().unwrap_or_default())),
        };
        if let Some(file) = &self.nats_ca {
            words += &format!(" --nats-ca {}", shell_quote(&file.to_string_lossy()));
        }
        words
    }
}

impl fmt::Display for FleetLocationArgs {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.dir {
            Some(dir) => dir.display().fmt(f),
            None => f.write_str(self.nats.as_deref().unwrap_or_default()),
        }
    }
}

impl FleetBackend {
    pub fn status(&self) -> io::Result<FleetStatus> {
        match self {
            Self::Folder(store) => worker::read_status(store),
            Self::Server(remote) => remote.status(),
        }
    }
}

/// Returns how a server is reached.
pub fn resolve_server_connection(
    url: &str,
    authority: Option<&Path>,
) -> Result<ConnectionSettings, UserError> {
    if url.contains('@') {
        let rule = "name and password stand in TRUEUP_NATS_USER and TRUEUP_NATS_PASSWORD, not in the address";
        return Err(UserError(format!("--nats: {rule}")));
    }
    if let Some(file) = authority.filter(|file| !file.is_file()) {
        return Err(UserError(format!("{}: is no file", file.display())));
    }
    let login = credentials_from_env()?;
    if login.is_some() && is_readable_on_network(url) {
        report::print_warning(
            "--nats: the password can be read on the network: write tls://HOST:PORT",
        );
    }
    Ok(ConnectionSettings { url: url.into(), login, authority: authority.map(PathBuf::from) })
}

/// Returns whether what is sent to this address can be read on a network.
fn is_readable_on_network(url: &str) -> bool {
    let address = url.split_once("://").map_or(url, |(_, rest)| rest).trim_end_matches('/');
    let host = match address.rsplit_once(':') {
        Some((host, port)) if !port.contains(']') => host,
        _ => address,
    };
    !url.starts_with("tls://") && !is_loopback(host)
}

/// Returns name and password of the environment.
pub fn credentials_from_env() -> Result<Option<(String, String)>, UserError> {
    match (env::var(NATS_USER_ENV_VAR).ok(), env::var(NATS_PASSWORD_ENV_VAR).ok()) {
        (None, None) => Ok(None),
        (Some(user), Some(password)) => Ok(Some((user, password))),
        _ => Err(UserError(format!(
            "{NATS_USER_ENV_VAR} and {NATS_PASSWORD_ENV_VAR}: one of them is set, both are needed"
        ))),
    }
}

/// Returns an error that the user can mend: an address, a login, a server that is not there.
fn to_user_error(error: io::Error) -> UserError {
    UserError(error.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_password_is_readable_on_the_way_to_another_computer_without_tls() {
        for url in
            ["nats://192.168.1.10:4222", "nats://shop", "192.168.1.10", "nats://[fe80::1]:4222"]
        {
            assert!(is_readable_on_network(url), "{url}");
        }
        for url in
            ["nats://127.0.0.1:4222", "nats://localhost/", "nats://[::1]:4222", "tls://shop:4222"]
        {
            assert!(!is_readable_on_network(url), "{url}");
        }
    }
}
