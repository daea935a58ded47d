//! The longest path of a task, as a table: which function takes which share of it.

use std::{
    collections::{BTreeMap, BTreeSet},
    fmt::Write as _,
};

use anyhow::{Context as _, Result, ensure};

use crate::{
    clock::Clock,
    image::Image,
    program::{Entry, Program},
    source::Source,
    table::{self, Sizes, Table},
    tasks,
    worst::Worst,
};

/// The share of a function in a path.
#[derive(Clone, Copy, Debug, Default)]
struct Share {
    calls: u64,
    own: u64,
    total: u64,
    /// The caller that calls it most often, and how often.
    caller: Option<(u64, Entry)>,
}

/// Returns the longest path of a task on a clock as a table, sorted by the cycles of the functions themselves. Functions that
/// are counted apart (`Once`) are named with the cycles of one call.
///
/// # Errors
/// The app's table cannot be read, or it has no such task.
pub fn of_task(
    image: &Image,
    app: &str,
    table: &Table,
    source: &Source,
    sizes: Sizes,
    clock: Clock,
    task: &str,
) -> Result<String> {
    let program = Program::new(image, table, source, sizes);
    let all = tasks::read(app)?;
    let entry_of = |interrupt: &str| {
        let function = image.function(interrupt)?;
        Some(Entry::of(function.start))
    };
    let entries: Vec<Entry> = all.iter().filter_map(|task| entry_of(&task.interrupt)).collect();
    program.find_ram(&entries);
    let found = all.iter().find(|it| it.name == task);
    let found = found.with_context(|| format!("{task}: no such task in src/main.rs"))?;
    let entry = entry_of(&found.interrupt);
    let entry = entry.with_context(|| format!("the image has no {}", found.interrupt))?;
    let waiting = found.bytes.map(|bytes| bytes.waiting);
    let free: BTreeSet<u32> = program.once().into_keys().collect();
    let (cycles, once) = Worst::turn(&program, clock, waiting, entry);
    let worst = Worst::new(&program, clock, waiting).without(free.clone());
    let us = |cycles: u64| cycles as f64 / f64::from(clock.mhz);
    let mut text = format!("{task}, {}: {:.1} µs\n", clock.name, us(cycles));
    write_shares(&mut text, image, &shares(&worst, entry), us);
    if waiting.is_some() {
        let within = program.within_line();
        let worst = Worst::new(&within, clock, waiting).without(free);
        writeln!(text, "\nwhere no byte ends a line: {:.1} µs", us(worst.of(entry))).ok();
        write_shares(&mut text, image, &shares(&worst, entry), us);
    }
    for (start, cost) in once {
        writeln!(text, "\napart: {}, {:.1} µs each", name(image, start), us(cost)).ok();
        let others = program.once().into_keys().filter(|it| *it != start).collect();
        let worst = Worst::new(&program, clock, waiting).without(others);
        let one = Entry::of(start);
        write_shares(&mut text, image, &shares(&worst, one), us);
    }
    let problems = program.problems();
    ensure!(problems.is_empty(), "{}", problems.join("\n"));
    Ok(text)
}

fn name(image: &Image, start: u32) -> &str {
    image.function_at(start).map_or("?", |function| &function.name)
}

/// The name of a function, and the length that it is called with.
fn entry_name(image: &Image, entry: Entry) -> String {
    let name = name(image, entry.start);
    let length = table::length_argument(name).and_then(|number| entry.arguments[number]);
    length.map_or_else(|| name.to_owned(), |length| format!("{name} ({length})"))
}

/// The shares of all functions on the path from an entry on.
fn shares(worst: &Worst<'_>, entry: Entry) -> BTreeMap<Entry, Share> {
    let mut shares: BTreeMap<Entry, Share> = BTreeMap::new();
    let mut callers: BTreeMap<(Entry, Entry), u64> = BTreeMap::new();
    let mut open = vec![((entry, false), 1)];
    while let Some(((entry, is_kept), count)) = open.pop() {
        let Some(path) = worst.path(entry, is_kept) else { continue };
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

fn write_shares(
    text: &mut String,
    image: &Image,
    shares: &BTreeMap<Entry, Share>,
    us: impl Fn(u64) -> f64,
) {
    let mut sorted: Vec<(&Entry, &Share)> = shares.iter().collect();
    sorted.sort_by_key(|(_, share)| std::cmp::Reverse(share.own));
    writeln!(text, "{:>6} {:>9} {:>9}  function < most frequent caller", "calls", "own", "total")
        .ok();
    for (entry, share) in sorted {
        let (own, total) = (us(share.own), us(share.total));
        let name = entry_name(image, *entry);
        write!(text, "{:>6} {own:>9.1} {total:>9.1}  {name}", share.calls).ok();
        if let Some((count, caller)) = share.caller {
            write!(text, " < {count} × {}", entry_name(image, caller)).ok();
        }
        text.push('\n');
    }
}
