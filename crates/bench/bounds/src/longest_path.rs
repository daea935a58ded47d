//! The longest path through blocks, loops within loops included.
//!
//! A loop that goes back `n` times at the most costs `n` times its longest round, and then the longest way from its
//! header to where it is left: never less than any path through it. Of a loop that is entered in several places each
//! block counts in each round. A loop whose instructions fit the cache of the flash reads each line of them once (RM0090 3.5.2:
//! 64 lines, the least recently used goes): what it does not read in between, it does not lose.

use std::collections::{BTreeMap, BTreeSet};

use crate::{
    control_flow::{ControlFlowEdge, ControlFlowGraph},
    loop_analysis::{self, Loop},
};

/// A path so far: its cycles, and what else is kept of it.
pub(crate) trait PathCost: Clone + Default {
    /// Returns its cycles.
    fn cycles(&self) -> u64;
    /// Adds cycles that belong to no block: edges, and lines that the cache takes.
    fn add_cycles(&mut self, cycles: u64);
    /// Adds a block of that price.
    fn add_block(&mut self, block: usize, is_kept: bool, cycles: u64);
    /// Adds another path behind it, that many times.
    fn append_path(&mut self, other: &Self, times: u64);
}

/// The cycles alone.
impl PathCost for u64 {
    fn cycles(&self) -> u64 {
        *self
    }

    fn add_cycles(&mut self, cycles: u64) {
        *self += cycles;
    }

    fn add_block(&mut self, _: usize, _: bool, cycles: u64) {
        *self += cycles;
    }

    fn append_path(&mut self, other: &Self, times: u64) {
        *self += other * times;
    }
}

/// The cycles, and how often each block is on the path, with the cache and without.
#[derive(Clone, Debug, Default)]
pub(crate) struct TracedPath {
    cycles: u64,
    /// By the block and whether the cache has it.
    pub visits: BTreeMap<(usize, bool), u64>,
}

impl PathCost for TracedPath {
    fn cycles(&self) -> u64 {
        self.cycles
    }

    fn add_cycles(&mut self, cycles: u64) {
        self.cycles += cycles;
    }

    fn add_block(&mut self, block: usize, is_kept: bool, cycles: u64) {
        self.cycles += cycles;
        *self.visits.entry((block, is_kept)).or_default() += 1;
    }

    fn append_path(&mut self, other: &Self, times: u64) {
        self.cycles += other.cycles * times;
        if times > 0 {
            for (block, count) in &other.visits {
                *self.visits.entry(*block).or_default() += count * times;
            }
        }
    }
}

/// How often a loop goes round before its last round.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct LoopIterations {
    /// Rounds.
    pub times: u64,
    /// Cycles in addition to those of the rounds.
    pub wait: u64,
}

/// Prices of a graph. `is_kept`: the cache of the flash has all instructions.
pub(crate) trait CycleCosts {
    /// Returns the cycles of a block, with what it calls.
    fn block_cycles(&self, block: usize, is_kept: bool) -> u64;
    /// Returns the cycles of the way from a block to the next.
    fn edge_cycles(&self, from: usize, edge: &ControlFlowEdge, is_kept: bool) -> u64;
    /// Returns the cycles in which the cache takes all instructions of a loop, with what it calls; `None`: they are too many.
    fn cache_fill_cycles(&self, one: &Loop) -> Option<u64>;
    /// Returns how often a loop goes round until it comes to its last round.
    fn loop_iterations(&self, one: &Loop) -> LoopIterations;
    /// Returns the headers of the loops within a loop whose rounds are among its own.
    fn merged_loops(&self, one: &Loop) -> BTreeSet<usize>;
}

/// Returns the longest way from `entry` to the end of each block of `within` that it leads to.
pub(crate) fn longest_paths<W: PathCost>(
    graph: &ControlFlowGraph,
    prices: &impl CycleCosts,
    within: &BTreeSet<usize>,
    entry: usize,
) -> BTreeMap<usize, W> {
    compute_longest_paths(graph, prices, within, entry, false, false)
}

/// Returns the longest of some ways.
pub(crate) fn max_by_cycles<W: PathCost>(ways: impl Iterator<Item = W>) -> Option<W> {
    ways.max_by_key(PathCost::cycles)
}

