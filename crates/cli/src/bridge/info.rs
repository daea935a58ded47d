//! `trueup bridge info`: who the bridge is, and how it is.

use std::time::{Duration, Instant};

use anyhow::{Result, bail};
use serde_json::json;
use trueup_core::cnc::Output;
use trueup_link::{
    frames::{self, State},
    receiver::OffsetReceiver,
    slcan::Event,
};

use super::{output_json, output_text, port::Port, session::Session, state_word};
use crate::{Outcome, output};

/// How long answers, a heartbeat and offsets are waited for: 20 heartbeats.
const PATIENCE: Duration = Duration::from_secs(2);

/// What is known of a bridge.
#[derive(Default)]
struct Info {
    version: Option<String>,
    serial: Option<String>,
    heartbeat: Option<State>,
    output: Option<Output>,
    offsets: OffsetReceiver,
}

impl Info {
    fn hear(&mut self, event: &Event) {
        match event {
            Event::Other(line) => {
                let text = || String::from_utf8_lossy(line).into_owned();
                match line.first() {
                    Some(b'V') => self.version = Some(text()),
                    Some(b'N') => self.serial = Some(text()),
                    _ => {}
                }
            }
            Event::Frame(frame) => {
                self.heartbeat = frames::decode_heartbeat(frame).ok().or(self.heartbeat);
                self.output = self.offsets.accept(frame).ok().flatten().or(self.output);
            }
            Event::Accepted | Event::Refused | Event::Malformed(_) => {}
        }
    }

    fn is_complete(&self) -> bool {
        self.version.is_some()
            && self.serial.is_some()
            && self.heartbeat.is_some()
            && self.output.is_some()
    }
}

/// Asks the bridge at `port` and prints what it says.
pub fn run(port: &str, as_json: bool) -> Result<Outcome> {
    let stream = Port::parse(port)?.open()?;
    let mut session = Session::open(stream)?;
    session.write(b"V\rN\r")?;
    let deadline = Instant::now() + PATIENCE;
    let mut info = Info::default();
    while !info.is_complete() {
        let Some(event) = session.next_event(deadline)? else { break };
        info.hear(&event);
    }
    session.close();
    let (Some(version), Some(serial)) = (&info.version, &info.serial) else {
        bail!("the bridge does not tell its version and serial number; is it a bridge?");
    };
    let state = info.heartbeat.map(state_word);
    if as_json {
        let mut all = output_json(info.output.as_ref());
        all["version"] = json!(version);
        all["serial"] = json!(serial);
        all["heartbeat"] = json!(state);
        output::print(all)?;
    } else {
        let seconds = PATIENCE.as_secs();
        let missing = format!("none in {seconds} s");
        output::print(format_args!("version    {version}"))?;
        output::print(format_args!("serial     {serial}"))?;
        output::print(format_args!("heartbeat  {}", state.unwrap_or(&missing)))?;
        let offsets = info.output.as_ref().map_or_else(|| missing.clone(), output_text);
        output::print(format_args!("offsets    {offsets}"))?;
    }
    Ok(if info.is_complete() { Outcome::Done } else { Outcome::NotMet })
}
