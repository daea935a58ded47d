//! Lines that a page, a file, a help or a command prints run as printed: the blocks of every page of the book, the end of a
//! file of `trueup new`, the examples of each `--help`, and what a program or a diagnosis says to type next; in their order,
//! with the run files filled in between. Lines that need a machine have their reason in [`ELSEWHERE`].

use std::{
    collections::BTreeMap,
    fs,
    path::Path,
    process::{Command, Output},
};

use crate::{
    desk::Desk,
    linuxcnc::{HAL, INI},
};

/// Commands that are not run here, by how they begin, and why.
const ELSEWHERE: &[(&str, &str)] = &[
    ("new -o mill.toml\n", "asks on a terminal: new.rs"),
    ("new\n", "asks on a terminal: tour.rs, new.rs"),
    ("virtual ", "runs until Ctrl-C: tour.rs, commission_board.rs"),
    ("commission ", "needs a bridge and its CNC: tour.rs, commission_board.rs"),
    ("bridge list", "what this computer has: wire.rs"),
    ("bridge ", "needs a bridge: tour.rs, bridge.rs, host-tests"),
    ("gateway ", "needs a bridge and a PLC: host-tests"),
    ("linuxcnc component", "needs LinuxCNC's compiler of components: host-tests"),
    ("linuxcnc keep", "runs while LinuxCNC does: host-tests"),
    ("linuxcnc status", "needs a LinuxCNC that runs: host-tests"),
    ("linuxcnc --port", "is a component of LinuxCNC: host-tests"),
    ("doctor", "what this computer has"),
    ("fleet server", "runs until Ctrl-C: fleet_nats.rs"),
    ("firmware ", "the tool of the tests carries no images: install.rs"),
    ("import ", "needs a table of the user's: import.rs"),
    ("serve ", "needs a bridge and a broker: crates/tool/serve/tests/live"),
];

/// Files that the reader of a page has, and the example that stands for each.
const OF_READER: &[(&str, &str)] = &[
    ("balls.csv", "mill/balls.csv"),
    ("ccw.csv", "mill/circle-ccw.csv"),
    ("cw.csv", "mill/circle-cw.csv"),
    ("lathe.toml", "linuxcnc/trueup_lathe.toml"),
    ("machine.toml", "mill/mill.toml"),
    ("mill.toml", "mill/mill.toml"),
    ("my_machine.toml", "mill/mill.toml"),
    ("volume.toml", "mill/volume.toml"),
    ("mill-7-2026-11-22.csv", "mill/warmup-off.csv"),
];

/// Returns why a command is not run here.
fn elsewhere(command: &str) -> Option<&'static str> {
    if command.contains(" --nats ") {
        return Some("needs a NATS server: fleet_nats.rs");
    }
    if command.ends_with(" --no-board") {
        return Some("needs the component of LinuxCNC: host-tests");
    }
    let line = format!("{command}\n");
    ELSEWHERE.iter().find(|(begin, _)| line.starts_with(begin)).map(|(_, why)| *why)
}

/// Runs a command of the tool in a shell: patterns of files and redirections are its own.
fn shell(desk: &Desk, command: &str) -> Output {
    Command::new("sh")
        .args(["-c", &format!("\"$TOOL\" {command}")])
        .current_dir(desk.path("."))
        .env("TOOL", env!("CARGO_BIN_EXE_trueup"))
        .env("XDG_STATE_HOME", desk.path(".state"))
        .env("HOME", desk.path("."))
        .env_remove("INI_FILE_NAME")
        .output()
        .expect("a shell")
}

/// Runs a command, which must not complain of what was typed: it ends with 0, or with 3 where a verdict may be any.
fn runs(desk: &Desk, command: &str) {
    let done = shell(desk, command);
    let stderr = String::from_utf8_lossy(&done.stderr).into_owned();
    assert!(matches!(done.status.code(), Some(0 | 3)), "trueup {command}: {stderr}");
}

/// Returns the lines of the code blocks of a page that are commands of the tool, without the tool's name.
fn commands_of_page(page: &str) -> Vec<String> {
    let mut is_code = false;
    let mut commands = Vec::new();
    for line in page.lines().map(str::trim) {
        is_code ^= line.starts_with("```");
        commands.extend(line.strip_prefix("trueup ").filter(|_| is_code).map(str::to_string));
    }
    commands
}

/// Returns the commands in the last lines of a machine file; what follows two spaces is a comment.
fn commands_of_file(file: &str) -> Vec<String> {
    let next = file.split("# Next").nth(1).expect("it says what comes next");
    let lines = next.lines().filter_map(|line| line.strip_prefix("#   trueup "));
    lines.map(|line| line.split("  ").next().unwrap_or_default().to_string()).collect()
}

