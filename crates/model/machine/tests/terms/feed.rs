//! Backlash that goes with the feed.

use trueup_machine::machine_file::Quantity;

use super::{AXIS, assert_near, predicted, term};

/// Six micrometres at 100 mm/min and eleven at 1000; where a run does not say, those of the feed that is
/// corrected.
#[test]
fn backlash_goes_with_the_feed_and_a_run_that_does_not_say_it_has_that_which_is_corrected() {
    let keys = "cause = \"feed-dependent-backlash\"\nfeeds_mm_per_min = [100.0, 1000.0]\n\
                width_um = [6.0, 11.0]\nat_feed_mm_per_min = 1000.0";
    let csv = "temp_a_c,x_mm,dir_x,feed_mm_per_min\n20,0,1,100\n20,0,-1,100\n20,0,-1,1000\n20,0,-1,550\n20,0,-1,\n";
    let expected = [0.0, 6.0, 11.0, 8.5, 11.0];
    assert_near(&predicted(AXIS, &term("dx", keys), Quantity::Dx, csv), &expected);
    let csv = "temp_a_c,x_mm,dir_x\n20,0,1\n20,0,-1\n";
    assert_near(&predicted(AXIS, &term("dx", keys), Quantity::Dx, csv), &[0.0, 11.0]);
}
