//! What a record leaves, where nothing in it shows that the gauge did it.
//!
//! Readings scattered over the travels of several axes have no neighbours: what differs from one to the next may be noise,
//! or a law of the positions that no term has. Places that were measured twice, or a gauge whose uncertainty is stated,
//! settle that. Along a pass the neighbours say what the noise is, and an axis measured in cycles has a judge of its own.

use std::{collections::HashMap, fmt};

use trueup_page::format_micrometres;

use crate::{
    data::DataTable,
    diagnosis::detection_power::COVERAGE,
    repeats::{MAX_REPEATABILITY_STD_UM, POSITION_TOLERANCE_MM, RepeatStatistics},
    search::model_comparison::MAJORITY_FRACTION,
};

/// Second readings from which a scatter is known: to a third, by its χ² with five degrees of freedom.
const MIN_REPEAT_READINGS: usize = 5;

/// A residual that nothing shows to be the gauge's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct UnexplainedResidual {
    /// RMS in µm.
    left_um: f64,
    /// The standard deviation of the gauge in µm, where that is known: then the rest is the machine's.
    gauge_um: Option<f64>,
    /// Whether it is most of the error: the names may stand for another law.
    pub is_most: bool,
}

impl UnexplainedResidual {
    /// Returns what is left of `before_um` (RMS), where it is more than a machine scatters and not shown to be the
    /// gauge's. `errors` are of all rows, in µm; NaN where one does not count.
    pub(super) fn detect(
        data: &DataTable,
        repeats: Option<&RepeatStatistics>,
        [before_um, left_um]: [f64; 2],
        errors: &[f64],
    ) -> Option<Self> {
        let has_random_order = data.positions_mm().into_iter().flatten().any(has_random_order);
        if repeats.is_some() || !has_random_order {
            return None;
        }
        let stated_um = data.setting.machine.instrument_um.map(|um| um / COVERAGE);
        let gauge_um = stated_um.or_else(|| repeatability_std_um(data, errors));
        let is_explained = gauge_um.is_some_and(|um| left_um <= COVERAGE * um);
        (left_um > MAX_REPEATABILITY_STD_UM && !is_explained).then_some(Self {
            left_um,
            gauge_um,
            is_most: left_um > MAJORITY_FRACTION * before_um,
        })
    }
}

/// Returns whether positions come in no order, so that neighbouring rows are no neighbours: the mean square of a step is at
/// least their variance, half of what it is in random order (von Neumann's ratio is 2), where a pass has nearly 0.
fn has_random_order(mm: &[f64]) -> bool {
    let known: Vec<f64> = mm.iter().copied().filter(|mm| !mm.is_nan()).collect();
    let count = known.len().max(1) as f64;
    let mean = known.iter().sum::<f64>() / count;
    let variance = known.iter().map(|mm| (mm - mean).powi(2)).sum::<f64>() / count;
    let steps = known.windows(2).map(|pair| (pair[1] - pair[0]).powi(2)).sum::<f64>();
    variance > 0.0 && steps / (count - 1.0) >= variance
}

/// Returns the standard deviation of readings at one place, in µm, where enough places were measured again.
fn repeatability_std_um(data: &DataTable, errors: &[f64]) -> Option<f64> {
    let place = |row: usize| {
        data.positions_mm().map(|axis| {
            let mm = axis.map_or(0.0, |mm| mm[row]);
            (mm / POSITION_TOLERANCE_MM).round() as i64
        })
    };
    let mut places: HashMap<[i64; 3], Vec<f64>> = HashMap::new();
    for (row, um) in errors.iter().enumerate().filter(|(_, um)| !um.is_nan()) {
        places.entry(place(row)).or_default().push(*um);
    }
    let (mut squares, mut second) = (0.0, 0);
    for readings in places.values() {
        let mean = readings.iter().sum::<f64>() / readings.len() as f64;
        squares += readings.iter().map(|um| (um - mean).powi(2)).sum::<f64>();
        second += readings.len() - 1;
    }
    (second >= MIN_REPEAT_READINGS).then(|| (squares / second as f64).sqrt())
}

