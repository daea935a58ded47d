//! The loops of a function, and how often each goes round at the most, where the code itself says it.
//!
//! A loop is a set of blocks from which each leads to each. It has one header, the block by which it is entered, and
//! loops within it once the ways back to the header are taken out. The code says a bound where a test that no round
//! can avoid compares a register that each round changes by the same number with one that no round changes.

use std::collections::{BTreeMap, BTreeSet};

use crate::{
    control_flow::{self, ControlFlowEdge, ControlFlowGraph},
    decode::{AddressingMode, ControlFlow, Instruction, RegisterEffect, SP},
    image::FirmwareImage,
    register_values::{
        self, FlagOperands, RegisterState, SymbolicBase, SymbolicValue, is_condition_met,
    },
};

/// A loop.
#[derive(Clone, Debug)]
pub struct Loop {
    /// The block by which it is entered; the lowest of several.
    pub header: usize,
    /// It is entered by one block alone.
    pub is_reducible: bool,
    /// Its blocks.
    pub blocks: BTreeSet<usize>,
}

/// How often a loop may go round before a test is believed not to end it.
const MAX_ITERATIONS: u32 = 1 << 20;
/// The register that holds the frame of a function (AAPCS for Thumb): what is near it is on the stack.
const FRAME_POINTER: u8 = 7;

/// Returns the strongly connected components of some blocks, entered by `entry`, without the edges back to it; each before
/// those that it leads to.
#[must_use]
pub(crate) fn components_without_back_edges(
    graph: &ControlFlowGraph,
    within: &BTreeSet<usize>,
    entry: usize,
) -> Vec<Vec<usize>> {
    // Tarjan's algorithm, without recursion.
    #[derive(Default, Clone)]
    struct TarjanNode {
        index: usize,
        low: usize,
        is_open: bool,
    }
    let mut marks: BTreeMap<usize, TarjanNode> = BTreeMap::new();
    let (mut open, mut found, mut count) = (Vec::new(), Vec::new(), 0);
    let mut stack = vec![(entry, 0)];
    while let Some((block, edge)) = stack.pop() {
        if edge == 0 {
            marks.insert(block, TarjanNode { index: count, low: count, is_open: true });
            count += 1;
            open.push(block);
        }
        let next = graph.blocks[block].next.get(edge).map(|edge| edge.to);
        let Some(next) = next else {
            let TarjanNode { index, low, .. } = marks[&block].clone();
            if index == low {
                let from =
                    open.iter().rposition(|candidate| *candidate == block).expect("it is open");
                let component = open.split_off(from);
                for it in &component {
                    marks.get_mut(it).expect("it was seen").is_open = false;
                }
                found.push(component);
            }
            if let Some((above, _)) = stack.last() {
                let mark = marks.get_mut(above).expect("it was seen");
                mark.low = mark.low.min(low);
            }
            continue;
        };
        stack.push((block, edge + 1));
        if next == entry || !within.contains(&next) {
            continue;
        }
        match marks.get(&next) {
            None => stack.push((next, 0)),
            Some(mark) if mark.is_open => {
                let index = mark.index;
                let mark = marks.get_mut(&block).expect("it was seen");
                mark.low = mark.low.min(index);
            }
            Some(_) => {}
        }
    }
    found.reverse();
    found
}

/// Returns whether a component is a loop: of several blocks, or one that leads to itself.
#[must_use]
pub(crate) fn is_loop(graph: &ControlFlowGraph, component: &[usize], entry: usize) -> bool {
    let [only] = component else { return true };
    *only != entry && graph.blocks[*only].next.iter().any(|edge| edge.to == *only)
}

/// Returns a component as a loop, entered from the blocks of `within` that are none of it.
#[must_use]
pub(crate) fn build_loop(
    graph: &ControlFlowGraph,
    component: &[usize],
    within: &BTreeSet<usize>,
) -> Loop {
    let blocks: BTreeSet<usize> = component.iter().copied().collect();
    let is_entered = |block: &usize| {
        let mut before = graph.before[*block].iter();
        before.any(|from| within.contains(from) && !blocks.contains(from))
    };
    let mut headers = blocks.iter().copied().filter(is_entered);
    let header = headers.next().unwrap_or(component[0]);
    Loop { header, is_reducible: headers.next().is_none(), blocks }
}

