use super::*;

/// Noise of −1…1 that repeats exactly, by a multiplier of a power of two.
fn noise(row: usize) -> f64 {
    let mixed = (row as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    let mixed = (mixed ^ (mixed >> 29)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    (mixed >> 40) as f64 / (1_u64 << 23) as f64 - 1.0
}

/// Returns a spindle's thermometer, a row a second: warmed for half an hour and cooled, with noise of this
/// amplitude, to this last digit.
fn thermometer(rows: usize, noise_c: f64, digit_c: f64) -> Vec<f64> {
    let mut celsius = 22.0;
    let value = |row: usize| {
        let goal = if row % 3600 < 1800 { 45.0 } else { 22.0 };
        celsius += (goal - celsius) / 900.0;
        ((celsius + noise_c * noise(row)) / digit_c).round() * digit_c
    };
    (0..rows).map(value).collect()
}

fn found(values: &[f64]) -> Vec<ThermometerFault> {
    let mut follows = vec![true; values.len()];
    follows[0] = false;
    find_thermometer_faults(values, &follows, &follows)
}

#[test]
fn a_sound_thermometer_of_any_noise_and_digit_is_left_alone() {
    for noise_c in [0.0, 0.005, 0.02, 0.1, 0.5] {
        for digit_c in [0.001, 0.01, 1.0 / 16.0, 0.1, 1.0] {
            let values = thermometer(12_000, noise_c, digit_c);
            assert_eq!(found(&values), [], "{noise_c} {digit_c}");
            assert_eq!(found(&values[..500]), [], "{noise_c} {digit_c}, short");
        }
    }
}

#[test]
fn a_reading_that_is_written_down_again_and_again_is_not_frozen() {
    let slow = thermometer(12_000, 0.1, 0.01);
    let held: Vec<f64> = (0..12_000).map(|row| slow[row / 20 * 20]).collect();
    assert_eq!(found(&held), []);
}

#[test]
fn a_set_value_and_one_that_follows_a_step_by_its_own_lag_are_no_faults() {
    let set: Vec<f64> = (0..4_000).map(|row| [20.0, 60.0, 90.0][row / 1_500]).collect();
    assert_eq!(found(&set), []);
    let mut celsius = 20.0;
    let followed = (0..4_000).map(|row| {
        celsius += (if row < 2_000 { 20.0 } else { 60.0 } - celsius) / 2.0;
        celsius + 0.02 * noise(row)
    });
    assert_eq!(found(&followed.collect::<Vec<f64>>()), []);
}

#[test]
fn a_step_over_a_pause_is_none() {
    let mut values = thermometer(2_000, 0.02, 0.01);
    values[1_000..].iter_mut().for_each(|value| *value -= 15.0);
    let mut follows = vec![true; 2_000];
    (follows[0], follows[1_000]) = (false, false);
    assert_eq!(find_thermometer_faults(&values, &follows, &follows), []);
    assert_eq!(found(&values).len(), 1);
}

#[test]
fn four_thousand_frozen_rows_are_found_where_they_are() {
    for (noise_c, digit_c) in [(0.02, 0.001), (0.05, 1.0 / 16.0), (0.1, 0.1)] {
        let mut values = thermometer(12_000, noise_c, digit_c);
        let shown = values[5_000];
        values[5_000..9_000].fill(shown);
        let Some(ThermometerFault::Frozen { rows, .. }) = found(&values).pop() else {
            panic!("{noise_c} {digit_c}: {:?}", found(&values))
        };
        assert!(rows.start.abs_diff(5_000) < 20 && rows.end.abs_diff(9_000) < 20, "{rows:?}");
    }
    // Without any noise only the step tells it.
    let mut values = thermometer(12_000, 0.0, 0.01);
    let shown = values[1_000];
    values[1_000..5_000].fill(shown);
    assert!(
        matches!(found(&values)[..], [ThermometerFault::Frozen { .. }]),
        "{:?}",
        found(&values)
    );
}

#[test]
fn an_absent_one_is_found_wherever_it_shows_itself() {
    for shown in [-180.0, -273.15, 850.0, 0.0, -3.0] {
        let mut values = thermometer(5_000, 0.02, 0.01);
        values[700..1_900].fill(shown);
        (values[2_500], values[2_700], values[4_999]) = (shown, shown, shown);
        values[4_998] = shown;
        let faults = found(&values);
        let [ThermometerFault::Absent { shown: value, rows }] = &faults[..] else {
            panic!("{faults:?}")
        };
        assert_eq!(*value, shown);
        assert_eq!(rows[..], [700..1_900, 2_500..2_501, 2_700..2_701, 4_998..5_000]);
    }
}

#[test]
fn a_jump_is_found_and_one_back_too() {
    let mut values = thermometer(5_000, 0.02, 0.01);
    values[2_200..].iter_mut().for_each(|value| *value += 3.0);
    let faults = found(&values);
    assert!(
        matches!(faults[..], [ThermometerFault::Jump { by, row: 2_200 }] if (by - 3.0).abs() < 0.1)
    );
    values[4_000..].iter_mut().for_each(|value| *value -= 3.0);
    assert_eq!(found(&values).len(), 2);
}

#[test]
fn what_is_between_absent_values_is_no_fault() {
    let mut values = thermometer(3_000, 0.0, 0.01);
    (0..3_000).step_by(37).for_each(|row| values[row] = -180.0);
    values[5] = -180.0;
    let faults = found(&values);
    let [ThermometerFault::Absent { shown, rows }] = &faults[..] else { panic!("{faults:?}") };
    assert_eq!((*shown, rows.len()), (-180.0, 83), "{rows:?}");
}

#[test]
fn what_a_converter_sends_for_a_fault_is_absent_in_a_short_record_too() {
    let sound = [20.1, 20.4, 20.9, 21.2, 21.8, 22.3, 22.5, 23.0];
    for (row, shown) in [(0, 85.0), (3, 85.0), (3, -127.0), (7, -127.0), (5, -242.02), (2, 988.79)]
    {
        let mut values = sound.to_vec();
        values[row] = shown;
        assert_eq!(
            found(&values),
            [ThermometerFault::Absent { shown, rows: std::iter::once(row..row + 1).collect() }],
            "{row} {shown}"
        );
    }
    // Reached as heat reaches it, or over a pause, it is a temperature; so it is to the end of a record.
    for values in [
        vec![70.0, 75.0, 80.0, 85.0, 85.0, 85.0, 82.0, 78.0],
        vec![20.0, 20.0, 20.0, 85.0, 85.0, 85.0, 85.0, 85.0],
    ] {
        assert_eq!(found(&values), [], "{values:?}");
    }
    let values = [20.0, 20.1, 85.0, 85.0, 20.3, 20.2];
    let slow = [false; 6];
    assert_eq!(find_thermometer_faults(&values, &slow, &slow), []);
}