/// As [`longest_paths`]; `is_round`: the ways back to `entry` are another round.
fn compute_longest_paths<W: PathCost>(
    graph: &ControlFlowGraph,
    prices: &impl CycleCosts,
    within: &BTreeSet<usize>,
    entry: usize,
    is_round: bool,
    is_kept: bool,
) -> BTreeMap<usize, W> {
    let is_cut = is_round || !graph.before[entry].iter().any(|from| within.contains(from));
    let parts = if is_cut {
        loop_analysis::components_without_back_edges(graph, within, entry)
    } else {
        loop_analysis::strongly_connected_components(graph, within, entry)
    };
    let mut known: BTreeMap<usize, W> = BTreeMap::new();
    for part in parts {
        let arrives = |block: usize| {
            let before = graph.before[block].iter();
            let ways = before.filter_map(|from| {
                let so_far = known.get(from)?;
                let edges = graph.blocks[*from].next.iter().filter(|edge| edge.to == block);
                let edge = edges.map(|edge| prices.edge_cycles(*from, edge, is_kept)).max()?;
                Some((so_far, edge))
            });
            let longest = ways.max_by_key(|(so_far, edge)| so_far.cycles() + edge);
            longest.map_or_else(W::default, |(so_far, edge)| {
                let mut way = so_far.clone();
                way.add_cycles(edge);
                way
            })
        };
        let cut = if is_cut { entry } else { usize::MAX };
        if !loop_analysis::is_loop(graph, &part, cut) {
            let block = part[0];
            let mut way = if block == entry && is_cut { W::default() } else { arrives(block) };
            way.add_block(block, is_kept, prices.block_cycles(block, is_kept));
            known.insert(block, way);
            continue;
        }
        let one = loop_analysis::build_loop(graph, &part, within);
        if !one.is_reducible {
            let before = max_by_cycles(part.iter().map(|block| arrives(*block)));
            let mut all = W::default();
            for block in &part {
                let edges = graph.blocks[*block].next.iter();
                all.add_block(*block, is_kept, prices.block_cycles(*block, is_kept));
                all.add_cycles(
                    edges.map(|edge| prices.edge_cycles(*block, edge, is_kept)).max().unwrap_or(0),
                );
            }
            let LoopIterations { times, wait } = prices.loop_iterations(&one);
            let mut way = before.unwrap_or_default();
            way.append_path(&all, times + 1);
            way.add_cycles(wait);
            known.extend(part.iter().map(|block| (*block, way.clone())));
            continue;
        }
        let before = arrives(one.header);
        let mut ways: BTreeMap<usize, W> = longest_paths_through_loop(graph, prices, &one, is_kept);
        // Either bounds the loop: with a cache that it fits, or without.
        if let Some(fill) = prices.cache_fill_cycles(&one).filter(|_| !is_kept) {
            let longest = |ways: &BTreeMap<usize, W>| ways.values().map(PathCost::cycles).max();
            let mut kept: BTreeMap<usize, W> =
                longest_paths_through_loop(graph, prices, &one, true);
            kept.values_mut().for_each(|way| way.add_cycles(fill));
            if longest(&kept) < longest(&ways) {
                ways = kept;
            }
        }
        known.extend(ways.into_iter().map(|(block, way)| {
            let mut whole = before.clone();
            whole.append_path(&way, 1);
            (block, whole)
        }));
    }
    known
}

/// The longest ways from where a loop is entered to the end of each of its blocks, all rounds included.
fn longest_paths_through_loop<W: PathCost>(
    graph: &ControlFlowGraph,
    prices: &impl CycleCosts,
    one: &Loop,
    is_kept: bool,
) -> BTreeMap<usize, W> {
    let inner: BTreeMap<usize, W> =
        compute_longest_paths(graph, prices, &one.blocks, one.header, true, is_kept);
    // A round that begins at a header within is a part of one that begins at this one.
    let mut headers = prices.merged_loops(one);
    headers.insert(one.header);
    let backs = inner.iter().filter_map(|(block, way)| {
        let edges = graph.blocks[*block].next.iter().filter(|edge| headers.contains(&edge.to));
        let edge = edges.map(|edge| prices.edge_cycles(*block, edge, is_kept)).max()?;
        let mut back = way.clone();
        back.add_cycles(edge);
        Some(back)
    });
    let round = max_by_cycles(backs).unwrap_or_default();
    let LoopIterations { times, wait } = prices.loop_iterations(one);
    let mut rounds = W::default();
    rounds.append_path(&round, times);
    rounds.add_cycles(wait);
    let whole = |way: W| {
        let mut whole = rounds.clone();
        whole.append_path(&way, 1);
        whole
    };
    inner.into_iter().map(|(block, way)| (block, whole(way))).collect()
}
