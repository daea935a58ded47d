//! The numbers of a machine file with what was learned.

use trueup_machine::{Machine, MachineFile, machine_file::Quantity};

use crate::{
    learnable_constants::{self, LearnableConstant},
    learner_state::{DailyChange, LearnerState, MachineIdentity},
};

/// A constant that has moved by less than this share of itself is written as it was.
pub(crate) const MIN_RELATIVE_CHANGE: f64 = 1e-3;

/// Returns the numbers of the machine file with what is applied: of the zero, of each constant.
pub(crate) fn applied_file_values(
    memory: &LearnerState,
    machine: &Machine,
    quantity: Quantity,
) -> Vec<f64> {
    let zero = match learnable_constants::zero_location(machine, quantity) {
        Some((_, from, per_um)) if memory.applied[0].abs() > 0.01 => {
            // A growth of k·(1 + x) moves its reference by as much less.
            let grown =
                memory.constants.iter().position(|constant| constant.key.ends_with("k_um_per_c"));
            let grown = grown.map_or(1.0, |index| 1.0 + memory.applied[index + 1]);
            let per_um = if per_um < 0.0 { per_um / grown } else { per_um };
            round_to_six_digits(from + per_um * memory.applied[0])
        }
        Some((_, from, _)) => from,
        None => 0.0,
    };
    let shares = memory.constants.iter().zip(&memory.applied[1..]);
    let constants = shares.map(|(constant, share)| {
        let believed = constant.believed;
        let share = share / slope_growth_factor(memory, constant);
        if share.abs() > MIN_RELATIVE_CHANGE {
            round_to_six_digits(believed * (1.0 + share))
        } else {
            believed
        }
    });
    std::iter::once(zero).chain(constants).collect()
}

/// Returns by how much the slope of a reference has grown, as a factor: it moves its reference by as much less. 1 for the rest.
fn slope_growth_factor(memory: &LearnerState, constant: &LearnableConstant) -> f64 {
    let Some(axis) =
        constant.key.strip_suffix("reference_c").filter(|_| constant.is_reference_temperature())
    else {
        return 1.0;
    };
    let slope = format!("{axis}slope_um_per_m_per_c");
    let place = memory.constants.iter().position(|constant| constant.key == slope);
    place.map_or(1.0, |index| 1.0 + memory.applied[index + 1])
}

/// Returns the user's file with what is applied.
pub(crate) fn apply_values_to_source(
    source: &str,
    machine: &Machine,
    quantity: Quantity,
    memory: &LearnerState,
) -> Option<String> {
    let all = applied_file_values(memory, machine, quantity);
    let constants = memory.constants.iter().zip(&all[1..]);
    let mut changed: Vec<(String, f64)> = constants
        .filter(|(constant, value)| constant.believed != **value)
        .map(|(constant, value)| (constant.key.clone(), *value))
        .collect();
    if let Some((key, from, _)) = learnable_constants::zero_location(machine, quantity)
        && all[0] != from
    {
        changed.push((key.into(), all[0]));
    }
    learnable_constants::replace_constants(source, &changed)
}

/// Lists the change that a reading made; those of one day are one.
pub(crate) fn record_daily_change(
    memory: &mut LearnerState,
    machine: &Machine,
    quantity: Quantity,
    from: &[f64],
    before: (u64, Vec<f64>),
) {
    let to = applied_file_values(memory, machine, quantity);
    if to == from {
        return;
    }
    let day = |s: f64| (s / 86_400.0).floor();
    let at = memory.last_s;
    let is_today = |change: &DailyChange| {
        change.before.is_some() && change.at.zip(at).is_some_and(|(one, two)| day(one) == day(two))
    };
    let today = memory.changes.pop_if(|change| is_today(change));
    let began = |place: usize| {
        let values = today.as_ref().map(|change| &change.values);
        let value =
            values.and_then(|values| values.iter().find(|(candidate, ..)| *candidate == place));
        value.map_or(from[place], |(_, from, _)| *from)
    };
    let values: Vec<(usize, f64, f64)> = (0..to.len())
        .map(|place| (place, began(place), to[place]))
        .filter(|(_, from, to)| from != to)
        .collect();
    if !values.is_empty() {
        let before = today.and_then(|change| change.before).or(Some(before));
        memory.record_change(DailyChange { at, values, is_undo: false, before });
    }
}

/// Six digits: a hundredth of what any of them is known to.
fn round_to_six_digits(number: f64) -> f64 {
    format!("{number:.5e}").parse().unwrap_or(number)
}

impl LearnerState {
    /// Returns the user's own machine file `source` with what is applied; `None` where it is another machine's, or its
    /// constants are others.
    #[must_use]
    pub fn apply_to_source(&self, source: &str, path: &std::path::Path) -> Option<String> {
        let machine = MachineFile::parse(source, path).ok()?;
        let quantity = learnable_constants::learnable_quantity_by_name(&self.quantity)?;
        let owner = MachineIdentity::from_machine(&machine);
        let constants =
            learnable_constants::learnable_constants(&machine, quantity, self.air.as_deref());
        let is_same = self.machine.is_same_as(&owner) && constants == self.constants;
        is_same.then(|| apply_values_to_source(source, &machine, quantity, self))?
    }

    /// Returns the values of the constants as they are applied, in their order and unit; `None` for one that is held at the
    /// file's own until something happens to it.
    #[must_use]
    pub fn applied_constant_values(&self) -> Vec<Option<f64>> {
        let shares = self.constants.iter().zip(&self.applied[1..]);
        let value = |(constant, share): (&LearnableConstant, &f64)| {
            let share_own = share / slope_growth_factor(self, constant);
            let is_held = constant.is_held() && *share == 0.0;
            (!is_held).then_some(constant.believed * (1.0 + share_own))
        };
        shares.map(value).collect()
    }
}
