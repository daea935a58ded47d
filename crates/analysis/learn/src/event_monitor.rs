//! After each reading: whether something has happened, from the readings so far only.
//!
//! An event is searched for over the last [`LOOKBACK_READINGS`] readings. It stays open until it is named and [`MIN_CLASSIFICATION_READINGS`] readings old, or
//! [`MAX_OPEN_EVENT_READINGS`] readings old: as long its name and size follow the readings. Where bad readings have moved the estimate, the good ones
//! after them look like an event: the belief before them predicts these, and there is none. The effect of an event on
//! the estimate is computed anew from its first reading on whenever that changes.

use crate::{
    change_detection::{
        AlternativeHypothesis, DetectedChange, FittedAlternative, RETRACTION_LOG_ODDS,
        min_zero_step_um,
    },
    event::{DetectedEvent, EventAction, EventKind, round_to_three_digits},
    filter_history::FilterHistory,
    learnable_constants::{LearnableConstant, unit},
    learner_state::LearnerState,
    temperature_rise::TemperatureRise,
};

/// Readings that are looked back at: twelve days at two a day.
const LOOKBACK_READINGS: usize = 24;
/// No fewer are after an event.
const MIN_EVENT_READINGS: usize = 3;
/// Readings from which on constants are known better than before the first: ten for each of four.
const MIN_SETTLED_READINGS: u64 = 40;
/// A step that the readings do not name acts from this many times the smallest one on: the estimate follows a smaller one.
const UNCLASSIFIED_STEP_FACTOR: f64 = 4.0 / 3.0;
/// Readings after an event from which on its name and size stay: named, and in any case (more than ten shifts of two).
const MIN_CLASSIFICATION_READINGS: usize = 12;
const MAX_OPEN_EVENT_READINGS: usize = 24;
/// A step of the zero is the simpler explanation: a constant that is not distinguished from it has to be as much likelier, in
/// ln of the odds, for the constant to follow.
const ZERO_STEP_LOG_ODDS_BONUS: f64 = 3.0;
/// After a constant has changed the others are known no better, as a share: what is believed before the first reading.
const RESTART_RELATIVE_STD: f64 = 0.25;
/// A zero of which nothing is known, in µm: the filters hold it to what they believe before the first reading.
const DIFFUSE_ZERO_STD_UM: f64 = 100.0;
/// The excess that a moved thermometer may show everywhere, one standard deviation in K: half of what an unheated hall
/// changes by within a week.
const MOVED_THERMOMETER_STD_K: f64 = 3.0;

/// Looks for events after the window's last reading; what is believed follows.
pub(crate) fn detect_events(memory: &mut LearnerState, believed: &mut FilterHistory) {
    let open = memory.events.iter().rposition(|event| event.is_open);
    let mut from = memory.first;
    if let Some(place) = open {
        update_open_event(memory, believed, place);
        return;
    }
    if let Some(last) = abrupt_events(memory).map(earliest_next_event_sequence).max() {
        from = from.max(last);
    }
    detect_next_event(memory, believed, from);
}

/// Returns the events that have an instant.
fn abrupt_events(memory: &LearnerState) -> impl Iterator<Item = &DetectedEvent> {
    let is_slow =
        |event: &DetectedEvent| matches!(event.event, EventKind::Wear | EventKind::ProbeDrift);
    memory.events.iter().filter(move |event| !is_slow(event))
}

/// Returns the number of the first reading at which another event may begin. Where constants have changed they are followed first:
/// what the readings still miss is theirs.
fn earliest_next_event_sequence(event: &DetectedEvent) -> u64 {
    let readings = if matches!(event.action, EventAction::Shift(_)) {
        MAX_OPEN_EVENT_READINGS as u64
    } else {
        1
    };
    event.sequence + readings
}

