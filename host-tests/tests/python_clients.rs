//! The running virtual bridge and clients that this project did not write: python-can, cantools and
//! autosar-e2e as a CNC; a bare socket as a terminal; a plant in JSON lines.
//!
//! The bridge is the real command with the real firmware in it, started as a user starts it.

mod support;

use std::{
    io::{BufRead as _, BufReader, ErrorKind, Read as _, Write as _},
    net::{TcpListener, TcpStream},
    process::{Command, Stdio},
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result, bail, ensure};
use serde_json::{Value, json};
use support::{BridgeProcess, FAST_MACHINE, GROWN_UM, TIMEOUT, file, wait_until_stuck};
use trueup_core::cnc::{CncMessage as CncCommand, Control, OffsetFlags, OffsetQuality};
use trueup_emulator::{cnc_client::CncClient, setup};
use trueup_link::e2e;

const CNC_LOST: u8 = OffsetFlags::CNC_LOST.0;
/// Noise after the filter, the rounding of a code and of the wire.
const TOLERANCE_UM: f64 = 0.3;

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or(f64::NAN)
}

/// Returns whether the range in `value` lies within `tolerance` of `expected`.
fn is_near(value: &Value, expected: f64, tolerance: f64) -> bool {
    [0, 1].iter().all(|&end| (number(&value[end]) - expected).abs() <= tolerance)
}

#[test]
fn python_can_cantools_and_autosar_e2e_engage_it_and_read_every_frame() -> Result<()> {
    let python = setup::ensure_python()?;
    let mut bridge = BridgeProcess::start_grown()?;
    let output = Command::new(python)
        .arg(setup::project_root().join("host-tests/python/cnc_client.py"))
        .arg(format!("socket://{}", bridge.address()))
        .arg(setup::project_root().join("crates/board/link/trueup.dbc"))
        .stdin(Stdio::null())
        .output()?;
    let stderr = String::from_utf8_lossy(&output.stderr);
    ensure!(output.status.success(), "{stderr}\nthe bridge: {}", bridge.command.log());
    let saw: Value = serde_json::from_slice(&output.stdout)?;
    println!("{saw:#}");

    assert_eq!(saw["wrong"], json!([]), "every frame is read, protected, in order, in pairs");
    assert_eq!(
        saw["states"],
        json!([0, 4, 5]),
        "one heartbeat says: boot-up, the others: stopped until it is engaged, then operational"
    );
    assert_eq!(saw["offset_xy"], saw["offset_z"]);
    let cycles = saw["offset_z"].as_u64().context("a count")?;
    let heartbeats = saw["heartbeats"].as_u64().context("a count")?;
    assert!(cycles.abs_diff(heartbeats * 100) <= 200, "{heartbeats} heartbeats in {cycles} ms");

    // The status: each item in turn, ten a second of the board, and what was wrong with Control.
    let items: Vec<u64> =
        saw["items"].as_array().into_iter().flatten().filter_map(Value::as_u64).collect();
    assert!((items.len() as u64 * 100).abs_diff(cycles) <= 200, "{} in {cycles} ms", items.len());
    assert!(items.windows(2).all(|pair| pair[1] == (pair[0] + 1) % 11), "{items:?}");
    assert_eq!(saw["reasons"], json!([0, 2, 3]), "none, then damaged, then repeated");
    let board = &saw["board"];
    assert!((number(&board["Elongation"]) - GROWN_UM).abs() < TOLERANCE_UM, "{board}");
    assert!(number(&board["Damaged"]) > 20.0 && number(&board["OutOfSequence"]) > 20.0, "{board}");
    assert_eq!(board["Temperature3"], json!(-327.68), "nothing is connected there");

    let phases = &saw["phases"];
    for (phase, flags, why) in [
        ("listening", 0, "no Control was sent"),
        ("damaged", 0, "the CRC of each Control was wrong, so none was heard"),
        ("repeated", CNC_LOST, "after the first three, which do not engage, each is a repetition"),
    ] {
        let saw = &phases[phase];
        assert_eq!(saw["qualities"], json!([6]), "{why}: {saw}");
        assert!(is_near(&saw["OffsetZ"], -5_242.88, 0.0), "not available, {why}: {saw}");
        assert_eq!(saw["Flags"], json!([0, flags]), "{why}: {saw}");
    }

    let live = &phases["live"];
    assert_eq!(live["cycles"], 1_000);
    assert_eq!(live["qualities"], json!([1]), "{live}");
    assert!(is_near(&live["OffsetZ"], GROWN_UM, TOLERANCE_UM), "the growth is undone: {live}");
    assert!((number(&live["mean_z_um"]) - GROWN_UM).abs() < 0.1, "{live}");
    // A tool that points straight down moves nothing sideways.
    assert!(is_near(&live["OffsetX"], 0.0, 0.0) && is_near(&live["OffsetY"], 0.0, 0.0), "{live}");

    assert_eq!(
        phases["engaging"]["qualities"].as_array().and_then(|all| all.last()),
        Some(&json!(1))
    );
    let leaving = &phases["disengaging"];
    // The first cycles were on their way before the bridge had received.
    assert!([json!([1, 5, 0]), json!([5, 0])].contains(&leaving["qualities"]), "{leaving}");
    assert_eq!(leaving["last_z_um"], json!(0.0), "{leaving}");
    assert_eq!(leaving["ramp_turns_back"], json!(false), "{leaving}");
    for phase in ["engaging", "disengaging"] {
        // 1000 µm/s are 1 µm in a cycle, and the wire rounds to 0.01 µm.
        let step = number(&phases[phase]["largest_step_um"]);
        assert!((0.9..=1.011).contains(&step), "{phase} in steps of {step} µm");
    }
    bridge.command.signal("TERM")?;
    assert!(bridge.command.end()?.status.success());
    Ok(())
}

