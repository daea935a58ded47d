//! Probing in the real LinuxCNC: what the offset does to a probed point, and a probe between jobs that the
//! learner learns of.

use std::fs;

use anyhow::{Context as _, Result, ensure};
use serde_json::json;

use super::{
    kill_component,
    linuxcnc_rig::{CLOSE_UM, GROWN_UM, Rig},
    rest, restart, scenario,
};

/// A surface at this height, in mm of the machine, which the tool touches when it has not grown.
const SURFACE_MM: f64 = -30.0;

/// Closes the probe where the joint is below this height, in mm.
fn touches(rig: &mut Rig, mm: f64) -> Result<()> {
    // A test before this one may have loaded it.
    for words in ["loadrt comp names=touch", "addf touch servo-thread", "net z-pos => touch.in0"] {
        rig.cnc.run_halcmd(words).ok();
    }
    rig.cnc.run_halcmd(&format!("setp touch.in1 {mm}"))?;
    rig.cnc.run_halcmd("net touched touch.out => motion.probe-input").map(drop)
}

#[test]
#[ignore = "long: the real LinuxCNC"]
fn a_probed_point_contains_the_offset_and_a_touched_off_one_does_not() -> Result<()> {
    scenario(GROWN_UM, |rig| {
        rig.cnc.send_request_with_argument("mdi", "text", "G10 L2 P1 Z0")?;
        rig.cnc.send_request_with_argument("mdi", "text", "G53 G0 Z0")?;
        rig.cnc.send_request_with_argument("mdi", "text", "G53 G0 Z-27")?;
        rig.applied()?;
        touches(rig, SURFACE_MM)?;
        let z_of = |rig: &mut Rig, what: &str| -> Result<f64> {
            let stat = rig.cnc.send_request(&json!({"do": "stat"}))?;
            stat[what][2].as_f64().with_context(|| format!("no {what} in {stat}"))
        };
        // As the README has it: the macro takes the offset off the point. (Late by a servo cycle: 2 µm.)
        rig.cnc.send_request_with_argument("mdi", "text", "o<trueup_touch_off> call [10] [120]")?;
        rig.cnc.run_halcmd("unlinkp motion.probe-input")?;
        let (probed, zero) = (z_of(rig, "probed")?, z_of(rig, "g5x")?);
        let offset_um = rig.z_um()?;
        println!(
            "surface at joint {SURFACE_MM} mm, probed {probed:.5} mm, set as zero {zero:.5} mm"
        );
        ensure!(((SURFACE_MM - zero) * 1e3 - offset_um).abs() < 3.0, "the offset is in the point");
        // What the axis was commanded, not where the joint is, is what touching off takes.
        rig.cnc.send_request_with_argument("mdi", "text", "G10 L20 P1 Z0")?;
        let (zero, command) = (z_of(rig, "g5x")?, rig.cnc.read_pin("axis.z.pos-cmd")?);
        ensure!((zero - command).abs() < 1e-6, "zero at {zero}, command {command} mm");
        // The position that LinuxCNC reports contains the offset.
        let (reported, joint) = (z_of(rig, "position")?, rig.cnc.read_pin("joint.2.pos-cmd")?);
        ensure!((reported - joint).abs() < 1e-6, "reported {reported}, joint {joint} mm");
        ensure!((reported - command) * 1e3 > GROWN_UM - CLOSE_UM);
        rig.cnc.send_request_with_argument("mdi", "text", "G10 L2 P1 Z0")?;
        rig.cnc.send_request_with_argument("mdi", "text", "G53 G0 Z0")?;
        rig.cnc.send_request_with_argument("teleop", "on", true)?;
        Ok(())
    })
}

#[test]
#[ignore = "long: the real LinuxCNC"]
fn it_probes_by_itself_and_what_it_finds_reaches_the_learner() -> Result<()> {
    scenario(GROWN_UM, |rig| {
        // The probe closes where the tip, which is below the joint by the growth, reaches the surface.
        let grown = |rig: &mut Rig, um: f64| touches(rig, SURFACE_MM + um * 1e-3);
        let log = |rig: &Rig| {
            fs::read_to_string(rig.cnc.folder().join("trueup_learn.log")).unwrap_or_default()
        };
        let probe = |rig: &mut Rig, um: f64| -> Result<String> {
            let before = log(rig).len();
            grown(rig, um)?;
            // The record has a row of now.
            rest(2_500);
            let call = format!("o<trueup_probe> call [{SURFACE_MM}] [0.5] [60]");
            rig.cnc.send_request_with_argument("mdi", "text", call)?;
            let log_lines = log(rig)[before..].to_string();
            println!("probed at {um} um: {log_lines}");
            Ok(log_lines)
        };
        for file in ["trueup_learn.log", "trueup_learned.toml", "trueup_learned.learn.json"] {
            fs::remove_file(rig.cnc.folder().join(file)).ok();
        }
        rig.cnc.send_request_with_argument("mdi", "text", "G10 L2 P1 X0 Y0 Z0")?;
        rig.cnc.send_request_with_argument("mdi", "text", "G53 G0 Z-20")?;
        let taken = probe(rig, GROWN_UM)?;
        ensure!(taken.contains("1 of 1 readings used"), "what agrees is taken: {taken}");
        let learned = rig.cnc.folder().join("trueup_learned.toml");
        ensure!(learned.exists(), "what was learned is written");
        let refused = probe(rig, GROWN_UM + 150.0)?;
        let reason = refused.contains("0 of 1 readings used") && refused.contains("refused: +1");
        ensure!(reason, "what cannot be is refused, with the reason: {refused}");
        // A record that nobody can write: the reading is not taken, the job goes on, and both logs say why.
        let here = rig.cnc.folder().to_path_buf();
        let record = here.join("trueup_record.csv");
        let known = fs::read_to_string(here.join("trueup_learned.learn.json"))?;
        fs::remove_file(&record)?;
        fs::create_dir(&record)?;
        let missed = probe(rig, GROWN_UM)?;
        let log_lines = fs::read_to_string(here.join("trueup.log"))?;
        let still = fs::read_to_string(here.join("trueup_learned.learn.json"))?;
        fs::remove_dir(&record)?;
        ensure!(missed.contains("trueup_record.csv: cannot be read"), "{missed}");
        ensure!(log_lines.contains("the record cannot be written"), "{log_lines}");
        ensure!(known == still, "nothing was learned from it");
        // The next component writes one again.
        kill_component(rig)?;
        restart(rig)?;
        ensure!(fs::read_to_string(&record)?.starts_with("time_s,"), "it is written again");
        rig.cnc.run_halcmd("unlinkp motion.probe-input").ok();
        rig.cnc.send_request_with_argument("mdi", "text", "G53 G0 X0 Y0 Z0")?;
        rig.cnc.send_request_with_argument("teleop", "on", true)?;
        Ok(())
    })
}
