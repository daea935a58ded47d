//! The start of the node.

use core::mem::MaybeUninit;

use trueup_core::calibration::Calibration;
use trueup_node::{configuration::NodeConfiguration, node::Node};

/// Puts the node in its place. Apart from the start, because a node and its calibration are moved by value here:
/// their stack is free again before the rest of the start needs its own.
#[inline(never)]
pub fn init_node_in_place(
    place: &'static mut MaybeUninit<Node<'static>>,
    calibration: Option<&Calibration<'static>>,
    with: impl FnOnce(Option<Calibration<'static>>) -> NodeConfiguration<'static>,
) -> &'static mut Node<'static> {
    place.write(Node::new(with(calibration.copied())))
}
