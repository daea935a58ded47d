//! The flashable image on the model of its chip, and those who talk to it: the clients that talk to the virtual
//! board, over the same serial line; and the same codes, for the same offsets.

#[path = "../support/mod.rs"]
mod support;

mod blocks;
mod command;
mod live;
mod modbus;
mod modbus_faults;
mod update;

use std::{
    ffi::OsStr,
    fs,
    process::{Command, Stdio},
    thread,
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result, ensure};
use serde_json::{Value, json};
use support::{FAST_MACHINE, chip::Chip, trueup};
use trueup_canopen::EDS;
use trueup_emulator::{chip::RunningChipModel, image_check, setup};
use trueup_machine::{MachineFile, compile};
use trueup_store::calibration::calibration_crc;

/// A code of the converter is 8 counts of the paper.
const CODE: u32 = 1_145;
const GROWN_UM: f64 = (8.0 * CODE as f64 - 5_048.0) * 0.015_258_789_062_5;
/// Time in which `bridge info` has to answer, on a computer that has better to do.
const TIMEOUT: Duration = Duration::from_secs(180);
/// An hour: the test ends it before.
const LONG: [&str; 3] = ["--bor", "--ms", "3600000"];

/// Returns what `trueup bridge info` prints.
fn info(port: u16) -> Result<String> {
    let port = format!("tcp:127.0.0.1:{port}");
    let output = trueup()?.args(["bridge", "info", "--port", &port]).output()?;
    let stderr = String::from_utf8_lossy(&output.stderr);
    ensure!(output.status.success(), "{stderr}");
    Ok(String::from_utf8(output.stdout)?)
}

/// Returns the same, once it has all of these texts: a slow board answers the next time what it did not this time.
fn info_with(port: u16, texts: &[&str]) -> Result<String> {
    let end = Instant::now() + TIMEOUT;
    loop {
        let message = info(port);
        let is_complete = |message: &String| texts.iter().all(|text| message.contains(text));
        match message {
            Ok(message) if is_complete(&message) => return Ok(message),
            message if Instant::now() > end => anyhow::bail!("not all of {texts:?} in {message:?}"),
            _ => thread::sleep(Duration::from_millis(200)),
        }
    }
}

#[test]
fn bridge_info_names_what_ended_the_last_start_and_where() -> Result<()> {
    let Some(chip) = Chip::that_breaks(FAST_MACHINE)? else { return Ok(()) };
    // Built before a board waits for it.
    trueup()?;
    let key =
        image_check::find_symbol_address(&chip.image, "TRUEUP_FAULT_KEY")?.context("it breaks")?;
    // What breaks by that number (`src/faults.rs`), and the words that name it.
    let cases: [(u32, &[&str]); 3] = [
        (6, &["last reset   watchdog, in task listen\n", "watchdog 1"]),
        (32, &["last reset   panic at src/faults.rs:", ", in task supervise\n", "panic 1"]),
        (33, &["last reset   hard-fault at pc 0x080", ", CFSR 0x02000000, in task supervise\n"]),
    ];
    let ends_as = |number: u32, words: &[&str]| {
        let script = chip.folder.path().join(format!("script-{number}"));
        fs::write(&script, format!("0 flags 2\n300 poke {key:x} {number:x}\n320 say V\\r\n"))?;
        let script = script.to_str().context("a plain name")?;
        let options = [&LONG[..], &["--script", script]].concat();
        let line = RunningChipModel::start(&chip.model, &chip.image, &options)?;
        let text = info_with(line.port, &[words, &["power-on 1"]].concat());
        println!("{}", text.with_context(|| format!("fault {number}"))?);
        Ok(())
    };
    thread::scope(|scope| {
        let ends_as = &ends_as;
        let all = cases.map(|(number, words)| scope.spawn(move || ends_as(number, words)));
        all.into_iter().try_for_each(|thread| thread.join().expect("it does not panic"))
    })
}

