//! `trueup bridge` against the running virtual bridge: a calibration loaded into the real firmware, and
//! a recording that other people's tools read.
#![allow(clippy::print_stdout, reason = "a test prints its figures")]

#[allow(dead_code, reason = "its `main` is that of the example's own process")]
#[path = "../../crates/tool/client/examples/listen.rs"]
mod listen;
mod support;

use std::{fs, path::Path, process::Command, time::Duration};

use anyhow::{Context as _, Result, ensure};
use serde_json::{Value, json};
use support::{BridgeProcess, FAST_MACHINE, GROWN_UM, file, trueup};
use tempfile::TempDir;
use trueup_core::cnc::{CncMessage as CncCommand, Control, OffsetQuality, Output};
use trueup_emulator::{cnc_client::CncClient, setup};
use trueup_link::{frames, slcan::AdapterMessage};
use trueup_machine::{MachineFile, RunFile, compile};
use trueup_store::calibration::calibration_crc;

/// Returns what the tool prints as JSON, one value or more, and its exit code.
fn json_of(arguments: &[&str]) -> Result<(Option<i32>, Vec<Value>, String)> {
    let output = trueup()?.arg("--json").args(arguments).output()?;
    let text = String::from_utf8(output.stdout)?;
    let values = serde_json::Deserializer::from_str(&text).into_iter();
    let values = values.collect::<Result<_, _>>().context(text.clone())?;
    Ok((output.status.code(), values, String::from_utf8(output.stderr)?))
}

/// Returns the fast machine, with growth times `gain`, as a calibration in a file.
fn calibration(folder: &TempDir, name: &str, gain: f64) -> Result<(String, String)> {
    let machine = file(folder, "machine.toml", FAST_MACHINE)?;
    let mut machine = MachineFile::read(machine.as_ref())?;
    machine.spindle.sensor.as_mut().context("it has one")?.um_per_count *= gain;
    let compiled = compile(&machine)?;
    let path = folder.path().join(name);
    fs::write(&path, compiled.blob())?;
    let path = path.to_str().context("text")?.to_owned();
    Ok((path, format!("{:08x}", calibration_crc(compiled.blob()))))
}

/// Returns what a CNC that engages gets once it is live and has arrived.
fn live_z_um(bridge: &BridgeProcess) -> Result<f64> {
    let mut cnc = CncClient::open(bridge.connect()?)?;
    // The tool has loaded while this CNC was away.
    cnc.send_confirmation()?;
    let control = |engage| CncCommand::Control(Control { engage, ..Control::REFERENCED });
    let mut settled = 0;
    let next = |cnc: &mut CncClient<_>, engage| -> Result<Output> {
        cnc.send_message(control(engage))?;
        let mut output = cnc.next_output()?;
        for _ in 1..20 {
            output = cnc.next_output()?;
        }
        Ok(output)
    };
    for _ in 0..200 {
        let output = next(&mut cnc, true)?;
        settled += u32::from(output.quality == OffsetQuality::Live && output.flags.0 == 0);
        if settled > 10 {
            let z = output.offset.context("available")?[2];
            // Off again, so that it can be loaded.
            while next(&mut cnc, false)?.quality != OffsetQuality::Off {}
            return Ok(f64::from(z.0) / 1_000.0);
        }
    }
    anyhow::bail!("it never goes live")
}

