//! `bridge monitor` and `bridge info` against a bridge that runs in this process: the node and the
//! SLCAN port of the firmware, without its hardware.

use std::{
    io::{ErrorKind, Read, Write},
    net::TcpListener,
    path::Path,
    process::{Command, Output},
    sync::{Arc, Mutex},
    thread,
    time::{Duration, Instant},
};

use trueup_core::{
    bridge::Input,
    cnc::Control,
    filter::CODES_PER_TICK,
    units::{Code, Rpm},
};
use trueup_link::{frame::Frame, frames, node::Node, slcan::Port};
use trueup_machine::{MachineFile, compile};

/// What the bridge has heard from its client.
#[derive(Default)]
struct Heard {
    bytes: Vec<u8>,
    frames: usize,
}

/// What is wrong with the bridge.
#[derive(Clone, Copy, PartialEq)]
enum Fault {
    None,
    /// A bit of every hundredth frame is flipped.
    Noise,
    /// It answers, but sends no frame.
    NoFrames,
    /// It says nothing at all.
    Silent,
    /// It closes the line after a while.
    Leaves,
}

/// A bridge at a port of this machine, engaged by a CNC that it has elsewhere.
fn bridge(fault: Fault) -> (String, Arc<Mutex<Heard>>) {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
    let address = format!("tcp:{}", listener.local_addr().expect("bound above"));
    let heard = Arc::new(Mutex::new(Heard::default()));
    let told = heard.clone();
    thread::spawn(move || {
        let (stream, _) = listener.accept().expect("the tool connects");
        stream.set_nonblocking(true).expect("a plain socket");
        live(stream, fault, &told);
    });
    (address, heard)
}

fn live(mut stream: impl Read + Write, fault: Fault, heard: &Mutex<Heard>) {
    let machine = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../data/paper_spindle.toml");
    let machine = MachineFile::read(&machine).expect("the project's own file");
    let compiled = compile(&machine).expect("the paper's sensor fits");
    let (mut node, mut port) = (Node::new(Some(compiled.calibration()), false), Port::new(0x00A1));
    // 100 codes above the paper's zero: 12.2 µm, which the slew limit reaches in 0.6 s.
    let codes: [Code; CODES_PER_TICK] = std::array::from_fn(|n| Code(731 + (n % 2) as u16));
    let start = Instant::now();
    let mut bytes = [0; 256];
    for ms in 0_u32.. {
        let due = Duration::from_millis(ms.into());
        thread::sleep(due.saturating_sub(start.elapsed()));
        if fault == Fault::Leaves && ms > 1_300 {
            return;
        }
        match stream.read(&mut bytes) {
            Ok(0) => return,
            Ok(length) => {
                let mut heard = heard.lock().expect("nobody panics with it");
                heard.bytes.extend(&bytes[..length]);
                heard.frames += bytes[..length].iter().filter_map(|&b| port.receive(b)).count();
            }
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {}
            Err(_) => return,
        }
        if ms % 20 == 0 {
            let engaged = Control { engage: true, referenced: true, zero: false };
            node.hear(&frames::control(engaged, (ms / 20) as u8)).expect("in order");
        }
        let speed = Some(Rpm(24_000));
        let sent = node.tick(1, Input { codes: Some(&codes), speed, ..Input::default() });
        if fault != Fault::NoFrames {
            for frame in &sent {
                let flip = fault == Fault::Noise && ms % 100 == 99;
                port.send(&if flip { damaged(frame) } else { *frame });
            }
        }
        let answer: Vec<u8> = std::iter::from_fn(|| port.pop()).collect();
        if fault != Fault::Silent && write_all(&mut stream, &answer).is_err() {
            return;
        }
    }
}

/// A socket that does not block may take bytes in parts.
fn write_all(stream: &mut impl Write, mut bytes: &[u8]) -> std::io::Result<()> {
    while !bytes.is_empty() {
        match stream.write(bytes) {
            Ok(taken) => bytes = &bytes[taken..],
            Err(error) if error.kind() == ErrorKind::WouldBlock => thread::yield_now(),
            Err(error) => return Err(error),
        }
    }
    Ok(())
}

