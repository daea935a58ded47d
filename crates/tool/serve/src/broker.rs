//! Where the broker is, and how it is spoken to: `mqtt://HOST:PORT`, or `mqtts://HOST:PORT` with TLS.
//!
//! A password never crosses a network in the clear: without TLS it is sent to this computer only.

use std::{net::IpAddr, path::Path, sync::Arc};

use anyhow::{Context as _, Result, bail, ensure};
use rumqttc::{
    TlsConfiguration, Transport,
    tokio_rustls::rustls::{
        ClientConfig, RootCertStore,
        crypto::ring,
        pki_types::{CertificateDer, PrivateKeyDer, pem::PemObject as _},
    },
};

/// The ports of MQTT without and with TLS.
const DEFAULT_MQTT_PORTS: [u16; 2] = [1883, 8883];

/// A broker.
#[derive(Clone)]
pub struct BrokerConfig {
    /// Its name or address.
    pub host: String,
    /// Its port.
    pub port: u16,
    /// TLS, if it is used.
    pub tls: Option<Arc<ClientConfig>>,
    /// User and password.
    pub login: Option<(String, String)>,
}

/// The files of TLS.
#[derive(Clone, Copy, Debug, Default)]
pub struct TlsFiles<'a> {
    /// Certificates that the broker's must be signed by; `None`: those that the system trusts.
    pub ca: Option<&'a Path>,
    /// The certificate and the key by which the broker knows this publisher.
    pub own: Option<(&'a Path, &'a Path)>,
}

impl BrokerConfig {
    /// Reads the URL of a broker, and the files.
    ///
    /// # Errors
    /// The URL has another form, a file is not what it should be, or a password would be readable on a network.
    pub fn from_url(
        url: &str,
        login: Option<(String, String)>,
        files: TlsFiles<'_>,
    ) -> Result<Self> {
        const URL_SYNTAX: &str = "a broker is mqtt://HOST:PORT, or mqtts://HOST:PORT with TLS";
        let (is_tls, rest) = match url.split_once("://") {
            Some(("mqtt", rest)) => (false, rest),
            Some(("mqtts", rest)) => (true, rest),
            _ => bail!("--mqtt \"{url}\": {URL_SYNTAX}"),
        };
        let rest = rest.trim_end_matches('/');
        ensure!(
            !rest.contains('@'),
            "--mqtt: a password on the command line is seen by every user of this computer; \
             give --user NAME and --password-file FILE"
        );
        let (host, port) = match rest.rsplit_once(':') {
            Some((host, port)) if !port.contains(']') => {
                let port = port.parse().ok().filter(|port| *port != 0);
                (host, port.with_context(|| format!("--mqtt \"{url}\": {URL_SYNTAX}"))?)
            }
            _ => (rest, DEFAULT_MQTT_PORTS[usize::from(is_tls)]),
        };
        let is_name = |c: char| c.is_ascii_alphanumeric() || "-._[]:%".contains(c);
        ensure!(!host.is_empty() && host.chars().all(is_name), "--mqtt \"{url}\": {URL_SYNTAX}");
        // The client of MQTT takes a name or an IPv4 address for that of the certificate.
        ensure!(
            !is_tls || !host.starts_with('['),
            "--mqtt \"{url}\": TLS needs a name in the place of an IPv6 address: mqtts://HOST:PORT"
        );
        if !is_tls {
            ensure!(
                files.ca.is_none() && files.own.is_none(),
                "--ca, --cert and --key are those of TLS: write mqtts://{rest}"
            );
            ensure!(
                login.is_none() || is_loopback(host),
                "--user with mqtt://: the password could be read on the way; write mqtts://{rest}"
            );
        }
        let tls = if is_tls { Some(Arc::new(build_tls_config(files)?)) } else { None };
        Ok(Self { host: host.into(), port, tls, login })
    }

    /// Returns how the connection is made.
    #[must_use]
    pub(crate) fn transport(&self) -> Transport {
        let tls = self.tls.clone();
        tls.map_or(Transport::Tcp, |tls| Transport::Tls(TlsConfiguration::Rustls(tls)))
    }

