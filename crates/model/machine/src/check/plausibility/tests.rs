use std::path::Path;

use super::*;
use crate::{
    MachineFile,
    effect::Cause,
    keys::{
        key::{Key, ValueType},
        term::{TERM, TERM_KEYS},
    },
    machine_file::machine_file_keys::MACHINE_FILE_KEYS,
};

const HEAD: &str = "[machine]\nname = \"m\"\nkind = \"3-axis\"\n";
const HEAT: &str =
    "[axis.x.thermal]\nmode = \"position\"\nsensor = \"temp_a_c\"\nreference_c = 20.0\n";

fn findings(text: &str) -> Vec<(String, Plausibility, String)> {
    let text = format!("{HEAD}{text}");
    let machine = MachineFile::parse(&text, Path::new("m.toml")).expect("the test's own file");
    let found = find_implausible_values(&machine).into_iter();
    let text = |warning: Warning| format!("{}; help: {}", warning.what, warning.help);
    found.map(|finding| (finding.key, finding.grade, text(finding.warning))).collect()
}

/// Returns the only finding: its key, grade, and what it says with its help.
fn only(text: &str) -> (String, Plausibility, String) {
    let mut found = findings(text);
    assert_eq!(found.len(), 1, "{text}: {found:?}");
    found.remove(0)
}

/// Calls `with` for every key of numbers in a scope, with its dotted name and its range.
fn for_each_numeric_key(
    scope: KeyScope,
    keys: &'static [Key],
    path: &str,
    with: &mut dyn FnMut(String, &Key, Option<PlausibleRange>),
) {
    for key in keys {
        let name = format!("{path}{}", key.name);
        match key.form {
            ValueType::Table(inner) => {
                let scope = scope.section(key.name).expect("it is a section");
                for_each_numeric_key(scope, inner, &format!("{name}."), with);
            }
            ValueType::Text
            | ValueType::Boolean
            | ValueType::Choice(_)
            | ValueType::Column
            | ValueType::Choices(_)
            | ValueType::Terms => {}
            _ => with(name, key, scope.key_range(key)),
        }
    }
}

#[test]
fn every_number_of_a_machine_file_has_a_range_that_its_example_keeps() {
    let mut requested = 0;
    let mut ask = |name: String, key: &Key, range: Option<PlausibleRange>| {
        let range = range.unwrap_or_else(|| panic!("no range for {name}"));
        let nested = |[inner, outer]: [[f64; 2]; 2]| outer[0] <= inner[0] && inner[1] <= outer[1];
        assert!(
            nested([range.usual, range.likely]) && nested([range.likely, range.hard]),
            "{name}"
        );
        assert!(!range.source.is_empty() && !range.below.is_empty() && !range.above.is_empty());
        let numbers = key.example.split(['[', ']', ',', ' ']).filter_map(|part| part.parse().ok());
        assert_eq!(
            find_worst_value(&range, &numbers.collect::<Vec<f64>>()),
            None,
            "{name} = {}",
            key.example
        );
        requested += 1;
    };
    for_each_numeric_key(KeyScope::FILE, MACHINE_FILE_KEYS, "", &mut ask);
    for &cause in Cause::ALL {
        for keys in [TERM, TERM_KEYS] {
            let path = format!("term.{}.", cause.name());
            for_each_numeric_key(KeyScope::Term(cause), keys, &path, &mut ask);
        }
    }
    assert!(requested > 1000, "{requested}");
}

#[test]
fn a_key_has_its_own_range_else_that_of_its_section_else_that_of_its_unit() {
    let likely = |name: &str| {
        let (_, range) = KeyScope::FILE.find(name).expect("a key");
        range.map(|range| range.likely)
    };
    for (name, range) in [
        ("axis.y.backlash.width_um", Some([-0.5, 300.0])),
        ("spindle.sensor.k0_um", Some([-5000.0, 5000.0])),
        ("spindle.sensor.um_per_count", Some([-1e9, 1e9])),
        ("inputs.temp_bed_c.zero_v", Some([-1e10, 1e10])),
        ("inputs.coolant_on.bit", Some([-1e10, 1e10])),
        ("spindle.tools.drill.number", Some([0.0, 65535.0])),
        ("axis.z.pitch.forward_um", Some([-4000.0, 4000.0])),
    ] {
        assert_eq!(likely(name), range, "{name}");
    }
    let of_cause = |cause, name: &str| {
        KeyScope::Term(cause).find(name).and_then(|(_, range)| range).map(|range| range.likely)
    };
    assert_eq!(of_cause(Cause::SlowMode, "amplitude_um"), Some([-500.0, 500.0]));
    assert_eq!(of_cause(Cause::PitchPeriodic, "amplitude_um"), Some([-4000.0, 4000.0]));
    assert_eq!(of_cause(Cause::Dependence, "constant_um"), Some([-1e15, 1e15]));
    assert_eq!(of_cause(Cause::Step, "constant_um"), Some([-5000.0, 5000.0]));
    assert!(KeyScope::FILE.find("axis.x.backlash.depth_um").is_none());
}

