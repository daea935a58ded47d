//! `fit` as a user runs it: all six kinds, from a run to a machine file that predicts, and how it
//! refuses.

use std::{fmt::Write as _, fs};

use crate::desk::Desk;
use trueup_machine::{Machine, MachineFile, RunFile};
use trueup_measured_data::find_measured_file as measured;

const MACHINE: &str = "# mine\n[machine]\nname = \"mill\" # the old one\nkind = \"3-axis\"\n";

fn desk() -> Desk {
    Desk::new(&[("m.toml", MACHINE)])
}

impl Desk {
    fn machine(&self, name: &str) -> Machine {
        MachineFile::read(&self.path(name)).unwrap_or_else(|error| panic!("{error}"))
    }

    /// Root mean square of measured minus predicted of `quantity`, by the tool itself.
    fn predicted_rms(&self, machine: &str, run: &str, quantity: &str) -> f64 {
        self.run_expecting(&format!("predict --machine {machine} --run {run} -o predicted.csv"), 0);
        let run = RunFile::read(&self.path("predicted.csv")).expect("just written");
        let measured = run.require_column(&format!("measured_{quantity}_um")).expect("measured");
        let predicted = run.require_column(&format!("predicted_{quantity}_um")).expect("predicted");
        let left: Vec<f64> = measured
            .iter()
            .zip(predicted)
            .map(|(measured, predicted)| measured - predicted)
            .filter(|left| !left.is_nan())
            .collect();
        (left.iter().map(|left| left * left).sum::<f64>() / left.len() as f64).sqrt()
    }
}

/// Returns a number of the JSON that a fit printed, by its path.
fn number(json: &str, path: &str) -> f64 {
    let value: serde_json::Value = serde_json::from_str(json).expect("JSON");
    value
        .pointer(path)
        .and_then(serde_json::Value::as_f64)
        .unwrap_or_else(|| panic!("{path}: {json}"))
}

/// Repeatable noise between −1 and 1.
fn noise(row: usize) -> f64 {
    ((row * 7919 + 104_729) % 2003) as f64 / 1001.0 - 1.0
}

#[test]
fn elongation_by_the_sensor_goes_into_the_users_own_file() {
    let desk = desk();
    desk.write("run.csv", include_str!("../../../../../data/spindle_paper_table1.csv"));
    let line = "fit elongation --run run.csv --machine m.toml -o out.toml";
    let (out, _) = desk.run_expecting(line, 0);
    assert!(out.starts_with("elongation of measured_elongation_um: fitted\n"), "{out}");
    assert!(
        out.contains("15 rows used, 0 incomplete, 0 excluded as outliers\nwritten to out.toml"),
        "{out}"
    );
    assert!(desk.text("out.toml").starts_with(MACHINE), "{}", desk.text("out.toml"));
    let rms = desk.predicted_rms("out.toml", "run.csv", "elongation");
    let (json, _) = desk.run_expecting(&format!("--json {line}"), 0);
    assert!((rms - number(&json, "/in_sample/rms_um")).abs() < 1e-3 && rms < 0.84, "{rms}");
    assert!(number(&json, "/left_out/rms_um") < 0.95);
}

#[test]
fn elongation_by_a_temperature_is_asked_for() {
    let desk = desk();
    let mut text = String::from("time_s,temp_a_c,temp_b_c,measured_elongation_um\n");
    for row in 0..200 {
        let warm = 20.0 + 15.0 * (1.0 - (-f64::from(row) / 60.0).exp());
        let y = 2.0 * (warm - 21.0) + 0.3 * noise(row as usize);
        writeln!(text, "{},{warm},{},{y}", 60 * row, 20 + row % 3).expect("a string");
    }
    desk.write("run.csv", text);
    let (_, err) = desk.run_expecting("fit elongation --run run.csv -o out.toml", 2);
    assert_eq!(
        err,
        "run.csv:1:1: name the temperature that explains it with --temperature: there are \
         temp_a_c, temp_b_c\n"
    );
    desk.run_expecting(
        "fit elongation --run run.csv --machine m.toml --temperature temp_a_c -o out.toml",
        0,
    );
    let model = desk.machine("out.toml").spindle.temperature.expect("written");
    assert!((model.k_um_per_c - 2.0).abs() < 0.05, "{model:?}");
    assert!(desk.predicted_rms("out.toml", "run.csv", "elongation") < 0.25);
}

