//! The flow: a record with readings, what is known, and a machine file that follows.

use std::{borrow::Cow, collections::HashSet};

use serde::Serialize;
use trueup_machine::{
    InputFileError, Location, Machine, MachineFile, RunFile,
    applied_offsets::{
        FactorEstimate, OffsetApplication, UncompensatedRun, estimate_offset_application,
        repeat_run_instruction,
    },
    machine_file::Quantity,
};

use crate::{
    event::{DetectedEvent, EventAction, format_timestamp},
    event_monitor::detect_events,
    file_update::{
        MIN_RELATIVE_CHANGE, applied_file_values, apply_values_to_source, record_daily_change,
    },
    filter_history::{FilterHistory, corrected_reading_um},
    learnable_constants::{self, PredictionSensitivities},
    learner_notes::{describe_applied_model, describe_reached_bound},
    learner_state::{LearnerState, StoredReading, format_truncated_hash},
    learning_limits::{LearningLimits, prediction_change_um},
    probe_checks,
    readings::{self, MAX_RELATIVE_START_S, ReferenceReading},
    rls_filter::FilterOutcome,
    state_reconciliation::reconcile_state,
    temperature_rise, wear,
};

/// A change of a constant by this share, from readings of an engaged bridge alone, may as well be a CNC that applies the
/// offsets by half, twice, not at all or with the wrong sign: these look like changes by 0.5, −1, 1 and 2.
const MAX_UNAMBIGUOUS_RELATIVE_CHANGE: f64 = 0.4;
/// A clock that was set back by at most this, in s, may be local time.
const MAX_CLOCK_SET_BACK_S: f64 = 3600.0;
const CLOCK_SET_BACK_NOTE: &str = ". If the clock was set back by an hour (the end of summer time), write each time with its offset \
     (2026-10-25T02:30:00+01:00) or in UTC (2026-10-25T01:30:00Z)";
/// Digits behind the point that are kept of a reading, in µm: a hundredth of what any probe repeats to.
const READING_RESOLUTION_UM: f64 = 1e-4;

/// The outcome of a reading.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ReadingOutcome {
    /// The row of the record, from 1, without the header.
    pub row: usize,
    /// The reading in µm.
    pub measured_um: f64,
    /// The prediction by what was applied then, in µm; `None` where the row does not say enough.
    pub predicted_um: Option<f64>,
    /// Whether it was used.
    pub used: bool,
    /// Why not, or what else there is to say of it.
    pub reason: Option<String>,
}

/// The result of a record.
#[derive(Clone, Debug)]
pub struct LearningResult {
    /// The machine file with what was learned.
    pub machine: String,
    /// The state after the record.
    pub memory: LearnerState,
    /// Each new reading, in its order.
    pub readings: Vec<ReadingOutcome>,
    /// Readings of the record that were learned from before.
    pub seen: usize,
    /// Half the 95 % interval of each constant, in its unit.
    pub half_widths: Vec<f64>,
    /// Whether a bound was reached, or what was learned may not be applied.
    pub is_held: bool,
    /// Events that this record has made certain, or has named.
    pub news: Vec<DetectedEvent>,
    /// Whether something that was known is no longer kept: a constant that was changed by hand.
    pub has_restarted: bool,
    /// Sentences for the user.
    pub notes: Vec<String>,
}

