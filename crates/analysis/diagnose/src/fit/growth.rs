//! The machine's own law of its growth in groups, where it is a factor times a temperature, and what multiplies it: the
//! mean of what they say is what they say of the mean. Only another lag is a reason to go through all rows again.

use std::{collections::VecDeque, sync::Arc};

use trueup_machine::effect::Late;

use crate::{
    data::{Data, Groups},
    laws::Growth,
};

/// How late the thermometer is, and behind which lags, in s.
type Asked = (Option<Late>, [f64; 2]);

/// Cache of the growth that was worked out before, in groups.
#[derive(Debug, Default)]
pub(super) struct Grown {
    still: Option<Arc<Still>>,
    /// The temperature, as much of it as of the elongation is in the quantity, the newest last.
    warm: VecDeque<(Asked, Arc<Vec<f64>>)>,
}

/// The quantities that no value of a model changes, in groups.
#[derive(Debug)]
pub(super) struct Still {
    /// How much of the elongation is in the quantity.
    pub along: Vec<f64>,
    /// The growth by the law of the machine file, as much of it as is in the quantity, and the axis's error, in µm.
    pub law_um: Vec<f64>,
    axis_um: Vec<f64>,
}

impl Still {
    /// This growth, as much of it as is in the quantity, with all that stands.
    pub(super) fn and(&self, grown_um: impl Iterator<Item = f64>, data: &Data) -> Vec<f64> {
        let [of_elongation_um, of_axis_um] = data.constants_um;
        let rows = grown_um.zip(&self.along).zip(&self.axis_um);
        rows.map(|((grown, along), axis)| grown + of_elongation_um * along + axis + of_axis_um)
            .collect()
    }
}

impl Grown {
    /// Numbers that are kept at most, 8 bytes each: 4 MB.
    const MAX_NUMBERS: usize = 500_000;

    pub(super) fn still(&mut self, data: &Data, groups: &Groups) -> Arc<Still> {
        let make = || {
            Arc::new(Still {
                along: groups.means(&data.along),
                law_um: in_quantity(&data.law, data, groups),
                axis_um: groups.means(&data.axis),
            })
        };
        self.still.get_or_insert_with(make).clone()
    }

    pub(super) fn known(&self, growth: &Growth<'_>) -> Option<Arc<Vec<f64>>> {
        let asked = (growth.late, growth.lags_s);
        let found = self.warm.iter().rev().find(|(there, _)| *there == asked);
        found.map(|(_, warm)| warm.clone())
    }

    pub(super) fn put(&mut self, growth: &Growth<'_>, warm: &Arc<Vec<f64>>) {
        self.warm.push_back(((growth.late, growth.lags_s), warm.clone()));
        if self.warm.len() * warm.len() > Self::MAX_NUMBERS {
            self.warm.pop_front();
        }
    }
}

/// Returns the temperature of `growth` in groups, as much of it as of the elongation is in the quantity.
pub(super) fn warm(growth: &Growth<'_>, data: &Data, groups: &Groups) -> Vec<f64> {
    in_quantity(&growth.behind_c(data), data, groups)
}

/// As much of a column of the elongation as is in the quantity, in groups.
fn in_quantity(values: &[f64], data: &Data, groups: &Groups) -> Vec<f64> {
    if data.along.iter().all(|&along| along == 1.0) {
        return groups.means(values);
    }
    let of = |(value, &along): (&f64, &f64)| if along == 0.0 { 0.0 } else { value * along };
    groups.means(&values.iter().zip(data.along.iter()).map(of).collect::<Vec<f64>>())
}
