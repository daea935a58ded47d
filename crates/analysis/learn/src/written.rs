//! The numbers of a machine file with what was learned.

use trueup_machine::{Machine, MachineFile, file::Quantity};

use crate::{
    constants::{self, Constant},
    memory::{Memory, Owner},
};

/// A constant that has moved by less than this share of itself is written as it was.
pub(crate) const SAME: f64 = 1e-3;

/// Returns the numbers of the machine file with what is applied: of the zero, of each constant.
pub(crate) fn figures(memory: &Memory, machine: &Machine, quantity: Quantity) -> Vec<f64> {
    let zero = match constants::zero(machine, quantity) {
        Some((_, from, per_um)) if memory.applied[0].abs() > 0.01 => {
            // A growth of k·(1 + x) moves its reference by as much less.
            let grown = memory.constants.iter().position(|it| it.key.ends_with("k_um_per_c"));
            let grown = grown.map_or(1.0, |index| 1.0 + memory.applied[index + 1]);
            let per_um = if per_um < 0.0 { per_um / grown } else { per_um };
            digits(from + per_um * memory.applied[0])
        }
        Some((_, from, _)) => from,
        None => 0.0,
    };
    let shares = memory.constants.iter().zip(&memory.applied[1..]);
    let constants = shares.map(|(constant, share)| {
        let believed = constant.believed;
        let share = share / grown_of(memory, constant);
        if share.abs() > SAME { digits(believed * (1.0 + share)) } else { believed }
    });
    std::iter::once(zero).chain(constants).collect()
}

/// Returns by how much the slope of a reference has grown, as a factor: it moves its reference by as much less. 1 for the rest.
fn grown_of(memory: &Memory, constant: &Constant) -> f64 {
    let Some(axis) = constant.key.strip_suffix("reference_c").filter(|_| constant.is_reference())
    else {
        return 1.0;
    };
    let slope = format!("{axis}slope_um_per_m_per_c");
    let place = memory.constants.iter().position(|it| it.key == slope);
    place.map_or(1.0, |index| 1.0 + memory.applied[index + 1])
}

/// Returns the user's file with what is applied.
pub(crate) fn written(
    source: &str,
    machine: &Machine,
    quantity: Quantity,
    memory: &Memory,
) -> Option<String> {
    let all = figures(memory, machine, quantity);
    let constants = memory.constants.iter().zip(&all[1..]);
    let mut changed: Vec<(String, f64)> = constants
        .filter(|(constant, value)| constant.believed != **value)
        .map(|(constant, value)| (constant.key.clone(), *value))
        .collect();
    if let Some((key, from, _)) = constants::zero(machine, quantity)
        && all[0] != from
    {
        changed.push((key.into(), all[0]));
    }
    constants::with(source, &changed)
}

/// Six digits: a hundredth of what any of them is known to.
fn digits(number: f64) -> f64 {
    format!("{number:.5e}").parse().unwrap_or(number)
}

impl Memory {
    /// Returns the user's own machine file `source` with what is applied; `None` where it is another machine's, or its
    /// constants are others.
    #[must_use]
    pub fn applied_to(&self, source: &str, path: &std::path::Path) -> Option<String> {
        let machine = MachineFile::parse(source, path).ok()?;
        let quantity = constants::named(&self.quantity)?;
        let owner = Owner::of(&machine);
        let constants = constants::constants(&machine, quantity, self.air.as_deref());
        let is_same = self.machine.is(&owner) && constants == self.constants;
        is_same.then(|| written(source, &machine, quantity, self))?
    }

    /// Returns the values of the constants as they are applied, in their order and unit; `None` for one that is held at the
    /// file's own until something happens to it.
    #[must_use]
    pub fn values(&self) -> Vec<Option<f64>> {
        let shares = self.constants.iter().zip(&self.applied[1..]);
        let value = |(constant, share): (&Constant, &f64)| {
            let share_own = share / grown_of(self, constant);
            let is_held = constant.is_held() && *share == 0.0;
            (!is_held).then_some(constant.believed * (1.0 + share_own))
        };
        shares.map(value).collect()
    }
}
