//! Whether a linear temperature input can give the temperatures that a machine has.
//!
//! A line in the counts of another converter, taken for codes of the board, ends below the first warm day: 4000 counts
//! at 0 °C and 16 for a kelvin would end at 5.4 °C, because the board has 4096 codes.

use trueup_core::sensor_health::{HIGH_RAIL, LOW_RAIL};

use super::{ImplausibleValue, Plausibility};
use crate::{
    check::warning::Warning,
    inputs::{CountScale, LinearInput, TemperatureInputKind},
    machine_file::Machine,
};

/// The temperatures between which machines work, in °C: PT100 chains are chosen for them (5 to 45 °C).
const WORKSHOP_RANGE_C: [f64; 2] = [5.0, 45.0];

/// An input must give at least this part of [`WORKSHOP_RANGE_C`], in K: a spindle's transmitter may begin at 20 °C, and one of
/// a cooler may end at 25 °C.
const MIN_COVERED_RANGE_K: f64 = 10.0;

/// Returns the linear inputs that cannot give the temperatures of a machine, or not the reference of a law that reads them.
pub(super) fn findings(machine: &Machine) -> Vec<ImplausibleValue> {
    let inputs = machine.inputs.iter().flat_map(|inputs| &inputs.temperatures);
    let mut found = Vec::new();
    for (name, input) in inputs {
        let TemperatureInputKind::Linear(line) = input.kind else { continue };
        let key = format!("inputs.{name}");
        let reach = line.temperature_range_c();
        let part_k = reach.map_or(0.0, |[low, high]| {
            high.min(WORKSHOP_RANGE_C[1]) - low.max(WORKSHOP_RANGE_C[0])
        });
        let what = if part_k < MIN_COVERED_RANGE_K {
            let [low, high] = WORKSHOP_RANGE_C;
            format!("{}, and a machine has {low} to {high} °C", describe_range(&line))
        } else if let Some((law, reference_c)) = reference_temperatures_c(machine, name)
            .into_iter()
            .find(|(_, c)| reach.is_some_and(|[low, high]| !(low..=high).contains(c)))
        {
            format!("{}, and {law} is {reference_c} °C", describe_range(&line))
        } else {
            continue;
        };
        let warning = Warning::for_key(machine, &key, &what, scale_help(&line));
        found.push(ImplausibleValue { key, grade: Plausibility::Impossible, warning });
    }
    found
}

/// Returns the temperatures of the input, and where they end.
fn describe_range(line: &LinearInput) -> String {
    let [low, high] = [LOW_RAIL.0 + 1, HIGH_RAIL.0 - 1];
    let last = line.scale.max_count() * line.scale.codes_per_count();
    let ends = [f64::from(low), last.min(f64::from(high))].map(|code| line.celsius_from_code(code));
    let [coldest, warmest] = [ends[0].min(ends[1]), ends[0].max(ends[1])];
    format!(
        "gives {coldest:.1} to {warmest:.1} °C at most (codes {low} to {high} of the board; the ends are faults)"
    )
}

fn scale_help(line: &LinearInput) -> &'static str {
    match line.scale {
        CountScale::Code => {
            "without counts_full_scale a count is a code of the board, 4096 at 3.3 V on the \
             pin. Add counts_full_scale of the converter whose counts these are (27648 for a \
             SIMATIC S7 input, 32768 for the paper's). Or write zero_v and c_per_v"
        }
        CountScale::Volt { .. } => {
            "T = (V − zero_v) · c_per_v: write the volts at 0 °C and the kelvin for one volt of the transmitter"
        }
        CountScale::Count { .. } => {
            "T = (counts − zero_counts)/counts_per_c: write the counts at 0 °C and per kelvin, and the full scale of the same converter in counts and volts"
        }
    }
}

