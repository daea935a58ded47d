//! `trueup fleet` as users run it: submit, workers that are killed, results equal to those of `trueup diagnose`, and the
//! series.

use std::{
    fs,
    process::{Child, Command, Stdio},
    thread,
    time::{Duration, Instant},
};

use serde_json::Value;
use trueup_numerics::random::RandomGenerator;

use crate::desk::Desk;

const MACHINE: &str =
    "[machine]\nname = \"mill\"\nkind = \"3-axis\"\n[instrument]\nuncertainty_um = 0.5\n";

/// Returns a run of an axis whose scale is long by `um_per_m`.
fn run(seed: u64, um_per_m: f64) -> String {
    let mut generator = RandomGenerator::new(seed);
    let mut text = String::from("run,x_mm,dir_x,measured_dx_um\n");
    for cycle in 1..=3 {
        for way in [1, -1] {
            for target in 0..11 {
                let mm = if way > 0 {
                    50.0 * f64::from(target)
                } else {
                    500.0 - 50.0 * f64::from(target)
                };
                let um = um_per_m * mm / 1000.0 + 0.3 * generator.normal();
                text += &format!("{cycle},{mm},{way},{um:.3}\n");
            }
        }
    }
    text
}

fn desk_with(jobs: usize) -> Desk {
    let desk = Desk::new(&[("m.toml", MACHINE)]);
    for job in 0..jobs {
        let name = format!("r{job}.csv");
        desk.write(&name, run(job as u64, 10.0));
        desk.run_expecting(
            &format!("fleet submit --dir shop --machine m.toml --run {name} --name M{job}"),
            0,
        );
    }
    desk
}

fn status(desk: &Desk) -> Value {
    let (out, _) = desk.run_expecting("--json fleet status --dir shop", 0);
    serde_json::from_str(&out).expect("JSON")
}

fn worker(desk: &Desk, lease_s: f64) -> Child {
    Command::new(env!("CARGO_BIN_EXE_trueup"))
        .args(["fleet", "worker", "--dir", "shop", "--until-empty", "--lease-s"])
        .arg(lease_s.to_string())
        .current_dir(desk.path("."))
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .expect("the tool was built for this test")
}

#[test]
fn a_result_has_the_bytes_of_diagnose() {
    let desk = desk_with(2);
    let (out, _) = desk.run_expecting("fleet worker --dir shop --threads 2 --until-empty", 0);
    assert!(out.starts_with("2 done, 0 failed"), "{out}");
    let (out, _) = desk
        .run_expecting("--json fleet submit --dir shop --machine m.toml --run r1.csv --name M1", 0);
    let submitted: Value = serde_json::from_str(&out).expect("JSON");
    assert_eq!(submitted["new"], false);
    let id = submitted["id"].as_str().expect("an identifier");
    let single = desk.trueup("diagnose --machine m.toml --run r1.csv --out d");
    assert!(matches!(single.status.code(), Some(0 | 3)));
    let out = format!("shop/results/{id}/out");
    assert_eq!(desk.files(&out), desk.files("d"));
    for name in ["diagnosis.json", "extended.toml", "residuals.csv"] {
        assert!(desk.read(&format!("{out}/{name}")) == desk.read(&format!("d/{name}")), "{name}");
    }
    // The page names its folder in the lines to be typed next, and nothing else is its own.
    let page = desk.text(&format!("{out}/report.html")).replace(&out, "d");
    assert_eq!(page, desk.text("d/report.html"));
}

#[test]
fn workers_that_are_killed_lose_nothing_and_each_job_has_one_result() {
    const JOBS: usize = 3;
    let desk = desk_with(JOBS);
    let mut generator = RandomGenerator::new(50);
    let started = Instant::now();
    let mut kills = 0;
    while kills < 50 && started.elapsed() < Duration::from_secs(6) {
        let mut child = worker(&desk, 0.2);
        thread::sleep(Duration::from_secs_f64(0.25 * generator.uniform()));
        child.kill().expect("it is a child of this test");
        child.wait().expect("it has ended");
        kills += 1;
        // What is done stays done, so that every schedule has jobs to interrupt.
        let done = desk.files("shop/results");
        if done.len() == JOBS {
            fs::remove_dir_all(desk.path(&format!("shop/results/{}", done[0]))).expect("removed");
        }
    }
    let ended = worker(&desk, 0.2).wait().expect("it ends by itself");
    assert!(ended.success());
    let status = status(&desk);
    let count = |key: &str| status[key].as_array().map_or(0, Vec::len);
    println!("{kills} kills");
    assert_eq!(
        [count("done"), count("waiting"), count("running"), count("failed")],
        [JOBS, 0, 0, 0]
    );
    assert_eq!(desk.files("shop/tmp"), [] as [String; 0]);
    for entry in status["done"].as_array().expect("a list") {
        let [id, machine] = ["id", "machine"].map(|key| entry[key].as_str().expect("a text"));
        let run = machine.replace('M', "r");
        desk.trueup(&format!("diagnose --machine m.toml --run {run}.csv --out d"));
        for name in ["diagnosis.json", "extended.toml", "residuals.csv"] {
            let there = desk.read(&format!("shop/results/{id}/out/{name}"));
            assert!(there == desk.read(&format!("d/{name}")), "{machine} {name}");
        }
    }
}

