//! The slopes of one axis along another, and the order of the pairs of axes on the board.

use trueup_core::{calibration::STRAIGHTNESS_AXIS_PAIRS, cnc, gradient::Gradient};

use crate::{
    sections::{LinearAxis, Squareness},
    unit_conversion::{GRADIENT_UNITS_PER_UM_PER_M, NM_PER_UM, round_to_i32, to_user_value},
};

/// Returns the place of a pair of axes in the board's order.
pub(super) fn axis_pair_index(error: LinearAxis, along: LinearAxis) -> usize {
    let pair = (error.index(), along.index());
    STRAIGHTNESS_AXIS_PAIRS
        .iter()
        .position(|(of, over)| (*of as usize, *over as usize) == pair)
        .expect("two different axes are one of the six pairs")
}

/// Returns the axis on the board.
pub(super) fn linear_axis_to_board(axis: LinearAxis) -> cnc::LinearAxis {
    cnc::LinearAxis::ALL[axis.index()]
}

/// Returns the board's axis in the machine file.
pub(super) fn linear_axis_from_board(axis: cnc::LinearAxis) -> LinearAxis {
    LinearAxis::ALL[axis as usize]
}

/// Returns the pairs in the board's order, each the axis in error and the one that moves.
pub(super) fn axis_pairs() -> [(LinearAxis, LinearAxis); 6] {
    STRAIGHTNESS_AXIS_PAIRS
        .map(|(error, along)| (linear_axis_from_board(error), linear_axis_from_board(along)))
}

/// Returns a squareness, and its largest difference from the model in nm over 15 m.
pub(super) fn compile_squareness(um_per_m: f64) -> Result<(Gradient, f64), String> {
    const MAX_CHECKED_TRAVEL_M: f64 = 15.0;
    let exact = um_per_m * GRADIENT_UNITS_PER_UM_PER_M;
    let gradient = round_to_i32(exact)
        .ok_or_else(|| format!("{um_per_m} is beyond the board's ±3125 µm/m"))?;
    let difference = (f64::from(gradient) - exact) / GRADIENT_UNITS_PER_UM_PER_M;
    Ok((Gradient(gradient), difference.abs() * MAX_CHECKED_TRAVEL_M * NM_PER_UM))
}

/// Returns the slopes that are not 0, as a user writes them.
pub(super) fn decompile(gradients: &[Gradient; 6]) -> Vec<Squareness> {
    let slope = |((error, along), gradient): (_, &Gradient)| Squareness {
        error,
        along,
        um_per_m: to_user_value(gradient.0, GRADIENT_UNITS_PER_UM_PER_M),
    };
    let all = axis_pairs().into_iter().zip(gradients);
    all.filter(|(_, gradient)| **gradient != Gradient::ZERO).map(slope).collect()
}
