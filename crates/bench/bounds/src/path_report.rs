//! The longest path of a task, as a table: which function takes which share of it.

use std::{
    collections::{BTreeMap, BTreeSet},
    fmt::Write as _,
};

use anyhow::{Context as _, Result, ensure};

use crate::{
    clock_configuration::ClockConfiguration,
    declarations::{self, CalibrationSizes, DeclarationTable},
    function_entry::FunctionEntry,
    image::FirmwareImage,
    program::Program,
    source_code::SourceCode,
    tasks,
    wcet::WcetAnalysis,
};

/// The share of a function in a path.
#[derive(Clone, Copy, Debug, Default)]
struct PathShare {
    calls: u64,
    own: u64,
    total: u64,
    /// The caller that calls it most often, and how often.
    caller: Option<(u64, FunctionEntry)>,
}

/// Returns the longest path of a task on a clock as a table, sorted by the cycles of the functions themselves. Functions that
/// are counted apart (`RateLimitedFunction`) are named with the cycles of one call.
///
/// # Errors
/// The app's table cannot be read, or it has no such task.
pub fn format_longest_path_of_task(
    image: &FirmwareImage,
    app: &str,
    table: &DeclarationTable,
    source: &SourceCode,
    sizes: CalibrationSizes,
    clock: ClockConfiguration,
    task: &str,
) -> Result<String> {
    let program = Program::new(image, table, source, sizes);
    let all = tasks::parse_tasks(app)?;
    let entry_of = |interrupt: &str| {
        let function = image.function_by_symbol(interrupt)?;
        Some(FunctionEntry::new(function.start))
    };
    let entries: Vec<FunctionEntry> =
        all.iter().filter_map(|task| entry_of(&task.interrupt)).collect();
    program.determine_ram_arguments(&entries);
    let found = all.iter().find(|entry| entry.name == task);
    let found = found.with_context(|| format!("{task}: no such task in src/main.rs"))?;
    let entry = entry_of(&found.interrupt);
    let entry = entry.with_context(|| format!("the image has no {}", found.interrupt))?;
    let waiting = found.bytes.map(|bytes| bytes.waiting);
    let free: BTreeSet<u32> = program.rate_limited_functions().into_keys().collect();
    let (cycles, once) = WcetAnalysis::compute_task_wcet(&program, clock, waiting, entry);
    let worst = WcetAnalysis::new(&program, clock, waiting).with_zero_cost_functions(free.clone());
    let us = |cycles: u64| cycles as f64 / f64::from(clock.mhz);
    let mut text = format!("{task}, {}: {:.1} µs\n", clock.name, us(cycles));
    write_path_shares(&mut text, image, &profile_longest_path(&worst, entry), us);
    if waiting.is_some() {
        let within = program.for_bytes_within_line();
        let worst = WcetAnalysis::new(&within, clock, waiting).with_zero_cost_functions(free);
        writeln!(text, "\nwhere no byte ends a line: {:.1} µs", us(worst.function_cycles(entry)))
            .ok();
        write_path_shares(&mut text, image, &profile_longest_path(&worst, entry), us);
    }
    for (start, (one, cost)) in once {
        writeln!(text, "\napart: {}, {:.1} µs each", function_name(image, start), us(cost)).ok();
        let others = program
            .rate_limited_functions()
            .into_keys()
            .filter(|address| *address != start)
            .collect();
        let worst = WcetAnalysis::new(&program, clock, waiting).with_zero_cost_functions(others);
        write_path_shares(&mut text, image, &profile_longest_path(&worst, one), us);
    }
    let problems = program.missing_flow_facts();
    ensure!(problems.is_empty(), "{}", problems.join("\n"));
    Ok(text)
}

fn function_name(image: &FirmwareImage, start: u32) -> &str {
    image.function_at(start).map_or("?", |function| &function.name)
}

/// The name of a function, and the length that it is called with.
fn format_entry(image: &FirmwareImage, entry: FunctionEntry) -> String {
    let name = function_name(image, entry.start);
    let length =
        declarations::length_argument_index(name).and_then(|number| entry.arguments[number]);
    length.map_or_else(|| name.to_owned(), |length| format!("{name} ({length})"))
}

/// The shares of all functions on the path from an entry on.
fn profile_longest_path(
    worst: &WcetAnalysis<'_>,
    entry: FunctionEntry,
) -> BTreeMap<FunctionEntry, PathShare> {
    let mut shares: BTreeMap<FunctionEntry, PathShare> = BTreeMap::new();
    let mut callers: BTreeMap<(FunctionEntry, FunctionEntry), u64> = BTreeMap::new();
    let mut open = vec![((entry, false), 1)];
    while let Some(((entry, is_kept), count)) = open.pop() {
        let Some(path) = worst.longest_path(entry, is_kept) else { continue };
        let share = shares.entry(entry).or_default();
        share.calls += count;
        share.own += path.own * count;
        share.total += path.cycles * count;
        for (to, times) in path.calls {
            *callers.entry((to.0, entry)).or_default() += times * count;
            open.push((to, times * count));
        }
    }
    for ((called, caller), count) in callers {
        if let Some(share) = shares.get_mut(&called) {
            share.caller = share.caller.max(Some((count, caller)));
        }
    }
    shares
}

fn write_path_shares(
    text: &mut String,
    image: &FirmwareImage,
    shares: &BTreeMap<FunctionEntry, PathShare>,
    us: impl Fn(u64) -> f64,
) {
    let mut sorted: Vec<(&FunctionEntry, &PathShare)> = shares.iter().collect();
    sorted.sort_by_key(|(_, share)| std::cmp::Reverse(share.own));
    writeln!(text, "{:>6} {:>9} {:>9}  function < most frequent caller", "calls", "own", "total")
        .ok();
    for (entry, share) in sorted {
        let (own, total) = (us(share.own), us(share.total));
        let name = format_entry(image, *entry);
        write!(text, "{:>6} {own:>9.1} {total:>9.1}  {name}", share.calls).ok();
        if let Some((count, caller)) = share.caller {
            write!(text, " < {count} × {}", format_entry(image, caller)).ok();
        }
        text.push('\n');
    }
}
