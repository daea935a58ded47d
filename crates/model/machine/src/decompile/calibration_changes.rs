//! The differences between two calibrations, in words: which axis, which law, and by how much at most.

use trueup_core::{
    calibration::{AxisModel, Calibration, MainsFrequency, STRAIGHTNESS_AXIS_PAIRS},
    cnc::LinearAxis,
    curve::Curve,
    pitch_table::PitchErrorTable,
    thermal::ThermalExpansionLaw,
    volumetric_error::VolumetricErrorModel,
};

use super::calibration_difference::{
    curve_difference, gradient_difference_nm, pitch_difference_nm, spindle_difference_nm,
    term_difference_nm, thermal_law_difference_nm, volume_difference_nm,
};
use crate::compile::term::REFERENCE_LEVER_M;
use crate::unit_conversion::{FINE_UNITS_PER_NM, NM_PER_UM};

/// Returns what is different in `new`, a sentence each; empty: the board computes the same by both.
#[must_use]
pub fn describe_changes(old: &Calibration<'_>, new: &Calibration<'_>) -> Vec<String> {
    let mut all = Vec::new();
    let text = |bytes: &[u8]| match bytes {
        [] => "no name".to_owned(),
        bytes => format!("\"{}\"", String::from_utf8_lossy(bytes).escape_debug()),
    };
    for (what, a, b) in [
        ("machine", old.names.machine, new.names.machine),
        ("serial number", old.names.serial, new.names.serial),
    ] {
        if a != b {
            all.push(format!("{what}: {} becomes {}", text(a), text(b)));
        }
    }
    if old.names.board != new.names.board {
        let of = |board| if board == [0; 3] { "any board" } else { "one board alone" };
        let (a, b) = (of(old.names.board), of(new.names.board));
        let other = if a == b { "another board".to_owned() } else { format!("{a} becomes {b}") };
        all.push(format!("made for: {other}"));
    }
    if old.spindle != new.spindle {
        let size = spindle_difference_nm(&old.spindle, &new.spindle);
        all.push(format_change("spindle growth: its law", size, ""));
    }
    if old.kinematics != new.kinematics {
        all.push("tool direction, or the axes that turn the tool".into());
    }
    for (axis, (a, b)) in LinearAxis::ALL.into_iter().zip(old.axes.iter().zip(&new.axes)) {
        append_axis_changes(axis, a, b, &mut all);
    }
    for ((error, along), (a, b)) in
        STRAIGHTNESS_AXIS_PAIRS.into_iter().zip(old.straightness.iter().zip(&new.straightness))
    {
        if a != b {
            let size = curve_change_nm(a, b);
            all.push(format_change(
                &format!("straightness of {error:?} along {along:?}"),
                size,
                "",
            ));
        }
    }
    for ((error, along), (a, b)) in
        STRAIGHTNESS_AXIS_PAIRS.into_iter().zip(old.squareness.into_iter().zip(new.squareness))
    {
        if a != b {
            let what = format!("squareness of {error:?} along {along:?}");
            all.push(format_change(&what, Some(gradient_difference_nm(a, b)), " over 1 m"));
        }
    }
    append_volume_change(old.volume.as_ref(), new.volume.as_ref(), &mut all);
    let terms = old.terms.iter().zip(&new.terms).filter(|(a, b)| a != b);
    for (number, (a, b)) in (1..).zip(terms) {
        let size = a.as_ref().zip(b.as_ref()).and_then(|(a, b)| term_difference_nm(a, b));
        let what = match (a, b) {
            (None, _) => "is added",
            (_, None) => "is gone",
            _ => "is another",
        };
        all.push(format_change(&format!("found cause, change {number}: one {what}"), size, ""));
    }
    if old.thermometers != new.thermometers || old.cold_within != new.cold_within {
        all.push("thermometers: their channels or kinds".into());
    }
    if old.guards.max_rates != new.guards.max_rates {
        all.push("how fast thermometers may change".into());
    }
    if old.guards.service_switch != new.guards.service_switch {
        let requested =
            if new.guards.service_switch { "asked for from now on" } else { "no longer asked for" };
        all.push(format!("the service switch is {requested}"));
    }
    if old.guards.mains != new.guards.mains {
        let hz = if new.guards.mains == MainsFrequency::Hz60 { 60 } else { 50 };
        all.push(format!("temperature inputs suppress the hum of {hz} Hz"));
    }
    append_limit_changes(old, new, &mut all);
    all
}

