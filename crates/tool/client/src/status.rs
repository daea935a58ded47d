//! The bridge's status, which it sends ten times a second, put together.

use serde_json::{Value, json};
use trueup_canopen::emergency::Faults;
use trueup_core::{design_parameters::TEMPERATURE_CHANNEL_COUNT, units::Nanometres};
use trueup_link::{
    frame::Frame,
    layout::STATUS_ID,
    receiver::StatusReceiver,
    status::{FrameRejectReason, ResetReason, StateBits, StatusItem},
};

use crate::state_text::{fault_names, state_names, to_micrometres};

/// The newest of each item.
#[derive(Default)]
pub struct BoardStatus {
    receiver: StatusReceiver,
    /// In 0.01 °C, by channel.
    pub centi_c: [Option<i16>; TEMPERATURE_CHANNEL_COUNT],
    /// Of the spindle, by its sensor.
    pub elongation: Option<Nanometres>,
    last_refused: FrameRejectReason,
    damaged: u16,
    out_of_sequence: u16,
    malformed: u16,
    lost: u16,
    noise_thousandths: u16,
    faults: u16,
    /// The state that a CNC must know next to the offsets.
    pub state: StateBits,
    reset_reason: ResetReason,
    free_stack: Option<u16>,
    /// CRC of the calibration that the board runs on, once it has reported it; 0: it has none.
    pub calibration: Option<u32>,
    /// Of X, Y and Z the constant of the offset in 0.1 µm and its slope in 0.1 µm/m; `None`: not available, or not sent.
    pub slopes: [Option<(i16, i16)>; 3],
}

impl BoardStatus {
    /// Takes a frame from the bus, and returns what it is about; `None`: it is no status, or cannot be used, which is
    /// counted.
    pub fn receive(&mut self, frame: &Frame) -> Option<StatusItem> {
        if frame.id() != STATUS_ID {
            return None;
        }
        let status = self.receiver.accept(frame).ok()?;
        self.last_refused = status.last_refused;
        match status.item {
            StatusItem::Temperatures { pair, centi_c } => {
                let both = self.centi_c.iter_mut().skip(2 * usize::from(pair));
                both.zip(centi_c).for_each(|(place, new)| *place = new);
            }
            StatusItem::Elongation(elongation) => self.elongation = elongation,
            StatusItem::Refused { damaged, out_of_sequence } => {
                (self.damaged, self.out_of_sequence) = (damaged, out_of_sequence);
            }
            StatusItem::Received { malformed, lost } => {
                (self.malformed, self.lost) = (malformed, lost)
            }
            StatusItem::Board { noise_thousandths, faults } => {
                (self.noise_thousandths, self.faults) = (noise_thousandths, faults);
            }
            StatusItem::State(state) => self.state = state,
            StatusItem::Reset { reason, free_stack } => {
                (self.reset_reason, self.free_stack) = (reason, Some(free_stack));
            }
            StatusItem::Calibration(crc) => self.calibration = Some(crc),
            StatusItem::Slope { axis, constant, slope } => {
                if let Some(place) = self.slopes.get_mut(usize::from(axis)) {
                    *place = constant.map(|constant| (constant, slope));
                }
            }
        }
        Some(status.item)
    }

