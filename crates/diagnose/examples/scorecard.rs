//! The score card: every effect of the twin at a ratio of effect to noise, drawn from seeds, and what
//! the diagnosis makes of it. The drawn truth is read only by the check.
//!
//! ```text
//! cargo run --release -p trueup-diagnose --example scorecard -- \
//!     [--ratios 3,1,10] [--seeds 20] [--few 20] [--clean 150] [--first 0] [--out docs/scorecard.md] \
//!     [--each] [cause…|pairs|first+second]
//! ```
//!
//! `--seeds` counts at ratio 3, `--few` at the others, `--clean` for noise alone. `--each` prints every
//! answer. The file is written anew after each row.

use std::{collections::BTreeMap, env, fs, path::PathBuf, process::ExitCode, thread};

#[path = "../tests/score/mod.rs"]
mod score;

use score::{Row, Score, answer, score};
use trueup_twin::hidden::{Expected, Hidden, PAIRS, draw, draw_pair};

/// What is asked for.
struct Asked {
    ratios: Vec<f64>,
    seeds: u64,
    few: u64,
    clean: u64,
    first: u64,
    out: Option<PathBuf>,
    each: bool,
    wanted: Vec<String>,
}

fn asked() -> Option<Asked> {
    let mut it = Asked {
        ratios: vec![3.0, 1.0, 10.0],
        seeds: 20,
        few: 20,
        clean: 150,
        first: 0,
        out: None,
        each: false,
        wanted: Vec::new(),
    };
    let mut words = env::args().skip(1);
    while let Some(word) = words.next() {
        match word.as_str() {
            "--ratios" => {
                let list = words.next()?;
                it.ratios = list.split(',').map(|word| word.parse().ok()).collect::<Option<_>>()?;
            }
            "--seeds" => it.seeds = words.next()?.parse().ok()?,
            "--few" => it.few = words.next()?.parse().ok()?,
            "--clean" => it.clean = words.next()?.parse().ok()?,
            "--first" => it.first = words.next()?.parse().ok()?,
            "--out" => it.out = Some(words.next()?.into()),
            "--each" => it.each = true,
            _ if word.starts_with('-') => return None,
            _ => it.wanted.push(word),
        }
    }
    Some(it)
}

/// The answers to `seeds`, in their order, on all cores.
fn row(seeds: std::ops::Range<u64>, of: &(dyn Fn(u64) -> Score + Sync)) -> Row {
    let cores = thread::available_parallelism().map_or(1, usize::from) as u64;
    let mut scores: Vec<(u64, Score)> = thread::scope(|scope| {
        let workers: Vec<_> = (0..cores)
            .map(|core| {
                let own = seeds.clone().filter(move |seed| seed % cores == core);
                scope.spawn(move || own.map(|seed| (seed, of(seed))).collect::<Vec<_>>())
            })
            .collect();
        workers
            .into_iter()
            .flat_map(|worker| worker.join().expect("a diagnosis does not panic"))
            .collect()
    });
    scores.sort_by_key(|(seed, _)| *seed);
    Row { scores: scores.into_iter().map(|(_, score)| score).collect() }
}

/// All rows, as a document.
#[derive(Clone, Debug, Default)]
struct Card {
    /// Ratio, name, answers.
    rows: Vec<(f64, String, Row)>,
}