/// Learns from `run`, given the user's own machine file `source` (at `path`) and what is known from before.
///
/// # Errors
/// `source` is no machine file, or has no constant that can follow; `memory` is of another machine or quantity; the run
/// measures nothing, or has a reading at or before the last clock that was not learned from.
pub fn learn_from_run(
    source: &str,
    path: &std::path::Path,
    run: &RunFile,
    requested: Option<Quantity>,
    memory: Option<LearnerState>,
    limits: &LearningLimits,
) -> Result<LearningResult, InputFileError> {
    let machine = MachineFile::parse(source, path)?;
    let bad = |rule: String| InputFileError::new(Location::start_of_file(path), rule);
    let mut notes = Vec::new();
    let quantity = learnable_constants::resolve_quantity(run, requested)?;
    let (mut memory, has_restarted) = reconcile_state(
        memory,
        &machine,
        (quantity, temperature_rise::air_column_name(run)),
        &mut notes,
    )
    .map_err(bad)?;
    let before = apply_values_to_source(source, &machine, quantity, &memory)
        .unwrap_or_else(|| source.into());
    // What a bridge applied meanwhile came from the file as it was written before.
    let ran = MachineFile::parse(&before, path)?;
    let (run, run_notes) =
        UncompensatedRun::from_run(Cow::Borrowed(run), Some(&ran), Some(quantity))?;
    notes.extend(run_notes);
    let has_bridge = has_engaged_bridge(&run, &ran, quantity)?;
    let record = readings::collect_readings(&run, quantity)?;
    let (new, seen) = select_unseen_readings(&record, &memory, &run, &mut notes)?;
    let sensitivity = PredictionSensitivities::from_run(
        source,
        (&memory.constants, &memory.applied),
        &run,
        quantity,
    )?;
    let old = memory.events.clone();
    let mut learner = Learner {
        believed: FilterHistory::from_state(&memory),
        columns: register_thermometer_columns(&mut memory, &sensitivity),
        memory,
        machine: &machine,
        quantity,
        sensitivity: &sensitivity,
        limits,
        extremes: Vec::new(),
        looked: 0,
    };
    let mut readings = Vec::new();
    let (mut is_held, mut forbids) = (false, None);
    for reading in &new {
        if !learner.memory.is_applied_once && has_bridge {
            learner.memory.is_applied_once =
                is_offset_applied_once_until(&run, &ran, quantity, reading.row);
        }
        if let Some(um) = reading.check_um {
            learner.record_probe_check(reading.time_s, um);
        }
        if let Some(um) = reading.um {
            let (taken, held) = learner.learn_from_reading(reading, um, !has_bridge);
            readings.push(taken);
            is_held |= held.is_bound;
            forbids = held.forbids;
        }
        learner.memory.mark_seen(reading.identity);
    }
    let Learner { memory, believed, .. } = learner;
    let after = apply_values_to_source(source, &machine, quantity, &memory)
        .ok_or_else(|| bad("cannot be written with other constants".into()))?;
    MachineFile::parse(&after, path)?;
    let is_bound = is_held;
    is_held |= forbids.is_some();
    notes.push(forbids.unwrap_or_else(|| describe_applied_model(&believed)));
    if is_bound {
        notes.push(describe_reached_bound(limits));
    }
    notes.extend(probe_checks::overdue_check_note(&memory));
    let is_news = |event: &&DetectedEvent| {
        !old.iter().any(|other| other.sequence == event.sequence && other.event == event.event)
    };
    let news = memory.events.iter().filter(is_news).cloned().collect();
    let half = believed.bank.confidence_half_widths();
    let half_widths = memory.constants.iter().zip(&half[1..]);
    let half_widths =
        half_widths.map(|(constant, half)| (constant.believed * half).abs()).collect();
    Ok(LearningResult {
        machine: after,
        memory,
        readings,
        seen,
        half_widths,
        is_held,
        news,
        has_restarted,
        notes,
    })
}

/// Returns the readings that were not learned from before, and how many were.
///
/// # Errors
/// One that was not lies at or before the last clock.
fn select_unseen_readings(
    record: &[ReferenceReading],
    memory: &LearnerState,
    run: &RunFile,
    notes: &mut Vec<String>,
) -> Result<(Vec<ReferenceReading>, usize), InputFileError> {
    let (seen, before) = (memory.seen_hashes(), memory.legacy_seen_hashes());
    let is_seen = |reading: &ReferenceReading| {
        let may_be = match (reading.time_s, memory.last_s) {
            (Some(time_s), Some(last_s)) => time_s <= last_s,
            _ => true,
        };
        let is_in =
            |all: &HashSet<&str>, hash: u64| all.contains(format_truncated_hash(hash).as_str());
        may_be && (is_in(&seen, reading.identity) || is_in(&before, reading.identity_before))
    };
    let new: Vec<ReferenceReading> =
        record.iter().filter(|reading| !is_seen(reading)).copied().collect();
    let known = record.len() - new.len();
    if known > 0 {
        let all = record.len();
        notes.push(format!("{known} of {all} readings were learned from before and are skipped"));
    }
    let Some(last_s) = memory.last_s else { return Ok((new, known)) };
    let early = new
        .iter()
        .find_map(|reading| Some((reading, reading.time_s.filter(|time_s| *time_s <= last_s)?)));
    if let Some((early, early_s)) = early {
        // Clocks of two records that each begin with the record.
        if known > 0 || last_s >= MAX_RELATIVE_START_S {
            let rule = format!(
                "{} is at or before the last reading that was learned from ({}), and was not \
                 learned from. Give the records in the order in which they were taken{}",
                format_timestamp(early_s),
                format_timestamp(last_s),
                if last_s - early_s <= MAX_CLOCK_SET_BACK_S { CLOCK_SET_BACK_NOTE } else { "" }
            );
            return Err(run.value_error(early.row, "time_s", rule));
        }
        notes.push(
            "The clock of this record begins before the last reading that was learned from: it is taken as a later \
             day. If it is an older one, take the change back (--undo)."
                .into(),
        );
    }
    Ok((new, known))
}

