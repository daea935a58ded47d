//! The state of a bridge at one moment, and the events from one moment to the next.

use trueup_client::state_text::quality_name;
use trueup_core::{cnc::OffsetQuality, design_parameters::TEMPERATURE_CHANNEL_COUNT};

/// Why a bridge is down whose line is open.
pub(crate) const NO_OFFSETS_REASON: &str = "no offsets come";

/// Who the bridge is, as far as it has answered.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct BridgeIdentity {
    /// The serial number of its board.
    pub serial: Option<u32>,
    /// The name of the machine that its calibration is for.
    pub machine: Option<String>,
    /// The version of its firmware.
    pub firmware: Option<String>,
}

/// The known state of a bridge; without a line nothing is known.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BridgeSnapshot {
    /// Valid offsets come from it.
    pub is_up: bool,
    /// Why the line was lost, until offsets come again.
    pub why: Option<String>,
    /// Who it is; this outlives the line.
    pub identity: BridgeIdentity,
    /// The newest offsets of X, Y and Z in µm.
    pub offset_um: [Option<f64>; 3],
    /// How good they are.
    pub quality: Option<OffsetQuality>,
    /// Why they are not simply the full correction.
    pub flags: Vec<&'static str>,
    /// By channel.
    pub temperature_c: [Option<f64>; TEMPERATURE_CHANNEL_COUNT],
    /// Of the spindle, by its sensor.
    pub elongation_um: Option<f64>,
    /// The commanded positions of X, Y and Z, where the CNC is on this line.
    pub position_mm: [Option<f64>; 3],
    /// The board has sent its status a short time ago; else faults, state and calibration are not known.
    pub has_status: bool,
    /// Words of the board's faults.
    pub faults: Vec<&'static str>,
    /// Words of the board's state.
    pub state: Vec<&'static str>,
    /// The CRC of the calibration that it runs on; 0: it has none.
    pub calibration: Option<u32>,
    /// Frames of offsets that were expected and never came.
    pub lost_frames: u32,
    /// How often it has reported its start.
    pub starts: u32,
}

/// Something that happened.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BridgeEvent {
    /// Which kind, for programs.
    pub code: &'static str,
    /// Its subject: the word of a fault, a quality, a CRC.
    pub about: String,
}

impl BridgeEvent {
    /// Returns an event.
    #[must_use]
    pub fn new(code: &'static str, about: impl Into<String>) -> Self {
        Self { code, about: about.into() }
    }
}

/// Returns what has happened between two moments, in the order in which it is best read.
#[must_use]
pub(crate) fn detect_events(before: &BridgeSnapshot, now: &BridgeSnapshot) -> Vec<BridgeEvent> {
    let mut events = Vec::new();
    match (before.is_up, now.is_up) {
        (true, false) => {
            let why = now.why.clone().unwrap_or_else(|| NO_OFFSETS_REASON.into());
            events.push(BridgeEvent::new("bridge-down", why));
            // The rest is unknown now; it has not changed.
            return events;
        }
        (false, true) => events.push(BridgeEvent::new("bridge-up", "")),
        (false, false) => return events,
        (true, true) => {}
    }
    if now.starts > before.starts {
        events.push(BridgeEvent::new("bridge-restarted", ""));
    }
    if let (Some(old), Some(new)) = (before.identity.serial, now.identity.serial)
        && old != new
    {
        events.push(BridgeEvent::new("bridge-exchanged", format!("{old:08x} {new:08x}")));
    }
    if now.quality != before.quality
        && let Some(quality) = now.quality
    {
        events.push(BridgeEvent::new("quality", quality_name(quality)));
    }
    if now.calibration != before.calibration
        && let Some(crc) = now.calibration
    {
        events.push(BridgeEvent::new("calibration", format!("{crc:08x}")));
    }
    // An unknown status has not changed.
    if !now.has_status {
        return events;
    }
    let words = [
        ("fault-set", "fault-cleared", &before.faults, &now.faults),
        ("state-set", "state-cleared", &before.state, &now.state),
    ];
    for (set, cleared, before, now) in words {
        let new = now.iter().filter(|word| !before.contains(word));
        events.extend(new.map(|word| BridgeEvent::new(set, *word)));
        let gone = before.iter().filter(|word| !now.contains(word));
        events.extend(gone.map(|word| BridgeEvent::new(cleared, *word)));
    }
    events
}

#[cfg(test)]
mod tests {
    use super::*;

    fn codes(before: &BridgeSnapshot, now: &BridgeSnapshot) -> Vec<(&'static str, String)> {
        detect_events(before, now).into_iter().map(|event| (event.code, event.about)).collect()
    }

    #[test]
    fn each_change_is_an_event_and_a_value_that_moves_is_none() {
        let up = BridgeSnapshot {
            is_up: true,
            quality: Some(OffsetQuality::Live),
            faults: vec!["cnc-lost"],
            calibration: Some(0xAB),
            has_status: true,
            ..BridgeSnapshot::default()
        };
        let same = BridgeSnapshot { offset_um: [Some(1.0); 3], lost_frames: 3, ..up.clone() };
        assert_eq!(codes(&up, &same), []);
        let now = BridgeSnapshot {
            quality: Some(OffsetQuality::Hold),
            faults: vec!["sensor-range"],
            state: vec!["restarted"],
            calibration: Some(0xCD),
            starts: 1,
            ..up.clone()
        };
        let expected = [
            ("bridge-restarted", ""),
            ("quality", "hold"),
            ("calibration", "000000cd"),
            ("fault-set", "sensor-range"),
            ("fault-cleared", "cnc-lost"),
            ("state-set", "restarted"),
        ];
        assert_eq!(codes(&up, &now), expected.map(|(code, about)| (code, about.to_owned())));
        let unknown = BridgeSnapshot {
            has_status: false,
            faults: Vec::new(),
            calibration: None,
            ..up.clone()
        };
        assert_eq!(codes(&up, &unknown), [], "a status that does not come clears no fault");
    }

    #[test]
    fn a_line_that_is_lost_changes_nothing_else() {
        let up = BridgeSnapshot {
            is_up: true,
            has_status: true,
            faults: vec!["store"],
            ..BridgeSnapshot::default()
        };
        let down = BridgeSnapshot { why: Some("closed".into()), ..BridgeSnapshot::default() };
        assert_eq!(codes(&up, &down), [("bridge-down", "closed".to_owned())]);
        assert_eq!(codes(&down, &down), []);
        assert_eq!(
            codes(&up, &BridgeSnapshot::default()),
            [("bridge-down", NO_OFFSETS_REASON.to_owned())]
        );
        let expected = [("bridge-up", String::new()), ("fault-set", "store".into())];
        assert_eq!(codes(&down, &up), expected);
    }
}
