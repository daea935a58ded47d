//! The control flow of a function: blocks of instructions, the edges between them, calls and ends.
//!
//! A block ends with a branch, a call, a change of the mask of interrupts, or before the target of a branch.

use std::collections::{BTreeMap, BTreeSet};

use anyhow::{Context as _, Result, bail};

pub use crate::block::{Block, Call, Edge};
use crate::{
    decode::{self, Flow, Instruction, PC},
    image::{Function, Image},
    pieces,
};

/// A function as blocks; the first one is its entry.
#[derive(Clone, Debug)]
pub struct Graph {
    /// Its name.
    pub name: String,
    /// Its blocks.
    pub blocks: Vec<Block>,
    /// The blocks that lead to each.
    pub before: Vec<Vec<usize>>,
}

impl Graph {
    /// Reads a function. `targets` gives what a branch by register may lead to, by its address.
    ///
    /// # Errors
    /// It branches by a register, or into the midst of another function, or its end is no branch.
    pub fn read(image: &Image, function: &Function) -> Result<Self> {
        Self::read_within(image, function, 0)
    }

    /// As [`Self::read`], as part of another function, that many deep.
    pub(crate) fn read_within(image: &Image, function: &Function, depth: usize) -> Result<Self> {
        Reader::read(image, function)?.graph(image, depth)
    }
}

struct Reader<'a> {
    function: &'a Function,
    code: BTreeMap<u32, Instruction>,
    /// Targets of a jump by table.
    tables: BTreeMap<u32, Vec<u32>>,
}

impl<'a> Reader<'a> {
    fn read(image: &Image, function: &'a Function) -> Result<Self> {
        let mut reader = Self { function, code: BTreeMap::new(), tables: BTreeMap::new() };
        let mut at = function.start;
        while at < function.end {
            let end = image.end_of_stretch(at).min(function.end);
            if !image.is_data(at) {
                let bytes = image.bytes(at, end).context("its bytes are not in the image")?;
                for one in decode::decode(bytes, at) {
                    reader.code.insert(one.at, one);
                }
            }
            at = end;
        }
        let code: Vec<Instruction> = reader.code.values().copied().collect();
        for one in code {
            let targets = match one.flow {
                Flow::Table { size } => reader.table(image, &one, size)?,
                Flow::JumpRegister(register) if register != PC => reader.jumps_behind(&one),
                _ => continue,
            };
            if !targets.is_empty() {
                reader.tables.insert(one.at, targets);
            }
        }
        Ok(reader)
    }

    /// The places of a table that stands behind its jump, up to where the mapping symbols say that code goes on.
    fn table(&self, image: &Image, one: &Instruction, size: u32) -> Result<Vec<u32>> {
        let end = image.end_of_stretch(one.end()).min(self.function.end);
        let bytes = image.bytes(one.end(), end).filter(|_| image.is_data(one.end()));
        let bytes = bytes.with_context(|| self.say(one, "jumps by a table that is not there"))?;
        let entries: Vec<u32> = if size == 1 {
            bytes.iter().map(|byte| u32::from(*byte)).collect()
        } else {
            bytes.chunks_exact(2).map(|two| u16::from_le_bytes([two[0], two[1]]).into()).collect()
        };
        // The byte that aligns the code behind it is none of the table; as an entry of 0 it would lead into the table.
        let targets = entries.into_iter().map(|entry| one.end() + 2 * entry);
        Ok(targets.filter(|target| self.code.contains_key(target)).collect())
    }

    /// A row of branches behind a jump by register is its table.
    fn jumps_behind(&self, one: &Instruction) -> Vec<u32> {
        let mut targets = Vec::new();
        let mut at = (one.end() + 3) & !3;
        while let Some(next) = self.code.get(&at) {
            if next.size != 4 || next.condition.is_some() || !matches!(next.flow, Flow::Jump(_)) {
                break;
            }
            targets.push(at);
            at += 4;
        }
        targets
    }

    fn say(&self, one: &Instruction, what: &str) -> String {
        format!("{} {what}, at {:#x}", self.function.name, one.at)
    }

    fn is_within(&self, at: u32) -> bool {
        (self.function.start..self.function.end).contains(&at)
    }

    /// Addresses at which a block begins.
    fn starts(&self) -> BTreeSet<u32> {
        let mut starts = BTreeSet::from([self.function.start]);
        for one in self.code.values() {
            match one.flow {
                Flow::Jump(target) | Flow::Zero { target, .. } => {
                    starts.extend([target, one.end()]);
                }
                Flow::Next if one.mask.is_none() => {}
                _ => {
                    starts.insert(one.end());
                }
            }
        }
        starts.extend(self.tables.values().flatten());
        starts
    }

    fn graph(&self, image: &Image, depth: usize) -> Result<Graph> {
        let starts = self.starts();
        let mut blocks: Vec<Block> = Vec::new();
        for one in self.code.values() {
            let is_behind = blocks.last().is_none_or(|block| block.end() != one.at);
            if starts.contains(&one.at) || is_behind {
                blocks.push(Block::default());
            }
            blocks.last_mut().expect("one was pushed").instructions.push(*one);
        }
        let numbers: BTreeMap<u32, usize> =
            blocks.iter().enumerate().map(|(number, block)| (block.start(), number)).collect();
        for block in &mut blocks {
            self.connect(image, block, &numbers)?;
        }
        let read = |piece: &Function| Ok(Graph::read_within(image, piece, depth + 1)?.blocks);
        let blocks = pieces::put_in(image, blocks, depth, read)?;
        Ok(reachable(self.function.name.clone(), blocks))
    }