#[test]
fn autosar_e2e_protects_as_we_do() -> Result<()> {
    let mut frames = vec![(0x0181, [0, 0, 0, 0x11, 0x22, 0x33, 0x44, 0x55])];
    let mut random = 1_u64;
    frames.extend((0..2_000_u16).map(|n| {
        random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(n.into());
        (n & 0x7FF, random.to_be_bytes())
    }));
    let hex = |data: &[u8; 8]| data.map(|byte| format!("{byte:02x}")).concat();
    let lines: String = frames.iter().map(|(id, data)| format!("{id:x} {}\n", hex(data))).collect();
    let folder = tempfile::tempdir()?;
    let input = file(&folder, "frames.txt", &lines)?;
    let output = Command::new(setup::ensure_python()?)
        .arg(setup::project_root().join("host-tests/python/e2e_protect.py"))
        .stdin(std::fs::File::open(input)?)
        .output()?;
    ensure!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let theirs = String::from_utf8(output.stdout)?;
    assert!(theirs.starts_with("8bcb001122334455 1\n"), "the vector of the documentation");
    assert_eq!(theirs.lines().count(), frames.len());
    for ((id, mut data), theirs) in frames.into_iter().zip(theirs.lines()) {
        e2e::protect(id, data[2], &mut data);
        assert_eq!(theirs, format!("{} 1", hex(&data)), "data ID {id:#x}");
    }
    Ok(())
}

/// A terminal: lines out, answers in, frames counted.
struct Terminal {
    stream: TcpStream,
    frames: usize,
}

impl Terminal {
    fn new(bridge: &BridgeProcess) -> Result<Self> {
        Ok(Self { stream: bridge.connect()?, frames: 0 })
    }

    /// Returns what the board answers to a line, with its end.
    fn query(&mut self, line: &str) -> Result<String> {
        self.stream.write_all(format!("{line}\r").as_bytes())?;
        loop {
            match self.next()? {
                frame if frame.starts_with('t') => self.frames += 1,
                answer => return Ok(answer),
            }
        }
    }