#[test]
fn the_odd_machine_of_a_series_is_named_though_the_others_are_clean() {
    let desk = Desk::new(&[("m.toml", MACHINE)]);
    let mut generator = RandomGenerator::new(7);
    for machine in 0..8 {
        let um_per_m = if machine == 5 { 6.0 } else { 0.2 * generator.normal() };
        desk.write("r.csv", run(machine, um_per_m));
        desk.run_expecting(
            &format!("fleet submit --dir shop --machine m.toml --run r.csv --name M{machine}"),
            0,
        );
    }
    desk.run_expecting("fleet worker --dir shop --threads 2 --until-empty", 0);
    let (out, _) = desk.run_expecting("fleet diagnose --dir shop --out series", 3);
    assert!(out.contains("M5 is unlike the others: dx pitch-scale um_per_m is "), "{out}");
    let series: Value = serde_json::from_str(&desk.text("series/fleet.json")).expect("JSON");
    let list = |of: &'_ Value| of.as_array().cloned().unwrap_or_default();
    let machines = list(&series["machines"]);
    let odd = machines
        .iter()
        .filter(|machine| machine["odd"].as_array().is_some_and(|reasons| !reasons.is_empty()));
    assert_eq!(odd.filter_map(|machine| machine["machine"].as_str()).collect::<Vec<_>>(), ["M5"]);
    // Its own diagnosis finds nothing on a healthy machine: what the odd one has is fitted there too.
    assert_eq!(machines[0]["verdict"], "clean");
    let constants = list(&series["constants"]);
    let scale = constants.iter().find(|constant| constant["name"] == "dx pitch-scale um_per_m");
    let values = list(&scale.expect("it is claimed on M5")["values"]);
    assert_eq!(values.len(), 8);
    assert_eq!(
        (&values[0]["claimed"], &values[0]["fitted_for_series"]),
        (&false.into(), &true.into())
    );
    let page = desk.text("series/report.html");
    assert!(page.contains("<svg") && page.contains("odd: M5"), "{page}");
}

#[test]
fn a_constant_that_changes_over_dated_records_drifts() {
    let desk = Desk::new(&[("m.toml", MACHINE)]);
    for (seed, (day, um_per_m)) in
        [("2026-01-10", 5.0), ("2026-05-10", 9.0), ("2026-11-10", 15.0)].into_iter().enumerate()
    {
        let name = format!("mill-{day}.csv");
        desk.write(&name, run(seed as u64, um_per_m));
        desk.run_expecting(
            &format!("fleet submit --dir shop --machine m.toml --run {name} --name M"),
            0,
        );
    }
    desk.run_expecting("fleet worker --dir shop --until-empty", 0);
    let (out, _) = desk.run_expecting("fleet diagnose --dir shop --out series", 3);
    assert!(out.contains("M drifts: dx pitch-scale um_per_m changes by 1"), "{out}");
}

#[test]
fn what_is_no_fleet_or_no_run_is_refused_with_what_to_do() {
    let desk = Desk::new(&[("m.toml", MACHINE), ("r.csv", "a,b\n1,2\n"), ("x.csv", "")]);
    let (_, err) = desk.run_expecting("fleet status --dir nowhere", 2);
    assert!(
        err.contains("nowhere: is no folder of a fleet: trueup fleet submit makes it"),
        "{err}"
    );
    desk.run_expecting("fleet submit --dir shop --machine m.toml --run x.csv", 2);
    assert!(!desk.path("shop").exists(), "nothing is made");
    // A run without a measured column is refused by the diagnosis, with its reason in the status.
    desk.run_expecting("fleet submit --dir shop --machine m.toml --run r.csv --name M", 0);
    desk.run_expecting("fleet worker --dir shop --until-empty", 3);
    let (out, _) = desk.run_expecting("fleet status --dir shop", 0);
    assert!(out.contains("1 failed") && out.contains("r.csv"), "{out}");
    let (_, err) = desk.run_expecting("fleet diagnose --dir shop --out series", 2);
    assert!(err.contains("has no result"), "{err}");
}
