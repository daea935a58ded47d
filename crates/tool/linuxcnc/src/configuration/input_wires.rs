//! The wires of the inputs that the user's HAL files bring (`inputs.rs`), and what is said of those that they do not bring.

use std::fmt::Write as _;

use super::{
    finding::{Demand, Finding},
    hal_files::HalFiles,
    ini_lines::IniLines,
    inputs::NamedInput,
    servo_lines::{FUNCTION, TEMPERATURE_TIMEOUT_MS},
};

/// Signals that are connected where they are, and missed nowhere.
const OPTIONAL: [(&str, &str); 5] = [
    ("trueup-zero", "zero"),
    ("trueup-confirm", "confirm"),
    ("trueup-load", "load-n"),
    ("trueup-angle-1", "angle-1"),
    ("trueup-angle-2", "angle-2"),
];
/// Those of a board alone.
const OF_BOARD: [(&str, &str); 1] = [("trueup-service", "service")];
/// Those of a bridge without a board.
const OF_NO_BOARD: [(&str, &str); 2] = [
    ("trueup-sensor-resolution", "sensor-resolution-v"),
    ("trueup-temp-heartbeat", "temp-heartbeat"),
];

/// Returns a finding for each input of the machine file that no HAL file brings.
pub(super) fn missing(demand: &Demand, ini: &IniLines, hal: &HalFiles) -> Vec<Finding> {
    let missing = all(demand).filter(|input| !hal.names(&input.signal));
    let finding = |NamedInput { signal, name, example, .. }: &NamedInput| {
        Finding::warning(
            ini.place_of_section("HAL"),
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
pub(super) fn sends_angles(demand: &Demand, hal: &HalFiles) -> bool {
    let has = |number| hal.names(&format!("trueup-angle-{number}"));
    demand.angles > 0 && (1..=demand.angles).all(has)
}

/// Returns the lines that connect the inputs which HAL files bring.
pub(super) fn wires(demand: &Demand, hal: &HalFiles) -> String {
    let own: &[(&str, &str)] = if demand.no_board.is_some() { &OF_NO_BOARD } else { &OF_BOARD };
    let mut named: Vec<(&str, &str)> =
        all(demand).map(|it| (it.signal.as_str(), it.pin.as_str())).collect();
    for optional in OPTIONAL.iter().chain(own) {
        if !named.contains(optional) {
            named.push(*optional);
        }
    }
    let mut text = String::new();
    for (signal, pin) in named.into_iter().filter(|(signal, _)| hal.names(signal)) {
        let _ = writeln!(text, "net {signal} => {FUNCTION}.{pin}");
    }
    if demand.no_board.is_some() && hal.names("trueup-temp-heartbeat") {
        let _ = writeln!(text, "setp {FUNCTION}.temp-timeout-ms {TEMPERATURE_TIMEOUT_MS}");
    }
    text
}

fn all(demand: &Demand) -> impl Iterator<Item = &NamedInput> {
    demand.inputs.iter().chain(demand.no_board.iter().flat_map(|it| &it.inputs))
}