    /// Returns the next thing that the board says, up to a carriage return or a bell.
    fn next(&mut self) -> Result<String> {
        let (mut text, mut byte) = (String::new(), [0]);
        while !text.ends_with(['\r', '\x07']) {
            ensure!(self.stream.read(&mut byte)? == 1, "the line was closed after {text:?}");
            text.push(char::from(byte[0]));
        }
        Ok(text)
    }

    /// Listens for a while in which nothing may come.
    fn silence(&mut self) -> Result<()> {
        self.stream.set_read_timeout(Some(Duration::from_millis(200)))?;
        match self.stream.read(&mut [0]) {
            Err(error) if [ErrorKind::WouldBlock, ErrorKind::TimedOut].contains(&error.kind()) => {}
            received => bail!("something came: {received:?}"),
        }
        self.stream.set_read_timeout(Some(TIMEOUT))?;
        Ok(())
    }
}

#[test]
fn the_handshake_is_lawicels_and_a_bad_line_rings_the_bell() -> Result<()> {
    let bridge = BridgeProcess::start_grown()?;
    let mut terminal = Terminal::new(&bridge)?;
    let closed = [
        ("", "\r"),
        ("V", "V1013\r"),
        ("N", "N0001\r"),
        ("F", "F00\r"),
        ("C", "\r"),
        ("C", "\r"),
        ("S8", "\r"),
        // No such command, half a frame, a rate that is none, a frame on a closed channel.
        ("X", "\x07"),
        ("t18", "\x07"),
        ("S9", "\x07"),
        ("t30220000", "\x07"),
        ("V", "V1013\r"),
    ];
    for (line, answer) in closed {
        assert_eq!(terminal.query(line)?, answer, "to {line:?} while it is closed");
    }
    assert_eq!(terminal.frames, 0);
    terminal.silence()?;

    let open = [
        ("O", "\r"),
        ("O", "\r"),
        ("", "\r"),
        ("N", "N0001\r"),
        ("tXYZ0", "\x07"),
        ("t1819", "\x07"),
        ("t30220000", "\r"),
        ("V", "V1013\r"),
    ];
    for (line, answer) in open {
        assert_eq!(terminal.query(line)?, answer, "to {line:?} while it is open");
    }
    while terminal.frames < 100 {
        ensure!(terminal.next()?.starts_with('t'), "only frames come by themselves");
        terminal.frames += 1;
    }
    for _ in 0..2 {
        assert_eq!(terminal.query("C")?, "\r");
    }
    terminal.silence()?;
    Ok(())
}

#[test]
fn a_second_client_waits_until_the_first_has_gone() -> Result<()> {
    let bridge = BridgeProcess::start_grown()?;
    let mut first = Terminal::new(&bridge)?;
    assert_eq!(first.query("O")?, "\r");
    assert!(first.next()?.starts_with('t'));

    let mut second = Terminal::new(&bridge)?;
    second.stream.write_all(b"C\rV\r")?;
    second.silence()?;
    assert_eq!(first.query("C")?, "\r");
    drop(first);
    assert_eq!(second.next()?, "\r");
    assert_eq!(second.next()?, "V1013\r");

    Ok(())
}

#[test]
fn a_client_that_leaves_in_mid_line_leaves_no_half_line_to_the_next() -> Result<()> {
    let bridge = BridgeProcess::start_grown()?;
    assert_eq!(Terminal::new(&bridge)?.query("O")?, "\r");
    for _ in 0..30 {
        let mut next = Terminal::new(&bridge)?;
        let line = next.next()?;
        let length = if line.starts_with("t701") { 8 } else { 22 };
        assert!(line.starts_with('t') && line.len() == length, "{line:?}");
        next.stream.write_all(b"t302")?;
    }
    for _ in 0..10 {
        let mut cnc = CncClient::open(bridge.connect()?)?;
        assert_eq!(cnc.query("V")?, "V1013");
        assert_eq!(cnc.next_output()?.quality, OffsetQuality::Fault, "not engaged");
        cnc.write(b"t302")?;
    }
    Ok(())
}