/// Names and sizes an open event by the readings until now.
fn update_open_event(memory: &mut LearnerState, believed: &mut FilterHistory, place: usize) {
    let sequence = memory.events[place].sequence;
    let (index, end) = (sequence.saturating_sub(memory.first) as usize, memory.window.len());
    if sequence < memory.first || end - index >= MAX_OPEN_EVENT_READINGS {
        memory.events[place].is_open = false;
        return;
    }
    let Some(finding) = believed.explain_readings(memory, [index, end], Some(sequence)) else {
        // Bad readings that agreed by chance: later ones do not.
        memory.events.remove(place);
        believed.replay_from(memory, sequence);
        return;
    };
    let mut event = event_from_finding(memory, &finding, index, finding.scatter_um);
    let old = &memory.events[place];
    event.certain_at = old.certain_at;
    event.is_open = event.event == EventKind::Unknown || end - index < MIN_CLASSIFICATION_READINGS;
    let is_same = event.action == old.action;
    memory.events[place] = event;
    if !is_same {
        believed.replay_from(memory, sequence);
    }
}

/// Looks for an event at the reading `from` or later.
fn detect_next_event(memory: &mut LearnerState, believed: &mut FilterHistory, from: u64) {
    let end = memory.window.len();
    let first =
        (from.saturating_sub(memory.first) as usize).max(end.saturating_sub(LOOKBACK_READINGS));
    let all: Vec<(usize, DetectedChange)> = (first..=end.saturating_sub(MIN_EVENT_READINGS))
        .filter(|index| can_start_event(memory.first + *index as u64))
        .filter_map(|index| Some((index, believed.explain_readings(memory, [index, end], None)?)))
        .filter(|(index, _)| !believed.is_outlier_artefact(memory, *index))
        .collect();
    let is_scatter =
        |finding: &DetectedChange| finding.best.alternative == AlternativeHypothesis::Scatter;
    // Readings before and after a step scatter as well.
    let certain = all
        .iter()
        .filter(|(_, finding)| !is_scatter(finding))
        .map(|(_, finding)| finding.best.gain);
    let step = certain.fold(f64::NEG_INFINITY, f64::max);
    let found = all
        .into_iter()
        .filter(|(_, finding)| {
            !is_scatter(finding) || finding.best.gain > step + RETRACTION_LOG_ODDS
        })
        .max_by(|a, b| a.1.best.gain.total_cmp(&b.1.best.gain));
    let Some((index, finding)) = found else { return };
    let event = event_from_finding(memory, &finding, index, finding.scatter_um);
    let sequence = event.sequence;
    memory.events.push(event);
    believed.replay_from(memory, sequence);
}

/// Returns true for an instant before which enough was read, or nothing: then what is believed before the first reading holds.
fn can_start_event(sequence: u64) -> bool {
    sequence == 0 || sequence >= MIN_SETTLED_READINGS
}

/// Returns the event that a finding is.
fn event_from_finding(
    memory: &LearnerState,
    finding: &DetectedChange,
    index: usize,
    scatter_um: f64,
) -> DetectedEvent {
    let best = &finding.best;
    let (event, constant, scale, unit) = classify_alternative(memory, best);
    let mut kinds = vec![event];
    for other in &finding.others {
        let kind = classify_alternative(memory, other).0;
        if !kinds.contains(&kind) {
            kinds.push(kind);
        }
    }
    let zero = std::iter::once(best).chain(&finding.others);
    let zero = zero.clone().find(|fitted| fitted.alternative == AlternativeHypothesis::Zero);
    let acting =
        zero.filter(|zero| zero.gain + ZERO_STEP_LOG_ODDS_BONUS > best.gain).unwrap_or(best);
    let is_named = kinds.len() == 1;
    let alternatives = if is_named { Vec::new() } else { kinds };
    let smallest =
        if is_named { 1.0 } else { UNCLASSIFIED_STEP_FACTOR } * min_zero_step_um(scatter_um);
    let does = match event_action(memory, acting, finding) {
        EventAction::Zero(um) if um.abs() < smallest => EventAction::Nothing,
        _ if !acting.is_actionable() => EventAction::Nothing,
        other => other,
    };
    let event = if is_named { event } else { EventKind::Unknown };
    let half = 1.96 * best.error;
    let [size, low, high] = [best.size, best.size - half, best.size + half].map(|size| {
        // A thermometer that shows a share m of its rise misses 1/m − 1 of what it shows.
        if matches!(best.alternative, AlternativeHypothesis::Thermometer(_)) {
            100.0 * (1.0 / (1.0 + size) - 1.0)
        } else {
            size * scale
        }
    });
    let (low, high) = (low.min(high), low.max(high));
    DetectedEvent {
        event,
        constant,
        at: memory.window[index].t,
        certain_at: memory.last_s,
        size: round_to_three_digits(size),
        unit,
        ci95: [round_to_three_digits(low), round_to_three_digits(high)],
        check: DetectedEvent::advice(event, &alternatives),
        alternatives,
        sequence: memory.first + index as u64,
        action: does,
        is_open: true,
    }
}

