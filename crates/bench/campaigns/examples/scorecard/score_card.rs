//! The score card as a document: `docs/scorecard.md`.

use std::collections::BTreeMap;

use trueup_campaigns::score::hidden_effect::ScoreRow;

/// All rows, as a document.
#[derive(Clone, Debug, Default)]
pub struct ScoreCard {
    /// Ratio, name, answers.
    pub rows: Vec<(f64, String, ScoreRow)>,
}

impl ScoreCard {
    /// Returns the document `docs/scorecard.md`.
    pub fn to_markdown(&self) -> String {
        let mut text = String::from(
            "# Score card of `trueup diagnose`\n\nWritten by `cargo xtask scorecard`. Each draw \
             hides an effect in what the virtual machine tool measures. Its ratio is the RMS of \
             the effect over the RMS of the noise. *Right*: every hidden cause is named and \
             claimed. A cause that these data cannot separate from another must be listed as \
             such and not claimed. For an effect without a name, structure must be reported. \
             *Wrong*: a cause is claimed that was not hidden. *Interval*: share of the hidden \
             values inside their 95 % interval, with their number. *Gain*: reduction on the \
             hold-out over the possible one, median and worst of the answers that claim every \
             hidden cause. *Harm*: draws whose hold-out is left more than 5 % worse than before \
             by what the answer compensates.\n",
        );
        if !self.rows.is_empty() {
            text += &format!("\n{}\n", self.format_totals());
        }
        let mut ratios: Vec<f64> = self.rows.iter().map(|(ratio, ..)| *ratio).collect();
        ratios.sort_by(f64::total_cmp);
        ratios.dedup();
        let is_clean = |name: &str| name.starts_with("clean");
        let clean: Vec<_> = self.rows.iter().filter(|(_, name, _)| is_clean(name)).collect();
        if !clean.is_empty() {
            text += "\n## False alarms on noise alone\n\n| noise | runs | false alarms | share |\n\
                     |---|---|---|---|\n";
            let (mut alarms, mut runs) = (0, 0);
            for (_, name, row) in &clean {
                let wrong = row.scores.iter().filter(|score| !score.is_right).count();
                text += &format_alarm_rate_row(name, row.scores.len(), wrong);
                (alarms, runs) = (alarms + wrong, runs + row.scores.len());
            }
            text += &format_alarm_rate_row("both", runs, alarms);
        }
        for ratio in ratios {
            let is_here =
                |(there, name, _): &&(f64, String, ScoreRow)| *there == ratio && !is_clean(name);
            let rows: Vec<_> = self.rows.iter().filter(is_here).collect();
            for (title, is_pair) in [("single effects", false), ("pairs", true)] {
                let rows: Vec<_> =
                    rows.iter().filter(|(_, name, _)| name.contains('+') == is_pair).collect();
                if rows.is_empty() {
                    continue;
                }
                text += &format!(
                    "\n## Ratio {ratio}, {title}\n\n| hidden | draws | right | wrong | interval | \
                     gain | worst | harm |\n|---|---|---|---|---|---|---|---|\n"
                );
                let mut all = ScoreRow::default();
                for (_, name, row) in rows {
                    text += &format_table_row(row, name);
                    all.scores.extend(row.scores.iter().cloned());
                }
                text += &format_table_row(&all, "all");
            }
            text += &format_confusion_table(ratio, &rows);
        }
        text
    }

    /// Returns all draws of all rows, in a sentence.
    pub fn format_totals(&self) -> String {
        let scores = || self.rows.iter().flat_map(|(.., row)| &row.scores);
        let draws = scores().count();
        let right = scores().filter(|score| score.is_right).count();
        let wrong = scores().filter(|score| score.is_wrong).count();
        let harmed = scores().filter(|score| score.is_harmed).count();
        let percent = |count: usize| 100.0 * count as f64 / draws.max(1) as f64;
        format!(
            "Of all {draws} draws {right} are right ({:.1} %), {wrong} have a false name ({:.2} %), {harmed} \
             do harm.",
            percent(right),
            percent(wrong)
        )
    }
}

fn format_alarm_rate_row(name: &str, runs: usize, alarms: usize) -> String {
    let percent = 100.0 * alarms as f64 / runs.max(1) as f64;
    format!("| {name} | {runs} | {alarms} | {percent:.2} % |\n")
}

/// Returns what was named instead, or next to: a line for each effect with anything but one right name.
fn format_confusion_table(ratio: f64, rows: &[&(f64, String, ScoreRow)]) -> String {
    let mut text = String::new();
    for (_, name, row) in rows.iter().filter(|(_, name, _)| !name.contains('+')) {
        let mut named: BTreeMap<String, usize> = BTreeMap::new();
        for score in &row.scores {
            let mut answers: Vec<String> = score.named.clone();
            answers.extend(score.unclaimed.iter().map(|name| format!("({name})")));
            if answers.is_empty() {
                answers.push(format!("*{}*", score.verdict.name()));
            }
            for answer in answers {
                *named.entry(answer).or_default() += 1;
            }
        }
        let mut named: Vec<(String, usize)> = named.into_iter().collect();
        named.sort_by(|a, b| b.1.cmp(&a.1).then(a.0.cmp(&b.0)));
        let named: Vec<String> =
            named.into_iter().map(|(name, count)| format!("{name} {count}")).collect();
        text += &format!("| {name} | {} |\n", named.join(", "));
    }
    if text.is_empty() {
        return text;
    }
    format!(
        "\n## Ratio {ratio}, confusion\n\nHow often each cause was claimed; in brackets: named, but \
         not claimed.\n\n| hidden | answered |\n|---|---|\n{text}"
    )
}

fn format_table_row(row: &ScoreRow, name: &str) -> String {
    let (median, worst) = row.gain();
    let (within, count) = row.interval_coverage();
    let number = |value: f64| if value.is_nan() { "–".into() } else { format!("{value:.3}") };
    let within =
        if count == 0 { "–".to_string() } else { format!("{:.0} % of {count}", 100.0 * within) };
    format!(
        "| {name} | {} | {:.0} % | {:.0} % | {within} | {} | {} | {} |\n",
        row.scores.len(),
        100.0 * row.correct_fraction(),
        100.0 * row.false_claim_fraction(),
        number(median),
        number(worst),
        row.count_degraded_hold_outs()
    )
}