#[test]
fn warmup_from_two_runs_at_two_speeds() {
    let desk = desk();
    for (name, rpm) in [("slow.csv", 12_000.0), ("fast.csv", 24_000.0)] {
        let mut text = String::from("time_s,spindle_rpm,measured_elongation_um\n");
        for row in 0..130 {
            let since = (60.0 * f64::from(row) - 120.0).max(0.0);
            let y = rpm / 300.0 * (1.0 - (-since / 1500.0).exp()) + 0.3 * noise(row as usize);
            writeln!(text, "{},{rpm},{y}", 60 * row).expect("a string");
        }
        desk.write(name, text);
    }
    let line = "fit warmup --run slow.csv --run fast.csv --machine m.toml -o out.toml --json";
    let (json, _) = desk.run_expecting(line, 0);
    assert!((number(&json, "/parameters/speed_exponent/value") - 1.0).abs() < 0.02, "{json}");
    assert!((number(&json, "/parameters/time_constant_s/value") - 1500.0).abs() < 40.0, "{json}");
    for run in ["slow.csv", "fast.csv"] {
        let rms = desk.predicted_rms("out.toml", run, "elongation");
        assert!(rms < 0.25, "{run}: {rms}");
    }
}

#[test]
fn thermal_does_not_fit_what_other_sections_say_already() {
    let desk = desk();
    let other =
        "[axis.x.pitch]\nstart_mm = 0.0\nstep_mm = 500.0\nforward_um = [0.0, 30.0, -20.0]\n";
    desk.write("m.toml", format!("{MACHINE}{other}"));
    let mut text = String::from("time_s,x_mm,temp_screw_c,measured_dx_um\n");
    for row in 0..300 {
        let warm = 20.0 + 10.0 * (1.0 - (-f64::from(row) / 90.0).exp());
        let x = 250.0 * f64::from(row % 5);
        let pitch = if x <= 500.0 { 0.06 * x } else { 30.0 - 0.1 * (x - 500.0) };
        let y = 12.0 * (warm - 21.0) * x / 1000.0 + pitch + 0.3 * noise(row as usize);
        writeln!(text, "{},{x},{warm},{y}", 30 * row).expect("a string");
    }
    desk.write("run.csv", text);
    desk.run_expecting("fit thermal --run run.csv --machine m.toml -o out.toml", 0);
    let thermal = desk.machine("out.toml").axes[0].thermal.clone().expect("written");
    assert!((thermal.slope_um_per_m_per_c - 12.0).abs() < 0.1, "{thermal:?}");
    assert!((thermal.reference_c - 21.0).abs() < 0.1, "{thermal:?}");
    assert!(desk.predicted_rms("out.toml", "run.csv", "dx") < 0.25);
    // The machine file may be named twice.
    desk.run_expecting("fit thermal --run run.csv --machine m.toml -o m.toml", 0);
    assert_eq!(desk.text("m.toml"), desk.text("out.toml"));
}

#[test]
fn pitch_and_backlash_of_real_axes() {
    let (Some(x), Some(muts)) = (measured("ess_iso230/x.csv"), measured("ess_iso230/muts_x.csv"))
    else {
        return;
    };
    let desk = desk();
    desk.write("x.csv", fs::read(x).expect("readable"));
    desk.write("muts.csv", fs::read(muts).expect("readable"));
    let line = "fit pitch --run x.csv --machine m.toml --repeats 1,2,3 -o out.toml";
    let (out, _) = desk.run_expecting(line, 0);
    println!("{out}");
    // The repeats 4 and 5, which were not fitted.
    let text = desk.text("x.csv");
    let unseen: Vec<&str> = text
        .lines()
        .filter(|line| line.starts_with("run") || line.starts_with("4,") || line.starts_with("5,"))
        .collect();
    desk.write("unseen.csv", unseen.join("\n"));
    let rms = desk.predicted_rms("out.toml", "unseen.csv", "dx");
    println!("x, on repeats that were not fitted: {rms:.2} µm RMS");
    assert!(rms < 5.5, "{rms}");
    let (out, _) = desk.run_expecting("fit backlash --run x.csv --machine m.toml -o lash.toml", 0);
    println!("{out}");
    let width = desk.machine("lash.toml").axes[0].backlash.expect("written").width_um;
    assert!((-30.0..-20.0).contains(&width), "{width}");
    let (out, _) = desk.run_expecting("fit pitch --run muts.csv --machine m.toml -o none.toml", 3);
    assert!(out.starts_with("pitch of measured_dx_um: do not compensate\n"), "{out}");
    assert!(out.ends_with("nothing is written\n") && !desk.path("none.toml").exists(), "{out}");
}

