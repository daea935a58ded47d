use super::{power::power, *};
use crate::random::RandomGenerator;

/// `cycles` there and back over `places` places: what `of` says of a place, a side and a cycle.
fn cycles_of(
    places: usize,
    cycles: usize,
    mut of: impl FnMut(usize, usize, usize) -> f64,
) -> Vec<RepeatReading> {
    let mut all = Vec::new();
    for cycle in 0..cycles {
        for side in [0, 1] {
            for n in 0..places {
                let place = if side == 0 { n } else { places - 1 - n };
                all.push(RepeatReading { place, side, cycle, value: of(place, side, cycle) });
            }
        }
    }
    all
}

/// Normal noise of the standard deviation 1.
fn noise(seed: u64) -> impl FnMut() -> f64 {
    let mut generator = RandomGenerator::new(seed);
    move || generator.normal()
}

const ALL: [TableLaw; 3] = [TableLaw::Table, TableLaw::TableAndStep, TableLaw::EachSide];

fn decided(readings: &[RepeatReading], places: usize) -> TableSelection {
    select_table(readings, &find_gross_errors(readings), places, &ALL)
}

#[test]
fn two_bad_readings_of_thirty_are_found_in_three_cycles_also_next_to_each_other() {
    let mut noise = noise(1);
    for at in 0..29 {
        let mut readings = cycles_of(5, 3, |place, side, _| 10.0 * (place * side) as f64 + noise());
        readings[at].value += 40.0;
        readings[at + 1].value += 90.0;
        let found: Vec<usize> = (0..30).filter(|&row| find_gross_errors(&readings)[row]).collect();
        assert_eq!(found, [at, at + 1]);
    }
}

#[test]
fn two_bad_readings_of_fifteen_are_found_where_three_cycles_went_one_way() {
    let mut noise = noise(4);
    for at in 0..14 {
        let mut readings = cycles_of(5, 3, |place, _, _| 10.0 * place as f64 + noise());
        readings.retain(|reading| reading.side == 0);
        readings[at].value += 40.0;
        readings[at + 1].value += 90.0;
        let found: Vec<usize> = (0..15).filter(|&row| find_gross_errors(&readings)[row]).collect();
        assert_eq!(found, [at, at + 1]);
    }
}

#[test]
fn a_sound_table_loses_a_reading_in_at_most_one_of_a_hundred() {
    let mut noise = noise(2);
    for cycles in [3, 5] {
        let lost = (0..1000)
            .filter(|_| find_gross_errors(&cycles_of(5, cycles, |_, _, _| noise())).contains(&true))
            .count();
        println!("{cycles} cycles: {lost} of 1000 sound tables lost a reading");
        assert!(lost <= 15, "{lost}");
    }
}

#[test]
fn a_cycle_that_is_warmer_than_the_others_is_no_row_of_gross_errors() {
    let mut noise = noise(3);
    let warm = cycles_of(9, 6, |_, _, cycle| (if cycle == 5 { 50.0 } else { 0.0 }) + noise());
    assert!(!find_gross_errors(&warm).contains(&true));
    // From the middle of it on as well, but for its first reading.
    let readings = cycles_of(9, 6, |place, side, cycle| {
        (if cycle == 5 && side == 1 && place < 6 { 50.0 } else { 0.0 }) + noise()
    });
    let count = find_gross_errors(&readings).iter().filter(|gross| **gross).count();
    assert!(count == 0, "{count}");
}

#[test]
fn f_is_that_of_an_analysis_of_variance() {
    // Three places with two readings each: 1, 3 | 5, 7 | 9, 11. Between 64/2, within 6/3: F = 16;
    // of (2, 3) degrees of freedom the upper tail is (1 + 2·16/3)^(−3/2) = 0.025 094.
    let values = [1.0, 5.0, 9.0, 3.0, 7.0, 11.0];
    let readings: Vec<RepeatReading> = (0..6)
        .map(|n| RepeatReading { place: n % 3, side: 0, cycle: n / 3, value: values[n] })
        .collect();
    let decision = select_table(&readings, &[false; 6], 3, &[TableLaw::Table]);
    let trial = &decision.trials[0];
    assert!((trial.f - 16.0).abs() < 1e-12, "{}", trial.f);
    assert!((trial.chance - (1.0_f64 + 32.0 / 3.0).powf(-1.5)).abs() < 1e-9, "{}", trial.chance);
    assert_eq!(decision.scatter, Some(2.0_f64.sqrt()));
    assert_eq!(decision.taken, Err(TableRejection::Chance));
}

#[test]
fn held_out_cycles_are_predicted_by_the_others() {
    // One place more than two differ: each cycle by the mean of the two others.
    let values = [[0.0, 1.0, 2.0], [10.0, 11.0, 12.0], [30.0, 31.0, 32.0]];
    let readings: Vec<RepeatReading> = (0..9)
        .map(|n| RepeatReading { place: n % 3, side: 0, cycle: n / 3, value: values[n % 3][n / 3] })
        .collect();
    let decision = select_table(&readings, &[false; 9], 3, &[TableLaw::Table]);
    let left: Vec<f64> = decision.trials[0].held_out.clone();
    assert_eq!(left, [-1.5, -1.5, -1.5, 0.0, 0.0, 0.0, 1.5, 1.5, 1.5]);
    assert_eq!(decision.taken, Ok(TableLaw::Table));
}

