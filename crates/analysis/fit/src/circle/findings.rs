//! The terms of a circle as causes: constants with their intervals, evidence, alternatives, and the next test.

use std::f64::consts::TAU;

use trueup_machine::machine_file::LinearAxis;

use super::{
    record::{CirclePlane, CircleRecord},
    term_selection::{CrossValidatedTermGroup, FittedTerm, SelectedModel, TermGroup},
    terms::{CircleTerm, DriftingParameter, WavePhase},
};
use crate::report::FitParameter;

/// From a value to either end of its 95 % interval, in standard errors: records have hundreds of rows.
const NORMAL_QUANTILE_975: f64 = 1.96;
/// A squareness below this share of an odd harmonic may be the line of its form: t³ is 2·sin 2φ for 1·sin 4φ.
const MIN_SQUARENESS_ODD_HARMONIC_RATIO: f64 = 2.2;
/// The same of an even one, whose middle is not that of the circle.
const MIN_SQUARENESS_EVEN_HARMONIC_RATIO: f64 = 0.3;
/// |t| of heights of spikes: of two, or of one.
const MIN_SPIKE_T_VALUES: [f64; 2] = [4.0, 8.0];

/// A cause.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CircleCause {
    /// A step at the reversals of an axis.
    Backlash,
    /// A step of one axis at the reversals of the other.
    LateralPlay,
    /// A peak behind the reversals of an axis.
    ReversalSpike,
    /// The axes are not at 90°.
    Squareness,
    /// The scales of the axes differ.
    ScaleMismatch,
    /// The servo loops of the axes differ.
    ServoMismatch,
    /// An error that is periodic in the position.
    CyclicError,
    /// An axis that does not run straight.
    Straightness,
    /// Positions of an axis that bend.
    PositionForm,
    /// Growth with time.
    Drift,
}

impl CircleCause {
    /// Returns its name in JSON.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Backlash => "backlash",
            Self::LateralPlay => "lateral-play",
            Self::ReversalSpike => "reversal-spike",
            Self::Squareness => "squareness",
            Self::ScaleMismatch => "scale-mismatch",
            Self::ServoMismatch => "servo-mismatch",
            Self::CyclicError => "cyclic-error",
            Self::Straightness => "straightness",
            Self::PositionForm => "position-form",
            Self::Drift => "drift",
        }
    }

    /// Returns why no table corrects it; `None` where one does.
    #[must_use]
    pub(crate) fn uncompensated_reason(self) -> Option<&'static str> {
        match self {
            Self::ServoMismatch => Some(
                "it depends on the feed: match the position gains (Kv) or the feed-forward of both axes",
            ),
            Self::ReversalSpike => Some(
                "it depends on friction and feed: use the control's quadrant or friction compensation",
            ),
            Self::LateralPlay => {
                Some("a guide has play across the axis: adjust the gib or the bearing")
            }
            Self::Drift => Some("it changes with time: find the heat, or measure a warm machine"),
            _ => None,
        }
    }
}

/// A cause that the record shows.
#[derive(Clone, Debug)]
pub struct CircleFinding {
    /// The cause.
    pub cause: CircleCause,
    /// The plane of the circle.
    pub plane: CirclePlane,
    /// The axis in error; `None` where it is of both.
    pub axis: Option<LinearAxis>,
    /// The axis that moves, of a straightness.
    pub along: Option<LinearAxis>,
    /// Whether the record shows it and nothing else in its place.
    pub claimed: bool,
    /// Whether it is in the machine file that is written.
    pub compensated: bool,
    /// Its constants.
    pub parameters: Vec<FitParameter>,
    /// RMS of its share of the readings, in µm.
    pub rms_um: f64,
    /// The facts, a sentence each.
    pub evidence: Vec<String>,
    /// Names of causes that would look the same.
    pub alternatives: Vec<String>,
    /// The measurement that settles what is open, or the remedy; empty where nothing is.
    pub next_test: String,
    /// The terms, for the machine file and the plot.
    pub terms: Vec<FittedTerm>,
}

