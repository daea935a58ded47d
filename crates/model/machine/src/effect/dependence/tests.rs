//! The page at rows worked out by hand.

use super::{column_values::find_levels, *};

fn added(page: &Dependence, x: &[f64]) -> f64 {
    crate::effect::law_evaluation::evaluate_at(page, &page.values(), x)
}

fn page(form: DependenceForm, times: Multiplier) -> Dependence {
    Dependence { form, times, ..Dependence::from_column("coolant_bar") }
}

#[test]
fn a_level_adds_its_own_value_and_an_unseen_one_nothing() {
    let levels = DependenceForm::Level {
        levels: vec![2.0, 1.0, 3.0],
        added: vec![0.0, 4.0, -3.0],
        otherwise: 0.0,
    };
    let page_of_levels = page(levels, Multiplier::One);
    let at = |level: f64| added(&page_of_levels, &[level]);
    assert_eq!([at(2.0), at(1.0), at(3.0), at(7.0)], [0.0, 4.0, -3.0, 0.0]);
    assert!(at(f64::NAN).is_nan(), "which level it was is not known");
    // 12,000 r/min: 144 · 0.01 µm and 144 · 0.03 µm.
    let levels =
        DependenceForm::Level { levels: vec![2.0, 1.0], added: vec![0.01, 0.03], otherwise: 0.0 };
    let by_speed = page(levels, Multiplier::Speed2);
    assert!((added(&by_speed, &[2.0, 12_000.0]) - 1.44).abs() < 1e-12);
    assert!((added(&by_speed, &[1.0, 12_000.0]) - 4.32).abs() < 1e-12);
}

#[test]
fn a_line_counts_from_its_reference_and_a_hinge_from_its_bend() {
    let line = page(DependenceForm::Line { slope: 0.2, reference: 20.0 }, Multiplier::One);
    assert_eq!([added(&line, &[20.0]), added(&line, &[70.0])], [0.0, 10.0]);
    let hinge = DependenceForm::Hinge { slope: 0.4, from: 35.0, range: [35.0; 2] };
    let hinge = page(hinge, Multiplier::One);
    assert_eq!([added(&hinge, &[10.0]), added(&hinge, &[45.0])], [0.0, 4.0]);
    assert!(added(&hinge, &[f64::NAN]).is_nan());
    // 500 mm of travel: half of what a metre adds.
    let along = page(DependenceForm::Line { slope: 2.0, reference: 0.0 }, Multiplier::Position);
    assert_eq!(added(&along, &[3.0, 500.0]), 3.0);
}

/// 30 bar at 7 l/min less 5: 0.02 µm × 30 × 2.
#[test]
fn a_product_counts_from_the_zero_of_the_second_column() {
    let flow = Multiplier::Column { column: "flow_l".into(), reference: 5.0, range: [5.0; 2] };
    let product = page(DependenceForm::Line { slope: 0.02, reference: 0.0 }, flow);
    assert!((added(&product, &[30.0, 7.0]) - 1.2).abs() < 1e-12);
    assert!(added(&product, &[30.0, f64::NAN]).is_nan());
    assert_eq!(product.inputs(&[]), [LawInput::Column("coolant_bar"), LawInput::Column("flow_l")]);
    // Open: −3 µm/K × 2 K. Closed: nothing.
    let room =
        Multiplier::Column { column: "temp_room_c".into(), reference: 20.0, range: [20.0; 2] };
    let open =
        DependenceForm::Level { levels: vec![0.0, 1.0], added: vec![0.0, -3.0], otherwise: 0.0 };
    let by_door = page(open, room);
    assert_eq!([added(&by_door, &[0.0, 22.0]), added(&by_door, &[1.0, 22.0])], [0.0, -6.0]);
    let inputs = by_door.inputs(&[]);
    assert_eq!(inputs[1], LawInput::Temperature { column: "temp_room_c", lag_s: 0.0 });
}

#[test]
fn a_category_has_few_levels_each_seen_often() {
    let switch = [1.0, 0.0, 1.0];
    assert_eq!(find_levels(&switch), Some(vec![0.0, 1.0]), "a switch is one, off first");
    let tools: Vec<f64> = (0..30).map(|n| f64::from(n % 3 + 1)).chain([2.0]).collect();
    assert_eq!(find_levels(&tools), Some(vec![2.0, 1.0, 3.0]), "the most frequent first");
    let rare: Vec<f64> = (0..30).map(|n| f64::from(n % 2)).chain([5.0]).collect();
    assert_eq!(find_levels(&rare), None, "5 was seen once");
    let many: Vec<f64> = (0..200).map(f64::from).collect();
    assert_eq!(find_levels(&many), None);
}

/// 0 at 2 bar, 4 µm at 20 and 5 µm at 40: 2 µm at 11 bar, and the ends are held.
#[test]
fn a_curve_goes_straight_between_its_places_and_holds_its_ends() {
    let form = DependenceForm::Curve { at: vec![2.0, 20.0, 40.0], added: vec![0.0, 4.0, 5.0] };
    let curve = page(form, Multiplier::One);
    let at = |bar: f64| added(&curve, &[bar]);
    assert_eq!([at(0.0), at(2.0), at(11.0), at(30.0), at(70.0)], [0.0, 0.0, 2.0, 4.5, 5.0]);
    assert!(at(f64::NAN).is_nan());
}

/// 2 µm/K × (25 °C − 22 °C); on a board 2 µm/K of the one and −2 µm/K of the other.
#[test]
fn a_difference_is_heat_of_two_thermometers_of_opposite_sign() {
    let form = DependenceForm::Line { slope: 2.0, reference: 0.0 };
    let minus = Some("temp_right_c".to_string());
    let difference =
        Dependence { form, minus, lag_s: 900.0, ..Dependence::from_column("temp_left_c") };
    assert_eq!(added(&difference, &[25.0, 22.0]), 6.0);
    let [BoardTerm::Heat(left), BoardTerm::Heat(right)] = &difference.board_terms()[..] else {
        panic!("{:?}", difference.board_terms())
    };
    assert_eq!((&left.column[..], left.um_per_c), ("temp_left_c", 2.0));
    assert_eq!((&right.column[..], right.um_per_c), ("temp_right_c", -2.0));
    assert_eq!([left.time_constant_s, right.time_constant_s], [900.0; 2]);
    assert_eq!(left.reference_c, right.reference_c);
}
