//! Calibrations of machine files that `fit` has written, by length and CRC: what a rename or a tidier sum must not change.
//! `golden_blobs` of `trueup-machine` has those of the shipped machine files.
//!
//! A fit that became better changes its number here, and that is fine: a board keeps what it was loaded with until a
//! new calibration is confirmed.

use std::path::{Path, PathBuf};

use trueup_fit::{FitReport, elongation, pitch, straightness, straightness_report, thermal};
use trueup_machine::{
    MachineFile, RunFile, applied_offsets::UncompensatedRun, compile, machine_file::LinearAxis,
};
use trueup_store::calibration::calibration_crc;

use crate::support::unaided;

/// A machine of which nothing is known but its inputs.
const BARE: &str = "[machine]\nname = \"m\"\nkind = \"3-axis\"\n\n[inputs]\n\
                    sensor = { volts_full_scale = 10.0, counts_full_scale = 32768, divider = 0.33 }\n\
                    temp_a_c = { channel = 0, kind = \"pt100\" }\n";

fn shipped(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../data").join(name)
}

fn read(path: &Path) -> UncompensatedRun<'static> {
    unaided(RunFile::read(path).expect("a run file"))
}

/// Returns length and CRC of what the machine file `text` compiles to with what was fitted.
fn length_and_crc(text: &str, report: &FitReport) -> (usize, u32) {
    assert!(report.verdict.is_usable(), "{:?}", report.verdict);
    let fitted = report.edit.apply(text, Path::new("m.toml")).expect("it loads");
    let machine = MachineFile::parse(&fitted, Path::new("m.toml")).expect("what was written");
    let compiled = compile(&machine).expect("it fits the board");
    (compiled.blob().len(), calibration_crc(compiled.blob()))
}

fn fit_pitch(run: &UncompensatedRun<'_>) -> FitReport {
    pitch::fit(run, LinearAxis::X, &pitch::PitchFitOptions::default()).expect("a fit").report
}

fn fit_backlash(run: &UncompensatedRun<'_>) -> FitReport {
    pitch::fit_backlash(run, LinearAxis::X, &pitch::PitchFitOptions::default())
        .expect("a fit")
        .report
}

fn fit_growth(run: &UncompensatedRun<'_>, text: &str) -> FitReport {
    let machine = MachineFile::parse(text, Path::new("m.toml")).expect("the test's own");
    let options = elongation::ElongationFitOptions::default();
    elongation::fit_elongation(std::slice::from_ref(run), Some(&machine), &options).expect("a fit")
}

fn fit_heat(run: &UncompensatedRun<'_>, axis: LinearAxis, temperature: &str) -> FitReport {
    let options = thermal::ThermalFitOptions {
        temperature: Some(temperature.into()),
        ..thermal::ThermalFitOptions::default()
    };
    thermal::fit(std::slice::from_ref(run), axis, None, &options).expect("a fit")
}

fn fit_curve(run: &UncompensatedRun<'_>) -> FitReport {
    let options = straightness::StraightnessFitOptions::default();
    straightness_report::fit_curve(run, Some("dz"), |_| Ok(None), &options).expect("a fit")
}

#[test]
fn fits_of_the_projects_own_runs_compile_to_the_bytes_they_did() {
    let text = |name: &str| std::fs::read_to_string(shipped(name)).expect("it is shipped");
    let (mill, paper) = (text("mill/mill.toml"), text("paper_spindle.toml"));
    let run = |name: &str| read(&shipped(name));
    let found = [
        (
            "spindle_paper_table1",
            length_and_crc(&paper, &fit_growth(&run("spindle_paper_table1.csv"), &paper)),
        ),
        ("warmup-off", length_and_crc(&mill, &fit_growth(&run("mill/warmup-off.csv"), &mill))),
        ("backlash-x", length_and_crc(&mill, &fit_backlash(&run("mill/backlash-x.csv")))),
        ("pitch-x", length_and_crc(&mill, &fit_pitch(&run("mill/pitch-x.csv")))),
        ("straightness-x", length_and_crc(&mill, &fit_curve(&run("mill/straightness-x.csv")))),
        (
            "axis-heat-x",
            length_and_crc(
                &mill,
                &fit_heat(&run("mill/axis-heat-x.csv"), LinearAxis::X, "temp_screw_x_c"),
            ),
        ),
    ];
    let expected = [
        ("spindle_paper_table1", (613, 0x14A9_8CE5)),
        ("warmup-off", (612, 0xFB9E_DEB3)),
        ("backlash-x", (612, 0xFE37_D1E8)),
        ("pitch-x", (692, 0x93FA_D1B0)),
        ("straightness-x", (654, 0x1A3C_E99A)),
        ("axis-heat-x", (632, 0x0CBC_95BC)),
    ];
    assert_eq!(found, expected);
}

/// Of measured runs that the project may not carry: `docs/measured-data.md`.
#[test]
fn fits_of_measured_runs_compile_to_the_bytes_they_did() {
    let expected = [
        ("ess_iso230/x", (681, 0x1504_204A)),
        ("ess_iso230/z", (629, 0x9A54_D5E1)),
        ("voron_frame_expansion/run1", (689, 0x6424_F34E)),
        ("voron_frame_expansion/run3", (629, 0x03EE_F432)),
        ("voron_frame_expansion/run4", (629, 0x96A5_410A)),
    ];
    let frame = BARE.replace("temp_a_c", "temp_frame_c");
    let mut found = expected;
    for (name, bytes) in &mut found {
        let Some(path) = trueup_measured_data::find_measured_file(&format!("{name}.csv")) else {
            return;
        };
        let run = read(&path);
        *bytes = match name.starts_with("ess_iso230") {
            true => length_and_crc(BARE, &fit_pitch(&run)),
            false => length_and_crc(&frame, &fit_heat(&run, LinearAxis::Z, "temp_frame_c")),
        };
    }
    assert_eq!(found, expected);
}
