//! Code that the compiler has put in one place for several functions (LLVM's outliner): it keeps to no convention of calls,
//! so its blocks become part of each function that uses it.

use std::collections::BTreeSet;

use anyhow::{Result, ensure};

use crate::{
    basic_block::{BasicBlock, Call, ControlFlowEdge},
    image::{FirmwareImage, Function},
};

/// How deep such pieces use each other.
const MAX_OUTLINE_DEPTH: usize = 8;

/// Returns whether a function is such a piece.
#[must_use]
pub(crate) fn is_outlined(name: &str) -> bool {
    name.starts_with("OUTLINED_FUNCTION")
}

/// Puts the blocks of pieces in the places of their calls; `read` reads one of them, `depth` deep in others.
///
/// # Errors
/// A piece cannot be read, or uses itself.
pub(crate) fn inline_outlined_code(
    image: &FirmwareImage,
    mut blocks: Vec<BasicBlock>,
    depth: usize,
    read: impl Fn(&Function) -> Result<Vec<BasicBlock>>,
) -> Result<Vec<BasicBlock>> {
    for number in 0..blocks.len() {
        let Some(Call::Direct(all)) = &blocks[number].call else { continue };
        let first = all.first().and_then(|to| image.function_at(*to));
        let Some(piece) = first.filter(|function| all.len() == 1 && is_outlined(&function.name))
        else {
            continue;
        };
        ensure!(depth < MAX_OUTLINE_DEPTH, "{} uses itself", piece.name);
        let copy = read(piece)?;
        let base = blocks.len();
        let block = &mut blocks[number];
        block.call = None;
        let behind = std::mem::take(&mut block.next);
        let is_tail = std::mem::take(&mut block.returns);
        let is_conditional = block.last_instruction().condition.is_some();
        block.next = vec![ControlFlowEdge { to: base, is_taken: true }];
        // One that is not always called is passed by as well.
        if is_conditional {
            block
                .next
                .extend(behind.iter().map(|edge| ControlFlowEdge { is_taken: false, ..*edge }));
        }
        let back: BTreeSet<ControlFlowEdge> =
            if is_tail { BTreeSet::new() } else { behind.into_iter().collect() };
        blocks.extend(copy.into_iter().map(|mut own| {
            for edge in &mut own.next {
                edge.to += base;
            }
            if own.returns && !is_tail {
                own.returns = false;
                own.next
                    .extend(back.iter().map(|edge| ControlFlowEdge { is_taken: true, ..*edge }));
            }
            own
        }));
    }
    Ok(blocks)
}
