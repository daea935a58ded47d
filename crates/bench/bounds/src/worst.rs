//! The worst case of a function, in cycles on one clock: the longest path through its blocks, what it calls included.

use std::{
    cell::RefCell,
    collections::{BTreeMap, BTreeSet},
    rc::Rc,
};

use crate::{
    clock::{Clock, KEPT_LINES, LINE},
    decode::Address,
    flow::Edge,
    longest::{self, Prices, Repeated, Traced, Way},
    loops::Loop,
    program::{Bounded, Entry, Prepared, Program},
    table::Rounds,
};

/// Prices on one clock.
pub struct Worst<'a> {
    program: &'a Program<'a>,
    clock: Clock,
    waiting: Option<u32>,
    known: RefCell<BTreeMap<(Entry, bool), u64>>,
    /// The lines of the flash of a function and all that it calls; `None`: more than the cache holds.
    lines: RefCell<BTreeMap<Entry, Option<Rc<BTreeSet<u32>>>>>,
    above: RefCell<Vec<Entry>>,
    /// Functions that count as free.
    free: BTreeSet<u32>,
    /// Those of them that were called.
    asked: RefCell<BTreeSet<Entry>>,
}

impl<'a> Worst<'a> {
    /// Returns the prices on a clock, with this many bytes waiting for loops that have a round for each.
    #[must_use]
    pub fn new(program: &'a Program<'a>, clock: Clock, waiting: Option<u32>) -> Self {
        let (known, above) = (RefCell::default(), RefCell::default());
        Self {
            program,
            clock,
            waiting,
            known,
            lines: RefCell::default(),
            above,
            free: BTreeSet::new(),
            asked: RefCell::default(),
        }
    }

    /// Has functions count as free.
    #[must_use]
    pub fn without(self, free: BTreeSet<u32>) -> Self {
        Self { free, ..self }
    }

    /// Returns the cycles of a turn of a task without the functions that it calls once, and those of each of these.
    #[must_use]
    pub fn turn(
        program: &'a Program<'a>,
        clock: Clock,
        waiting: Option<u32>,
        entry: Entry,
    ) -> (u64, BTreeMap<u32, u64>) {
        let once: BTreeSet<u32> = program.once().into_keys().collect();
        let plain = Self::new(program, clock, waiting).without(once.clone());
        let cycles = plain.of(entry);
        let mut alone: BTreeMap<u32, u64> = BTreeMap::new();
        for it in plain.asked.take() {
            // Another one within it is counted for itself.
            let others = once.iter().copied().filter(|start| *start != it.start).collect();
            let own = Self::new(program, clock, waiting).without(others).of(it);
            // With the arguments that take the longest.
            let known = alone.entry(it.start).or_default();
            *known = own.max(*known);
        }
        (cycles, alone)
    }

    /// Returns the cycles of a function from its first instruction to its return. Where it cannot be priced it is
    /// 0, and the program has the complaint.
    pub fn of(&self, entry: Entry) -> u64 {
        self.cycles(entry, false)
    }

    /// As [`Self::of`]; `is_kept`: the cache of the flash has its instructions.
    fn cycles(&self, entry: Entry, is_kept: bool) -> u64 {
        if let Some(known) = self.known.borrow().get(&(entry, is_kept)) {
            return *known;
        }
        if self.free.contains(&entry.start) {
            self.asked.borrow_mut().insert(entry);
            return 0;
        }
        let Some(prepared) = self.program.prepare(entry) else { return 0 };
        if self.above.borrow().iter().any(|above| above.start == entry.start) {
            self.program.complain(format!("{} calls itself, in a circle", prepared.graph.name));
            return 0;
        }
        self.above.borrow_mut().push(entry);
        let priced = self.priced(&prepared);
        let within: BTreeSet<usize> = (0..prepared.graph.blocks.len()).collect();
        let longest: u64 = to_return(&prepared, &priced.kept(is_kept), &within);
        self.above.borrow_mut().pop();
        self.known.borrow_mut().insert((entry, is_kept), longest);
        longest
    }

    /// Returns the longest path of a function: its cycles, its own among them, and how often it calls which functions.
    #[must_use]
    pub fn path(&self, entry: Entry, is_kept: bool) -> Option<Path> {
        let cycles = self.cycles(entry, is_kept);
        let prepared = self.program.prepare(entry).filter(|_| !self.free.contains(&entry.start))?;
        let priced = self.priced(&prepared).kept(is_kept);
        let within: BTreeSet<usize> = (0..prepared.graph.blocks.len()).collect();
        let way: Traced = to_return(&prepared, &priced, &within);
        let (mut calls, mut own) = (BTreeMap::new(), cycles);
        for ((block, in_cache), count) in way.visits {
            let is_kept = is_kept || in_cache;
            let called = prepared.calls[block].iter().map(|to| (self.cycles(*to, is_kept), *to));
            if let Some((cost, to)) = called.max_by_key(|(cost, _)| *cost) {
                own = own.saturating_sub(cost * count);
                *calls.entry((to, is_kept)).or_default() += count;
            }
        }
        Some(Path { cycles, own, calls })
    }

