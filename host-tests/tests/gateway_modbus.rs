//! `trueup gateway modbus` between the real firmware and masters that this project did not write:
//! pymodbus and Debian's mbpoll.

mod support;

use std::{
    path::Path,
    process::{Command, Stdio},
    thread,
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result, ensure};
use serde_json::{Value, json};
use support::{BridgeProcess, FAST_MACHINE, GROWN_RUN, GROWN_UM, Running, trueup};
use trueup_emulator::setup;

/// Noise after the filter, the rounding of a code and of the wire.
const TOLERANCE_UM: f64 = 0.3;

/// A bridge that has grown, and a gateway before it.
struct World {
    _bridge: BridgeProcess,
    gateway: Running,
    port: String,
}

impl World {
    fn start() -> Result<Self> {
        Self::before(BridgeProcess::start_grown()?)
    }

    fn before(bridge: BridgeProcess) -> Result<Self> {
        let mut command = trueup()?;
        command.args(["gateway", "modbus", "--listen", "127.0.0.1:0", "--port"]);
        command.arg(format!("tcp:{}", bridge.address()));
        let mut gateway = Running::start(&mut command)?;
        let address = gateway.wait_for("reach the bridge at tcp:", ",")?;
        let (_, port) = address.rsplit_once(':').context("an address has a port")?;
        Ok(Self { _bridge: bridge, gateway, port: port.into() })
    }

    /// Runs a master of pymodbus against it, and returns what that saw.
    fn master(&self, script: &str) -> Result<Value> {
        let output = Command::new(setup::ensure_python()?)
            .arg(setup::project_root().join("host-tests/python").join(script))
            .args(["127.0.0.1", &self.port])
            .stdin(Stdio::null())
            .output()?;
        let errors = String::from_utf8_lossy(&output.stderr);
        ensure!(output.status.success(), "{errors}\nthe gateway: {}", self.gateway.log());
        Ok(serde_json::from_slice(&output.stdout)?)
    }
}

#[test]
fn pymodbus_engages_it_reads_it_and_gets_the_exception_that_the_standard_names() -> Result<()> {
    let world = World::start()?;
    let saw = world.master("modbus_master.py")?;
    println!("{saw:#}");

    assert_eq!(saw["wrong"], json!([]), "every block is whole");
    assert_eq!(saw["released"]["offset_um"], json!([null, null, null]), "nobody has engaged it");
    assert_eq!((&saw["released"]["quality"], &saw["released"]["state"]), (&json!(6), &json!(1)));
    let is_grown = |report: &Value| {
        let z = report["offset_um"][2].as_f64().unwrap_or(f64::NAN);
        (z - GROWN_UM).abs() < TOLERANCE_UM
            && report["offset_um"][0] == 0.0
            && report["quality"] == 1
    };
    assert!(is_grown(&saw["live"]), "the growth is undone: {}", saw["live"]);
    let elongation = saw["live"]["elongation_um"].as_f64().unwrap_or(f64::NAN);
    assert!((elongation - GROWN_UM).abs() < TOLERANCE_UM, "{elongation}");
    assert!(saw["live"]["age_ms"].as_u64().is_some_and(|age| age < 100), "{}", saw["live"]);
    assert_eq!(
        saw["exceptions"],
        json!({
            "coils": 1, "discrete inputs": 1, "one register": 1, "read and write": 1,
            "behind the end": 2, "a part": 2, "elsewhere": 2, "another unit": 11,
        })
    );
    assert_eq!(saw["refused by faults"], 0);
    assert_eq!(saw["acknowledged"], json!([null, null, null]), "and not used:");
    assert!(is_grown(&saw["after faults"]), "nothing moved: {}", saw["after faults"]);
    // The faults are three; a block that comes after a silence, and one on its heels, may be old.
    assert_eq!(saw["after faults"]["last_refused"], 4);
    let refused = saw["after faults"]["refused"].as_u64().unwrap_or(0);
    assert!((3..=5).contains(&refused), "{refused}");
    assert!(is_grown(&saw["after broadcast"]), "{}", saw["after broadcast"]);
    assert_eq!(saw["second master"], 6);
    assert_eq!(saw["second master is told"], 1);
    // Live until the link timeout, held, taken back, off.
    assert_eq!(saw["silent"], json!([1, 4, 5, 0]));
    assert_eq!(saw["ramp turns back"], false);
    assert_eq!(saw["silent at the end"], json!([0, 0.0]));
    Ok(())
}

