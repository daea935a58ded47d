//! The flow: a record with readings, what is known, and a machine file that follows.

use std::borrow::Cow;

use serde::Serialize;
use trueup_machine::{
    BadInput, Location, MachineFile, RunFile,
    applied::{Applied, Factor, Unaided, applied, decisive_record},
    file::Quantity,
};

use crate::{
    bank::{Bank, ENOUGH},
    constants::{self, Constant, Sensitivity},
    filter::Fate,
    limits::{Limits, times},
    memory::{Before, Change, Memory, SCHEMA, hash},
    readings::{self, Order, Reading},
    step,
};

/// A constant that has moved by less than this share of itself is written as it was.
const SAME: f64 = 1e-3;
/// What is believed before the first reading, one standard deviation: a constant is known to a quarter (what a
/// maker says of growth is no better), the zero to 5 µm, which any tool setter keeps.
const SHARE: f64 = 0.25;
const ZERO_UM: f64 = 5.0;
/// What a probe repeats to where nobody says, in µm: the last digit of the papers' indicator.
const NOISE_UM: f64 = 1.0;
/// A change of a constant by this share, from readings of an engaged bridge alone, may as well be a CNC that applies the
/// offsets by half, twice, not at all or with the wrong sign: these look like changes by 0.5, −1, 1 and 2.
const AS_A_CNC: f64 = 0.4;

/// What became of a reading.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Taken {
    /// The row of the record, from 1, without the header.
    pub row: usize,
    /// The reading in µm.
    pub measured_um: f64,
    /// What was applied then foresaw, in µm; `None` where the row does not say enough.
    pub foreseen_um: Option<f64>,
    /// Whether it was used.
    pub used: bool,
    /// Why not, or what else is to be told of it.
    pub reason: Option<String>,
}

/// What a record has taught.
#[derive(Clone, Debug)]
pub struct Learned {
    /// The machine file with what was learned.
    pub machine: String,
    /// What is known now.
    pub memory: Memory,
    /// Each reading, in its order.
    pub readings: Vec<Taken>,
    /// Half the 95 % interval of each constant, in its unit.
    pub half_widths: Vec<f64>,
    /// Whether a bound was reached.
    pub is_held: bool,
    /// Sentences for the user.
    pub notes: Vec<String>,
}

/// Learns from `run`, beside the user's own machine file `source` (at `path`) and what is known from before.
///
/// # Errors
/// `source` is no machine file, or has no constant that can follow; the run measures nothing, or what it
/// measures was learned from before; `memory` is of another quantity.
pub fn learn(
    source: &str,
    path: &std::path::Path,
    run: &RunFile,
    wanted: Option<Quantity>,
    memory: Option<Memory>,
    limits: &Limits,
) -> Result<Learned, BadInput> {
    let machine = MachineFile::parse(source, path)?;
    let bad = |rule: String| BadInput::new(Location::start_of(path), rule);
    let mut notes = Vec::new();
    let quantity = constants::measured(run, wanted)?;
    let base = hash(source.bytes());
    let memory = memory.filter(|memory| {
        let is_same = memory.base == base;
        if !is_same {
            let file = path.display();
            notes.push(format!("{file} was changed by hand: learning begins anew from it"));
        }
        is_same
    });
    let mut memory = match memory {
        Some(memory) if constants::named(&memory.quantity) == Some(quantity) => memory,
        Some(memory) => {
            let rule = format!(
                "was learned for {}, and the record measures {}: keep a file for each",
                memory.quantity,
                quantity.name()
            );
            return Err(bad(rule));
        }
        None => {
            let all = constants::constants(&machine, quantity);
            if all.is_empty() {
                let rule = format!(
                    "has no constant other than 0 by which {} is multiplied, so nothing can follow",
                    quantity.name()
                );
                return Err(bad(rule));
            }
            let noise_um = machine.instrument_um.map_or(NOISE_UM, |um| um / 2.0);
            Memory {
                schema: SCHEMA,
                base,
                quantity: quantity.name().into(),
                applied: vec![0.0; all.len() + 1],
                bank: Bank::new(&prior(all.len()), noise_um),
                constants: all,
                last_s: None,
                records: Vec::new(),
                readings: Vec::new(),
                recent: Vec::new(),
                is_applied_once: false,
                changes: Vec::new(),
            }
        }
    };
    let before = written(source, &machine, quantity, &memory).unwrap_or_else(|| source.into());
    // What a bridge applied meanwhile came from the file as it was written before.
    let ran = MachineFile::parse(&before, path)?;
    let (run, told) = Unaided::of(Cow::Borrowed(run), Some(&ran), Some(quantity))?;
    notes.extend(told);
    let is_factor_known = factor_of(&run, &ran, quantity, &mut memory)?;
    let record = readings::of(&run, quantity)?;
    let fingerprint = readings::fingerprint(&record);
    let is_new = |it: &&Reading| !memory.knows_reading(it.identity);
    let new: Vec<Reading> = record.iter().filter(is_new).copied().collect();
    let name = format!("measured_{}_um", quantity.name());
    if memory.knows(fingerprint) || new.is_empty() {
        let rule = "was learned from before: each record counts once";
        return Err(run.bad(record[0].row, &name, rule));
    }
    if new.len() < record.len() {
        notes.push(format!(
            "{} of {} readings were learned from before and are not counted again",
            record.len() - new.len(),
            record.len()
        ));
    }
    match readings::order(memory.last_s, &new) {
        Order::Later => {}
        Order::Anew => notes.push(
            "The clock of this record begins before the last reading that was learned from: it is taken as a later \
             day. If it is an older one, take the change back (--undo)."
                .into(),
        ),
        Order::Earlier => {
            let rule = format!(
                "{} is before the last reading that was learned from ({}): give the records in the order in which \
                 they were taken",
                new[0].time_s.unwrap_or(f64::NAN),
                memory.last_s.unwrap_or(f64::NAN)
            );
            return Err(run.bad(new[0].row, "time_s", rule));
        }
    }
    let sensitivity = Sensitivity::of(source, &memory.constants, &run, quantity)?;
    let known = Before { bank: memory.bank.clone(), applied: memory.applied.clone() };
    let mut readings = Vec::new();
    let (mut is_held, mut forbids) = (false, None);
    for reading in &new {
        let (taken, held) = one(reading, &sensitivity, &mut memory, limits, is_factor_known);
        readings.push(taken);
        is_held |= held.is_bound;
        forbids = held.forbids;
        memory.remember_reading(reading.identity);
    }
    memory.remember(fingerprint);
    if forbids.is_some() {
        // Nor the steps on the way there.
        memory.applied.clone_from(&known.applied);
    }
    let after = written(source, &machine, quantity, &memory)
        .ok_or_else(|| bad("cannot be written with other constants".into()))?;
    MachineFile::parse(&after, path)?;
    let is_bound = is_held;
    is_held |= forbids.is_some();
    notes.push(forbids.unwrap_or_else(|| believed(&memory)));
    if is_bound {
        notes.push(format!(
            "A bound was reached ({:.0} % of a constant, or {} µm together): the machine is no longer the one \
             that was measured. Measure it again: trueup fit, or trueup diagnose.",
            100.0 * limits.share,
            limits.total_um
        ));
    }
    log(&mut memory, &before, &after, &run, quantity, known);
    let half = memory.bank.half_widths();
    let half_widths = memory.constants.iter().zip(&half[1..]);
    let half_widths = half_widths.map(|(it, half)| (it.believed * half).abs()).collect();
    Ok(Learned { machine: after, memory, readings, half_widths, is_held, notes })
}

