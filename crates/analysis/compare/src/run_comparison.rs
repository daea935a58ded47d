//! Two runs place by place: unloaded against cut (paper 3), this year against last.
//!
//! ```text
//! d(place) = mean B − mean A,   its 95 %: t·s·√(1/n_A + 1/n_B),   s from the repeats at all places
//! ```
//!
//! Readings that stand alone among the repeats of their place are excluded and listed by line, as in `fit pitch`.
//!
//! A place is a position with its direction of approach. The zero of an axis's gauge is arbitrary, so the
//! mean of all differences is distinguished and taken off. The rest is tested against these laws, the simplest first,
//!
//! ```text
//! nothing, backlash (w where d < 0), a slope along the axis that moved, both, a curve (another at each place)
//! ```
//!
//! and the law of least BIC is the answer, if it is better than nothing by strong evidence (6, Kass and
//! Raftery 1995). A curve has a value a place, so it is only distinguished from the others with repeats.

use std::fmt::Display;

use serde::Serialize;
use trueup_machine::{InputFileError, Location, RunFile, machine_file::Quantity};
use trueup_numerics::{
    least_squares::GivensQr,
    repeats::{self, cycle_numbers, find_gross_errors, group_positions},
    t_quantile,
};

/// A difference of BIC from which evidence is strong.
const STRONG_EVIDENCE_BIC_DIFFERENCE: f64 = 6.0;
/// Places nearer than this are one, in mm: a tenth of the finest spacing in use, as `accept` has it.
const POSITION_TOLERANCE_MM: f64 = 0.1;
/// The fewest places that both runs have.
const MIN_COMMON_POSITIONS: usize = 3;

/// The difference at one place.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PositionDifference {
    /// Where, in mm.
    pub at_mm: f64,
    /// How it was approached: 1 or −1; 0 where the runs do not say.
    pub direction: i8,
    /// Mean of B minus mean of A, in µm, the shift of all taken off.
    pub difference_um: f64,
    /// Half its 95 % interval in µm; `None` without repeats.
    pub half_width_um: Option<f64>,
    /// Readings of A and of B.
    pub readings: [usize; 2],
}

/// A constant that is another one in B.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ParameterChange {
    /// Of which cause: `backlash` in µm, `pitch-scale` or `cross-axis` in µm/m.
    pub cause: &'static str,
    /// B minus A.
    pub value: f64,
    /// Half its 95 % interval.
    pub half_width: f64,
}

/// A reading that was excluded as an outlier.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ExcludedReading {
    /// The run: 0 is A, 1 is B.
    pub file: usize,
    /// Its line in the file, from 1.
    pub line: usize,
    /// The reading in µm.
    pub measured_um: f64,
}

/// The difference between two runs.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RunComparison {
    /// The measured quantity: `dx`.
    pub quantity: String,
    /// The column of the places: `x_mm`.
    pub over: String,
    /// Mean of all differences, in µm: the gauge's zero, or a shift of the machine.
    pub shift_um: f64,
    /// Half its 95 % interval.
    pub shift_half_width_um: Option<f64>,
    /// Each place.
    pub places: Vec<PositionDifference>,
    /// Places that only one of the runs has.
    pub unmatched: usize,
    /// Standard deviation of one reading, from the repeats, in µm.
    pub repeatability_um: Option<f64>,
    /// Root mean square and largest difference in µm.
    pub rms_um: f64,
    /// The largest one.
    pub max_um: f64,
    /// Whether they differ by more than repeats do.
    pub differs: bool,
    /// The cause that explains it, by its name in the reference.
    pub cause: Option<&'static str>,
    /// Each change with its size; empty for a curve, which is in the places.
    pub changes: Vec<ParameterChange>,
    /// Readings that were excluded as outliers.
    pub outliers: Vec<ExcludedReading>,
    /// The difference in sentences.
    pub sentences: Vec<String>,
}

struct PositionReading {
    /// In the file, from 0.
    row: usize,
    at: f64,
    direction: i8,
    um: f64,
}

