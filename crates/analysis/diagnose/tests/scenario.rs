//! The shipped scenarios, each with the machine file of a user who knows little: nothing false is
//! claimed. The whole is `scorecard scenarios`.

#[path = "score/key.rs"]
mod key;
#[path = "score/shipped.rs"]
mod shipped;

use shipped::Shipped;

use key::KeyComparison;

/// Returns what is said of the record of `seed`.
fn told(shipped: &Shipped, seed: u64) -> KeyComparison {
    (shipped.key)().of(&shipped.diagnosed(seed).report)
}

#[test]
fn an_axis_that_warms_up_is_named_along_and_across() {
    let [along, across, _] = &shipped::ALL;
    let told_along = told(along, 10);
    assert!(told_along.is_right(), "{told_along}");
    let told_across = told(across, 10);
    assert!(told_across.is_right(), "{told_across}");
}

#[test]
fn a_wave_beside_an_uneven_screw_is_not_the_instruments() {
    let [along, ..] = &shipped::ALL;
    let told = told(along, 41);
    assert!(told.is_right(), "{told}");
}