fn damaged(frame: &Frame) -> Frame {
    let mut data = *frame.data();
    data[5] ^= 0x04;
    Frame::new(frame.id(), &data[..frame.len().into()]).expect("the frame's own identifier")
}

fn trueup(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_trueup"))
        .args(arguments)
        .output()
        .expect("the tool was built for this test")
}

fn monitor(port: &str, count: &str, more: &[&str]) -> (Option<i32>, String, String) {
    let arguments = [&["bridge", "monitor", "--port", port, "--count", count][..], more].concat();
    ended(trueup(&arguments))
}

fn ended(output: Output) -> (Option<i32>, String, String) {
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).expect("text");
    (output.status.code(), text(output.stdout), text(output.stderr))
}

fn json_lines(text: &str) -> Vec<serde_json::Value> {
    text.lines().map(|line| serde_json::from_str(line).expect("a JSON object a line")).collect()
}

#[test]
fn the_monitor_tells_the_offsets_once_a_second_and_sends_no_frame() {
    let (port, heard) = bridge(Fault::None);
    let (code, out, err) = monitor(&port, "2", &["--json"]);
    assert_eq!(code, Some(0), "{out}{err}");
    let lines = json_lines(&out);
    assert_eq!(lines.len(), 2);
    for (second, line) in lines.iter().enumerate() {
        let time_s = line["time_s"].as_f64().expect("a number");
        assert!((time_s - 1.0 - second as f64).abs() < 0.5, "{line}");
        // 2000 of offsets and 10 heartbeats, if this machine keeps up.
        let frames_per_s = line["frames_per_s"].as_f64().expect("a number");
        assert!((200.0..2_100.0).contains(&frames_per_s), "{line}");
        for counter in ["crc_errors", "sequence_errors", "malformed"] {
            assert_eq!(line[counter], 0, "{line}");
        }
        assert_eq!((&line["quality"], &line["quality_word"]), (&1.into(), &"live".into()));
        assert!(line["age_ms"].is_u64(), "{line}");
    }
    // 100.5 codes of 0.122 µm.
    let z = lines[1]["offset_um"][2].as_f64().expect("available");
    assert!((z - 12.27).abs() < 0.01, "{z}");
    assert_eq!(lines[1]["offset_um"][0], 0.0);
    assert_eq!(lines[1]["flags"], serde_json::json!([]));

    let heard = heard.lock().expect("nobody panics with it");
    assert_eq!(heard.frames, 0, "a monitor must not take part");
    assert_eq!(heard.bytes, b"\rC\rS8\rO\rC\r", "it opens, listens and closes");
}

#[test]
fn the_monitor_prints_one_line_of_text_a_second() {
    let (port, _) = bridge(Fault::None);
    let (code, out, _) = monitor(&port, "1", &[]);
    assert_eq!((code, out.lines().count()), (Some(0), 1), "{out}");
    for phrase in ["x +0.00  y +0.00  z +", " µm  live", "  age ", " frames/s", "crc 0, sequence 0"]
    {
        assert!(out.contains(phrase), "{phrase}: {out}");
    }
}

#[test]
fn damaged_frames_are_counted_and_end_with_3() {
    let (port, _) = bridge(Fault::Noise);
    let (code, out, _) = monitor(&port, "1", &["--json"]);
    assert_eq!(code, Some(3), "{out}");
    let line = &json_lines(&out)[0];
    assert!(line["crc_errors"].as_u64().expect("a number") >= 2, "{line}");
}

#[test]
fn a_bridge_without_offsets_is_told_after_three_lines() {
    let (port, _) = bridge(Fault::NoFrames);
    let (code, out, err) = monitor(&port, "9", &[]);
    assert_eq!((code, out.lines().count()), (Some(1), 3), "{out}");
    assert!(out.starts_with("no offsets came  0 frames/s"), "{out}");
    assert!(err.contains("error: no offsets for 3 s: not a single frame came"), "{err}");
}

#[test]
fn a_line_that_is_silent_or_breaks_is_told() {
    let (port, _) = bridge(Fault::Silent);
    let (code, out, err) = monitor(&port, "1", &[]);
    assert_eq!((code, out.as_str()), (Some(1), ""));
    assert!(err.starts_with("error: the bridge has answered 0 of 4 lines in 3 s"), "{err}");

    let (port, _) = bridge(Fault::Leaves);
    let (code, _, err) = monitor(&port, "9", &[]);
    assert_eq!(code, Some(1));
    assert!(err.contains("error: the bridge has closed the line"), "{err}");
}

