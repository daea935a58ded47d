//! How often a loop of the image goes back to its header by the declaration of a loop of the source: the compiler may have
//! unrolled that one.

use crate::{
    control_flow::ControlFlowGraph,
    declarations::IterationBound,
    image::Image,
    loops::{self, Loop},
    register_values::RegisterState,
};

/// Returns declared rounds as those of a loop of the image; `None`: they depend on an argument that is not known.
#[must_use]
pub(crate) fn resolve_iteration_bound(
    rounds: IterationBound,
    image: &Image,
    (graph, starts): (&ControlFlowGraph, &[RegisterState]),
    arguments: [Option<u32>; 4],
    one: &Loop,
) -> Option<IterationBound> {
    let step = || loops::max_induction_step(image, graph, starts, one);
    Some(match rounds {
        IterationBound::Odd { argument } => {
            let length = arguments[argument]?;
            let bytes = if length < 16 { length } else { 3 };
            IterationBound::Times(
                bytes.div_ceil(loops::min_words_stored_per_iteration(graph, one).max(1)),
            )
        }
        // Unrolled, a round moves an address by more.
        IterationBound::Length { argument, per, more } => {
            IterationBound::Times(arguments[argument]?.div_ceil(per.max(step())) + more)
        }
        // Or has more stores: the addresses may be on the stack meanwhile.
        IterationBound::Copied { argument, per } => {
            let stored = per * loops::min_words_stored_per_iteration(graph, one);
            IterationBound::Times(arguments[argument]?.div_ceil(per.max(step()).max(stored)))
        }
        IterationBound::Mask(bits) => {
            IterationBound::Times(bits.div_ceil(loops::min_shift_bits_per_iteration(graph, one)))
        }
        other => other,
    })
}
