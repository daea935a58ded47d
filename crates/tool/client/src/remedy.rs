//! The remedy for each word that the bridge says of itself: a flag, a fault or a bit of its state.

/// Returns the words in the order of this list, what is worst first, each once, with its remedy.
#[must_use]
pub fn find_remedies(words: &[&str]) -> Vec<(&'static str, &'static str)> {
    REMEDIES.into_iter().filter(|(word, _)| words.contains(word)).collect()
}

/// Every word, with what it means and what to do.
pub const REMEDIES: [(&str, &str); 61] = [
    ("self-test", "the board found itself damaged: flash it again; if it stays, replace the board"),
    ("no-calibration", "load one: trueup bridge load CAL.bin --port …"),
    ("example-constants", "it runs on the example: compile your machine file and load it"),
    ("older-calibration", "the newest is damaged: load it again, or Confirm the older one"),
    ("foreign-machine", "made for another machine or board: load the right one, or Confirm it"),
    (
        "calibration-changed",
        "it was loaded while no CNC was sending: if it is the right one (compare its CRC under calibration), Confirm it",
    ),
    (
        "reference-offered",
        "Confirm takes the older reference, Zero makes a new one, trueup bridge forget-reference declines it",
    ),
    ("stopped", "the last start ended in a fault: trueup bridge info says where; report it"),
    ("watchdog-reset", "a task hung: trueup bridge info says which; report it"),
    ("restarted", "engage anew: Engage off, then on"),
    ("sensor-fault", "the sensor or a thermometer is lost: see the faults of trueup bridge info"),
    ("sensor", "out of range or stuck: check its cable, supply and gap"),
    ("thermometer-0", "channel 0: open, short, at a rail or stuck: check its cable and converter"),
    ("thermometer-1", "channel 1: open, short, at a rail or stuck: check its cable and converter"),
    ("thermometer-2", "channel 2: open, short, at a rail or stuck: check its cable and converter"),
    ("thermometer-3", "channel 3: open, short, at a rail or stuck: check its cable and converter"),
    ("thermometer-4", "channel 4: open, short, at a rail or stuck: check its cable and converter"),
    ("thermometer-5", "channel 5: open, short, at a rail or stuck: check its cable and converter"),
    ("thermometer-6", "channel 6: open, short, at a rail or stuck: check its cable and converter"),
    ("thermometer-7", "channel 7: open, short, at a rail or stuck: check its cable and converter"),
    (
        "temperature-rate",
        "a thermometer is not believed: its channel is not available; check its contact",
    ),
    ("temperature-rate-0", "channel 0 changes too fast: check its contact, or max_c_per_min"),
    ("temperature-rate-1", "channel 1 changes too fast: check its contact, or max_c_per_min"),
    ("temperature-rate-2", "channel 2 changes too fast: check its contact, or max_c_per_min"),
    ("temperature-rate-3", "channel 3 changes too fast: check its contact, or max_c_per_min"),
    ("temperature-rate-4", "channel 4 changes too fast: check its contact, or max_c_per_min"),
    ("temperature-rate-5", "channel 5 changes too fast: check its contact, or max_c_per_min"),
    ("temperature-rate-6", "channel 6 changes too fast: check its contact, or max_c_per_min"),
    ("temperature-rate-7", "channel 7 changes too fast: check its contact, or max_c_per_min"),
    (
        "samples-missing",
        "the converter stopped: it restarts by itself; if it stays, switch off and on",
    ),
    (
        "sensor-odd",
        "the sensor jumped, or its run-out changed at one speed: check its cable, mounting and ring",
    ),
    ("supply-off", "the sensor's supply is out of range: measure it at the board"),
    ("source-dead", "a spare source is dead: look for the temperature that is not available"),
    ("calibration-unfit", "what is measured no longer fits: measure the machine again and fit"),
    ("place-lost", "the CNC sends no position or angle that is needed: check what it sends"),
    ("conditions-lost", "the CNC sends no Conditions: the defaults of the file stand in for them"),
    ("cnc-lost", "no frames from the CNC: check cable, bit rate, and that its program runs"),
    (
        "position-jump",
        "the CNC sends a position out of reach: check what it sends, and rapid_mm_per_min",
    ),
    ("heartbeat-lost", "the node of object 1016 is silent: check it, or set 1016 to 0"),
    ("second-master", "two controls send Control: switch one off"),
    ("speed-unknown", "the CNC sends no spindle speed: send Spindle at least every 500 ms"),
    ("heat-unknown", "the heat stored in the machine is not known: let it cool, or Confirm"),
    (
        "learned-refused",
        "what was learned is of another calibration or beyond [limits.learned]: load its file at rest",
    ),
    ("zero-refused", "Zero was not taken: reference the axes and look for missing inputs"),
    (
        "outside-table",
        "a position beyond its table: the end value is held; measure the whole travel",
    ),
    ("clamped", "an axis is at its largest offset: check zero and sign, or raise max_um"),
    ("slewing", "on the way to the new offset: wait"),
    ("board-degraded", "see the other words"),
    ("degraded", "it runs on a fall-back source: look for the input that is missing"),
    ("crystal", "the crystal is dead: serial only, no CAN; replace it"),
    ("pll", "the clock cannot be made: serial only, no CAN; replace the board"),
    ("fall-back-clock", "it runs without its crystal: serial only, no CAN"),
    ("can", "the CAN controller does not answer: switch off and on; replace the board"),
    ("can-off", "off the bus: look for a short or a wrong bit rate; it comes back by itself"),
    (
        "can-passive",
        "no node acknowledges: check that the CNC is on, its bit rate, and 120 Ω at both ends of the bus",
    ),
    ("can-warning", "errors on the bus: check termination, shield and length"),
    ("store", "the store takes nothing: what is loaded is lost at power-off; replace the board"),
    ("store-failing", "see store"),
    ("cnc-malformed", "the CNC sends frames of a wrong form: check its program against trueup.dbc"),
    ("cnc-damaged", "frames of the CNC come damaged: check termination and shield"),
    ("cnc-sequence", "frames of the CNC come twice or out of order: does a second program send?"),
];

#[cfg(test)]
mod tests {
    use super::*;
    use crate::state_text::{fault_names, flag_names};
    use trueup_canopen::emergency::Faults;
    use trueup_core::cnc::OffsetFlags;
    use trueup_link::status::StateBits;

    #[test]
    fn every_word_has_its_remedy() {
        let states = StateBits::NAMES.map(|(_, word)| word);
        for word in flag_names(OffsetFlags(0xFF))
            .into_iter()
            .chain(fault_names(Faults::from_words(u32::MAX, u32::MAX)))
            .chain(states)
        {
            assert_eq!(find_remedies(&[word]).len(), 1, "{word}");
        }
    }

    #[test]
    fn what_is_worst_comes_first_and_no_word_twice() {
        let words = find_remedies(&["slewing", "sensor", "self-test", "sensor"]).into_iter();
        assert_eq!(
            words.map(|(word, _)| word).collect::<Vec<_>>(),
            ["self-test", "sensor", "slewing"]
        );
    }
}