    /// The lines of the flash of some blocks, and of what they call.
    fn lines_of(&self, prepared: &Prepared, blocks: &[usize]) -> Option<BTreeSet<u32>> {
        let mut lines = BTreeSet::new();
        for number in blocks {
            let block = &prepared.graph.blocks[*number];
            lines.extend(block.start() / LINE..=(block.end() - 1) / LINE);
            for call in &prepared.calls[*number] {
                lines.extend(self.lines_below(*call)?.iter());
            }
            if lines.len() > KEPT_LINES {
                return None;
            }
        }
        Some(lines)
    }

    fn lines_below(&self, entry: Entry) -> Option<Rc<BTreeSet<u32>>> {
        if let Some(known) = self.lines.borrow().get(&entry) {
            return known.clone();
        }
        // A circle of calls has a complaint already.
        self.lines.borrow_mut().insert(entry, None);
        let prepared = self.program.prepare(entry)?;
        let all: Vec<usize> = (0..prepared.graph.blocks.len()).collect();
        let lines = self.lines_of(&prepared, &all).map(Rc::new);
        self.lines.borrow_mut().insert(entry, lines.clone());
        lines
    }

    /// Returns the functions priced so far.
    #[must_use]
    pub fn all(&self) -> BTreeMap<Entry, u64> {
        let known = self.known.borrow();
        known.iter().filter(|((_, is_kept), _)| !is_kept).map(|((it, _), of)| (*it, *of)).collect()
    }

    /// Returns the prices of the blocks of a function.
    #[must_use]
    pub(crate) fn priced(&self, prepared: &Rc<Prepared>) -> Priced {
        let count = prepared.graph.blocks.len();
        let of = |is_kept| (0..count).map(|it| self.block(prepared, it, is_kept)).collect();
        let blocks: [Vec<u64>; 2] = [of(false), of(true)];
        let fills = prepared.loops.iter().filter_map(|bounded| {
            let all: Vec<usize> = bounded.one.blocks.iter().copied().collect();
            let lines = self.lines_of(prepared, &all)?.len() as u64;
            // Each line of the flash is read once, and waited for once more where a branch has asked ahead.
            Some((bounded.one.blocks.clone(), 2 * lines * u64::from(self.clock.flash)))
        });
        let fills = fills.collect();
        let mut rounds: BTreeMap<usize, Rounds> = BTreeMap::new();
        let joined = joined(prepared);
        for bounded in &prepared.loops {
            let own = match bounded.rounds {
                Rounds::Byte => Rounds::Times(self.waiting.unwrap_or_else(|| {
                    let name = &prepared.graph.name;
                    self.program.complain(format!(
                        "{name} has a round for each byte that waits, and its task says none"
                    ));
                    0
                })),
                Rounds::Together(_)
                    if joined.values().any(|it| it.contains(&bounded.one.header)) =>
                {
                    Rounds::Times(0)
                }
                Rounds::Together(times) => Rounds::Times(times),
                other => other,
            };
            rounds.insert(bounded.one.header, own);
        }
        Priced {
            prepared: prepared.clone(),
            clock: self.clock,
            blocks,
            fills,
            rounds,
            joined,
            is_kept: false,
        }
    }

    fn block(&self, prepared: &Prepared, number: usize, is_kept: bool) -> u64 {
        let block = &prepared.graph.blocks[number];
        let mut state = prepared.starts[number];
        let lines = if is_kept { 0 } else { self.clock.lines(block.start(), block.end()) };
        let mut cycles = u64::from(lines);
        for one in &block.instructions {
            cycles += u64::from(one.cycles);
            if let Some(access) = &one.access {
                let address = match access.at {
                    Address::Literal => None,
                    Address::Near(base, offset) => match state.of(base) {
                        value if value.as_number().is_some() => {
                            Some(value.offset.wrapping_add(offset))
                        }
                        value => value.unit(),
                    },
                    Address::Sum(base, other) => {
                        let (a, b) = (state.of(base), state.of(other));
                        let sum = a.as_number().zip(b.as_number());
                        sum.map(|(a, b)| a.wrapping_add(b)).or(a.unit()).or(b.unit())
                    }
                };
                let is_ram = match access.at {
                    Address::Literal => false,
                    Address::Near(base, _) => state.is_ram(base),
                    Address::Sum(base, other) => state.is_ram(base) || state.is_ram(other),
                };
                cycles += u64::from(self.clock.access(access, address, is_ram));
            }
            state.step(self.program.image, one);
        }
        let calls = prepared.calls[number].iter().map(|entry| self.cycles(*entry, is_kept)).max();
        match calls {
            Some(called) => cycles + self.clock.jump(block.end(), is_kept) + called,
            None => cycles,
        }
    }
}