/// Fills the empty cells of the run files in `folder`: a backlash of 4 µm, a growth of 40 µm in half an hour, a screw of steel.
fn fill_in(desk: &Desk, folder: &str) {
    for name in desk.files(folder).into_iter().filter(|name| name.ends_with(".csv")) {
        let path = format!("{folder}/{name}");
        let text = desk.text(&path);
        let (notes, rows): (Vec<&str>, Vec<&str>) =
            text.lines().partition(|line| line.starts_with('#'));
        let names: Vec<&str> = rows[0].split(',').collect();
        let mut filled = notes.join("\n") + "\n" + rows[0] + "\n";
        for (number, row) in rows[1..].iter().enumerate() {
            let cells: Vec<&str> = row.split(',').collect();
            let of = |name: &str| -> f64 {
                let at = names.iter().position(|candidate| *candidate == name);
                at.and_then(|at| cells[at].parse().ok()).unwrap_or(0.0)
            };
            let noise = f64::from(u32::try_from(number * 7919 % 13).expect("small")) / 130.0;
            let minute = 60.0 * f64::from(u32::try_from(number).expect("small"));
            let time_s = if of("time_s") > 0.0 { of("time_s") } else { minute };
            let growth = 40.0 * (1.0 - f64::exp(-time_s / 1800.0)) + noise;
            let has_heat = names.iter().any(|name| name.starts_with("temp_"));
            let heat = if has_heat { 0.0115 * growth / 4.0 * of("x_mm") } else { 0.0 };
            let filled_cells = names.iter().zip(&cells).map(|(name, cell)| match *name {
                _ if !cell.is_empty() => (*cell).to_string(),
                "time_s" => time_s.to_string(),
                "measured_elongation_um" => growth.to_string(),
                "sensor_counts" => (5048.0 + growth / 500.0 * 32768.0).round().to_string(),
                name if name.starts_with("temp_") => (20.0 + growth / 4.0).to_string(),
                _ => (heat + noise + if cells.contains(&"-1") { 4.0 } else { 0.0 }).to_string(),
            });
            filled += &(filled_cells.collect::<Vec<_>>().join(",") + "\n");
        }
        desk.write(&path, filled);
    }
}

/// Returns every page with commands: its name, and its text.
fn pages() -> BTreeMap<String, String> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../..");
    let mut pages = BTreeMap::new();
    for folder in ["docs", "docs/book/src", "integrations/linuxcnc", "integrations/modbus", "."] {
        for entry in fs::read_dir(root.join(folder)).expect("a folder of the project") {
            let path = entry.expect("readable").path();
            if path.extension().is_some_and(|extension| extension == "md") {
                let name = path.strip_prefix(&root).unwrap_or(&path).display().to_string();
                pages.insert(name, fs::read_to_string(&path).expect("text"));
            }
        }
    }
    pages
}

#[test]
fn the_blocks_of_every_page_run_as_printed() {
    let (mut ran, mut left) = (0, Vec::new());
    for (name, page) in pages() {
        // Its commands are `$ trueup …`, and tutorial.rs compares what they print.
        let commands = commands_of_page(&page);
        if commands.is_empty() {
            continue;
        }
        let desk = Desk::new(&[("machine.ini", INI), ("own.hal", HAL)]);
        desk.run_expecting("examples .", 0);
        for command in commands {
            if let Some(why) = elsewhere(&command) {
                left.push(format!("{name}: trueup {command}: {why}"));
                continue;
            }
            let is_made = |file: &str| command.contains(&format!("-o {file}"));
            for (file, example) in OF_READER {
                if is_made(file) {
                    fs::remove_file(desk.path(file)).ok();
                } else if !desk.path(file).exists() {
                    desk.write(file, desk.read(example));
                }
            }
            if command.starts_with("simulate") && !desk.path("try").exists() {
                desk.run_expecting("examples try", 0);
            }
            runs(&desk, &command);
            ran += 1;
        }
    }
    println!("{ran} run, elsewhere:\n{}", left.join("\n"));
    assert!(ran >= 20, "{ran}");
}

/// Returns the paths of all commands, by the help of the tool itself.
fn examples_of(desk: &Desk, path: &str, found: &mut Vec<String>) {
    let line = if path.is_empty() { "--help".into() } else { format!("{path} --help") };
    let (help, _) = desk.run_expecting(&line, 0);
    let (mut is_list, mut is_example, mut inner) = (path.is_empty(), false, Vec::new());
    for line in help.lines() {
        if !path.is_empty() && !line.starts_with(' ') {
            is_list = line == "Commands:";
            is_example = line.starts_with("Example") || line.starts_with("For instance");
        }
        let word =
            line.strip_prefix("  ").and_then(|rest| rest.split(' ').next()).unwrap_or_default();
        let is_name = !word.is_empty()
            && word
                .bytes()
                .all(|byte| byte.is_ascii_lowercase() || byte == b'-' || byte.is_ascii_digit());
        if is_list && is_name && !word.starts_with('-') && word != "help" {
            inner.push(word.to_string());
        }
        if let Some(command) = line.trim().strip_prefix("trueup ").filter(|_| is_example) {
            found.push(command.split("   ").next().unwrap_or_default().trim().to_string());
        }
    }
    for word in inner {
        examples_of(desk, format!("{path} {word}").trim(), found);
    }
}