/// Compares what `a` and `b` measured of `asked`, or of the only quantity that both have.
///
/// # Errors
/// They do not measure the same, or have fewer than three places in common.
pub fn compare_runs(
    a: &RunFile,
    b: &RunFile,
    requested: Option<Quantity>,
) -> Result<RunComparison, InputFileError> {
    let quantity = resolve_common_quantity(b, (a, a.path().display()), requested)?;
    let over = find_longest_travel_column(a, b, quantity)?;
    let rows = [
        extract_position_readings(a, quantity, &over)?,
        extract_position_readings(b, quantity, &over)?,
    ];
    let all: Vec<f64> = rows.iter().flatten().map(|row| row.at).collect();
    let (targets, target_of) = group_positions(&all, 10.0 * POSITION_TOLERANCE_MM);
    // By place and direction: the readings of A and of B.
    let mut cells: Vec<[Vec<f64>; 2]> = vec![<[Vec<f64>; 2]>::default(); 3 * targets.len()];
    let (of_a, of_b) = target_of.split_at(rows[0].len());
    let found = [flag_outliers(&rows[0], of_a), flag_outliers(&rows[1], of_b)].concat();
    let mut outliers = Vec::new();
    let numbered =
        rows.iter().enumerate().flat_map(|(run, rows)| rows.iter().map(move |row| (run, row)));
    for (((run, row), target), is_outlier) in numbered.zip(target_of).zip(found) {
        if is_outlier {
            let place =
                [a, b][run].value_location(row.row, &format!("measured_{}_um", quantity.name()));
            outliers.push(ExcludedReading { file: run, line: place.line, measured_um: row.um });
            continue;
        }
        let way = usize::try_from(row.direction + 1).unwrap_or(1);
        cells[3 * target + way][run].push(row.um);
    }
    let mean = |um: &[f64]| um.iter().sum::<f64>() / um.len() as f64;
    let (mut squares, mut freedom) = (0.0, 0);
    for um in cells.iter().flatten().filter(|um| um.len() > 1) {
        squares += um.iter().map(|value| (value - mean(um)).powi(2)).sum::<f64>();
        freedom += um.len() - 1;
    }
    let variance = (freedom > 0).then(|| squares / freedom as f64);
    let t = if freedom > 0 { t_quantile(0.975, freedom as f64) } else { f64::NAN };
    let mut found = Vec::new();
    let mut unmatched = 0;
    for (number, [a, b]) in cells.iter().enumerate() {
        match (a.len(), b.len()) {
            (0, 0) => {}
            (0, _) | (_, 0) => unmatched += 1,
            (n_a, n_b) => {
                let share = 1.0 / n_a as f64 + 1.0 / n_b as f64;
                found.push(PositionDifference {
                    at_mm: targets[number / 3],
                    direction: (number % 3) as i8 - 1,
                    difference_um: mean(b) - mean(a),
                    half_width_um: variance.map(|variance| t * (variance * share).sqrt()),
                    readings: [n_a, n_b],
                });
            }
        }
    }
    if found.len() < MIN_COMMON_POSITIONS {
        let rule = format!(
            "has {} places in common with {}, and {MIN_COMMON_POSITIONS} are needed: run the same program in both",
            found.len(),
            a.path().display()
        );
        return Err(InputFileError::new(Location::start_of_file(b.path()), rule));
    }
    let mut comparison = summarise_differences(quantity, over, found, unmatched, variance, t);
    let describe = |reading: &ExcludedReading| {
        let path = [a, b][reading.file].path().display();
        format!("{path}:{} ({:+.1} µm)", reading.line, reading.measured_um)
    };
    if !outliers.is_empty() {
        let all: Vec<String> = outliers.iter().map(describe).collect();
        comparison.sentences.push(format!(
            "Excluded as outliers, far from the other readings at their place: {}.",
            all.join(", ")
        ));
    }
    comparison.outliers = outliers;
    Ok(comparison)
}

/// Returns which readings of a run stand alone among the repeats of their place.
fn flag_outliers(rows: &[PositionReading], targets: &[usize]) -> Vec<bool> {
    // Where a run does not say the direction, as if all came from one side.
    let side = |row: &PositionReading| usize::from(row.direction < 0);
    let stops = rows.iter().zip(targets).map(|(row, target)| (*target, side(row)));
    let stops: Vec<(usize, usize)> = stops.collect();
    let cycles = cycle_numbers(&stops);
    let readings = rows.iter().zip(&stops).zip(cycles);
    let readings = readings.map(|((row, (place, side)), cycle)| repeats::RepeatReading {
        place: *place,
        side: *side,
        cycle,
        value: row.um,
    });
    find_gross_errors(&readings.collect::<Vec<_>>())
}