/// Returns the causes of a circle, the largest first.
#[must_use]
pub(crate) fn build_findings(record: &CircleRecord, chosen: &SelectedModel) -> Vec<CircleFinding> {
    let has = |unit: &TermGroup| chosen.tried.iter().any(|tried| tried.unit == *unit);
    // Forms whose axis a circle does not show are listed with the larger straightness that it does show.
    let rms_um = |wave: WavePhase| {
        let own = chosen.tried.iter().find(|tried| tried.unit == TermGroup::Even(wave));
        own.map_or(0.0, |tried| tried.rms_um)
    };
    let odd_to = match [WavePhase::Sine, WavePhase::Cosine].map(|wave| has(&TermGroup::Even(wave)))
    {
        [false, false] => None,
        _ if rms_um(WavePhase::Sine) >= rms_um(WavePhase::Cosine) => Some(WavePhase::Sine),
        _ => Some(WavePhase::Cosine),
    };
    let mut all = Vec::new();
    for tried in &chosen.tried {
        if tried.unit == TermGroup::OddSines && odd_to.is_some() {
            continue;
        }
        let is_own = |term: &&FittedTerm| {
            term.unit == tried.unit
                || term.unit == TermGroup::OddSines
                    && odd_to.is_some_and(|to| TermGroup::Even(to) == tried.unit)
        };
        let terms: Vec<FittedTerm> = chosen.terms.iter().filter(is_own).cloned().collect();
        all.push(build_finding(record, tried, terms));
    }
    flag_doubtful_squareness(&mut all);
    all.sort_by(|a, b| b.rms_um.total_cmp(&a.rms_um));
    all
}

/// Doubts a squareness that is no more than the line from which a form that is there counts.
fn flag_doubtful_squareness(all: &mut [CircleFinding]) {
    let forms = || {
        all.iter()
            .filter(|finding| finding.cause == CircleCause::Straightness)
            .flat_map(|finding| &finding.terms)
    };
    let size = |is_one: fn(&CircleTerm) -> bool| {
        let own = forms().filter(|term| is_one(&term.term)).map(|term| term.um.abs());
        own.fold(0.0, f64::max)
    };
    let odd = size(|term| matches!(term, CircleTerm::Form(4 | 6, _)));
    let even = size(|term| matches!(term, CircleTerm::Form(3 | 5 | 7, _)));
    let of_line_um =
        (MIN_SQUARENESS_ODD_HARMONIC_RATIO * odd).max(MIN_SQUARENESS_EVEN_HARMONIC_RATIO * even);
    for it in all.iter_mut().filter(|finding| finding.cause == CircleCause::Squareness) {
        if it.terms.iter().all(|term| term.um.abs() < of_line_um) {
            it.claimed = false;
            it.alternatives.push(CircleCause::Straightness.name().into());
            it.next_test =
                "a square, or `trueup fit straightness` of the axis: the line of its form is as steep"
                    .into();
        }
    }
}

fn build_finding(
    record: &CircleRecord,
    tried: &CrossValidatedTermGroup,
    terms: Vec<FittedTerm>,
) -> CircleFinding {
    let axes = record.plane.axes();
    let [u, v] = axes;
    let (cause, axis, along) = match &tried.unit {
        TermGroup::Single(CircleTerm::Backlash(of)) => {
            (CircleCause::Backlash, Some(axes[*of]), None)
        }
        TermGroup::Single(CircleTerm::Lateral(of)) => {
            (CircleCause::LateralPlay, Some(axes[1 - of]), Some(axes[*of]))
        }
        TermGroup::Single(CircleTerm::Scale) => (CircleCause::ScaleMismatch, None, None),
        TermGroup::Single(CircleTerm::Servo) => (CircleCause::ServoMismatch, None, None),
        TermGroup::Setup | TermGroup::Single(_) => (CircleCause::Squareness, None, None),
        TermGroup::Even(WavePhase::Sine) => (CircleCause::Straightness, Some(v), Some(u)),
        TermGroup::Even(WavePhase::Cosine) => (CircleCause::Straightness, Some(u), Some(v)),
        TermGroup::OddSines => (CircleCause::Straightness, None, None),
        TermGroup::EvenCosines => (CircleCause::PositionForm, None, None),
        TermGroup::Drift => (CircleCause::Drift, None, None),
        TermGroup::Spikes(of) => (CircleCause::ReversalSpike, Some(axes[*of]), Some(axes[*of])),
        TermGroup::Cyclic(of, _) => (CircleCause::CyclicError, Some(axes[*of]), None),
    };
    let mut it = CircleFinding {
        cause,
        plane: record.plane,
        axis,
        along: along.filter(|_| cause != CircleCause::ReversalSpike),
        claimed: tried.is_gain,
        compensated: false,
        parameters: build_parameters(record, cause, &terms),
        rms_um: tried.rms_um,
        evidence: vec![format!(
            "{}: {:.2} µm RMS without it, {:.2} µm with it",
            if cause == CircleCause::ReversalSpike { "left" } else { "on held-out arcs" },
            tried.held_out_um[0],
            tried.held_out_um[1]
        )],
        alternatives: tried.alternatives.iter().map(|unit| cause_name(record, unit)).collect(),
        next_test: String::new(),
        terms,
    };
    if cause == CircleCause::ReversalSpike {
        let heights =
            it.parameters.iter().filter_map(|parameter| Some((parameter.value, parameter.ci95?)));
        let size = |(um, [low, high]): (f64, [f64; 2])| {
            (um / (high - low) * 2.0 * NORMAL_QUANTILE_975).abs()
        };
        let mut sizes: Vec<f64> = heights.map(size).collect();
        sizes.sort_unstable_by(|a, b| b.total_cmp(a));
        let second = sizes.get(1).copied().unwrap_or_default();
        it.claimed = second > MIN_SPIKE_T_VALUES[0]
            || sizes.first().is_some_and(|size| *size > MIN_SPIKE_T_VALUES[1]);
    }
    add_ambiguities(record, &mut it);
    it.claimed &= it.alternatives.is_empty();
    if it.next_test.is_empty()
        && let Some(why) = cause.uncompensated_reason()
    {
        it.next_test = format!("no table corrects it, {why}");
    }
    it
}

