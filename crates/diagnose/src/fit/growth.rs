//! The machine's own law of its growth in groups, where it is a factor times a temperature: the mean of what it says is
//! what it says of the mean. Only another lag is a reason to go through all rows again.

use std::{collections::VecDeque, sync::Arc};

use trueup_machine::effect::Late;

use crate::{
    data::{Data, Groups},
    laws::Growth,
};

/// How late the thermometer is, and behind which lags, in s.
type Asked = (Option<Late>, [f64; 2]);

/// What was worked out before, in groups.
#[derive(Debug, Default)]
pub(super) struct Grown {
    /// How much of the elongation is in the quantity, and the axis's error, in µm.
    still: Option<Arc<[Vec<f64>; 2]>>,
    /// The temperature, as much of it as of the elongation is in the quantity, the newest last.
    warm: VecDeque<(Asked, Arc<Vec<f64>>)>,
}

impl Grown {
    /// Numbers that are kept at most, 8 bytes each: 4 MB.
    const MOST_NUMBERS: usize = 500_000;

    pub(super) fn still(&mut self, data: &Data, groups: &Groups) -> Arc<[Vec<f64>; 2]> {
        let make = || [groups.means(&data.along), groups.means(&data.axis)].into();
        self.still.get_or_insert_with(make).clone()
    }

    pub(super) fn known(&self, growth: &Growth<'_>) -> Option<Arc<Vec<f64>>> {
        let asked = (growth.late, growth.lags_s);
        let found = self.warm.iter().rev().find(|(there, _)| *there == asked);
        found.map(|(_, warm)| warm.clone())
    }

    pub(super) fn put(&mut self, growth: &Growth<'_>, warm: &Arc<Vec<f64>>) {
        self.warm.push_back(((growth.late, growth.lags_s), warm.clone()));
        if self.warm.len() * warm.len() > Self::MOST_NUMBERS {
            self.warm.pop_front();
        }
    }
}

/// The temperature of `growth` in groups, as much of it as of the elongation is in the quantity.
pub(super) fn warm(growth: &Growth<'_>, data: &Data, groups: &Groups) -> Vec<f64> {
    let behind_c = growth.behind_c(data);
    if data.along.iter().all(|&along| along == 1.0) {
        return groups.means(&behind_c);
    }
    let of = |(c, &along): (&f64, &f64)| if along == 0.0 { 0.0 } else { c * along };
    groups.means(&behind_c.iter().zip(data.along.iter()).map(of).collect::<Vec<f64>>())
}

/// What the law says, and the constants of the machine file's terms.
pub(super) fn predicted(
    growth: &Growth<'_>,
    warm: &[f64],
    [along, axis]: &[Vec<f64>; 2],
    [of_elongation_um, of_axis_um]: [f64; 2],
) -> Vec<f64> {
    let (factor, reference_c) = (growth.model.k_um_per_c, growth.model.reference_c);
    let rows = warm.iter().zip(along).zip(axis);
    rows.map(|((warm, along), axis)| {
        factor * (warm - reference_c * along) + of_elongation_um * along + axis + of_axis_um
    })
    .collect()
}
