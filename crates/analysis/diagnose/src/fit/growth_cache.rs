//! The machine's own law of its growth in groups, where it is a factor times a temperature, and what multiplies it: the
//! mean of what they say is what they say of the mean. Only another lag is a reason to go through all rows again.

use std::{collections::VecDeque, sync::Arc};

use trueup_machine::effect::ThermometerDelay;

use crate::{
    data::{DataTable, RowGroups},
    machine_laws::ThermalGrowth,
};

/// How late the thermometer is, and behind which lags, in s.
type GrowthKey = (Option<ThermometerDelay>, [f64; 2]);

/// Cache of the growth that was worked out before, in groups.
#[derive(Debug, Default)]
pub(super) struct GrowthCache {
    still: Option<Arc<InvariantColumns>>,
    /// The temperature, as much of it as of the elongation is in the quantity, the newest last.
    warm: VecDeque<(GrowthKey, Arc<Vec<f64>>)>,
}

/// The quantities that no value of a model changes, in groups.
#[derive(Debug)]
pub(super) struct InvariantColumns {
    /// How much of the elongation is in the quantity.
    pub along: Vec<f64>,
    /// The growth by the law of the machine file, as much of it as is in the quantity, and the axis's error, in µm.
    pub law_um: Vec<f64>,
    axis_um: Vec<f64>,
}

impl InvariantColumns {
    /// This growth, as much of it as is in the quantity, with all that stands.
    pub(super) fn prediction_with_growth(
        &self,
        grown_um: impl Iterator<Item = f64>,
        data: &DataTable,
    ) -> Vec<f64> {
        let [of_elongation_um, of_axis_um] = data.setting.constants_um;
        let rows = grown_um.zip(&self.along).zip(&self.axis_um);
        rows.map(|((grown, along), axis)| grown + of_elongation_um * along + axis + of_axis_um)
            .collect()
    }
}

impl GrowthCache {
    /// Numbers that are kept at most, 8 bytes each: 4 MB.
    const MAX_CACHED_VALUES: usize = 500_000;

    pub(super) fn invariant_columns(
        &mut self,
        data: &DataTable,
        groups: &RowGroups,
    ) -> Arc<InvariantColumns> {
        let make = || {
            Arc::new(InvariantColumns {
                along: groups.means(&data.predicted.along),
                law_um: project_elongation_to_quantity(&data.predicted.law, data, groups),
                axis_um: groups.means(&data.predicted.axis),
            })
        };
        self.still.get_or_insert_with(make).clone()
    }

    pub(super) fn cached_projected_temperature(
        &self,
        growth: &ThermalGrowth<'_>,
    ) -> Option<Arc<Vec<f64>>> {
        let asked = (growth.late, growth.lags_s);
        let found = self.warm.iter().rev().find(|(there, _)| *there == asked);
        found.map(|(_, warm)| warm.clone())
    }

    pub(super) fn insert(&mut self, growth: &ThermalGrowth<'_>, warm: &Arc<Vec<f64>>) {
        self.warm.push_back(((growth.late, growth.lags_s), warm.clone()));
        if self.warm.len() * warm.len() > Self::MAX_CACHED_VALUES {
            self.warm.pop_front();
        }
    }
}

/// Returns the temperature of `growth` in groups, as much of it as of the elongation is in the quantity.
pub(super) fn projected_temperature_by_group(
    growth: &ThermalGrowth<'_>,
    data: &DataTable,
    groups: &RowGroups,
) -> Vec<f64> {
    project_elongation_to_quantity(&growth.lagged_temperature_c(data), data, groups)
}

/// As much of a column of the elongation as is in the quantity, in groups.
fn project_elongation_to_quantity(
    values: &[f64],
    data: &DataTable,
    groups: &RowGroups,
) -> Vec<f64> {
    if data.predicted.along.iter().all(|&along| along == 1.0) {
        return groups.means(values);
    }
    let of = |(value, &along): (&f64, &f64)| if along == 0.0 { 0.0 } else { value * along };
    groups.means(&values.iter().zip(data.predicted.along.iter()).map(of).collect::<Vec<f64>>())
}