/// Z by tool, X by a condition; the spindle turns at 24 000 r/min.
const BY_TOOL: &str = "\
[inputs.coolant_on]
kind = \"condition\"
bit = 9

[spindle.tools]
7 = { um_per_krpm2 = 0.02 }
12 = { um_per_krpm2 = -0.01 }
default = { um_per_krpm2 = 0.005 }

[[term]]
cause = \"dependence\"
quantity = \"dx\"
column = \"coolant_on\"
form = \"level\"
levels = [0.0, 1.0]
level_um = [0.0, 3.0]
";

#[test]
fn pymodbus_says_the_tool_and_a_condition_and_the_offset_follows_them() -> Result<()> {
    let folder = tempfile::tempdir()?;
    let machine = support::file(&folder, "m.toml", &format!("{FAST_MACHINE}\n{BY_TOOL}"))?;
    let run = support::file(&folder, "run.csv", GROWN_RUN)?;
    let bridge = BridgeProcess::start(&["--machine", &machine, "--run", &run, "--speed", "1"])?;
    let world = World::before(bridge)?;
    let saw = world.master("modbus_tool.py")?;
    println!("{saw:#}");
    let is_at = |report: &Value, [x_um, by_tool_um]: [f64; 2]| {
        let at = |axis: usize| report["offset_um"][axis].as_f64().unwrap_or(f64::NAN);
        (at(0) - x_um).abs() < TOLERANCE_UM
            && (at(2) - GROWN_UM - by_tool_um).abs() < TOLERANCE_UM
            && (&report["quality"], &report["state"]) == (&json!(1), &json!(0))
    };
    for (name, offset_um) in [
        ("tool 7", [0.0, 0.02 * 576.0]),
        ("tool 12", [0.0, -0.01 * 576.0]),
        ("another tool", [0.0, 0.005 * 576.0]),
        ("no tool, coolant", [-3.0, 0.005 * 576.0]),
        ("after", [-3.0, 0.005 * 576.0]),
    ] {
        assert!(is_at(&saw[name], offset_um), "{name}: {}", saw[name]);
    }
    assert_eq!(saw["read back"], json!([0, 512]));
    assert_eq!((&saw["damaged"], &saw["after"]["last_refused"]), (&Value::Null, &json!(2)));
    assert_eq!((&saw["19 registers"], &saw["wrong"]), (&json!(2), &json!([])));
    Ok(())
}

#[test]
fn mbpoll_reads_the_offsets_as_the_page_says() -> Result<()> {
    let mbpoll = setup::ensure_mbpoll()?;
    let world = World::start()?;
    let end = Instant::now() + Duration::from_secs(20);
    loop {
        let output = Command::new(&mbpoll)
            .args(["-m", "tcp", "-p", &world.port, "-t", "3:int", "-B", "-0", "-r", "2"])
            .args(["-c", "3", "-1", "127.0.0.1"])
            .output()?;
        let stdout = String::from_utf8_lossy(&output.stdout).into_owned();
        // Nobody has engaged it: not available.
        if stdout.contains("[6]:") && stdout.matches("-2147483648").count() == 3 {
            return Ok(());
        }
        ensure!(Instant::now() < end, "{stdout}{}", String::from_utf8_lossy(&output.stderr));
        thread::sleep(Duration::from_millis(200));
    }
}

