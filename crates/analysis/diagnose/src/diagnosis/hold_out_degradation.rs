//! Where on a hold-out a model is worse, and what is different there from the runs.

use crate::{
    columns::column_by_name,
    data::{DataTable, forward_fill},
    diagnosis::{
        held_out_errors::{EXTRAPOLATION_MARGIN_FRACTION, input_columns},
        hold_out::HoldOut,
        value_range::{largest_rise, min_max},
    },
};

/// Returns the stretch in which `worse` (µm² of each row) is the most, and the columns that do there what they never
/// did in the runs: a sentence each.
pub(super) fn describe_worst_interval(
    training: &DataTable,
    hold_out: &HoldOut<'_>,
    worse: &[f64],
) -> Vec<String> {
    let Some((first, last)) = max_subarray(worse) else { return Vec::new() };
    let mut sentences = describe_inputs_outside_training(training, hold_out, worse);
    if sentences.is_empty() {
        let stretch = format_row_range(&hold_out.data, hold_out, first, last);
        sentences.push(format!("{stretch} it is worst"));
    }
    sentences
}

/// Returns the columns that do in the worst stretch what they never did in the runs: a sentence each, none where they
/// do nothing new.
pub(super) fn describe_inputs_outside_training(
    training: &DataTable,
    hold_out: &HoldOut<'_>,
    worse: &[f64],
) -> Vec<String> {
    let test = &hold_out.data;
    let Some((first, last)) = max_subarray(worse) else { return Vec::new() };
    let stretch = format_row_range(test, hold_out, first, last);
    input_columns(training)
        .filter_map(|column| {
            let [runs, here] = [training, test].map(|data| column_by_name(data, &column));
            describe_input_outside_training(
                &column,
                &forward_fill(runs?),
                &forward_fill(here?),
                first,
                last,
            )
        })
        .map(|what| format!("{stretch} {what}"))
        .collect()
}

/// Returns what `after` leaves more of the squares than `share` of what `before` leaves, in each row of `test`, in µm².
pub(super) fn excess_squared_errors(
    test: &DataTable,
    [before, after]: [&[f64]; 2],
    share: f64,
) -> Vec<f64> {
    (0..test.rows)
        .map(|row| {
            let [before, after] =
                [before, after].map(|predicted| (test.measured[row] - predicted[row]).powi(2));
            let is_known = test.used[row] && (after - before).is_finite();
            if is_known { after - share * before } else { 0.0 }
        })
        .collect()
}

/// Returns the rows of the stretch, as the user counts them.
fn format_row_range(test: &DataTable, hold_out: &HoldOut<'_>, first: usize, last: usize) -> String {
    let end = test.places.file.partition_point(|&there| there <= test.places.file[first]);
    let (row, name) = locate_row_in_file(test, hold_out, first);
    if last + 1 >= end {
        format!("from row {row} of {name} on,")
    } else {
        format!("in rows {row} to {} of {name}", row + last - first)
    }
}

/// Returns the number of a row in its file, as the user counts it, and the name of the file.
pub(super) fn locate_row_in_file(
    test: &DataTable,
    hold_out: &HoldOut<'_>,
    row: usize,
) -> (usize, String) {
    let file = test.places.file[row];
    let start = test.places.file.partition_point(|&there| there < file);
    let path = hold_out.files[file as usize].path();
    (row - start + 1, path.file_name().unwrap_or(path.as_os_str()).display().to_string())
}

/// Returns what `column` does `here`, in the rows `first` to `last`, and nowhere in the `runs`.
fn describe_input_outside_training(
    column: &str,
    runs: &[f64],
    here: &[f64],
    first: usize,
    last: usize,
) -> Option<String> {
    let stretch = &here[first..=last];
    let ([low, high], [here_low, here_high]) =
        (min_max(runs.iter().copied()), min_max(stretch.iter().copied()));
    let margin = EXTRAPOLATION_MARGIN_FRACTION * (high - low);
    if here_high > high + margin {
        return Some(format!(
            "{column} reaches {here_high:.2}; in the runs {high:.2} was the most"
        ));
    }
    if here_low < low - margin {
        return Some(format!("{column} reaches {here_low:.2}; in the runs {low:.2} was the least"));
    }
    let change = stretch[stretch.len() - 1] - stretch[0];
    let (verb, never, most) = if change < 0.0 {
        ("falls", "fell", largest_rise(runs.iter().map(|value| -value)))
    } else {
        ("rises", "rose", largest_rise(runs.iter().copied()))
    };
    (change.abs() > margin && most < margin).then(|| {
        format!(
            "{column} {verb} by {:.2}; in the runs it never {never} by more than {most:.2}",
            change.abs()
        )
    })
}

/// Returns the first and last of the consecutive values whose sum is the largest; none where no value is above
/// 0.
fn max_subarray(values: &[f64]) -> Option<(usize, usize)> {
    let mut best = (0.0, None);
    let (mut sum, mut first) = (0.0, 0);
    for (at, value) in values.iter().enumerate() {
        if sum <= 0.0 {
            (sum, first) = (0.0, at);
        }
        sum += value;
        if sum > best.0 {
            best = (sum, Some((first, at)));
        }
    }
    best.1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_worst_stretch_is_the_consecutive_rows_of_the_largest_sum() {
        assert_eq!(max_subarray(&[-1.0, 2.0, -0.5, 3.0, -4.0, 1.0]), Some((1, 3)));
        assert_eq!(max_subarray(&[-1.0, 0.0]), None);
    }

    #[test]
    fn a_cool_down_after_runs_that_only_warmed_is_told() {
        let runs: Vec<f64> = (0..50).map(|n| 20.0 + 0.5 * f64::from(n)).collect();
        let here: Vec<f64> = runs.iter().rev().copied().collect();
        let description = describe_input_outside_training("temp_frame_c", &runs, &here, 10, 49)
            .expect("it falls");
        assert_eq!(
            description,
            "temp_frame_c falls by 19.50; in the runs it never fell by more than 0.00"
        );
        assert_eq!(describe_input_outside_training("temp_frame_c", &here, &here, 10, 49), None);
    }

    #[test]
    fn a_column_beyond_what_the_runs_covered_is_told() {
        let runs = [20.0, 30.0, 20.0];
        assert_eq!(describe_input_outside_training("t", &runs, &[30.5, 25.0], 0, 1), None);
        let description =
            describe_input_outside_training("t", &runs, &[35.0, 30.0], 0, 1).expect("it is beyond");
        assert_eq!(description, "t reaches 35.00; in the runs 30.00 was the most");
    }
}