fn prior(constants: usize) -> Vec<f64> {
    let shares = std::iter::repeat_n(SHARE, constants);
    std::iter::once(ZERO_UM).chain(shares).collect()
}

/// Whether the record, or one before it, has shown that the CNC applies the offsets of the bridge once; a record without a
/// bridge needs not.
///
/// # Errors
/// It applies them otherwise.
fn factor_of(
    run: &Unaided<'_>,
    ran: &trueup_machine::Machine,
    quantity: Quantity,
    memory: &mut Memory,
) -> Result<bool, BadInput> {
    match applied(std::slice::from_ref(run), Some(ran), quantity) {
        Applied::Nothing => return Ok(true),
        Applied::Once(_) => memory.is_applied_once = true,
        Applied::Unknown(_) => {}
        Applied::Otherwise(factor) => {
            let rule = format!("{} {}", factor.sentence(), Factor::where_to_look().join(" "));
            return Err(BadInput::new(Location::start_of(run.path()), rule));
        }
    }
    Ok(memory.is_applied_once)
}

/// What held a reading back.
#[derive(Default)]
struct Held {
    /// A bound was reached.
    is_bound: bool,
    /// Why what was learned is not applied, a sentence.
    forbids: Option<String>,
}

/// What one reading does, and what held it.
fn one(
    reading: &Reading,
    sensitivity: &Sensitivity,
    memory: &mut Memory,
    limits: &Limits,
    is_factor_known: bool,
) -> (Taken, Held) {
    let (g, believed_um) = (&sensitivity.um[reading.row], sensitivity.believed_um[reading.row]);
    let mut taken = Taken {
        row: reading.row + 1,
        measured_um: reading.um,
        foreseen_um: None,
        used: false,
        reason: None,
    };
    if !believed_um.is_finite() || g.iter().any(|g| !g.is_finite()) {
        taken.reason = Some(
            "refused: the row does not say enough for the model (a missing temperature?)".into(),
        );
        return (taken, Held::default());
    }
    memory.bank.age(readings::between_s(memory.last_s, reading.time_s));
    memory.last_s = reading.time_s.or(memory.last_s);
    taken.foreseen_um = Some(believed_um + times(g, &memory.applied));
    match memory.bank.take(g, reading.um - believed_um) {
        Fate::Taken => taken.used = true,
        Fate::Refused { off_um, deviations } => {
            taken.reason = Some(format!(
                "refused: {off_um:+.1} µm from what was foreseen, {deviations:.0} times what a reading may \
                 differ by"
            ));
        }
        Fate::Changed => {
            taken.used = true;
            taken.reason = Some(
                "used, with those before it that were refused: four of six stand on one side, so the \
                 machine has changed"
                    .into(),
            );
        }
    }
    let wanted = memory.bank.believed().unwrap_or_else(|| vec![0.0; g.len()]);
    let (wanted, is_bound) = limits.held(&wanted, &sensitivity.um);
    step::remember(&mut memory.recent, g, reading.um - believed_um);
    let forbids = forbidden(memory, &wanted, is_factor_known);
    if forbids.is_none() {
        memory.applied = limits.step(&memory.applied, &wanted, g);
    }
    (taken, Held { is_bound, forbids })
}

