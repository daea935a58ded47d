//! The real parts: mosquitto, a Sparkplug host by pysparkplug, and the publisher in a process of its own, each on
//! loopback and ended with its owner.

use std::{
    fs,
    io::{BufRead as _, BufReader, Write as _},
    net::TcpListener,
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    sync::{Arc, Mutex, atomic::AtomicBool},
    thread,
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result, ensure};
use serde_json::{Value, json};
use trueup_client::port::PortAddress;
use trueup_emulator::setup;
use trueup_serve::{
    broker::{self, TlsFiles},
    publisher::{self, PublisherOptions},
};

/// How long anything may take on a busy computer.
pub const TIMEOUT: Duration = Duration::from_secs(30);

/// A process that ends with this.
pub struct Process(pub Child);

impl Process {
    /// Ends it at once: SIGKILL.
    pub fn kill(&mut self) {
        self.0.kill().ok();
        self.0.wait().ok();
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        self.kill();
    }
}

/// Returns a port of this computer that is free now.
pub fn free_port() -> u16 {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
    listener.local_addr().expect("bound").port()
}

/// A broker that is killed.
pub trait Broker {
    /// Ends it at once, and starts it again after this time.
    fn kill(&mut self, pause: Duration) -> Result<()>;
    /// The port for MQTT on this computer.
    fn port(&self) -> u16;
    /// The number of its process.
    fn process(&self) -> String;
}

impl Broker for Mosquitto {
    fn kill(&mut self, pause: Duration) -> Result<()> {
        self.process = None;
        thread::sleep(pause);
        self.restart()
    }

    fn port(&self) -> u16 {
        self.port
    }

    fn process(&self) -> String {
        self.process.as_ref().map_or_else(String::new, |process| process.0.id().to_string())
    }
}

/// Waits until something listens at a port of this computer.
pub fn wait_for_port(port: u16, log: &Path) -> Result<()> {
    let end = Instant::now() + TIMEOUT;
    while std::net::TcpStream::connect(("127.0.0.1", port)).is_err() {
        ensure!(Instant::now() < end, "{}", fs::read_to_string(log)?);
        thread::sleep(Duration::from_millis(10));
    }
    Ok(())
}

/// A broker with a folder of its own, that keeps what it has acknowledged: within a second it is on its disk.
pub struct Mosquitto {
    process: Option<Process>,
    program: PathBuf,
    folder: PathBuf,
    pub port: u16,
}

impl Mosquitto {
    pub fn start(folder: &Path, more: &str) -> Result<Self> {
        let folder = folder.join("broker");
        fs::create_dir_all(&folder)?;
        let port = free_port();
        let mut text = format!(
            "listener {port} 127.0.0.1\nuser root\npersistence true\npersistence_location {}/\n\
             max_queued_messages 0\n{more}\n",
            folder.display()
        );
        for (key, lines) in [
            ("autosave", "autosave_interval 1\nautosave_on_changes true\n"),
            ("allow_anonymous", "allow_anonymous true\n"),
        ] {
            if !more.contains(key) {
                text += lines;
            }
        }
        fs::write(folder.join("mosquitto.conf"), text)?;
        let program = setup::ensure_mosquitto()?;
        let mut broker = Self { process: None, program, folder, port };
        broker.restart()?;
        Ok(broker)
    }

    fn restart(&mut self) -> Result<()> {
        let log = fs::OpenOptions::new().create(true).append(true).open(self.folder.join("log"))?;
        let mut command = Command::new(&self.program);
        command.arg("-c").arg(self.folder.join("mosquitto.conf"));
        let child = command.stdout(log.try_clone()?).stderr(log).spawn()?;
        self.process = Some(Process(child));
        wait_for_port(self.port, &self.folder.join("log"))
    }

    pub fn url(&self) -> String {
        format!("mqtt://127.0.0.1:{}", self.port)
    }
}

/// The Sparkplug host, and its output: a line of JSON for each message.
pub struct Host {
    process: Process,
    messages: Arc<Mutex<Vec<(Instant, Value)>>>,
}

impl Host {
    pub fn start(port: u16) -> Result<Self> {
        let mut child = Command::new(setup::ensure_python()?)
            .arg(setup::project_root().join("host-tests/python/sparkplug_host.py"))
            .arg(port.to_string())
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()?;
        let lines = BufReader::new(child.stdout.take().context("asked for")?).lines();
        let messages = Arc::new(Mutex::new(Vec::new()));
        let keep = messages.clone();
        thread::spawn(move || {
            for line in lines.map_while(Result::ok) {
                let value = serde_json::from_str(&line).unwrap_or_else(|_| json!({ "what": line }));
                keep.lock().expect("no thread panics with it").push((Instant::now(), value));
            }
        });
        let host = Self { process: Process(child), messages };
        host.wait("it is connected", |message| message["what"] == "connected")?;
        Ok(host)
    }

