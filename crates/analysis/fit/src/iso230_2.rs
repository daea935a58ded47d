//! The figures of ISO 230-2 for one axis: how accurately and how repeatably it takes a position.
//!
//! At each target i the axis arrives n times in each direction (↑ positive, ↓ negative); x is the
//! positioning deviation, actual minus target. With x̄ᵢ↑ the mean and sᵢ↑ the standard deviation
//! (n − 1) of the arrivals in one direction at one target:
//!
//! ```text
//! x̄ᵢ = (x̄ᵢ↑ + x̄ᵢ↓)/2             Bᵢ = x̄ᵢ↑ − x̄ᵢ↓          B = max |Bᵢ|        B̄ = mean of Bᵢ
//! Rᵢ↑ = 4 sᵢ↑                      R↑ = max Rᵢ↑
//! Rᵢ = max(2 sᵢ↑ + 2 sᵢ↓ + |Bᵢ|, Rᵢ↑, Rᵢ↓)                 R = max Rᵢ
//! E↑ = max x̄ᵢ↑ − min x̄ᵢ↑           E = the same over both directions together
//! M  = max x̄ᵢ − min x̄ᵢ
//! A↑ = max(x̄ᵢ↑ + 2 sᵢ↑) − min(x̄ᵢ↑ − 2 sᵢ↑)                A = the same over both together
//! ```
//!
//! The names are those of the 2014 edition; the editions before say "reversal value" for reversal
//! error and "systematic deviation" for systematic error, with the same formulas. The uncertainty
//! of the measuring instrument is not part of these figures.
//!
//! The standard's B is forward minus reverse. The `width_um` of a machine file is the error of the
//! approach in the negative direction, so it is −B̄.

use std::fmt;

/// The readings at one target: positioning deviations in µm, actual minus target.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct TargetReadings {
    /// The target position in mm.
    pub position_mm: f64,
    /// Of the arrivals in the positive direction; empty if there are none.
    pub forward_um: Vec<f64>,
    /// Of the arrivals in the negative direction; empty if there are none.
    pub reverse_um: Vec<f64>,
}

/// The figures of one axis. All in µm but for positions.
#[derive(Clone, Debug, PartialEq)]
pub struct Iso230Results {
    /// Each target, in the order given.
    pub targets: Vec<TargetResults>,
    /// The axis in the positive direction; `None` if it was not measured.
    pub forward: Option<UnidirectionalResults>,
    /// The axis in the negative direction; `None` if it was not measured.
    pub reverse: Option<UnidirectionalResults>,
    /// Both directions together, from the targets that have both; `None` if there is no such.
    pub both: Option<BidirectionalResults>,
    /// The fewest arrivals at any target in any direction; the standard requires 5.
    pub fewest_runs: usize,
}

/// The figures of one target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TargetResults {
    /// Its position in mm.
    pub position_mm: f64,
    /// Arrivals in the positive direction.
    pub forward: Option<ApproachStatistics>,
    /// Arrivals in the negative direction.
    pub reverse: Option<ApproachStatistics>,
    /// The figures that need both directions.
    pub both: Option<BidirectionalStatistics>,
}

/// Arrivals at one target in one direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ApproachStatistics {
    /// n, at least 2.
    pub runs: usize,
    /// x̄ᵢ↑ or x̄ᵢ↓, the mean unidirectional positioning deviation at a position.
    pub mean_um: f64,
    /// sᵢ↑ or sᵢ↓, the estimator of the unidirectional repeatability at a position.
    pub estimator_um: f64,
    /// Rᵢ↑ or Rᵢ↓, the unidirectional positioning repeatability at a position.
    pub repeatability_um: f64,
}

/// One target by both directions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BidirectionalStatistics {
    /// x̄ᵢ, the mean bi-directional positioning deviation at a position.
    pub mean_um: f64,
    /// Bᵢ, the reversal error at a position: forward minus reverse.
    pub reversal_um: f64,
    /// Rᵢ, the bi-directional positioning repeatability at a position.
    pub repeatability_um: f64,
}