#[test]
fn a_client_that_never_reads_stops_no_other_once_it_has_gone() -> Result<()> {
    let bridge = BridgeProcess::start_grown_at("max")?;
    let mut deaf = bridge.connect()?;
    deaf.write_all(b"O\r")?;
    wait_until_stuck(&deaf)?;
    drop(deaf);
    CncClient::open(bridge.connect()?)?.next_output()?;
    Ok(())
}

/// The test's side of `--plant`.
struct Plant {
    lines: BufReader<TcpStream>,
    ms: u32,
}

impl Plant {
    fn accept(listener: &TcpListener) -> Result<Self> {
        let (stream, _) = listener.accept()?;
        stream.set_nodelay(true)?;
        stream.set_read_timeout(Some(TIMEOUT))?;
        Ok(Self { lines: BufReader::new(stream), ms: 0 })
    }

    /// Lets this many milliseconds pass; gives the answer.
    fn step(&mut self, ms: u32, sensor_v: f64) -> Result<Value> {
        self.ms += ms;
        let step = json!({
            "t_s": f64::from(self.ms) / 1_000.0,
            "sensor_v": sensor_v,
            "temps_c": { "temp_screw_c": 21.5 },
            "spindle_rpm": 24_000,
        });
        self.lines.get_mut().write_all(format!("{step}\n").as_bytes())?;
        let mut line = String::new();
        self.lines.read_line(&mut line)?;
        serde_json::from_str(&line).with_context(|| format!("{line:?} is not an answer"))
    }
}

#[test]
fn a_plant_gets_back_what_the_cnc_gets() -> Result<()> {
    const STEP_MS: u32 = 5;
    let folder = tempfile::tempdir()?;
    let machine = file(&folder, "machine.toml", FAST_MACHINE)?;
    let listener = TcpListener::bind("127.0.0.1:0")?;
    let address = format!("tcp:{}", listener.local_addr()?);
    let mut bridge = BridgeProcess::start(&["--machine", &machine, "--plant", &address])?;
    let mut plant = Plant::accept(&listener)?;
    let mut cnc = CncClient::open(bridge.connect()?)?;

    let volts = |counts: f64| counts * 10.0 / 32_768.0;
    let um = |counts: f64| (counts - 5_048.0) * 500.0 / 32_768.0;
    // The first step says when the plant's clock starts, and lasts a millisecond.
    plant.step(1, volts(9_164.0))?;
    let answer = plant.step(200, volts(9_164.0))?;
    assert_eq!(answer, json!({ "offset_um": [null, null, null], "quality": 6 }), "nobody engages");

    let engage = CncCommand::Control(Control::ENGAGED);
    let mut last = Value::Null;
    // Longer than the spindle was at the start, then shorter: the offset goes up, then down.
    for counts in [9_164.0, 4_000.0] {
        for _ in 0..20 {
            cnc.send_message(engage)?;
            for _ in 0..4 {
                last = plant.step(STEP_MS, volts(counts))?;
            }
        }
        assert_eq!(last["quality"], 1, "{last}");
        let [x, y, z] = [0, 1, 2].map(|axis| number(&last["offset_um"][axis]));
        assert_eq!([x, y], [0.0; 2], "{last}");
        assert!((z - um(counts)).abs() <= TOLERANCE_UM, "{} µm is undone: {last}", um(counts));
    }
    // Every millisecond of the plant was a cycle for the CNC, and the last says the same.
    let started = Instant::now();
    let mut output = cnc.next_output()?;
    for _ in 1..plant.ms {
        output = cnc.next_output()?;
    }
    assert!(started.elapsed() < TIMEOUT);
    assert_eq!(output.quality, OffsetQuality::Live);
    let [_, _, z] = output.offset.context("available")?;
    assert_eq!(json!(f64::from(z.0) / 1_000.0), last["offset_um"][2]);

    drop(plant);
    let ended = bridge.command.end()?;
    assert!(ended.status.success(), "{ended:?}");
    assert!(ended.stderr.contains("the plant has closed its line"), "{ended:?}");
    assert!(bridge.command.emulators_left().is_empty());
    Ok(())
}
