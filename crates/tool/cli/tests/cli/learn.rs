//! `trueup learn` and `trueup trust` as a user calls them: records in, a second machine file out, the way
//! back, and an alarm.

use crate::desk::Desk;
use serde_json::Value;

const MACHINE: &str = "[machine]\nname = \"m\"\nkind = \"3-axis\"\n[inputs]\n\
                       temp_a_c = { channel = 0, kind = \"pt100\" }\n[spindle]\nsource = \"temperature\"\n\
                       [spindle.temperature]\nsensor = \"temp_a_c\"\nreference_c = 20.0\n\
                       k_um_per_c = 2.0 # the maker's\n";

/// Returns a day of readings each half hour, of a spindle that grows by 2.6 µm/K.
fn day(number: u32) -> String {
    let mut text = "time_s,temp_a_c,measured_elongation_um\n".to_string();
    for n in 0..30 {
        let celsius = 25.0 + 10.0 * f64::from(n % 7) / 6.0;
        let um = 2.6 * (celsius - 20.0) + [0.6, -0.6, 0.2, -0.2, -0.4, 0.4][n as usize % 6];
        let time_s = 86_400 * number + 1800 * n;
        text += &format!("{time_s},{celsius:.3},{um:.3}\n");
    }
    text
}

#[test]
fn days_are_learned_from_and_the_last_change_is_taken_back() {
    let desk = Desk::new(&[("m.toml", MACHINE), ("1.csv", &day(1)), ("2.csv", &day(2))]);
    let (out, _) = desk.run_expecting("learn --machine m.toml --run 1.csv -o learned.toml", 0);
    assert!(out.contains("30 of 30 readings used"), "{out}");
    let (_, constant) =
        out.split_once("spindle.temperature.k_um_per_c: ").expect("what is learned");
    assert!(constant.starts_with("2 µm/K in your file, 2."), "{out}");
    let (_, half_width) = constant.split_once(" µm/K learned, ± ").expect("its interval");
    let half_width = half_width.split(" µm/K").next().and_then(|text| text.parse::<f64>().ok());
    assert!(half_width.is_some_and(|half_width| half_width > 0.0), "{out}");
    let first = desk.text("learned.toml");
    assert!(first.contains("# the maker's") && first != MACHINE, "{first}");
    let (out, _) =
        desk.run_expecting("--json learn --machine m.toml --run 2.csv -o learned.toml", 0);
    let json: Value = serde_json::from_str(&out).expect("JSON");
    let constant = &json["constants"][0];
    let learned = constant["learned"].as_f64().expect("a number");
    assert!((learned - 2.6).abs() < 0.1 && constant["file"] == 2.0, "{constant}");
    assert_eq!(desk.text("m.toml"), MACHINE, "the user's own file stays");
    // The calibration can be made of it.
    desk.run_expecting("compile learned.toml -o cal.bin", 0);
    desk.run_expecting("learn --undo --machine m.toml -o learned.toml", 0);
    assert_eq!(desk.text("learned.toml"), first);
    desk.run_expecting("learn --undo --machine m.toml -o learned.toml", 0);
    assert_eq!(desk.text("learned.toml"), MACHINE);
    let (_, err) = desk.run_expecting("learn --undo --machine m.toml -o learned.toml", 2);
    assert!(err.contains("no change that is not taken back already"), "{err}");
    let (out, _) = desk.run_expecting("learn --machine m.toml --run 1.csv -o learned.toml", 0);
    assert!(out.contains("30 of 30 readings were learned from before"), "{out}");
}

