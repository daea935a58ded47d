//! What the CNC says, where it can be heard, as cells of a run file.

use trueup_core::{
    cnc::Command,
    units::{MicroDegrees, Position},
};
use trueup_link::{frame::Frame, receiver::Receiver};

use super::decimals;

/// What the CNC has said counts for so long, in ms of the bridge.
const TIMEOUT_MS: u64 = 500;
/// Its columns of a run file; two angles come after them, whose names the machine file knows.
pub const COLUMNS: [&str; 8] =
    ["spindle_rpm", "load_n", "x_mm", "y_mm", "z_mm", "dir_x", "dir_y", "dir_z"];
const CELLS: usize = COLUMNS.len() + 2;

/// What the CNC has said, where it can be heard: the cells, and when.
#[derive(Default)]
pub struct Cnc {
    receiver: Receiver,
    cells: [Option<(String, u64)>; CELLS],
}

impl Cnc {
    /// Takes a frame from the bus at this time of the bridge.
    pub fn hear(&mut self, frame: &Frame, now_ms: u64) {
        let Ok(Some(command)) = self.receiver.accept(frame) else { return };
        let mut note = |column: usize, cell: String| self.cells[column] = Some((cell, now_ms));
        match command {
            Command::Control(_) => {}
            Command::Spindle(spindle) => {
                note(0, spindle.speed.0.to_string());
                note(1, spindle.load_n.to_string());
            }
            Command::Position(it) => {
                let mm = f64::from(it.position.0) / f64::from(Position::PER_MILLIMETRE);
                note(2 + it.axis as usize, decimals(Some(mm), 5));
                note(5 + it.axis as usize, (it.direction as i8).to_string());
            }
            Command::Rotary(it) => {
                for (column, angle) in (8..).zip(it.angles) {
                    let degrees = f64::from(angle.0) / f64::from(MicroDegrees::PER_DEGREE);
                    note(column, decimals(Some(degrees), 4));
                }
            }
        }
    }

    /// The cells of a row at this time of the bridge, empty where nothing is known.
    pub fn cells(&self, now_ms: u64) -> impl Iterator<Item = String> {
        self.cells.iter().map(move |cell| match cell {
            Some((cell, at_ms)) if now_ms.saturating_sub(*at_ms) <= TIMEOUT_MS => cell.clone(),
            _ => String::new(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use trueup_core::{
        cnc::{AxisPosition, Heading, LinearAxis, Rotary, Spindle},
        units::Rpm,
    };
    use trueup_link::frames;

    #[test]
    fn what_the_cnc_says_stands_in_its_columns_until_it_is_old() {
        let mut cnc = Cnc::default();
        let spindle = Spindle { speed: Rpm(12_000), load_n: -7 };
        cnc.hear(&frames::spindle(spindle, 0), 1_000);
        let z = AxisPosition {
            axis: LinearAxis::Z,
            position: Position(-12_345_678),
            direction: Heading::Negative,
        };
        cnc.hear(&frames::position(z, 0), 1_200);
        let rotary = Rotary { angles: [MicroDegrees(-90_000_000), MicroDegrees(1_234_567)] };
        cnc.hear(&frames::rotary(rotary, 0), 1_300);
        let at = |ms| cnc.cells(ms).collect::<Vec<_>>().join(",");
        assert_eq!(at(1_500), "12000,-7,,,-123.45678,,,-1,-90.0000,1.2345");
        assert_eq!(at(1_501), ",,,,-123.45678,,,-1,-90.0000,1.2345");
        assert_eq!(at(1_801), ",,,,,,,,,");
    }
}
