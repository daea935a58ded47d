//! The power of the diagnosis: which errors it would have found, and the smallest measurement that would do.
//!
//! Both questions are answered by the noncentral F distribution. An error of the root mean square δ that
//! repeats, in n rows whose noise is σ, has the noncentrality λ = n·(δ/σ)².
//!
//! - Could any error of a size that matters have been distinguished from noise? One constant next to the zero, at
//!   1 %, in all rows: the error that shows best, because it changes from row to row.
//! - Which error would have been found? Two constants, at the level that the search leaves to each of
//!   its candidates, in as many rows as are independent: an error as slow as the noise, which shows
//!   worst.
//!
//! An axis that was measured once, without a clock, and whose error goes on from position to position, is
//! neither: an uneven screw looks like that, and so does noise with a memory. A second pass distinguishes them.

use std::{collections::BTreeSet, fmt};

pub(super) use trueup_numerics::block_resampling::COVERAGE_FACTOR_95 as COVERAGE;
use trueup_numerics::{
    noise,
    noncentral_f::{f_test_power, required_noncentrality},
    repeats::{SIGNIFICANCE_LEVEL, required_cycles},
};

use crate::{
    candidates::single_input_candidates,
    data::DataTable,
    diagnosis::slow_drift::has_slow_drift,
    fit::{CONFIDENCE_LEVEL, FitProblem},
    search::{
        SearchOutcome, scan::FALSE_ALARM_PROBABILITY, search_state::MIN_RELEVANT_RMS_FRACTION,
    },
};

/// A term has mostly an amplitude and a time constant or a reference.
const TYPICAL_PARAMETERS_PER_TERM: f64 = 2.0;
/// ISO 230-2: five targets at the least.
const MIN_ISO_230_2_TARGETS: usize = 5;
/// No longer record is considered.
const MAX_RECORD_ROWS: usize = 1_000_000;

/// The power of a diagnosis.
#[derive(Clone, Debug)]
pub(crate) struct DetectionPower {
    /// An error of this size that repeats would have been found with 95 %: RMS, in µm, no more than what is
    /// left; infinite where nothing can be promised, because an error as large as all that is left could hide
    /// in it: there are too few rows, or what is left is too slow.
    pub found_um: f64,
    /// The size that matters: RMS, in µm.
    pub matters_um: f64,
    /// Whether an error of the size that matters could have been distinguished from noise.
    pub is_enough: bool,
    /// Whether what is left is as small as what the instrument is worth.
    pub is_of_instrument: bool,
    /// The rows that there are.
    pub rows: usize,
    /// The smallest measurement that would do.
    pub needed: RequiredMeasurement,
}

/// The smallest measurement that would do.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum RequiredMeasurement {
    /// This many cycles at the places where the axis was.
    Cycles { cycles: usize, places: usize, range_mm: [f64; 2] },
    /// A calibration by ISO 230-2.
    Calibration,
    /// A record of this many rows, and so long where there is time.
    Record { rows: usize, seconds: Option<f64> },
    /// None: the instrument is too coarse.
    OtherInstrument,
}

impl DetectionPower {
    /// Of what `found` leaves of `rows` rows, `left_um` RMS; `matters_um`: the size that matters, by
    /// default what is left.
    pub(super) fn new(
        problem: &FitProblem,
        found: &SearchOutcome,
        left_um: f64,
        rows: usize,
        matters_um: Option<f64>,
    ) -> Self {
        let groups = &problem.groups;
        let (count, noise_um) = (groups.len() as f64, found.fitted.rms());
        let instrument_um = problem.data.setting.machine.instrument_um;
        let is_of_instrument = instrument_um.is_some_and(|um| {
            let freedom = rows as f64 - problem.data.setting.quantity.axis().map_or(0.0, |_| 1.0);
            is_within_noise(left_um, um / COVERAGE, rows as f64, freedom)
        });
        let matters_um = match (matters_um, instrument_um) {
            (Some(matters_um), _) => matters_um,
            (None, Some(um)) if is_of_instrument => um,
            _ => left_um,
        };
        // What the instrument is worth is known; what is left is known by the rows alone.
        let known_um = instrument_um.filter(|_| is_of_instrument).map(|um| um / COVERAGE);
        let is_found = |rows: f64| match known_um {
            Some(um) => f_test_power(SIGNIFICANCE_LEVEL, 1.0, f64::from(u16::MAX), rows * (matters_um / um).powi(2)),
            None => f_test_power(SIGNIFICANCE_LEVEL, 1.0, rows - 2.0, rows * signal_to_noise_ratio(matters_um, noise_um).powi(2)),
        } >= CONFIDENCE_LEVEL;
        let candidates =
            single_input_candidates(problem, &found.fitted.model, &found.fitted.residual).len();
        let level = FALSE_ALARM_PROBABILITY / candidates.max(1) as f64;
        let independent = noise::effective_sample_size(found.noise, &groups.steps).min(count);
        let lambda = required_noncentrality(
            CONFIDENCE_LEVEL,
            level,
            TYPICAL_PARAMETERS_PER_TERM,
            independent - TYPICAL_PARAMETERS_PER_TERM - 1.0,
        );
        // What takes away less than that is not worth a term.
        let least = ((1.0 - MIN_RELEVANT_RMS_FRACTION).powi(-2) - 1.0).sqrt();
        let found_um = noise_um * (lambda / independent).sqrt().max(least);
        let is_promised = found_um <= left_um;
        let is_of_position =
            problem.data.time_s().is_none() && problem.data.own_position_mm().is_some();
        let may_be_a_curve =
            is_of_position && !is_promised && !is_of_instrument && has_slow_drift(problem, found);
        let is_detectable = is_found(if known_um.is_some() { rows as f64 } else { count });
        Self {
            found_um: if is_promised { found_um } else { f64::INFINITY },
            matters_um,
            is_enough: is_detectable && !may_be_a_curve,
            is_of_instrument,
            rows,
            needed: RequiredMeasurement::new(
                &problem.data,
                signal_to_noise_ratio(matters_um, left_um),
                &is_found,
            ),
        }
    }
}

