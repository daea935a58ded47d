//! Directions and places on the workpiece and on the tool, along the machine's axes.

use trueup_machine::{Machine, machine_file::AxisChain, model::rotate_about_axis};

use super::reading::Pose;

/// Where the workpiece and the tool are turned to.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ForwardKinematics<'m> {
    machine: &'m Machine,
    chain: &'m AxisChain,
}

impl<'m> ForwardKinematics<'m> {
    /// Returns the frame of a machine.
    #[must_use]
    pub fn new(machine: &'m Machine, chain: &'m AxisChain) -> Self {
        Self { machine, chain }
    }

    /// Returns the way from the spindle nose to the tip, along the machine's axes.
    #[must_use]
    pub(crate) fn tip_offset_mm(&self, pose: &Pose) -> [f64; 3] {
        let volume = &self.machine.volume;
        let direction = self.machine.tool_direction;
        let mut tip = [0, 1, 2].map(|n| volume.tool.offset_mm[n] + pose.tool_mm * direction[n]);
        for &axis in self.chain.head.iter().rev() {
            let point = volume.axis_line_point_mm(axis);
            let arm = [0, 1, 2].map(|n| tip[n] - point[n]);
            let arm = rotate_about_axis(arm, axis, pose.angle_deg[axis.index()]);
            tip = [0, 1, 2].map(|n| point[n] + arm[n]);
        }
        tip
    }

    /// Returns the place of the tip on the workpiece.
    #[must_use]
    pub(crate) fn tip_on_workpiece_mm(&self, pose: &Pose) -> [f64; 3] {
        let tip = self.tip_offset_mm(pose);
        let mut seen = [0, 1, 2].map(|n| pose.position_mm[n] + tip[n]);
        for &axis in &self.chain.table {
            let point = self.machine.volume.axis_line_point_mm(axis);
            let arm = [0, 1, 2].map(|n| seen[n] - point[n]);
            let arm = rotate_about_axis(arm, axis, pose.angle_deg[axis.index()]);
            seen = [0, 1, 2].map(|n| point[n] + arm[n]);
        }
        seen
    }

    /// Returns a direction of the workpiece along the machine's axes.
    #[must_use]
    pub(crate) fn workpiece_direction_to_machine(&self, vector: [f64; 3], pose: &Pose) -> [f64; 3] {
        let table = self.chain.table.iter().rev();
        table.fold(vector, |vector, &axis| {
            rotate_about_axis(vector, axis, -pose.angle_deg[axis.index()])
        })
    }

    /// Returns a direction of the tool along the machine's axes.
    #[must_use]
    pub(crate) fn tool_direction_to_machine(&self, vector: [f64; 3], pose: &Pose) -> [f64; 3] {
        let head = self.chain.head.iter().rev();
        head.fold(vector, |vector, &axis| {
            rotate_about_axis(vector, axis, pose.angle_deg[axis.index()])
        })
    }
}
