//! The HAL lines of a bridge without a board: the component `trueup_node` in the servo thread.
//!
//! Analogue inputs and thermometers come in as the other inputs do (`inputs.rs`):
//!
//! | signal | pin | what |
//! |---|---|---|
//! | `trueup-sensor-v` | `sensor-v` | the sensor, in volts |
//! | `trueup-sensor-resolution` | `sensor-resolution-v` | smallest step of its source, in volts |
//! | `trueup-temp-NN` | `temp-NN-in` | the temperature of channel NN of the machine file, in °C |
//! | `trueup-temp-heartbeat` | `temp-heartbeat` | changes with each set of temperatures that a program gives |
//!
//! A signal that nothing drives is 0, and so would be a temperature; so what is not there is not connected.

use std::fmt::Write as _;

use super::{
    OffsetEntryPoint,
    boardless_config::BoardlessConfig,
    finding::OffsetRequirements,
    ini_file::IniFile,
    joints::{Joint, compute_offset_av_ratio},
};
use crate::ini_settings::IniSettings;

/// The realtime component.
pub(crate) const REALTIME_COMPONENT_NAME: &str = "trueup_node";
/// Its function.
pub(crate) const REALTIME_INSTANCE_NAME: &str = "trueup.0";
/// After this time without a heartbeat the temperatures of a program count as missing.
pub(super) const TEMPERATURE_TIMEOUT_MS: u32 = 2_000;
const UM_PER_MM: f64 = 1e3;

/// Returns the lines that load the component and set it; `sends_angles`: those of the rotary axes are connected.
pub(super) fn format_load_and_setp_lines(
    no_board: &BoardlessConfig,
    ini: &IniFile,
    joints: &[Joint],
    demand: &OffsetRequirements,
    sends_angles: bool,
) -> String {
    let mut text = format!(
        "\nloadrt {REALTIME_COMPONENT_NAME} file=[TRUEUP](CALIBRATION) heat=[TRUEUP](HEAT)"
    );
    if demand.entry == OffsetEntryPoint::Joint {
        let _ = write!(text, " joints={}", joint_axis_letters(joints));
    }
    if sends_angles {
        text.push_str(" rotary=1");
    }
    text.push('\n');
    let mut set = |pin: &str, value: f64| {
        let _ = writeln!(text, "setp {REALTIME_INSTANCE_NAME}.{pin} {}", round_to_billionth(value));
    };
    let base = IniSettings::parse(&ini.to_text()).unwrap_or_default();
    set("mm-per-unit", base.mm_per_unit);
    if let Some(codes) = no_board.codes_per_v {
        set("sensor-codes-per-v", codes);
    }
    for (axis, letter) in ["x", "y", "z"].iter().enumerate() {
        set(&format!("{letter}-against-um"), no_board.against_um[axis]);
        if demand.entry == OffsetEntryPoint::Eoffset {
            let motion = &base.axes[axis];
            let section = format!("AXIS_{}", letter.to_ascii_uppercase());
            let stated = ini.value(&section, "OFFSET_AV_RATIO").is_some_and(|value| !value.is_ours);
            let proper = compute_offset_av_ratio(motion.velocity_mm_per_s, demand.slew_um_per_s);
            let ratio = if stated { motion.ratio } else { proper.unwrap_or_default() };
            let acceleration = motion.acceleration_mm_per_s2.unwrap_or_default() * ratio;
            set(&format!("{letter}-accel"), acceleration / base.mm_per_unit);
            let most = motion.velocity_mm_per_s.unwrap_or_default() * ratio * UM_PER_MM;
            let keeps = most > 0.0 && most <= demand.slew_um_per_s;
            set(&format!("{letter}-keeps-slew"), f64::from(u8::from(keeps)));
        }
    }
    if demand.entry == OffsetEntryPoint::Joint {
        for joint in joints {
            for (limit, end) in joint.limits.iter().zip(["min", "max"]) {
                if let Some(limit) = limit {
                    set(&format!("joint-{}-{end}-limit", joint.number), *limit);
                }
            }
        }
    }
    text
}

/// Rounds to 10⁻⁹: what is beyond is arithmetic.
pub(super) fn round_to_billionth(value: f64) -> f64 {
    (value * 1e9).round() / 1e9
}

/// Returns a letter for each joint, in the order of their numbers; a dot for one without an offset.
fn joint_axis_letters(joints: &[Joint]) -> String {
    let last = joints.iter().map(|joint| joint.number).max().unwrap_or_default();
    let letter = |number: usize| {
        let joint = joints.iter().find(|joint| joint.number == number);
        joint.map_or('.', |joint| ['X', 'Y', 'Z'][joint.axis])
    };
    (0..=last).map(letter).collect()
}
