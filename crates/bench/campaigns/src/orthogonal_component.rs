//! The part of an effect that other effects cannot imitate.

/// Computes the RMS of the part of `of` that no linear combination of the `others` and a constant has, over the same rows,
/// in their unit.
pub(crate) fn orthogonal_component_rms(of: &[f64], others: &[&[f64]]) -> f64 {
    let mut basis = vec![vec![1.0; of.len()]];
    for other in others {
        let left = project_out(other, &basis);
        // One that the ones before it can do as well brings nothing, and has no direction.
        if dot(&left, &left) > 1e-12 * dot(other, other) {
            basis.push(left);
        }
    }
    let left = project_out(of, &basis);
    (dot(&left, &left) / left.len() as f64).sqrt()
}

/// Returns what is left of `um` next to columns that are at right angles to each other.
fn project_out(um: &[f64], basis: &[Vec<f64>]) -> Vec<f64> {
    let mut left = um.to_vec();
    for column in basis {
        let share = dot(&left, column) / dot(column, column);
        left.iter_mut().zip(column).for_each(|(left, value)| *left -= share * value);
    }
    left
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}