#[test]
fn pymodbus_and_mbpoll_read_it_over_a_serial_line() -> Result<()> {
    let output = Command::new(setup::ensure_python()?)
        .arg(setup::project_root().join("host-tests/python/rtu_masters.py"))
        .arg(trueup()?.get_program())
        .arg(setup::ensure_mbpoll()?)
        .output()?;
    ensure!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let saw: Value = serde_json::from_slice(&output.stdout)?;
    // The layout, "not available" on three axes, quality 6: there is no bridge.
    assert_eq!(
        (&saw["block"][0], &saw["block"][2], &saw["block"][8]),
        (&json!(1), &json!(0x8000), &json!(6))
    );
    assert_eq!(saw["exception"], 1);
    let text = saw["mbpoll"].as_str().context("what it prints")?;
    assert_eq!(text.matches("-2147483648").count(), 3, "{text}");
    Ok(())
}

#[test]
#[ignore = "long: the real LinuxCNC"]
fn mb2hal_reads_the_block_with_the_sample_that_is_delivered() -> Result<()> {
    let Some(_linuxcnc) = setup::install_and_lock_linuxcnc()? else {
        println!("skipped: this distribution has no package of LinuxCNC");
        return Ok(());
    };
    let world = World::start()?;
    let folder = tempfile::tempdir()?;
    let sample =
        std::fs::read_to_string(setup::project_root().join("integrations/modbus/mb2hal.ini"))?;
    let here = sample.replace("TCP_PORT=502", &format!("TCP_PORT={}", world.port));
    ensure!(here != sample, "the sample names a port");
    let ini = support::file(&folder, "mb2hal.ini", &here)?;
    let hal =
        format!("loadusr -Wn trueup-gateway mb2hal config={ini}\nloadusr -w sleep 2\nshow pin\n");
    let hal = support::file(&folder, "read.hal", &hal)?;
    let output = Command::new("halrun").args(["-f", &hal]).stdin(Stdio::null()).output()?;
    let stdout = String::from_utf8_lossy(&output.stdout).into_owned();
    println!("{stdout}");
    let pin = |number: u32| -> Option<&str> {
        let name = format!("trueup-gateway.input.{number:02}.int");
        let line = stdout.lines().find(|line| line.ends_with(&name))?;
        line.split_whitespace().nth(3)
    };
    // The layout, "not available" on X, quality 6: nobody has engaged it.
    assert_eq!([pin(0), pin(2), pin(3), pin(8)], ["1", "32768", "0", "6"].map(Some));
    Ok(())
}

/// Returns whether the bridge is received, as the lines on standard output report it, one value for each change.
fn read_bridge_states(lines: &Path) -> Result<Vec<bool>> {
    let text = std::fs::read_to_string(lines)?;
    // The last one may only be half written.
    let whole = text.rsplit_once('\n').map_or("", |(whole, _)| whole);
    let mut received = Vec::new();
    for line in whole.lines() {
        let json: Value = serde_json::from_str(line).with_context(|| line.to_owned())?;
        received.push(json["bridge"]["heard"].as_bool().context("it tells of the bridge")?);
    }
    received.dedup();
    Ok(received)
}