/// Readings of X on a beam: `share` of the way to the second drive; errors of each drive, a backlash of 4 um, and noise.
fn beam_run(share: f64, y_column: bool) -> String {
    let mut text = String::from("run,x_mm,dir_x,measured_dx_um");
    text += if y_column { ",y_mm\n" } else { "\n" };
    for run in 1..=4 {
        for way in [1, -1] {
            for n in 0..=20 {
                let x = if way == 1 { 50.0 * f64::from(n) } else { 1000.0 - 50.0 * f64::from(n) };
                let first = 0.006 * x + 5.0 * (x / 160.0).sin();
                let second = 0.030 * x - 4.0 * (x / 210.0).sin();
                let noise = 0.3 * f64::from((run * 7 + n * 5 + way * 3) % 5 - 2) / 2.0;
                let lash = if way == -1 { 4.0 } else { 0.0 };
                let um = (1.0 - share) * first + share * second + lash + noise;
                text += &format!("{run},{x},{way},{um:.3}");
                text += &if y_column { format!(",{}\n", 3000.0 * share) } else { "\n".into() };
            }
        }
    }
    text
}

#[test]
fn a_gantry_with_two_drives_gets_both_tables_and_one_run_says_which_stays() {
    let desk = desk();
    desk.write(
        "gantry.toml",
        "[machine]\nname = \"g\"\nkind = \"3-axis\"\n[axis.x.pitch]\nstart_mm = 0.0\nstep_mm = 1000.0\n\
         forward_um = [0.0, 0.0]\n[axis.x.dual]\nacross = \"y\"\nfirst_mm = 0.0\nsecond_mm = 3000.0\n\
         pitch = { start_mm = 0.0, step_mm = 1000.0, forward_um = [0.0, 0.0] }\n",
    );
    for (name, share) in [("one.csv", 0.0), ("two.csv", 1.0), ("between.csv", 0.3)] {
        desk.write(name, beam_run(share, true));
    }
    desk.write("nowhere.csv", beam_run(0.0, false));
    let both = "fit pitch --machine gantry.toml --run one.csv --run two.csv -o both.toml";
    let (out, _) = desk.run_expecting(both, 0);
    println!("{out}");
    for run in ["one.csv", "two.csv", "between.csv"] {
        let rms = desk.predicted_rms("both.toml", run, "dx");
        assert!(rms < 0.6, "{run}: {rms} µm");
    }
    let axis = &desk.machine("both.toml").axes[0];
    assert!((axis.backlash.expect("written").width_um - 4.0).abs() < 0.3);
    assert!(axis.dual.as_ref().expect("kept").pitch.forward_um.iter().any(|um| *um > 20.0));

    // One run: the other table stays, and that is reported with what it costs to leave it.
    for run in ["one.csv", "nowhere.csv"] {
        let (out, stderr) = desk
            .run_expecting(&format!("fit pitch --machine gantry.toml --run {run} -o one.toml"), 0);
        let message = format!("{out}{stderr}");
        assert!(message.contains("[axis.x.dual] pitch, stays as it is, 0 everywhere"), "{message}");
        assert!(message.contains("Y at 3000 mm, and --run twice"), "{message}");
    }
    assert!(desk.predicted_rms("one.toml", "two.csv", "dx") > 10.0);
    let (_, stderr) =
        desk.run_expecting("fit pitch --machine gantry.toml --run between.csv -o no.toml", 2);
    assert!(stderr.contains("y_mm is 900: the two drives are at 0 and 3000 mm"), "{stderr}");
    let (_, stderr) = desk
        .run_expecting("fit pitch --machine gantry.toml --run one.csv --run one.csv -o no.toml", 2);
    assert!(stderr.contains("is of the same drive as another run"), "{stderr}");
}

