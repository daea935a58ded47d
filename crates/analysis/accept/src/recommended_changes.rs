//! Which constant to change by how much: the constants of the machine file against those that the run
//! without compensation shows, each with its interval.

use std::borrow::Cow;

use serde::Serialize;
use trueup_fit::{FitReport, elongation, thermal, warmup};
use trueup_machine::{
    InputFileError, Machine, MachineFile, RunFile,
    applied_offsets::{FactorEstimate, UncompensatedRun},
    machine_file::{ElongationSource, LinearAxis, ThermalMode},
};
use trueup_page::format_with_interval;

use crate::paired_readings::PairedReadings;

/// A change below this share of a constant is none that can be seen: 1 % of a reduction of 90 % asked for
/// is a tenth of what may be left.
const MIN_RELATIVE_CHANGE: f64 = 0.01;

/// Advice on the machine file and the CNC.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Recommendations {
    /// A sentence each.
    pub sentences: Vec<String>,
    /// The constants to change.
    pub changes: Vec<ConstantChange>,
}

/// A constant of the machine file that is not what the run shows.
#[derive(Clone, Debug, Serialize)]
pub struct ConstantChange {
    /// Its section and key: `spindle.warmup.max_um`.
    pub key: String,
    /// The value in the file.
    pub from: f64,
    /// The value that the run without compensation shows.
    pub to: f64,
    /// Its interval, 95 %; absent for what follows from other constants.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ci95: Option<[f64; 2]>,
}

impl Recommendations {
    pub(crate) fn no_change() -> Self {
        Self { sentences: vec!["Nothing is to be changed.".into()], changes: Vec::new() }
    }

    /// Where the CNC applies the offset otherwise than once: no constant makes up for that.
    pub(crate) fn cnc_troubleshooting() -> Self {
        Self { sentences: FactorEstimate::troubleshooting_steps(), changes: Vec::new() }
    }
}

/// Returns what to change, and the machine file with it.
///
/// # Errors
/// The run without compensation cannot be compared with the machine file.
pub(crate) fn recommend_changes(
    pair: &PairedReadings,
    off: &RunFile,
    believed: Option<(&str, &Machine)>,
) -> Result<(Recommendations, Option<String>), InputFileError> {
    let mut advice =
        Recommendations { sentences: vec![describe_corrected_fraction(pair)], changes: Vec::new() };
    let Some((source, machine)) = believed else {
        advice.sentences.push(
            "Give the machine file that the bridge ran (--machine) to learn which constant to change."
                .into(),
        );
        return Ok((advice, None));
    };
    let (unaided, _) = UncompensatedRun::from_run(Cow::Borrowed(off), None, Some(pair.quantity))?;
    let runs = [unaided];
    let Some((section, report)) = fit_section_constants(pair, machine, &runs)? else {
        advice.sentences.push(
            "No constants of this machine file can be fitted to such a run; trueup diagnose shows what it gets wrong."
                .into(),
        );
        return Ok((advice, None));
    };
    if !report.verdict.is_usable() {
        advice.sentences.push(
            "The run without compensation does not show these constants well enough to change any; record \
             for longer, or ask trueup diagnose."
                .into(),
        );
        return Ok((advice, None));
    }
    let adjusted = report.edit.apply(source, off.path())?;
    let after = MachineFile::parse(&adjusted, off.path())?;
    let shown = section_constants(&section, &after);
    for (key, from) in section_constants(&section, machine) {
        let Some((_, to)) = shown.iter().copied().find(|(other, _)| *other == key) else {
            continue;
        };
        let ci95 = report.parameter(key).and_then(|change| change.ci95);
        if (to - from).abs() > MIN_RELATIVE_CHANGE * from.abs().max(to.abs()) {
            let key = format!("{section}.{key}");
            advice.sentences.push(describe_constant_change(&key, from, to, ci95));
            advice.changes.push(ConstantChange { key, from, to, ci95 });
        }
    }
    if advice.changes.is_empty() {
        advice.sentences.push(
            "The constants are those that the run without compensation shows. So what is left \
             has another cause, or the bridge has not run this file. trueup diagnose looks for \
             it."
            .into(),
        );
        return Ok((advice, None));
    }
    Ok((advice, Some(adjusted)))
}

