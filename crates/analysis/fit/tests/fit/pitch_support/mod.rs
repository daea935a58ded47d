//! Shared parts of the tests of the pitch fit.

use std::{borrow::Cow, fmt::Write as _, path::Path};

use trueup_machine::{
    Machine, MachineFile, RunFile,
    applied_offsets::UncompensatedRun,
    machine_file::writer::MachineFileEdit,
    model::{ReferenceModel, RowInputs},
};

/// Returns the run file with this content.
pub fn run_of(text: &str) -> UncompensatedRun<'static> {
    unaided(
        RunFile::from_reader(text.as_bytes(), Path::new("r.csv"))
            .expect("the test's own text is a run file"),
    )
}

/// Returns a run that no bridge had a part in.
pub fn unaided(run: RunFile) -> UncompensatedRun<'static> {
    UncompensatedRun::from_run(Cow::Owned(run), None, None).expect("no bridge").0
}

/// Returns a run of sweeps up and down over `targets`: `error` in µm of run, position and direction.
pub fn sweeps(
    runs: usize,
    targets: &[f64],
    mut error: impl FnMut(usize, f64, f64) -> f64,
) -> String {
    let mut text = String::from("run,x_mm,dir_x,measured_dx_um\n");
    for run in 1..=runs {
        for &x in targets {
            writeln!(text, "{run},{x},1,{}", error(run, x, 1.0)).expect("a string takes all");
        }
        for &x in targets.iter().rev() {
            writeln!(text, "{run},{x},-1,{}", error(run, x, -1.0)).expect("a string takes all");
        }
    }
    text
}

/// Returns the machine file that `edit` makes of one without an axis.
pub fn machine_of(edit: &MachineFileEdit) -> Machine {
    let source = "[machine]\nname = \"tested\"\nkind = \"3-axis\"\n";
    let path = Path::new("m.toml");
    let written = edit.apply(source, path).expect("the fit writes a machine file");
    MachineFile::parse(&written, path).expect("apply has parsed it")
}

/// Returns what the reference model, which `trueup predict` prints, leaves of `measured_dx_um` on the rows
/// of the named runs.
pub fn left_by_model(run: &RunFile, edit: &MachineFileEdit, runs: &[f64]) -> Vec<f64> {
    let machine = machine_of(edit);
    let mut model = ReferenceModel::new(&machine);
    let column = |name| run.column(name).expect("the run has it");
    let (x, dir, um) = (column("x_mm"), column("dir_x"), column("measured_dx_um"));
    (0..run.row_count())
        .filter(|&row| runs.contains(&column("run")[row]))
        .map(|row| {
            let position_mm = [x[row], f64::NAN, f64::NAN];
            let direction = [dir[row], f64::NAN, f64::NAN];
            let there = RowInputs { position_mm, direction, ..RowInputs::UNKNOWN };
            um[row] - model.step(&there).to_error_values().error_um[0]
        })
        .collect()
}

/// Returns the root mean square.
pub fn rms(um: &[f64]) -> f64 {
    (um.iter().map(|x| x * x).sum::<f64>() / um.len() as f64).sqrt()
}
