//! What a board knows at its start, before its first sample.

use trueup_canopen::emergency::Faults;
use trueup_core::calibration::Calibration;
use trueup_store::write_log::WriteLog;

use crate::reset_info::ResetInfo;

/// What a node is made of.
#[derive(Debug)]
pub struct NodeConfiguration<'a> {
    /// `None`: none is valid, and nothing can be computed.
    pub calibration: Option<Calibration<'a>>,
    /// Its blob, which a CANopen master may read; empty without one.
    pub blob: &'a [u8],
    /// Through which a CANopen master loads a calibration; `None`: its answer is that nothing can be stored.
    pub buffer: Option<&'a mut [u8]>,
    /// The board runs on a fall-back: every frame is marked.
    pub is_degraded: bool,
    /// What is wrong with the board. With constants of the example, or damaged, it never has an offset.
    pub faults: Faults,
    /// What the operator must confirm: nothing is available until it is confirmed.
    pub questions: Faults,
    /// Where the last start stopped, and how often the board has started.
    pub start: ResetInfo,
    /// Of the identity object (0x1018:04), 0…2³² − 1: a board of its own has its own.
    pub serial_number: u32,
    /// The first 32 bits of the hash of the commit that the image was built from; 0: not known.
    pub commit: u32,
    /// The writes that the board has stored before the start.
    pub writes: WriteLog,
}

impl Default for NodeConfiguration<'_> {
    fn default() -> Self {
        Self {
            calibration: None,
            blob: &[],
            buffer: None,
            is_degraded: false,
            faults: Faults::default(),
            questions: Faults::default(),
            start: ResetInfo::default(),
            serial_number: 1,
            commit: 0,
            writes: WriteLog::default(),
        }
    }
}

impl<'a> From<Calibration<'a>> for NodeConfiguration<'a> {
    fn from(calibration: Calibration<'a>) -> Self {
        Self { calibration: Some(calibration), ..Self::default() }
    }
}
