//! `bridge monitor`, `info` and `load` against a bridge that runs in this process.

use std::{
    net::TcpListener,
    sync::{Arc, Mutex},
    thread,
    time::Duration,
};

use crate::desk::Desk;
use crate::pretended::{
    PAPER, PretendedFault, Tty, bridge, bridge_many, bridge_with, live, paper, paper_machine,
};
use crate::wire::ReceivedBytes;
use trueup_machine::{RunFile, compile};
use trueup_store::calibration::calibration_crc;

/// Returns a run that needs no files, and must end with `code`.
fn run_expecting(line: &str, code: i32) -> (String, String) {
    Desk::new(&[]).run_expecting(line, code)
}

fn monitor(port: &str, count_and_more: &str, code: i32) -> (String, String) {
    run_expecting(&format!("bridge monitor --port {port} --count {count_and_more}"), code)
}

fn json_lines(text: &str) -> Vec<serde_json::Value> {
    text.lines().map(|line| serde_json::from_str(line).expect("a JSON object a line")).collect()
}

#[test]
fn the_monitor_reports_the_offsets_once_a_second_and_sends_no_frame() {
    let (port, received) = bridge(PretendedFault::None);
    let (out, _) = monitor(&port, "2 --json", 0);
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
    assert!((z - 12.32).abs() < 0.01, "{z}");
    assert_eq!(lines[1]["offset_um"][0], 0.0);
    assert_eq!(lines[1]["flags"], serde_json::json!([]));

    let received = received.lock().expect("no holder panics");
    assert_eq!(received.frames, 0, "a monitor must not take part");
    assert_eq!(received.bytes, b"\rC\rS8\rZ0\rO\rC\r", "it opens, listens and closes");
}

#[test]
fn the_monitor_prints_one_line_of_text_a_second() {
    let (port, _) = bridge(PretendedFault::None);
    let (out, _) = monitor(&port, "1", 0);
    assert_eq!(out.lines().count(), 1, "{out}");
    for phrase in ["x +0.00  y +0.00  z +", " µm  live", "  age ", " frames/s", "crc 0, sequence 0"]
    {
        assert!(out.contains(phrase), "{phrase}: {out}");
    }
}

#[test]
fn damaged_frames_are_counted_and_end_with_3() {
    let (port, _) = bridge(PretendedFault::Noise);
    let (out, _) = monitor(&port, "1 --json", 3);
    let line = &json_lines(&out)[0];
    assert!(line["crc_errors"].as_u64().expect("a number") >= 2, "{line}");
}

#[test]
fn a_bridge_without_offsets_is_reported_after_three_lines() {
    let (port, _) = bridge(PretendedFault::NoFrames);
    let (out, err) = monitor(&port, "9", 1);
    assert_eq!(out.lines().count(), 3, "{out}");
    assert!(out.starts_with("no offsets came  0 frames/s"), "{out}");
    assert!(err.contains("error: no offsets for 3 s: no frame came"), "{err}");
}

#[test]
fn a_line_that_is_silent_or_breaks_is_reported() {
    let (port, _) = bridge(PretendedFault::Silent);
    let (out, err) = monitor(&port, "1", 1);
    assert_eq!(out, "");
    assert!(err.starts_with("error: the bridge has answered 0 of 5 lines in 3 s"), "{err}");

    let (port, _) = bridge(PretendedFault::Leaves);
    let (_, err) = monitor(&port, "9", 1);
    assert!(err.contains("error: the bridge has closed the line"), "{err}");
}

#[test]
fn info_reports_version_serial_number_and_state() {
    let (port, received) = bridge(PretendedFault::None);
    let (out, _) = run_expecting(&format!("bridge info --port {port}"), 0);
    assert!(
        out.starts_with(
            "version      V1013\nserial       N00A1\nheartbeat    alive (CANopen: operational)\n"
        ),
        "{out}"
    );
    let crc = format!("{:08x}", calibration_crc(paper().blob()));
    for line in [
        "\noffsets      x ",
        "\ndevice       trueup bridge 0.",
        &format!("\ncalibration  CRC {crc}\n"),
        "\nmachine      paper\n",
        "\nreference    the calibration's own zero\n",
        "\nfaults       none\n",
    ] {
        assert!(out.contains(line), "{line}: {out}");
    }
    assert!(received.lock().expect("no holder panics").frames > 8, "it has asked");

    let (port, _) = bridge(PretendedFault::None);
    let (out, _) = run_expecting(&format!("--json bridge info --port {port}"), 0);
    let document = &json_lines(&out)[0];
    assert_eq!(document["serial"], "N00A1");
    assert_eq!(document["heartbeat"], "operational");
    assert_eq!(
        (&document["calibration_crc"], &document["faults"]),
        (&crc.into(), &serde_json::json!([]))
    );
    assert_eq!(document["new_calibration_crc"], serde_json::Value::Null);
}