fn summarise_differences(
    quantity: Quantity,
    over: String,
    mut places: Vec<PositionDifference>,
    unmatched: usize,
    variance: Option<f64>,
    t: f64,
) -> RunComparison {
    let count = places.len() as f64;
    let shift_um = places.iter().map(|place| place.difference_um).sum::<f64>() / count;
    let shares: f64 =
        places.iter().map(|place| place.readings.map(|n| 1.0 / n as f64).iter().sum::<f64>()).sum();
    let shift_half_width_um = variance.map(|variance| t * (variance * shares).sqrt() / count);
    places.iter_mut().for_each(|place| place.difference_um -= shift_um);
    let um: Vec<f64> = places.iter().map(|place| place.difference_um).collect();
    let rms_um = (um.iter().map(|um| um * um).sum::<f64>() / count).sqrt();
    let max_um = um.iter().fold(0.0_f64, |most, um| most.max(um.abs()));
    let along = over.strip_suffix("_mm")
        == quantity.axis().map(trueup_machine::machine_file::LinearAxis::name);
    let laws = DifferenceModel::fit_candidates(&places, along, variance);
    let best = laws.iter().min_by(|a, b| a.bic.total_cmp(&b.bic));
    let nothing = laws[0].bic;
    let best = best
        .filter(|best| best.constants > 1 && nothing - best.bic >= STRONG_EVIDENCE_BIC_DIFFERENCE);
    let mut sentences = best.map_or_else(Vec::new, |best| best.sentences.clone());
    if best.is_none() {
        sentences.push("The two runs do not differ by more than their readings scatter.".into());
    }
    if quantity.axis().is_some() {
        sentences.push(format!(
            "A shift of {shift_um:+.2} µm everywhere is taken off: the zero of a gauge is arbitrary."
        ));
    }
    if unmatched > 0 {
        sentences.push(format!("{unmatched} places are in one run only, and do not count."));
    }
    if variance.is_none() {
        sentences.push(
            "No place was read twice in a run, so the scatter of readings is taken \
            from what the simplest law leaves. Repeat each place to be sure."
                .into(),
        );
    }
    RunComparison {
        quantity: quantity.name().into(),
        over,
        shift_um,
        shift_half_width_um,
        unmatched,
        repeatability_um: variance.map(f64::sqrt),
        rms_um,
        max_um,
        differs: best.is_some(),
        cause: best.and_then(|best| best.cause),
        changes: best.map_or_else(Vec::new, |best| best.changes.clone()),
        outliers: Vec::new(),
        sentences,
        places,
    }
}

/// A law of the differences, fitted.
struct DifferenceModel {
    cause: Option<&'static str>,
    constants: usize,
    bic: f64,
    changes: Vec<ParameterChange>,
    sentences: Vec<String>,
}

impl DifferenceModel {
    fn fit_candidates(
        places: &[PositionDifference],
        along: bool,
        variance: Option<f64>,
    ) -> Vec<Self> {
        let both = [-1, 1].iter().all(|way| places.iter().any(|place| place.direction == *way));
        let backlash = if both { Some(0) } else { None };
        let slope = Some(1);
        let slope_name = if along { "pitch-scale" } else { "cross-axis" };
        let curve_name = if along { "pitch-error" } else { "straightness" };
        let mut laws = vec![Self::fit_linear(places, variance, slope_name, &[])];
        laws.extend(
            backlash.map(|backlash| Self::fit_linear(places, variance, slope_name, &[backlash])),
        );
        laws.extend(slope.map(|slope| Self::fit_linear(places, variance, slope_name, &[slope])));
        if both {
            laws.push(Self::fit_linear(places, variance, slope_name, &[0, 1]));
        }
        if variance.is_some() {
            let largest = places
                .iter()
                .max_by(|a, b| a.difference_um.abs().total_cmp(&b.difference_um.abs()));
            let sentence = largest.map_or(String::new(), |largest| {
                format!(
                    "They differ by a curve: most at {} mm, by {:+.2} µm{}.",
                    largest.at_mm,
                    largest.difference_um,
                    largest.half_width_um.map_or(String::new(), |half| format!(" ± {half:.2}"))
                )
            });
            laws.push(Self {
                cause: Some(curve_name),
                constants: places.len(),
                bic: places.len() as f64 * (places.len() as f64).ln(),
                changes: Vec::new(),
                sentences: vec![sentence],
            });
        }
        laws
    }