/// Returns all loops of a graph, those within others as well.
#[must_use]
pub(crate) fn find_loops(graph: &ControlFlowGraph) -> Vec<Loop> {
    let mut found = Vec::new();
    let mut open = vec![((0..graph.blocks.len()).collect::<BTreeSet<_>>(), None)];
    while let Some((within, header)) = open.pop() {
        // The entry of the function may be a header itself: no edge is taken out for it.
        let entry = header.unwrap_or(usize::MAX);
        let parts = match header {
            Some(header) => components_without_back_edges(graph, &within, header),
            None => strongly_connected_components(graph, &within, 0),
        };
        for component in parts {
            if is_loop(graph, &component, entry) {
                let one = build_loop(graph, &component, &within);
                if one.is_reducible {
                    open.push((one.blocks.clone(), Some(one.header)));
                }
                found.push(one);
            }
        }
    }
    found
}

/// Returns the components of blocks that are entered by `entry`, which may itself be part of a loop: then it is the first of
/// its component.
#[must_use]
pub(crate) fn strongly_connected_components(
    graph: &ControlFlowGraph,
    within: &BTreeSet<usize>,
    entry: usize,
) -> Vec<Vec<usize>> {
    let (mut round, mut open) = (BTreeSet::new(), vec![entry]);
    while let Some(block) = open.pop() {
        let before = graph.before[block].iter().filter(|from| within.contains(from));
        open.extend(before.filter(|from| round.insert(**from)));
    }
    let parts = components_without_back_edges(graph, within, entry);
    if round.is_empty() {
        return parts;
    }
    let mut first: Vec<usize> = round.iter().copied().filter(|block| *block != entry).collect();
    first.insert(0, entry);
    let others = parts.into_iter().filter(|part| part.iter().all(|block| !round.contains(block)));
    let others: Vec<_> = others.filter(|part| !part.contains(&entry)).collect();
    std::iter::once(first).chain(others).collect()
}

/// Returns how often the loop goes back to its header at the most, if the code says it.
#[must_use]
pub(crate) fn derive_iteration_bound(
    image: &FirmwareImage,
    graph: &ControlFlowGraph,
    starts: &[RegisterState],
    one: &Loop,
) -> Option<u32> {
    if !one.is_reducible {
        return None;
    }
    let mut rounds = one.blocks.iter().filter_map(|block| {
        let is_inside = |edge: &&ControlFlowEdge| one.blocks.contains(&edge.to);
        let next = &graph.blocks[*block].next;
        let inside: Vec<&ControlFlowEdge> = next.iter().filter(is_inside).collect();
        if next.len() != 2 || inside.len() != 1 || !is_on_every_iteration(graph, one, *block) {
            return None;
        }
        ConditionalBranch::from_block(image, graph, starts, *block)?
            .iteration_count(image, graph, starts, one, inside[0])
    });
    let first = rounds.next()?;
    Some(rounds.fold(first, u32::min))
}

/// Returns whether every round passes a block.
fn is_on_every_iteration(graph: &ControlFlowGraph, one: &Loop, block: usize) -> bool {
    if block == one.header {
        return true;
    }
    let (mut seen, mut open) = (BTreeSet::from([one.header]), vec![one.header]);
    while let Some(at) = open.pop() {
        for edge in &graph.blocks[at].next {
            if edge.to == one.header {
                return false;
            }
            if edge.to != block && one.blocks.contains(&edge.to) && seen.insert(edge.to) {
                open.push(edge.to);
            }
        }
    }
    true
}