#[test]
fn a_command_that_is_refused_leaves_state_and_inputs_as_they_were() {
    let (one, two) = (day(1), day(2));
    let desk =
        Desk::new(&[("m.toml", MACHINE), ("1.csv", &one), ("2.csv", &two), ("bad.csv", "a\nx\n")]);
    desk.run_expecting("learn --machine m.toml --run 1.csv -o learned.toml", 0);
    let known = desk.text("learned.learn.json");
    for line in [
        "learn --machine m.toml --run 2.csv -o 2.csv",
        "learn --machine m.toml --run 2.csv --run bad.csv -o learned.toml",
        "learn --machine learned.toml --run 2.csv -o learned.toml",
        "learn --machine m.toml --run learned.learn.json --run 2.csv -o learned.toml",
        "learn --machine m.toml --run 2.csv -o no/learned.toml",
        "learn --undo --machine learned.toml -o learned.toml",
    ] {
        desk.run_expecting(line, 2);
        assert_eq!(desk.text("learned.learn.json"), known, "{line}");
        assert!(!desk.path("2.learn.json").exists() && desk.text("2.csv") == two, "{line}");
    }
    // A day file that is fed as it grows.
    let rows = |count: usize| two.lines().take(count + 1).collect::<Vec<_>>().join("\n") + "\n";
    for (count, message) in [(10, "10 of 10 readings used"), (20, "10 of 10 readings used")] {
        std::fs::write(desk.path("today.csv"), rows(count)).expect("written");
        let (out, _) =
            desk.run_expecting("learn --machine m.toml --run today.csv -o learned.toml", 0);
        assert!(out.contains(message), "{out}");
    }
    // An older record that is known is skipped.
    let (out, _) = desk.run_expecting("learn --machine m.toml --run 1.csv -o learned.toml", 0);
    assert!(out.contains("30 of 30 readings were learned from before"), "{out}");
    std::fs::write(desk.path("older.csv"), day(1).replace(".600", ".700")).expect("written");
    let (_, err) = desk.run_expecting("learn --machine m.toml --run older.csv -o learned.toml", 2);
    assert!(err.contains("at or before the last reading"), "{err}");
}

#[test]
fn a_bound_that_is_reached_is_reported_and_ends_with_3() {
    let desk = Desk::new(&[("m.toml", MACHINE), ("1.csv", &day(1))]);
    let line = "learn --machine m.toml --run 1.csv -o learned.toml --limit-percent 5";
    let (out, _) = desk.run_expecting(line, 3);
    assert!(out.contains("A bound was reached"), "{out}");
    assert!(
        desk.text("learned.toml").contains("k_um_per_c = 2.1 "),
        "{}",
        desk.text("learned.toml")
    );
}

#[test]
fn a_record_that_no_longer_fits_ends_with_3_and_says_what_to_measure() {
    let day = |added: f64| {
        let mut text = "time_s,temp_a_c,measured_elongation_um\n".to_string();
        for n in 0..240 {
            let celsius = 30.0 + 8.0 * (f64::from(n) / 30.0).sin();
            let scatter = [0.6, -0.6, 0.2, -0.2, -0.4, 0.4, 0.1][n as usize % 7];
            let um = 2.0 * (celsius - 20.0) + scatter + if n < 120 { 0.0 } else { added };
            text += &format!("{},{celsius:.3},{um:.3}\n", 60 * n);
        }
        text
    };
    let files = [("m.toml", MACHINE), ("then.csv", &day(0.0)), ("now.csv", &day(3.0))];
    let desk = Desk::new(&files);
    let same = "trust --machine m.toml --calibrated then.csv --run then.csv";
    let (out, _) = desk.run_expecting(same, 0);
    assert!(out.starts_with("the calibration fits"), "{out}");
    let (out, _) =
        desk.run_expecting("trust --machine m.toml --calibrated then.csv --run now.csv", 3);
    assert!(out.contains("no longer fits: row 12"), "{out}");
    assert!(out.contains("touch off the tool"), "{out}");
}

/// Returns the same readings for another time of the year and with another machine file.
fn learned_from(desk: &Desk, machine: &str, record: &str, code: i32) -> (String, String) {
    desk.run_expecting(&format!("learn --machine {machine} --run {record} -o learned.toml"), code)
}