/// An axis in one direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UnidirectionalResults {
    /// R↑ or R↓, the unidirectional positioning repeatability of an axis.
    pub repeatability_um: f64,
    /// E↑ or E↓, the unidirectional systematic positioning error of an axis.
    pub systematic_um: f64,
    /// A↑ or A↓, the unidirectional positioning accuracy of an axis.
    pub accuracy_um: f64,
}

/// An axis by both directions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BidirectionalResults {
    /// B, the reversal error of an axis: the largest magnitude.
    pub reversal_um: f64,
    /// B̄, the mean reversal error of an axis, with its sign.
    pub mean_reversal_um: f64,
    /// R, the bi-directional positioning repeatability of an axis.
    pub repeatability_um: f64,
    /// E, the bi-directional systematic positioning error of an axis.
    pub systematic_um: f64,
    /// M, the mean bi-directional positioning error of an axis.
    pub mean_error_um: f64,
    /// A, the bi-directional positioning accuracy of an axis.
    pub accuracy_um: f64,
}

/// Why there are no figures.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub(crate) enum Iso230Error {
    /// No target has an arrival.
    #[error("no target was measured")]
    Empty,
    /// One arrival in one direction has no standard deviation.
    #[error(
        "the target at {position_mm} mm was measured once in a direction, and repeatability needs at least two"
    )]
    OneArrival {
        /// The target, in mm.
        position_mm: f64,
    },
    /// A deviation or a position is NaN or infinite.
    #[error("a deviation at the target {position_mm} mm is not a finite number")]
    NotFinite {
        /// The target, in mm.
        position_mm: f64,
    },
}

impl Iso230Results {
    /// Returns the figures of an axis measured at `targets`.
    ///
    /// # Errors
    /// No arrival at all, a single one in a direction in which the target was measured, or a value
    /// that is not finite.
    pub(crate) fn from_targets(targets: &[TargetReadings]) -> Result<Self, Iso230Error> {
        let targets: Vec<TargetResults> =
            targets.iter().map(TargetResults::from_readings).collect::<Result<_, _>>()?;
        let approaches =
            || targets.iter().flat_map(|target| [target.forward, target.reverse]).flatten();
        let fewest_runs =
            approaches().map(|statistics| statistics.runs).min().ok_or(Iso230Error::Empty)?;
        Ok(Self {
            forward: UnidirectionalResults::from_approaches(
                targets.iter().filter_map(|target| target.forward),
            ),
            reverse: UnidirectionalResults::from_approaches(
                targets.iter().filter_map(|target| target.reverse),
            ),
            both: BidirectionalResults::from_targets(&targets),
            targets,
            fewest_runs,
        })
    }
}

impl TargetResults {
    fn from_readings(target: &TargetReadings) -> Result<Self, Iso230Error> {
        let position_mm = target.position_mm;
        let all = target.forward_um.iter().chain(&target.reverse_um);
        if !position_mm.is_finite() || !all.clone().all(|um| um.is_finite()) {
            return Err(Iso230Error::NotFinite { position_mm });
        }
        let approach = |um: &[f64]| match um.len() {
            0 => Ok(None),
            1 => Err(Iso230Error::OneArrival { position_mm }),
            _ => Ok(Some(ApproachStatistics::from_deviations(um))),
        };
        let (forward, reverse) = (approach(&target.forward_um)?, approach(&target.reverse_um)?);
        let both = forward
            .zip(reverse)
            .map(|(up, down)| BidirectionalStatistics::from_approaches(&up, &down));
        Ok(Self { position_mm, forward, reverse, both })
    }
}

impl ApproachStatistics {
    fn from_deviations(um: &[f64]) -> Self {
        let n = um.len() as f64;
        let mean_um = um.iter().sum::<f64>() / n;
        let squares: f64 = um.iter().map(|x| (x - mean_um).powi(2)).sum();
        let estimator_um = (squares / (n - 1.0)).sqrt();
        Self { runs: um.len(), mean_um, estimator_um, repeatability_um: 4.0 * estimator_um }
    }
}

