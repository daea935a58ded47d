//! In how many places the name of one cause of error stands.
//!
//! Not counted are its own page (the file that is named after it, or a table of the causes with one
//! number), the list of the pages, the virtual machine tool, which must not share a word with the
//! model that is tried on it, and tests. Names that are ordinary words (`backlash`, `step`) cannot be distinguished from these and are excluded.

use super::source_file::{SourceFile, contains_word};

/// The causes whose names cannot mean anything else.
const UNAMBIGUOUS_CAUSE_NAMES: &[&str] = &[
    "sensor-offset",
    "sensor-gain",
    "sensor-curvature",
    "sensor-saturation",
    "sensor-temperature-drift",
    "time-shift",
    "thermal-lag",
    "slow-mode",
    "extra-heat-path",
    "growth-amplitude",
    "growth-rate",
    "cooling-asymmetry",
    "thermometer-lag",
    "expansion-constant",
    "angular-error",
    "axis-expansion",
    "feed-dependent-backlash",
    "expansion-slope",
    "reference-temperature",
    "centrifugal-growth",
    "cutting-load",
    "pitch-scale",
    "pitch-error",
    "pitch-periodic",
    "position-dependent-backlash",
    "cross-axis",
    "reference-instrument",
];

/// The folder of the pages; what it has next to them is the list.
const CAUSE_FOLDER: &str = "crates/model/machine/src/effect/";

/// Returns the cause that is named in most places, and these as `file:line`.
pub(crate) fn find_most_mentioned_cause(sources: &[SourceFile]) -> (&'static str, Vec<String>) {
    let counted =
        UNAMBIGUOUS_CAUSE_NAMES.iter().map(|&cause| (cause, find_cause_mentions(sources, cause)));
    counted.max_by_key(|(_, places)| places.len()).expect("the list is not empty")
}

fn find_cause_mentions(sources: &[SourceFile], cause: &str) -> Vec<String> {
    let snake = cause.replace('-', "_");
    let camel: String = cause.split('-').map(capitalise).collect();
    let (quoted, module) = (format!("\"{cause}\""), format!("{snake}::"));
    let page = [
        format!("{CAUSE_FOLDER}{snake}.rs"),
        format!("{CAUSE_FOLDER}{snake}/"),
        format!("{CAUSE_FOLDER}scalar_cause"),
    ];
    let list = [format!("{CAUSE_FOLDER}mod.rs"), format!("{CAUSE_FOLDER}list.rs")];
    let counts = |source: &&SourceFile| {
        !source.is_test_or_example()
            && !source.path.starts_with("crates/tool/twin/")
            && !source.path.starts_with("crates/bench/campaigns/")
            // The names above.
            && !source.path.starts_with("crates/bench/checks/")
            && !page.iter().any(|page| source.path.starts_with(page.as_str()))
            && !list.contains(&source.path)
    };
    let mut places = Vec::new();
    for source in sources.iter().filter(counts) {
        for (line, words) in source.words.lines().enumerate() {
            if words.contains(&quoted) || contains_word(words, &camel) || words.contains(&module) {
                places.push(format!("{}:{}", source.path, line + 1));
            }
        }
    }
    places
}

fn capitalise(word: &str) -> String {
    let (first, rest) = word.split_at(1);
    first.to_ascii_uppercase() + rest
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cause_counts_once_a_line_and_only_outside_its_page() {
        let text = "// cutting-load\nA::CuttingLoad => \"cutting-load\",\ncutting_load::f();\nCuttingLoads";
        let at = |path: &str| SourceFile::new(path, text);
        let sources = [
            at("crates/x/src/a.rs"),
            at("crates/x/tests/a.rs"),
            at("crates/tool/twin/src/a.rs"),
            at("crates/bench/campaigns/src/a.rs"),
            at("crates/model/machine/src/effect/cutting_load.rs"),
            at("crates/model/machine/src/effect/scalar_cause/sensor.rs"),
            at("crates/model/machine/src/effect/mod.rs"),
        ];
        let (cause, places) = find_most_mentioned_cause(&sources);
        assert_eq!(cause, "cutting-load");
        assert_eq!(places, ["crates/x/src/a.rs:2", "crates/x/src/a.rs:3"]);
    }
}
