//! The machine and its CNC: a spindle that grows, a bridge's calibration for it, and a CNC that obeys
//! the rules of the README.

use trueup_core::{
    calibration::{AxisModel, Calibration, MachineIdentity},
    cnc::{Control, Output, SpindleState},
    design_parameters::TEMPERATURE_CHANNEL_COUNT,
    kinematics::Kinematics,
    limits::CompensationLimits,
    thermometer::Thermometer,
    tool_direction::ToolDirection,
    units::{Nanometres, Rpm, Temperature},
};
use trueup_link::{frame::Frame, frames, receiver::OffsetReceiver};

use crate::{
    axis::{SPEED, pitch},
    spindle_model::{KnownSpindle, per_step},
};

/// The largest offset on an axis, nm, and the slew limit, nm in a millisecond.
pub const MAX_NM: i32 = 15_000;
pub const SLEW_NM_PER_MS: i32 = 200;
/// Nanometres that a wire bit may add to a step.
pub const WIRE_NM: i32 = 10;
/// A code is this many nanometres of growth.
pub const NM_PER_CODE: f64 = 122.0;
pub const ZERO_CODE: f64 = 600.0;
/// τ of the spindle's heat, and its growth when warm through.
pub const TAU_S: f64 = 60.0;
pub const GROWTH_NM: f64 = 60_000.0;
/// The law by temperature, in nm a kelvin.
pub const NM_PER_KELVIN: i32 = 4_000;

/// Returns a sensor, then a temperature with a lag, then running time; and one of the two tables of X.
pub fn calibration(table: usize) -> Calibration<'static> {
    let mut thermometers = [None; TEMPERATURE_CHANNEL_COUNT];
    // One count a kelvin.
    thermometers[2] = Some(Thermometer::Linear { zero: 0, slope: 16_000, shift: 0 });
    thermometers[4] = thermometers[2];
    let spindle = KnownSpindle {
        zero_code: ZERO_CODE,
        nm_per_code: NM_PER_CODE,
        channel: 2,
        nm_per_kelvin: NM_PER_KELVIN.into(),
        lag: per_step(TAU_S),
        growth_nm: GROWTH_NM,
        tau_s: TAU_S,
    };
    Calibration {
        thermometers,
        spindle: spindle.model(),
        kinematics: Kinematics { zero: ToolDirection::DOWN, axes: [None; 2] },
        axes: [
            AxisModel {
                pitch: Some(pitch(table)),
                rapid: SPEED.unsigned_abs(),
                ..AxisModel::default()
            },
            AxisModel::default(),
            AxisModel::default(),
        ],
        straightness: Default::default(),
        squareness: Default::default(),
        volume: None,
        terms: Default::default(),
        limits: CompensationLimits {
            max: [Nanometres(MAX_NM); 3],
            slew_nm_per_s: SLEW_NM_PER_MS as u32 * 1_000,
            link_timeout_ms: 500,
            hold_ms: 2_000,
            rejoin_nm_per_s: 10,
            learned: Default::default(),
        },
        cold_within: Temperature(Temperature::PER_KELVIN / 2),
        guards: Default::default(),
        names: MachineIdentity::default(),
    }
}

/// The machine: how far the spindle has grown, and whether it runs.
pub struct GrowingSpindle {
    pub heat: f64,
    pub runs: bool,
}

impl GrowingSpindle {
    pub fn live(&mut self) {
        let target = if self.runs { 1.0 } else { 0.0 };
        self.heat += (target - self.heat) * (1e-3 / TAU_S);
    }

    pub fn grown_nm(&self) -> f64 {
        self.heat * GROWTH_NM
    }
}

/// The CNC, by the README: what it applies follows what it receives, at the slew limit, and `Engage` is
/// raised only where it applies nothing.
pub struct Cnc {
    pub ears: OffsetReceiver,
    pub applied_nm: i32,
    pub received: Option<Output>,
    pub silent_ms: u32,
    pub is_engage_requested: bool,
    pub raised: bool,
    pub since_ms: u32,
    pub counters: [u8; 2],
}

impl Cnc {
    pub fn new() -> Self {
        Self {
            ears: OffsetReceiver::new(),
            applied_nm: 0,
            received: None,
            silent_ms: u32::MAX,
            is_engage_requested: true,
            raised: false,
            since_ms: 0,
            counters: [0; 2],
        }
    }

    pub fn receive(&mut self, frame: &Frame) {
        if let Ok(Some(output)) = self.ears.accept(frame) {
            (self.received, self.silent_ms) = (Some(output), 0);
        }
    }

    /// A millisecond: it moves what it applies.
    pub fn live(&mut self) {
        self.silent_ms = self.silent_ms.saturating_add(1);
        self.since_ms = self.since_ms.saturating_add(1);
        let available =
            self.received.filter(|_| self.silent_ms <= 100).and_then(|received| received.offset);
        let goal = match available {
            Some(offset) => Some(offset[2].0),
            None if self.silent_ms <= 2_000 && self.silent_ms > 100 => None,
            None => Some(0),
        };
        if let Some(goal) = goal {
            let step =
                (goal - self.applied_nm).clamp(-SLEW_NM_PER_MS - WIRE_NM, SLEW_NM_PER_MS + WIRE_NM);
            self.applied_nm += step;
        }
        let waits = available.is_none() && self.silent_ms <= 100;
        let falls = self.raised && (!self.is_engage_requested || (waits && self.since_ms >= 1_000));
        let rises = !self.raised
            && self.is_engage_requested
            && self.applied_nm == 0
            && self.since_ms >= 120;
        if falls || rises {
            (self.raised, self.since_ms) = (rises, 0);
        }
    }

    pub fn control(&mut self, zero: bool) -> Frame {
        let control = Control { engage: self.raised, zero, ..Control::REFERENCED };
        let counter = self.counters[0];
        self.counters[0] = counter.wrapping_add(1);
        frames::encode_control(control, counter)
    }

    pub fn spindle(&mut self, runs: bool) -> Frame {
        let counter = self.counters[1];
        self.counters[1] = counter.wrapping_add(1);
        frames::encode_spindle(
            SpindleState { speed: Rpm(if runs { 12_000 } else { 0 }), load_n: 0 },
            counter,
        )
    }
}
