//! Where the jobs of a fleet are: a folder, or a NATS server.

use std::{
    env, fmt, io,
    path::{Path, PathBuf},
};

use anyhow::Result;
use clap::Args;
use trueup_fleet::{
    nats::{Access, Remote},
    store::Store,
    worker::{self, Status},
};
use trueup_output::escape::shell_word;
use trueup_serve::broker::is_loopback;

use crate::{UserError, report};

/// The variables with the name and the password for a server: every user of the computer sees a command line.
pub const USER: &str = "TRUEUP_NATS_USER";
pub const PASSWORD: &str = "TRUEUP_NATS_PASSWORD";

#[derive(Args)]
pub struct Place {
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
pub enum Opened {
    Folder(Store),
    Server(Box<Remote>),
}

impl Place {
    /// Opens a place for a first job, and makes what is missing there.
    pub fn create(&self) -> Result<Opened> {
        let Some(dir) = &self.dir else {
            let remote = Remote::create(&self.access()?).map_err(said)?;
            return Ok(Opened::Server(Box::new(remote)));
        };
        let named = |error| UserError(format!("{}: cannot be made: {error}", dir.display()));
        Ok(Opened::Folder(Store::create(dir).map_err(named)?))
    }

    /// Opens a place that has jobs.
    pub fn open(&self) -> Result<Opened> {
        let Some(dir) = &self.dir else {
            let remote = Remote::open(&self.access()?).map_err(said)?;
            return Ok(Opened::Server(Box::new(remote)));
        };
        let rule = "is no folder of a fleet: trueup fleet submit makes it";
        let store =
            Store::open(dir).ok_or_else(|| UserError(format!("{}: {rule}", dir.display())))?;
        Ok(Opened::Folder(store))
    }

    fn access(&self) -> Result<Access, UserError> {
        access(self.nats.as_deref().unwrap_or_default(), self.nats_ca.as_deref())
    }

    /// Returns the options that name the place, for a line to be typed.
    pub fn words(&self) -> String {
        let mut words = match (&self.dir, &self.nats) {
            (Some(dir), _) => format!("--dir {}", shell_word(&dir.to_string_lossy())),
            (None, url) => format!("--nats {}", shell_word(url.as_deref().unwrap_or_default())),
        };
        if let Some(file) = &self.nats_ca {
            words += &format!(" --nats-ca {}", shell_word(&file.to_string_lossy()));
        }
        words
    }
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.dir {
            Some(dir) => dir.display().fmt(f),
            None => f.write_str(self.nats.as_deref().unwrap_or_default()),
        }
    }
}

impl Opened {
    pub fn status(&self) -> io::Result<Status> {
        match self {
            Self::Folder(store) => worker::status(store),
            Self::Server(remote) => remote.status(),
        }
    }
}

/// Returns how a server is reached.
pub fn access(url: &str, authority: Option<&Path>) -> Result<Access, UserError> {
    if url.contains('@') {
        let rule = "name and password stand in TRUEUP_NATS_USER and TRUEUP_NATS_PASSWORD, not in the address";
        return Err(UserError(format!("--nats: {rule}")));
    }
    if let Some(file) = authority.filter(|file| !file.is_file()) {
        return Err(UserError(format!("{}: is no file", file.display())));
    }
    let login = login()?;
    if login.is_some() && is_readable(url) {
        report::warn("--nats: the password can be read on the network: write tls://HOST:PORT");
    }
    Ok(Access { url: url.into(), login, authority: authority.map(PathBuf::from) })
}

/// Returns whether what is sent to this address can be read on a network.
fn is_readable(url: &str) -> bool {
    let address = url.split_once("://").map_or(url, |(_, rest)| rest).trim_end_matches('/');
    let host = match address.rsplit_once(':') {
        Some((host, port)) if !port.contains(']') => host,
        _ => address,
    };
    !url.starts_with("tls://") && !is_loopback(host)
}

/// Returns name and password of the environment.
pub fn login() -> Result<Option<(String, String)>, UserError> {
    match (env::var(USER).ok(), env::var(PASSWORD).ok()) {
        (None, None) => Ok(None),
        (Some(user), Some(password)) => Ok(Some((user, password))),
        _ => Err(UserError(format!("{USER} and {PASSWORD}: one of them is set, both are needed"))),
    }
}

/// Returns an error that the user can mend: an address, a login, a server that is not there.
fn said(error: io::Error) -> UserError {
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
            assert!(is_readable(url), "{url}");
        }
        for url in
            ["nats://127.0.0.1:4222", "nats://localhost/", "nats://[::1]:4222", "tls://shop:4222"]
        {
            assert!(!is_readable(url), "{url}");
        }
    }
}