impl fmt::Display for UnexplainedResidual {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let left = format_micrometres(self.left_um);
        match self.gauge_um {
            Some(um) => write!(
                f,
                "what is left, {left} RMS, is more than the gauge scatters, {}: it is the machine's, and no cause explains it",
                format_micrometres(um)
            ),
            None => write!(
                f,
                "what is left, {left} RMS, may be the machine as well as the gauge. Hardly a \
                 position is repeated, and the uncertainty of the gauge is not stated \
                 ([instrument] uncertainty_um). Measure {MIN_REPEAT_READINGS} positions twice \
                 or more"
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use trueup_machine::{MachineFile, RunFile};

    use super::*;

    fn of(machine: &str, run: &str, left_um: f64, errors: &[f64]) -> Option<UnexplainedResidual> {
        let machine = format!("[machine]\nname = \"m\"\nkind = \"3-axis\"\n{machine}");
        let machine = MachineFile::parse(&machine, Path::new("m.toml")).expect("a machine file");
        let run = RunFile::from_reader(run.as_bytes(), Path::new("r.csv")).expect("a run file");
        let quantity =
            crate::data::resolve_quantity(std::slice::from_ref(&run), None).expect("one");
        let data = DataTable::with_offset_factor(&machine, &[run], quantity, 0.0).expect("data");
        UnexplainedResidual::detect(&data, None, [20.0, left_um], errors)
    }

    const SCATTERED: &str = "x_mm,y_mm,measured_dx_um\n1,2,3\n90,40,-20\n30,70,11\n";

    #[test]
    fn what_is_left_of_scattered_positions_has_no_known_origin() {
        let rest = of("", SCATTERED, 8.0, &[8.0, -8.0, f64::NAN]).expect("unknown");
        assert_eq!((rest.left_um, rest.gauge_um, rest.is_most), (8.0, None, false));
        assert!(of("", SCATTERED, 11.0, &[11.0; 3]).expect("unknown").is_most);
        // A clock adds no information.
        let timed = "time_s,x_mm,measured_dx_um\n0,1,3\n1,90,-20\n2,30,11\n";
        assert!(of("", timed, 8.0, &[8.0; 3]).is_some());
        // A machine may scatter so; neighbours of a pass show the noise; nothing moves.
        assert_eq!(of("", SCATTERED, 4.0, &[4.0; 3]), None);
        let pass = "x_mm,measured_dx_um\n0,3\n10,-20\n20,11\n30,4\n40,-2\n";
        assert_eq!(of("", pass, 8.0, &[8.0; 5]), None);
        let at_rest = "x_mm,measured_dx_um\n5,3\n5,-20\n5,11\n";
        assert_eq!(of("", at_rest, 8.0, &[8.0; 3]), None);
    }

    #[test]
    fn a_gauge_that_is_stated_says_whose_the_rest_is() {
        let stated = |um: f64| format!("[instrument]\nuncertainty_um = {um:.1}\n");
        assert_eq!(of(&stated(30.0), SCATTERED, 8.0, &[8.0; 3]), None);
        let rest = of(&stated(4.0), SCATTERED, 8.0, &[8.0; 3]).expect("the machine's");
        assert_eq!(rest.gauge_um, Some(2.0));
        assert!(rest.to_string().contains("it is the machine's"), "{rest}");
    }

    /// Five places, each twice, 2 µm apart: a standard deviation of √2 µm.
    #[test]
    fn places_that_were_measured_twice_say_it_as_well() {
        let mut run = "x_mm,y_mm,measured_dx_um\n".to_string();
        for n in [0, 3, 1, 4, 2, 0, 3, 1, 4, 2] {
            run += &format!("{},{},{n}\n", 10 * n, 7 * n);
        }
        let apart = |um: f64| (0..10).map(|n| 8.0 + um * f64::from(n / 5)).collect::<Vec<_>>();
        let rest = of("", &run, 9.0, &apart(2.0)).expect("the machine's");
        assert!((rest.gauge_um.expect("known") - 2.0_f64.sqrt()).abs() < 1e-12);
        assert_eq!(of("", &run, 9.0, &apart(16.0)), None);
        // Four second readings are too few.
        let mut few = apart(2.0);
        few[0] = f64::NAN;
        assert_eq!(of("", &run, 9.0, &few).expect("unknown").gauge_um, None);
    }
}