/// Returns the graph without the ways that a branch by two numbers never takes; `None`: there are none.
#[must_use]
pub(crate) fn prune_infeasible_edges(
    image: &FirmwareImage,
    graph: &ControlFlowGraph,
    starts: &[RegisterState],
) -> Option<ControlFlowGraph> {
    let mut blocks = graph.blocks.clone();
    let mut is_changed = false;
    for (number, block) in blocks.iter_mut().enumerate() {
        if block.next.len() != 2 || block.call.is_some() || block.returns {
            continue;
        }
        let Some(test) = ConditionalBranch::from_block(image, graph, starts, number) else {
            continue;
        };
        if let Some(is_taken) = test.flags.evaluate_condition(test.condition) {
            block.next.retain(|edge| edge.is_taken == is_taken);
            is_changed = true;
        }
    }
    let all = vec![true; blocks.len()];
    is_changed.then(|| control_flow::subgraph(graph.name.clone(), blocks, &all))
}

/// A branch by two values.
struct ConditionalBranch {
    flags: FlagOperands,
    /// Condition by which the branch is taken.
    condition: u8,
}

impl ConditionalBranch {
    fn from_block(
        image: &FirmwareImage,
        graph: &ControlFlowGraph,
        starts: &[RegisterState],
        block: usize,
    ) -> Option<Self> {
        let block_of = &graph.blocks[block];
        let mut state = starts[block];
        for one in &block_of.instructions {
            state.execute_checking_condition(image, one);
        }
        match *block_of.last_instruction() {
            Instruction { flow: ControlFlow::Jump(_), condition: Some(condition), .. } => {
                let flags =
                    state.flag_operands().filter(|flags| flags.supports_condition(condition))?;
                Some(Self { flags, condition })
            }
            Instruction {
                flow: ControlFlow::CompareAndBranch { register, if_zero, .. }, ..
            } => Some(Self {
                flags: FlagOperands::from_comparison_with_zero(state.register_value(register)),
                condition: u8::from(!if_zero),
            }),
            _ => None,
        }
    }

    /// How often it lets the loop go on.
    fn iteration_count(
        &self,
        image: &FirmwareImage,
        graph: &ControlFlowGraph,
        starts: &[RegisterState],
        one: &Loop,
        inside: &ControlFlowEdge,
    ) -> Option<u32> {
        let Self { flags: FlagOperands { left, right, is_sum, .. }, condition } = *self;
        let way = |value: SymbolicValue| -> Option<(SymbolicValue, u32)> {
            match value.base {
                SymbolicBase::Met(at, register) if at == one.header => {
                    let (start, step) =
                        find_induction_variable(image, graph, starts, one, register)?;
                    let offset = start.offset.wrapping_add(value.offset);
                    Some((SymbolicValue { offset, ..start }, step))
                }
                SymbolicBase::Met(at, _) if one.blocks.contains(&at) => None,
                SymbolicBase::Left(at, _) if loop_contains_address(graph, one, at & !1) => None,
                SymbolicBase::Unit(_) => None,
                _ => Some((value, 0)),
            }
        };
        let ((mut a, step_a), (mut b, step_b)) = (way(left)?, way(right)?);
        if a.base != b.base || step_a == step_b {
            return None;
        }
        if a.base != SymbolicBase::Nothing {
            // Of two addresses only the difference is known. One that meets its limit exactly cannot pass it.
            let distance = b.offset.wrapping_sub(a.offset).cast_signed();
            let step = step_a.wrapping_sub(step_b).cast_signed();
            let goes_on = if inside.is_taken { condition } else { condition ^ 1 };
            let meets = distance.checked_rem(step) == Some(0) && distance / step >= 0;
            let is_exact = matches!(goes_on, 0 | 1) || matches!(goes_on, 3 | 8) && meets;
            if is_sum || !is_exact {
                return None;
            }
            a.offset = 0x4000_0000;
            b.offset = a.offset.wrapping_add(distance.cast_unsigned());
        }
        let (mut x, mut y) = (a.offset, b.offset);
        for rounds in 0..MAX_ITERATIONS {
            if is_condition_met(condition, x, y, is_sum) != inside.is_taken {
                return Some(rounds);
            }
            (x, y) = (x.wrapping_add(step_a), y.wrapping_add(step_b));
        }
        None
    }
}

fn loop_contains_address(graph: &ControlFlowGraph, one: &Loop, at: u32) -> bool {
    one.blocks.iter().any(|block| {
        let block = &graph.blocks[*block];
        (block.start_address()..block.end_address()).contains(&at)
    })
}