#[test]
fn the_law_that_was_drawn_is_taken_and_noise_gets_none() {
    let shape = [4.0, -9.0, 12.0, 3.0, -14.0, 6.0, 0.0];
    let mut noise = noise(4);
    let mut taken = [[0; 4]; 4];
    for (drawn, counts) in taken.iter_mut().enumerate() {
        for _ in 0..200 {
            let readings = cycles_of(7, 3, |place, side, _| {
                let side = side as f64;
                let table = match drawn {
                    0 => 0.0,
                    1 => shape[place],
                    2 => shape[place] + 8.0 * side,
                    _ => shape[place] + side * shape[6 - place],
                };
                table + noise()
            });
            let law = decided(&readings, 7).taken;
            counts[law.map_or(0, |law| 1 + law as usize)] += 1;
        }
    }
    println!("taken none, table, and step, each side (a row each that was drawn): {taken:?}");
    for (drawn, counts) in taken.iter().enumerate() {
        assert!(counts[drawn] >= 180, "{taken:?}");
    }
    assert!(taken[0][0] >= 196, "{taken:?}");
}

#[test]
fn one_cycle_is_judged_by_its_two_sides_and_one_way_alone_not_at_all() {
    let shape = [4.0, -9.0, 12.0, 3.0, -14.0, 6.0, 0.0];
    let mut noise = noise(5);
    let both = cycles_of(7, 1, |place, _, _| shape[place] + noise());
    let decision = decided(&both, 7);
    assert_eq!((decision.taken, decision.by_side), (Ok(TableLaw::Table), true));
    // The same with a number for each way in the place of a cycle.
    let ways: Vec<RepeatReading> =
        both.iter().map(|reading| RepeatReading { cycle: reading.side, ..*reading }).collect();
    assert_eq!(decided(&ways, 7).taken, Ok(TableLaw::Table));
    // A step is seen at every place.
    let step = cycles_of(7, 1, |place, side, _| shape[place] - 4.0 * side as f64 + noise());
    assert_eq!(decided(&step, 7).taken, Ok(TableLaw::TableAndStep));
    let one_way = &both[..7];
    assert_eq!(decided(one_way, 7).taken, Err(TableRejection::TooFew));
}

#[test]
fn what_shifts_from_cycle_to_cycle_as_much_as_places_differ_is_refused() {
    let shape = [4.0, -9.0, 12.0, 3.0, -14.0];
    let shift = [-64.0, 20.0, 45.0, -20.0, -10.0];
    let readings = cycles_of(5, 5, |place, _, cycle| shape[place] + shift[cycle]);
    assert_eq!(decided(&readings, 5).taken, Err(TableRejection::Chance));
}

#[test]
fn a_cycle_that_does_not_gain_refuses_the_table() {
    let shape = [4.0, -9.0, 12.0, 3.0, -14.0];
    let readings =
        cycles_of(5, 6, |place, _, cycle| if cycle == 5 { -0.6 } else { 1.0 } * shape[place]);
    assert_eq!(decided(&readings, 5).taken, Err(TableRejection::NoGain));
}

#[test]
fn a_slow_curve_is_predicted_between_its_places_and_a_quick_one_is_not() {
    let at: Vec<f64> = (0..9).map(|n| 5.0 * f64::from(n)).collect();
    let mut noise = noise(6);
    let mut found = |period: f64, size: f64| {
        let readings = cycles_of(9, 3, |place, _, _| {
            size * (std::f64::consts::TAU * at[place] / period).sin() + noise()
        });
        check_interpolation(&at, &readings, &[false; 54], TableLaw::Table)
            .expect("it has inner places")
    };
    assert!(!found(60.0, 30.0).is_interpolation_doubtful());
    assert!(found(11.0, 30.0).is_interpolation_doubtful());
    // What the scatter hides is not doubted.
    let count = (0..300).filter(|_| found(11.0, 0.0).is_interpolation_doubtful()).count();
    println!("{count} of 300 tables of noise alone are doubted between their places");
    assert!(count <= 9, "{count}");
}

#[test]
fn five_places_do_not_show_what_is_between_them() {
    let at = [0.0, 2.0, 4.0, 6.0, 8.0];
    let readings = cycles_of(5, 3, |place, _, _| [9.0, -7.0, 8.0, -9.0, 7.0][place]);
    let found = check_interpolation(&at, &readings, &[false; 30], TableLaw::Table)
        .expect("it has inner places");
    assert!(!found.has_enough_interior_positions() && !found.is_interpolation_doubtful());
    assert_eq!(found.inner, 3);
}

#[test]
fn the_power_is_that_of_drawn_tables() {
    let mut noise = noise(7);
    for (size, cycles) in [(0.8, 2), (0.8, 3), (0.5, 5)] {
        // An error of this root mean square over ten places.
        let error = |place: usize| if place.is_multiple_of(2) { size } else { -size };
        let found = (0..2000)
            .filter(|_| {
                let readings: Vec<RepeatReading> = (0..10 * cycles)
                    .map(|n| (n % 10, n / 10))
                    .map(|(place, cycle)| RepeatReading {
                        place,
                        side: 0,
                        cycle,
                        value: error(place) + noise(),
                    })
                    .collect();
                let decision =
                    select_table(&readings, &vec![false; readings.len()], 10, &[TableLaw::Table]);
                decision.trials[0].is_significant()
            })
            .count();
        let (drawn, predicted) = (found as f64 / 2000.0, power(size, 1.0, 10, cycles));
        println!(
            "{size} in {cycles} cycles: {drawn:.3} of the draws, {predicted:.3} by the noncentral F"
        );
        assert!((drawn - predicted).abs() < 0.025, "{drawn} {predicted}");
    }
}

#[test]
fn positions_within_a_tenth_of_a_step_are_one_place() {
    let (places, of) = group_positions(&[10.0, 0.0, 0.3, 9.8, 20.0], 10.0);
    assert_eq!(of, [1, 0, 0, 1, 2]);
    assert_eq!(places, [0.15, 9.9, 20.0]);
}
