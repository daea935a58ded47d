//! What a record leaves, where nothing in it shows whether the gauge or the machine did it.
//!
//! Readings scattered over the travels of several axes have no neighbours: what differs from one to the next may be noise,
//! or a law of the positions that no term has. Repeats, a gauge whose uncertainty is stated, or a clock of readings
//! at rest settle that.

use std::fmt;

use trueup_page::micrometres;

use crate::{
    data::Data,
    repeats::{REPEATABLE_UM, Repeats},
};

/// With more than this share of the error left the names may stand for another law.
const MOST: f64 = 0.5;

/// A residual of unknown origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct UnknownRest {
    /// RMS in µm.
    pub left_um: f64,
    /// Whether it is most of the error.
    pub is_most: bool,
}

impl UnknownRest {
    /// Returns what is left of `before_um` (RMS), where it is more than a machine scatters and nothing shows its noise.
    pub(super) fn of(
        data: &Data,
        repeats: Option<&Repeats>,
        [before_um, left_um]: [f64; 2],
    ) -> Option<Self> {
        let is_known =
            repeats.is_some() || data.machine.instrument_um.is_some() || data.time_s.is_some();
        let moves = data.position_mm.iter().flatten().any(|mm| is_moving(mm));
        (!is_known && moves && left_um > REPEATABLE_UM)
            .then_some(Self { left_um, is_most: left_um > MOST * before_um })
    }
}

fn is_moving(mm: &[f64]) -> bool {
    let known = mm.iter().filter(|mm| !mm.is_nan());
    let (low, high) = known
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), &mm| (low.min(mm), high.max(mm)));
    high > low
}

impl fmt::Display for UnknownRest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "what is left, {} RMS, may be the machine as well as the gauge: no position comes again, and the \
             uncertainty of the gauge is not stated ([instrument] uncertainty_um). Measure each position twice",
            micrometres(self.left_um)
        )
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use trueup_machine::{MachineFile, RunFile};

    use super::*;

    fn of(machine: &str, run: &str, left_um: f64) -> Option<UnknownRest> {
        let machine = format!("[machine]\nname = \"m\"\nkind = \"3-axis\"\n{machine}");
        let machine = MachineFile::parse(&machine, Path::new("m.toml")).expect("a machine file");
        let run = RunFile::from_reader(run.as_bytes(), Path::new("r.csv")).expect("a run file");
        let quantity = crate::data::quantity_of(std::slice::from_ref(&run), None).expect("one");
        let data = Data::applied(&machine, &[run], quantity, 0.0).expect("data");
        UnknownRest::of(&data, None, [20.0, left_um])
    }

    const SCATTERED: &str = "x_mm,y_mm,measured_dx_um\n1,2,3\n90,40,-20\n30,70,11\n";

    #[test]
    fn what_is_left_of_scattered_positions_has_no_known_origin() {
        let rest = of("", SCATTERED, 8.0).expect("unknown");
        assert_eq!((rest.left_um, rest.is_most), (8.0, false));
        assert!(of("", SCATTERED, 11.0).expect("unknown").is_most);
        // A machine may scatter so; the gauge is stated; a clock shows readings at rest; nothing moves.
        assert_eq!(of("", SCATTERED, 4.0), None);
        assert_eq!(of("[instrument]\nuncertainty_um = 30.0\n", SCATTERED, 8.0), None);
        let timed = "time_s,x_mm,measured_dx_um\n0,1,3\n1,90,-20\n2,30,11\n";
        assert_eq!(of("", timed, 8.0), None);
        let at_rest = "x_mm,measured_dx_um\n5,3\n5,-20\n5,11\n";
        assert_eq!(of("", at_rest, 8.0), None);
    }
}
