//! Thermometers of what changes fast: the board does not believe more than 10 K/min unless the file says so.

use super::warning::Warning;
use crate::{machine_file::Machine, model::required_columns};

/// Things that change faster than a machine's parts, by a word of the column's name, in English and German.
const FAST_CHANGING_KEYWORDS: [&str; 20] = [
    "air",
    "ambient",
    "coolant",
    "cooling",
    "emulsion",
    "fluid",
    "hydraulic",
    "kss",
    "luft",
    "oel",
    "oil",
    "room",
    "umgebung",
    "wasser",
    "water",
    "raum",
    "kuehl",
    "kühl",
    "öl",
    "hall",
];

/// Words that are asked for at the beginning of a longer one too: `coolant2`, `kuehlmittel`, `hydrauliköl`.
const MIN_PREFIX_LENGTH: usize = 4;

pub(super) fn warnings(machine: &Machine) -> Vec<Warning> {
    let used = required_columns(&machine.with_only_compensated_terms());
    let inputs = machine.inputs.iter().flat_map(|inputs| &inputs.temperatures);
    let unstated =
        inputs.filter(|(name, input)| input.max_c_per_min.is_none() && used.contains(*name));
    let named = unstated.filter_map(|(name, _)| Some((name, find_fast_changing_keyword(name)?)));
    named
        .map(|(name, word)| {
            Warning::for_key(
                machine,
                &format!("inputs.{name}"),
                &format!(
                    "is named after {word}, which may change faster than 10 K/min: the board would not believe it then"
                ),
                "add max_c_per_min, the fastest change that you have seen there in K/min, with a margin (10.0 if it is a part of the machine)",
            )
        })
        .collect()
}

/// Returns the word in a column's name that stands for something fast.
fn find_fast_changing_keyword(column: &str) -> Option<&'static str> {
    let lower = column.to_lowercase();
    let is = |part: &str, word: &str| {
        let part = part.trim_end_matches(|c: char| c.is_ascii_digit());
        part == word || (word.chars().count() >= MIN_PREFIX_LENGTH && part.starts_with(word))
    };
    FAST_CHANGING_KEYWORDS
        .into_iter()
        .find(|word| lower.split(['_', '-', ' ']).any(|part| is(part, word)))
}

#[cfg(test)]
mod tests {
    use super::find_fast_changing_keyword;

    #[test]
    fn a_name_of_something_fast_is_found_and_a_part_of_the_machine_is_none() {
        for name in ["temp_coolant_c", "temp_oil_c", "temp_air2_c", "temp_gear_oil_c", "temp_öl_c"]
        {
            assert!(find_fast_changing_keyword(name).is_some(), "{name}");
        }
        for name in ["temp_kuehlmittel_c", "temp_Luft_c", "temp_water_in_c"] {
            assert!(find_fast_changing_keyword(name).is_some(), "{name}");
        }
        for name in ["temp_coil_c", "temp_front_c", "temp_screw_c", "temp_foil_c", "temp_bed_c"] {
            assert_eq!(find_fast_changing_keyword(name), None, "{name}");
        }
    }
}
