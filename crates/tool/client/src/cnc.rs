//! The CNC's messages to the bridge, where they can be received: on a CAN bus, not on the bridge's own
//! serial line.

use trueup_core::{
    cnc::{CncMessage, MachineConditions},
    units::{MicroDegrees, Position},
};
use trueup_link::{frame::Frame, receiver::CncReceiver};

/// How long a value from the CNC counts, in ms of the bridge.
const VALUE_TIMEOUT_MS: u64 = 500;
/// Its columns of a run file; two angles come after them, whose names the machine file knows.
pub(crate) const CNC_COLUMNS: [&str; 8] =
    ["spindle_rpm", "load_n", "x_mm", "y_mm", "z_mm", "dir_x", "dir_y", "dir_z"];
/// Decimals of each in a run file; the angles stand last.
const COLUMN_DECIMALS: [usize; CNC_VALUE_COUNT] = [0, 0, 5, 5, 5, 0, 0, 0, 4, 4];
const CNC_VALUE_COUNT: usize = CNC_COLUMNS.len() + 2;

/// The CNC's state, where it can be received: the values of its columns of a run file and two angles, and when.
#[derive(Default)]
pub struct CncState {
    receiver: CncReceiver,
    values: [Option<(f64, u64)>; CNC_VALUE_COUNT],
    conditions: Option<(MachineConditions, u64)>,
}

impl CncState {
    /// Takes a frame from the bus at this time of the bridge.
    pub fn receive(&mut self, frame: &Frame, now_ms: u64) {
        let Ok(Some(command)) = self.receiver.accept(frame) else { return };
        let mut note = |column: usize, value: f64| self.values[column] = Some((value, now_ms));
        match command {
            CncMessage::Control(_) => {}
            CncMessage::Conditions(it) => self.conditions = Some((it, now_ms)),
            CncMessage::Spindle(spindle) => {
                note(0, spindle.speed.0.into());
                note(1, spindle.load_n.into());
            }
            CncMessage::Position(it) => {
                let mm = f64::from(it.position.0) / f64::from(Position::PER_MILLIMETRE);
                note(2 + it.axis as usize, mm);
                note(5 + it.axis as usize, f64::from(it.direction as i8));
            }
            CncMessage::Rotary(it) => {
                for (column, angle) in (8..).zip(it.angles) {
                    note(column, f64::from(angle.0) / f64::from(MicroDegrees::PER_DEGREE));
                }
            }
        }
    }

    fn value(&self, column: usize, now_ms: u64) -> Option<f64> {
        let (value, at_ms) = self.values[column]?;
        (now_ms.saturating_sub(at_ms) <= VALUE_TIMEOUT_MS).then_some(value)
    }

    /// Returns the tool and the conditions of the machine.
    #[must_use]
    pub fn conditions(&self, now_ms: u64) -> Option<MachineConditions> {
        let (conditions, at_ms) = self.conditions?;
        (now_ms.saturating_sub(at_ms) <= VALUE_TIMEOUT_MS).then_some(conditions)
    }

    /// Returns the speed of the spindle in r/min, at least 0.
    #[must_use]
    pub fn spindle_rpm(&self, now_ms: u64) -> Option<f64> {
        self.value(0, now_ms)
    }

    /// Returns the axial cutting force in N; pushing the tool back is positive.
    #[must_use]
    pub fn load_n(&self, now_ms: u64) -> Option<f64> {
        self.value(1, now_ms)
    }

    /// Returns the commanded positions of X, Y and Z in mm.
    #[must_use]
    pub fn position_mm(&self, now_ms: u64) -> [Option<f64>; 3] {
        [2, 3, 4].map(|column| self.value(column, now_ms))
    }

    /// Returns the directions of approach of X, Y and Z: +1, −1, or 0 where the CNC does not say.
    #[must_use]
    pub fn direction(&self, now_ms: u64) -> [Option<f64>; 3] {
        [5, 6, 7].map(|column| self.value(column, now_ms))
    }

    /// Returns the angles in degrees, in the order of the axes that carry the spindle.
    #[must_use]
    pub fn rotary_angles_deg(&self, now_ms: u64) -> [Option<f64>; 2] {
        [8, 9].map(|column| self.value(column, now_ms))
    }

    /// Returns the cells of a row at this time of the bridge, empty where nothing is known.
    pub(crate) fn row_cells(&self, now_ms: u64) -> impl Iterator<Item = String> {
        COLUMN_DECIMALS.into_iter().enumerate().map(move |(column, decimals)| {
            self.value(column, now_ms)
                .map(|value| format!("{value:.decimals$}"))
                .unwrap_or_default()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use trueup_core::{
        cnc::{AxisPosition, LinearAxis, RotaryAxisAngles, SpindleState, TravelDirection},
        units::Rpm,
    };
    use trueup_link::frames;

    #[test]
    fn what_the_cnc_says_stands_in_its_columns_until_it_is_old() {
        let mut cnc = CncState::default();
        let spindle = SpindleState { speed: Rpm(12_000), load_n: -7 };
        cnc.receive(&frames::encode_spindle(spindle, 0), 1_000);
        let z = AxisPosition {
            axis: LinearAxis::Z,
            position: Position(-12_345_678),
            direction: TravelDirection::Negative,
        };
        cnc.receive(&frames::encode_position(z, 0), 1_200);
        let rotary =
            RotaryAxisAngles { angles: [MicroDegrees(-90_000_000), MicroDegrees(1_234_567)] };
        cnc.receive(&frames::encode_rotary(rotary, 0), 1_300);
        let at = |ms| cnc.row_cells(ms).collect::<Vec<_>>().join(",");
        assert_eq!(at(1_500), "12000,-7,,,-123.45678,,,-1,-90.0000,1.2345");
        assert_eq!(at(1_501), ",,,,-123.45678,,,-1,-90.0000,1.2345");
        assert_eq!(at(1_801), ",,,,,,,,,");
        assert_eq!(cnc.position_mm(1_700), [None, None, Some(-123.456_78)]);
        let [first, second] =
            cnc.rotary_angles_deg(1_800).map(|angle_deg| angle_deg.expect("heard"));
        // The wire has 0.0001°.
        assert!(first == -90.0 && (second - 1.234_567).abs() < 1e-4, "{first} {second}");
        assert_eq!((cnc.spindle_rpm(1_500), cnc.load_n(1_501)), (Some(12_000.0), None));
    }
}