/// Returns the kind of an alternative, what it belongs to, the factor to its unit, and the unit.
fn classify_alternative(
    memory: &LearnerState,
    it: &FittedAlternative,
) -> (EventKind, Option<String>, f64, String) {
    match it.alternative {
        AlternativeHypothesis::Zero => (EventKind::ZeroStep, None, 1.0, "µm".into()),
        AlternativeHypothesis::Constant(index) => {
            let constant = &memory.constants[index];
            let key = constant.key.clone();
            let unit = unit(&key);
            (EventKind::ConstantChanged, Some(key), constant.believed, unit)
        }
        AlternativeHypothesis::Thermometer(index) => {
            (EventKind::ThermometerMoved, memory.thermometers.get(index).cloned(), 1.0, "%".into())
        }
        AlternativeHypothesis::Scatter => (EventKind::ScatterGrown, None, 1.0, "times".into()),
    }
}

/// Returns the values that may take a part of the air that a moved thermometer no longer shows: all but that of place `own`. A zero
/// that no file has a place for is none of them: it would only hide what the references are to take.
fn values_affected_by_air(memory: &LearnerState, own: Option<usize>) -> Vec<(usize, f64, f64)> {
    let deviation = |constant: &LearnableConstant| match constant.is_reference_temperature() {
        true => (MOVED_THERMOMETER_STD_K / constant.believed).abs(),
        false => RESTART_RELATIVE_STD,
    };
    let zero = memory.zero.map(|_| (0, 0.0, DIFFUSE_ZERO_STD_UM));
    let constants = memory.constants.iter().enumerate();
    let constants =
        constants.filter(|(_, constant)| TemperatureRise::from_key(&constant.key).is_none());
    let constants = constants.map(|(index, constant)| (index + 1, 0.0, deviation(constant)));
    zero.into_iter().chain(constants.filter(|entry| Some(entry.0) != own)).collect()
}

/// Returns the place among the constants of the rise that a thermometer shows, where there is one.
fn rise_index(memory: &LearnerState, thermometer: usize) -> Option<usize> {
    let name = memory.thermometers.get(thermometer)?;
    let is_of = |constant: &LearnableConstant| {
        TemperatureRise::from_key(&constant.key).is_some_and(|rise| rise.thermometer == name)
    };
    memory.constants.iter().position(is_of)
}