#[test]
fn info_tells_version_serial_number_and_state() {
    let (port, heard) = bridge(Fault::None);
    let (code, out, err) = ended(trueup(&["bridge", "info", "--port", &port]));
    assert_eq!(code, Some(0), "{out}{err}");
    assert!(
        out.starts_with("version    V1013\nserial     N00A1\nheartbeat  operational\n"),
        "{out}"
    );
    assert!(out.contains("\noffsets    x "), "{out}");
    assert_eq!(heard.lock().expect("nobody panics with it").frames, 0);

    let (port, _) = bridge(Fault::None);
    let (code, out, _) = ended(trueup(&["--json", "bridge", "info", "--port", &port]));
    let told = &json_lines(&out)[0];
    assert_eq!((code, &told["serial"]), (Some(0), &"N00A1".into()));
    assert_eq!(told["heartbeat"], "operational");
}

#[test]
fn info_of_a_bridge_that_only_answers_ends_with_3() {
    let (port, _) = bridge(Fault::NoFrames);
    let (code, out, _) = ended(trueup(&["bridge", "info", "--port", &port]));
    assert_eq!(code, Some(3), "{out}");
    assert!(out.contains("heartbeat  none in 2 s\n"), "{out}");
}

#[test]
fn a_port_that_is_wrong_ends_with_2_and_one_without_a_bridge_with_1() {
    for (port, phrase) in [
        ("can0", "--port can0: SocketCAN is not supported by this version"),
        ("tcp:nowhere", "--port \"tcp:nowhere\": after tcp: comes HOST:PORT"),
        ("nowhere", "--port \"nowhere\": a port is tcp:HOST:PORT or a serial device"),
    ] {
        let (code, out, err) = monitor(port, "1", &[]);
        assert_eq!((code, out.as_str()), (Some(2), ""), "{err}");
        assert!(err.starts_with(phrase), "{err}");
    }
    // Bound and given up again: nobody listens there.
    let free = TcpListener::bind("127.0.0.1:0").and_then(|it| it.local_addr()).expect("a port");
    for (port, phrase) in [
        (format!("tcp:{free}"), "error: no connection to tcp:127.0.0.1:"),
        ("/dev/no-such-device".into(), "error: the serial device /dev/no-such-device cannot"),
    ] {
        let (code, _, err) = monitor(&port, "1", &[]);
        assert_eq!(code, Some(1), "{err}");
        assert!(err.starts_with(phrase), "{err}");
    }
}

/// The bridge's end of a pseudo terminal, which fails while the tool has not opened the other.
#[cfg(unix)]
struct Terminal(serialport::TTYPort);

#[cfg(unix)]
impl Read for Terminal {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        self.0.read(buffer).map_err(|_| ErrorKind::WouldBlock.into())
    }
}

#[cfg(unix)]
impl Write for Terminal {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.0.write(bytes)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

/// A pseudo terminal is a serial device, but for its speed.
#[cfg(unix)]
#[test]
fn a_serial_device_is_monitored_like_a_port() {
    use serialport::{SerialPort as _, TTYPort};
    let (mut ours, mut theirs) = TTYPort::pair().expect("this machine has pseudo terminals");
    ours.set_timeout(Duration::from_millis(1)).expect("a plain terminal");
    theirs.set_exclusive(false).expect("a plain terminal");
    let device = theirs.name().expect("a pseudo terminal has a name");
    // The tool wants the device for itself.
    drop(theirs);
    let heard = Arc::new(Mutex::new(Heard::default()));
    let told = heard.clone();
    thread::spawn(move || live(Terminal(ours), Fault::None, &told));
    let (code, out, err) = monitor(&device, "1", &["--json"]);
    assert_eq!(code, Some(0), "{out}{err}");
    assert_eq!(json_lines(&out)[0]["quality_word"], "live");
    assert_eq!(heard.lock().expect("nobody panics with it").frames, 0);
}
