//! Changes learned since the calibration was made: the one thing that may be changed while an offset is
//! followed.
//!
//! They come in `Control`, and in nothing else. So who may send them is settled already: the CNC whose `Control`
//! counts, on its own line, protected and in sequence ([`master`](super::master)); not SDO, and not a PLC, which
//! loads a new calibration at rest. A change of another calibration or beyond the caps is not taken, and is
//! reported until `Control` comes without any; the frame is a sign of life all the same. A zero is always right:
//! of another calibration nothing is in force, because a new one begins with a start.

use trueup_core::learned_changes::{LearnedChangeRequest, calibration_id};
use trueup_store::calibration::calibration_crc;

use super::Node;

impl Node<'_> {
    /// Takes what a believed `Control` says of it.
    // Called for none of the 50 frames a second, or for one part: kept out of the code that all frames run.
    #[inline(never)]
    pub(super) fn apply_learned_change(&mut self, change: LearnedChangeRequest) {
        let is_ours = change.calibration == calibration_id(calibration_crc(self.blob));
        let is_taken = match &self.bridge {
            Some(bridge) if is_ours => bridge.apply_learned_change(&mut self.state, change),
            _ => change.amount == 0,
        };
        self.learned_refused = change.part != 0 && (self.learned_refused || !is_taken);
    }
}
