//! The linear equations: each reading is the sum of constants and of unknowns of its set-up.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector};
use trueup_machine::Machine;

use super::{
    constants::Constants,
    frame::Frame,
    reading::{Kind, Reading, dot},
    setup::{Centres, Nuisance, unknowns},
};

/// The columns of all readings.
#[derive(Clone, Debug)]
pub struct Design {
    /// The constants of the machine: the first columns.
    pub constants: Constants,
    /// The unknowns of the set-ups: the columns after them.
    pub nuisances: Vec<Nuisance>,
    /// A row for each reading.
    pub rows: Vec<Vec<f64>>,
}

impl Design {
    /// Returns the equations of `readings` with these constants.
    ///
    /// # Panics
    /// The machine has no chain.
    #[must_use]
    pub fn of(machine: &Machine, constants: Constants, readings: &[Reading]) -> Self {
        let chain = machine.volume.chain.as_ref().expect("was checked");
        let frame = Frame::of(machine, chain);
        let centres = Centres::of(readings, &frame);
        let of_rows: Vec<Vec<(Nuisance, f64)>> =
            readings.iter().map(|it| unknowns(it, &frame, &centres)).collect();
        let mut numbers: BTreeMap<Nuisance, usize> = BTreeMap::new();
        for (nuisance, _) in of_rows.iter().flatten() {
            numbers.insert(*nuisance, 0);
        }
        let own = constants.all.len();
        numbers.values_mut().enumerate().for_each(|(n, number)| *number = own + n);
        let rows = readings.iter().zip(of_rows).map(|(reading, unknowns)| {
            let moved = constants.at(&reading.pose);
            let mut row: Vec<f64> = moved.into_iter().map(|um| dot(um, reading.toward)).collect();
            row.resize(own + numbers.len(), 0.0);
            for (nuisance, by) in unknowns {
                row[numbers[&nuisance]] += by;
            }
            row
        });
        let rows = rows.collect();
        Self { constants, nuisances: numbers.into_keys().collect(), rows }
    }

    /// Returns the number of columns.
    #[must_use]
    pub fn columns(&self) -> usize {
        self.constants.all.len() + self.nuisances.len()
    }
}

/// Normal equations of the readings of one kind.
#[derive(Clone, Debug)]
pub struct Normal {
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
pub type Normals = [Normal; 4];

/// Returns the normal equations of those readings for which `is_in` holds.
#[must_use]
pub(crate) fn normals(
    design: &Design,
    readings: &[Reading],
    is_in: impl Fn(usize) -> bool,
) -> Normals {
    let columns = design.columns();
    Kind::ALL.map(|kind| {
        let own: Vec<usize> =
            (0..readings.len()).filter(|n| readings[*n].kind == kind && is_in(*n)).collect();
        let x = DMatrix::from_fn(own.len(), columns, |row, column| design.rows[own[row]][column]);
        let y = DVector::from_iterator(own.len(), own.iter().map(|n| readings[*n].um));
        Normal {
            squares: x.tr_mul(&x),
            products: x.tr_mul(&y),
            whole: y.norm_squared(),
            count: own.len(),
        }
    })
}