#[test]
fn a_gateway_outlives_its_bridge_reports_it_line_by_line_and_once_prints_both_ends() -> Result<()> {
    let mut bridge = BridgeProcess::start_grown()?;
    let address = bridge.address().to_owned();
    let folder = tempfile::tempdir()?;
    let lines = folder.path().join("lines");
    let mut command = trueup()?;
    command.args(["gateway", "modbus", "--listen", "127.0.0.1:0"]);
    command.args(["--port", &format!("tcp:{address}")]);
    let output = std::fs::File::create(&lines)?;
    let mut gateway = Running::start_into(&mut command, output.into())?;
    let until = |expected_value: &[bool]| -> Result<()> {
        let end = Instant::now() + Duration::from_secs(20);
        loop {
            let received = read_bridge_states(&lines)?;
            if received.ends_with(expected_value) {
                return Ok(());
            }
            ensure!(Instant::now() < end, "{received:?} for {expected_value:?}");
            thread::sleep(Duration::from_millis(50));
        }
    };
    let once = |expected: i32| -> Result<Value> {
        let mut command = trueup()?;
        command.args(["gateway", "modbus", "--listen", "127.0.0.1:0", "--once"]);
        let output = command.args(["--port", &format!("tcp:{address}")]).output()?;
        let stderr = String::from_utf8_lossy(&output.stderr);
        ensure!(output.status.code() == Some(expected), "{:?} {stderr}", output.status);
        Ok(serde_json::from_slice(&output.stdout)?)
    };
    until(&[true])?;
    bridge.command.signal("TERM")?;
    bridge.command.end()?;
    until(&[true, false])?;
    let alone = once(3)?;
    assert_eq!(
        (&alone["bridge"]["line"], &alone["bridge"]["heard"]),
        (&json!("down"), &json!(false))
    );
    let _bridge = BridgeProcess::start_grown_at_address(&address)?;
    until(&[true, false, true])?;
    gateway.signal("TERM")?;
    assert!(gateway.end()?.status.success());
    // The bridge has one client at a time.
    let both = once(0)?;
    assert_eq!(both["bridge"]["heard"], true);
    Ok(())
}

#[test]
fn without_an_address_only_this_computer_reaches_it() -> Result<()> {
    let mut command = trueup()?;
    let output =
        command.args(["gateway", "modbus", "--once", "--port", "tcp:127.0.0.1:1"]).output()?;
    let stderr = String::from_utf8_lossy(&output.stderr);
    // A user who may not open a port below 1024, or finds it in use, gets its number.
    let is_reported =
        stderr.contains("tcp:127.0.0.1:502,") || stderr.contains("listen at [127.0.0.1:502]");
    ensure!(is_reported && !stderr.contains("every computer"), "{stderr}");
    Ok(())
}

#[test]
fn systemd_takes_the_service_and_its_commands_are_this_tools() -> Result<()> {
    let text = std::fs::read_to_string(
        setup::project_root().join("integrations/modbus/trueup-gateway.service"),
    )?;
    let program = trueup()?.get_program().to_owned();
    let commands: Vec<&str> =
        text.lines().filter_map(|line| Some(line.split_once("ExecStart=")?.1)).collect();
    // The one that runs, and the one for an S7 in a comment.
    ensure!(commands.len() == 2, "{commands:?}");
    for command in commands {
        let words = command.split(' ').skip(1).map(|word| match word {
            "/dev/trueup" => "tcp:127.0.0.1:1",
            "192.168.214.10:502" => "127.0.0.1:0",
            "192.168.214.1" => "127.0.0.1:1",
            word => word,
        });
        let output = Command::new(&program).args(words).arg("--once").output()?;
        let stderr = String::from_utf8_lossy(&output.stderr);
        // Nobody is there; 2 would be a command that it does not know.
        ensure!(matches!(output.status.code(), Some(1 | 3)), "{command}: {stderr}");
    }
    let Some(systemd) = trueup_emulator::process::find_on_path("systemd-analyze") else {
        println!("skipped: this computer has no systemd-analyze");
        return Ok(());
    };
    let folder = tempfile::tempdir()?;
    // The program need not be installed here.
    let here = text.replace("/usr/local/bin/trueup", &program.to_string_lossy());
    let unit = support::file(&folder, "trueup-gateway.service", &here)?;
    let output = Command::new(systemd).args(["verify", &unit]).output()?;
    // A key that it does not know is a warning alone, and ends with 0.
    let stderr = String::from_utf8_lossy(&output.stderr);
    let ours: Vec<&str> = stderr.lines().filter(|line| line.contains("trueup-gateway")).collect();
    ensure!(output.status.success() && ours.is_empty(), "{stderr}");
    Ok(())
}
