//! Lines that a page or a file prints run as printed: the quick start, the page of lathes, and what stands at the end of
//! a file of `trueup new`, in their order, with the run files filled in between.

use crate::desk::Desk;

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

/// Fills the empty cells of the run files in `folder`: a backlash of 4 µm, a growth of 40 µm in half an hour.
fn fill_in(desk: &Desk, folder: &str) {
    for name in desk.files(folder).into_iter().filter(|name| name.ends_with(".csv")) {
        let path = format!("{folder}/{name}");
        let text = desk.text(&path);
        let (notes, rows): (Vec<&str>, Vec<&str>) =
            text.lines().partition(|it| it.starts_with('#'));
        let names: Vec<&str> = rows[0].split(',').collect();
        let mut filled = notes.join("\n") + "\n" + rows[0] + "\n";
        for (number, row) in rows[1..].iter().enumerate() {
            let cells: Vec<&str> = row.split(',').collect();
            let of = |name: &str| -> f64 {
                let at = names.iter().position(|it| *it == name);
                at.and_then(|at| cells[at].parse().ok()).unwrap_or(0.0)
            };
            let noise = f64::from(u32::try_from(number * 7919 % 13).expect("small")) / 130.0;
            let growth = 40.0 * (1.0 - f64::exp(-of("time_s") / 1800.0)) + noise;
            let filled_cells = names.iter().zip(&cells).map(|(name, cell)| match *name {
                _ if !cell.is_empty() => (*cell).to_string(),
                "measured_elongation_um" => growth.to_string(),
                "sensor_counts" => (5048.0 + growth / 500.0 * 32768.0).round().to_string(),
                name if name.starts_with("temp_") => (20.0 + growth / 4.0).to_string(),
                _ => (noise + if cells.contains(&"-1") { 4.0 } else { 0.0 }).to_string(),
            });
            filled += &(filled_cells.collect::<Vec<_>>().join(",") + "\n");
        }
        desk.write(&path, filled);
    }
}

#[test]
fn the_commands_of_the_first_pages_run_as_printed() {
    for (page, least) in [
        (include_str!("../../../../docs/book/src/quick-start.md"), 3),
        (include_str!("../../../../docs/book/src/lathe.md"), 5),
    ] {
        let desk = Desk::new(&[]);
        let commands = commands_of_page(page);
        assert!(commands.len() >= least, "{commands:?}");
        for command in commands {
            desk.said(&command, 0);
        }
    }
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
        desk.said(&format!("new -o my_machine.toml --yes {flags}"), 0);
        let commands = commands_of_file(&desk.text("my_machine.toml"));
        assert!(commands.len() >= 7, "{commands:?}");
        for command in commands {
            let done = desk.trueup(&command);
            let said = String::from_utf8_lossy(&done.stderr).into_owned();
            let is_right = match done.status.code() {
                Some(0) => true,
                // A diagnosis of invented readings may have any verdict; an export says what it leaves out.
                Some(3) => command.starts_with("diagnose") || command.starts_with("export"),
                _ => false,
            };
            assert!(is_right, "{flags}: trueup {command}: {said}");
            if command.starts_with("program") {
                fill_in(&desk, "measure");
            }
        }
        let page = desk.text("my_machine-backlash.html");
        assert!(page.contains("ISO 230-2") && page.contains("bi-directional accuracy"), "{page}");
    }
}