/// Returns the place in the state's thermometers of each one of the record; new ones are added.
fn register_thermometer_columns(
    memory: &mut LearnerState,
    sensitivity: &PredictionSensitivities,
) -> Vec<usize> {
    let places = sensitivity.thermometers.iter().map(|name| {
        let place = memory.thermometers.iter().position(|thermometer| thermometer == name);
        place.unwrap_or_else(|| {
            memory.thermometers.push(name.clone());
            memory.thermometers.len() - 1
        })
    });
    places.collect()
}

/// Returns true if the record has offsets of an engaged bridge.
///
/// # Errors
/// The CNC applies them otherwise than once.
fn has_engaged_bridge(
    run: &UncompensatedRun<'_>,
    ran: &Machine,
    quantity: Quantity,
) -> Result<bool, InputFileError> {
    match estimate_offset_application(std::slice::from_ref(run), Some(ran), quantity) {
        OffsetApplication::NoOffset => Ok(false),
        OffsetApplication::Once(_) | OffsetApplication::Unknown(_) => Ok(true),
        OffsetApplication::OtherFactor(factor) => {
            let rule = format!(
                "{} {}",
                factor.describe(),
                FactorEstimate::troubleshooting_steps().join(" ")
            );
            Err(InputFileError::new(Location::start_of_file(run.path()), rule))
        }
    }
}

/// Returns true if the rows up to `row` show that the CNC applies the offsets once.
fn is_offset_applied_once_until(
    run: &UncompensatedRun<'_>,
    ran: &Machine,
    quantity: Quantity,
    row: usize,
) -> bool {
    let rows = run.with_altered_values(row + 1, |_, _| {});
    let part = UncompensatedRun::from_run(Cow::Owned(rows), Some(ran), Some(quantity));
    part.is_ok_and(|(part, _)| {
        matches!(
            estimate_offset_application(&[part], Some(ran), quantity),
            OffsetApplication::Once(_)
        )
    })
}

/// The causes that hold a correction back.
#[derive(Default)]
struct HoldReasons {
    /// A bound was reached.
    is_bound: bool,
    /// Why what was learned is not applied, a sentence.
    forbids: Option<String>,
}

/// A record, while it is learned from.
struct Learner<'a> {
    memory: LearnerState,
    believed: FilterHistory,
    machine: &'a Machine,
    quantity: Quantity,
    sensitivity: &'a PredictionSensitivities,
    /// The place in the state of each thermometer of the record.
    columns: Vec<usize>,
    limits: &'a LearningLimits,
    /// Rows so far in which a constant does most and least.
    extremes: Vec<usize>,
    /// Rows that were looked at for them.
    looked: usize,
}

