//! NATS as the broker, as `trueup fleet server --mqtt` starts it: what its listener for MQTT acknowledges is in the stream,
//! whatever is killed, and `trueup fleet records` prints it.

use std::{
    collections::{BTreeSet, HashMap},
    env, fs,
    path::{Path, PathBuf},
    process::{Command, Stdio},
    thread,
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result, ensure};
use rumqttc::{Client, Event, MqttOptions, Outgoing, Packet, QoS};
use serde_json::Value;
use trueup_emulator::{host_programs, setup};
use trueup_serve::sparkplug::encode_payload;

use crate::{
    kills::{Draw, schedules},
    parts::{Broker, Process, free_port, wait_for_port},
    scale::a_thousand,
};

/// A NATS server with a folder of its own.
struct Nats {
    process: Option<Process>,
    trueup: PathBuf,
    folder: PathBuf,
    /// For clients of NATS, and for those of MQTT.
    ports: [u16; 2],
}

impl Nats {
    fn start(folder: &Path) -> Result<Self> {
        let folder = folder.join("server");
        fs::create_dir_all(&folder)?;
        let ports = [free_port(), free_port()];
        let mut server =
            Self { process: None, trueup: host_programs::build_trueup()?, folder, ports };
        server.restart()?;
        Ok(server)
    }

    fn restart(&mut self) -> Result<()> {
        let path = self.folder.join("log");
        let log = fs::OpenOptions::new().create(true).append(true).open(&path)?;
        let [listen, mqtt] = self.ports.map(|port| format!("127.0.0.1:{port}"));
        let program = setup::ensure_python()?.with_file_name("nats-server");
        let mut command = Command::new(&self.trueup);
        command.args([
            "fleet",
            "server",
            "--records-gb",
            "1",
            "--listen",
            &listen,
            "--mqtt",
            &mqtt,
        ]);
        command.arg("--dir").arg(&self.folder).arg("--program").arg(program);
        self.process = Some(Process(command.stdout(Stdio::null()).stderr(log).spawn()?));
        wait_for_port(self.ports[1], &path)
    }

    /// Returns the identifiers of what `trueup fleet records` prints.
    fn identifiers(&self) -> Result<BTreeSet<String>> {
        let mut command = Command::new(&self.trueup);
        let url = format!("nats://127.0.0.1:{}", self.ports[0]);
        let output = command.args(["fleet", "records", "--nats", &url]).output()?;
        ensure!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let mut found = BTreeSet::new();
        for line in String::from_utf8(output.stdout)?.lines() {
            let record: Value = serde_json::from_str(line)?;
            let id = record["id"].as_str().context("an identifier")?.to_owned();
            ensure!(found.insert(id), "printed twice: {line}");
        }
        Ok(found)
    }
}

impl Broker for Nats {
    fn kill(&mut self, pause: Duration) -> Result<()> {
        self.process = None;
        thread::sleep(pause);
        self.restart()
    }

    fn port(&self) -> u16 {
        self.ports[1]
    }

    fn process(&self) -> String {
        self.process.as_ref().map_or_else(String::new, |process| process.0.id().to_string())
    }
}

/// Publishes at least once, as fast as the broker takes it, until the connection breaks; returns the identifiers of
/// what was acknowledged.
fn acknowledged(port: u16, run: u64) -> BTreeSet<String> {
    let id = move |number: u64| format!("{run:016x}-{number}");
    let mut options = MqttOptions::new("acknowledged", "127.0.0.1", port);
    options.set_clean_session(true).set_inflight(64);
    let (client, mut connection) = Client::new(options, 64);
    thread::spawn(move || {
        for number in 0.. {
            let payload = encode_payload(Vec::new(), number, None, Some(&id(number)));
            let topic = "trueup/n/0000002a/record";
            if client.publish(topic, QoS::AtLeastOnce, false, payload).is_err() {
                return;
            }
        }
    });
    let (mut next, mut open, mut acknowledged) = (0, HashMap::new(), BTreeSet::new());
    for event in connection.iter() {
        match event {
            Ok(Event::Outgoing(Outgoing::Publish(packet))) => {
                open.insert(packet, next);
                next += 1;
            }
            Ok(Event::Incoming(Packet::PubAck(ack))) => {
                acknowledged.extend(open.remove(&ack.pkid).map(id));
            }
            Ok(_) => {}
            Err(_) => break,
        }
    }
    acknowledged
}

