//! The bridge's state in words: the same ones in text and in JSON.

use serde_json::{Value, json};
use trueup_canopen::emergency::{Fault, Faults};
use trueup_core::{
    cnc::{OffsetFlags, OffsetQuality, Output},
    units::{NANOMETRES_PER_MICROMETRE, Nanometres},
};
use trueup_link::{frames::NmtState, status::StateBits};

use crate::operator_questions::unanswered_questions;

/// Returns a quality in a word.
#[must_use]
pub fn quality_name(quality: OffsetQuality) -> &'static str {
    match quality {
        OffsetQuality::Off => "off",
        OffsetQuality::Live => "live",
        OffsetQuality::TemperatureModel => "temperature-model",
        OffsetQuality::WarmUpModel => "warm-up-model",
        OffsetQuality::Hold => "hold",
        OffsetQuality::RampingOut => "ramping-out",
        OffsetQuality::Fault => "fault",
    }
}

/// Returns for whom a bridge waits that gives no offset and has no fault: "engage", the engage sequence of the CNC, or
/// "confirm", the operator's answer to a question. `None`: it waits for neither. `calibration` is the CRC of the one
/// that it runs on, 0 for none.
#[must_use]
pub fn pending_action(
    quality: OffsetQuality,
    state: StateBits,
    calibration: Option<u32>,
) -> Option<&'static str> {
    let dead = [StateBits::EXAMPLE_CONSTANTS, StateBits::SELF_TEST_FAILED];
    let is_dead = calibration == Some(0) || dead.into_iter().any(|bit| state.contains(bit));
    if quality != OffsetQuality::Fault || is_dead {
        return None;
    }
    if unanswered_questions(state).iter().any(|(word, _)| *word != "heat-unknown") {
        return Some("confirm");
    }
    state.contains(StateBits::RESTARTED).then_some("engage")
}

/// Returns the flags that are set, in words.
#[must_use]
pub fn flag_names(flags: OffsetFlags) -> Vec<&'static str> {
    const FLAG_NAMES: [(OffsetFlags, &str); 8] = [
        (OffsetFlags::CLAMPED, "clamped"),
        (OffsetFlags::SLEWING, "slewing"),
        (OffsetFlags::SENSOR_FAULT, "sensor-fault"),
        (OffsetFlags::SAMPLES_MISSING, "samples-missing"),
        (OffsetFlags::CNC_LOST, "cnc-lost"),
        (OffsetFlags::SPEED_UNKNOWN, "speed-unknown"),
        (OffsetFlags::OUTSIDE_TABLE, "outside-table"),
        (OffsetFlags::BOARD_DEGRADED, "board-degraded"),
    ];
    FLAG_NAMES.into_iter().filter(|(flag, _)| flags.contains(*flag)).map(|(_, word)| word).collect()
}

/// Returns the words of these faults, by rising number.
#[must_use]
pub fn fault_names(faults: Faults) -> Vec<&'static str> {
    let is_set = |fault: &Fault| faults.contains(*fault);
    Fault::ALL.into_iter().filter(is_set).map(Fault::as_str).collect()
}

/// Returns the bits of the state that are set, in words.
#[must_use]
pub fn state_names(state: StateBits) -> Vec<&'static str> {
    let is_set = |(bit, _): &(StateBits, &str)| state.contains(*bit);
    StateBits::NAMES.into_iter().filter(is_set).map(|(_, word)| word).collect()
}

/// Returns a heartbeat's state in a word, as CiA 301 names it.
#[must_use]
pub fn nmt_state_name(state: NmtState) -> &'static str {
    match state {
        NmtState::BootUp => "boot-up",
        NmtState::Stopped => "stopped",
        NmtState::Operational => "operational",
        NmtState::PreOperational => "pre-operational",
    }
}