impl Learner<'_> {
    /// Takes a check of the probe.
    fn record_probe_check(&mut self, time_s: Option<f64>, um: f64) {
        probe_checks::add_check_and_detect_drift(
            &mut self.memory,
            time_s,
            um,
            self.believed.bank.scatter_um()[0],
        );
        self.believed = FilterHistory::from_state(&self.memory);
    }

    /// Takes one reading: what became of it, and what held it.
    fn learn_from_reading(
        &mut self,
        reading: &ReferenceReading,
        um: f64,
        is_factor_known: bool,
    ) -> (ReadingOutcome, HoldReasons) {
        let (g, file_um) =
            (&self.sensitivity.um[reading.row], self.sensitivity.believed_um[reading.row]);
        let mut taken = ReadingOutcome {
            row: reading.row + 1,
            measured_um: um,
            predicted_um: None,
            used: false,
            reason: None,
        };
        if !file_um.is_finite() || g.iter().any(|g| !g.is_finite()) {
            let reason = "refused: the row lacks an input of the model (a missing temperature?)";
            taken.reason = Some(reason.into());
            return (taken, HoldReasons::default());
        }
        let memory = &mut self.memory;
        let mut h = vec![0.0; memory.thermometers.len()];
        for (place, um) in self.columns.iter().zip(&self.sensitivity.shares_um) {
            h[*place] = um[reading.row];
        }
        let stored = StoredReading {
            t: reading.time_s,
            y: round_to_stored_um(&(um - file_um)),
            g: g.iter().map(round_to_stored_um).collect(),
            h: h.iter().map(round_to_stored_um).collect(),
            worn: Vec::new(),
        };
        let g = &stored.g.clone();
        taken.predicted_um = Some(file_um + prediction_change_um(g, &memory.applied));
        let (sequence, values) = (
            memory.next_sequence_number(),
            applied_file_values(memory, self.machine, self.quantity),
        );
        let was_applied = memory.applied.clone();
        memory.first_s = memory.first_s.or(reading.time_s);
        memory.last_s = reading.time_s.or(memory.last_s);
        memory.window.push(stored);
        let (lasting, [scatter_um, _]) =
            (self.believed.bank.persistent_values(), self.believed.bank.scatter_um());
        let last = memory.window.len() - 1;
        match self.believed.process_window_reading(memory, last) {
            FilterOutcome::Accepted => taken.used = true,
            FilterOutcome::Rejected { off_um, deviations } => {
                taken.reason = Some(format!(
                    "refused: {off_um:+.1} µm from the prediction, {deviations:.0} times what a reading may \
                     differ by"
                ));
            }
            FilterOutcome::Changed => {
                taken.used = true;
                let reason =
                    "used, with those before it that were refused: four of six are on one side";
                taken.reason = Some(reason.into());
            }
        }
        if taken.used {
            let missed_um = corrected_reading_um(memory, &memory.window[last], sequence, None)
                - prediction_change_um(g, &lasting);
            let observations = wear::backlash_observations(
                &memory.constants,
                &memory.window[..last],
                g,
                &lasting,
                missed_um,
                scatter_um,
            );
            memory.window[last].worn = observations.iter().map(round_to_stored_um).collect();
        }
        let before = memory.events.clone();
        detect_events(memory, &mut self.believed);
        let rests_on = supporting_reading_count(memory, &before);
        wear::detect_wear(memory, self.believed.bank.scatter_um()[1]);
        let requested =
            self.believed.bank.learned_values_if_applied().unwrap_or_else(|| vec![0.0; g.len()]);
        self.track_sensitivity_extremes(reading.row);
        let rows = self.extremes.iter().map(|row| &self.sensitivity.um[*row]);
        let (requested, is_bound) = self.limits.clamp_to_limits(&requested, rows);
        let memory = &mut self.memory;
        let is_proven = is_factor_known || memory.is_applied_once;
        let forbids = rejection_reason(memory, &requested, is_proven);
        if forbids.is_some() {
            // Nor the steps on the way there.
            memory.applied = memory.proven.take().unwrap_or(was_applied.clone());
        } else {
            let proven = memory.proven.take().unwrap_or_else(|| was_applied.clone());
            memory.proven = (!is_proven).then_some(proven);
            memory.applied =
                self.limits.step_toward_target(&memory.applied, &requested, g, rests_on);
        }
        self.believed.trim_window(memory);
        record_daily_change(memory, self.machine, self.quantity, &values, (sequence, was_applied));
        (taken, HoldReasons { is_bound, forbids })
    }

    /// Looks at the rows until `row` for those in which a constant does most or least.
    fn track_sensitivity_extremes(&mut self, row: usize) {
        let all = &self.sensitivity.um;
        for row in self.looked..=row {
            if all[row].iter().any(|g| !g.is_finite()) {
                continue;
            }
            let beats = |value: usize| {
                let others = self.extremes.iter().map(|extreme| all[*extreme][value]);
                let (low, high) = others
                    .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), g| {
                        (low.min(g), high.max(g))
                    });
                all[row][value] < low || all[row][value] > high
            };
            if (1..all[row].len()).any(beats) || self.extremes.is_empty() {
                // Others that it beats in all stay: there are some tens at most in a record that warms slowly.
                self.extremes.push(row);
            }
        }
        self.looked = self.looked.max(row + 1);
    }
}

/// Returns how many readings the present change rests on: all since an event that is new, or has another name than `before`; else this
/// one.
fn supporting_reading_count(memory: &LearnerState, before: &[DetectedEvent]) -> u64 {
    let name = |event: &DetectedEvent| (event.sequence, event.event, event.constant.clone());
    let acts = |event: &&DetectedEvent| {
        matches!(event.action, EventAction::Zero(_) | EventAction::Shift(_))
    };
    let new = memory.events.iter().filter(acts);
    let new = new.filter(|event| !before.iter().any(|other| name(other) == name(event)));
    new.map(|event| memory.next_sequence_number().saturating_sub(event.sequence))
        .max()
        .unwrap_or(1)
        .max(1)
}

/// Rounds a value in µm as it is stored; 0 where it is none.
fn round_to_stored_um(um: &f64) -> f64 {
    let um = if um.is_finite() { *um } else { 0.0 };
    let rounded = (um / READING_RESOLUTION_UM).round() * READING_RESOLUTION_UM;
    format!("{rounded:.4}").parse().unwrap_or(rounded)
}

/// Returns why `target` may not be applied, in a sentence.
fn rejection_reason(
    memory: &LearnerState,
    target: &[f64],
    is_factor_known: bool,
) -> Option<String> {
    let moves = |(to, from): (&f64, &f64)| (to - from).abs() > MIN_RELATIVE_CHANGE;
    let is_as_a_cnc = target[1..].iter().any(|share| share.abs() > MAX_UNAMBIGUOUS_RELATIVE_CHANGE);
    let is_moved = target.iter().zip(&memory.applied).any(moves);
    (is_moved && is_as_a_cnc && !is_factor_known)
        .then(|| format!("Nothing is applied. {}", repeat_run_instruction()))
}