/// Returns a client of others in Python, against the image's serial line; what it prints as JSON.
fn python(script: &str, more: &[&OsStr]) -> Result<Option<Value>> {
    let Some(chip) = Chip::of_machine(FAST_MACHINE)? else { return Ok(None) };
    let code = CODE.to_string();
    let options = [&LONG[..], &["--code", &code, "--code-after", &code, "--no-cnc"]].concat();
    // There before a board waits for them.
    let python = setup::ensure_python()?;
    trueup()?;
    let line = RunningChipModel::start(&chip.model, &chip.image, &options)?;
    // A message before the board is up is lost, as on a wire.
    info_with(line.port, &["heartbeat"])?;
    let output = Command::new(python)
        .arg(setup::project_root().join("host-tests/python").join(script))
        .arg(format!("socket://127.0.0.1:{}", line.port))
        .args(more)
        .stdin(Stdio::null())
        .output()?;
    ensure!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    Ok(Some(serde_json::from_slice(&output.stdout)?))
}

#[test]
#[ignore = "long: a CNC's session, as slow as the model is"]
fn python_can_cantools_and_autosar_e2e_engage_the_flashable_image() -> Result<()> {
    let dbc = setup::project_root().join("crates/board/link/trueup.dbc");
    let Some(saw) = python("cnc_client.py", &[dbc.as_ref(), "--board-time".as_ref()])? else {
        return Ok(());
    };
    println!("{saw:#}");
    assert_eq!(saw["wrong"], json!([]), "every frame is read, protected, in order, in pairs");
    // The boot-up message came before it listened.
    assert_eq!(saw["states"], json!([4, 5]));
    assert_eq!(saw["offset_xy"], saw["offset_z"]);
    let phases = &saw["phases"];
    for phase in ["listening", "damaged", "repeated"] {
        assert_eq!(phases[phase]["qualities"], json!([6]), "{phase}");
    }
    let live = &phases["live"];
    assert_eq!((&live["cycles"], &live["qualities"]), (&json!(1_000), &json!([1])), "{live}");
    let mean = live["mean_z_um"].as_f64().context("a number")?;
    assert!((mean - GROWN_UM).abs() < 0.1, "{mean} µm of {GROWN_UM}");
    let leaving = &phases["disengaging"];
    assert_eq!(leaving["last_z_um"], json!(0.0), "{leaving}");
    assert_eq!(leaving["ramp_turns_back"], json!(false), "{leaving}");
    for phase in ["engaging", "disengaging"] {
        // 1000 µm/s are 1 µm in a cycle, and the wire rounds to 0.01 µm.
        let step = phases[phase]["largest_step_um"].as_f64().context("a number")?;
        assert!((0.9..=1.011).contains(&step), "{phase} in steps of {step} µm");
    }
    Ok(())
}

#[test]
#[ignore = "long: every object, every abort code, as slow as the model is"]
fn pypi_canopen_reads_every_object_of_the_flashable_image_and_loads_a_calibration() -> Result<()> {
    let folder = tempfile::tempdir()?;
    let [eds, blob, machine] =
        ["trueup.eds", "new.bin", "machine.toml"].map(|name| folder.path().join(name));
    fs::write(&eds, EDS)?;
    fs::write(&machine, FAST_MACHINE.replace("0.0152587890625", "0.00762939453125"))?;
    let new = compile(&MachineFile::read(&machine)?)?;
    fs::write(&blob, new.blob())?;
    let patient = [eds.as_ref(), blob.as_ref(), "--patience".as_ref(), "120".as_ref()];
    let Some(saw) = python("canopen_master.py", &patient)? else { return Ok(()) };
    println!("{saw:#}");
    assert_eq!(saw["wrong"], json!([]), "each object has the length of its type");
    assert_eq!(saw["values"]["1008:0"], "trueup bridge");
    for it in saw["misuses"].as_array().context("misuses")? {
        assert_eq!(it["abort"], it["expected"], "{it}");
    }
    for equal in ["read_back_is_equal", "running_again_is_equal"] {
        assert_eq!(saw[equal], json!(true), "{equal}");
    }
    assert_eq!((&saw["new_crc"], &saw["gaps"]), (&json!(calibration_crc(new.blob())), &json!(0)));
    let restart = &saw["restart"];
    assert_eq!(restart["runs_on_the_new_one"], json!(true), "{restart}");
    assert_eq!(restart["running_crc"], calibration_crc(new.blob()), "{restart}");
    Ok(())
}
