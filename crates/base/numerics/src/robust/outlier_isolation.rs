//! Rows that stand alone, not a range of the input in which the law is another one.

use super::Outlier;

/// Neighbours on either side that are looked at.
const NEIGHBOURS_PER_SIDE: usize = 3;

/// Returns those of `found` that stand alone among the rows whose `x` is near theirs: where half of these are
/// off too, the relation is another one there, and no row of it is a gross error. Rows whose `y` is NaN are
/// no neighbours.
#[must_use]
pub fn retain_isolated_outliers(mut found: Vec<Outlier>, x: &[f64], y: &[f64]) -> Vec<Outlier> {
    let mut is_found = vec![false; y.len()];
    found.iter().for_each(|outlier| is_found[outlier.row] = true);
    let mut by_x: Vec<usize> = (0..y.len()).filter(|row| !y[*row].is_nan()).collect();
    by_x.sort_by(|a, b| x[*a].total_cmp(&x[*b]));
    let mut is_alone = vec![false; y.len()];
    for (at, row) in by_x.iter().enumerate().filter(|(_, row)| is_found[**row]) {
        let near =
            at.saturating_sub(NEIGHBOURS_PER_SIDE)..(at + NEIGHBOURS_PER_SIDE + 1).min(by_x.len());
        let others = near.filter(|other| *other != at && is_found[by_x[*other]]);
        is_alone[*row] = others.count() < NEIGHBOURS_PER_SIDE;
    }
    found.retain(|outlier| is_alone[outlier.row]);
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_range_of_the_input_is_kept_and_a_single_row_is_not() {
        let x: Vec<f64> = (0..20).map(f64::from).collect();
        let y = vec![0.0; 20];
        let found = |rows: &[usize]| -> Vec<Outlier> {
            let of = |&row: &usize| Outlier { row, distance: 9.0, scales: 9.0 };
            rows.iter().map(of).collect()
        };
        let rows =
            |found: Vec<Outlier>| found.iter().map(|outlier| outlier.row).collect::<Vec<_>>();
        assert_eq!(rows(retain_isolated_outliers(found(&[2, 15, 16, 17, 18, 19]), &x, &y)), [2]);
        assert_eq!(rows(retain_isolated_outliers(found(&[4, 5, 11]), &x, &y)), [4, 5, 11]);
    }
}