/// Returns how much of what the machine does the bridge corrects: least squares of (off − on) over off.
fn describe_corrected_fraction(pair: &PairedReadings) -> String {
    let rows = || pair.off_um.iter().zip(&pair.on_um);
    let corrected: f64 = rows().map(|(off, on)| off * (off - on)).sum();
    let whole: f64 = pair.off_um.iter().map(|off| off * off).sum();
    let share = corrected / whole;
    match share {
        share if !share.is_finite() => "There is no error to be corrected.".into(),
        share if share < 0.05 => {
            "The bridge corrects next to nothing of it: is it engaged, and are its offsets applied?".into()
        }
        share if share < 0.97 => format!(
            "The bridge corrects {:.0} % of what the machine does: on the whole {:.2} times as much is needed.",
            100.0 * share,
            1.0 / share
        ),
        share if share > 1.03 => format!(
            "The bridge corrects {:.0} % of what the machine does: on the whole {:.2} of it is needed.",
            100.0 * share,
            1.0 / share
        ),
        _ => "On the whole the bridge corrects as much as is needed: what is left has another course.".into(),
    }
}

fn describe_constant_change(key: &str, from: f64, to: f64, ci95: Option<[f64; 2]>) -> String {
    let (shown, interval) = match ci95 {
        Some(ci95) => {
            let [to, low, high] = format_with_interval(to, ci95);
            (to, format!(" (95 %: {low} … {high})"))
        }
        None => (format_four_significant_digits(to), String::new()),
    };
    let change =
        if from == 0.0 { String::new() } else { format!(", {:+.0} %", 100.0 * (to / from - 1.0)) };
    format!(
        "Change {key} from {} to {shown}{interval}{change}.",
        format_four_significant_digits(from)
    )
}

/// Returns a number in its first four digits.
pub(crate) fn format_four_significant_digits(number: f64) -> String {
    format!("{number:.3e}").parse::<f64>().unwrap_or(number).to_string()
}

/// Returns the fit of the law that the machine file corrects the pair's quantity by, and its section.
fn fit_section_constants(
    pair: &PairedReadings,
    machine: &Machine,
    runs: &[UncompensatedRun<'_>],
) -> Result<Option<(String, FitReport)>, InputFileError> {
    let Some(axis) = pair.quantity.axis() else {
        return Ok(match machine.spindle.source {
            Some(ElongationSource::Warmup) => {
                Some(("spindle.warmup".into(), warmup::fit(runs, Some(machine))?))
            }
            Some(source) => {
                let name = match source {
                    ElongationSource::Sensor => "spindle.sensor",
                    _ => "spindle.temperature",
                };
                let options =
                    elongation::ElongationFitOptions { source: Some(source), temperature: None };
                Some((name.into(), elongation::fit_elongation(runs, Some(machine), &options)?))
            }
            None => None,
        });
    };
    if machine.axes[axis.index()].thermal.is_none() {
        return Ok(None);
    }
    let options = thermal::ThermalFitOptions {
        mode: None::<ThermalMode>,
        temperature: None,
        table_rows: None,
        known_um: None,
    };
    let name = format!("axis.{}.thermal", axis.name());
    Ok(Some((name, thermal::fit(runs, axis, Some(machine), &options)?)))
}

/// Returns the constants of a section, by their keys.
fn section_constants(section: &str, machine: &Machine) -> Vec<(&'static str, f64)> {
    let spindle = &machine.spindle;
    let of_axis = |axis: &LinearAxis| section == format!("axis.{}.thermal", axis.name());
    match section {
        "spindle.warmup" => spindle.warmup.as_ref().map_or(Vec::new(), |warmup| {
            let own = [
                ("lag_s", warmup.lag_s),
                ("warm_s", warmup.warm_s),
                ("max_um", warmup.max_um),
                ("exponent", warmup.exponent),
            ];
            // Where the file does not state it, it follows from the others.
            own.into_iter().chain(warmup.cool_s.map(|cool_s| ("cool_s", cool_s))).collect()
        }),
        "spindle.sensor" => spindle.sensor.as_ref().map_or(Vec::new(), |sensor| {
            vec![("k0_um", sensor.k0_um), ("um_per_count", sensor.um_per_count)]
        }),
        "spindle.temperature" => spindle.temperature.as_ref().map_or(Vec::new(), |temperature| {
            vec![
                ("k_um_per_c", temperature.k_um_per_c),
                ("reference_c", temperature.reference_c),
                ("lag_s", temperature.lag_s),
            ]
        }),
        _ => LinearAxis::ALL
            .into_iter()
            .find(of_axis)
            .and_then(|axis| machine.axes[axis.index()].thermal.as_ref())
            .map_or(Vec::new(), |law| {
                vec![
                    ("constant_um_per_c", law.constant_um_per_c),
                    ("slope_um_per_m_per_c", law.slope_um_per_m_per_c),
                    ("reference_c", law.reference_c),
                    ("lag_s", law.lag_s),
                ]
            }),
    }
}
