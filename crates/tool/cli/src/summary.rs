//! The effect of a machine file, in words.

use trueup_machine::{
    Machine,
    check::{AxisSummary, MachineSummary, no_correction_warning},
    model::required_columns,
};

/// Returns a line for the machine, each axis, the limits, the sensor and the board.
pub fn summary_text(machine: &Machine, summary: &MachineSummary) -> String {
    let mut lines = vec![format!("\"{}\", {}", machine.name.escape_debug(), machine.kind.name())];
    lines.extend(summary.axes.iter().map(describe_axis));
    lines.push(format!(
        "changes by at most {} µm/s: 1 % of the rapid traverse of axes from {:.0} mm/min on",
        summary.slew_um_per_s, summary.slowest_rapid_mm_per_min
    ));
    if !summary.jumps_pass.is_empty() {
        let names: Vec<String> =
            summary.jumps_pass.iter().map(|axis| axis.name().to_uppercase()).collect();
        lines.push(format!(
            "a position of {} that jumps is accepted: no rapid_mm_per_min states how fast the axis can move",
            names.join(", ")
        ));
    }
    if let Some(sensor) = &summary.sensor {
        lines.push(format!(
            "sensor: {:.1} µm from 0 to {} V ({} counts); {:.4} µm a count, {:.4} µm a code of the board's \
             converter, which it averages",
            sensor.range_um,
            sensor.volts_full_scale,
            sensor.counts_full_scale,
            sensor.um_per_count,
            sensor.um_per_code
        ));
    }
    let unused = find_unused_inputs(machine);
    if !unused.is_empty() {
        lines.push(format!("inputs that no law uses: {}", unused.join(", ")));
    }
    if let Some(nothing) = no_correction_warning(machine) {
        lines.push(format!("{}; {}", nothing.what.trim_start_matches("machine "), nothing.help));
    }
    lines.push(match &summary.bytes {
        Ok(bytes) => {
            let share = 100.0 * *bytes as f64 / summary.most_bytes as f64;
            format!("on the board: {bytes} of {} bytes ({share:.0} %)", summary.most_bytes)
        }
        Err(error) => format!("not on the board: {}", error.rule),
    });
    lines.join("\n  ")
}

/// Returns the inputs that are described and that nothing on the board goes by.
fn find_unused_inputs(machine: &Machine) -> Vec<String> {
    let used = required_columns(&machine.with_only_compensated_terms());
    let Some(inputs) = &machine.inputs else { return Vec::new() };
    let sensor = inputs.sensor.is_some().then_some(("sensor", "sensor_counts"));
    let names = inputs.temperatures.keys().map(|name| (name.as_str(), name.as_str()));
    let unused = sensor
        .into_iter()
        .chain(names)
        .filter(|(_, column)| !used.iter().any(|other| other == column));
    unused.map(|(name, _)| name.to_string()).collect()
}

fn describe_axis(axis: &AxisSummary) -> String {
    let name = axis.axis.name().to_uppercase();
    if axis.parts.is_empty() {
        return format!("{name}: not corrected");
    }
    let parts: Vec<String> = axis
        .parts
        .iter()
        .map(|part| match part.largest_um {
            Some(um) => format!("{} {um:.1}", part.key),
            None => format!("{} ?", part.key),
        })
        .collect();
    let largest = match axis.max_total_error_um() {
        Some(um) => format!("up to {um:.1} µm"),
        None => {
            "as far as its parts go (? grows with an input that the file does not state)".into()
        }
    };
    format!("{name}: {largest}, held to {} µm: {}", axis.limit_um, parts.join(" + "))
}
