//! The questions of a bridge to its operator: until they are answered, nothing is engaged.

use trueup_link::status::StateBits;

use crate::remedy::find_remedies;

/// The questions in the order in which `Confirm` answers them.
const QUESTION_ORDER: [StateBits; 5] = [
    StateBits::FOREIGN_MACHINE,
    StateBits::CALIBRATION_CHANGED,
    StateBits::OLDER_CALIBRATION,
    StateBits::REFERENCE_OFFERED,
    StateBits::HEAT_UNKNOWN,
];

/// Where an operator answers.
pub const CONFIRM_INSTRUCTIONS: &str = "an edge of Confirm at the CNC answers one (LinuxCNC: the pin trueup.0.confirm; Modbus: \
                           bit 4 of Control; SINUMERIK: the input CONFIRM)";

/// Returns the questions that are open in this state: the word of each, and what to do about it, in the order in
/// which `Confirm` answers them.
#[must_use]
pub fn unanswered_questions(state: StateBits) -> Vec<(&'static str, &'static str)> {
    let open = QUESTION_ORDER.into_iter().filter(|question| state.contains(*question));
    let words = open
        .filter_map(|bit| StateBits::NAMES.into_iter().find(|(candidate, _)| *candidate == bit));
    words.flat_map(|(_, word)| find_remedies(&[word])).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_questions_come_in_the_order_of_their_answers() {
        let words = |bits| -> Vec<_> {
            unanswered_questions(StateBits(bits)).into_iter().map(|(word, _)| word).collect()
        };
        assert_eq!(words(0x1_0001), [""; 0]);
        assert_eq!(
            words(u32::MAX),
            [
                "foreign-machine",
                "calibration-changed",
                "older-calibration",
                "reference-offered",
                "heat-unknown"
            ]
        );
    }
}
