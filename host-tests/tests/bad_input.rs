//! Failures at the user's: broken files, a port in use, no emulator, an emulator that dies,
//! a command that is ended in every way there is.
//!
//! Each time the command has to say what is wrong and where, to write over nothing, and to leave
//! no emulator behind. It is the real command, as a user starts it.

mod support;

use std::{
    collections::BTreeMap,
    fs,
    io::{Read as _, Write as _},
    net::{TcpListener, TcpStream},
    os::unix::fs::{PermissionsExt as _, symlink},
    path::{Path, PathBuf},
    thread::{self, JoinHandle},
    time::{Duration, Instant, SystemTime},
};

use anyhow::{Context as _, Result, ensure};
use support::{
    BridgeProcess, Ended, FAST_MACHINE, GROWN_RUN, Running, TIMEOUT, run, signal, wait_until_stuck,
    xtask,
};
use tempfile::TempDir;
use trueup_core::cnc::OffsetQuality;
use trueup_emulator::{
    analogue_front_end::AnalogueFrontEnd, board::VirtualBoard, firmware_images, process, setup,
};
use trueup_link::{
    frames::{self, NmtState},
    receiver::OffsetReceiver,
    slcan::client::OPEN_SEQUENCE,
};
use trueup_machine::{MachineFile, compile};
use trueup_pipe::Block;

/// An error is there while the user still looks.
const AT_ONCE: Duration = Duration::from_secs(5);

/// It ended with this status and an error that says all of this.
fn assert_refused(ended: &Ended, status: i32, expected_phrase: &[&str]) {
    assert_eq!(ended.status.code(), Some(status), "{ended:?}");
    let (_, error) = ended.stderr.split_once("error: ").expect("it says what is wrong");
    for phrase in expected_phrase {
        assert!(error.contains(phrase), "no {phrase:?} in {ended:?}");
    }
}

/// It left neither an emulator nor a file.
fn assert_nothing_left(command: &Running) -> Result<()> {
    assert!(command.emulators_left().is_empty(), "QEMU is left: {}", command.log());
    let left: Vec<_> = fs::read_dir(command.temporary.path())?.collect();
    assert!(left.is_empty(), "files are left: {left:?}");
    Ok(())
}

/// Returns every file in a folder, with its size and the time at which it was last written.
fn inventory(folder: &Path) -> Result<BTreeMap<PathBuf, (u64, SystemTime)>> {
    if !folder.exists() {
        return Ok(BTreeMap::new());
    }
    let files = fs::read_dir(folder)?.map(|file| {
        let file = file?;
        let about = file.metadata()?;
        Ok((file.path(), (about.len(), about.modified()?)))
    });
    files.collect()
}

fn demo_folder() -> PathBuf {
    setup::project_root().join("target/demo")
}

/// Runs `virtual` on a machine file and a run file, of which one is broken at a place.
fn assert_bad_file(machine: &[u8], run_file: &[u8], place: &str, rule: &str) -> Result<()> {
    let folder = tempfile::tempdir()?;
    let [machine_path, run_path] = ["machine.toml", "run.csv"].map(|name| folder.path().join(name));
    fs::write(&machine_path, machine)?;
    fs::write(&run_path, run_file)?;
    let before = (inventory(folder.path())?, inventory(&demo_folder())?);

    let mut command = xtask()?;
    command.args(["virtual", "--cnc", "tcp:127.0.0.1:0"]);
    command.arg("--machine").arg(&machine_path).arg("--run").arg(&run_path);
    let (command, ended) = run(&mut command)?;

    let place = format!("{}/{place}: ", folder.path().display());
    assert!(ended.stderr.starts_with(&format!("error: {place}")), "not at {place}: {ended:?}");
    assert_refused(&ended, 2, &[rule]);
    assert_eq!(ended.stderr.lines().count(), 1, "nothing else was begun: {ended:?}");
    assert!(ended.took < AT_ONCE, "{ended:?}");
    assert_eq!(before, (inventory(folder.path())?, inventory(&demo_folder())?));
    assert_eq!(fs::read(machine_path)?, machine);
    assert_eq!(fs::read(run_path)?, run_file);
    assert_nothing_left(&command)
}