fn append_volume_change(
    a: Option<&VolumetricErrorModel<'_>>,
    b: Option<&VolumetricErrorModel<'_>>,
    all: &mut Vec<String>,
) {
    let what = "angular and location errors";
    match (a, b) {
        (None, Some(_)) => all.push(format!("{what}: they are added")),
        (Some(_), None) => all.push(format!("{what}: they are gone")),
        (Some(a), Some(b)) if a != b => all.push(match volume_difference_nm(a, b) {
            Some(nm) => format_change(what, Some(nm / REFERENCE_LEVER_M), " at a lever of 1 m"),
            None => format!("{what}: other axes, points or tool"),
        }),
        _ => {}
    }
}

/// Returns a change with its size, where it is known.
fn format_change(what: &str, nm: Option<f64>, over: &str) -> String {
    match nm {
        // What has changed has no size of its own.
        Some(0.0) => format!("{what}: another channel, lag or place"),
        Some(nm) => format!("{what}, up to {:.2} µm{over}", nm / NM_PER_UM),
        None => format!("{what} is of another kind"),
    }
}

fn append_axis_changes(
    axis: LinearAxis,
    a: &AxisModel<'_>,
    b: &AxisModel<'_>,
    all: &mut Vec<String>,
) {
    let mut note = |what: &str, size: Option<f64>, over: &str| {
        all.push(format_change(&format!("{axis:?}: {what}"), size, over));
    };
    if a.thermal != b.thermal {
        let [old, new] = [a, b].map(|axis| {
            axis.thermal.map_or_else(ThermalExpansionLaw::default, |thermal| thermal.law)
        });
        let size = thermal_law_difference_nm(old, new);
        note("heat", Some(size), " over 1 m, from -20 to 100 °C");
    }
    if a.pitch != b.pitch {
        note("pitch", pitch_change_nm(a.pitch.as_ref(), b.pitch.as_ref()), "");
    }
    if a.dual != b.dual {
        let [old, new] = [a, b].map(|axis| axis.dual.map(|dual| dual.pitch));
        note("second drive", pitch_change_nm(old.as_ref(), new.as_ref()), "");
    }
    if a.backlash != b.backlash {
        let size = f64::from(a.backlash.0.abs_diff(b.backlash.0)) / FINE_UNITS_PER_NM;
        note("backlash", Some(size), "");
    }
    if a.travel != b.travel {
        all.push(format!("{axis:?}: how a reversal is detected"));
    }
}

/// Returns the largest difference of two tables, or the largest error of the one that is there alone.
fn pitch_change_nm(
    a: Option<&PitchErrorTable<'_>>,
    b: Option<&PitchErrorTable<'_>>,
) -> Option<f64> {
    match (a, b) {
        (Some(a), Some(b)) => pitch_difference_nm(a, b),
        (Some(only), None) | (None, Some(only)) => {
            super::calibration_difference::max_pitch_error_nm(only)
        }
        (None, None) => Some(0.0),
    }
}

fn curve_change_nm(a: &Curve<'_>, b: &Curve<'_>) -> Option<f64> {
    let (of, from) = if a.is_empty() { (b, a) } else { (a, b) };
    // Over the places of either; where one has none it is 0.
    let there = curve_difference(of, from);
    let back = if from.is_empty() { 0.0 } else { curve_difference(from, of) };
    Some(there.max(back) / FINE_UNITS_PER_NM)
}