    pub fn messages(&self) -> Vec<(Instant, Value)> {
        self.messages.lock().expect("no thread panics with it").clone()
    }

    /// Waits for a message; returns when it came, and it.
    pub fn wait(&self, what: &str, is_it: impl Fn(&Value) -> bool) -> Result<(Instant, Value)> {
        self.wait_since(
            Instant::now().checked_sub(TIMEOUT * 10).unwrap_or_else(Instant::now),
            what,
            is_it,
        )
    }

    /// Waits for a message that came after a moment.
    pub fn wait_since(
        &self,
        since: Instant,
        what: &str,
        is_it: impl Fn(&Value) -> bool,
    ) -> Result<(Instant, Value)> {
        let end = Instant::now() + TIMEOUT;
        loop {
            {
                let messages = self.messages.lock().expect("no thread panics with it");
                let first = messages.partition_point(|(at, _)| *at < since);
                if let Some(found) = messages[first..].iter().find(|(_, message)| is_it(message)) {
                    return Ok(found.clone());
                }
                let (count, last) = (messages.len(), messages.last());
                ensure!(Instant::now() < end, "never: {what}; the last of {count}: {last:?}");
            }
            thread::sleep(Duration::from_millis(5));
        }
    }

    /// Lets it do something: a line to its standard input.
    pub fn send_line(&mut self, line: &str) -> Result<()> {
        let input = self.process.0.stdin.as_mut().context("asked for")?;
        writeln!(input, "{line}")?;
        Ok(input.flush()?)
    }
}

/// The options of a publisher; its bridges with commas between them.
#[derive(Clone, Default)]
pub struct Start {
    pub bridge: String,
    pub name: String,
    pub spool: PathBuf,
    pub url: String,
    pub more: Value,
}

impl Start {
    /// Returns a publisher in a process of its own: this program again, with [`publisher`] as its only test.
    pub fn spawn(&self) -> Result<Process> {
        let text = json!({
            "bridge": self.bridge, "name": self.name, "spool": self.spool, "url": self.url, "more": self.more,
        });
        let log = self.spool.with_extension("log");
        let log = fs::OpenOptions::new().create(true).append(true).open(log)?;
        let child = Command::new(std::env::current_exe()?)
            .args(["--exact", "parts::publisher", "--nocapture"])
            .env(VARIABLE, text.to_string())
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(log)
            .spawn()?;
        Ok(Process(child))
    }

    /// Returns what the publishers of this spool have reported.
    pub fn log(&self) -> String {
        fs::read_to_string(self.spool.with_extension("log")).unwrap_or_default()
    }

    pub fn wait_for_log(&self, phrase: &str) -> Result<()> {
        let end = Instant::now() + TIMEOUT;
        while !self.log().contains(phrase) {
            ensure!(Instant::now() < end, "never \"{phrase}\" in:\n{}", self.log());
            thread::sleep(Duration::from_millis(20));
        }
        Ok(())
    }
}

const VARIABLE: &str = "TRUEUP_TEST_PUBLISHER";

/// The publisher, where this program was started as one; else nothing.
#[test]
fn publisher() -> Result<()> {
    let Ok(text) = std::env::var(VARIABLE) else { return Ok(()) };
    let start: Value = serde_json::from_str(&text)?;
    let word = |value: &Value| value.as_str().map(str::to_owned);
    let more = &start["more"];
    let path = |value: &Value| word(value).map(PathBuf::from);
    let (ca, cert, key) = (path(&more["ca"]), path(&more["cert"]), path(&more["key"]));
    let login = word(&more["user"]).zip(word(&more["password"]));
    let files = TlsFiles { ca: ca.as_deref(), own: cert.as_deref().zip(key.as_deref()) };
    let url = word(&start["url"]).unwrap_or_default();
    let broker = if url.is_empty() {
        None
    } else {
        Some(broker::BrokerConfig::from_url(&url, login, files)?)
    };
    let mtconnect = word(&more["mtconnect"]).map(|text| text.parse()).transpose()?;
    let bridges = word(&start["bridge"]).context("a bridge")?;
    let ports: Result<Vec<PortAddress>, _> = bridges.split(',').map(PortAddress::parse).collect();
    let options = PublisherOptions {
        ports: ports?,
        name: word(&start["name"]).context("a name")?,
        spool: path(&start["spool"]).context("a spool")?,
        spool_bytes: 64 << 20,
        row: Duration::from_millis(more["row_ms"].as_u64().unwrap_or(1_000)),
        broker,
        primary_host: word(&more["primary_host"]),
        mtconnect: mtconnect.into_iter().collect(),
        devices: None,
        once: false,
        version: "0.0.0",
    };
    let report = |text: &str| {
        let mut stderr = fs::OpenOptions::new().append(true).open("/dev/stderr").ok();
        stderr.as_mut().and_then(|stderr| writeln!(stderr, "{text}").ok());
    };
    publisher::run(options, Arc::new(AtomicBool::new(false)), report)?;
    Ok(())
}