/// Adds what one plane or one direction cannot distinguish, and the test that does.
fn add_ambiguities(record: &CircleRecord, it: &mut CircleFinding) {
    let [u, v] = record.plane.axes().map(LinearAxis::name);
    let one_way = !(record.has_direction(1.0) && record.has_direction(-1.0));
    let plane = record.plane.name();
    let other_way = format!("measure the same circle in {plane} in the other direction too");
    match it.cause {
        CircleCause::Squareness if one_way => {
            it.alternatives.push(CircleCause::ServoMismatch.name().into());
            it.next_test = other_way;
        }
        CircleCause::ScaleMismatch if one_way => {
            it.alternatives.push(CircleCause::LateralPlay.name().into());
            it.next_test = other_way;
        }
        CircleCause::Straightness => match (it.axis, it.along) {
            (Some(error), Some(along)) => it.evidence.push(format!(
                "a bend in the positions of {0} would look the same. A circle at another place of {0} or `trueup fit pitch` of {0} separates them; `trueup program straightness` measures the form along {1} itself",
                error.name(),
                along.name()
            )),
            _ => {
                it.evidence.push(format!(
                    "one circle does not show whether {u} errs along {v} or {v} along {u}: not written"
                ));
                it.next_test = format!(
                    "a dial on a straight edge along {u}: `trueup program straightness`, then `trueup fit straightness`"
                );
            }
        },
        CircleCause::PositionForm => {
            it.alternatives.extend([format!("{} of {u}", it.cause.name()), format!("{} of {v}", it.cause.name())]);
            it.next_test = format!("measure the positions of {u} and {v}: `trueup program pitch`, then `trueup fit pitch`");
        }
        _ if !it.alternatives.is_empty() => {
            it.next_test = if record.covered_arc_rad() < 6.0 {
                format!("measure the whole circle in {plane}, in both directions")
            } else if one_way {
                other_way
            } else {
                format!("repeat the circle in {plane} with more readings, and at another feed")
            };
        }
        _ => {}
    }
}

/// Returns the name of a cause that was not chosen.
fn cause_name(record: &CircleRecord, unit: &TermGroup) -> String {
    let axes = record.plane.axes().map(LinearAxis::name);
    match unit {
        TermGroup::Single(CircleTerm::Backlash(of)) => {
            format!("{} of {}", CircleCause::Backlash.name(), axes[*of])
        }
        TermGroup::Single(CircleTerm::Lateral(of)) => {
            format!("{} of {}", CircleCause::LateralPlay.name(), axes[*of])
        }
        TermGroup::Single(CircleTerm::Scale) => CircleCause::ScaleMismatch.name().into(),
        TermGroup::Single(CircleTerm::Servo) => CircleCause::ServoMismatch.name().into(),
        TermGroup::Even(_) | TermGroup::OddSines => CircleCause::Straightness.name().into(),
        TermGroup::EvenCosines => CircleCause::PositionForm.name().into(),
        TermGroup::Drift => CircleCause::Drift.name().into(),
        TermGroup::Spikes(of) => format!("{} of {}", CircleCause::ReversalSpike.name(), axes[*of]),
        TermGroup::Cyclic(of, _) => format!("{} of {}", CircleCause::CyclicError.name(), axes[*of]),
        TermGroup::Setup | TermGroup::Single(_) => CircleCause::Squareness.name().into(),
    }
}

