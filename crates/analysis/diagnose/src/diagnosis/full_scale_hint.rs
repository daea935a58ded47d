//! Hints: what a figure that was found reminds of, by a rule, and how to check it. No cause depends on them.

use trueup_machine::{Machine, inputs::SensorInput};

use crate::diagnosis::report::Finding;

/// Inputs for 0–10 V or ±10 V: the counts at full scale, and the largest count that such an input gives. An S7 analogue
/// input (rated range and overrange: SIMATIC manual, representation of analogue values), and one of 15 bits and a sign.
const ANALOGUE_INPUT_FULL_SCALES: [(f64, f64, &str); 2] =
    [(27_648.0, 32_511.0, "an S7 analogue input"), (32_768.0, 32_768.0, "an input of 16 bits")];

/// Where a gain of the sensor would be gone, or a part of it, if the input's full scale were that of another
/// usual input: which, how much of the gain that is, and how to check it. `law_um`: what the sensor's own law
/// says of each row, from which its counts follow.
pub(super) fn full_scale_hints(
    machine: &Machine,
    findings: &[Finding],
    law_um: &[f64],
) -> Vec<String> {
    let sensor = machine.inputs.as_ref().and_then(|inputs| inputs.sensor.as_ref());
    let gain = findings.iter().find_map(|finding| finding.parameters.get("gain"));
    let (Some(sensor), Some(gain)) = (sensor, gain) else { return Vec::new() };
    let counts = machine.spindle.sensor.as_ref().map(|model| {
        let counts = |um: &f64| model.zero_counts + (um - model.k0_um) / model.um_per_count;
        law_um.iter().map(counts).fold(f64::NEG_INFINITY, f64::max)
    });
    let largest_counts = counts.filter(|counts| counts.is_finite());
    let value = gain["value"].as_f64().unwrap_or(f64::NAN);
    let ci95 = [0, 1].map(|end| gain["ci95"][end].as_f64().unwrap_or(value));
    full_scale_hint(sensor, value, ci95, largest_counts).into_iter().collect()
}

fn full_scale_hint(
    sensor: &SensorInput,
    gain: f64,
    ci95: [f64; 2],
    largest_counts: Option<f64>,
) -> Option<String> {
    let SensorInput { volts_full_scale, counts_full_scale, .. } = *sensor;
    let believed = counts_full_scale;
    let is_all = |ratio: &f64| (ci95[0]..=ci95[1]).contains(ratio);
    let is_part = |ratio: &f64| (1.0..gain).contains(ratio) || (gain..1.0).contains(ratio);
    let (counts, name, ratio) = ANALOGUE_INPUT_FULL_SCALES
        .into_iter()
        // Not the one that is believed, within a count.
        .filter(|(counts, ..)| (counts - believed).abs() > 1.5)
        .filter(|(_, most, _)| largest_counts.is_none_or(|largest| largest <= *most))
        .map(|(counts, _, name)| (counts, name, believed / counts))
        .find(|(.., ratio)| is_all(ratio) || is_part(ratio))?;
    let share = if is_all(&ratio) {
        "that alone would be this gain".to_string()
    } else {
        format!("that would be {ratio:.3} of this gain, and {:.3} is something else", gain / ratio)
    };
    Some(format!(
        "The machine file takes {volts_full_scale} V as {believed} counts; {name} reaches it at {counts}: \
         {share}. To check: put {volts_full_scale} V on the input and read its counts."
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    const PAPER: SensorInput =
        SensorInput { volts_full_scale: 10.0, counts_full_scale: 32_768.0, divider: 0.33 };

    fn hint(gain: f64, ci95: [f64; 2], largest: Option<f64>) -> Option<String> {
        full_scale_hint(&PAPER, gain, ci95, largest)
    }

    #[test]
    fn a_gain_that_another_full_scale_explains_is_hinted_at_with_a_check() {
        let whole = hint(1.19, [1.17, 1.21], None).expect("1.185 is in the interval");
        assert!(whole.contains("27648") && whole.contains("alone") && whole.contains("To check"));
        let part = hint(1.2976, [1.27, 1.32], Some(9164.0)).expect("a part of it");
        assert!(part.contains("1.185") && part.contains("1.095"), "{part}");
        let other = SensorInput { counts_full_scale: 27_648.0, ..PAPER };
        let message = full_scale_hint(&other, 0.85, [0.83, 0.87], None).expect("the other way");
        assert!(message.contains("32768"), "{message}");
    }

    #[test]
    fn no_hint_where_the_other_full_scale_makes_it_worse_or_cannot_be() {
        assert_eq!(hint(1.12, [1.11, 1.13], None), None, "1.185 is more than there is");
        assert_eq!(hint(0.85, [0.84, 0.86], None), None);
        assert_eq!(hint(1.19, [1.17, 1.21], Some(32_600.0)), None, "no S7 gives such a reading");
    }
}