impl Card {
    /// The document `docs/scorecard.md`.
    fn markdown(&self) -> String {
        let mut text = String::from(
            "# Score card of `trueup diagnose`\n\nWritten by `cargo xtask scorecard`. Each draw hides \
             an effect in what the virtual machine tool measures; ratio: RMS of the effect over RMS \
             of the noise. *right*: every hidden cause is named and claimed (or listed as one that \
             these data cannot tell apart, and then not claimed); for an effect without a name: \
             structure is reported. *wrong*: a cause is claimed that was not hidden. *interval*: \
             share of the hidden values inside their 95 % interval, of so many. *gain*: reduction on \
             the hold-out over the possible one, median and worst of the answers that claim every \
             hidden cause.\n",
        );
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
                text += &share_line(name, row.scores.len(), wrong);
                (alarms, runs) = (alarms + wrong, runs + row.scores.len());
            }
            text += &share_line("both", runs, alarms);
        }
        for ratio in ratios {
            let is_here =
                |(there, name, _): &&(f64, String, Row)| *there == ratio && !is_clean(name);
            let rows: Vec<_> = self.rows.iter().filter(is_here).collect();
            for (title, is_pair) in [("single effects", false), ("pairs", true)] {
                let rows: Vec<_> =
                    rows.iter().filter(|(_, name, _)| name.contains('+') == is_pair).collect();
                if rows.is_empty() {
                    continue;
                }
                text += &format!(
                    "\n## Ratio {ratio}, {title}\n\n| hidden | draws | right | wrong | interval | \
                     gain | worst |\n|---|---|---|---|---|---|---|\n"
                );
                let mut all = Row::default();
                for (_, name, row) in rows {
                    text += &table_line(row, name);
                    all.scores.extend(row.scores.iter().cloned());
                }
                text += &table_line(&all, "all");
            }
            text += &confusion(ratio, &rows);
        }
        text
    }
}

fn share_line(name: &str, runs: usize, alarms: usize) -> String {
    let percent = 100.0 * alarms as f64 / runs.max(1) as f64;
    format!("| {name} | {runs} | {alarms} | {percent:.2} % |\n")
}

/// What was named instead, or beside: a line for each effect with anything but one right name.
fn confusion(ratio: f64, rows: &[&(f64, String, Row)]) -> String {
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

fn table_line(row: &Row, name: &str) -> String {
    let (median, worst) = row.gain();
    let (within, count) = row.within();
    let number = |value: f64| if value.is_nan() { "–".into() } else { format!("{value:.3}") };
    let within =
        if count == 0 { "–".to_string() } else { format!("{:.0} % of {count}", 100.0 * within) };
    format!(
        "| {name} | {} | {:.0} % | {:.0} % | {within} | {} | {} |\n",
        row.scores.len(),
        100.0 * row.right(),
        100.0 * row.wrong(),
        number(median),
        number(worst)
    )
}

fn main() -> ExitCode {
    let Some(asked) = asked() else {
        eprintln!("error: see the head of examples/scorecard.rs for what may be asked");
        return ExitCode::from(2);
    };
    let is_wanted =
        |name: &str| asked.wanted.is_empty() || asked.wanted.iter().any(|there| there == name);
    let mut card = Card::default();
    let mut done = |ratio: f64, name: String, row: Row| {
        println!("ratio {ratio}: {}", row.line(&name));
        if asked.each {
            for (seed, score) in row.scores.iter().enumerate() {
                println!("    seed {}: {score}", asked.first + seed as u64);
            }
        }
        card.rows.push((ratio, name, row));
        if let Some(path) = &asked.out
            && let Err(error) = fs::write(path, card.markdown())
        {
            eprintln!("error: {}: {error}", path.display());
        }
    };
    let drawn = |cause: Hidden, ratio: f64, count: u64| {
        row(asked.first..asked.first + count, &|seed| {
            let challenge = draw(cause, ratio, seed);
            score(&challenge, &answer(&challenge))
        })
    };
    for (number, &ratio) in asked.ratios.iter().enumerate() {
        let seeds = if ratio == 3.0 { asked.seeds } else { asked.few };
        for &cause in Hidden::ALL {
            if is_wanted(cause.name()) && cause.expected() != Expected::Clean {
                done(ratio, cause.name().into(), drawn(cause, ratio, seeds));
            }
        }
        for &(a, b) in PAIRS {
            let both = format!("{}+{}", a.name(), b.name());
            if is_wanted("pairs") || is_wanted(&both) {
                let row = row(asked.first..asked.first + seeds, &|seed| {
                    let challenge =
                        draw_pair(a, b, ratio, seed).expect("the twin's own pairs can be drawn");
                    score(&challenge, &answer(&challenge))
                });
                done(ratio, both, row);
            }
        }
        // Noise alone has no ratio.
        for &cause in Hidden::ALL.iter().filter(|_| number == 0) {
            if is_wanted(cause.name()) && cause.expected() == Expected::Clean {
                done(ratio, cause.name().into(), drawn(cause, ratio, asked.clean));
            }
        }
    }
    ExitCode::SUCCESS
}