/// Returns the constants of a cause.
fn build_parameters(
    record: &CircleRecord,
    cause: CircleCause,
    terms: &[FittedTerm],
) -> Vec<FitParameter> {
    let Some(first) = terms.first() else { return Vec::new() };
    let scaled = |name: &str, term: &FittedTerm, factor: f64| {
        FitParameter::amplitude(
            name,
            factor * term.um,
            NORMAL_QUANTILE_975 * (factor * term.standard_error_um).abs(),
        )
    };
    match cause {
        CircleCause::Backlash | CircleCause::LateralPlay => vec![scaled("width_um", first, 1.0)],
        CircleCause::Squareness | CircleCause::ScaleMismatch => vec![
            scaled("um_per_m", first, 2e3 / record.radius_mm),
            scaled("amplitude_um", first, 1.0),
        ],
        CircleCause::ServoMismatch => {
            let mut all = vec![scaled("amplitude_um", first, 1.0)];
            if let Some(feed) = record.median_feed_mm_per_min() {
                // 2·amplitude / F, in ms.
                all.push(scaled("lag_difference_ms", first, 2.0 / (feed / 60.0)));
                all.push(FitParameter::fixed("feed_mm_per_min", feed));
            }
            all
        }
        CircleCause::ReversalSpike => build_spike_parameters(record, terms),
        CircleCause::CyclicError => build_cyclic_parameters(record, terms),
        CircleCause::Straightness | CircleCause::PositionForm => {
            let largest = terms.iter().map(|term| term.um.abs()).fold(0.0, f64::max);
            let error = terms.iter().map(|term| term.standard_error_um.powi(2)).sum::<f64>().sqrt();
            let range = straightness_range_um(terms);
            let mut all = vec![FitParameter::fitted(
                "range_um",
                range,
                NORMAL_QUANTILE_975 * error * range / largest.max(f64::MIN_POSITIVE),
            )];
            all.extend(terms.iter().filter_map(|term| match term.term {
                CircleTerm::Form(number, _) => {
                    Some(scaled(&format!("harmonic_{number}_um"), term, 1.0))
                }
                _ => None,
            }));
            all
        }
        CircleCause::Drift => build_drift_parameters(record, terms),
    }
}

/// Returns the height of each spike, the peak of its shapes' sum, and the width of the highest.
fn build_spike_parameters(record: &CircleRecord, terms: &[FittedTerm]) -> Vec<FitParameter> {
    /// Steps of an angle.
    const SPIKE_HALF_RANGE_STEPS: i32 = 600;
    let mut all = Vec::new();
    let (mut highest, mut width_rad) = (0.0, 0.0);
    for (is_positive, sense) in [(true, 1.0), (true, -1.0), (false, 1.0), (false, -1.0)] {
        let own = |term: &&FittedTerm| matches!(term.term, CircleTerm::Spike { is_positive: end, sense: way, .. } if end == is_positive && way == sense);
        let own: Vec<&FittedTerm> = terms.iter().filter(own).collect();
        let at = |step: i32| {
            let since = f64::from(step).to_radians() / 20.0;
            let of = |fitted_term: &&FittedTerm| match fitted_term.term {
                CircleTerm::Spike { shape, width, .. } => {
                    fitted_term.um * shape.evaluate(since, width)
                }
                _ => 0.0,
            };
            own.iter().map(of).sum::<f64>()
        };
        let curve: Vec<f64> = (-SPIKE_HALF_RANGE_STEPS..SPIKE_HALF_RANGE_STEPS).map(at).collect();
        let Some(peak) = curve.iter().copied().max_by(|a, b| a.abs().total_cmp(&b.abs())) else {
            continue;
        };
        if own.is_empty() {
            continue;
        }
        let error = own
            .iter()
            .map(|fitted_term| fitted_term.standard_error_um)
            .fold(f64::INFINITY, f64::min);
        let end = if is_positive { "positive" } else { "negative" };
        let way = if sense > 0.0 { "ccw" } else { "cw" };
        all.push(FitParameter::amplitude(
            format!("height_{end}_end_{way}_um"),
            peak,
            NORMAL_QUANTILE_975 * error,
        ));
        if peak.abs() > highest {
            highest = peak.abs();
            let wide = curve.iter().filter(|um| **um / peak >= 0.5).count();
            width_rad = (wide as f64 / 20.0).to_radians();
        }
    }
    all.push(FitParameter::fixed("width_deg", width_rad.to_degrees()));
    all.push(FitParameter::fixed("width_mm", width_rad * record.radius_mm));
    all
}