/// Why `wanted` is not to be applied, in a sentence.
fn forbidden(memory: &Memory, wanted: &[f64], is_factor_known: bool) -> Option<String> {
    let moves = |(to, from): (&f64, &f64)| (to - from).abs() > SAME;
    if !wanted.iter().zip(&memory.applied).any(moves) {
        return None;
    }
    let (prior, noise_um) = (prior(memory.constants.len()), memory.bank.noise_um());
    if let Some(um) = step::step_um(&memory.recent, &memory.applied, &prior, noise_um) {
        return Some(format!(
            "Nothing is applied: a step of the zero by {um:+.1} µm explains the readings as well. Was the reference touched \
             off anew, or moved? Then set the reference (Zero), and move the .learn.json of the output away: learning \
             begins anew."
        ));
    }
    let is_as_a_cnc = wanted[1..].iter().any(|share| share.abs() > AS_A_CNC);
    (is_as_a_cnc && !is_factor_known).then(|| format!("Nothing is applied. {}", decisive_record()))
}

/// Which of the two is believed, in a sentence.
fn believed(memory: &Memory) -> String {
    let (count, file_um, own_um) = memory.bank.compared();
    let figures = match count {
        0 => "no reading has been used yet".into(),
        _ => format!(
            "of the last {count} readings that were used the file as it is missed each by {file_um:.2} µm on \
             average, what was learned by {own_um:.2} µm, before they were used"
        ),
    };
    let odds = memory.bank.odds();
    match memory.bank.believed() {
        Some(_) => format!("What was learned is applied: {figures}."),
        None => format!(
            "The file as it is stays: {figures}; they are {odds:.0} times likelier by what was learned, and \
             {ENOUGH:.0} times would be enough."
        ),
    }
}

/// The user's file with what is applied.
fn written(
    source: &str,
    machine: &trueup_machine::Machine,
    quantity: Quantity,
    memory: &Memory,
) -> Option<String> {
    let shares = memory.constants.iter().zip(&memory.applied[1..]);
    let mut changed: Vec<(String, f64)> = shares
        .filter(|(_, share)| share.abs() > SAME)
        .map(|(Constant { key, believed }, share)| (key.clone(), digits(believed * (1.0 + share))))
        .collect();
    if let Some((key, from, per_um)) = constants::zero(machine, quantity)
        && memory.applied[0].abs() > 0.01
    {
        // A growth of k·(1 + x) moves its reference by as much less.
        let grown = memory.constants.iter().position(|it| it.key.ends_with("k_um_per_c"));
        let grown = grown.map_or(1.0, |index| 1.0 + memory.applied[index + 1]);
        let per_um = if per_um < 0.0 { per_um / grown } else { per_um };
        changed.push((key.into(), digits(from + per_um * memory.applied[0])));
    }
    constants::with(source, &changed)
}

/// Six digits: a hundredth of what any of them is known to.
fn digits(number: f64) -> f64 {
    format!("{number:.5e}").parse().unwrap_or(number)
}

/// Writes down what has changed.
fn log(
    memory: &mut Memory,
    before: &str,
    after: &str,
    run: &RunFile,
    quantity: Quantity,
    known: Before,
) {
    let zero = match quantity {
        Quantity::Elongation => &["spindle.sensor.k0_um", "spindle.temperature.reference_c"][..],
        _ => &[],
    };
    let keys = memory.constants.iter().map(|it| it.key.clone());
    let keys = keys.chain(zero.iter().map(|key| (*key).to_string()));
    let changed: Vec<(String, f64, f64)> = keys
        .filter_map(|key| {
            let to = constants::number(after, &key)?;
            let from = constants::number(before, &key).unwrap_or(0.0);
            (from != to).then_some((key, from, to))
        })
        .collect();
    if !changed.is_empty() {
        memory.changes.push(Change {
            record: run.path().display().to_string(),
            constants: changed,
            reason: believed(memory),
            before: Some(Box::new(known)),
        });
    }
}

impl Memory {
    /// The user's own machine file `source` with what is applied; `None` where it is another one.
    #[must_use]
    pub fn applied_to(&self, source: &str, path: &std::path::Path) -> Option<String> {
        let machine = MachineFile::parse(source, path).ok()?;
        let quantity = constants::named(&self.quantity)?;
        let is_same = self.base == hash(source.bytes());
        is_same.then(|| written(source, &machine, quantity, self))?
    }
}