/// The first value of a register that each round changes by the same number, and that number.
fn find_induction_variable(
    image: &FirmwareImage,
    graph: &ControlFlowGraph,
    starts: &[RegisterState],
    one: &Loop,
    register: u8,
) -> Option<(SymbolicValue, u32)> {
    let own = SymbolicBase::Met(one.header, register);
    let (mut first, mut step) = (None, None);
    for before in &graph.before[one.header] {
        let mut state = starts[*before];
        register_values::execute_block(image, graph, *before, &mut state);
        let value = state.register_value(register);
        let known = if one.blocks.contains(before) {
            (value.base == own).then_some(())?;
            step.get_or_insert(SymbolicValue::constant(value.offset))
                == &SymbolicValue::constant(value.offset)
        } else {
            *first.get_or_insert(value) == value
        };
        known.then_some(())?;
    }
    Some((first?, step?.offset))
}

/// Returns whether a loop is left by the blocks alone that lead back to its header.
#[must_use]
pub(crate) fn is_post_tested(graph: &ControlFlowGraph, one: &Loop) -> bool {
    let leaves = |block: &&usize| {
        let block = &graph.blocks[**block];
        block.returns || block.next.iter().any(|edge| !one.blocks.contains(&edge.to))
    };
    let goes_back =
        |block: &usize| graph.blocks[*block].next.iter().any(|edge| edge.to == one.header);
    one.is_reducible && one.blocks.iter().filter(leaves).all(goes_back)
}

/// Returns how many words each round stores at the least, but for those on the stack.
#[must_use]
pub(crate) fn min_words_stored_per_iteration(graph: &ControlFlowGraph, one: &Loop) -> u32 {
    let stores = |block: usize| {
        let stored = graph.blocks[block].instructions.iter().filter_map(|instruction| {
            let access = instruction
                .access
                .filter(|access| !access.is_load && instruction.condition.is_none())?;
            let is_own =
                matches!(access.at, AddressingMode::ImmediateOffset(FRAME_POINTER | SP, _));
            (!is_own).then_some(access.words)
        });
        stored.sum::<u32>()
    };
    let mut fewest = BTreeMap::from([(one.header, stores(one.header))]);
    let mut open = BTreeSet::from([(fewest[&one.header], one.header)]);
    while let Some((so_far, block)) = open.pop_first() {
        for edge in &graph.blocks[block].next {
            if edge.to == one.header || !one.blocks.contains(&edge.to) {
                continue;
            }
            let way = so_far + stores(edge.to);
            if fewest.get(&edge.to).is_none_or(|known| way < *known) {
                fewest.insert(edge.to, way);
                open.insert((way, edge.to));
            }
        }
    }
    let goes_back =
        |block: &usize| graph.blocks[*block].next.iter().any(|edge| edge.to == one.header);
    fewest.iter().filter(|(block, _)| goes_back(block)).map(|(_, count)| *count).min().unwrap_or(0)
}

/// Returns the fewest bits by which every round moves a register down; 1: none.
#[must_use]
pub(crate) fn min_shift_bits_per_iteration(graph: &ControlFlowGraph, one: &Loop) -> u32 {
    let passed = one.blocks.iter().filter(|block| is_on_every_iteration(graph, one, **block));
    let instructions = passed.flat_map(|block| &graph.blocks[*block].instructions);
    let shifts = instructions.filter_map(|instruction| match instruction.effect {
        RegisterEffect::Shift(to, from, by)
            if to == from && by < 0 && instruction.condition.is_none() =>
        {
            Some(u32::from(by.unsigned_abs()))
        }
        _ => None,
    });
    shifts.min().unwrap_or(1)
}

/// Returns the largest number by which each round changes a register, up to 64.
#[must_use]
pub(crate) fn max_induction_step(
    image: &FirmwareImage,
    graph: &ControlFlowGraph,
    starts: &[RegisterState],
    one: &Loop,
) -> u32 {
    let steps =
        (0..15).filter_map(|register| find_induction_variable(image, graph, starts, one, register));
    let sizes = steps.map(|(_, step)| step.cast_signed().unsigned_abs());
    sizes.filter(|size| *size <= 64).max().unwrap_or(1)
}
