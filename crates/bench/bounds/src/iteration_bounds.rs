//! How often a loop of the image goes back to its header by the declaration of a loop of the source: the compiler may have
//! unrolled that one.

use crate::{
    control_flow::ControlFlowGraph,
    declarations::IterationBound,
    image::FirmwareImage,
    loop_analysis::{self, Loop},
    register_values::RegisterState,
};

/// Returns declared rounds as those of a loop of the image; `None`: they depend on an argument that is not known.
#[must_use]
pub(crate) fn resolve_iteration_bound(
    rounds: IterationBound,
    image: &FirmwareImage,
    (graph, starts): (&ControlFlowGraph, &[RegisterState]),
    arguments: [Option<u32>; 4],
    one: &Loop,
) -> Option<IterationBound> {
    let step = || loop_analysis::max_induction_step(image, graph, starts, one);
    Some(match rounds {
        IterationBound::RemainderBytes { argument } => {
            let length = arguments[argument]?;
            let bytes = if length < 16 { length } else { 3 };
            IterationBound::AtMost(
                bytes.div_ceil(loop_analysis::min_words_stored_per_iteration(graph, one).max(1)),
            )
        }
        // Unrolled, a round moves an address by more.
        IterationBound::Length { argument, per, more } => {
            IterationBound::AtMost(arguments[argument]?.div_ceil(per.max(step())) + more)
        }
        // Or has more stores: the addresses may be on the stack meanwhile.
        IterationBound::PerStoredBytes { argument, per } => {
            let stored = per * loop_analysis::min_words_stored_per_iteration(graph, one);
            IterationBound::AtMost(arguments[argument]?.div_ceil(per.max(step()).max(stored)))
        }
        IterationBound::Mask(bits) => IterationBound::AtMost(
            bits.div_ceil(loop_analysis::min_shift_bits_per_iteration(graph, one)),
        ),
        other => other,
    })
}