#[test]
fn straightness_of_a_real_bed() {
    let Some(path) = measured("bed_mesh_troodon/mesh_101x101_mm.csv") else { return };
    let text = fs::read_to_string(path).expect("readable");
    let rows: Vec<Vec<f64>> = text
        .lines()
        .map(|line| line.split(',').map(|cell| cell.parse().expect("a number")).collect())
        .collect();
    let height = |column: usize| {
        1000.0 * rows.iter().map(|row| row[column]).sum::<f64>() / rows.len() as f64
    };
    let (mut even, mut odd) =
        ("x_mm,measured_dz_um\n".to_string(), "x_mm,measured_dz_um\n".to_string());
    for column in 0..101 {
        let text = if column % 2 == 0 { &mut even } else { &mut odd };
        writeln!(text, "{},{}", 30.0 + 2.9 * column as f64, height(column)).expect("a string");
    }
    let desk = desk();
    desk.write("even.csv", even);
    desk.write("odd.csv", odd);
    let (json, _) = desk
        .run_expecting("fit straightness --run even.csv --machine m.toml -o out.toml --json", 0);
    let coefficients = number(&json, "/facts/coefficients");
    let rms = desk.predicted_rms("out.toml", "odd.csv", "dz");
    println!("bed: {coefficients} coefficients, on the odd points {rms:.3} µm RMS");
    assert!(rms < 0.8 && coefficients < 40.0, "{coefficients}: {rms}");
    // A tolerance below the noise is not reached, and that is reported.
    let line = "fit straightness --run even.csv --tolerance-um 0.001 -o tight.toml";
    let (out, _) = desk.run_expecting(line, 3);
    assert!(out.contains("not reached: the largest residual is "), "{out}");
    let (json, _) = desk
        .run_expecting("fit straightness --run even.csv --tolerance-um 5 -o loose.toml --json", 0);
    assert!(
        number(&json, "/in_sample/max_um") <= 5.0 && number(&json, "/facts/coefficients") < 9.0
    );
}

#[test]
fn ways_to_a_curve_stand_side_by_side_on_curves_and_diagonals() {
    let error = |mm: f64| 8.0 * (mm / 90.0).sin();
    let mut texts = ["x_mm", "y_mm", "x_mm,y_mm"].map(|names| format!("{names},measured_dz_um\n"));
    for n in 0..60 {
        let at = 10.0 * f64::from(n);
        for (text, row) in texts.iter_mut().zip([
            format!("{at},{}", error(at)),
            format!("{at},{}", error(at + 200.0)),
            format!("{at},{at},{}", error(at) + error(at + 200.0)),
        ]) {
            writeln!(text, "{row}").expect("a string");
        }
    }
    let desk = desk();
    for (name, text) in ["x.csv", "y.csv", "xy.csv"].into_iter().zip(texts) {
        desk.write(name, text);
    }
    let line =
        "fit table1 --run x.csv --run xy.csv --run y.csv --tolerance-um 0.5 --feed 6000 -o t.html";
    let (out, _) = desk.run_expecting(line, 0);
    println!("{out}");
    for entry in ["z_of_x, 60", "z_of_y, 60", "dz on the diagonal of x and y, 60"] {
        assert!(out.contains(&format!("{entry} positions\n  without: range ")), "{out}");
    }
    assert_eq!(out.matches("  straight lines: range 0.00 µm, mean 0.00 µm").count(), 3, "{out}");
    assert!(desk.text("t.html").contains("<svg"));
    let (json, _) = desk.run_expecting(&format!("{line} --json"), 0);
    // Along the diagonal each axis has 1/√2 of the feed.
    let jump = |entry| number(&json, &format!("/entries/{entry}/ways/4/jump_mm_per_s"));
    let most = f64::max(jump(0), jump(1));
    assert!((jump(2) - most / 2_f64.sqrt()).abs() < 1e-9 && most > 0.0, "{json}");
    let (_, error) = desk.run_expecting("fit table1 --run xy.csv -o t.html", 2);
    assert!(error.contains("give the run of z over x alone by --run as well"), "{error}");
}