#[test]
fn a_broken_machine_file_is_refused_at_its_place_and_nothing_is_written() -> Result<()> {
    let broken = [
        // Not known, of another kind, no TOML, not among the values, out of range.
        ("zero_counts =", "zero_count =", "13:1", "unknown key spindle.sensor.zero_count; did you"),
        ("5048.0", "\"many\"", "13:15", "zero_counts must be a number, not a string"),
        ("[spindle.sensor]", "[spindle.sensor", "11:16", "not valid TOML"),
        ("0.0152587890625", "0,0152587890625", "14:17", "not valid TOML"),
        ("3-axis", "4-axis", "3:8", "machine.kind must be"),
        ("1000.0", "-1.0", "17:17", "slew_um_per_s must be above 0, not -1"),
        // It describes a machine, but no board.
        ("sensor = {", "# sensor = {", "5:2", "inputs.sensor is missing"),
        // A word processor's: not UTF-8.
        ("fast", "\u{80}", "2:9", "UTF-8"),
    ];
    for (good, bad, place, rule) in broken {
        assert!(FAST_MACHINE.contains(good), "{good}");
        let machine = FAST_MACHINE.replace(good, bad).into_bytes();
        // U+0080 stands for the byte 80, which is no UTF-8 by itself.
        let machine: Vec<u8> = machine.into_iter().filter(|&byte| byte != 0xC2).collect();
        assert_bad_file(&machine, GROWN_RUN.as_bytes(), &format!("machine.toml:{place}"), rule)?;
    }
    Ok(())
}

#[test]
fn a_broken_run_file_is_refused_at_its_place_and_nothing_is_written() -> Result<()> {
    let broken: [(&[u8], _, _); 9] = [
        (b"sensor_counts,spindle_rpm\n9164,24000\n9164,fast\n", "3:6", "is not a number"),
        (b"sensor_counts;spindle_rpm\n9164,5;24000\n", "2:1", "has a decimal comma"),
        (b"spindle_rpm\n24000\n", "1:1", "column sensor_counts is missing"),
        (b"sensor_counts,spindle_rpm\n9164,24000\n9164\n", "3:5", "the row has 1 fields"),
        (b"spindle_rpm,sensor_counts\n0,9164\n0,32769\n", "3:3", "counts 32769 is outside 0"),
        (b"sensor_counts\n-1\n", "2:1", "sensor_counts -1 is outside 0"),
        (b"time_s,sensor_counts\n1,9164\n0.5,9164\n", "3:1", "time_s runs back"),
        (b"", "1:1", "is empty"),
        (b"sensor_counts\n\xFF\n", "2:1", "is not UTF-8"),
    ];
    for (run, place, rule) in broken {
        assert_bad_file(FAST_MACHINE.as_bytes(), run, &format!("run.csv:{place}"), rule)?;
    }
    Ok(())
}

#[test]
fn a_file_that_is_not_there_is_named() -> Result<()> {
    let mut command = xtask()?;
    command.args(["virtual", "--machine", "no/such.toml", "--run", "no/such.csv"]);
    let (_, ended) = run(&mut command)?;
    assert_refused(&ended, 2, &["no/such.toml:1:1: cannot be read: No such file"]);
    Ok(())
}

#[test]
fn the_command_takes_its_options_as_the_documentation_writes_them() -> Result<()> {
    for dashes in [&["--"][..], &[]] {
        let mut command = process::new_cargo_command();
        command.arg("virtual").args(dashes).args(["--run", "no/such.csv"]);
        let ended = command.current_dir(setup::project_root()).output()?;
        let stderr = String::from_utf8_lossy(&ended.stderr);
        assert_eq!(ended.status.code(), Some(2), "{stderr}");
        assert!(stderr.contains("error: no/such.csv:1:1: cannot be read"), "{stderr}");
    }
    Ok(())
}

