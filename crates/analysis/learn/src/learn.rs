//! The flow: a record with readings, what is known, and a machine file that follows.

use std::{borrow::Cow, collections::HashSet};

use serde::Serialize;
use trueup_machine::{
    BadInput, Location, Machine, MachineFile, RunFile,
    applied::{Applied, Factor, Uncompensated, applied, decisive_record},
    file::Quantity,
};

use crate::{
    bank::ENOUGH,
    checks,
    constants::{self, Sensitivity},
    event::{Action, Event, clock},
    filter::Fate,
    limits::{Limits, times},
    memory::{Change, Memory, StoredReading, digits as hash_digits},
    readings::{self, FIRST_DAY_S, Reading},
    reconcile::reconciled,
    replay::{self, Believed},
    rise,
    watch::watch,
    wear,
    written::{SAME, figures, written},
};

/// A change of a constant by this share, from readings of an engaged bridge alone, may as well be a CNC that applies the
/// offsets by half, twice, not at all or with the wrong sign: these look like changes by 0.5, −1, 1 and 2.
const AS_A_CNC: f64 = 0.4;
/// A clock that was set back by at most this, in s, may be local time.
const HOUR_S: f64 = 3600.0;
const SET_BACK: &str = ". If the clock was set back by an hour (the end of summer time), write each time with its offset \
     (2026-10-25T02:30:00+01:00) or in UTC (2026-10-25T01:30:00Z)";
/// Digits behind the point that are kept of a reading, in µm: a hundredth of what any probe repeats to.
const FINEST_UM: f64 = 1e-4;

/// The outcome of a reading.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ReadingOutcome {
    /// The row of the record, from 1, without the header.
    pub row: usize,
    /// The reading in µm.
    pub measured_um: f64,
    /// The prediction by what was applied then, in µm; `None` where the row does not say enough.
    pub foreseen_um: Option<f64>,
    /// Whether it was used.
    pub used: bool,
    /// Why not, or what else there is to say of it.
    pub reason: Option<String>,
}

