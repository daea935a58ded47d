//! The object dictionary of version 0.2.0: a master that was set up by its data sheet still finds every object.

use std::collections::BTreeMap;

use trueup_canopen::EDS;

const EDS_0_2_0: &str = include_str!("../../../../host-tests/corpus/0.2.0/objects.eds");

/// Names that are others today, and why the object is the same.
const RENAMED: [(&str, &str, &str); 2] = [
    // There were no faults from 32 on.
    ("2001sub9", "All faults", "Faults 0 to 31"),
    // `back` is a text that was refused.
    (
        "2010sub6",
        "Forget the reference (write zero as text)",
        "Forget the reference (write zero as text), offer what was written (back)",
    ),
];

type Section<'a> = BTreeMap<&'a str, &'a str>;

/// Returns the objects and their entries by the names of their sections, `2001` and `2001sub9` say.
fn objects(eds: &str) -> BTreeMap<&str, Section<'_>> {
    let mut sections = BTreeMap::<&str, Section<'_>>::new();
    let mut section = "";
    for line in eds.lines() {
        if let Some(name) = line.strip_prefix('[').and_then(|line| line.strip_suffix(']')) {
            section = name;
        } else if let Some((key, value)) = line.split_once('=') {
            sections.entry(section).or_default().insert(key, value);
        }
    }
    let is_index =
        |name: &str| name.get(..4).is_some_and(|index| u16::from_str_radix(index, 16).is_ok());
    sections.retain(|name, _| is_index(name));
    sections
}

fn number(text: &str) -> u32 {
    let digits = text.strip_prefix("0x");
    digits.map_or_else(|| text.parse(), |hex| u32::from_str_radix(hex, 16)).expect("a number")
}

#[test]
fn every_object_of_0_2_0_is_where_it_was_with_its_type() {
    let (then, now) = (objects(EDS_0_2_0), objects(EDS));
    for (name, section) in &then {
        let today = now.get(name).unwrap_or_else(|| panic!("{name} is gone"));
        // How many entries an object has: it may get more.
        let is_count = name.ends_with("sub0");
        for (key, value) in section {
            let same = today.get(key).unwrap_or_else(|| panic!("{name}: {key} is gone"));
            let is_as_it_was = match *key {
                "SubNumber" => number(same) >= number(value),
                "DefaultValue" if is_count => number(same) >= number(value),
                "ParameterName" => value == same || RENAMED.contains(&(name, value, same)),
                // What could only be read may now be written as well.
                "AccessType" => value == same || (*value, *same) == ("ro", "rw"),
                _ => value == same,
            };
            assert!(is_as_it_was, "{name}: {key} was {value} and is {same}");
        }
    }
    assert_eq!(then.len(), 146, "all were compared");
}
