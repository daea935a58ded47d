//! An axis on its way: where it is, what its screw does there, and what the bridge has learnt of it.
//!
//! The error is computed here from the same knots in `f64`, not by the bridge's table.

use trueup_core::{
    cnc::{AxisPosition, LinearAxis, TravelDirection},
    pitch_table::PitchErrorTable,
    reversal::Interval,
    units::Position,
};
use trueup_link::{frame::Frame, frames};

/// The CNC sends where it is every so often.
const PERIOD_MS: u64 = 10;
/// From one knot of the table to the next, in 10 nm: 100 mm.
const STEP: i32 = 10_000_000;
/// The axis travels from 0 to the last knot.
const END: i32 = STEP * (KNOTS as i32 - 1);
const KNOTS: usize = 6;
/// 6 m/min in 10 nm a millisecond, its rapid traverse.
pub const SPEED: i32 = 10_000;

/// Errors of the screw at the knots, in nm: one table for each calibration that is loaded.
const TABLES_NM: [[i32; KNOTS]; 2] =
    [[0, 4_000, -6_000, 9_000, 1_000, -3_000], [0, -2_000, 8_000, -9_000, 500, 0]];

/// Returns a table as a calibration has it.
pub fn pitch(table: usize) -> PitchErrorTable<'static> {
    let points = TABLES_NM[table].map(|nm| (nm * 256).to_le_bytes());
    let forward: &'static [[u8; 4]] = Box::leak(Box::new(points));
    PitchErrorTable {
        start: Position(0),
        step: Interval::new(STEP.unsigned_abs()),
        forward,
        reverse: None,
    }
}

/// The axis and its CNC.
#[derive(Clone, Copy, Debug, Default)]
pub struct Axis {
    at: i32,
    velocity: i32,
    counter: u8,
    /// The position that the bridge has received last.
    pub received_nm: Option<i32>,
    /// How long ago, in milliseconds.
    pub received_ms: u32,
    /// It was elsewhere in the frame before.
    pub moves: bool,
}

impl Axis {
    /// A millisecond.
    pub fn live(&mut self) {
        self.received_ms = self.received_ms.saturating_add(1);
        self.at = (self.at + self.velocity).clamp(0, END);
        if self.at == 0 || self.at == END {
            self.velocity = -self.velocity;
        }
    }

    /// It sets off, or stands still.
    pub fn turn(&mut self, drawn: u32) {
        self.velocity = match drawn % 3 {
            0 => 0,
            1 => SPEED,
            _ => -SPEED / 3,
        };
    }

    /// Returns what is sent now, if it is time.
    pub fn speak(&mut self, tick: u64) -> Option<Frame> {
        if !tick.is_multiple_of(PERIOD_MS) {
            return None;
        }
        self.counter = self.counter.wrapping_add(1);
        let direction = match self.velocity {
            1.. => TravelDirection::Positive,
            0 => TravelDirection::Standing,
            _ => TravelDirection::Negative,
        };
        let at = AxisPosition { axis: LinearAxis::X, position: Position(self.at), direction };
        Some(frames::encode_position(at, self.counter))
    }

    /// The bridge has taken what was sent now.
    pub fn was_received(&mut self) {
        self.moves = self.received_nm.unwrap_or(0) != self.at;
        (self.received_nm, self.received_ms) = (Some(self.at), 0);
    }

    /// The bridge has started anew.
    pub fn forget(&mut self) {
        (self.received_nm, self.received_ms, self.moves) = (None, 0, false);
    }

    /// Returns what the screw does where the bridge takes the axis to be, in nm.
    pub fn error_nm(&self, table: usize) -> Option<f64> {
        let place = f64::from(self.received_nm?) / f64::from(STEP);
        let knot = (place.floor() as usize).min(KNOTS - 2);
        let [from, to] = [knot, knot + 1].map(|knot| f64::from(TABLES_NM[table][knot]));
        Some(from + (place - knot as f64) * (to - from))
    }
}