impl BidirectionalStatistics {
    fn from_approaches(up: &ApproachStatistics, down: &ApproachStatistics) -> Self {
        let reversal_um = up.mean_um - down.mean_um;
        let combined = 2.0 * up.estimator_um + 2.0 * down.estimator_um + reversal_um.abs();
        Self {
            mean_um: (up.mean_um + down.mean_um) / 2.0,
            reversal_um,
            repeatability_um: combined.max(up.repeatability_um).max(down.repeatability_um),
        }
    }
}

impl UnidirectionalResults {
    fn from_approaches(approaches: impl Iterator<Item = ApproachStatistics>) -> Option<Self> {
        let approaches: Vec<ApproachStatistics> = approaches.collect();
        if approaches.is_empty() {
            return None;
        }
        Some(Self {
            repeatability_um: maximum(approaches.iter().map(|approach| approach.repeatability_um)),
            systematic_um: overall_range(approaches.iter().map(|approach| [approach.mean_um; 2])),
            accuracy_um: overall_range(approaches.iter().map(ApproachStatistics::two_sigma_limits)),
        })
    }
}

impl ApproachStatistics {
    /// x̄ − 2s and x̄ + 2s.
    fn two_sigma_limits(&self) -> [f64; 2] {
        [self.mean_um - 2.0 * self.estimator_um, self.mean_um + 2.0 * self.estimator_um]
    }
}

impl BidirectionalResults {
    fn from_targets(targets: &[TargetResults]) -> Option<Self> {
        let both: Vec<(ApproachStatistics, ApproachStatistics, BidirectionalStatistics)> = targets
            .iter()
            .filter_map(|target| target.forward.zip(target.reverse).zip(target.both))
            .map(|((up, down), both)| (up, down, both))
            .collect();
        if both.is_empty() {
            return None;
        }
        let approaches = || both.iter().flat_map(|(up, down, _)| [up, down]);
        let reversals = || both.iter().map(|(_, _, both)| both.reversal_um);
        Some(Self {
            reversal_um: maximum(reversals().map(f64::abs)),
            mean_reversal_um: reversals().sum::<f64>() / both.len() as f64,
            repeatability_um: maximum(both.iter().map(|(_, _, both)| both.repeatability_um)),
            systematic_um: overall_range(approaches().map(|approach| [approach.mean_um; 2])),
            mean_error_um: overall_range(both.iter().map(|(_, _, both)| [both.mean_um; 2])),
            accuracy_um: overall_range(approaches().map(ApproachStatistics::two_sigma_limits)),
        })
    }
}

fn maximum(values: impl Iterator<Item = f64>) -> f64 {
    values.fold(f64::NEG_INFINITY, f64::max)
}

/// Returns the largest upper end minus the smallest lower end.
fn overall_range(ends: impl Iterator<Item = [f64; 2]>) -> f64 {
    let (low, high) = ends.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), ends| {
        (low.min(ends[0]), high.max(ends[1]))
    });
    high - low
}

