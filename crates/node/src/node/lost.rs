//! Lost inputs as faults, one for each source: the second loss is reported while the first lasts.

use trueup_canopen::emergency::{Fault, Faults};
use trueup_core::{cnc::Flags, set::IndexSet};

use super::Node;

impl Node<'_> {
    /// Returns the lost inputs, with the flags of an output. A flag without a source that is lost by now was a
    /// short loss of the sensor or of `Control`, and is not overlooked.
    pub(super) fn lost_inputs(&self, flags: Flags) -> Faults {
        let lost = self.bridge.as_ref().map(|it| it.lost_inputs(&self.state)).unwrap_or_default();
        let has_thermometers = lost.thermometers != IndexSet::default();
        let sensor = lost.sensor || (flags.contains(Flags::SENSOR_FAULT) && !has_thermometers);
        let sources = Faults::default()
            .with_if(sensor, Fault::Sensor)
            .with_if(flags.contains(Flags::CNC_LOST) && !lost.place, Fault::CncLost)
            .with_if(lost.place, Fault::PlaceLost);
        let of = |sources: Faults, channels: IndexSet, faults: [Fault; 8]| {
            let numbered = faults.into_iter().enumerate();
            numbered
                .fold(sources, |all, (channel, fault)| all.with_if(channels.has(channel), fault))
        };
        let sources = of(sources, lost.thermometers, Fault::THERMOMETERS);
        of(sources, lost.too_fast, Fault::TEMPERATURE_RATES)
    }
}