#[test]
fn comments_limits_and_other_keys_keep_what_was_learned_and_a_changed_constant_restarts_alone() {
    let commented = format!("# a comment\n{MACHINE}\n[limits]\nslew_um_per_s = 12.0\n")
        .replace("k_um_per_c", "lag_s = 5.0\nk_um_per_c")
        + "learned = { growth_percent = 5 }\n";
    let serial = MACHINE.replace("name = \"m\"", "name = \"m\"\nserial = \"4711\"");
    let by_hand = MACHINE.replace("= 2.0 #", "= 2.5 #");
    let files = [
        ("m.toml", MACHINE),
        ("commented.toml", &commented),
        ("serial.toml", &serial),
        ("by_hand.toml", &by_hand),
        ("1.csv", &day(1)),
        ("2.csv", &day(2)),
        ("3.csv", &day(3)),
        ("4.csv", &day(4)),
    ];
    let desk = Desk::new(&files);
    learned_from(&desk, "m.toml", "1.csv", 0);
    let first = desk.text("learned.learn.json");
    for (machine, record) in [("commented.toml", "2.csv"), ("serial.toml", "3.csv")] {
        let (out, _) = learned_from(&desk, machine, record, 0);
        assert!(!out.contains("anew"), "{machine}: {out}");
        let text = desk.text("learned.toml");
        assert!(text.contains("k_um_per_c = 2.5") || text.contains("k_um_per_c = 2.6"), "{text}");
    }
    assert!(!desk.path("learned.learn.json.bak").exists());
    let before = desk.text("learned.learn.json");
    let (out, _) = learned_from(&desk, "by_hand.toml", "4.csv", 0);
    assert!(out.contains("k_um_per_c was changed by hand (2 to 2.5): it begins anew"), "{out}");
    assert_eq!(desk.text("learned.learn.json.bak"), before, "a backup is kept");
    // Nothing is discarded without --reset, and then there is a backup too.
    desk.run_expecting("learn --reset --machine m.toml --run 1.csv -o learned.toml", 0);
    assert_eq!(desk.text("learned.learn.json"), first);
    assert!(desk.path("learned.learn.json.bak1").exists());
}

#[test]
fn the_output_of_another_machine_or_quantity_is_refused_and_stays() {
    let other = MACHINE.replace("name = \"m\"", "name = \"n\"");
    let one = MACHINE.replace("name = \"m\"", "name = \"m\"\nserial = \"1\"");
    let two = MACHINE.replace("name = \"m\"", "name = \"m\"\nserial = \"2\"");
    let axis = "[axis.z]\nfeedback = \"screw\"\n[axis.z.backlash]\nwidth_um = 4.0\n";
    let with_axis = format!("{one}{axis}");
    let dz = day(2).replace("measured_elongation_um", "measured_dz_um");
    let files = [
        ("m.toml", &one[..]),
        ("n.toml", &other),
        ("two.toml", &two),
        ("axis.toml", &with_axis),
        ("1.csv", &day(1)),
        ("2.csv", &day(2)),
        ("dz.csv", &dz),
    ];
    let desk = Desk::new(&files);
    learned_from(&desk, "m.toml", "1.csv", 0);
    let (state, learned) = (desk.text("learned.learn.json"), desk.text("learned.toml"));
    for (machine, record) in [("n.toml", "2.csv"), ("two.toml", "2.csv"), ("axis.toml", "dz.csv")] {
        let (_, err) = learned_from(&desk, machine, record, 2);
        assert!(err.contains("--output"), "{machine}: {err}");
        assert_eq!(desk.text("learned.learn.json"), state, "{machine}");
        assert_eq!(desk.text("learned.toml"), learned, "{machine}");
    }
    // Nor without a state next to it.
    std::fs::remove_file(desk.path("learned.learn.json")).expect("it was there");
    let (_, err) = learned_from(&desk, "n.toml", "2.csv", 2);
    assert!(err.contains("machine m (serial 1)"), "{err}");
    assert_eq!(desk.text("learned.toml"), learned);
}

