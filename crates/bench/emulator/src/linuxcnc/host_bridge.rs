//! The board's own code on this computer: the offsets that a machine file asks for, a millisecond after the other.

use std::collections::BTreeMap;

use anyhow::{Context as _, Result};
use trueup_core::{
    bridge::{Bridge, BridgeState, TickInput},
    cnc::{AxisPosition, CncMessage, Control, LinearAxis, RotaryAxisAngles, TravelDirection},
    units::{MicroDegrees, Position, Rpm, TimestampMs},
};
use trueup_machine::{CompiledCalibration, Machine, inputs::TemperatureInput};
use trueup_virtual_bridge::{analogue_front_end::AnalogueFrontEnd, replay};

use super::plant::ServoCycle;

const NANOMETRES_PER_MM: f64 = 1e6;
/// Time for which the machine stands before the first cycle, in ms: the offset arrives at the slew limit.
const SETTLING_DURATION_MS: usize = 2_000;
/// Within the range of any sensor.
const SENSOR_VOLTS: f64 = 1.5;
const AMBIENT_TEMPERATURE_C: f64 = 20.0;

/// A bridge with the head of its machine straight and its spindle at rest.
pub(crate) struct HostBridge<'a> {
    bridge: Bridge<'a>,
    state: BridgeState,
    front_end: AnalogueFrontEnd,
    temperatures: &'a BTreeMap<String, TemperatureInput>,
    now: TimestampMs,
    before_mm: [f64; 3],
}

impl<'a> HostBridge<'a> {
    /// Switches it on, with this seed of the noise of its converter.
    ///
    /// # Errors
    /// The machine file has no inputs.
    pub fn new(compiled: &'a CompiledCalibration, file: &'a Machine, seed: u64) -> Result<Self> {
        let inputs = file.inputs.as_ref().context("the machine file has its inputs")?;
        let sensor = inputs.sensor.as_ref().context("the machine file has a sensor")?;
        let bridge = Bridge::new(compiled.calibration());
        Ok(Self {
            state: bridge.initial_state(),
            bridge,
            front_end: AnalogueFrontEnd::new(sensor.divider, seed),
            temperatures: &inputs.temperatures,
            now: TimestampMs(0),
            before_mm: [0.0; 3],
        })
    }

    /// Lives for a millisecond at these positions, volts of the sensor and temperatures by the names of their columns.
    /// Returns the offset in mm, where there is one.
    pub fn step(
        &mut self,
        position_mm: [f64; 3],
        volts: f64,
        celsius: &BTreeMap<String, f64>,
    ) -> Option<[f64; 3]> {
        let Self { bridge, state, .. } = self;
        bridge.receive(state, CncMessage::Control(Control::ENGAGED));
        bridge
            .receive(state, CncMessage::Rotary(RotaryAxisAngles { angles: [MicroDegrees(0); 2] }));
        let both = position_mm.into_iter().zip(&mut self.before_mm);
        for (axis, (mm, before_mm)) in LinearAxis::ALL.into_iter().zip(both) {
            let position = Position((mm * f64::from(Position::PER_MILLIMETRE)).round() as i32);
            let direction = match mm - std::mem::replace(before_mm, mm) {
                way if way > 0.0 => TravelDirection::Positive,
                way if way < 0.0 => TravelDirection::Negative,
                _ => TravelDirection::Standing,
            };
            bridge.receive(state, CncMessage::Position(AxisPosition { axis, position, direction }));
        }
        let temperatures = replay::raw_temperatures_from_celsius(self.temperatures, celsius);
        let codes = self.front_end.convert_block(|_| volts);
        self.now = self.now.wrapping_add_ms(1);
        let input = TickInput {
            codes: Some(&codes),
            speed: Some(Rpm(0)),
            temperatures: Some(&temperatures),
        };
        let output = bridge.tick(state, self.now, input);
        Some(output.offset?.map(|nm| f64::from(nm.0) / NANOMETRES_PER_MM))
    }
}

/// Returns the offsets in µm that the machine file asks for where these cycles are commanded, without any delay and at a
/// temperature that stands.
///
/// # Errors
/// It does not compile, or asks for none.
pub(crate) fn requested_offset_um(file: &Machine, cycles: &[&ServoCycle]) -> Result<Vec<[f64; 3]>> {
    let compiled = trueup_machine::compile(file)?;
    let mut bridge = HostBridge::new(&compiled, file, 1)?;
    let celsius =
        bridge.temperatures.keys().map(|name| (name.clone(), AMBIENT_TEMPERATURE_C)).collect();
    let first = cycles.first().context("there are cycles")?.commanded_mm();
    for _ in 0..SETTLING_DURATION_MS {
        bridge.step(first, SENSOR_VOLTS, &celsius);
    }
    let requested = |cycle: &&ServoCycle| {
        let mm = bridge.step(cycle.commanded_mm(), SENSOR_VOLTS, &celsius);
        Ok(mm.context("the machine file gives no offset")?.map(|mm| mm * 1e3))
    };
    cycles.iter().map(requested).collect()
}