fn append_limit_changes(old: &Calibration<'_>, new: &Calibration<'_>, all: &mut Vec<String>) {
    let um = |nm: i32| f64::from(nm) / NM_PER_UM;
    for (axis, (a, b)) in LinearAxis::ALL.into_iter().zip(old.limits.max.iter().zip(new.limits.max))
    {
        if *a != b {
            let (a, b) = (um(a.0), um(b.0));
            all.push(format!("largest offset of {axis:?}: {a} becomes {b} µm"));
        }
    }
    let per_s = |nm_per_s: u32| f64::from(nm_per_s) / NM_PER_UM;
    let (a, b) = (old.limits.learned, new.limits.learned);
    let cap = |tenths: u8| f64::from(tenths) / 10.0;
    for (what, a, b, unit) in [
        ("slew limit", per_s(old.limits.slew_nm_per_s), per_s(new.limits.slew_nm_per_s), "µm/s"),
        (
            "rejoin limit",
            per_s(old.limits.rejoin_nm_per_s),
            per_s(new.limits.rejoin_nm_per_s),
            "µm/s",
        ),
        (
            "link timeout",
            old.limits.link_timeout_ms.into(),
            new.limits.link_timeout_ms.into(),
            "ms",
        ),
        ("hold", old.limits.hold_ms.into(), new.limits.hold_ms.into(), "ms"),
        ("learned growth", cap(a.growth), cap(b.growth), "%"),
        ("learned expansion", cap(a.axes), cap(b.axes), "%"),
        ("learned zero", cap(a.zero), cap(b.zero), "µm"),
    ] {
        if a != b {
            all.push(format!("{what}: {a} becomes {b} {unit}"));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Machine, MachineFile, compile};
    use std::path::Path;

    const GANTRY: &str = include_str!("../../../../../data/gantry.toml");

    fn gantry() -> Machine {
        MachineFile::parse(GANTRY, Path::new("m.toml")).expect("the project's own file")
    }

    fn describe_change(change: impl FnOnce(&mut Machine)) -> Vec<String> {
        let mut other = gantry();
        change(&mut other);
        let (a, b) = (compile(&gantry()).expect("it fits"), compile(&other).expect("it fits"));
        describe_changes(&a.calibration(), &b.calibration())
    }

    #[test]
    fn two_of_one_kind_do_not_differ() {
        assert_eq!(describe_change(|_| ()), [""; 0]);
    }

    #[test]
    fn each_change_is_reported_with_its_axis_and_its_size() {
        let all = describe_change(|machine| {
            machine.name = "other".into();
            machine.limits.slew_um_per_s *= 2.0;
            machine.limits.max_um[2] += 1.0;
        });
        assert!(
            all[0].starts_with("machine: \"") && all[0].ends_with(" becomes \"other\""),
            "{all:?}"
        );
        assert!(all[1].starts_with("largest offset of Z: "), "{all:?}");
        assert!(all[2].starts_with("slew limit: ") && all.len() == 3, "{all:?}");
    }

    #[test]
    fn a_table_that_comes_or_goes_has_its_own_size() {
        let table =
            "[axis.x.pitch]\nstart_mm = 0.0\nstep_mm = 10.0\nforward_um = [0.0, 3.0, -7.5]\n";
        let text = "[machine]\nname = \"m\"\nkind = \"3-axis\"\n[limits]\nmax_um = { x = 50.0, \
                    y = 50.0, z = 50.0 }\nslew_um_per_s = 5.0\nlink_timeout_ms = 500\nhold_ms = 1000\n";
        let of = |text: &str| {
            let machine = MachineFile::parse(text, Path::new("m.toml")).expect("right");
            compile(&machine).expect("it fits")
        };
        let (without, with) = (of(text), of(&format!("{text}{table}")));
        let (a, b) = (without.calibration(), with.calibration());
        assert_eq!(describe_changes(&a, &b), ["X: pitch, up to 7.50 µm"]);
        assert_eq!(describe_changes(&b, &a), ["X: pitch, up to 7.50 µm"]);
        let backlash = of(&format!("{text}[axis.y.backlash]\nwidth_um = 4.25\n"));
        assert_eq!(describe_changes(&a, &backlash.calibration()), ["Y: backlash, up to 4.25 µm"]);
    }
}
