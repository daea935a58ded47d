//! An agent at the adapter: an independent reader of SHDR and of `Devices.xml`, with the vocabulary of the standard's
//! own model. It keeps what it is sent; what breaks a rule ends it with the reason.

use std::{
    io::{Read as _, Write as _},
    net::TcpStream,
    process::{Command, Stdio},
    sync::atomic::Ordering,
    thread,
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result, ensure};
use serde_json::{Value, json};
use trueup_emulator::setup;

use crate::{
    bridge::{self, Switches},
    parts::{Start, TIMEOUT, free_port},
};

/// Returns what an agent knows each second, for this many seconds.
fn agent(start: &Start, port: u16, seconds: u32) -> Result<Vec<Value>> {
    let output = Command::new(setup::ensure_python()?)
        .arg(setup::project_root().join("host-tests/python/mtconnect_agent.py"))
        .arg(start.spool.join("Devices.xml"))
        .args([port.to_string(), seconds.to_string()])
        .stderr(Stdio::piped())
        .output()?;
    ensure!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8(output.stdout)?;
    Ok(text.lines().map(serde_json::from_str).collect::<Result<_, _>>()?)
}

#[test]
fn an_agent_keeps_what_the_bridge_does_and_notices_that_it_is_gone() -> Result<()> {
    let folder = tempfile::tempdir()?;
    let (switches, port) = (Switches::default(), free_port());
    let start = Start {
        bridge: bridge::start(switches.clone()),
        name: "mill-7".into(),
        spool: folder.path().join("spool"),
        url: String::new(),
        more: json!({ "mtconnect": format!("127.0.0.1:{port}") }),
    };
    let _publisher = start.spawn()?;
    let end = Instant::now() + TIMEOUT;
    // Its serial number is known.
    let devices = start.spool.join("Devices.xml");
    while !std::fs::read_to_string(&devices).unwrap_or_default().contains("uuid=\"trueup-0") {
        let text = std::fs::read_to_string(&devices).unwrap_or_default();
        if text.contains("serialNumber=\"") && !text.contains("serialNumber=\"\"") {
            break;
        }
        ensure!(Instant::now() < end, "{text}\n{}", start.log());
        thread::sleep(Duration::from_millis(50));
    }
    // A client that sends no line, or too long a one, is closed; the agents go on.
    let mut hostile = TcpStream::connect(("127.0.0.1", port))?;
    hostile.write_all(&[b'x'; 100_000]).ok();
    let off = switches.is_off.clone();
    let switch = thread::spawn(move || {
        thread::sleep(Duration::from_secs(4));
        off.store(true, Ordering::Relaxed);
    });
    let known = agent(&start, port, 8)?;
    switch.join().ok().context("the switch")?;
    let value = |at: &Value, key: &str| at["values"][key].as_str().unwrap_or_default().to_owned();
    let live = &known[3];
    println!("{live:#}");
    assert_eq!(value(live, "b1_avail"), "AVAILABLE");
    let mm: f64 = value(live, "b1_offset_z").parse()?;
    assert!((mm - 0.0123).abs() < 0.0005, "{mm} mm: the spindle has grown by 12.3 µm");
    assert_eq!(value(live, "b1_temperature_0"), "UNAVAILABLE", "nothing is connected there");
    assert_eq!(live["conditions"]["b1_line"], json!({}));
    assert!(live["pongs"].as_u64() >= Some(2) && live["skew_s"].as_f64() < Some(2.0), "{live}");
    let gone = known.last().context("lines")?;
    for key in ["b1_avail", "b1_offset_z", "b1_elongation"] {
        assert_eq!(value(gone, key), "UNAVAILABLE", "{gone}");
    }
    assert_eq!(gone["conditions"]["b1_faults"], Value::Null);
    assert!(gone["conditions"]["b1_line"]["bridge-down"].is_array(), "{gone}");
    assert_eq!(gone["values"]["b1_message"][0], "bridge-down");
    let mut bytes = [0; 1 << 16];
    hostile.set_read_timeout(Some(Duration::from_secs(2)))?;
    while hostile.read(&mut bytes).is_ok_and(|length| length > 0) {}
    Ok(())
}
