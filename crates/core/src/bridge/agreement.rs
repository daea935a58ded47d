//! Does the calibration still fit? The first source of the elongation against the models behind it.
//!
//! Each has a zero of its own, so what is compared is how far they have grown since both were there for the
//! first time. They differ, where one is wrong, in proportion to the growth; so a model no longer fits if it is
//! off by more than half of the larger growth: then more than half of what it corrects is made up. Below
//! [`LEAST_NM`] nothing is said, and not before it has lasted for [`LASTS_STEPS`].

use crate::{calibration::ElongationSource, units::Nanometres};

/// The paper's own sensor law is off by 15.2 µm of 62.8 and is called sufficient.
pub const LEAST_NM: u32 = 15_000;
/// A minute, in steps of the heat: what lags by less is no fault of a calibration.
pub const LASTS_STEPS: u16 = 600;

/// What the sources said at a step of the heat.
#[derive(Clone, Copy, Debug)]
pub(super) struct Past {
    /// The elongation that was told.
    pub elongation: Nanometres,
    /// What each source by itself would have said, in the order of [`ElongationSource::ALL`]; `None`: nothing.
    pub raw: [Option<Nanometres>; 3],
}

/// Whether the sources grow alike.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Agreement {
    /// The first source and another one when both were there for the first time, by the other one.
    began: [Option<(Nanometres, Nanometres)>; 3],
    /// For how many steps they have not.
    off_steps: u16,
}

impl Agreement {
    /// A step of the heat, with what each source says; `first`: the one that the others are held against.
    pub fn step(&mut self, first: Option<ElongationSource>, past: &Past) {
        let of = |source: ElongationSource| past.raw.get(source as usize).copied().flatten();
        let first_now = first.and_then(of);
        let mut is_off = false;
        for (began, other) in self.began.iter_mut().zip(ElongationSource::ALL) {
            let (Some(now), Some(other_now)) = (first_now, of(other)) else {
                *began = None;
                continue;
            };
            let (then, other_then) = *began.get_or_insert((now, other_now));
            let grown = i64::from(now.0).wrapping_sub(then.0.into());
            let other_grown = i64::from(other_now.0).wrapping_sub(other_then.0.into());
            let off = grown.abs_diff(other_grown);
            let larger = grown.unsigned_abs().max(other_grown.unsigned_abs());
            is_off |= off > LEAST_NM.into() && off > larger / 2;
        }
        self.off_steps = if is_off { self.off_steps.saturating_add(1) } else { 0 };
    }

    /// Whether one of them no longer fits.
    pub const fn is_off(&self) -> bool {
        self.off_steps >= LASTS_STEPS
    }
}