#[test]
fn a_port_in_use_is_named_and_its_user_is_not_disturbed() -> Result<()> {
    let first = BridgeProcess::start_grown()?;
    let mut line = first.connect()?;
    let mut command = xtask()?;
    let port = format!("tcp:{}", first.address());
    let run_file = setup::project_root().join("data/spindle_paper_table1.csv");
    command.args(["virtual", "--cnc", &port, "--run"]).arg(run_file);
    let (second, ended) = run(&mut command)?;
    assert_refused(&ended, 1, &[&format!("cannot listen at {port}"), "using it?"]);
    assert!(ended.took < AT_ONCE, "{ended:?}");
    assert_nothing_left(&second)?;
    line.write_all(b"V\r")?;
    let mut answer = [0; 6];
    line.read_exact(&mut answer)?;
    assert_eq!(&answer, b"V1013\r");
    Ok(())
}

#[test]
fn a_plant_that_does_not_listen_or_talks_nonsense_is_named() -> Result<()> {
    let listener = TcpListener::bind("127.0.0.1:0")?;
    let plant = format!("tcp:{}", listener.local_addr()?);
    for (line, phrase) in [
        ("{\"t_s\": 0.1, \"sensor_v\": }\n", "line 2, column 26"),
        ("{\"t_s\": -1, \"sensor_v\": 1}\n", "line 2: t_s goes from 0 to -1"),
        ("{\"t_s\": 0.1, \"sensor_v\": 1e9}\n", "line 2: sensor_v 1000000000 is"),
        (
            "{\"t_s\": 0.1, \"sensor_v\": 1, \"spindle_rpm\": 1e9}\n",
            "line 2: spindle_rpm 1000000000",
        ),
    ] {
        let mut bridge = BridgeProcess::start(&["--plant", &plant])?;
        let (mut stream, _) = listener.accept()?;
        stream.write_all(b"{\"t_s\": 0, \"sensor_v\": 1}\n")?;
        stream.write_all(line.as_bytes())?;
        let ended = bridge.command.end()?;
        assert_refused(&ended, 1, &[&format!("plant at {plant}, {phrase}")]);
        assert_nothing_left(&bridge.command)?;
    }
    drop(listener);
    let mut command = xtask()?;
    command.args(["virtual", "--cnc", "tcp:127.0.0.1:0", "--plant", &plant]);
    let (command, ended) = run(&mut command)?;
    assert_refused(&ended, 1, &[&format!("no plant listens at {plant}")]);
    assert_nothing_left(&command)
}

/// Returns a folder with everything that is on the search path, but for these programs.
fn path_without(programs: &[&str]) -> Result<TempDir> {
    let folder = tempfile::tempdir()?;
    let path = std::env::var_os("PATH").context("there is a search path")?;
    for file in
        std::env::split_paths(&path).filter_map(|folder| fs::read_dir(folder).ok()).flatten()
    {
        let file = file?;
        let place = folder.path().join(file.file_name());
        let expected = !programs.iter().any(|program| file.file_name() == *program);
        // The first on the path wins, as it does there.
        if expected && place.symlink_metadata().is_err() {
            symlink(file.path(), place)?;
        }
    }
    Ok(folder)
}

/// Puts a program on a path.
fn put_program(path: &TempDir, name: &str, script: &str) -> Result<()> {
    let place = path.path().join(name);
    fs::write(&place, format!("#!/bin/sh\n{script}\n"))?;
    fs::set_permissions(place, fs::Permissions::from_mode(0o755))?;
    Ok(())
}

