//! Values that a machine hardly has are reported, and those that it cannot have are refused until they are
//! accepted, by every command that reads or writes them.

use crate::desk::Desk;

const HEAD: &str = "[machine]\nname = \"m\"\nkind = \"3-axis\"\n";
const REVERSED: &str = "the sign is reversed: errors are actual minus commanded";

fn desk() -> Desk {
    let lash = |um: f64| {
        format!("{HEAD}[axis.x]\ntravel_mm = [0.0, 400.0]\n[axis.x.backlash]\nwidth_um = {um:?}\n")
    };
    Desk::new(&[("m.toml", HEAD), ("negative.toml", &lash(-7.3)), ("hard.toml", &lash(6100.0))])
}

/// Five sweeps there and back with a backlash of 7.3 µm, or with the error reversed.
fn sweeps(sign: f64) -> String {
    let mut text = String::from("time_s,run,x_mm,dir_x,measured_dx_um\n");
    let mut time_s = 0;
    for run in 0..5 {
        for dir in [1, -1] {
            for step in 0..11 {
                let place = if dir == 1 { step } else { 10 - step };
                let lash = if dir == 1 { 0.0 } else { 7.3 };
                let noise = f64::from((time_s * 7 + run * 3) % 11 - 5) * 0.04;
                let um = sign * (lash + noise);
                text += &format!("{time_s},{run},{},{dir},{um:.3}\n", 40 * place);
                time_s += 3;
            }
        }
    }
    text
}

#[test]
fn a_reversed_backlash_is_reported_by_every_command_that_makes_or_reads_it() {
    let desk = desk();
    desk.write("right.csv", sweeps(1.0));
    desk.write("reversed.csv", sweeps(-1.0));
    for fit in ["pitch", "backlash"] {
        let line = |run: &str| format!("fit {fit} --run {run}.csv --machine m.toml -o f.toml");
        assert!(desk.run_expecting(&line("reversed"), 0).1.contains(REVERSED), "{fit}");
        assert!(desk.path("f.toml").exists(), "a warning does not keep it from being written");
        assert!(!desk.run_expecting(&line("right"), 0).1.contains(REVERSED), "{fit}");
    }
    for (line, code) in [
        ("check negative.toml", 3),
        ("compile negative.toml -o c.bin", 0),
        ("show c.bin", 0),
        ("export negative.toml --format fanuc -o e", 0),
        ("diagnose --machine m.toml --run reversed.csv --out d", 0),
    ] {
        let (_, err) = desk.run_expecting(line, code);
        assert!(err.contains(REVERSED), "{line}: {err}");
    }
}

#[test]
fn an_impossible_value_is_refused_and_not_written_until_its_key_is_accepted() {
    let desk = desk();
    desk.write("r.csv", sweeps(1.0));
    let key = "axis.x.backlash.width_um";
    for (line, code, written) in [
        ("check hard.toml", 3, None),
        ("compile hard.toml -o c.bin", 0, Some("c.bin")),
        ("export hard.toml --format linuxcnc -o e", 0, Some("e")),
        ("fit pitch --run r.csv --machine hard.toml -o f.toml", 0, Some("f.toml")),
        ("predict --machine hard.toml --run r.csv -o p.csv", 0, Some("p.csv")),
        ("show c.bin", 0, None),
    ] {
        if !line.starts_with("show") {
            // As it is, with its help.
            let refused = desk.trueup(line);
            let err = String::from_utf8(refused.stderr).expect("UTF-8");
            assert_eq!(refused.status.code(), Some(2), "{line}: {err}");
            assert!(err.contains(&format!("{key} 6100 µm is impossible")), "{line}: {err}");
            assert!(err.contains(&format!("--accept {key}")), "{line}: {err}");
            assert!(written.is_none_or(|file| !desk.path(file).exists()), "{line}");
        }
        let (_, err) = desk.run_expecting(&format!("{line} --accept {key}"), code);
        assert!(err.contains("impossible"), "reported even where it is accepted: {line}: {err}");
        assert!(written.is_none_or(|file| desk.path(file).exists()), "{line}");
    }
    let load = "bridge load c.bin --port tcp:127.0.0.1:1 --yes";
    assert!(desk.run_expecting(load, 2).1.contains(&format!("--accept {key}")));
    // Accepted, the next thing that is wrong is that nobody answers there.
    assert!(
        !desk.run_expecting(&format!("{load} --accept {key}"), 1).1.contains("not written or used")
    );
}

#[test]
fn what_a_fit_makes_is_held_against_the_ranges_before_it_is_written() {
    let desk = desk();
    // Milliseconds as time_s: the lag comes out as 600 000 s.
    let mut text = String::from("time_s,temp_a_c,measured_elongation_um\n");
    let (mut warm, mut lagged) = (0.0_f64, 0.0_f64);
    for row in 0..300 {
        let target = if row % 200 < 120 { 14.0 } else { 0.0 };
        warm += (target - warm) * 0.03;
        lagged += (warm - lagged) * (1.0 - (-20.0_f64 / 600.0).exp());
        text += &format!("{},{:.3},{:.3}\n", row * 20_000, 20.0 + warm, 2.4 * lagged);
    }
    desk.write("ms.csv", text);
    let line = "fit elongation --run ms.csv --machine m.toml --source temperature -o f.toml";
    let (_, err) = desk.run_expecting(line, 2);
    assert!(err.contains("looks like ms, not s"), "{err}");
    let line = &format!("{line} --accept time_s");
    let (_, err) = desk.run_expecting(line, 2);
    assert!(err.contains("spindle.temperature.lag_s") && err.contains("ms instead of s"), "{err}");
    assert!(!desk.path("f.toml").exists());
    desk.run_expecting(&format!("{line} --accept spindle.temperature.lag_s"), 0);
    assert!(desk.path("f.toml").exists());
}