/// The longest path through a function.
#[derive(Clone, Debug)]
pub struct Path {
    /// Its cycles, with all that it calls.
    pub cycles: u64,
    /// Those of its own instructions.
    pub own: u64,
    /// How often it calls what, with the cache and without.
    pub calls: BTreeMap<(Entry, bool), u64>,
}

/// The longest way to a return.
fn to_return<W: Way>(prepared: &Prepared, prices: &Priced, within: &BTreeSet<usize>) -> W {
    let ways = longest::ways::<W>(&prepared.graph, prices, within, 0);
    let blocks = &prepared.graph.blocks;
    let back = ways.into_iter().filter(|(block, _)| blocks[*block].returns);
    longest::longest_of(back.map(|(_, way)| way)).unwrap_or_default()
}

/// The prices of one function.
pub(crate) struct Priced {
    prepared: Rc<Prepared>,
    clock: Clock,
    /// Without the cache, and with it.
    blocks: [Vec<u64>; 2],
    /// Cycles in which the cache takes a loop that fits it.
    fills: BTreeMap<BTreeSet<usize>, u64>,
    is_kept: bool,
    rounds: BTreeMap<usize, Rounds>,
    /// By the header of a loop those of the loops within it that are one with it in the source.
    joined: BTreeMap<usize, BTreeSet<usize>>,
}

/// The headers of loops within others that are one with them in the source.
fn joined(prepared: &Prepared) -> BTreeMap<usize, BTreeSet<usize>> {
    let mut joined: BTreeMap<usize, BTreeSet<usize>> = BTreeMap::new();
    let is_one = |it: &&Bounded| matches!(it.rounds, Rounds::Together(_));
    for inner in prepared.loops.iter().filter(is_one) {
        let around = prepared.loops.iter().filter(is_one).filter(|outer| {
            outer.one.header != inner.one.header && outer.one.blocks.is_superset(&inner.one.blocks)
        });
        if let Some(outer) = around.max_by_key(|outer| outer.one.blocks.len()) {
            joined.entry(outer.one.header).or_default().insert(inner.one.header);
        }
    }
    joined
}

impl Priced {
    /// Returns the same, all of it in the cache or not.
    #[must_use]
    fn kept(self, is_kept: bool) -> Self {
        Self { is_kept, ..self }
    }
}

impl Prices for Priced {
    fn block(&self, block: usize, is_kept: bool) -> u64 {
        self.blocks[usize::from(is_kept || self.is_kept)][block]
    }

    fn edge(&self, from: usize, edge: &Edge, is_kept: bool) -> u64 {
        let end = self.prepared.graph.blocks[from].end();
        match (edge.is_taken, is_kept || self.is_kept) {
            (true, is_kept) => self.clock.jump(end, is_kept),
            (false, true) => 0,
            (false, false) => self.clock.fall(end),
        }
    }

    fn fill(&self, one: &Loop) -> Option<u64> {
        self.fills.get(&one.blocks).copied()
    }

    fn joined(&self, one: &Loop) -> BTreeSet<usize> {
        self.joined.get(&one.header).cloned().unwrap_or_default()
    }

    fn rounds(&self, one: &Loop) -> Repeated {
        let repeated = |rounds: Rounds| match rounds {
            Rounds::Times(times) => Repeated { times: times.into(), wait: 0 },
            Rounds::Micros(us) => {
                Repeated { times: 1, wait: u64::from(us) * u64::from(self.clock.mhz) }
            }
            _ => Repeated::default(),
        };
        let own = self.rounds.get(&one.header).map(|rounds| repeated(*rounds));
        // One of which only a part is looked at may be entered elsewhere: it turns no more often than the whole.
        own.unwrap_or_else(|| {
            let around = self.prepared.loops.iter();
            let around = around.filter(|it| it.one.blocks.is_superset(&one.blocks));
            let all = around.filter_map(|it| self.rounds.get(&it.one.header));
            let all: Vec<Repeated> = all.map(|rounds| repeated(*rounds)).collect();
            Repeated {
                times: all.iter().map(|it| it.times).max().unwrap_or(0),
                wait: all.iter().map(|it| it.wait).max().unwrap_or(0),
            }
        })
    }
}
