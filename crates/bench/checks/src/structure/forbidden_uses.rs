//! The walls between the code that hides an effect and the code that finds it.
//!
//! They share no model, or a hidden effect that is found proves nothing. A dependency of a crate does not show this
//! where one crate both draws cases and scores the answers.

use super::source_file::{SourceFile, contains_word};

/// The drawing of cases.
const CAMPAIGNS_SOURCE_FOLDER: &str = "crates/bench/campaigns/src/";
/// The virtual machine tool.
const TWIN_SOURCE_FOLDER: &str = "crates/tool/twin/src/";
/// The part of [`CAMPAIGNS_SOURCE_FOLDER`] that scores answers.
const SCORE_SOURCE_FOLDER: &str = "crates/bench/campaigns/src/score/";

/// The folder of a wall, a name that its code may not use, and the files or folders in it that may.
const FORBIDDEN_DEPENDENCIES: &[(&str, &str, &[&str])] = &[
    (TWIN_SOURCE_FOLDER, "trueup_machine", &[]),
    (TWIN_SOURCE_FOLDER, "trueup_diagnose", &[]),
    (CAMPAIGNS_SOURCE_FOLDER, "trueup_diagnose", &[SCORE_SOURCE_FOLDER]),
    (CAMPAIGNS_SOURCE_FOLDER, "score", &[SCORE_SOURCE_FOLDER, "crates/bench/campaigns/src/lib.rs"]),
    (
        CAMPAIGNS_SOURCE_FOLDER,
        "trueup_machine",
        &[
            SCORE_SOURCE_FOLDER,
            "crates/bench/campaigns/src/faulty_machine/",
            "crates/bench/campaigns/src/run_file.rs",
        ],
    ),
];

/// Returns the places that use a name behind a wall, as `file:line: name`.
pub(crate) fn find_forbidden_uses(sources: &[SourceFile]) -> Vec<String> {
    let mut found = Vec::new();
    for (folder, name, exceptions) in FORBIDDEN_DEPENDENCIES {
        let is_behind = |source: &&SourceFile| {
            source.path.starts_with(folder)
                && !exceptions.iter().any(|path| source.path.starts_with(path))
        };
        for source in sources.iter().filter(is_behind) {
            let lines = source.code.lines().enumerate();
            let uses = lines.filter(|(_, line)| contains_word(line, name));
            found.extend(uses.map(|(line, _)| format!("{}:{}: {name}", source.path, line + 1)));
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_score_knows_the_diagnosis() {
        let text = "//! [`trueup_diagnose`]\nuse trueup_diagnose::Report;\n";
        let found = find_forbidden_uses(&[
            SourceFile::new("crates/bench/campaigns/src/score/answer_key.rs", text),
            SourceFile::new("crates/bench/campaigns/src/physical_faults/plant.rs", text),
            SourceFile::new("crates/bench/campaigns/examples/year.rs", text),
        ]);
        assert_eq!(
            found,
            ["crates/bench/campaigns/src/physical_faults/plant.rs:2: trueup_diagnose"]
        );
    }

    #[test]
    fn a_drawing_that_uses_the_score_is_found() {
        let source = SourceFile::new(
            "crates/bench/campaigns/src/simulated_month.rs",
            "use crate::score::key::AnswerKey;\nlet scored = 1;\n",
        );
        assert_eq!(
            find_forbidden_uses(&[source]),
            ["crates/bench/campaigns/src/simulated_month.rs:1: score"]
        );
    }
}