/// Returns a length in µm.
#[must_use]
pub(crate) fn to_micrometres(length: Nanometres) -> f64 {
    f64::from(length.0) / f64::from(NANOMETRES_PER_MICROMETRE)
}

/// Returns the offsets of X, Y and Z in µm, if they are available.
#[must_use]
pub fn offset_um(output: &Output) -> Option<[f64; 3]> {
    output.offset.map(|offset| offset.map(to_micrometres))
}

/// Returns what the offsets' frames say, in one phrase.
#[must_use]
pub fn format_output(output: &Output) -> String {
    let offset = match offset_um(output) {
        Some([x, y, z]) => format!("x {x:+.2}  y {y:+.2}  z {z:+.2} µm"),
        None => "not available".into(),
    };
    let quality = quality_name(output.quality);
    let flags = match flag_names(output.flags)[..] {
        [] => "no flags".into(),
        ref words => words.join(" "),
    };
    // The largest age on the wire stands for all beyond.
    let age = match output.age_ms {
        u8::MAX => "255 ms or more".into(),
        age_ms => format!("{age_ms} ms"),
    };
    format!("{offset}  {quality}  {flags}  age {age}")
}

/// Returns the same as JSON members; `null` throughout without an output.
#[must_use]
pub fn output_to_json(output: Option<&Output>) -> Value {
    json!({
        "offset_um": output.and_then(offset_um).map_or([None; 3], |offset| offset.map(Some)),
        "quality": output.map(|output| output.quality as u8),
        "quality_word": output.map(|output| quality_name(output.quality)),
        "flags": output.map(|output| flag_names(output.flags)),
        "age_ms": output.map(|output| output.age_ms),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_bit_of_the_flags_has_a_word() {
        assert_eq!(flag_names(OffsetFlags(0xFF)).len(), 8);
        assert_eq!(fault_names(Faults::from_words(0x2001, 0)), ["no-calibration", "store"]);
        assert_eq!(fault_names(Faults::from_words(u32::MAX, u32::MAX)).len(), Fault::ALL.len());
        assert_eq!(flag_names(OffsetFlags::NONE), [""; 0]);
        assert_eq!(
            flag_names(OffsetFlags::SLEWING.union(OffsetFlags::CNC_LOST)),
            ["slewing", "cnc-lost"]
        );
    }

    #[test]
    fn a_bridge_that_waits_is_distinguished_from_one_with_a_fault() {
        let of = |quality, bits, crc| pending_action(quality, StateBits(bits), crc);
        // Restarted; with a reference that is offered; and what no engage sequence mends.
        assert_eq!(of(OffsetQuality::Fault, 1, Some(7)), Some("engage"));
        assert_eq!(of(OffsetQuality::Fault, 1 | 1 << 17, Some(7)), Some("confirm"));
        for (quality, bits, crc) in [
            (OffsetQuality::Fault, 0, Some(7)),
            (OffsetQuality::Fault, 1, Some(0)),
            (OffsetQuality::Fault, 1 | 1 << 3, Some(7)),
            (OffsetQuality::Fault, 1 | 1 << 14, Some(7)),
            (OffsetQuality::Off, 1, Some(7)),
        ] {
            assert_eq!(of(quality, bits, crc), None, "{bits}");
        }
    }

    #[test]
    fn offsets_are_reported_in_micrometres_with_the_resolution_of_the_wire() {
        let mut output = Output {
            offset: Some([0, -10, 62_800].map(Nanometres)),
            quality: OffsetQuality::Live,
            flags: OffsetFlags::SLEWING,
            age_ms: 1,
        };
        assert_eq!(
            format_output(&output),
            "x +0.00  y -0.01  z +62.80 µm  live  slewing  age 1 ms"
        );
        output.offset = None;
        output.age_ms = 255;
        assert_eq!(format_output(&output), "not available  live  slewing  age 255 ms or more");
        assert_eq!(output_to_json(Some(&output))["offset_um"], json!([null, null, null]));
    }
}