    /// Returns what is wrong with the board, in words.
    #[must_use]
    pub fn fault_names(&self) -> Vec<&'static str> {
        fault_names(Faults::from_words(self.faults.into(), 0))
    }

    /// Returns what is wrong with the board and what a CNC must know of it, in words.
    #[must_use]
    pub fn fault_and_state_names(&self) -> Vec<&'static str> {
        let mut words = self.fault_names();
        words.extend(state_names(self.state));
        words
    }

    /// Frames of the CNC that the board has refused: damaged, out of sequence, malformed.
    #[must_use]
    pub const fn rejected_cnc_frame_counts(&self) -> [u16; 3] {
        [self.damaged, self.out_of_sequence, self.malformed]
    }

    /// RMS noise of the sensor in ADC codes.
    #[must_use]
    pub fn rms_noise_codes(&self) -> f64 {
        f64::from(self.noise_thousandths) / 1_000.0
    }

    /// Status frames that were damaged or out of order.
    #[must_use]
    pub fn rejected_status_frame_count(&self) -> u32 {
        let counters = self.receiver.counters();
        counters
            .crc_errors
            .saturating_add(counters.sequence_errors)
            .saturating_add(counters.malformed)
    }

    /// Returns the elongation of the spindle in µm, by its sensor.
    #[must_use]
    pub fn elongation_um(&self) -> Option<f64> {
        self.elongation.map(to_micrometres)
    }

    /// Returns the temperatures that are known, the faults, and what the board has refused, if anything.
    #[must_use]
    pub fn to_text(&self) -> String {
        let known = (0..)
            .zip(self.centi_c)
            .filter_map(|(channel, centi_c): (u8, _)| Some((channel, centi_c?)));
        let mut text: String = known
            .map(|(channel, centi_c)| format!("  T{channel} {:.2} °C", f64::from(centi_c) / 100.0))
            .collect();
        let refused = [
            ("damaged", self.damaged),
            ("out of sequence", self.out_of_sequence),
            ("malformed", self.malformed),
        ];
        for (what, count) in refused {
            if count > 0 {
                text += &format!("  from the CNC {what} {count}");
            }
        }
        let faults = fault_names(Faults::from_words(self.faults.into(), 0));
        if !faults.is_empty() {
            text += &format!("  faults {}", faults.join(" "));
        }
        let state = state_names(self.state);
        if !state.is_empty() {
            text += &format!("  state {}", state.join(" "));
        }
        text
    }

    /// Returns the same as JSON members.
    #[must_use]
    pub fn to_json(&self) -> Value {
        json!({
            "temps_c": self.centi_c.map(|channel| channel.map(|centi_c| f64::from(centi_c) / 100.0)),
            "elongation_um": self.elongation_um(),
            "noise_codes": self.rms_noise_codes(),
            "faults": fault_names(Faults::from_words(self.faults.into(), 0)),
            "state": state_names(self.state),
            "reset_reason": self.reset_reason.as_str(),
            "free_stack_bytes": self.free_stack,
            "calibration_crc":
                self.calibration.filter(|crc| *crc != 0).map(|crc| format!("{crc:08x}")),
            "from_cnc": {
                "damaged": self.damaged,
                "out_of_sequence": self.out_of_sequence,
                "malformed": self.malformed,
                "lost": self.lost,
                "last_refused": reject_reason_name(self.last_refused),
            },
        })
    }
}

fn reject_reason_name(reason: FrameRejectReason) -> Option<&'static str> {
    match reason {
        FrameRejectReason::None => None,
        FrameRejectReason::Malformed => Some("malformed"),
        FrameRejectReason::Damaged => Some("damaged"),
        FrameRejectReason::Repeated => Some("repeated"),
        FrameRejectReason::WrongSequence => Some("wrong-sequence"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use trueup_link::status::{Status, encode};

    #[test]
    fn the_newest_of_each_item_is_reported() {
        let mut board = BoardStatus::default();
        let items = [
            StatusItem::Temperatures { pair: 0, centi_c: [Some(2_345), None] },
            StatusItem::Temperatures { pair: 3, centi_c: [None, Some(-50)] },
            StatusItem::Elongation(Some(Nanometres(62_805))),
            StatusItem::Refused { damaged: 2, out_of_sequence: 0 },
            StatusItem::Board { noise_thousandths: 1_041, faults: 1 << 3 },
            StatusItem::State(StateBits::RESTARTED),
            StatusItem::Reset { reason: ResetReason::Watchdog, free_stack: 4_000 },
            StatusItem::Calibration(0xF4AC_FB13),
        ];
        for (counter, item) in (0..).zip(items) {
            board.receive(&encode(
                &Status { last_refused: FrameRejectReason::Damaged, item },
                counter,
            ));
        }
        assert_eq!(
            board.to_text(),
            "  T0 23.45 °C  T7 -0.50 °C  from the CNC damaged 2  faults cnc-lost  \
             state restarted"
        );
        let json = board.to_json();
        assert_eq!(json["temps_c"], json!([23.45, null, null, null, null, null, null, -0.5]));
        assert_eq!(json["elongation_um"], json!(62.805));
        assert_eq!(json["noise_codes"], json!(1.041));
        assert_eq!(json["state"], json!(["restarted"]));
        assert_eq!(json["reset_reason"], json!("watchdog"));
        assert_eq!(json["calibration_crc"], json!("f4acfb13"));
        assert_eq!(json["from_cnc"]["last_refused"], json!("damaged"));
        // A repetition changes nothing and is counted.
        let repeated =
            Status { last_refused: FrameRejectReason::None, item: StatusItem::Elongation(None) };
        board.receive(&encode(&repeated, 7));
        assert_eq!(
            (board.elongation, board.rejected_status_frame_count()),
            (Some(Nanometres(62_805)), 1)
        );
    }
}