impl fmt::Display for Iso230Results {
    /// The table of the targets and the figures of the axis, in µm to two decimals.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let cell = |value: Option<f64>| value.map_or("-".to_string(), |um| format!("{um:.2}"));
        writeln!(f, "ISO 230-2, deviations in µm, actual minus target")?;
        let head = ["i", "P mm", "n", "x̄↑", "x̄↓", "x̄", "B", "s↑", "s↓", "R↑", "R↓", "R"];
        write!(f, "{:>4} {:>11} {:>4}", head[0], head[1], head[2])?;
        for name in &head[3..] {
            // A combining overline is a character without a width of its own.
            let width = 9 + name.matches('\u{304}').count();
            write!(f, " {name:>width$}")?;
        }
        writeln!(f)?;
        for (index, it) in self.targets.iter().enumerate() {
            let runs =
                [it.forward, it.reverse].iter().flatten().map(|statistics| statistics.runs).min();
            write!(f, "{:>4} {:>11} {:>4}", index + 1, it.position_mm, runs.unwrap_or(0))?;
            let (up, down, both) = (it.forward, it.reverse, it.both);
            for value in [
                up.map(|up| up.mean_um),
                down.map(|down| down.mean_um),
                both.map(|both| both.mean_um),
                both.map(|both| both.reversal_um),
                up.map(|up| up.estimator_um),
                down.map(|down| down.estimator_um),
                up.map(|up| up.repeatability_um),
                down.map(|down| down.repeatability_um),
                both.map(|both| both.repeatability_um),
            ] {
                write!(f, " {:>9}", cell(value))?;
            }
            writeln!(f)?;
        }
        let line = |f: &mut fmt::Formatter<'_>, name: &str, symbol: &str, values: [_; 3]| {
            let [up, down, both] = values.map(cell);
            writeln!(f, "{name:<43} {symbol:<2} {up:>9} {down:>9} {both:>9}")
        };
        writeln!(f, "{:<46} {:>9} {:>9} {:>9}", "the axis", "↑", "↓", "both")?;
        let (up, down, both) = (self.forward, self.reverse, self.both);
        line(f, "reversal error", "B", [None, None, both.map(|both| both.reversal_um)])?;
        line(f, "mean reversal error", "B̄", [None, None, both.map(|both| both.mean_reversal_um)])?;
        let repeatability = [
            up.map(|up| up.repeatability_um),
            down.map(|down| down.repeatability_um),
            both.map(|both| both.repeatability_um),
        ];
        line(f, "positioning repeatability", "R", repeatability)?;
        let systematic = [
            up.map(|up| up.systematic_um),
            down.map(|down| down.systematic_um),
            both.map(|both| both.systematic_um),
        ];
        line(f, "systematic positioning error", "E", systematic)?;
        let mean = [None, None, both.map(|both| both.mean_error_um)];
        line(f, "mean bi-directional positioning error", "M", mean)?;
        let accuracy = [
            up.map(|up| up.accuracy_um),
            down.map(|down| down.accuracy_um),
            both.map(|both| both.accuracy_um),
        ];
        line(f, "positioning accuracy", "A", accuracy)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn target(position_mm: f64, forward_um: &[f64], reverse_um: &[f64]) -> TargetReadings {
        TargetReadings { position_mm, forward_um: forward_um.into(), reverse_um: reverse_um.into() }
    }

    #[test]
    fn two_targets_reckoned_in_the_head_give_reversal_systematic_and_mean_error() {
        // Means +1 and −1 at 0 mm, +4 and +3 at 10 mm; all standard deviations 0.
        let targets = [target(0.0, &[1.0; 2], &[-1.0; 2]), target(10.0, &[4.0; 2], &[3.0; 2])];
        let axis = Iso230Results::from_targets(&targets).expect("two targets");
        let both = axis.both.expect("both directions were measured");
        assert_eq!((both.reversal_um, both.mean_reversal_um), (2.0, 1.5));
        // E from −1 to +4; M from the bi-directional means 0 to 3.5.
        assert_eq!((both.systematic_um, both.mean_error_um), (5.0, 3.5));
    }

    /// Three targets, five arrivals each way, with means and deviations that are whole: the sums of
    /// squares about the means are 4 and 16, so s is 1 and 2 with n − 1 = 4.
    fn by_hand() -> Iso230Results {
        let one = |mean: f64| [-1.0, -1.0, 0.0, 1.0, 1.0].map(|off| mean + off);
        let two = |mean: f64| [-2.0, -2.0, 0.0, 2.0, 2.0].map(|off| mean + off);
        Iso230Results::from_targets(&[
            target(0.0, &one(2.0), &one(-1.0)),
            target(90.0, &two(10.0), &one(12.0)),
            target(210.0, &one(-4.0), &two(-5.0)),
        ])
        .expect("all targets are measured both ways")
    }

    #[test]
    fn the_figures_of_a_target_are_those_worked_by_hand() {
        let axis = by_hand();
        let figures: Vec<_> =
            axis.targets.iter().map(|target| target.both.expect("both ways")).collect();
        let of = |mean_um, reversal_um, repeatability_um| BidirectionalStatistics {
            mean_um,
            reversal_um,
            repeatability_um,
        };
        // R: 2·1 + 2·1 + 3, against 4 and 4; 2·2 + 2·1 + 2 = 8, against 8 and 4; 2 + 4 + 1 = 7,
        // against 4 and 8.
        assert_eq!(figures, [of(0.5, 3.0, 7.0), of(11.0, -2.0, 8.0), of(-4.5, 1.0, 8.0)]);
        let second = axis.targets[1].forward.expect("measured");
        assert_eq!(
            second,
            ApproachStatistics { runs: 5, mean_um: 10.0, estimator_um: 2.0, repeatability_um: 8.0 }
        );
    }

    #[test]
    fn the_figures_of_an_axis_are_those_worked_by_hand() {
        let axis = by_hand();
        // x̄↑ 2, 10, −4: E 14; +2s: 4, 14, −2, −2s: 0, 6, −6: A 20.
        let forward =
            UnidirectionalResults { repeatability_um: 8.0, systematic_um: 14.0, accuracy_um: 20.0 };
        // x̄↓ −1, 12, −5: E 17; +2s: 1, 14, −1; −2s: −3, 10, −9: A 23.
        let reverse =
            UnidirectionalResults { repeatability_um: 8.0, systematic_um: 17.0, accuracy_um: 23.0 };
        assert_eq!((axis.forward, axis.reverse), (Some(forward), Some(reverse)));
        let both = BidirectionalResults {
            reversal_um: 3.0,
            mean_reversal_um: 2.0 / 3.0,
            repeatability_um: 8.0,
            // 12 − (−5)
            systematic_um: 17.0,
            // 11 − (−4.5)
            mean_error_um: 15.5,
            // 14 − (−9)
            accuracy_um: 23.0,
        };
        assert_eq!(axis.both, Some(both));
        assert_eq!(axis.fewest_runs, 5);
    }

    #[test]
    fn both_together_can_be_worse_than_either_direction() {
        // Each direction is flat, and they lie 10 apart: E↑ = E↓ = 0, E = 10.
        let axis = Iso230Results::from_targets(&[
            target(0.0, &[10.0, 10.0], &[0.0, 0.0]),
            target(50.0, &[10.0, 10.0], &[0.0, 0.0]),
        ])
        .expect("both ways");
        let both = axis.both.expect("both ways");
        assert_eq!(axis.forward.map(|forward| forward.accuracy_um), Some(0.0));
        assert_eq!((both.systematic_um, both.accuracy_um, both.mean_error_um), (10.0, 10.0, 0.0));
        assert_eq!(both.repeatability_um, 10.0);
    }

    #[test]
    fn one_direction_alone_has_no_figures_of_both() {
        let axis = Iso230Results::from_targets(&[
            target(0.0, &[1.0, 2.0], &[]),
            target(9.0, &[1.0, 1.0], &[]),
        ])
        .expect("forward");
        assert!(axis.both.is_none() && axis.reverse.is_none() && axis.forward.is_some());
        assert!(axis.to_string().contains(" -"));
    }

    #[test]
    fn what_has_no_deviation_is_refused() {
        let of = |targets: &[TargetReadings]| {
            Iso230Results::from_targets(targets).expect_err("it has none")
        };
        assert_eq!(of(&[]), Iso230Error::Empty);
        let once = of(&[target(5.0, &[1.0], &[])]);
        assert_eq!(once, Iso230Error::OneArrival { position_mm: 5.0 });
        let infinite = of(&[target(5.0, &[1.0, f64::NAN], &[])]);
        assert_eq!(infinite, Iso230Error::NotFinite { position_mm: 5.0 });
    }
}
