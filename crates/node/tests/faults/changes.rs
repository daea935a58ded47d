//! Resets and changes of source, drawn: the offset that a CNC applies goes on.

use crate::rig::{Kind, Part, Rig, calibration};
use trueup_core::cnc::{Flags, Quality};
use trueup_node::node::Node;

/// The slew limit of the rig in nm a millisecond, and what rounding may add.
const SLEW_NM: u32 = 20;
const ROUNDING_NM: u32 = 1;

/// A CNC that applies what is available at once, takes it back at the slew limit where nothing is, and raises
/// `Engage` only where it applies nothing.
#[derive(Default)]
struct Cnc {
    z_nm: i32,
    at_zero_ms: u32,
    without_ms: u32,
}

impl Cnc {
    fn live(&mut self, rig: &mut Rig) {
        let before = self.z_nm;
        match rig.last.offset {
            Some([_, _, z]) => (self.z_nm, self.without_ms) = (z.0, 0),
            None => {
                self.without_ms += 1;
                let step = SLEW_NM.cast_signed();
                self.z_nm -= self.z_nm.clamp(-step, step);
            }
        }
        let step = before.abs_diff(self.z_nm);
        assert!(step <= SLEW_NM + ROUNDING_NM, "a step of {step} nm at {} ms", rig.ms);
        self.at_zero_ms = if self.z_nm == 0 { self.at_zero_ms + 1 } else { 0 };
        if rig.engage && self.without_ms > 1_000 {
            rig.engage = false;
            self.at_zero_ms = 0;
        } else if !rig.engage && self.at_zero_ms > 120 {
            rig.engage = true;
            self.without_ms = 0;
        }
    }
}

fn resets(count: u32, seed: u64) {
    let (mut twin, mut rig) = (Rig::engaged(seed), Rig::engaged(seed));
    let (mut cnc, mut kept) =
        (Cnc { z_nm: rig.applied_nm()[1], ..Cnc::default() }, rig.node.kept());
    let (mut compared, mut worst_nm, mut done) = (0_u32, 0, 0);
    let mut until = 100;
    while done < count {
        if rig.ms.is_multiple_of(1_000) {
            kept = rig.node.kept();
        }
        until -= 1;
        if until == 0 {
            let mut next = Node::new(Some(calibration()), false);
            next.set_reference(rig.node.reference());
            next.resume(Some(&kept));
            rig.node = next;
            rig.last.offset = None;
            // Long enough to arrive after most of them.
            until = 200 + (rig.bits() % 5_000) as u32;
            // Now and then the sensor is gone as well, of both.
            rig.blind = rig.bits().is_multiple_of(4);
            twin.blind = rig.blind;
            done += 1;
        }
        twin.live();
        rig.live();
        cnc.live(&mut rig);
        let has_arrived = rig.last.quality != Quality::Off
            && rig.last.quality == twin.last.quality
            && rig.last.offset.is_some()
            && !rig.last.flags.contains(Flags::SLEWING)
            && !twin.last.flags.contains(Flags::SLEWING)
            && twin.last.offset.is_some();
        if has_arrived {
            compared += 1;
            worst_nm = worst_nm.max(rig.applied_nm()[1].abs_diff(twin.applied_nm()[1]));
        }
    }
    println!("{count} resets: {worst_nm} nm from a twin without them, over {compared} ms");
    assert!(worst_nm <= 1_000, "{worst_nm} nm");
    assert!(compared > count * 100, "compared for {compared} ms");
}

#[test]
fn no_reset_is_seen_by_the_cnc_as_a_step() {
    resets(40, 3);
}

#[test]
#[ignore = "long: a thousand resets"]
fn a_thousand_resets_are_within_a_micrometre_of_a_bridge_without_them() {
    resets(1_000, 4);
}

/// So many changes of source: by how much the offset goes beyond the true growth in the first second of each, in nm.
fn changes(count: u32, seed: u64) -> f64 {
    let mut rig = Rig::engaged(seed);
    // What noise leaves behind the filter is not what is asked (1 nm); with less the codes themselves show.
    rig.noise_codes = 0.6;
    let mut worst_nm = 0.0_f64;
    let mut done = 0;
    while done < count {
        if rig.heat < 0.2 {
            // Warm, and then standing still, where the filter's window is longest and its noise least.
            (rig.runs, rig.blind, rig.fault) = (true, false, None);
            rig.run(300_000);
            rig.runs = false;
            rig.run(5_000);
        }
        // The sensor's cable, or the thermometer's, or both.
        let drawn = rig.bits();
        rig.blind = drawn.is_multiple_of(2);
        let is_off = (drawn >> 8).is_multiple_of(4);
        let since = rig.ms + 1;
        rig.fault = is_off.then_some((Part::SpindleThermometer, Kind::Off, since));
        let before = rig.last.quality;
        let mut begin: Option<(f64, f64, u32)> = None;
        let mut last = (f64::from(rig.applied_nm()[1]), rig.grown_nm());
        for _ in 0..(2_700 + (drawn >> 16) % 500) {
            let quality = rig.last.quality;
            rig.live();
            if rig.last.quality != quality && rig.last.quality as u8 <= 3 {
                begin = Some((last.0, last.1, rig.ms));
                done += u32::from(rig.last.quality != before);
            }
            last = (f64::from(rig.applied_nm()[1]), rig.grown_nm());
            if let Some((offset, grown, at)) = begin
                && rig.ms - at < 1_000
            {
                worst_nm = worst_nm.max(((last.0 - offset) - (last.1 - grown)).abs());
            }
        }
    }
    println!(
        "{count} changes of source: {worst_nm:.1} nm beyond the true growth in the first second"
    );
    worst_nm
}

#[test]
fn a_change_of_source_goes_on_with_the_growth() {
    assert!(changes(40, 5) <= 10.0);
}

#[test]
#[ignore = "long: a thousand changes of source"]
fn a_thousand_changes_of_source_go_on_with_the_growth() {
    assert!(changes(1_000, 7) <= 10.0);
}

#[test]
#[ignore = "campaign: cargo test -p trueup-node --test faults campaign -- --ignored --nocapture"]
fn campaign_ten_thousand_changes_of_source_go_on_with_the_growth() {
    assert!(changes(10_000, 6) <= 10.0);
}
