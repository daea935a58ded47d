//! Two score cards compared draw by draw: both saw the same files, so that what differs is due to the
//! diagnosis alone.
//!
//! In each cell (a ratio and what is hidden) b draws were right and are not now, c are right now and
//! were not. If the two cards were equally good, each such draw would fall to either side like a coin:
//! McNemar's test, here exact,
//!
//! ```text
//! p = min(1, 2·Σ_{k ≤ min(b, c)} C(b + c, k)/2^(b + c))
//! ```
//!
//! and likewise of the draws with a wrong name, and of those with harm where both cards record it. A cell
//! with more losses than gains and p below 1 % is worse, and the command ends with 1. The limit holds for each cell by
//! itself, without Bonferroni's correction: of 200 cells whose answers change by chance alone about one is called worse
//! too often rather than one overlooked.

use std::{collections::BTreeMap, fs, process::ExitCode};

use trueup_campaigns::{hidden_effects::HiddenCause, score::hidden_effect::ScoreRow};

/// Below it a cell is worse.
const SIGNIFICANCE_LEVEL: f64 = 0.01;

/// The score of one draw.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DrawScore {
    is_right: bool,
    is_wrong: bool,
    /// True values inside their intervals, and how many intervals there were.
    within: (usize, usize),
    /// Share of the possible gain on the hold-out; NaN: none to be had, or not all claimed.
    gain: f64,
    /// None: the card does not record it.
    is_harmed: Option<bool>,
}

impl DrawScore {
    /// Right or not, with a wrong name or not, and its gain; no intervals.
    pub fn without_intervals(is_right: bool, is_wrong: bool, gain: f64) -> Self {
        Self { is_right, is_wrong, within: (0, 0), gain, is_harmed: None }
    }
}

/// A card draw by draw: by ratio and what is hidden, then by seed.
#[derive(Clone, Debug, Default)]
pub struct DrawScores {
    cells: BTreeMap<(String, String), BTreeMap<u64, DrawScore>>,
}

const TSV_HEADER: &str = "ratio\thidden\tseed\tright\twrong\tinside\tintervals\tgain\tharm";
/// The header of a card that does not record harm.
const TSV_HEADER_WITHOUT_HARM: &str = "ratio\thidden\tseed\tright\twrong\tinside\tintervals\tgain";

impl DrawScores {
    /// Adds `row`, whose seeds begin at `first`.
    pub fn add_row(&mut self, ratio: f64, hidden: &str, first: u64, row: &ScoreRow) {
        let cell = self.cells.entry((ratio.to_string(), hidden.to_string())).or_default();
        for (seed, score) in (first..).zip(&row.scores) {
            let inside =
                score.intervals.iter().filter(|interval| interval.contains_true_value(1.0)).count();
            let draw = DrawScore {
                is_right: score.is_right,
                is_wrong: score.is_wrong,
                within: (inside, score.intervals.len()),
                gain: score.share_of_gain,
                is_harmed: Some(score.is_harmed),
            };
            cell.insert(seed, draw);
        }
    }

    /// Adds `draw` of `seed` to the cell of a tier (in the ratio's place) and a name.
    pub fn insert(&mut self, tier: &str, name: &str, seed: u64, draw: DrawScore) {
        self.cells.entry((tier.into(), name.into())).or_default().insert(seed, draw);
    }

    /// Returns one line a draw, tabs between.
    pub fn to_tsv(&self) -> String {
        let mut text = format!("{TSV_HEADER}\n");
        for ((ratio, hidden), cell) in &self.cells {
            for (seed, draw) in cell {
                let DrawScore { is_right, is_wrong, within: (inside, intervals), gain, is_harmed } =
                    draw;
                let (right, wrong) = (u8::from(*is_right), u8::from(*is_wrong));
                let harm = is_harmed.map_or("-", |is_harmed| if is_harmed { "1" } else { "0" });
                text += &format!(
                    "{ratio}\t{hidden}\t{seed}\t{right}\t{wrong}\t{inside}\t{intervals}\t{gain:.4}\t{harm}\n"
                );
            }
        }
        text
    }

