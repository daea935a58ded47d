//! The state and the machine file of today: whose it is, and which constants the user has changed since.
//!
//! A comment, a limit, another key changes nothing. A constant whose number was changed begins anew alone; so does the zero,
//! and a constant that is new. One that is gone is dropped. Then the readings of the window advance the checkpoint, since
//! they speak of the old number.

use trueup_machine::{Machine, machine_file::Quantity};

use crate::{
    event::EventAction,
    filter_bank::FilterBank,
    filter_history::FilterHistory,
    learnable_constants::{self, LearnableConstant},
    learner_state::{LearnerState, MachineIdentity},
};

/// The prior, one standard deviation: a constant is known to a quarter (what a maker says of growth is no better),
/// the zero to 5 µm, which any tool setter keeps.
const PRIOR_RELATIVE_STD: f64 = 0.25;
const PRIOR_ZERO_STD_UM: f64 = 5.0;
/// A backlash may double in a year.
const PRIOR_BACKLASH_RELATIVE_STD: f64 = 1.0;
/// Repeatability of a probe where nothing says it, in µm: the last digit of the papers' indicator.
const DEFAULT_READING_NOISE_UM: f64 = 1.0;

/// Returns the standard deviations before the first reading: of the zero in µm, of the share of each constant.
fn prior_standard_deviations(constants: &[LearnableConstant]) -> Vec<f64> {
    let share = |constant: &LearnableConstant| match constant {
        it if it.is_held() => 0.0,
        it if it.key.ends_with("width_um") => PRIOR_BACKLASH_RELATIVE_STD,
        _ => PRIOR_RELATIVE_STD,
    };
    std::iter::once(PRIOR_ZERO_STD_UM).chain(constants.iter().map(share)).collect()
}

/// Returns the state for `machine` as its file is today, and whether something of it began anew.
///
/// # Errors
/// It is of another machine or quantity, or nothing of the file can follow; the rule.
pub(crate) fn reconcile_state(
    memory: Option<LearnerState>,
    machine: &Machine,
    (quantity, air): (Quantity, Option<String>),
    notes: &mut Vec<String>,
) -> Result<(LearnerState, bool), String> {
    let air = memory.as_ref().and_then(|memory| memory.air.clone()).or(air);
    let all = learnable_constants::learnable_constants(machine, quantity, air.as_deref());
    let zero = learnable_constants::zero_location(machine, quantity).map(|(_, number, _)| number);
    if all.is_empty() {
        return Err(format!(
            "has no constant other than 0 by which {} is multiplied, so nothing can follow",
            quantity.name()
        ));
    }
    let Some(mut memory) = memory else {
        let noise_um = machine.instrument_um.map_or(DEFAULT_READING_NOISE_UM, |um| um / 2.0);
        let bank = FilterBank::new(&prior_standard_deviations(&all), noise_um);
        let owner = MachineIdentity::from_machine(machine);
        let state = LearnerState::new(owner, quantity.name().into(), all, bank);
        return Ok((LearnerState { air, zero, ..state }, false));
    };
    memory.air = air;
    let owner = MachineIdentity::from_machine(machine);
    let is_migrated = memory.machine.name.is_empty();
    if !is_migrated && !memory.machine.is_same_as(&owner) {
        return Err(format!(
            "is of {}, and the state next to the output was learned for {}: give each machine its own --output",
            owner.description(),
            memory.machine.description()
        ));
    }
    if learnable_constants::learnable_quantity_by_name(&memory.quantity) != Some(quantity) {
        return Err(format!(
            "the state next to the output was learned for {}, and the record measures {}: give each quantity its own \
             --output",
            memory.quantity,
            quantity.name()
        ));
    }
    if is_migrated {
        notes.push(
            "The state was read from the form of an earlier version; a backup is kept.".into(),
        );
    }
    // A serial number that the file says no longer is kept.
    let serial = owner.serial.or(memory.machine.serial.take());
    memory.machine = MachineIdentity { name: owner.name, serial };
    memory.zero = memory.zero.or(zero);
    let has_restarted = reset_changed_constants(&mut memory, all, zero, notes)?;
    Ok((memory, has_restarted))
}

/// Begins anew what the file says otherwise today; the rest stays. Returns true if anything did.
fn reset_changed_constants(
    memory: &mut LearnerState,
    all: Vec<LearnableConstant>,
    zero: Option<f64>,
    notes: &mut Vec<String>,
) -> Result<bool, String> {
    let place = |constant: &LearnableConstant| {
        memory.constants.iter().position(|candidate| candidate.is_same_as(constant))
    };
    let places: Vec<Option<usize>> = all.iter().map(place).collect();
    if places.iter().all(Option::is_none) {
        return Err(
            "has none of the constants that were learned: give another --output, or --reset to begin anew (a backup is kept)"
                .into(),
        );
    }
    let (mut from, mut is_news) = (vec![Some(0)], false);
    let is_same = |one: f64, two: f64| (one - two).abs() <= 1e-12 * one.abs().max(two.abs());
    if let (Some(old), Some(new)) = (memory.zero, zero)
        && !is_same(old, new)
    {
        from[0] = None;
        is_news = true;
        notes.push(format!(
            "The zero was changed by hand ({old} to {new}): it begins anew from there, the constants stay."
        ));
    }
    for (constant, place) in all.iter().zip(&places) {
        let Some(place) = *place else {
            // What is held is at the file's own value, and so it was.
            if !constant.is_held() {
                notes.push(format!("{} is new: it is learned from here on.", constant.key));
                is_news = true;
            }
            from.push(None);
            continue;
        };
        let old = memory.constants[place].believed;
        let is_retained = is_same(old, constant.believed);
        if !is_retained {
            is_news = true;
            notes.push(format!(
                "{} was changed by hand ({old} to {}): it begins anew from there, the rest stays.",
                constant.key, constant.believed
            ));
        }
        from.push(is_retained.then_some(place + 1));
    }
    for (index, old) in memory.constants.iter().enumerate() {
        if !places.contains(&Some(index)) {
            is_news = true;
            notes.push(format!("{} is no longer in the machine file: it is dropped.", old.key));
        }
    }
    let is_all = from.len() == memory.constants.len() + 1
        && from.iter().enumerate().all(|(index, source)| *source == Some(index));
    if !is_all {
        memory.checkpoint = FilterHistory::from_state(memory).bank;
        memory.checkpoint.remap_values(&from, &prior_standard_deviations(&all));
        memory.checkpoint_s =
            memory.window.last().and_then(|stored| stored.t).or(memory.checkpoint_s);
        memory.first = memory.next_sequence_number();
        memory.window.clear();
        let applied = from.iter().map(|source| source.map_or(0.0, |index| memory.applied[index]));
        memory.applied = applied.collect();
        memory.proven = None;
        // A width that was changed by hand wears from there on; with it the others.
        memory.worn.clear();
        for event in &mut memory.events {
            event.is_open = false;
            if matches!(event.action, EventAction::Shift(_)) {
                event.action = EventAction::Nothing;
            }
        }
        for change in &mut memory.changes {
            change.before = None;
            change.values.retain_mut(|(place, ..)| {
                let new = from.iter().position(|source| *source == Some(*place));
                *place = new.unwrap_or(*place);
                new.is_some()
            });
        }
    }
    memory.constants = all;
    memory.zero = zero;
    Ok(is_news)
}
