//! Levels against `f64`, over their whole range.

use super::*;
use crate::{
    cnc::LinearAxis,
    machine_position::MachinePosition,
    term::{
        Effect, OperatingPoint, Target, Term, TermStates, Terms, apply_elongation_terms,
        compute_axis_errors, elongation_term_prefix_length,
    },
    testing::next_random,
    units::{FineNanometres, Position, Rpm},
};
extern crate std;

const TOOLS: [(u32, i32); 3] = [(1, 700_000_000), (7, -41), (65_535, 1 << 29)];

fn levels() -> [[u8; 8]; 3] {
    TOOLS.map(|(number, level)| {
        let ([a, b, c, d], [e, f, g, h]) = (number.to_le_bytes(), level.to_le_bytes());
        [a, b, c, d, e, f, g, h]
    })
}

fn of(target: Target, effect: Effect<'_>) -> Terms<'_> {
    let mut terms = Terms::default();
    terms[0] = Some(Term { target, constant: FineNanometres::ZERO, effect });
    terms
}

fn on_off(times: CategoryFactor) -> ConditionLevels {
    let smoothing = SmoothingFactor::NO_LAG;
    ConditionLevels { bit: 3, default: false, off: 0, on: 1 << 29, shift: 20, smoothing, times }
}

#[test]
fn each_tool_has_its_level_and_every_other_and_none_that_of_the_rest() {
    let levels = levels();
    let table = ToolTable { levels: &levels, other: 99, ..ToolTable::default() };
    for (number, level) in TOOLS.into_iter().chain([(0, 99), (2, 99), (65_534, 99)]) {
        let tool = u16::try_from(number).expect("a tool");
        assert_eq!(
            table.level(Some(MachineConditions { tool, bits: u16::MAX })),
            level,
            "{number}"
        );
    }
    assert_eq!(table.level(None), 99, "the CNC does not say");
}

#[test]
fn a_condition_is_its_own_bit_and_its_default_where_the_cnc_does_not_say() {
    for bit in 0..16 {
        let it = ConditionLevels { bit, ..on_off(CategoryFactor::One) };
        let is_on = |bits| it.lag_input(Some(MachineConditions { tool: 7, bits })) == UNIT_STEP;
        assert!(is_on(1 << bit) && !is_on(!(1 << bit)), "{bit}");
        assert!(
            it.lag_input(None) == 0
                && ConditionLevels { default: true, ..it }.lag_input(None) == UNIT_STEP
        );
    }
}

/// The bound of the page: half of a place of m times f, and half of 1/256 nm.
#[test]
fn levels_times_any_factor_are_right_to_the_bound_of_the_page() {
    let mut seed = 5;
    let mut worst: f64 = 0.0;
    for _ in 0..100_000 {
        let shift = u8::try_from(next_random(&mut seed) % 63).expect("below 63");
        let exact = (f64::from(next_random(&mut seed)) / 2_f64.powi(31) - 1.0) * 2_f64.powi(30);
        let level = exact.round() as i32;
        let x = match next_random(&mut seed) % 3 {
            0 => 1,
            1 => speed_squared(next_random(&mut seed) as u16),
            _ => i64::from(next_random(&mut seed) as i32),
        };
        let place = 2_f64.powi(-i32::from(shift)) * x.abs() as f64;
        let expected = exact * 2_f64.powi(-i32::from(shift)) * x as f64;
        if expected.abs() < 2e9 {
            let off = (f64::from(scale_level(level, shift, x)) - expected).abs();
            worst = worst.max(off / (0.5 * place + 0.5));
        }
    }
    std::println!("largest error: {worst:.4} of the bound");
    assert!(worst > 0.9 && worst <= 1.0 + 1e-6, "{worst}");
}

#[test]
fn on_its_way_a_level_is_right_to_a_place_and_ends_exactly() {
    let mut seed = 9;
    for _ in 0..10_000 {
        let any = |seed: &mut u64| (next_random(seed) as i32) >> 1;
        let it = ConditionLevels {
            off: any(&mut seed),
            on: any(&mut seed),
            ..on_off(CategoryFactor::One)
        };
        assert_eq!([it.level(0), it.level(UNIT_STEP)], [it.off, it.on]);
        let s = (next_random(&mut seed) >> 2) as i32;
        let share = f64::from(s) / f64::from(UNIT_STEP);
        let expected = f64::from(it.off) + (f64::from(it.on) - f64::from(it.off)) * share;
        assert!((f64::from(it.level(s)) - expected).abs() <= 0.5 + 1e-6, "{it:?} at {s}");
    }
}

#[test]
fn what_a_level_is_multiplied_by() {
    let operating = OperatingPoint::default();
    let grown = FineNanometres(10 * 256_000);
    let mut states = TermStates::default();
    states.update_speed(&Terms::default(), Rpm(20_000));
    // 2²⁹ in 2⁻²⁰ are 512 units.
    let mut of_growth = |times| {
        let terms = of(Target::Elongation, Effect::Condition(on_off(times)));
        states.set_conditions(&terms, Some(MachineConditions { tool: 0, bits: 1 << 3 }));
        apply_elongation_terms(&terms, grown, &states, operating).0 - grown.0
    };
    assert_eq!(of_growth(CategoryFactor::One), 512);
    assert_eq!(of_growth(CategoryFactor::Growth), 512 * grown.0);
    let terms =
        of(Target::Axis(LinearAxis::Y), Effect::Condition(on_off(CategoryFactor::Position)));
    let mut place = MachinePosition::default();
    place.position[1] = Position(-1_000);
    states.set_conditions(&terms, Some(MachineConditions { tool: 0, bits: 1 << 3 }));
    assert_eq!(compute_axis_errors(&terms, &states, &place).0[1], FineNanometres(-512_000));
    states.set_conditions(&terms, Some(MachineConditions { tool: 0, bits: !(1 << 3) }));
    assert_eq!(compute_axis_errors(&terms, &states, &place).0[1], FineNanometres::ZERO);
    // 20 000² · 512/2³⁰ units of an axis by its speed.
    let by_speed = ConditionLevels { shift: 50, ..on_off(CategoryFactor::Speed2) };
    let terms = of(Target::Axis(LinearAxis::Y), Effect::Condition(by_speed));
    states.set_conditions(&terms, Some(MachineConditions { tool: 0, bits: 1 << 3 }));
    assert_eq!(compute_axis_errors(&terms, &states, &place).0[1], FineNanometres(191));
}

#[test]
fn a_condition_behind_a_lag_begins_settled_and_follows_from_there() {
    let lagged =
        ConditionLevels { smoothing: SmoothingFactor(1 << 30), ..on_off(CategoryFactor::One) };
    let terms = of(Target::Elongation, Effect::Condition(lagged));
    let mut states = TermStates::default();
    let added = |states: &TermStates| {
        apply_elongation_terms(&terms, FineNanometres::ZERO, states, OperatingPoint::default()).0
    };
    let step = |states: &mut TermStates| states.step(&terms, 0, &[None; 8], None, true);
    step(&mut states);
    assert_eq!(added(&states), 0, "nothing is known yet");
    states.set_conditions(&terms, Some(MachineConditions { tool: 0, bits: 1 << 3 }));
    step(&mut states);
    assert_eq!(added(&states), 512, "it was on at the first step");
    states.set_conditions(&terms, Some(MachineConditions::default()));
    for expected in [384, 288, 216, 162] {
        step(&mut states);
        assert_eq!(added(&states), expected, "a quarter less in each step");
    }
    let mut memory = crate::retained_lags::RetainedLags::default();
    states.store_lags(&terms, &mut memory);
    let mut resumed = TermStates::default();
    resumed.restore_lags(&terms, |key| memory.find(key));
    resumed.set_conditions(&terms, Some(MachineConditions::default()));
    step(&mut resumed);
    step(&mut states);
    assert_eq!(added(&resumed), added(&states), "a reset changes nothing");
}

/// By category comes last, wherever it stands in the blob, each with its constant once.
#[test]
fn terms_by_category_add_to_what_all_others_have_made() {
    let term = |constant, effect| {
        Some(Term { target: Target::Elongation, constant: FineNanometres(constant), effect })
    };
    let double =
        Effect::Gain(crate::fixed_point::ScaledCoefficient { mantissa: 1 << 29, shift: 29 });
    let levels = levels();
    let tools =
        ToolTable { levels: &levels, other: 1 << 29, shift: 50, times: CategoryFactor::Speed2 };
    let all = [
        term(10, Effect::Condition(on_off(CategoryFactor::One))),
        term(
            20,
            Effect::Condition(ConditionLevels { shift: 30, ..on_off(CategoryFactor::Growth) }),
        ),
        term(3, double),
        term(40, Effect::Tool(tools)),
    ];
    let sum = |places: [usize; 4]| {
        let mut terms = Terms::default();
        terms.iter_mut().zip(places).for_each(|(place, from)| *place = all[from]);
        let mut states = TermStates::default();
        states.set_conditions(&terms, Some(MachineConditions { tool: 9, bits: 1 << 3 }));
        assert!(
            states.update_speed(&terms, Rpm(20_000)) && !states.update_speed(&terms, Rpm(20_000))
        );
        let sum = |terms: &[Option<Term<'_>>]| {
            apply_elongation_terms(terms, FineNanometres(1_000), &states, OperatingPoint::default())
                .0
        };
        assert_eq!(
            sum(&terms),
            sum(&terms[..elongation_term_prefix_length(&terms)]),
            "the rest need not be walked"
        );
        sum(&terms)
    };
    // 2·1000 + 3, then 512 + 10, 20 000²·2²⁹⁻⁵⁰ + 40, 1000/2 + 20.
    let expected = 2_003 + 522 + (191 + 40) + 520;
    for places in [[0, 1, 2, 3], [2, 0, 1, 3], [3, 2, 1, 0]] {
        assert_eq!(sum(places), expected, "{places:?}");
    }
}