fn build_cyclic_parameters(record: &CircleRecord, terms: &[FittedTerm]) -> Vec<FitParameter> {
    let of = |wave: WavePhase| {
        terms
            .iter()
            .find(|term| matches!(term.term, CircleTerm::Cyclic { wave: own, .. } if own == wave))
    };
    let (Some(sine), Some(cosine)) = (of(WavePhase::Sine), of(WavePhase::Cosine)) else {
        return Vec::new();
    };
    let CircleTerm::Cyclic { period_mm, .. } = sine.term else { return Vec::new() };
    let amplitude = sine.um.hypot(cosine.um);
    let error = sine.standard_error_um.max(cosine.standard_error_um);
    // The phase over a travel of ±R, weighted with the half of it: ∂phase/∂L = 2π·u/L².
    let spread = record.radius_mm / 2.0;
    let period_error = error / amplitude * period_mm * period_mm / (TAU * spread);
    vec![
        FitParameter::amplitude("amplitude_um", amplitude, NORMAL_QUANTILE_975 * error),
        FitParameter::fitted("period_mm", period_mm, NORMAL_QUANTILE_975 * period_error),
        FitParameter::fitted(
            "phase_deg",
            cosine.um.atan2(sine.um).to_degrees(),
            NORMAL_QUANTILE_975 * (error / amplitude).to_degrees(),
        ),
    ]
}

fn build_drift_parameters(record: &CircleRecord, terms: &[FittedTerm]) -> Vec<FitParameter> {
    let [u, v] = record.plane.axes().map(LinearAxis::name);
    let [first, last] = record.clock;
    let (unit, factor) = if record.has_time && last > first {
        ("um_per_h", 3600.0 / (last - first))
    } else {
        ("um_over_record", 1.0)
    };
    let parameter = |term: &FittedTerm| {
        let CircleTerm::Drift(of) = term.term else { return None };
        let name = match of {
            DriftingParameter::Radius => format!("radius_{unit}"),
            DriftingParameter::CentreU => format!("{u}_{unit}"),
            DriftingParameter::CentreV => format!("{v}_{unit}"),
        };
        let half = NORMAL_QUANTILE_975 * (factor * term.standard_error_um).abs();
        Some(FitParameter::amplitude(name, factor * term.um, half))
    };
    terms.iter().filter_map(parameter).collect()
}

/// Returns the error of a straightness in µm at −1…1 of the way along the circle's diameter, without a constant.
///
/// Uₙ(t)·√(1 − t²) = sin((n + 1)·acos t) makes the harmonic sin mφ of the second axis along the first. Of the first axis
/// along the second φ is counted from the other axis: cos 3φ ↦ −U₂, sin 4φ ↦ −U₃, cos 5φ ↦ U₄, sin 6φ ↦ U₅, cos 7φ ↦ −U₆.
#[must_use]
pub(crate) fn straightness_um(terms: &[FittedTerm], share: f64) -> f64 {
    let is_first = terms
        .iter()
        .any(|term| matches!(term.term, CircleTerm::Form(3 | 5 | 7, WavePhase::Cosine)));
    let of = |term: &FittedTerm| {
        let CircleTerm::Form(number, _) = term.term else { return 0.0 };
        let sign = if is_first && matches!(number, 3 | 4 | 7) { -1.0 } else { 1.0 };
        sign * term.um * chebyshev_second_kind(number - 1, share)
    };
    terms.iter().map(of).sum()
}

/// Returns Chebyshev's polynomial of the second kind.
fn chebyshev_second_kind(degree: u8, t: f64) -> f64 {
    let (mut before, mut now) = (0.0, 1.0);
    for _ in 0..degree {
        (before, now) = (now, 2.0 * t * now - before);
    }
    now
}

fn straightness_range_um(terms: &[FittedTerm]) -> f64 {
    let at = |n: i32| straightness_um(terms, f64::from(n) / 100.0);
    let values = (-100..=100).map(at);
    values.clone().fold(f64::MIN, f64::max) - values.fold(f64::MAX, f64::min)
}