/// Returns the reference temperatures of the laws that read the column, with their keys.
fn reference_temperatures_c(machine: &Machine, column: &str) -> Vec<(String, f64)> {
    let spindle = machine.spindle.temperature.iter().filter(|law| law.sensor == column);
    let mut all: Vec<(String, f64)> = spindle
        .map(|law| ("spindle.temperature.reference_c".to_string(), law.reference_c))
        .collect();
    for axis in crate::sections::LinearAxis::ALL {
        let thermal = machine.axes[axis.index()].thermal.iter();
        for law in thermal.filter(|law| law.sensor == column && law.table.is_none()) {
            all.push((format!("axis.{}.thermal.reference_c", axis.name()), law.reference_c));
        }
    }
    all
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::machine_file::MachineFile;

    fn refused(input: &str, laws: &str) -> Vec<String> {
        let text = format!(
            "[machine]\nname = \"m\"\nkind = \"3-axis\"\n[inputs]\ntemp_a_c = {{ channel = 0, kind = \"linear\", \
             {input} }}\n{laws}"
        );
        let machine =
            MachineFile::parse(&text, Path::new("m.toml")).expect("a file that can be read");
        findings(&machine)
            .into_iter()
            .map(|finding| format!("{}: {}", finding.warning.place, finding.warning.what))
            .collect()
    }

    #[test]
    fn the_papers_line_needs_the_papers_full_scale() {
        // In codes: (4086 − 4000)/16 = 5.4 °C is the end.
        let message = refused("zero_counts = 4000, counts_per_c = 16", "");
        assert!(
            message.len() == 1 && message[0].contains("gives -249.4 to 5.4 °C at most"),
            "{message:?}"
        );
        assert!(message[0].starts_with("m.toml:5:1: inputs.temp_a_c"), "{message:?}");
        let message = refused("zero_counts = 40000, counts_per_c = 16", "");
        assert!(
            message.len() == 1 && message[0].contains("gives -2499.4 to -2244.6"),
            "{message:?}"
        );
        for counts in [27648, 32768] {
            let line =
                format!("zero_counts = 4000, counts_per_c = 16, counts_full_scale = {counts}");
            assert_eq!(refused(&line, ""), [""; 0]);
        }
        let message =
            refused("zero_counts = 40000, counts_per_c = 16, counts_full_scale = 32768", "");
        assert!(message.len() == 1 && message[0].contains("to -452.0 °C"), "{message:?}");
    }

    #[test]
    fn an_input_that_gives_ten_kelvin_of_a_workshop_is_no_fault() {
        assert_eq!(refused("zero_v = 0.0, c_per_v = 10.0", ""), [""; 0]);
        // 4–20 mA over 500 Ω for 20…70 °C, which is 12.5 °C at 0 V less 2 V · 6.25 K/V.
        assert_eq!(refused("zero_v = -1.2, c_per_v = 6.25", ""), [""; 0]);
        assert_eq!(refused("zero_v = 0.0, c_per_v = 1.5", ""), [""; 0], "0 to 15 °C");
        assert_eq!(refused("zero_v = 0.0, c_per_v = 1.4", "").len(), 1, "0 to 14 °C");
        assert_eq!(
            refused("zero_v = 0.0, c_per_v = 2.0, full_scale_v = 5.0", "").len(),
            1,
            "0 to 10 °C"
        );
        assert_eq!(
            refused("zero_v = 10.0, c_per_v = -10.0", ""),
            [""; 0],
            "it falls as it grows warmer"
        );
    }

    #[test]
    fn a_reference_beyond_the_input_is_refused_with_its_key() {
        let law = |c: f64| {
            format!(
                "[axis.x.thermal]\nmode = \"constant\"\nsensor = \"temp_a_c\"\nreference_c = {c:?}\nconstant_um_per_c = 1.0\n"
            )
        };
        let input = "zero_v = 0.0, c_per_v = 3.0";
        assert_eq!(refused(input, &law(20.0)), [""; 0]);
        let message = refused(input, &law(31.0));
        assert!(
            message.len() == 1 && message[0].contains("axis.x.thermal.reference_c is 31 °C"),
            "{message:?}"
        );
    }
}
