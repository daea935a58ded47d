//! The demonstration reaches its figures: the paper's own measurement through the real firmware.

use trueup_emulator::{
    demo,
    firmware::{self, Board},
    report,
};

#[test]
fn the_bridge_carries_the_papers_sensor_and_the_fit_brings_its_error_below_a_micrometre() {
    let image = firmware::build(Board::Virtual).expect("the image builds");
    let findings = demo::run(&image).expect("the demonstration runs");
    println!("{}", findings.table());

    assert_eq!(findings.rows.len(), 15);
    assert_eq!(findings.e2e_errors, 0);
    // Two frames a millisecond, half a second a row, twice.
    assert_eq!(findings.frames, 2 * 500 * 15 * 2);
    for row in &findings.rows {
        let off = row.bridge_um - row.sensor_um;
        assert!(off.abs() <= 0.02, "the bridge says {row:?}");
    }
    let off = findings.rows.iter().map(|row| (row.bridge_um - row.sensor_um).abs());
    println!("bridge against the sensor's counts: at most {:.4} µm", off.fold(0.0, f64::max));
    // What the paper's constants leave, and what is left of rows that took no part in the fit.
    assert!((findings.paper.rms_um - 9.4).abs() < 0.1, "{:?}", findings.paper);
    assert!((findings.paper.max_um - 15.3).abs() < 0.1, "{:?}", findings.paper);
    let calibrated = &findings.calibrated;
    assert!(calibrated.loo_rms_um <= 0.95 && calibrated.loo_max_um <= 1.9, "{calibrated:?}");
    assert!((calibrated.gain - 1.30).abs() < 0.01, "{calibrated:?}");
    assert!((calibrated.offset_um + 4.0).abs() < 0.1, "{calibrated:?}");

    let page = report::page(&findings).expect("a page");
    assert_eq!(page.matches("<svg").count(), 2);
    for outside in ["<script", "<link", "src=", "href="] {
        assert!(!page.contains(outside), "the page stands alone: {outside}");
    }
}