#[test]
fn the_tool_loads_a_calibration_and_the_board_runs_on_it_after_its_restart() -> Result<()> {
    let folder = tempfile::tempdir()?;
    let mut bridge = BridgeProcess::start_grown()?;
    let port = format!("tcp:{}", bridge.address());
    assert!((live_z_um(&bridge)? - GROWN_UM).abs() < 0.3);

    let (old, old_crc) = calibration(&folder, "old.bin", 1.0)?;
    let (new, new_crc) = calibration(&folder, "new.bin", 0.5)?;
    let (code, document, _) = json_of(&["bridge", "info", "--port", &port])?;
    assert_eq!((code, &document[0]["calibration_crc"]), (Some(0), &json!(old_crc)));
    assert_eq!(document[0]["new_calibration_crc"], Value::Null);

    // Garbage that passes the tool's own eye is not to be had; the bridge itself is tried by
    // `canopen_master`. Here it comes from a raw client in the middle of a transfer.
    let mut raw = CncClient::open(bridge.connect()?)?;
    raw.write(b"t6018210021020f000000\rt60180aaaaaaaaaaaaaaa\rt6018ffffffffffffffff\r")?;
    raw.next_output()?;
    drop(raw);

    for (file, crc, gain) in [(&new, &new_crc, 0.5), (&old, &old_crc, 1.0)] {
        let (code, document, err) = json_of(&["bridge", "load", file, "--yes", "--port", &port])?;
        println!("{document:?}");
        assert_eq!(code, Some(0), "{err}");
        assert_eq!(document[0]["running_crc"], json!(crc));
        assert_eq!(document[0]["restarted"], json!(true));
        let z = live_z_um(&bridge)?;
        assert!((z - gain * GROWN_UM).abs() < 0.3, "{z} µm, by {gain}");
    }
    bridge.command.signal("TERM")?;
    assert!(bridge.command.end()?.status.success());
    Ok(())
}

/// Runs a program that must succeed; gives what it prints.
fn printed(command: &mut Command) -> Result<String> {
    let output = command.output()?;
    ensure!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    Ok(String::from_utf8(output.stdout)?)
}

#[test]
fn the_example_of_a_client_receives_the_offsets_of_the_board() -> Result<()> {
    let bridge = BridgeProcess::start_grown()?;
    let mut offsets = 0;
    listen::listen(&format!("tcp:{}", bridge.address()), Duration::from_secs(1), |event| {
        let AdapterMessage::Frame(frame) = event else { return };
        offsets += u32::from(frames::decode_offset_z(&frame).is_ok());
    })?;
    // A thousand a second; the computer may be late.
    assert!(offsets > 100, "{offsets} offsets of Z in a second");
    Ok(())
}