    /// Returns a constant and these of: 1 where the approach was negative; the position in m.
    fn fit_linear(
        places: &[PositionDifference],
        variance: Option<f64>,
        slope_name: &'static str,
        columns: &[usize],
    ) -> Self {
        let middle = places.iter().map(|place| place.at_mm).sum::<f64>() / places.len() as f64;
        let row = |difference: &PositionDifference| {
            let all = [
                f64::from(u8::from(difference.direction < 0)),
                (difference.at_mm - middle) / 1000.0,
            ];
            let mut x = vec![1.0];
            x.extend(columns.iter().map(|column| all[*column]));
            x
        };
        // Weighted by what each place rests on.
        let weight = |difference: &PositionDifference| {
            (1.0 / difference.readings.map(|n| 1.0 / n as f64).iter().sum::<f64>()).sqrt()
        };
        let mut triangle = GivensQr::new(1 + columns.len());
        for it in places {
            let w = weight(it);
            let x: Vec<f64> = row(it).iter().map(|x| w * x).collect();
            triangle.add_row(&x, w * it.difference_um);
        }
        let constants = 1 + columns.len();
        let none = Self {
            cause: None,
            constants,
            bic: f64::INFINITY,
            changes: Vec::new(),
            sentences: Vec::new(),
        };
        let Ok(fit) = triangle.solve() else { return none };
        let squares: f64 = places
            .iter()
            .map(|place| (weight(place) * (place.difference_um - fit.predict(&row(place)))).powi(2))
            .sum();
        let count = places.len() as f64;
        let fitted = match variance {
            Some(variance) => squares / variance.max(f64::MIN_POSITIVE),
            None => count * (squares / count).max(f64::MIN_POSITIVE).ln(),
        };
        // With repeats the scatter is theirs; without, what is left.
        let half = |n: usize| match variance {
            Some(variance) => {
                fit.confidence_half_width(n)
                    * (variance / fit.residual_variance().max(f64::MIN_POSITIVE)).sqrt()
            }
            None => fit.confidence_half_width(n),
        };
        let changes: Vec<ParameterChange> = columns
            .iter()
            .enumerate()
            .map(|(n, column)| ParameterChange {
                cause: if *column == 0 { "backlash" } else { slope_name },
                value: fit.coefficients[n + 1],
                half_width: half(n + 1),
            })
            .collect();
        let sentences =
            changes.iter().map(|ParameterChange { cause, value, half_width }| match *cause {
                "backlash" => format!("Backlash has changed by {value:+.2} ± {half_width:.2} µm."),
                _ => format!(
                    "The error has changed by {value:+.2} ± {half_width:.2} µm over a metre."
                ),
            });
        let sentences = sentences.collect();
        let bic = fitted + constants as f64 * count.ln();
        Self {
            cause: changes.first().map(|change| change.cause),
            constants,
            bic,
            changes,
            sentences,
        }
    }
}

/// Returns the quantity that both runs measure; the other one is called by its name in an error.
///
/// # Errors
/// One of them does not measure the requested quantity, they have none in common, or several and none is requested.
pub fn resolve_common_quantity(
    run: &RunFile,
    (other, name): (&RunFile, impl Display),
    requested: Option<Quantity>,
) -> Result<Quantity, InputFileError> {
    let column = |quantity: &Quantity| format!("measured_{}_um", quantity.name());
    if let Some(quantity) = requested {
        other.require_column(&column(&quantity))?;
        return run.require_column(&column(&quantity)).map(|_| quantity);
    }
    let is_in_both = |quantity: &Quantity| {
        [run, other].iter().all(|run| run.column(&column(quantity)).is_some())
    };
    let all: Vec<Quantity> = Quantity::ALL.into_iter().filter(is_in_both).collect();
    let rule = match all[..] {
        [quantity] => return Ok(quantity),
        [] => format!("measures nothing that {name} measures (measured_…_um)"),
        _ => {
            let names: Vec<&str> = all.iter().map(|quantity| quantity.name()).collect();
            format!("the runs measure {}: choose one with --quantity", names.join(", "))
        }
    };
    Err(InputFileError::new(Location::start_of_file(run.path()), rule))
}

/// Returns the column of the axis that travels most in both.
fn find_longest_travel_column(
    a: &RunFile,
    b: &RunFile,
    quantity: Quantity,
) -> Result<String, InputFileError> {
    let travel = |run: &RunFile, name: &str| {
        let there = run.column(name)?.iter().copied().filter(|mm| mm.is_finite());
        let (low, high) = there.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), mm| {
            (low.min(mm), high.max(mm))
        });
        (high > low).then_some(high - low)
    };
    let names = ["x_mm", "y_mm", "z_mm"];
    let least = |name: &'static str| Some((travel(a, name)?.min(travel(b, name)?), name));
    let best = names.into_iter().filter_map(least).max_by(|a, b| a.0.total_cmp(&b.0));
    best.map(|(_, name)| name.to_string()).ok_or_else(|| {
        let rule = format!(
            "no axis moves in both runs, so {} cannot be compared place by place; for two runs in time \
             use trueup accept",
            quantity.name()
        );
        InputFileError::new(Location::start_of_file(b.path()), rule)
    })
}

fn extract_position_readings(
    run: &RunFile,
    quantity: Quantity,
    over: &str,
) -> Result<Vec<PositionReading>, InputFileError> {
    let um = run.require_column(&format!("measured_{}_um", quantity.name()))?;
    let at = run.require_column(over)?;
    let directions = run.column(&format!("dir_{}", &over[..1]));
    let rows = (0..run.row_count()).filter(|row| um[*row].is_finite() && at[*row].is_finite());
    let direction = |row: usize| match directions.map(|all| all[row]) {
        Some(way) if way < 0.0 => -1,
        Some(way) if way > 0.0 => 1,
        _ => 0,
    };
    Ok(rows
        .map(|row| PositionReading { row, at: at[row], direction: direction(row), um: um[row] })
        .collect())
}