#[test]
fn a_request_that_is_lost_on_the_line_is_asked_for_again() {
    // A start, and a segment of the calibration.
    for lost in [1, 20] {
        let desk = Desk::new(&[]);
        let (port, received) = bridge_with(PretendedFault::Loses(lost), false);
        desk.run_expecting(&format!("bridge save saved.json --port {port}"), 0);
        assert!(received.lock().expect("no holder panics").frames > lost);
        let saved: serde_json::Value =
            serde_json::from_str(&desk.text("saved.json")).expect("JSON");
        let bytes = paper().blob().iter().map(|byte| format!("{byte:02x}")).collect::<String>();
        assert_eq!(saved["calibration"], bytes.as_str());
    }
}

#[test]
fn info_of_a_bridge_that_only_answers_ends_with_3() {
    let (port, _) = bridge(PretendedFault::NoFrames);
    let (out, _) = run_expecting(&format!("bridge info --port {port}"), 3);
    assert!(out.contains("heartbeat    none in 2 s\n"), "{out}");
}

#[test]
fn a_port_that_is_wrong_ends_with_2_and_one_without_a_bridge_with_1() {
    for (port, phrase) in [
        ("tcp:nowhere", "--port \"tcp:nowhere\": after tcp: comes HOST:PORT"),
        ("nowhere", "--port \"nowhere\": a port is tcp:HOST:PORT, a serial device"),
    ] {
        let (out, err) = monitor(port, "1", 2);
        assert_eq!(out, "", "{err}");
        assert!(err.starts_with(phrase), "{err}");
    }
    // Bound and given up again: nobody listens there.
    let free = TcpListener::bind("127.0.0.1:0")
        .and_then(|listener| listener.local_addr())
        .expect("a port");
    for (port, phrase) in [
        (format!("tcp:{free}"), "error: no connection to tcp:127.0.0.1:"),
        ("/dev/no-such-device".into(), "error: the serial device /dev/no-such-device cannot"),
    ] {
        let (_, err) = monitor(&port, "1", 1);
        assert!(err.starts_with(phrase), "{err}");
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
    let received = Arc::new(Mutex::new(ReceivedBytes::default()));
    let shared = received.clone();
    thread::spawn(move || live(Tty(ours), PretendedFault::None, || true, &shared));
    let (out, _) = monitor(&device, "1 --json", 0);
    assert_eq!(json_lines(&out)[0]["quality_word"], "live");
    assert_eq!(received.lock().expect("no holder panics").frames, 0);
}

/// Returns a folder with another calibration, `cal.bin`, and its CRC.
fn other() -> (Desk, u32) {
    let mut machine = paper_machine();
    machine.limits.slew_um_per_s *= 2.0;
    let compiled = compile(&machine).expect("it fits");
    let desk = Desk::new(&[]);
    // Bytes after the blob are not part of it.
    desk.write("cal.bin", [compiled.blob(), b"more"].concat());
    (desk, calibration_crc(compiled.blob()))
}

#[test]
fn a_calibration_is_loaded_read_back_and_put_to_use() {
    let (desk, crc) = other();
    let (port, _) = bridge_with(PretendedFault::None, false);
    let (out, _) =
        desk.run_expecting(&format!("bridge load cal.bin --yes --port {port} --json"), 0);
    let json = &json_lines(&out)[0];
    let crc = format!("{crc:08x}");
    assert_eq!((&json["crc"], &json["running_crc"]), (&crc.clone().into(), &crc.clone().into()));
    assert_eq!((&json["read_back_is_equal"], &json["restarted"]), (&true.into(), &true.into()));

    let (port, _) = bridge_many(PretendedFault::None, false);
    let (out, _) =
        desk.run_expecting(&format!("bridge load cal.bin --yes --port {port} --keep-running"), 0);
    let running = format!("{:08x}", calibration_crc(paper().blob()));
    assert!(out.contains(&format!("stored and read back the same, CRC {crc}\n")), "{out}");
    assert!(out.ends_with(&format!("now the bridge runs on {running}\n")), "{out}");
    // Who has loaded it is reported, and so is what waits when another one is loaded.
    let (out, _) = desk.run_expecting(&format!("bridge info --port {port}"), 0);
    assert!(out.contains(&format!("\nwritten      #7 loaded calibration {crc}, 20")), "{out}");
    assert!(out.ends_with(" s after a start, by serial\n"), "{out}");
    let mut third = paper_machine();
    third.limits.slew_um_per_s *= 3.0;
    desk.write("third.bin", compile(&third).expect("it fits").blob());
    let (_, err) =
        desk.run_expecting(&format!("bridge load third.bin --yes --port {port} --keep-running"), 0);
    assert!(
        err.contains(&format!("the calibration {crc} was loaded before and never used")),
        "{err}"
    );
}

#[test]
fn the_calibration_that_a_load_has_replaced_is_loaded_again() {
    let (desk, crc) = other();
    let (port, _) = bridge_many(PretendedFault::None, false);
    let before = calibration_crc(paper().blob());
    let running = |out: &str| json_lines(out)[0]["running_crc"].clone();
    // Nothing was loaded from here yet.
    let (_, err) = desk.run_expecting(&format!("bridge load --previous --yes --port {port}"), 2);
    assert!(err.contains(&format!("no calibration that {before:08x} has replaced")), "{err}");
    desk.run_expecting(&format!("bridge load cal.bin --yes --port {port}"), 0);
    // Back, and forth again.
    for crc in [before, crc] {
        let (out, _) =
            desk.run_expecting(&format!("bridge load --previous --yes --json --port {port}"), 0);
        assert_eq!(running(&out), format!("{crc:08x}"));
    }
    let (_, err) =
        desk.run_expecting(&format!("bridge load cal.bin --previous --yes --port {port}"), 2);
    assert!(err.contains("cannot be used with"), "{err}");
}

#[test]
fn offsets_are_taken_back_where_no_cnc_commands_and_only_there() {
    // A CNC that is engaged, on its own line.
    let (port, received) = bridge_many(PretendedFault::None, true);
    monitor(&port, "1", 0);
    let before = received.lock().expect("no holder panics").bytes.len();
    let (out, err) = run_expecting(&format!("bridge disengage --port {port}"), 3);
    assert_eq!(out, "");
    assert!(err.contains("a CNC commands this bridge and follows its offset, x +0.00"), "{err}");
    let sent = received.lock().expect("no holder panics").bytes[before..].to_vec();
    let control = sent.windows(4).any(|bytes| bytes == b"t302");
    assert!(!control, "it must not speak as a CNC: {}", sent.escape_ascii());

    // It has gone: its offset would be held for 2 s. It goes back at 20 µm/s, and never faster.
    let (port, _) = bridge_many(PretendedFault::CncLeaves, true);
    monitor(&port, "1", 0);
    let (out, err) = run_expecting(&format!("bridge disengage --port {port}"), 0);
    assert!(out.starts_with("disengaged: the offset went from x +0.00, y +0.00, z +12.3"), "{out}");
    assert!(err.contains("goes to 0 at the slew limit"), "{err}");
    let (out, _) = run_expecting(&format!("bridge disengage --json --port {port}"), 0);
    assert_eq!(
        json_lines(&out)[0],
        serde_json::json!({"done": "nothing", "offset_um": [0.0, 0.0, 0.0]})
    );
}

#[test]
fn what_must_not_or_cannot_be_loaded_is_reported_and_nothing_changes() {
    let (desk, _) = other();
    for (fault, engage, phrases) in [
        // Which of them depends on when the bridge has gone live.
        (
            PretendedFault::None,
            true,
            &["offsets are being followed", "with Engage off, and try again"][..],
        ),
        (
            PretendedFault::Forgetful,
            false,
            &["error: what the bridge has stored is not what was sent"],
        ),
        (
            PretendedFault::Full,
            false,
            &["error: the calibration is not loaded: object 2100:2: the board cannot store it \
               (abort code 08000020)"],
        ),
        (PretendedFault::NoFrames, false, &["error: object 2001:1: no answer in 5 s"]),
    ] {
        let (port, _) = bridge_with(fault, engage);
        let (out, err) = desk.run_expecting(&format!("bridge load cal.bin --yes --port {port}"), 1);
        assert_eq!(out, "", "{err}");
        assert!(phrases.iter().any(|phrase| err.contains(phrase)), "{err}");
    }
    // What is not a calibration never reaches the bridge.
    desk.write("garbage.bin", [7; 700]);
    let mut bytes = paper().blob().to_vec();
    bytes[100] ^= 1;
    desk.write("damaged.bin", bytes);
    let (port, received) = bridge_with(PretendedFault::None, false);
    for (file, phrase) in [
        ("garbage.bin", "garbage.bin: "),
        ("damaged.bin", "damaged.bin: "),
        ("none.bin", "none.bin: cannot be read: "),
    ] {
        let (out, err) = desk.run_expecting(&format!("bridge load {file} --yes --port {port}"), 2);
        assert_eq!(out, "", "{err}");
        assert!(err.contains(phrase), "{err}");
    }
    assert_eq!(received.lock().expect("no holder panics").bytes, b"");
}

#[test]
fn a_recording_is_a_log_of_every_frame_and_a_run_file() {
    let desk = Desk::new(&[("m.toml", PAPER)]);
    let record = |count_and_more: &str, code| {
        let (port, _) = bridge(PretendedFault::None);
        desk.run_expecting(&format!("bridge monitor --port {port} --count {count_and_more}"), code)
    };
    let (_, err) = record("2 --record here --machine m.toml", 0);

    let log = desk.text("here/bridge.log");
    let number = |what: &str| -> usize {
        let before = err.split(what).next().expect("a part");
        before.split_whitespace().last().and_then(|word| word.parse().ok()).expect("a number")
    };
    assert_eq!(log.lines().count(), number(" frames in "), "{err}");
    assert!(log.lines().filter(|line| line.contains(" can0 181#")).count() > 200);
    assert!(log.lines().filter(|line| line.contains(" can0 381#")).count() > 5);

    let run = RunFile::read(&desk.path("here/bridge.csv")).expect("a run file");
    assert_eq!(run.row_count(), number(" rows in "), "{err}");
    let time_s = run.column("time_s").expect("times");
    assert!(time_s.windows(2).all(|pair| (pair[1] - pair[0] - 0.1).abs() < 0.0501), "{time_s:?}");
    let last = |name: &str| *run.column(name).expect(name).last().expect("a row");
    assert!((last("offset_z_um") - 12.32).abs() < 0.02);
    // 100.5 codes of 12 bits above the zero, in the counts of the machine file: what the model of
    // this machine makes of them is what the bridge has undone.
    let sensor = paper_machine().spindle.sensor.expect("it has one");
    let um = sensor.k0_um + (last("sensor_counts") - sensor.zero_counts) * sensor.um_per_count;
    assert!((um - last("offset_z_um")).abs() < 0.02, "{um}");
    assert!(last("x_mm").is_nan(), "no CNC is heard on this line");
    assert_eq!(last("calibration_crc"), f64::from(calibration_crc(paper().blob())));

    // A recording is not written over.
    let (_, err) = record("1 --record here", 2);
    assert!(err.contains("bridge.log: the recording cannot be created: "), "{err}");

    // Another machine file than the bridge's: reported, and with --strict refused before anything is written.
    let mut other = paper_machine();
    other.limits.slew_um_per_s *= 2.0;
    desk.write("other.toml", other.to_toml());
    let (_, err) = record("1 --record reported --machine other.toml", 0);
    assert!(err.contains("what is recorded is not of this file"), "{err}");
    let (_, err) = record("1 --record strict --machine other.toml --strict", 2);
    assert!(err.contains("what is recorded is not of this file"), "{err}");
    assert!(!desk.path("strict").exists());
    record("1 --record same --machine m.toml --strict", 0);

    // Without a machine file the channels have no names, and the elongation stands for the counts.
    record("1 --record bus.log", 0);
    let run = RunFile::read(&desk.path("bus.csv")).expect("a run file");
    assert!(run.column("temp_channel7_c").is_some() && run.column("elongation_um").is_some());
}

#[test]
fn a_recording_goes_on_when_the_line_comes_back() {
    let desk = Desk::new(&[]);
    // It closes the line 1.3 s after it was opened, each time.
    let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
    let port = format!("tcp:{}", listener.local_addr().expect("bound above"));
    thread::spawn(move || {
        for stream in listener.incoming().flatten().take(2) {
            stream.set_nonblocking(true).expect("a plain socket");
            stream.set_nodelay(true).expect("a plain socket");
            live(stream, PretendedFault::Leaves, || true, &Arc::default());
        }
    });
    let line = format!("bridge monitor --port {port} --count 4 --record run.csv");
    let (_, err) = desk.run_expecting(&line, 3);
    for phrase in ["the recording goes on with a gap", "the line is open again", " rows in run.csv"]
    {
        assert!(err.contains(phrase), "{phrase}: {err}");
    }
    let run = RunFile::read(&desk.path("run.csv")).expect("a run file");
    let time_s = run.column("time_s").expect("times");
    // Twice a second of rows, and the time of the gap between them.
    assert!(run.row_count() > 12, "{} rows", run.row_count());
    assert!(time_s.windows(2).all(|pair| pair[1] > pair[0]), "{time_s:?}");
    let gap_s = time_s.windows(2).map(|pair| pair[1] - pair[0]).fold(0.0, f64::max);
    assert!((0.15..3.0).contains(&gap_s), "{gap_s} s");
}

#[cfg(not(all(feature = "socketcan", target_os = "linux")))]
#[test]
fn a_can_interface_needs_the_feature_and_says_how() {
    let (_, err) = monitor("can0", "1", 2);
    assert!(err.contains("--port can0: this tool was built without SocketCAN"), "{err}");
    assert!(err.contains("without --no-default-features"), "{err}");
}

#[cfg(all(feature = "socketcan", target_os = "linux"))]
#[test]
fn a_can_interface_that_is_not_there_is_named() {
    let (_, err) = monitor("can97", "1", 1);
    assert!(err.contains("error: the CAN interface can97 cannot be opened; is it up"), "{err}");
}