#[test]
fn without_a_machine_file_the_section_alone_is_written() {
    let desk = desk();
    desk.write("run.csv", include_str!("../../../../../data/spindle_paper_table1.csv"));
    desk.run_expecting("fit elongation --run run.csv -o section.toml", 0);
    let section = desk.text("section.toml");
    assert!(section.contains("\n[spindle.sensor]\nk0_um = "), "{section}");
    desk.write("whole.toml", format!("{MACHINE}[spindle]\nsource = \"sensor\"\n{section}"));
    assert!(desk.machine("whole.toml").spindle.sensor.is_some());
}

#[test]
fn bad_input_ends_with_2_and_one_line_and_writes_nothing() {
    let desk = desk();
    desk.write("two.csv", "x_mm,temp_a_c,measured_dx_um,measured_dy_um\n0,20,1,2\n");
    desk.write("one.csv", "sensor_counts,measured_elongation_um\n1,2\n");
    desk.write("bad.toml", "[machine]\nnam = \"x\"\n");
    for (line, expected) in [
        (
            "fit thermal --run two.csv -o out.toml",
            "two.csv:1:1: the run measures dx, dy: choose one with --axis or --quantity\n",
        ),
        (
            "fit pitch --run two.csv --quantity dw -o out.toml",
            "two.csv:1:1: --quantity must be dx or dy or dz, not \"dw\"\n",
        ),
        (
            "fit elongation --run one.csv -o out.toml",
            "one.csv:1:1: 1 of 1 rows are complete: the fit needs at least 3\n",
        ),
        (
            "fit elongation --run one.csv --machine bad.toml -o out.toml",
            "bad.toml:2:1: unknown key machine.nam; did you mean name?\n",
        ),
        (
            "fit backlash --run two.csv --run one.csv -o out.toml",
            "--run is given 2 times: this fit takes one run file (repeats stand in its column \
             run)\n",
        ),
        (
            "fit warmup --run one.csv -o out.toml",
            "one.csv:1:1: column time_s is missing; there are sensor_counts, \
             measured_elongation_um\n",
        ),
    ] {
        let (out, err) = desk.run_expecting(line, 2);
        assert_eq!((out.as_str(), err.as_str()), ("", expected), "{line}");
        assert!(!desk.path("out.toml").exists(), "{line}");
    }
}

/// A circle of 100 mm in both directions: `um` of the angle and the direction, and noise of 0.1 µm.
fn circle_csv(um: impl Fn(f64, f64) -> f64) -> String {
    let mut text = String::from("time_s,x_mm,y_mm,measured_dr_um\n");
    for row in 0..1440_usize {
        let sense = if row < 720 { 1.0 } else { -1.0 };
        let angle = sense * ((row % 720) as f64 * 0.5 + 3.0).to_radians();
        let (x, y) = (100.0 * angle.cos(), 100.0 * angle.sin());
        let um = um(angle, sense) + 0.1 * noise(row);
        writeln!(text, "{:.2},{x:.5},{y:.5},{um:.4}", 0.05 * row as f64).expect("a string");
    }
    text
}

#[test]
fn a_circle_gives_causes_sections_and_a_page_with_the_polar_plot() {
    let desk = desk();
    // 4 µm of sin 2φ at 100 mm are 80 µm/m.
    desk.write("run.csv", circle_csv(|angle, _| 3.0 + 4.0 * (2.0 * angle).sin()));
    let line = "fit circle --run run.csv --machine m.toml -o out.toml --out page";
    let (out, _) = desk.run_expecting(line, 0);
    assert!(out.contains("squareness (written)"), "{out}");
    let squareness = &desk.machine("out.toml").squareness[0];
    assert!((squareness.um_per_m - 80.0).abs() < 0.5, "{squareness:?}");
    let page = desk.text("page/report.html");
    assert!(page.contains("<circle class=") && page.contains("G(b)"), "{page}");
    let json = desk.text("page/circle.json");
    assert_eq!(number(&json, "/planes/0/radius_mm").round(), 100.0);
    assert!((number(&json, "/findings/0/parameters/um_per_m/value") - 80.0).abs() < 0.5);
    // The file explains it now: nothing is left, and nothing is written.
    let (out, _) =
        desk.run_expecting("fit circle --run run.csv --machine out.toml -o again.toml", 0);
    assert!(out.contains("circle: clean") && out.contains("nothing is written"), "{out}");
    assert!(!desk.path("again.toml").exists());
}

