//! Faults around a publisher: hostile payloads, a second publisher, passwords and certificates.

use std::{fs, process::Command, time::Instant};

use anyhow::{Result, ensure};
use serde_json::json;

use crate::{
    bridge::{self, Switches},
    parts::{Host, Mosquitto, Start},
};

fn start(folder: &std::path::Path, broker: &Mosquitto) -> Start {
    Start {
        bridge: bridge::start(Switches::default()),
        name: "n".into(),
        spool: folder.join("spool"),
        url: broker.url(),
        more: json!({ "row_ms": 100 }),
    }
}

#[test]
fn a_hostile_payload_is_ignored_and_reported() -> Result<()> {
    let folder = tempfile::tempdir()?;
    let broker = Mosquitto::start(folder.path(), "")?;
    let mut host = Host::start(broker.port)?;
    let start = start(folder.path(), &broker);
    let mut publisher = start.spawn()?;
    host.wait("a birth", |message| message["what"] == "DBIRTH")?;
    // No payload; groups that nest without end; a metric without a name; nothing.
    for hex in ["ff".into(), "0b".repeat(4_000), "12021a00".into(), String::new()] {
        host.send_line(&format!("raw spBv1.0/trueup/NCMD/n {hex}"))?;
    }
    start.wait_for_log("is no payload of Sparkplug")?;
    let requested_at = Instant::now();
    host.send_line("rebirth n")?;
    host.wait_since(requested_at, "it lives", |message| {
        message["what"] == "NBIRTH" && message["seq"] == 0
    })?;
    // One that is longer than any command costs the connection, and the next one goes on.
    let requested_at = Instant::now();
    host.send_line(&format!("raw spBv1.0/trueup/NCMD/n {}", "0a".repeat(100_000)))?;
    start.wait_for_log("payload size limit exceeded")?;
    host.wait_since(requested_at, "it is there again", |message| message["what"] == "DBIRTH")?;
    ensure!(publisher.0.try_wait()?.is_none(), "{}", start.log());
    Ok(())
}

#[test]
fn a_second_publisher_of_one_name_is_reported_and_one_of_one_spool_is_refused() -> Result<()> {
    let folder = tempfile::tempdir()?;
    let broker = Mosquitto::start(folder.path(), "")?;
    let first = start(folder.path(), &broker);
    let _publisher = first.spawn()?;
    let host = Host::start(broker.port)?;
    host.wait("a record", |message| message["what"] == "record")?;
    let mut same = first.spawn()?;
    ensure!(!same.0.wait()?.success());
    let second = Start { spool: folder.path().join("second"), ..start(folder.path(), &broker) };
    let _second = second.spawn()?;
    let phrase = "another publisher publishes as spBv1.0/trueup/NBIRTH/n";
    first.wait_for_log(phrase)?;
    Ok(())
}

/// Writes a certificate authority and two certificates signed by it into a folder.
fn certificates(folder: &std::path::Path) -> Result<()> {
    let script = "set -e\nopenssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -days 2 \
        -subj /CN=ca -keyout ca.key -out ca.pem\nfor who in broker publisher; do\nopenssl req -newkey ec \
        -pkeyopt ec_paramgen_curve:P-256 -nodes -subj /CN=$who -keyout $who.key -out $who.csr\n\
        printf 'subjectAltName=IP:127.0.0.1\\n' > ext\nopenssl x509 -req -in $who.csr -CA ca.pem -CAkey ca.key \
        -CAcreateserial -days 2 -extfile ext -out $who.pem\ndone\n";
    let output = Command::new("sh").args(["-c", script]).current_dir(folder).output()?;
    ensure!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    Ok(())
}

#[test]
fn tls_with_certificates_is_spoken_and_a_publisher_without_one_is_refused() -> Result<()> {
    let folder = tempfile::tempdir()?;
    certificates(folder.path())?;
    let path = |name: &str| folder.path().join(name).display().to_string();
    let secure = crate::parts::free_port();
    let more = format!(
        "allow_anonymous true\nlistener {secure} 127.0.0.1\ncafile {}\ncertfile {}\nkeyfile {}\nrequire_certificate true",
        path("ca.pem"),
        path("broker.pem"),
        path("broker.key")
    );
    let broker = Mosquitto::start(folder.path(), &more)?;
    let host = Host::start(broker.port)?;
    let url = format!("mqtts://127.0.0.1:{secure}");
    let without = Start {
        url: url.clone(),
        spool: folder.path().join("without"),
        more: json!({ "ca": path("ca.pem") }),
        ..start(folder.path(), &broker)
    };
    let refused = without.spawn()?;
    without.wait_for_log("the broker is not connected")?;
    drop(refused);
    let with = Start {
        url,
        more: json!({ "ca": path("ca.pem"), "cert": path("publisher.pem"), "key": path("publisher.key") }),
        ..start(folder.path(), &broker)
    };
    let _publisher = with.spawn()?;
    host.wait("a birth over TLS", |message| message["what"] == "DBIRTH")?;
    Ok(())
}

#[test]
fn a_broker_that_asks_for_a_password_is_given_it_and_a_wrong_one_is_reported() -> Result<()> {
    let folder = tempfile::tempdir()?;
    let file = folder.path().join("passwords");
    fs::write(&file, "u:right\n")?;
    let mut hash = Command::new("mosquitto_passwd");
    ensure!(hash.arg("-U").arg(&file).status()?.success());
    let open = crate::parts::free_port();
    let more = format!(
        "per_listener_settings false\nallow_anonymous false\npassword_file {}\nlistener {open} 127.0.0.1",
        file.display()
    );
    let broker = Mosquitto::start(folder.path(), &more)?;
    let of = |password: &str, spool: &str| Start {
        spool: folder.path().join(spool),
        more: json!({ "user": "u", "password": password }),
        ..start(folder.path(), &broker)
    };
    let wrong = of("wrong", "wrong");
    let _wrong = wrong.spawn()?;
    wrong.wait_for_log("the broker is not connected")?;
    let right = of("right", "right");
    let _right = right.spawn()?;
    // The number of its connection says that it was connected.
    let publisher = right.spool.join("publisher");
    let end = Instant::now() + crate::parts::TIMEOUT;
    while !fs::read_to_string(&publisher).unwrap_or_default().ends_with(" 0\n") {
        ensure!(Instant::now() < end, "{}", right.log());
    }
    std::thread::sleep(std::time::Duration::from_secs(2));
    ensure!(!right.log().contains("not connected"), "{}", right.log());
    Ok(())
}