/// The result of a record.
#[derive(Clone, Debug)]
pub struct Learned {
    /// The machine file with what was learned.
    pub machine: String,
    /// The state after the record.
    pub memory: Memory,
    /// Each new reading, in its order.
    pub readings: Vec<ReadingOutcome>,
    /// Readings of the record that were learned from before.
    pub seen: usize,
    /// Half the 95 % interval of each constant, in its unit.
    pub half_widths: Vec<f64>,
    /// Whether a bound was reached, or what was learned may not be applied.
    pub is_held: bool,
    /// Events that this record has made certain, or has named.
    pub news: Vec<Event>,
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
pub fn learn(
    source: &str,
    path: &std::path::Path,
    run: &RunFile,
    wanted: Option<Quantity>,
    memory: Option<Memory>,
    limits: &Limits,
) -> Result<Learned, BadInput> {
    let machine = MachineFile::parse(source, path)?;
    let bad = |rule: String| BadInput::new(Location::start_of(path), rule);
    let mut notes = Vec::new();
    let quantity = constants::measured(run, wanted)?;
    let (mut memory, has_restarted) =
        reconciled(memory, &machine, (quantity, rise::air(run)), &mut notes).map_err(bad)?;
    let before = written(source, &machine, quantity, &memory).unwrap_or_else(|| source.into());
    // What a bridge applied meanwhile came from the file as it was written before.
    let ran = MachineFile::parse(&before, path)?;
    let (run, told) = Uncompensated::of(Cow::Borrowed(run), Some(&ran), Some(quantity))?;
    notes.extend(told);
    let has_bridge = has_bridge(&run, &ran, quantity)?;
    let record = readings::of(&run, quantity)?;
    let (new, seen) = unseen(&record, &memory, &run, &mut notes)?;
    let sensitivity =
        Sensitivity::of(source, (&memory.constants, &memory.applied), &run, quantity)?;
    let old = memory.events.clone();
    let mut learner = Learner {
        believed: Believed::of(&memory),
        columns: columns(&mut memory, &sensitivity),
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
            let rows = run.altered(reading.row + 1, |_, _| {});
            let part = Uncompensated::of(Cow::Owned(rows), Some(&ran), Some(quantity));
            learner.memory.is_applied_once = part.is_ok_and(|(part, _)| {
                matches!(applied(&[part], Some(&ran), quantity), Applied::Once(_))
            });
        }
        if let Some(um) = reading.check_um {
            learner.check(reading.time_s, um);
        }
        if let Some(um) = reading.um {
            let (taken, held) = learner.one(reading, um, !has_bridge);
            readings.push(taken);
            is_held |= held.is_bound;
            forbids = held.forbids;
        }
        learner.memory.see(reading.identity);
    }
    let Learner { memory, believed, .. } = learner;
    let after = written(source, &machine, quantity, &memory)
        .ok_or_else(|| bad("cannot be written with other constants".into()))?;
    MachineFile::parse(&after, path)?;
    let is_bound = is_held;
    is_held |= forbids.is_some();
    notes.push(forbids.unwrap_or_else(|| sentence(&believed)));
    if is_bound {
        notes.push(format!(
            "A bound was reached ({:.0} % of a constant, or {} µm together): the machine is no longer the one \
             that was measured. Measure it again: trueup fit, or trueup diagnose.",
            100.0 * limits.share,
            limits.total_um
        ));
    }
    notes.extend(checks::due(&memory));
    let is_news = |event: &&Event| {
        !old.iter().any(|it| it.sequence == event.sequence && it.event == event.event)
    };
    let news = memory.events.iter().filter(is_news).cloned().collect();
    let half = believed.bank.half_widths();
    let half_widths = memory.constants.iter().zip(&half[1..]);
    let half_widths = half_widths.map(|(it, half)| (it.believed * half).abs()).collect();
    Ok(Learned {
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
fn unseen(
    record: &[Reading],
    memory: &Memory,
    run: &RunFile,
    notes: &mut Vec<String>,
) -> Result<(Vec<Reading>, usize), BadInput> {
    let (seen, before) = (memory.seen(), memory.seen_before());
    let is_seen = |it: &Reading| {
        let may_be = match (it.time_s, memory.last_s) {
            (Some(time_s), Some(last_s)) => time_s <= last_s,
            _ => true,
        };
        let is_in = |all: &HashSet<&str>, hash: u64| all.contains(hash_digits(hash).as_str());
        may_be && (is_in(&seen, it.identity) || is_in(&before, it.identity_before))
    };
    let new: Vec<Reading> = record.iter().filter(|it| !is_seen(it)).copied().collect();
    let known = record.len() - new.len();
    if known > 0 {
        let all = record.len();
        notes.push(format!("{known} of {all} readings were learned from before and are skipped"));
    }
    let Some(last_s) = memory.last_s else { return Ok((new, known)) };
    let early = new.iter().find_map(|it| Some((it, it.time_s.filter(|time_s| *time_s <= last_s)?)));
    if let Some((early, early_s)) = early {
        // Clocks of two records that each begin with the record.
        if known > 0 || last_s >= FIRST_DAY_S {
            let rule = format!(
                "{} is at or before the last reading that was learned from ({}), and was not learned from: \
                 give the records in the order in which they were taken{}",
                clock(early_s),
                clock(last_s),
                if last_s - early_s <= HOUR_S { SET_BACK } else { "" }
            );
            return Err(run.bad(early.row, "time_s", rule));
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
fn columns(memory: &mut Memory, sensitivity: &Sensitivity) -> Vec<usize> {
    let places = sensitivity.thermometers.iter().map(|name| {
        let place = memory.thermometers.iter().position(|it| it == name);
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
fn has_bridge(
    run: &Uncompensated<'_>,
    ran: &Machine,
    quantity: Quantity,
) -> Result<bool, BadInput> {
    match applied(std::slice::from_ref(run), Some(ran), quantity) {
        Applied::Nothing => Ok(false),
        Applied::Once(_) | Applied::Unknown(_) => Ok(true),
        Applied::Otherwise(factor) => {
            let rule = format!("{} {}", factor.sentence(), Factor::where_to_look().join(" "));
            Err(BadInput::new(Location::start_of(run.path()), rule))
        }
    }
}

/// The causes that hold a correction back.
#[derive(Default)]
struct Held {
    /// A bound was reached.
    is_bound: bool,
    /// Why what was learned is not applied, a sentence.
    forbids: Option<String>,
}

/// A record, while it is learned from.
struct Learner<'a> {
    memory: Memory,
    believed: Believed,
    machine: &'a Machine,
    quantity: Quantity,
    sensitivity: &'a Sensitivity,
    /// The place in the state of each thermometer of the record.
    columns: Vec<usize>,
    limits: &'a Limits,
    /// Rows so far in which a constant does most and least.
    extremes: Vec<usize>,
    /// Rows that were looked at for them.
    looked: usize,
}

impl Learner<'_> {
    /// Takes a check of the probe.
    fn check(&mut self, time_s: Option<f64>, um: f64) {
        checks::add(&mut self.memory, time_s, um, self.believed.bank.scatter_um()[0]);
        self.believed = Believed::of(&self.memory);
    }

    /// Takes one reading: what became of it, and what held it.
    fn one(&mut self, reading: &Reading, um: f64, is_factor_known: bool) -> (ReadingOutcome, Held) {
        let (g, file_um) =
            (&self.sensitivity.um[reading.row], self.sensitivity.believed_um[reading.row]);
        let mut taken = ReadingOutcome {
            row: reading.row + 1,
            measured_um: um,
            foreseen_um: None,
            used: false,
            reason: None,
        };
        if !file_um.is_finite() || g.iter().any(|g| !g.is_finite()) {
            taken.reason = Some(
                "refused: the row does not say enough for the model (a missing temperature?)"
                    .into(),
            );
            return (taken, Held::default());
        }
        let memory = &mut self.memory;
        let mut h = vec![0.0; memory.thermometers.len()];
        for (place, um) in self.columns.iter().zip(&self.sensitivity.shares_um) {
            h[*place] = um[reading.row];
        }
        let rounded = |um: &f64| (um / FINEST_UM).round() * FINEST_UM;
        let short = |um: &f64| {
            let um = if um.is_finite() { rounded(um) } else { 0.0 };
            format!("{um:.4}").parse().unwrap_or(um)
        };
        let kept = StoredReading {
            t: reading.time_s,
            y: short(&(um - file_um)),
            g: g.iter().map(short).collect(),
            h: h.iter().map(short).collect(),
            worn: Vec::new(),
        };
        let g = &kept.g.clone();
        taken.foreseen_um = Some(file_um + times(g, &memory.applied));
        let (sequence, values) = (memory.next(), figures(memory, self.machine, self.quantity));
        let was_applied = memory.applied.clone();
        memory.first_s = memory.first_s.or(reading.time_s);
        memory.last_s = reading.time_s.or(memory.last_s);
        memory.window.push(kept);
        let (lasting, [scatter_um, _]) =
            (self.believed.bank.lasting(), self.believed.bank.scatter_um());
        let last = memory.window.len() - 1;
        match self.believed.advance(memory, last) {
            Fate::ReadingOutcome => taken.used = true,
            Fate::Refused { off_um, deviations } => {
                taken.reason = Some(format!(
                    "refused: {off_um:+.1} µm from the prediction, {deviations:.0} times what a reading may \
                     differ by"
                ));
            }
            Fate::Changed => {
                taken.used = true;
                taken.reason = Some(
                    "used, with those before it that were refused: four of six are on one side"
                        .into(),
                );
            }
        }
        if taken.used {
            let missed_um =
                replay::level(memory, &memory.window[last], sequence, None) - times(g, &lasting);
            let before = &memory.window[..last];
            let said = wear::said(&memory.constants, before, g, &lasting, missed_um, scatter_um);
            memory.window[last].worn = said.iter().map(short).collect();
        }
        let before = memory.events.clone();
        watch(memory, &mut self.believed);
        let rests_on = rests_on(memory, &before);
        wear::watch(memory, self.believed.bank.scatter_um()[1]);
        let wanted = self.believed.bank.believed().unwrap_or_else(|| vec![0.0; g.len()]);
        self.look(reading.row);
        let rows = self.extremes.iter().map(|row| &self.sensitivity.um[*row]);
        let (wanted, is_bound) = self.limits.held(&wanted, rows);
        let memory = &mut self.memory;
        let is_proven = is_factor_known || memory.is_applied_once;
        let forbids = forbidden(memory, &wanted, is_proven);
        if forbids.is_some() {
            // Nor the steps on the way there.
            memory.applied = memory.proven.take().unwrap_or(was_applied.clone());
        } else {
            if is_proven {
                memory.proven = None;
            } else {
                memory.proven.get_or_insert_with(|| was_applied.clone());
            }
            memory.applied = self.limits.step(&memory.applied, &wanted, g, rests_on);
        }
        self.believed.keep(memory);
        list(memory, self.machine, self.quantity, &values, (sequence, was_applied));
        (taken, Held { is_bound, forbids })
    }

    /// Looks at the rows until `row` for those in which a constant does most or least.
    fn look(&mut self, row: usize) {
        let all = &self.sensitivity.um;
        for row in self.looked..=row {
            if all[row].iter().any(|g| !g.is_finite()) {
                continue;
            }
            let beats = |value: usize| {
                let others = self.extremes.iter().map(|it| all[*it][value]);
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
fn rests_on(memory: &Memory, before: &[Event]) -> u64 {
    let name = |event: &Event| (event.sequence, event.event, event.constant.clone());
    let acts = |event: &&Event| matches!(event.action, Action::Zero(_) | Action::Shift(_));
    let new = memory.events.iter().filter(acts);
    let new = new.filter(|event| !before.iter().any(|it| name(it) == name(event)));
    new.map(|event| memory.next().saturating_sub(event.sequence)).max().unwrap_or(1).max(1)
}

/// Returns why `wanted` may not be applied, in a sentence.
fn forbidden(memory: &Memory, wanted: &[f64], is_factor_known: bool) -> Option<String> {
    let moves = |(to, from): (&f64, &f64)| (to - from).abs() > SAME;
    let is_as_a_cnc = wanted[1..].iter().any(|share| share.abs() > AS_A_CNC);
    let is_moved = wanted.iter().zip(&memory.applied).any(moves);
    (is_moved && is_as_a_cnc && !is_factor_known)
        .then(|| format!("Nothing is applied. {}", decisive_record()))
}

/// Returns which of the two is believed, in a sentence.
fn sentence(believed: &Believed) -> String {
    let bank = &believed.bank;
    let (count, file_um, own_um) = bank.compared();
    let figures = match count {
        0 => "no reading has been used yet".into(),
        _ => format!(
            "of the last {count} readings that were used the current machine file missed each by {file_um:.2} µm on \
             average, what was learned by {own_um:.2} µm, before they were used"
        ),
    };
    let odds = bank.odds();
    match bank.believed() {
        Some(_) => format!("What was learned is applied: {figures}."),
        None => format!(
            "The current machine file stays: {figures}; they are {odds:.0} times likelier by what was learned, and \
             {ENOUGH:.0} times would be enough."
        ),
    }
}

/// Lists the change that a reading made; those of one day are one.
fn list(
    memory: &mut Memory,
    machine: &Machine,
    quantity: Quantity,
    from: &[f64],
    before: (u64, Vec<f64>),
) {
    let to = figures(memory, machine, quantity);
    if to == from {
        return;
    }
    let day = |s: f64| (s / 86_400.0).floor();
    let at = memory.last_s;
    let is_today = |change: &Change| {
        change.before.is_some() && change.at.zip(at).is_some_and(|(one, two)| day(one) == day(two))
    };
    let today = memory.changes.pop_if(|change| is_today(change));
    let began = |place: usize| {
        let values = today.as_ref().map(|change| &change.values);
        let value = values.and_then(|values| values.iter().find(|(it, ..)| *it == place));
        value.map_or(from[place], |(_, from, _)| *from)
    };
    let values: Vec<(usize, f64, f64)> = (0..to.len())
        .map(|place| (place, began(place), to[place]))
        .filter(|(_, from, to)| from != to)
        .collect();
    if !values.is_empty() {
        let before = today.and_then(|change| change.before).or(Some(before));
        memory.list(Change { at, values, is_undo: false, before });
    }
}