#[test]
fn a_circle_in_one_direction_or_without_readings_says_what_to_do() {
    let desk = desk();
    let both = circle_csv(|angle, _| 4.0 * (2.0 * angle).sin());
    let one: String = both.lines().take(721).map(|line| format!("{line}\n")).collect();
    desk.write("one.csv", one);
    let (out, _) = desk.run_expecting("fit circle --run one.csv -o out.toml", 3);
    assert!(out.contains("not claimed") && out.contains("other direction"), "{out}");
    desk.write("line.csv", "x_mm,measured_dr_um\n1,2\n2,3\n3,4\n");
    let (_, err) = desk.run_expecting("fit circle --run line.csv -o out.toml", 2);
    assert!(err.contains("needs two of x_mm, y_mm and z_mm that move"), "{err}");
    desk.write("dx.csv", "x_mm,y_mm,measured_dx_um\n1,2,3\n");
    let (_, err) = desk.run_expecting("fit circle --run dx.csv -o out.toml", 2);
    assert!(err.contains("column measured_dr_um is missing"), "{err}");
}

/// Balls at three heights: X is out of square to Y by 80 µm/m, and a roll of X lifts what is away from Y = 0.
fn balls_csv() -> String {
    let mut text =
        String::from("x_mm,y_mm,z_mm,setup,measured_dx_um,measured_dy_um,measured_dz_um\n");
    let mut row = 0;
    for z in [0.0, 100.0, 200.0] {
        for (x, y) in (0..25).map(|n: u8| (f64::from(n % 5) * 100.0, f64::from(n / 5) * 100.0)) {
            let roll_urad = 40.0 * ((x - 200.0) / 200.0_f64).powi(2);
            let um = [0.08 * y, -roll_urad * z / 1000.0, roll_urad * y / 1000.0];
            row += 3;
            let um = [0, 1, 2].map(|n| um[n] + 0.2 * noise(row + n));
            writeln!(text, "{x},{y},{z},1,{:.3},{:.3},{:.3}", um[0], um[1], um[2])
                .expect("a string");
        }
    }
    text
}

#[test]
fn balls_give_the_errors_of_the_volume_and_what_one_tool_does_not_show() {
    let desk = desk();
    let machine = "[machine]\nname = \"m\"\nkind = \"3-axis\"\nchain = \"w b X Y Z t\"\ntool.length_mm = 100.0\n";
    desk.write("chain.toml", machine.replace("tool.length_mm", "[tool]\nlength_mm"));
    desk.write("run.csv", balls_csv());
    let line = "fit volume --run run.csv --machine chain.toml -o out.toml --instrument-um 0.2 --scale-um-per-m 1";
    let (out, _) = desk.run_expecting(line, 0);
    assert!(out.contains("written to out.toml"), "{out}");
    assert!(desk.text("out.html").contains("EAX over X"));
    let fitted = desk.machine("out.toml");
    let squareness =
        fitted.squareness.iter().find(|squareness| squareness.name() == "x_of_y_um_per_m");
    assert!((squareness.expect("written").um_per_m - 80.0).abs() < 2.0, "{out}");
    assert!(fitted.volume.angular.iter().any(|motion| motion.name() == "eax"), "{out}");
    // One tool: what Z turns by looks like its straightness.
    assert!(out.contains("not known by itself") && out.contains("100 mm longer"), "{out}");
    let (json, _) = desk.run_expecting(&format!("{line} --json"), 0);
    let json: serde_json::Value = serde_json::from_str(&json).expect("JSON");
    let eax =
        json["errors"].as_array().expect("a list").iter().find(|error| error["error"] == "EAX");
    let eax = eax.expect("is there");
    assert_eq!(
        (eax["known"].as_bool(), eax["claimed"].as_bool()),
        (Some(true), Some(true)),
        "{eax}"
    );
    assert!((eax["size"].as_f64().expect("a number") - 40.0).abs() < 4.0, "{eax}");
    let (_, err) = desk.run_expecting("fit volume --run run.csv --machine m.toml -o out.toml", 2);
    assert!(err.contains("machine.chain is missing"), "{err}");
}