    /// Returns whether what is published can be read on a network.
    #[must_use]
    pub(crate) fn is_unencrypted(&self) -> bool {
        self.tls.is_none() && !is_loopback(&self.host)
    }
}

/// Returns whether a host is this computer.
#[must_use]
pub fn is_loopback(host: &str) -> bool {
    let bare = host.trim_start_matches('[').trim_end_matches(']');
    host == "localhost" || bare.parse().is_ok_and(|address: IpAddr| address.is_loopback())
}

fn load_certificates(path: &Path) -> Result<Vec<CertificateDer<'static>>> {
    let place = || format!("{}: is no certificate in PEM", path.display());
    let all: Result<Vec<_>, _> = CertificateDer::pem_file_iter(path).with_context(place)?.collect();
    let all = all.with_context(place)?;
    ensure!(!all.is_empty(), place());
    Ok(all)
}

fn build_tls_config(files: TlsFiles<'_>) -> Result<ClientConfig> {
    let mut roots = RootCertStore::empty();
    let trusted = match files.ca {
        Some(path) => load_certificates(path)?,
        None => rustls_native_certs::load_native_certs().certs,
    };
    roots.add_parsable_certificates(trusted);
    ensure!(
        !roots.is_empty(),
        "no certificate is trusted here: give the one that signed the broker's with --ca FILE"
    );
    let builder = ClientConfig::builder_with_provider(Arc::new(ring::default_provider()))
        .with_safe_default_protocol_versions()
        .context("TLS")?
        .with_root_certificates(roots);
    Ok(match files.own {
        None => builder.with_no_client_auth(),
        Some((cert, key)) => {
            let place = || format!("{}: is no private key in PEM", key.display());
            let private = PrivateKeyDer::from_pem_file(key).with_context(place)?;
            let fit = || format!("{} and {}", cert.display(), key.display());
            builder.with_client_auth_cert(load_certificates(cert)?, private).with_context(fit)?
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn broker(url: &str, has_login: bool) -> Result<BrokerConfig, String> {
        let login = has_login.then(|| ("u".to_owned(), "p".to_owned()));
        BrokerConfig::from_url(url, login, TlsFiles::default())
            .map_err(|error| format!("{error:#}"))
    }

    #[test]
    fn a_url_gives_host_and_port() {
        for (url, host, port) in [
            ("mqtt://127.0.0.1:1884", "127.0.0.1", 1884),
            ("mqtt://localhost", "localhost", 1883),
            ("mqtt://[::1]:1884/", "[::1]", 1884),
            ("mqtt://broker.shop.example", "broker.shop.example", 1883),
        ] {
            let broker = broker(url, false).expect(url);
            assert_eq!((broker.host.as_str(), broker.port), (host, port));
        }
    }

    #[test]
    fn what_is_no_broker_is_refused_with_the_form() {
        for (url, has_login, phrase) in [
            ("localhost:1883", false, "a broker is mqtt://HOST:PORT"),
            ("http://localhost", false, "a broker is"),
            ("mqtt://", false, "a broker is"),
            ("mqtt://h:0", false, "a broker is"),
            ("mqtt://a b:1", false, "a broker is"),
            ("mqtt://me:secret@h:1883", false, "--password-file"),
            ("mqtt://10.0.0.1", true, "write mqtts://10.0.0.1"),
            ("mqtts://[::1]:8883", false, "a name in the place of an IPv6 address"),
        ] {
            let error = broker(url, has_login).err().expect(url);
            assert!(error.contains(phrase), "{error}");
            assert!(!error.contains("secret"), "{error}");
        }
        assert!(broker("mqtt://127.0.0.1", true).is_ok());
        let cert = TlsFiles { ca: Some(Path::new("/nonexistent.pem")), own: None };
        for (url, phrase) in
            [("mqtt://localhost", "write mqtts://"), ("mqtts://localhost", "/nonexistent.pem")]
        {
            let error = BrokerConfig::from_url(url, None, cert).err().expect(url);
            assert!(format!("{error:#}").contains(phrase), "{error:#}");
        }
    }
}