    /// Reads what [`Self::to_tsv`] writes, or what `--each` prints.
    fn parse(text: &str) -> Option<Self> {
        let is_tsv = text.starts_with(TSV_HEADER_WITHOUT_HARM);
        let mut draws = Self::default();
        let mut ratio = "";
        for line in text.lines().skip(usize::from(is_tsv)) {
            let ((ratio, hidden), (seed, draw)) = if is_tsv {
                parse_tsv_line(line)?
            } else if let Some(of_row) = line.strip_prefix("ratio ") {
                ratio = of_row.split_once(':')?.0;
                continue;
            } else if let Some(of_seed) = line.strip_prefix("    seed ") {
                let (seed, hidden, draw) = parse_text_line(of_seed)?;
                ((ratio, hidden), (seed, draw))
            } else {
                continue;
            };
            let cell = draws.cells.entry((ratio.to_string(), hidden.to_string())).or_default();
            cell.insert(seed, draw);
        }
        (!draws.cells.is_empty()).then_some(draws)
    }
}

/// Ratio and what is hidden, seed and draw.
type ScoreRecord<'t> = ((&'t str, &'t str), (u64, DrawScore));

fn parse_tsv_line(line: &str) -> Option<ScoreRecord<'_>> {
    let cells: Vec<&str> = line.split('\t').collect();
    let (&[ratio, hidden, seed, right, wrong, inside, intervals, gain]
    | &[ratio, hidden, seed, right, wrong, inside, intervals, gain, _]) = &cells[..]
    else {
        return None;
    };
    let draw = DrawScore {
        is_right: right == "1",
        is_wrong: wrong == "1",
        within: (inside.parse().ok()?, intervals.parse().ok()?),
        gain: gain.parse().ok()?,
        is_harmed: cells.get(8).and_then(|&harm| (harm != "-").then_some(harm == "1")),
    };
    Some(((ratio, hidden), (seed.parse().ok()?, draw)))
}

/// `7: sensor-gain (effect 3.0 times the noise): right and wrong, explained, claimed …, named …, 0.998
/// of the possible gain, sensor-gain gain inside`.
fn parse_text_line(line: &str) -> Option<(u64, &str, DrawScore)> {
    let (seed, rest) = line.split_once(": ")?;
    let (hidden, rest) = rest.split_once(" (effect ")?;
    let (_, rest) = rest.split_once("): ")?;
    let parts: Vec<&str> =
        rest.split(", ").take_while(|part| !part.starts_with("open: ")).collect();
    let answer = parts.first()?;
    let claimed = parts.iter().find_map(|part| part.strip_prefix("claimed "))?;
    // A cause that was given its name later is right by that name, in an older card too.
    let renamed = HiddenCause::ALL
        .iter()
        .find(|cause| cause.name() == hidden && cause.expected_name() != hidden);
    let is_right = match renamed {
        Some(cause) => claimed.split('+').any(|name| name == cause.expected_name()),
        None => answer.starts_with("right"),
    };
    let ends = |end: &str| parts.iter().filter(|part| part.ends_with(end)).count();
    let inside = ends(" inside");
    let gain = parts.iter().find_map(|part| part.strip_suffix(" of the possible gain"));
    let draw = DrawScore {
        is_right,
        is_wrong: answer.ends_with("wrong"),
        within: (inside, inside + ends(" OUTSIDE")),
        gain: gain.map_or(Some(f64::NAN), |gain| gain.parse().ok())?,
        // What was printed without this word may be of before it was there.
        is_harmed: None,
    };
    Some((seed.parse().ok()?, hidden, draw))
}