#[test]
fn can_utils_and_python_can_read_a_recording_and_diagnose_its_run_file() -> Result<()> {
    let folder = tempfile::tempdir()?;
    let machine_text = format!(
        "{FAST_MACHINE}{}",
        // A channel that has a name.
        "\n[axis.x.thermal]\nmode = \"constant\"\nsensor = \"temp_screw_c\"\n\
         reference_c = 20.0\nconstant_um_per_c = 0.0\n"
    )
    .replace("[spindle]\n", "temp_screw_c = { channel = 5, kind = \"pt100\" }\n\n[spindle]\n");
    let machine = file(&folder, "machine.toml", &machine_text)?;
    // The spindle grows by 20 µm in 12 s.
    let rows: String = (0..=120)
        .map(|n| format!("{},{},24000,{}\n", n as f64 / 10.0, 5_048.0 + 11.0 * f64::from(n), 23.5))
        .collect();
    let run = format!("time_s,sensor_counts,spindle_rpm,temp_screw_c\n{rows}");
    let run = file(&folder, "run.csv", &run)?;
    let bridge = BridgeProcess::start(&["--machine", &machine, "--run", &run])?;
    let port = format!("tcp:{}", bridge.address());
    // Engaged for a moment: before that it says "not available", and there is nothing to compare.
    let mut cnc = CncClient::open(bridge.connect()?)?;
    for engage in [true, false] {
        cnc.send_message(CncCommand::Control(Control { engage, ..Control::REFERENCED }))?;
    }
    cnc.query("C")?;
    drop(cnc);
    let place = folder.path().join("recorded");
    let record = place.to_str().context("text")?;
    let (code, json, err) = json_of(&[
        "bridge",
        "monitor",
        "--port",
        &port,
        "--count",
        "8",
        "--record",
        record,
        "--machine",
        &machine,
    ])?;
    assert_eq!(code, Some(0), "{err}");
    let last = &json.last().context("a line a second")?["board"];
    assert!((last["temps_c"][5].as_f64().context("a temperature")? - 23.5).abs() < 0.02, "{last}");
    assert_eq!(last["temps_c"][4], Value::Null);

    let log = place.join("bridge.log");
    let frames = fs::read_to_string(&log)?.lines().count();
    // log2asc writes a line a frame under a head.
    let asc = printed(Command::new(setup::ensure_log2asc()?).arg("-I").arg(&log).arg("can0"))?;
    let is_frame = |line: &&str| line.contains("  Rx  ") || line.contains(" Rx ");
    assert_eq!(asc.lines().filter(is_frame).count(), frames, "{asc:.500}");
    let count = "import can, sys\n\
                 frames = list(can.CanutilsLogReader(sys.argv[1]))\n\
                 times = [frame.timestamp for frame in frames]\n\
                 assert times == sorted(times) and all(it.channel == 'can0' for it in frames)\n\
                 cycles = [it.data[2] for it in frames if it.arbitration_id == 0x181]\n\
                 assert all((b - a) % 256 == 1 for a, b in zip(cycles, cycles[1:])), 'a gap'\n\
                 print(len(frames), sum(it.arbitration_id == 0x181 for it in frames))\n";
    let counted = printed(Command::new(setup::ensure_python()?).args(["-c", count]).arg(&log))?;
    let [all, offsets] = counted.split_whitespace().collect::<Vec<_>>()[..] else {
        anyhow::bail!("{counted}")
    };
    assert_eq!(all.parse::<usize>()?, frames);
    assert!(offsets.parse::<usize>()? > 4_000, "{offsets} in 8 s");
    println!("{frames} frames read by log2asc and by python-can, {offsets} of them OffsetXY");

    diagnosed(&folder, &place.join("bridge.csv"), &machine)
}

/// The run file with a measurement next to it, as a user with an indicator would have it: 1.25 times that of the model.
fn diagnosed(folder: &TempDir, recorded: &Path, machine: &str) -> Result<()> {
    let run = RunFile::read(recorded)?;
    let counts = run.column("sensor_counts").context("of the machine file's law")?;
    assert!(run.row_count() > 60, "{} rows in 8 s", run.row_count());
    let screw = run.column("temp_screw_c").context("by its name")?;
    assert!(screw.iter().rev().take(30).all(|c| (c - 23.5).abs() < 0.02), "{screw:?}");
    let text = fs::read_to_string(recorded)?;
    let mut lines = text.lines();
    let mut measured = format!("{},measured_elongation_um\n", lines.next().context("a header")?);
    for (number, (line, counts)) in lines.zip(counts).enumerate() {
        if counts.is_nan() {
            continue;
        }
        let um = 1.25 * (counts - 5_048.0) * 0.015_258_789_062_5;
        // An indicator's noise, which is not the sensor's.
        let noise = [0.03, -0.05, 0.01, 0.06, -0.04, -0.01, 0.02, -0.02][number % 8];
        measured += &format!("{line},{:.3}\n", um + noise);
    }
    let measured = file(folder, "measured.csv", &measured)?;
    let out = folder.path().join("diagnosis");
    let out = out.to_str().context("text")?;
    let run = ["diagnose", "--machine", machine, "--run", &measured, "--out", out];
    let (code, json, err) = json_of(&run)?;
    println!("{code:?} {json:?}");
    assert!(code == Some(0) || code == Some(3), "{err}");
    let diagnosis: Value =
        serde_json::from_slice(&fs::read(Path::new(out).join("diagnosis.json"))?)?;
    let before = diagnosis["before"]["rms_um"].as_f64().context("a number")?;
    let after = diagnosis["after"]["rms_um"].as_f64().context("a number")?;
    assert!(before > 0.5 && after < 0.2, "{before} µm before, {after} µm after");
    Ok(())
}
