//! Runs at another temperature: the expansion that the machine file knows is taken off before runs are compared.

use trueup_machine::{Machine, RunFile, machine_file::LinearAxis, predict::RunPredictor};

/// Returns `run` with the expansion of the axes by `machine` taken off what was measured, and a sentence for the user.
#[must_use]
pub fn remove_thermal_expansion(run: &RunFile, machine: Option<&Machine>) -> (RunFile, String) {
    let as_it_is = || run.with_altered_values(run.row_count(), |_, _| {});
    let measured = |axis: &LinearAxis| format!("measured_d{}_um", axis.name());
    let axes: Vec<LinearAxis> =
        LinearAxis::ALL.into_iter().filter(|axis| run.column(&measured(axis)).is_some()).collect();
    let Some(machine) = machine else {
        return (
            as_it_is(),
            "Runs are as they were measured, at any temperature: with a temperature column and the machine file (--machine) its \
             expansion is taken off."
                .into(),
        );
    };
    let laws: Vec<_> = axes
        .iter()
        .filter_map(|axis| Some((*axis, machine.axes[axis.index()].thermal.as_ref()?)))
        .collect();
    let there = |column: &str| {
        run.column(column).is_some_and(|values| values.iter().any(|c| c.is_finite()))
    };
    if let Some((axis, law)) = laws.iter().find(|(_, law)| !there(&law.sensor)) {
        return (
            as_it_is(),
            format!(
                "The expansion of {} is not taken off: the run has no {}.",
                axis.name().to_uppercase(),
                law.sensor
            ),
        );
    }
    if laws.is_empty() {
        return (
            as_it_is(),
            "No expansion is taken off: the machine file has no [axis.*.thermal] for what was measured."
                .into(),
        );
    }
    let mut only = machine.clone();
    only.spindle.source = None;
    (only.straightness, only.squareness, only.terms) = (Vec::new(), Vec::new(), Vec::new());
    (only.volume.angular, only.volume.rotary) = (Vec::new(), Vec::new());
    for axis in &mut only.axes {
        (axis.pitch, axis.backlash, axis.dual) = (None, None, None);
    }
    let Ok(rows) = RunPredictor::new(&only, run) else {
        return (
            as_it_is(),
            "No expansion is taken off: the run has no column with the position.".into(),
        );
    };
    let grown: Vec<[f64; 4]> = rows.model_values().map(|values| values.to_array()).collect();
    let corrected = run.with_altered_values(run.row_count(), |name, values| {
        let axis = axes.iter().find(|axis| measured(axis) == name);
        if let Some(axis) = axis {
            let rows = values.iter_mut().zip(&grown);
            rows.for_each(|(um, grown)| *um -= grown[axis.index() + 1]);
        }
    });
    (corrected, "The expansion by the machine file is taken off, row by row.".into())
}