/// McNemar's exact p of `b` draws that changed one way and `c` the other.
fn mcnemar_p_value(b: usize, c: usize) -> f64 {
    let all = b + c;
    // C(n, k)/2ⁿ, from one k to the next.
    let mut term = 0.5_f64.powi(i32::try_from(all).unwrap_or(i32::MAX));
    let mut sum = 0.0;
    for k in 0..=b.min(c) {
        sum += term;
        term *= (all - k) as f64 / (k + 1) as f64;
    }
    (2.0 * sum).min(1.0)
}

/// The draws of a cell that lost and gained one property.
struct DiscordantDraws {
    lost: Vec<u64>,
    gained: Vec<u64>,
}

impl DiscordantDraws {
    fn from_comparison(
        before: &BTreeMap<u64, DrawScore>,
        after: &BTreeMap<u64, DrawScore>,
        is_good: fn(&DrawScore) -> Option<bool>,
    ) -> Self {
        let seeds = |was: bool| {
            let both = before
                .iter()
                .filter_map(|(seed, one)| Some((*seed, is_good(one)?, is_good(after.get(seed)?)?)));
            let changed = both.filter(|(_, one, other)| one != other);
            changed.filter(|(_, one, _)| *one == was).map(|(seed, ..)| seed).collect()
        };
        Self { lost: seeds(true), gained: seeds(false) }
    }

    fn p_value(&self) -> f64 {
        mcnemar_p_value(self.lost.len(), self.gained.len())
    }

    fn is_worse(&self) -> bool {
        self.lost.len() > self.gained.len() && self.p_value() < SIGNIFICANCE_LEVEL
    }
}

/// `compare BEFORE AFTER`.
pub fn run(words: &[String]) -> ExitCode {
    let [before, after] = words else {
        eprintln!("error: give two cards: what --tsv wrote, or what --each printed");
        return ExitCode::from(2);
    };
    let read = |path: &String| {
        let text = fs::read_to_string(path).map_err(|error| format!("{path}: {error}"))?;
        DrawScores::parse(&text)
            .ok_or_else(|| format!("{path}: has no draws, or a line that is none"))
    };
    let (before, after) = match (read(before), read(after)) {
        (Ok(before), Ok(after)) => (before, after),
        (Err(error), _) | (_, Err(error)) => {
            eprintln!("error: {error}");
            return ExitCode::from(2);
        }
    };
    let (mut worse, mut pairs, mut cells) = (0, 0, 0);
    for ((ratio, hidden), old) in &before.cells {
        let Some(new) = after.cells.get(&(ratio.clone(), hidden.clone())) else { continue };
        cells += 1;
        pairs += old.keys().filter(|seed| new.contains_key(seed)).count();
        let changes = [
            ("right", DiscordantDraws::from_comparison(old, new, |draw| Some(draw.is_right))),
            (
                "without a wrong name",
                DiscordantDraws::from_comparison(old, new, |draw| Some(!draw.is_wrong)),
            ),
            (
                "without harm",
                DiscordantDraws::from_comparison(old, new, |draw| {
                    draw.is_harmed.map(|is_harmed| !is_harmed)
                }),
            ),
        ];
        for (what, change) in changes {
            if change.lost.is_empty() && change.gained.is_empty() {
                continue;
            }
            let verdict = if change.is_worse() { "WORSE" } else { "" };
            worse += usize::from(change.is_worse());
            println!(
                "ratio {ratio} {hidden}, {what}: lost seeds {:?}, gained seeds {:?}, p {:.4} {verdict}",
                change.lost,
                change.gained,
                change.p_value()
            );
        }
    }
    if pairs == 0 {
        eprintln!("error: the two cards have no draw in common");
        return ExitCode::from(2);
    }
    println!(
        "{pairs} draws in {cells} cells; worse at {} % in a cell: {worse}",
        100.0 * SIGNIFICANCE_LEVEL
    );
    ExitCode::from(u8::from(worse > 0))
}