#[test]
fn a_missing_emulator_is_an_error_with_the_line_that_installs_it() -> Result<()> {
    let path = path_without(&["qemu-system-arm", "apt-get", "sudo", "id"])?;
    let requested = path.path().join("asked");
    let mut runs = Vec::new();
    let mut try_demo = || -> Result<()> {
        let before = inventory(&demo_folder())?;
        let mut command = xtask()?;
        let (command, ended) = run(command.arg("demo").env("PATH", path.path()))?;
        assert_eq!(before, inventory(&demo_folder())?, "the last good result stays");
        assert_nothing_left(&command)?;
        runs.push(ended);
        Ok(())
    };

    // Not a distribution that is known.
    try_demo()?;
    // A known one, and a user who may not install anything.
    put_program(&path, "apt-get", &format!("echo \"$@\" >>'{}'; exit 100", requested.display()))?;
    put_program(&path, "sudo", "exit 1")?;
    put_program(&path, "id", "echo 1000")?;
    try_demo()?;
    let no_package_was_installed = !requested.exists();
    // One who may, but the network is down.
    put_program(&path, "id", "echo 0")?;
    try_demo()?;
    // There, but too old.
    put_program(&path, "qemu-system-arm", "echo QEMU emulator version 6.2.0")?;
    try_demo()?;

    let [unknown, forbidden, failed, old] = &runs[..] else { panic!("four runs") };
    let by_hand = "    sudo apt-get update && sudo apt-get install -y qemu-system-arm";
    assert_refused(unknown, 1, &["QEMU, the emulator is missing", "install: qemu-system-arm"]);
    assert_refused(forbidden, 1, &["may not install it; run:\n", by_hand]);
    assert!(no_package_was_installed, "nothing is installed without permission");
    assert!(failed.stderr.contains("is missing; installing: qemu-system-arm"), "{failed:?}");
    assert_refused(failed, 1, &["could not be installed; by hand:\n", by_hand]);
    assert_refused(old, 1, &["is version 6.2; 7.2 or newer is needed"]);
    Ok(())
}

/// Starts a client that has opened the channel and reads until the line ends. Its thread returns how much it read.
fn reader(bridge: &BridgeProcess) -> Result<JoinHandle<usize>> {
    let mut stream = opened(bridge)?;
    Ok(thread::spawn(move || {
        let (mut bytes, mut sum) = ([0; 4096], 0);
        while let Ok(length @ 1..) = stream.read(&mut bytes) {
            sum += length;
        }
        sum
    }))
}

/// Opens a client's line, and waits until frames have begun to come.
fn opened(bridge: &BridgeProcess) -> Result<TcpStream> {
    let mut stream = bridge.connect()?;
    stream.write_all(OPEN_SEQUENCE)?;
    stream.read_exact(&mut [0; 1_000])?;
    Ok(stream)
}

#[test]
fn an_emulator_that_dies_ends_the_command_with_an_error() -> Result<()> {
    // Before any client, with one, and while a plant thinks.
    for client in [false, true] {
        let mut bridge = BridgeProcess::start_grown()?;
        let client = client.then(|| reader(&bridge)).transpose()?;
        signal("KILL", bridge.qemu)?;
        let ended = bridge.command.end()?;
        assert_refused(&ended, 1, &["QEMU has ended (signal: 9"]);
        assert!(ended.took < AT_ONCE, "{ended:?}");
        assert_nothing_left(&bridge.command)?;
        if let Some(client) = client {
            client.join().ok().context("the client's line ends with it")?;
        }
    }
    let listener = TcpListener::bind("127.0.0.1:0")?;
    let plant = format!("tcp:{}", listener.local_addr()?);
    let mut bridge = BridgeProcess::start(&["--plant", &plant])?;
    let (_plant, _) = listener.accept()?;
    signal("TERM", bridge.qemu)?;
    let ended = bridge.command.end()?;
    assert_refused(&ended, 1, &["QEMU has ended"]);
    assert!(ended.took < AT_ONCE, "{ended:?}");
    assert_nothing_left(&bridge.command)
}

#[test]
fn ctrl_c_and_sigterm_end_it_in_peace_and_the_emulator_with_it() -> Result<()> {
    for name in ["INT", "TERM"] {
        // Before any client.
        let mut bridge = BridgeProcess::start_grown()?;
        bridge.command.signal(name)?;
        assert_ended_in_peace(&mut bridge)?;
        // With one that reads.
        let mut bridge = BridgeProcess::start_grown()?;
        let client = reader(&bridge)?;
        bridge.command.signal(name)?;
        assert_ended_in_peace(&mut bridge)?;
        client.join().ok().context("the client's line ends with it")?;
        // With one that has stopped reading, so that everything is stuck behind it.
        let mut bridge = BridgeProcess::start_grown_at("max")?;
        let deaf = opened(&bridge)?;
        wait_until_stuck(&deaf)?;
        bridge.command.signal(name)?;
        assert_ended_in_peace(&mut bridge)?;
    }
    Ok(())
}