#[test]
fn the_examples_of_every_help_run_on_the_examples_that_the_tool_writes() {
    // The configuration of LinuxCNC is the user's.
    let desk = Desk::new(&[("machine.ini", INI), ("own.hal", HAL)]);
    desk.run_expecting("examples .", 0);
    let mut commands = Vec::new();
    examples_of(&desk, "", &mut commands);
    let (mut ran, mut left) = (0, Vec::new());
    for command in commands {
        // A line that goes on behind a backslash is one of new.rs.
        match elsewhere(&command).or(command.ends_with('\\').then_some("goes on: new.rs")) {
            Some(why) => left.push(format!("trueup {command}: {why}")),
            None => {
                fs::create_dir_all(desk.path(".local/share/bash-completion/completions"))
                    .expect("a folder of the test");
                runs(&desk, &command);
                ran += 1;
            }
        }
    }
    println!("{ran} run, elsewhere:\n{}", left.join("\n"));
    assert!(ran >= 35, "{ran}");
}

/// Returns the commands that stand behind `then:` in what was printed.
fn commands_behind_then(printed: &str) -> Vec<String> {
    let lines = printed.lines().filter_map(|line| line.trim().strip_prefix("then: trueup "));
    lines.map(str::to_string).collect()
}

#[test]
fn what_a_program_and_a_fit_say_to_type_next_runs_as_printed() {
    let mut ran = 0;
    for (kind, file, flags) in [
        ("backlash", "mill.toml", "--axis x"),
        ("pitch", "mill.toml", "--axis x"),
        ("straightness", "mill.toml", "--axis x"),
        ("axis-heat", "mill.toml", "--axis x"),
        ("diagonal", "mill.toml", "--axis x,y"),
        ("circle", "mill.toml", "--axis x,y"),
        ("warmup", "mill.toml", "--rpm 3000"),
        ("warmup", "mill.toml", "--rpm 3000 --gauge dial"),
        // Two drives of an axis have a run file each.
        ("pitch", "gantry.toml", "--axis x --range x=0:14300 --margin 0"),
    ] {
        let desk = Desk::new(&[]);
        desk.run_expecting("examples .", 0);
        desk.write("mill.toml", desk.read("mill/mill.toml"));
        let line = format!("program {kind} --machine {file} --for linuxcnc {flags} -o measure");
        let (printed, _) = desk.run_expecting(&line, 0);
        fill_in(&desk, "measure");
        let commands = commands_behind_then(&printed);
        assert!(!commands.is_empty(), "{printed}");
        for command in commands {
            let done = shell(&desk, &command);
            let stderr = String::from_utf8_lossy(&done.stderr).into_owned();
            assert!(matches!(done.status.code(), Some(0 | 3)), "trueup {command}: {stderr}");
            ran += 1;
            // What a fit says; a calibration is loaded elsewhere.
            let next = commands_behind_then(&String::from_utf8_lossy(&done.stdout));
            for command in next.iter().filter(|word| elsewhere(word).is_none()) {
                runs(&desk, command);
                ran += 1;
            }
        }
    }
    assert!(ran >= 12, "{ran}");
}

#[test]
fn the_last_lines_of_a_new_file_run_as_printed() {
    let mill = "--travel x=0:600 --travel y=0:400 --travel z=-300:0";
    let lathe = "--kind lathe --travel x=0:150 --travel z=-400:0";
    let sensor = "--sensor-um-per-v 50 --sensor-zero-v 1.54 --thermometer front";
    for flags in [
        mill.to_string(),
        format!("{mill} {sensor} --control siemens"),
        format!("{mill} --control fanuc"),
        format!("{mill} --control heidenhain"),
        lathe.to_string(),
        format!("{lathe} {sensor} --control siemens"),
        "--travel z=-300:0".to_string(),
    ] {
        let desk = Desk::new(&[]);
        desk.run_expecting(&format!("new -o my_machine.toml --yes {flags}"), 0);
        let commands = commands_of_file(&desk.text("my_machine.toml"));
        assert!(commands.len() >= 7, "{commands:?}");
        for command in commands {
            let done = desk.trueup(&command);
            let stderr = String::from_utf8_lossy(&done.stderr).into_owned();
            let is_right = match done.status.code() {
                Some(0) => true,
                // A diagnosis of invented readings may have any verdict; an export says what it leaves out.
                Some(3) => command.starts_with("diagnose") || command.starts_with("export"),
                _ => false,
            };
            assert!(is_right, "{flags}: trueup {command}: {stderr}");
            if command.starts_with("program") {
                fill_in(&desk, "measure");
            }
        }
        let page = desk.text("my_machine-backlash.html");
        assert!(page.contains("ISO 230-2") && page.contains("bi-directional accuracy"), "{page}");
    }
}