/// Returns one over the other; 1 where both are nothing.
fn signal_to_noise_ratio(size: f64, noise: f64) -> f64 {
    if size == noise { 1.0 } else { size / noise }
}

/// Returns whether `left_um` RMS in this many rows is no more than noise of the standard deviation `noise_um`
/// leaves in 95 of 100 cases (χ², by the cube root of Wilson and Hilferty 1931).
fn is_within_noise(left_um: f64, noise_um: f64, rows: f64, freedom: f64) -> bool {
    if freedom < 1.0 {
        return false;
    }
    const NORMAL_QUANTILE_95: f64 = 1.645;
    let third = 2.0 / (9.0 * freedom);
    let most = freedom * (1.0 - third + NORMAL_QUANTILE_95 * third.sqrt()).powi(3);
    rows * (left_um / noise_um).powi(2) <= most
}

impl RequiredMeasurement {
    fn new(data: &DataTable, ratio: f64, is_found: &dyn Fn(f64) -> bool) -> Self {
        if let Some(own) = data.own_position_mm().filter(|_| data.time_s().is_none()) {
            return Self::for_axis(data, own, ratio);
        }
        let Some(rows) = min_sufficient_rows(is_found) else { return Self::OtherInstrument };
        let seconds = data.time_s().and_then(|times| {
            let mut steps: Vec<f64> = times.windows(2).map(|pair| pair[1] - pair[0]).collect();
            steps.retain(|step| *step > 0.0);
            steps.sort_unstable_by(f64::total_cmp);
            steps.get(steps.len() / 2).map(|step| step * rows as f64)
        });
        Self::Record { rows, seconds }
    }

    fn for_axis(data: &DataTable, own: &[f64], ratio: f64) -> Self {
        // Positions to a micrometre.
        let at: BTreeSet<i64> = (0..data.rows)
            .filter(|&row| data.used[row] && own[row].is_finite())
            .map(|row| (own[row] * 1000.0).round() as i64)
            .collect();
        let (Some(&first), Some(&last)) = (at.first(), at.last()) else { return Self::Calibration };
        if at.len() < MIN_ISO_230_2_TARGETS {
            return Self::Calibration;
        }
        let both_sides = 2 * at.len();
        required_cycles(ratio, 1.0, both_sides).map_or(Self::OtherInstrument, |cycles| {
            Self::Cycles {
                cycles,
                places: at.len(),
                range_mm: [first, last].map(|at| at as f64 / 1000.0),
            }
        })
    }
}

/// Returns the fewest rows, at least 3, that are enough; none where a million are not.
fn min_sufficient_rows(is_found: &dyn Fn(f64) -> bool) -> Option<usize> {
    let (mut low, mut high) = (2, 3);
    while !is_found(high as f64) {
        (low, high) = (high, 2 * high);
        if high > MAX_RECORD_ROWS {
            return None;
        }
    }
    while high - low > 1 {
        let middle = usize::midpoint(low, high);
        if is_found(middle as f64) { high = middle } else { low = middle }
    }
    Some(high)
}

impl fmt::Display for RequiredMeasurement {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Cycles { cycles, places, range_mm: [first, last] } => write!(
                f,
                "measure {cycles} cycles at the {places} positions from {first} to {last} mm, each \
                 approached from both sides, with the cycle's number in a column run"
            ),
            Self::Calibration => write!(
                f,
                "measure by ISO 230-2: at least {MIN_ISO_230_2_TARGETS} positions over the travel, five \
                 cycles, each position approached from both sides"
            ),
            Self::Record { rows, seconds: Some(seconds) } if *seconds >= 60.0 => write!(
                f,
                "record at least {rows} rows ({:.0} minutes at this rate) while what may matter changes",
                seconds / 60.0
            ),
            Self::Record { rows, .. } => {
                write!(f, "record at least {rows} rows while what may matter changes")
            }
            Self::OtherInstrument => {
                f.write_str("measure with an instrument of less noise: more readings do not help")
            }
        }
    }
}