fn assert_ended_in_peace(bridge: &mut BridgeProcess) -> Result<()> {
    let ended = bridge.command.end()?;
    assert!(ended.status.success() && !ended.stderr.contains("error"), "{ended:?}");
    assert!(ended.took < AT_ONCE, "{ended:?}");
    assert_nothing_left(&bridge.command)
}

#[test]
fn even_sigkill_leaves_no_emulator() -> Result<()> {
    for client in [false, true] {
        let mut bridge = BridgeProcess::start_grown()?;
        let client = client.then(|| reader(&bridge)).transpose()?;
        let emulator = Path::new("/proc").join(bridge.qemu.to_string()).join("cmdline");
        assert!(fs::read(&emulator)?.starts_with(b"/"), "the process that it names is there");
        bridge.command.signal("KILL")?;
        let ended = bridge.command.end()?;
        assert_eq!(ended.status.code(), None, "{ended:?}");
        assert!(bridge.command.emulators_left().is_empty());
        // Dead and not waited for, it may still have an entry, but no command line.
        assert!(fs::read(&emulator).unwrap_or_default().is_empty());
        if let Some(client) = client {
            client.join().ok().context("the client's line ends with it")?;
        }
    }
    Ok(())
}

#[test]
fn a_broken_calibration_gives_no_offset_and_the_log_says_why() -> Result<()> {
    let machine = MachineFile::read(&setup::project_root().join("data/paper_spindle.toml"))?;
    let compiled = compile(&machine)?;
    let good = compiled.blob();
    let flipped = |at: usize| {
        let mut blob = good.to_vec();
        blob[at] ^= 0x04;
        blob
    };
    let image = firmware_images::build_virtual_board_image()?;
    let blobs = [
        // The mark, the layout's number, a limit, the sensor's slope, the checksum itself.
        (flipped(0), "Magic { found: "),
        (flipped(4), "Schema { found: 0 }"),
        (flipped(17), "Crc { stored: "),
        (flipped(61), "Crc { stored: "),
        (flipped(good.len() - 1), "Crc { stored: "),
        (good[..good.len() - 1].to_vec(), "TooShort { len: "),
        (Vec::new(), "TooShort { len: 0 }"),
        (good.to_vec(), ""),
    ];
    for (blob, why) in blobs {
        let mut board = VirtualBoard::boot(&image, &blob)?;
        let mut front_end = AnalogueFrontEnd::new(0.328, 1);
        let blocks: Vec<Block> = (0..200)
            .map(|_| Block { codes: front_end.convert_block(|_| 2.0), ..Block::default() })
            .collect();
        let (mut offsets, mut outputs, mut states) = (OffsetReceiver::new(), 0, Vec::new());
        for (_, frame) in board.step(&blocks)? {
            if frame.id() == frames::HEARTBEAT_ID {
                states.push(frames::decode_heartbeat(&frame)?);
            } else if let Some(output) = offsets.accept(&frame)? {
                outputs += 1;
                // No CNC has engaged: nothing is available either way, and the log tells why.
                assert_eq!(
                    (output.quality, output.offset),
                    (OffsetQuality::Fault, None),
                    "{output:?}"
                );
            }
        }
        assert_eq!(outputs, 200, "it says so every millisecond");
        assert_eq!(states, [NmtState::BootUp, NmtState::Stopped]);
        let log = log_of(&board)?;
        println!("{log}");
        assert!(log.contains(why), "{log}");
        assert_eq!(log.contains("ERROR calibration refused: "), !why.is_empty(), "{log}");
    }
    Ok(())
}

/// Returns the log from the start to the first line that the board writes of its own accord. It comes
/// next to the frames, so it may come later.
fn log_of(board: &VirtualBoard) -> Result<String> {
    let end = Instant::now() + TIMEOUT;
    loop {
        let log = board.log().join("\n");
        if log.contains("quality") {
            return Ok(log);
        }
        ensure!(Instant::now() < end, "the log stays at: {log}");
        thread::sleep(Duration::from_millis(5));
    }
}