/// Returns what an alternative does to the estimate. A constant changes as it was fitted to all readings after the event,
/// which bad ones among the first do not move; half of it the readings may still give to others.
fn event_action(
    memory: &LearnerState,
    acting: &FittedAlternative,
    finding: &DetectedChange,
) -> EventAction {
    let is_constant = |alternative: &&FittedAlternative| {
        matches!(alternative.alternative, AlternativeHypothesis::Constant(_))
    };
    let constants = finding.all.iter().filter(is_constant);
    let best = constants.max_by(|a, b| a.gain.total_cmp(&b.gain));
    match acting.alternative {
        // A thousandth of a micrometre: this much is written.
        AlternativeHypothesis::Zero => EventAction::Zero((acting.size * 1e3).round() / 1e3),
        AlternativeHypothesis::Constant(index) => {
            let deviation =
                (2.0 * acting.error).max(acting.size.abs() / 2.0).max(RESTART_RELATIVE_STD);
            let own = (index + 1, acting.size, deviation);
            let is_other = |other: &usize| *other != index && !memory.constants[*other].is_held();
            let others = (0..memory.constants.len()).filter(is_other);
            // Where its thermometer may as well have moved, a part of it may be the rise that this shows.
            let may_be = finding
                .all
                .iter()
                .filter(|alternative| alternative.gain > acting.gain - RETRACTION_LOG_ODDS);
            let rises = may_be.filter_map(|alternative| match alternative.alternative {
                AlternativeHypothesis::Thermometer(index) => rise_index(memory, index),
                _ => None,
            });
            let others = others.chain(rises).map(|other| (other + 1, 0.0, RESTART_RELATIVE_STD));
            EventAction::Shift(std::iter::once(own).chain(others).collect())
        }
        AlternativeHypothesis::Thermometer(index) => {
            if let Some(place) = rise_index(memory, index) {
                let deviation = (2.0 * acting.error).max(acting.size.abs() / 2.0);
                return EventAction::Shift(vec![(place + 1, acting.size, deviation)]);
            }
            // The constant that stands in best for it, roughly.
            let stands_in = best.and_then(|best| match best.alternative {
                AlternativeHypothesis::Constant(index) => {
                    Some((index + 1, best.size, best.size.abs() / 2.0))
                }
                _ => None,
            });
            let of_air = values_affected_by_air(memory, stands_in.map(|entry| entry.0));
            EventAction::Shift(stands_in.into_iter().chain(of_air).collect())
        }
        AlternativeHypothesis::Scatter => EventAction::Scatter(acting.size),
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use trueup_machine::{MachineFile, machine_file::Quantity};

    use super::*;
    use crate::state_reconciliation::reconcile_state;

    /// Returns the keys of what a moved thermometer frees.
    fn freed(laws: &str, quantity: Quantity) -> Vec<String> {
        let text = format!("[machine]\nname = \"m\"\nkind = \"3-axis\"\n{laws}");
        let machine = MachineFile::parse(&text, Path::new("m.toml")).expect("a machine file");
        let (memory, _) =
            reconcile_state(None, &machine, (quantity, None), &mut Vec::new()).expect("a state");
        values_affected_by_air(&memory, Some(1))
            .iter()
            .map(|entry| memory.value_key(entry.0).to_string())
            .collect()
    }

    #[test]
    fn a_moved_thermometer_frees_no_zero_that_the_file_has_no_place_for() {
        let axis = "[axis.x]\nfeedback = \"screw\"\n[axis.x.thermal]\nmode = \"position\"\nsensor = \"temp_a_c\"\n\
                    reference_c = 20.0\nslope_um_per_m_per_c = 11.0\norigin_mm = 0.0\n[axis.x.backlash]\nwidth_um = 4.0\n";
        assert_eq!(
            freed(axis, Quantity::Dx),
            ["axis.x.thermal.reference_c", "axis.x.backlash.width_um"]
        );
        let spindle = "[spindle]\nsource = \"temperature\"\n[spindle.temperature]\nsensor = \"temp_a_c\"\n\
                       reference_c = 20.0\nk_um_per_c = 2.0\n";
        assert_eq!(freed(spindle, Quantity::Elongation), ["zero"]);
    }

    #[test]
    fn changed_constants_are_followed_before_another_event_is_looked_for() {
        let event = |action: EventAction| DetectedEvent {
            event: EventKind::Unknown,
            constant: None,
            at: None,
            certain_at: None,
            size: 1.0,
            unit: String::new(),
            ci95: [0.0, 2.0],
            check: String::new(),
            alternatives: Vec::new(),
            sequence: 100,
            action,
            is_open: false,
        };
        assert_eq!(
            earliest_next_event_sequence(&event(EventAction::Shift(vec![(1, 0.3, 0.25)]))),
            124
        );
        // Of a step the constants know nothing: the next crash may be tomorrow.
        assert_eq!(earliest_next_event_sequence(&event(EventAction::Zero(12.0))), 101);
        assert_eq!(earliest_next_event_sequence(&event(EventAction::Nothing)), 101);
    }
}
