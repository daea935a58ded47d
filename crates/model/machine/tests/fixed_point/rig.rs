//! The whole bridge: from inputs to the offset that leaves it.

use trueup_core::{
    bridge::{Bridge, BridgeState, TickInput},
    cnc::{
        AxisPosition, CncMessage, Control, LinearAxis, OffsetQuality, RotaryAxisAngles,
        TravelDirection,
    },
    design_parameters::{CODES_PER_TICK, TEMPERATURE_CHANNEL_COUNT},
    thermometer::RawTemperatureReading,
    units::{AdcCode, MicroDegrees, Position, Rpm, TimestampMs},
};
use trueup_machine::{
    CompiledCalibration, Machine,
    model::{ReferenceModel, RowInputs},
};

use crate::gantry::*;

/// A bridge with the hand that feeds it.
pub struct Rig<'c> {
    pub bridge: Bridge<'c>,
    pub state: BridgeState,
    pub ms: u32,
    pub raw: [RawTemperatureReading; TEMPERATURE_CHANNEL_COUNT],
    pub position_mm: [f64; 3],
    pub heading: [TravelDirection; 3],
    pub angles_deg: [f64; 2],
    /// Counts of the paper's chain, whole codes.
    pub counts: u16,
    pub rpm: u16,
}

impl<'c> Rig<'c> {
    pub fn new(compiled: &'c CompiledCalibration) -> Self {
        let mut calibration = compiled.calibration();
        // Where an offset goes is asked here, not how fast.
        calibration.limits.slew_nm_per_s = u32::MAX;
        let bridge = Bridge::new(calibration);
        Self {
            state: bridge.initial_state(),
            bridge,
            ms: 0,
            raw: [RawTemperatureReading::NONE; TEMPERATURE_CHANNEL_COUNT],
            position_mm: [0.0; 3],
            heading: [TravelDirection::Positive; 3],
            angles_deg: [0.0; 2],
            counts: 5_048,
            rpm: 24_000,
        }
    }

    /// Returns the offset after this many milliseconds, in nm.
    pub fn offset_nm(&mut self, ms: u32) -> [i32; 3] {
        let mut last = None;
        for _ in 0..ms {
            self.ms += 1;
            let (bridge, state) = (&self.bridge, &mut self.state);
            let control = Control::ENGAGED;
            bridge.receive(state, CncMessage::Control(control));
            for axis in LinearAxis::ALL {
                let position = (self.position_mm[axis as usize] * UNITS_PER_MM).round() as i32;
                let direction = self.heading[axis as usize];
                let received = AxisPosition { axis, position: Position(position), direction };
                bridge.receive(state, CncMessage::Position(received));
            }
            let angles =
                self.angles_deg.map(|degrees| MicroDegrees((degrees * 1e6).round() as i32));
            bridge.receive(state, CncMessage::Rotary(RotaryAxisAngles { angles }));
            let code = self.counts / 8;
            let codes: [AdcCode; CODES_PER_TICK] = std::array::from_fn(|n| match n % 4 {
                0 => AdcCode(code - 1),
                2 => AdcCode(code + 1),
                _ => AdcCode(code),
            });
            let input = TickInput {
                codes: Some(&codes),
                speed: Some(Rpm(self.rpm)),
                temperatures: Some(&self.raw),
            };
            last = Some(bridge.tick(state, TimestampMs(self.ms), input));
        }
        let output = last.expect("at least a millisecond");
        assert_eq!(output.quality, OffsetQuality::Live, "{:?}", output.flags);
        output.offset.expect("live").map(|nm| nm.0)
    }

    /// Paper 2's chain, 16 counts a kelvin above 4000.
    pub fn heat_to(&mut self, channel: usize, celsius: f64) {
        // With this divider 32768 counts are 4096 codes, delivered in 1/256.
        self.raw[channel] =
            RawTemperatureReading(((4_000.0 + 16.0 * celsius) / 8.0 * 256.0).round() as i32);
    }
}

/// Returns a machine of `sections` with wide limits, `kind` and `inputs` as a user writes them.
pub fn machine_of(kind: &str, sections: &str) -> String {
    format!(
        "[machine]\nname = \"mill\"\nkind = {kind}\n[inputs]\n\
         sensor = {{ volts_full_scale = 10.0, counts_full_scale = 32768, divider = 0.33 }}\n\
         temp_x_c = {{ channel = 2, kind = \"linear\", zero_counts = 4000, counts_per_c = 16, counts_full_scale = 32768, divider = 0.33 }}\n\
         [limits]\nmax_um = {{ x = 4000, y = 4000, z = 4000 }}\nslew_um_per_s = 10000\n{sections}"
    )
}

pub const PAPERS_SENSOR: &str = "[spindle]\nsource = \"sensor\"\n[spindle.sensor]\nk0_um = 0.0\n\
                             zero_counts = 5048.0\num_per_count = 0.0152587890625\n";

/// The model says `error_nm`; the board's offset is its opposite.
pub fn assert_signs(
    machine: &Machine,
    rig: &mut Rig<'_>,
    ms: u32,
    situation: &RowInputs<'_>,
    error_nm: [f64; 3],
) {
    let model = ReferenceModel::new(machine).step(situation).error_um();
    for axis in 0..3 {
        let off = model[axis] * 1_000.0 - error_nm[axis];
        assert!(off.abs() < 0.5, "the model's axis {axis}: {} µm", model[axis]);
    }
    let offset = rig.offset_nm(ms);
    for axis in 0..3 {
        let off = f64::from(offset[axis]) + error_nm[axis];
        assert!(off.abs() <= 1.0, "the board's axis {axis}: {offset:?} nm against {error_nm:?}");
    }
}

pub fn at(position_mm: [f64; 3]) -> RowInputs<'static> {
    RowInputs { position_mm, direction: [1.0; 3], angle_deg: [0.0; 3], ..RowInputs::UNKNOWN }
}
