//! The draws of the card, answered by a program: `trueup` of another version, which gets the same files and is
//! judged by the same rule. With `--tsv` the answers can be compared with those of a card, draw by draw; a draw without
//! an answer is in no line, and the command ends with 1.

use std::{fs, path::Path, process::Command, process::ExitCode};

use serde_json::Value;
use trueup_campaigns::{
    hidden_effects::{
        DISTINGUISHABLE_PAIRS, ExpectedDiagnosis, HiddenCause, TestCase, draw_test_case,
        draw_test_case_with_cause_pair,
    },
    score::hidden_effect::{AnswerFinding, DiagnosisAnswer},
};

use crate::{
    compare::{DrawScore, DrawScores},
    map_seeds_in_parallel, parse_arguments,
};

/// `program TRUEUP` and the words of the card.
pub fn run(words: &[String]) -> ExitCode {
    let Some((program, asked)) =
        words.split_first().and_then(|(program, rest)| Some((program, parse_arguments(rest)?)))
    else {
        eprintln!(
            "error: program TRUEUP [--ratios 3,1,10] [--seeds 20] [--first 0] [--tsv FILE] [cause…]"
        );
        return ExitCode::from(2);
    };
    let is_selected =
        |name: &str| asked.names.is_empty() || asked.names.iter().any(|other| other == name);
    let seeds = asked.first..asked.first + asked.seeds;
    let (mut draws, mut are_all_answered) = (DrawScores::default(), true);
    let mut of_cell = |ratio: f64, name: &str, drawn: &(dyn Fn(u64) -> TestCase + Sync)| {
        if !is_selected(name) {
            return;
        }
        let answers = map_seeds_in_parallel(seeds.clone(), &|seed| {
            let challenge = drawn(seed);
            let answer = run_diagnosis(Path::new(program), &challenge);
            answer.map(|answer| {
                (
                    answer.names_all_causes(&challenge.truth),
                    answer.has_false_claim(&challenge.truth),
                )
            })
        });
        let (mut right, mut wrong) = (0, 0);
        for (seed, answer) in seeds.clone().zip(answers) {
            let (is_right, is_wrong) = match answer {
                Ok(verdict) => verdict,
                Err(complaint) => {
                    eprintln!("error: {name}, seed {seed}, no answer: {complaint}");
                    are_all_answered = false;
                    continue;
                }
            };
            right += u32::from(is_right);
            wrong += u32::from(is_wrong);
            draws.insert(
                &ratio.to_string(),
                name,
                seed,
                DrawScore::without_intervals(is_right, is_wrong, f64::NAN),
            );
        }
        println!(
            "ratio {ratio}: {name:<40} n {:>3} right {right:>3} wrong {wrong:>3}",
            asked.seeds
        );
        if let Some(path) = &asked.tsv
            && let Err(error) = fs::write(path, draws.to_tsv())
        {
            eprintln!("error: {}: {error}", path.display());
        }
    };
    for &ratio in &asked.ratios {
        for &cause in HiddenCause::ALL
            .iter()
            .filter(|cause| cause.expected_diagnosis() != ExpectedDiagnosis::Clean)
        {
            of_cell(ratio, cause.name(), &|seed| draw_test_case(cause, ratio, seed));
        }
        for &(a, b) in DISTINGUISHABLE_PAIRS {
            of_cell(ratio, &format!("{}+{}", a.name(), b.name()), &|seed| {
                draw_test_case_with_cause_pair(a, b, ratio, seed)
                    .expect("the twin's own pairs can be drawn")
            });
        }
    }
    ExitCode::from(u8::from(!are_all_answered))
}

/// Returns the columns of a finding without a physical name.
fn finding_columns(finding: &Value) -> Vec<String> {
    let both = finding["columns"].as_array().into_iter().flatten();
    let all = both.chain([&finding["column"], &finding["where"]["column"]]);
    all.filter_map(|value| value.as_str().map(String::from)).collect()
}

/// Returns what `program` says of the files of `challenge`.
fn run_diagnosis(program: &Path, challenge: &TestCase) -> Result<DiagnosisAnswer, String> {
    let folder = tempfile::tempdir().map_err(|error| error.to_string())?;
    let put = |name: &str, text: &str| {
        let path = folder.path().join(name);
        fs::write(&path, text).map(|()| path).map_err(|error| error.to_string())
    };
    let mut command = Command::new(program);
    command.args(["diagnose", "--json", "--machine"]).arg(put("machine.toml", &challenge.machine)?);
    for (number, run) in challenge.runs.iter().enumerate() {
        command.arg("--run").arg(put(&format!("run{number}.csv"), run)?);
    }
    command.arg("--holdout").arg(put("holdout.csv", &challenge.holdout)?);
    command.arg("--out").arg(folder.path().join("out"));
    let output = command.output().map_err(|error| format!("{}: {error}", program.display()))?;
    let report: Value = serde_json::from_slice(&output.stdout)
        .map_err(|_| String::from_utf8_lossy(&output.stderr).into_owned())?;
    let text = |value: &Value| value.as_str().unwrap_or_default().to_owned();
    let each = |value: &Value| value.as_array().cloned().unwrap_or_default();
    let findings = each(&report["findings"]).into_iter().map(|finding| AnswerFinding {
        cause: text(&finding["cause"]),
        columns: finding_columns(&finding),
        is_claimed: finding["claimed"] == true,
        partners: each(&finding["together_with"])
            .iter()
            .map(|partner| text(&partner["cause"]))
            .collect(),
    });
    Ok(DiagnosisAnswer { verdict: text(&report["verdict"]), findings: findings.collect() })
}
