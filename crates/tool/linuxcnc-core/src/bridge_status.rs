//! The bridge's state, as its `Status` frames report it.

use core::time::Duration;

use trueup_link::{
    frame::Frame,
    receiver::StatusReceiver,
    status::{StateBits, StatusItem},
};

use crate::NANOMETRES_PER_MICROMETRE;

/// Temperature channels of the bridge.
pub const TEMPERATURE_CHANNEL_COUNT: usize =
    trueup_core::design_parameters::TEMPERATURE_CHANNEL_COUNT;

/// The newest of what the bridge says of itself, with its time.
#[derive(Debug, Default)]
pub(crate) struct BridgeStatus {
    receiver: StatusReceiver,
    pub(crate) temperatures_c: [Option<(Duration, f64)>; TEMPERATURE_CHANNEL_COUNT],
    pub(crate) elongation_um: Option<(Duration, f64)>,
    pub(crate) state: StateBits,
    pub(crate) calibration: Option<u32>,
}

impl BridgeStatus {
    /// Takes a frame of `Status`.
    pub(crate) fn receive(&mut self, now: Duration, frame: &Frame) {
        let Ok(status) = self.receiver.accept(frame) else { return };
        match status.item {
            StatusItem::Temperatures { pair, centi_c } => {
                let both = self.temperatures_c.iter_mut().skip(2 * usize::from(pair));
                for (place, centi) in both.zip(centi_c) {
                    *place = centi.map(|centi| (now, f64::from(centi) / 100.0));
                }
            }
            StatusItem::Elongation(elongation) => {
                self.elongation_um = elongation
                    .map(|elongation| (now, f64::from(elongation.0) / NANOMETRES_PER_MICROMETRE));
            }
            StatusItem::State(state) => self.state = state,
            StatusItem::Calibration(crc) => self.calibration = Some(crc),
            StatusItem::Refused { .. }
            | StatusItem::Received { .. }
            | StatusItem::Board { .. }
            | StatusItem::Reset { .. }
            | StatusItem::Slope { .. } => {}
        }
    }
}
