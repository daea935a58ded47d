//! The linear equations: each reading is the sum of constants and of unknowns of its set-up.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector};
use trueup_machine::Machine;

use super::{
    error_parameters::ErrorParameters,
    kinematics::ForwardKinematics,
    nuisance_parameters::{NuisanceParameter, SetupCentroids, nuisance_sensitivities},
    reading::{ReadingKind, VolumeReading, dot},
};

/// The columns of all readings.
#[derive(Clone, Debug)]
pub struct DesignMatrix {
    /// The constants of the machine: the first columns.
    pub constants: ErrorParameters,
    /// The unknowns of the set-ups: the columns after them.
    pub nuisances: Vec<NuisanceParameter>,
    /// A row for each reading.
    pub rows: Vec<Vec<f64>>,
}

impl DesignMatrix {
    /// Returns the equations of `readings` with these constants.
    ///
    /// # Panics
    /// The machine has no chain.
    #[must_use]
    pub fn new(machine: &Machine, constants: ErrorParameters, readings: &[VolumeReading]) -> Self {
        let chain = machine.volume.chain.as_ref().expect("was checked");
        let frame = ForwardKinematics::new(machine, chain);
        let centres = SetupCentroids::from_readings(readings, &frame);
        let of_rows: Vec<Vec<(NuisanceParameter, f64)>> = readings
            .iter()
            .map(|reading| nuisance_sensitivities(reading, &frame, &centres))
            .collect();
        let mut numbers: BTreeMap<NuisanceParameter, usize> = BTreeMap::new();
        for (nuisance, _) in of_rows.iter().flatten() {
            numbers.insert(*nuisance, 0);
        }
        let own = constants.all.len();
        numbers.values_mut().enumerate().for_each(|(n, number)| *number = own + n);
        let rows = readings.iter().zip(of_rows).map(|(reading, nuisance_sensitivities)| {
            let moved = constants.tip_sensitivities(&reading.pose);
            let mut row: Vec<f64> = moved.into_iter().map(|um| dot(um, reading.toward)).collect();
            row.resize(own + numbers.len(), 0.0);
            for (nuisance, by) in nuisance_sensitivities {
                row[numbers[&nuisance]] += by;
            }
            row
        });
        let rows = rows.collect();
        Self { constants, nuisances: numbers.into_keys().collect(), rows }
    }

    /// Returns the number of columns.
    #[must_use]
    pub(crate) fn column_count(&self) -> usize {
        self.constants.all.len() + self.nuisances.len()
    }
}

/// Normal equations of the readings of one kind.
#[derive(Clone, Debug)]
pub struct NormalEquations {
    /// XᵀX.
    pub squares: DMatrix<f64>,
    /// Xᵀy.
    pub products: DVector<f64>,
    /// yᵀy.
    pub whole: f64,
    /// Readings.
    pub count: usize,
}

/// Normal equations, one for each kind of reading.
pub type NormalEquationsByKind = [NormalEquations; 4];

/// Returns the normal equations of those readings for which `is_in` holds.
#[must_use]
pub(crate) fn normal_equations(
    design: &DesignMatrix,
    readings: &[VolumeReading],
    is_in: impl Fn(usize) -> bool,
) -> NormalEquationsByKind {
    let columns = design.column_count();
    ReadingKind::ALL.map(|kind| {
        let own: Vec<usize> =
            (0..readings.len()).filter(|n| readings[*n].kind == kind && is_in(*n)).collect();
        let x = DMatrix::from_fn(own.len(), columns, |row, column| design.rows[own[row]][column]);
        let y = DVector::from_iterator(own.len(), own.iter().map(|n| readings[*n].um));
        NormalEquations {
            squares: x.tr_mul(&x),
            products: x.tr_mul(&y),
            whole: y.norm_squared(),
            count: own.len(),
        }
    })
}
