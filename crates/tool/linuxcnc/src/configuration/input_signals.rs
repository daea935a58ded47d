//! The wires of the inputs that the user's HAL files bring (`inputs.rs`), and the messages about those that they do not bring.

use std::fmt::Write as _;

use super::{
    finding::{ConfigurationFinding, OffsetRequirements},
    hal_files::HalFiles,
    ini_file::IniFile,
    inputs::NamedInput,
    servo_hal_lines::{REALTIME_INSTANCE_NAME, TEMPERATURE_TIMEOUT_MS},
};

/// Signals that are connected where they are, and missed nowhere.
const OPTIONAL_SIGNALS: [(&str, &str); 5] = [
    ("trueup-zero", "zero"),
    ("trueup-confirm", "confirm"),
    ("trueup-load", "load-n"),
    ("trueup-angle-1", "angle-1"),
    ("trueup-angle-2", "angle-2"),
];
/// Those of a board alone.
const BOARD_SIGNALS: [(&str, &str); 1] = [("trueup-service", "service")];
/// Those of a bridge without a board.
const BOARDLESS_SIGNALS: [(&str, &str); 2] = [
    ("trueup-sensor-resolution", "sensor-resolution-v"),
    ("trueup-temp-heartbeat", "temp-heartbeat"),
];

/// Returns a finding for each input of the machine file that no HAL file brings.
pub(super) fn find_missing_inputs(
    demand: &OffsetRequirements,
    ini: &IniFile,
    hal: &HalFiles,
) -> Vec<ConfigurationFinding> {
    let missing = all_inputs(demand).filter(|input| !hal.has_signal(&input.signal));
    let finding = |NamedInput { signal, name, example, .. }: &NamedInput| {
        ConfigurationFinding::warning(
            ini.section_location("HAL"),
            format!(
                "no HAL file has the signal {signal}, by which \"{name}\" of the machine file comes in"
            ),
            format!(
                "connect the pin of your input in a HAL file of yours: net {signal} PIN (such as {example})"
            ),
        )
    };
    missing.map(finding).collect()
}

/// Returns whether the angles are sent: all of them have a signal. A pin that nothing drives is 0 degrees, which would turn an
/// offset; without angles the bridge knows that it has none.
pub(super) fn has_all_angle_signals(demand: &OffsetRequirements, hal: &HalFiles) -> bool {
    let has = |number| hal.has_signal(&format!("trueup-angle-{number}"));
    demand.angles > 0 && (1..=demand.angles).all(has)
}

/// Returns the lines that connect the inputs which HAL files bring.
pub(super) fn format_input_nets(demand: &OffsetRequirements, hal: &HalFiles) -> String {
    let own: &[(&str, &str)] =
        if demand.no_board.is_some() { &BOARDLESS_SIGNALS } else { &BOARD_SIGNALS };
    let mut named: Vec<(&str, &str)> =
        all_inputs(demand).map(|input| (input.signal.as_str(), input.pin.as_str())).collect();
    for optional in OPTIONAL_SIGNALS.iter().chain(own) {
        if !named.contains(optional) {
            named.push(*optional);
        }
    }
    let mut text = String::new();
    for (signal, pin) in named.into_iter().filter(|(signal, _)| hal.has_signal(signal)) {
        let _ = writeln!(text, "net {signal} => {REALTIME_INSTANCE_NAME}.{pin}");
    }
    if demand.no_board.is_some() && hal.has_signal("trueup-temp-heartbeat") {
        let _ = writeln!(
            text,
            "setp {REALTIME_INSTANCE_NAME}.temp-timeout-ms {TEMPERATURE_TIMEOUT_MS}"
        );
    }
    text
}

fn all_inputs(demand: &OffsetRequirements) -> impl Iterator<Item = &NamedInput> {
    demand.inputs.iter().chain(demand.no_board.iter().flat_map(|boardless| &boardless.inputs))
}
