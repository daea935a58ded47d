//! How often a loop of the image goes back to its header by the declaration of a loop of the source: the compiler may have
//! unrolled that one.

use crate::{
    flow::Graph,
    image::Image,
    loops::{self, Loop},
    table::Rounds,
    values::State,
};

/// Returns declared rounds as those of a loop of the image; `None`: they depend on an argument that is not known.
#[must_use]
pub(crate) fn of_loop(
    rounds: Rounds,
    image: &Image,
    (graph, starts): (&Graph, &[State]),
    arguments: [Option<u32>; 4],
    one: &Loop,
) -> Option<Rounds> {
    let step = || loops::largest_step(image, graph, starts, one);
    Some(match rounds {
        Rounds::Odd { argument } => {
            let length = arguments[argument]?;
            let bytes = if length < 16 { length } else { 3 };
            Rounds::Times(bytes.div_ceil(loops::fewest_stores(graph, one).max(1)))
        }
        // Unrolled, a round moves an address by more.
        Rounds::Length { argument, per, more } => {
            Rounds::Times(arguments[argument]?.div_ceil(per.max(step())) + more)
        }
        // Or has more stores: the addresses may be on the stack meanwhile.
        Rounds::Copied { argument, per } => {
            let stored = per * loops::fewest_stores(graph, one);
            Rounds::Times(arguments[argument]?.div_ceil(per.max(step()).max(stored)))
        }
        Rounds::Mask(bits) => Rounds::Times(bits.div_ceil(loops::smallest_shift(graph, one))),
        other => other,
    })
}