#[test]
fn a_reversed_error_is_unlikely_and_reports_it() {
    for (text, key) in [
        ("[axis.x.backlash]\nwidth_um = -5.9\n".into(), "axis.x.backlash.width_um"),
        (format!("{HEAT}slope_um_per_m_per_c = -11.49\n"), "axis.x.thermal.slope_um_per_m_per_c"),
        (
            "[spindle]\nsource = \"temperature\"\n[spindle.temperature]\nsensor = \"temp_a_c\"\n\
             reference_c = 20.0\nk_um_per_c = -2.4\n"
                .into(),
            "spindle.temperature.k_um_per_c",
        ),
        (
            format!(
                "{HEAT}slope_um_per_m_per_c = 11.5\n[[term]]\ncause = \"expansion-slope\"\n\
                 quantity = \"dx\"\num_per_m_per_c = -11.5\n"
            ),
            "term[0].um_per_m_per_c",
        ),
        (
            "[axis.x.pitch]\nstart_mm = 0.0\nstep_mm = 100.0\nforward_um = [0.0, 1.0]\n\
             reverse_um = [-6.0, -5.0]\n"
                .into(),
            "axis.x.pitch.reverse_um",
        ),
        (
            "[axis.x.backlash]\nwidth_um = 6.0\n[[term]]\ncause = \"backlash\"\nquantity = \"dx\"\n\
             width_um = -12.0\n"
                .into(),
            "term[0].width_um",
        ),
        (
            "[axis.x.thermal]\nmode = \"position\"\nsensor = \"temp_a_c\"\n\
             table = [[20.0, 0.0, 0.0], [40.0, 0.0, -230.0]]\n"
                .into(),
            "axis.x.thermal.table",
        ),
    ] {
        let (found, grade, what) = only(&text);
        assert_eq!((found.as_str(), grade), (key, Plausibility::Unlikely), "{text}");
        assert!(what.contains("the sign is reversed: "), "{what}");
        let is_helped = ["help: look at one reading", "help: look at one reversal"];
        assert!(is_helped.iter().any(|help| what.contains(help)), "{what}");
    }
    // A correction that makes a backlash smaller is none of a reversed error; nor is noise about 0.
    assert_eq!(
        findings(
            "[axis.x.backlash]\nwidth_um = 6.0\n[[term]]\ncause = \"backlash\"\nquantity = \"dx\"\n\
             width_um = -2.0\n"
        ),
        []
    );
    assert_eq!(findings("[axis.x.backlash]\nwidth_um = -0.3\n"), []);
}

#[test]
fn a_doubted_value_is_reported_in_the_unit_of_its_key() {
    let text = "[spindle]\nsource = \"sensor\"\n[spindle.sensor]\nk0_um = 0.0\nzero_counts = 5e9\n\
                um_per_count = 0.0153\n";
    let (key, grade, what) = only(text);
    assert_eq!((key.as_str(), grade), ("spindle.sensor.zero_counts", Plausibility::Unlikely));
    assert!(what.contains(" 5000000000 counts is unlikely"), "{what}");
}

#[test]
fn what_no_machine_has_is_refused_until_its_key_is_accepted() {
    let text = format!("{HEAD}{HEAT}slope_um_per_m_per_c = 11500.0\n");
    let machine = MachineFile::parse(&text, Path::new("m.toml")).expect("the test's own file");
    let found = find_implausible_values(&machine);
    let bad = combine_rejected_findings(&found, &[]).expect("refused");
    assert_eq!((bad.place.line, bad.place.column), (8, 24), "{bad}");
    assert!(
        bad.rule.starts_with("axis.x.thermal.slope_um_per_m_per_c 11500 µm/(m·K) is impossible")
    );
    let help = bad.help.expect("what to do");
    assert!(help.ends_with("add --accept axis.x.thermal.slope_um_per_m_per_c"), "{help}");
    assert_eq!(
        combine_rejected_findings(&found, &["axis.x.thermal.slope_um_per_m_per_c".into()]),
        None
    );
    assert!(
        combine_rejected_findings(&found, &["axis.y.thermal.slope_um_per_m_per_c".into()])
            .is_some()
    );
}