#[test]
fn a_crash_is_an_event_with_exit_3_and_the_constants_stay() {
    let calm = day(5);
    let crashed = calm.lines().map(|line| {
        let cells: Vec<&str> = line.split(',').collect();
        match cells[2].parse::<f64>() {
            Ok(um) => format!("{},{},{:.3}\n", cells[0], cells[1], um + 20.0),
            Err(_) => format!("{line}\n"),
        }
    });
    let crashed: String = crashed.collect();
    let days: Vec<String> = (1..5).map(day).collect();
    let files = [
        ("m.toml", MACHINE),
        ("1.csv", &days[0]),
        ("2.csv", &days[1]),
        ("3.csv", &days[2]),
        ("4.csv", &days[3]),
        ("5.csv", &crashed),
    ];
    let desk = Desk::new(&files);
    for record in ["1.csv", "2.csv", "3.csv", "4.csv"] {
        learned_from(&desk, "m.toml", record, 0);
    }
    let before = desk.text("learned.toml");
    let (out, _) = learned_from(&desk, "m.toml", "5.csv", 3);
    assert!(out.contains("event: zero-step") && out.contains("Was there a crash"), "{out}");
    let number = |text: &str| -> f64 {
        let line = text.lines().find_map(|line| line.strip_prefix("k_um_per_c = "));
        line.and_then(|line| line.split('#').next())
            .expect("there")
            .trim()
            .parse()
            .expect("a number")
    };
    assert!((number(&before) - number(&desk.text("learned.toml"))).abs() < 0.05);
    let state: Value = serde_json::from_str(&desk.text("learned.learn.json")).expect("JSON");
    let event = &state["events"][0];
    assert_eq!(event["event"], "zero-step", "{event}");
    assert!((event["size"].as_f64().expect("a number") - 20.0).abs() < 1.5, "{event}");
    assert!(event["at"] == 432_000.0 && event["unit"] == "µm" && event["ci95"][1].is_number());
    // It is reported once.
    let (out, _) = learned_from(&desk, "m.toml", "5.csv", 0);
    assert!(!out.contains("event:"), "{out}");
}

#[test]
fn equal_runs_compared_by_a_limit_below_their_scatter_end_with_0() {
    let run = |seed: usize, more: f64| {
        let noise = [1.9, -1.4, 0.3, 2.2, -2.4, 0.8, -1.1, 1.2, -0.2, 2.6, -1.8];
        let mut text = "run,x_mm,dir_x,measured_dx_um\n".to_string();
        for n in 0..50 {
            let um = noise[(n * 7 + seed * 3) % 11] + more * (n % 10) as f64;
            text += &format!("{},{},1,{um:.2}\n", n / 10 + 1, 100 * (n % 10));
        }
        text
    };
    let files = [("a.csv", &run(0, 0.0)[..]), ("b.csv", &run(1, 0.0)), ("c.csv", &run(1, 3.0))];
    let desk = Desk::new(&files);
    let (out, _) = desk.run_expecting("compare a.csv b.csv --limit-um 0.01", 0);
    assert!(out.contains("no difference"), "{out}");
    desk.run_expecting("compare a.csv c.csv --limit-um 5", 3);
}

#[test]
fn a_short_record_without_a_clock_is_refused_by_its_measured_column() {
    let rows: String = (0..15).map(|n| format!("{n}.5,{n}\n")).collect();
    let short = format!("temp_a_c,measured_elongation_um\n{rows}");
    let desk = Desk::new(&[("m.toml", MACHINE), ("short.csv", &short)]);
    let (_, err) = desk.run_expecting("trust m.toml --calibrated short.csv --run short.csv", 2);
    assert!(err.contains("measured_elongation_um has 15 rows") && !err.contains("time_s"), "{err}");
}