/// `TRUEUP_SCHEDULES` is another number of kills than 50.
fn count() -> Result<u32> {
    Ok(env::var("TRUEUP_SCHEDULES").map_or(Ok(50), |text| text.parse())?)
}

/// Nothing is sent a second time here, so that an acknowledgement alone stands for a message.
#[test]
#[ignore = "campaign: cargo test -p trueup-serve --test live campaign_nats -- --ignored --nocapture"]
fn campaign_nats_has_what_it_acknowledged_before_it_was_killed() -> Result<()> {
    let folder = tempfile::tempdir()?;
    let mut server = Nats::start(folder.path())?;
    let (mut draw, mut expected) = (Draw(44), BTreeSet::new());
    let (kills, mut took) = (count()?, Duration::ZERO);
    for run in 0..kills {
        let port = server.port();
        let begun = Instant::now();
        let publisher = thread::spawn(move || acknowledged(port, run.into()));
        thread::sleep(Duration::from_millis(100 + draw.below(500)));
        took += begun.elapsed();
        server.kill(Duration::ZERO)?;
        expected.extend(publisher.join().expect("no thread panics"));
    }
    let found = server.identifiers()?;
    let lost = expected.difference(&found).count();
    println!(
        "{kills} kills of the server: {} acknowledged, {lost} lost, {:.0} a second",
        expected.len(),
        expected.len() as f64 / took.as_secs_f64()
    );
    ensure!(expected.len() > 20 * kills as usize, "{}", expected.len());
    ensure!(lost == 0, "{lost} of {}", expected.len());
    Ok(())
}

#[test]
#[ignore = "campaign: cargo test -p trueup-serve --test live campaign_nats -- --ignored --nocapture"]
fn campaign_nats_gets_and_keeps_each_record_in_fifty_schedules_of_kills() -> Result<()> {
    let folder = tempfile::tempdir()?;
    let mut server = Nats::start(folder.path())?;
    let count = count()?;
    let (recorded, longest) = schedules(count, 2_026, folder.path(), &mut server)?;
    let found = server.identifiers()?;
    let lost = recorded.difference(&found).count();
    println!(
        "{count} schedules with NATS: {} recorded, {lost} lost; state right after {longest:?} at most",
        recorded.len()
    );
    ensure!(lost == 0, "{lost} of {}", recorded.len());
    Ok(())
}

#[test]
#[ignore = "campaign: cargo test -p trueup-serve --test live campaign_nats -- --ignored --nocapture"]
fn campaign_nats_takes_a_thousand_bridges() -> Result<()> {
    let folder = tempfile::tempdir()?;
    let server = Nats::start(folder.path())?;
    a_thousand(folder.path(), &server)?;
    let begun = Instant::now();
    let records = server.identifiers()?.len();
    println!(
        "the server has {records} records of {} bytes each on its disk; trueup fleet records prints them in {:.1} s",
        bytes(&server.folder.join("jetstream"))? / records.max(1) as u64,
        begun.elapsed().as_secs_f64()
    );
    Ok(())
}

/// Returns the bytes of all files below a folder.
fn bytes(folder: &Path) -> Result<u64> {
    let one = |entry: fs::DirEntry| match entry.file_type()?.is_dir() {
        true => bytes(&entry.path()),
        false => Ok(entry.metadata()?.len()),
    };
    fs::read_dir(folder)?.flatten().map(one).sum()
}
