//! The faults of a node. Each lost input is one of its own: the second loss is reported while the first lasts.

use trueup_canopen::emergency::{Fault, Faults, faults_from_output};
use trueup_core::{
    cnc::{OffsetFlags, Output},
    index_set::IndexSet,
};

use super::Node;

impl Node<'_> {
    /// Returns the faults, with an output like this.
    pub(super) fn faults(&self, output: &Output) -> Faults {
        let board = self.board_faults;
        let known =
            [Fault::Crystal, Fault::Pll, Fault::Can].iter().any(|fault| board.contains(*fault));
        faults_from_output(output)
            .union(board)
            .union(self.lost_inputs(output.flags))
            .with_fault_if(self.bridge.is_none(), Fault::NoCalibration)
            .with_fault_if(self.consumer.is_lost(), Fault::HeartbeatLost)
            .with_fault_if(self.degraded && !known, Fault::Degraded)
            .with_fault_if(!self.master.is_engage_sequence_complete(), Fault::Restarted)
            .with_fault_if(self.master.has_second_sender(), Fault::SecondMaster)
            .with_fault_if(self.zero_refused, Fault::ZeroRefused)
            .with_fault_if(self.learned_refused, Fault::LearnedRefused)
            .with_fault_if(self.state.has_position_jumped(), Fault::PositionJump)
            .with_fault_if(self.state.is_sensor_anomalous(), Fault::SensorOdd)
            .with_fault_if(
                self.bridge.as_ref().is_some_and(|bridge| bridge.has_fallback_failed(&self.state)),
                Fault::SourceDead,
            )
            .with_fault_if(
                self.bridge
                    .as_ref()
                    .is_some_and(|bridge| bridge.has_source_disagreement(&self.state)),
                Fault::CalibrationUnfit,
            )
            .union(self.questions)
    }

    /// Returns the lost inputs, with the flags of an output. A flag without a source that is lost by now was a
    /// short loss of the sensor or of `Control`, and is not overlooked.
    fn lost_inputs(&self, flags: OffsetFlags) -> Faults {
        let lost =
            self.bridge.as_ref().map(|bridge| bridge.lost_inputs(&self.state)).unwrap_or_default();
        let has_thermometers = lost.thermometers != IndexSet::default();
        let sensor =
            lost.sensor || (flags.contains(OffsetFlags::SENSOR_FAULT) && !has_thermometers);
        let sources = Faults::default()
            .with_fault_if(sensor, Fault::Sensor)
            .with_fault_if(flags.contains(OffsetFlags::CNC_LOST) && !lost.place, Fault::CncLost)
            .with_fault_if(lost.place, Fault::PlaceLost)
            .with_fault_if(lost.conditions, Fault::ConditionsLost);
        let of = |sources: Faults, channels: IndexSet, faults: [Fault; 8]| {
            let numbered = faults.into_iter().enumerate();
            numbered.fold(sources, |all, (channel, fault)| {
                all.with_fault_if(channels.contains(channel), fault)
            })
        };
        let sources = of(sources, lost.thermometers, Fault::THERMOMETER_FAULTS);
        of(sources, lost.too_fast, Fault::TEMPERATURE_RATE_FAULTS)
    }
}