    fn connect(
        &self,
        image: &Image,
        block: &mut Block,
        numbers: &BTreeMap<u32, usize>,
    ) -> Result<()> {
        let one = *block.last();
        let fall =
            || Edge { to: numbers.get(&one.end()).copied().unwrap_or(usize::MAX), is_taken: false };
        let may_fall = one.condition.is_some();
        match one.flow {
            Flow::Next => block.next.push(fall()),
            Flow::Jump(target) | Flow::Zero { target, .. } => {
                if self.is_within(target) {
                    let to = *numbers
                        .get(&target)
                        .with_context(|| self.say(&one, "jumps into an instruction"))?;
                    block.next.push(Edge { to, is_taken: true });
                } else {
                    // A function that ends by calling another one.
                    block.call = Some(Call::To(BTreeSet::from([called(image, target)
                        .with_context(|| self.say(&one, "jumps to no function"))?])));
                    block.returns = true;
                }
                if may_fall || matches!(one.flow, Flow::Zero { .. }) {
                    block.next.push(fall());
                }
            }
            Flow::Call(target) => {
                let start = called(image, target)
                    .with_context(|| self.say(&one, "calls what is no function"))?;
                block.call = Some(Call::To(BTreeSet::from([start])));
                block.next.push(Edge { is_taken: true, ..fall() });
            }
            Flow::CallRegister(register) => {
                block.call = Some(Call::Register(register));
                block.next.push(Edge { is_taken: true, ..fall() });
            }
            Flow::Return => {
                block.returns = true;
                if may_fall {
                    block.next.push(fall());
                }
            }
            Flow::Table { .. } | Flow::JumpRegister(_) => match self.tables.get(&one.at) {
                Some(targets) => {
                    let all: BTreeSet<usize> =
                        targets.iter().filter_map(|target| numbers.get(target).copied()).collect();
                    block.next.extend(all.into_iter().map(|to| Edge { to, is_taken: true }));
                }
                None => match one.flow {
                    Flow::JumpRegister(register) => {
                        block.call = Some(Call::Register(register));
                        block.returns = true;
                        if may_fall {
                            block.next.push(fall());
                        }
                    }
                    _ => bail!(self.say(&one, "jumps by a table without entries")),
                },
            },
            Flow::Stop => {}
        }
        Ok(())
    }
}

fn called(image: &Image, target: u32) -> Option<u32> {
    image.function_at(target).map(|function| function.start).filter(|start| *start == target & !1)
}

/// Leaves out what the entry does not lead to.
fn reachable(name: String, blocks: Vec<Block>) -> Graph {
    let mut seen = vec![false; blocks.len()];
    let mut open = vec![0];
    while let Some(number) = open.pop() {
        if number < blocks.len() && !std::mem::replace(&mut seen[number], true) {
            open.extend(blocks[number].next.iter().map(|edge| edge.to));
        }
    }
    keep(name, blocks, &seen)
}

/// Returns a graph of some of the blocks, the first one among them.
#[must_use]
pub fn keep(name: String, blocks: Vec<Block>, is_kept: &[bool]) -> Graph {
    let mut numbers = vec![usize::MAX; blocks.len()];
    let mut count = 0;
    for (number, kept) in is_kept.iter().enumerate() {
        if *kept {
            numbers[number] = count;
            count += 1;
        }
    }
    let kept = blocks.into_iter().zip(is_kept).filter(|(_, kept)| **kept);
    let blocks: Vec<Block> = kept
        .map(|(mut block, _)| {
            // One that falls off the end of the function comes back from nowhere: what it calls does not return.
            block.next.retain(|edge| is_kept.get(edge.to).copied().unwrap_or(false));
            for edge in &mut block.next {
                edge.to = numbers[edge.to];
            }
            block.next.sort_unstable();
            block.next.dedup();
            block
        })
        .collect();
    let mut before = vec![Vec::new(); blocks.len()];
    for (number, block) in blocks.iter().enumerate() {
        for edge in &block.next {
            before[edge.to].push(number);
        }
    }
    Graph { name, blocks, before }
}

/// Returns which blocks the entry leads to and that lead back to the caller; where no call in between stays away.
pub(crate) fn returning_blocks(graph: &Graph, returns: &dyn Fn(u32) -> bool) -> Vec<bool> {
    let comes_back = |number: usize| match &graph.blocks[number].call {
        Some(Call::To(all)) => all.iter().any(|to| returns(*to)),
        _ => true,
    };
    let count = graph.blocks.len();
    let mut leads_back = vec![false; count];
    let mut open: Vec<usize> = Vec::new();
    for number in 0..count {
        if graph.blocks[number].returns && comes_back(number) {
            open.push(number);
        }
    }
    while let Some(number) = open.pop() {
        if std::mem::replace(&mut leads_back[number], true) {
            continue;
        }
        for before in &graph.before[number] {
            // A call that is not always made leaves the way past it.
            let is_conditional = graph.blocks[*before].last().condition.is_some();
            if comes_back(*before) || is_conditional {
                open.push(*before);
            }
        }
    }
    let mut is_kept = vec![false; count];
    let mut open = vec![0];
    while let Some(number) = open.pop() {
        if leads_back[number] && !std::mem::replace(&mut is_kept[number], true) {
            open.extend(graph.blocks[number].next.iter().map(|edge| edge.to));
        }
    }
    is_kept
}
