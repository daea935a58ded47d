//! The longest path through blocks, loops within loops included.
//!
//! A loop that goes back `n` times at the most costs `n` times its longest round, and then the longest way from its
//! header to where it is left: never less than any path through it. Of a loop that is entered in several places each
//! block counts in each round. A loop whose instructions fit the cache of the flash reads each line of them once (RM0090 3.5.2:
//! 64 lines, the least recently used goes): what it does not read in between, it does not lose.

use std::collections::{BTreeMap, BTreeSet};

use crate::{
    flow::{Edge, Graph},
    loops::{self, Loop},
};

/// Prices of a graph. `is_kept`: the cache of the flash has all instructions.
pub trait Prices {
    /// Returns the cycles of a block, with what it calls.
    fn block(&self, block: usize, is_kept: bool) -> u64;
    /// Returns the cycles of the way from a block to the next.
    fn edge(&self, from: usize, edge: &Edge, is_kept: bool) -> u64;
    /// Returns the cycles in which the cache takes all instructions of a loop, with what it calls; `None`: they are too many.
    fn fill(&self, one: &Loop) -> Option<u64>;
    /// Returns the cycles of a loop until it comes to its last round, by the cycles of its longest round.
    fn rounds(&self, one: &Loop, round: u64) -> u64;
    /// Returns the headers of the loops within a loop whose rounds are among its own.
    fn joined(&self, one: &Loop) -> BTreeSet<usize>;
}

/// Returns the longest way from `entry` to the end of each block of `within` that it leads to.
pub fn ways(
    graph: &Graph,
    prices: &impl Prices,
    within: &BTreeSet<usize>,
    entry: usize,
) -> BTreeMap<usize, u64> {
    walk(graph, prices, within, entry, false, false)
}

/// As [`ways`]; `is_round`: the ways back to `entry` are another round.
fn walk(
    graph: &Graph,
    prices: &impl Prices,
    within: &BTreeSet<usize>,
    entry: usize,
    is_round: bool,
    is_kept: bool,
) -> BTreeMap<usize, u64> {
    let is_cut = is_round || !graph.before[entry].iter().any(|from| within.contains(from));
    let parts = if is_cut {
        loops::components(graph, within, entry)
    } else {
        loops::whole(graph, within, entry)
    };
    let mut known: BTreeMap<usize, u64> = BTreeMap::new();
    for part in parts {
        let arrives = |block: usize| {
            let before = graph.before[block].iter();
            let ways = before.filter_map(|from| {
                let so_far = known.get(from)?;
                let edges = graph.blocks[*from].next.iter().filter(|edge| edge.to == block);
                Some(so_far + edges.map(|edge| prices.edge(*from, edge, is_kept)).max()?)
            });
            ways.max().unwrap_or(0)
        };
        let cut = if is_cut { entry } else { usize::MAX };
        if !loops::is_loop(graph, &part, cut) {
            let block = part[0];
            let before = if block == entry && is_cut { 0 } else { arrives(block) };
            known.insert(block, before + prices.block(block, is_kept));
            continue;
        }
        let one = loops::as_loop(graph, &part, within);
        if !one.is_reducible {
            let before = part.iter().map(|block| arrives(*block)).max().unwrap_or(0);
            let all = part.iter().map(|block| {
                let edges = graph.blocks[*block].next.iter();
                prices.block(*block, is_kept)
                    + edges.map(|edge| prices.edge(*block, edge, is_kept)).max().unwrap_or(0)
            });
            let all: u64 = all.sum();
            let way = before + prices.rounds(&one, all) + all;
            known.extend(part.iter().map(|block| (*block, way)));
            continue;
        }
        let before = arrives(one.header);
        let mut ways = around(graph, prices, &one, is_kept);
        // Either bounds the loop: with a cache that it fits, or without.
        if let Some(fill) = prices.fill(&one).filter(|_| !is_kept) {
            let longest = |ways: &BTreeMap<usize, u64>| ways.values().copied().max();
            let kept = around(graph, prices, &one, true);
            let kept: BTreeMap<usize, u64> =
                kept.into_iter().map(|(block, way)| (block, way + fill)).collect();
            if longest(&kept) < longest(&ways) {
                ways = kept;
            }
        }
        known.extend(ways.into_iter().map(|(block, way)| (block, before + way)));
    }
    known
}

/// The longest ways from where a loop is entered to the end of each of its blocks, all rounds included.
fn around(graph: &Graph, prices: &impl Prices, one: &Loop, is_kept: bool) -> BTreeMap<usize, u64> {
    let inner = walk(graph, prices, &one.blocks, one.header, true, is_kept);
    // A round that begins at a header within is a part of one that begins at this one.
    let mut headers = prices.joined(one);
    headers.insert(one.header);
    let backs = inner.iter().filter_map(|(block, way)| {
        let edges = graph.blocks[*block].next.iter().filter(|edge| headers.contains(&edge.to));
        Some(way + edges.map(|edge| prices.edge(*block, edge, is_kept)).max()?)
    });
    let rounds = prices.rounds(one, backs.max().unwrap_or(0));
    inner.into_iter().map(|(block, way)| (block, rounds + way)).collect()
}
