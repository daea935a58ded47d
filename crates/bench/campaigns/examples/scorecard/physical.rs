//! `scorecard physical`: machines with one to five physical faults ([`trueup_campaigns::faulty_machine`]), and
//! machines without one; what names a fault stands in `docs/physical-faults.md`.

use std::{collections::BTreeMap, ops::Range, process::ExitCode};

use trueup_campaigns::{
    faulty_machine::MultiFaultMachine,
    score::physical_faults::{PhysicalFaultScore, diagnose_and_score},
};

use crate::{
    compare::{DrawScore, DrawScores},
    map_seeds_in_parallel,
    options::TierOptions,
};

/// The least share of draws in which all is named, of those whose faults can be distinguished from each other.
const MIN_NAMED_SHARE: f64 = 0.95;
/// The largest share of draws with a wrong name.
const MAX_INCORRECT_FRACTION: f64 = 0.01;
/// A healthy machine for this many with faults.
const FAULTY_PER_HEALTHY: u64 = 5;

/// Counts over draws.
#[derive(Default)]
struct DrawCounts {
    draws: usize,
    named: usize,
    wrong: usize,
    harmed: usize,
    /// Draws whose faults can be distinguished from each other, and those of them in which all are named.
    distinguishable: usize,
    named_of_distinguishable: usize,
    /// By fault: draws, named, claimed.
    by_fault: BTreeMap<&'static str, [usize; 3]>,
}

impl DrawCounts {
    fn add(&mut self, judged: &PhysicalFaultScore) {
        let is_named = judged.comparison.missed.is_empty();
        self.draws += 1;
        self.named += usize::from(is_named);
        self.wrong += usize::from(!judged.comparison.wrong.is_empty());
        self.harmed += usize::from(judged.is_harmed());
        self.distinguishable += usize::from(judged.is_distinguishable());
        self.named_of_distinguishable += usize::from(judged.is_distinguishable() && is_named);
        for ((fault, ..), (is_named, is_claimed)) in
            judged.faults.iter().zip(&judged.comparison.needed)
        {
            let counts = self.by_fault.entry(fault.name()).or_default();
            counts[0] += 1;
            counts[1] += usize::from(*is_named);
            counts[2] += usize::from(*is_claimed);
        }
    }

    fn print(&self, name: &str) {
        let percent = |count: usize, of: usize| 100.0 * count as f64 / of.max(1) as f64;
        println!(
            "{name}: {} draws, all named in {:.1} %, a wrong name in {:.1} %, harm in {}; of the {} whose \
             faults can be separated all named in {:.1} %",
            self.draws,
            percent(self.named, self.draws),
            percent(self.wrong, self.draws),
            self.harmed,
            self.distinguishable,
            percent(self.named_of_distinguishable, self.distinguishable),
        );
    }

    fn is_target_met(&self) -> bool {
        self.named_of_distinguishable as f64 >= MIN_NAMED_SHARE * self.distinguishable as f64
            && self.wrong as f64 <= MAX_INCORRECT_FRACTION * self.draws as f64
            && self.harmed == 0
    }
}

/// Machines that are counted together.
struct MachineGroup {
    name: &'static str,
    seeds: Range<u64>,
    draw: fn(u64) -> MultiFaultMachine,
}

/// `physical [--seeds 300] [--first 0] [--each] [--tsv FILE] [faults|healthy]`.
pub fn run(words: &[String]) -> ExitCode {
    let asked = match TierOptions::parse(words, 300) {
        Ok(asked) => asked,
        Err(complaint) => return complaint,
    };
    let seeds = asked.seeds();
    let healthy = seeds.start..seeds.start + (seeds.end - seeds.start).div_ceil(FAULTY_PER_HEALTHY);
    let rows = [
        MachineGroup { name: "faults", seeds, draw: MultiFaultMachine::draw },
        MachineGroup { name: "healthy", seeds: healthy, draw: MultiFaultMachine::without_fault },
    ];
    let (mut draws, mut is_met) = (DrawScores::default(), true);
    for MachineGroup { name, seeds, draw } in
        rows.into_iter().filter(|row| asked.is_selected(row.name))
    {
        let mut sum = DrawCounts::default();
        let judged = map_seeds_in_parallel(seeds.clone(), &|seed| {
            let judged = diagnose_and_score(&draw(seed));
            if asked.each || !judged.comparison.is_right() || judged.is_harmed() {
                println!("    seed {seed}: {judged}");
            }
            judged
        });
        for (seed, judged) in seeds.zip(&judged) {
            sum.add(judged);
            let comparison = &judged.comparison;
            let (is_right, is_wrong) = (comparison.missed.is_empty(), !comparison.wrong.is_empty());
            let gain = 1.0 - judged.after_um / judged.before_um;
            let draw = DrawScore::without_intervals(is_right, is_wrong, gain);
            let cell = if name == "healthy" { name } else { judged.kind.name() };
            draws.insert("physical", cell, seed, draw);
        }
        for (fault, [count, named, claimed]) in &sum.by_fault {
            println!("{fault:<24} n {count:>3} named {named:>3} claimed {claimed:>3}");
        }
        sum.print(name);
        is_met &= sum.is_target_met();
        asked.write_tsv(&draws);
    }
    ExitCode::from(u8::from(!is_met))
}
