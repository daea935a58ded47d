//! The C interface: what `hal/trueup_node.c` calls. `hal/trueup_servo.h` declares the same.
//!
//! The memory of a bridge belongs to the caller: [`BRIDGE_MEMORY_BYTES`] of it, aligned to [`BRIDGE_MEMORY_ALIGNMENT`], so that nothing is
//! allocated. A pointer that is null is refused; any other has to point to what the function says.
#![allow(unsafe_code, reason = "the edge to C")]

use core::{ffi::c_char, mem, ptr, slice};

use trueup_core::design_parameters::TEMPERATURE_CHANNEL_COUNT;
use trueup_linuxcnc_core::joint_offsets::MAX_JOINTS;
use trueup_store::{
    calibration::BlobError,
    retained_state::{RETAINED_COPY_SIZE, RetainedCopies},
};

use crate::{
    sensor::SensorScale,
    servo::{ComponentOutputs, Joint, ServoBridge, ServoError, ServoInputs, ServoSettings},
};

/// Bytes of memory of a bridge.
pub const BRIDGE_MEMORY_BYTES: usize = 65_536;
/// Alignment of this memory.
pub const BRIDGE_MEMORY_ALIGNMENT: usize = 16;
/// Bytes of the two copies of what outlasts a restart.
pub(crate) const RETAINED_BYTES: usize = 2 * RETAINED_COPY_SIZE;
const _: () = assert!(RETAINED_BYTES == mem::size_of::<RetainedCopies>());
const _: () = assert!(
    mem::size_of::<ServoBridge>() <= BRIDGE_MEMORY_BYTES
        && mem::align_of::<ServoBridge>() <= BRIDGE_MEMORY_ALIGNMENT
);

/// [`ServoSettings`] in C.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct CSettings {
    /// Millimetres in a machine unit.
    pub mm_per_unit: f64,
    /// Codes of the board's converter for a volt of the sensor.
    pub codes_per_v: f64,
    /// Smallest step of the source, in volts.
    pub resolution_v: f64,
    /// As [`ServoSettings::against_um`].
    pub against_um: [f64; 3],
    /// As [`ServoSettings::acceleration`].
    pub acceleration: [f64; 3],
    /// Least position of each joint, in machine units.
    pub joint_min: [f64; MAX_JOINTS],
    /// Largest position of each joint, in machine units.
    pub joint_max: [f64; MAX_JOINTS],
    /// Axis of each joint, 0…2; below 0: no offset enters there.
    pub joint_axis: [i32; MAX_JOINTS],
    /// As [`ServoSettings::temperature_timeout_ms`].
    pub temperature_timeout_ms: u32,
    /// A bit for each axis: as [`ServoSettings::planner_keeps_slew`].
    pub planner_keeps_slew: u32,
    /// Not 0: angles are given.
    pub sends_rotary: u32,
}

/// [`ServoInputs`] in C: flags are bits of `bits`.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct CInputs {
    /// As [`ServoInputs`].
    pub position: [f64; 3],
    /// As [`ServoInputs`].
    pub request: [f64; 3],
    /// As [`ServoInputs`].
    pub eoffset: [f64; 3],
    /// As [`ServoInputs`].
    pub angles_deg: [f64; 2],
    /// As [`ServoInputs`].
    pub spindle_rpm: f64,
    /// As [`ServoInputs`].
    pub load_n: f64,
    /// As [`ServoInputs`].
    pub sensor_v: f64,
    /// As [`ServoInputs`].
    pub temperature_c: [f64; TEMPERATURE_CHANNEL_COUNT],
    /// As [`ServoInputs`].
    pub joint_now: [f64; MAX_JOINTS],
    /// As [`ServoInputs`].
    pub joint_command: [f64; MAX_JOINTS],
    /// As [`ServoInputs`].
    pub joint_reference: [f64; MAX_JOINTS],
    /// As [`ServoInputs`].
    pub tool: i32,
    /// As [`ServoInputs`].
    pub conditions: u32,
    /// As [`ServoInputs`].
    pub joint_homing: u32,
    /// From bit 0: enable, machine on, homed, zero, confirm, heartbeat of the temperatures.
    pub bits: u32,
}

/// [`ComponentOutputs`] in C.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct COutputs {
    /// Offsets of the bridge, in µm.
    pub offset_um: [f64; 3],
    /// Offsets that LinuxCNC has applied, in µm.
    pub applied_um: [f64; 3],
    /// Goal of each joint's offset, in machine units.
    pub joint_offset: [f64; MAX_JOINTS],
    /// Least offset of each joint, in machine units.
    pub joint_min: [f64; MAX_JOINTS],
    /// Largest offset of each joint, in machine units.
    pub joint_max: [f64; MAX_JOINTS],
    /// Temperatures that the bridge has, in °C; not a number: none.
    pub temperature_c: [f64; TEMPERATURE_CHANNEL_COUNT],
    /// Elongation of the spindle by its sensor, in µm; not a number: none.
    pub elongation_um: f64,
    /// To be added to the counts of X, Y and Z, with wrapping.
    pub counts: [i32; 3],
    /// As on the wire.
    pub quality: i32,
    /// As on the wire.
    pub flags: u32,
    /// State of the bridge: item 8 of `Status`.
    pub state: u32,
    /// Milliseconds since the sample on which the offset rests.
    pub age_ms: u32,
    /// CRC of the calibration.
    pub calibration: u32,
    /// From bit 0: applied, connected, fault, limited, heartbeat.
    pub bits: u32,
}

impl CSettings {
    fn to_settings(self) -> ServoSettings {
        let mut joints = [None; MAX_JOINTS];
        let limits = self.joint_min.iter().zip(&self.joint_max);
        for (place, (axis, (low, high))) in
            joints.iter_mut().zip(self.joint_axis.iter().zip(limits))
        {
            *place = usize::try_from(*axis).ok().map(|axis| Joint { axis, limits: [*low, *high] });
        }
        let bit = |number: u32| self.planner_keeps_slew >> number & 1 == 1;
        ServoSettings {
            mm_per_unit: self.mm_per_unit,
            sensor: SensorScale { codes_per_v: self.codes_per_v, resolution_v: self.resolution_v },
            sends_rotary: self.sends_rotary != 0,
            against_um: self.against_um,
            acceleration: self.acceleration,
            planner_keeps_slew: [bit(0), bit(1), bit(2)],
            joints,
            temperature_timeout_ms: self.temperature_timeout_ms,
        }
    }
}

impl CInputs {
    #[allow(clippy::cast_possible_truncation, reason = "16 bits are used")]
    fn to_inputs(self) -> ServoInputs {
        let bit = |number: u32| self.bits >> number & 1 == 1;
        ServoInputs {
            enable: bit(0),
            machine_on: bit(1),
            homed: bit(2),
            zero: bit(3),
            confirm: bit(4),
            temperature_heartbeat: bit(5),
            position: self.position,
            request: self.request,
            eoffset: self.eoffset,
            angles_deg: self.angles_deg,
            spindle_rpm: self.spindle_rpm,
            load_n: self.load_n,
            tool: self.tool,
            conditions: self.conditions as u16,
            joint_now: self.joint_now,
            joint_command: self.joint_command,
            joint_reference: self.joint_reference,
            joint_homing: self.joint_homing as u16,
            sensor_v: self.sensor_v,
            temperature_c: self.temperature_c,
        }
    }
}

impl COutputs {
    fn from_outputs(outputs: &ComponentOutputs, nm_per_unit: f64) -> Self {
        let units = |nm: f64| nm / nm_per_unit;
        let bit = |number: u32, is_set: bool| u32::from(is_set) << number;
        Self {
            offset_um: outputs.offset_um,
            applied_um: outputs.applied_um,
            joint_offset: outputs.joints.map(|joint| units(joint.offset_nm)),
            joint_min: outputs.joints.map(|joint| units(joint.min_nm)),
            joint_max: outputs.joints.map(|joint| units(joint.max_nm)),
            temperature_c: outputs.temperatures_c.map(|celsius| celsius.unwrap_or(f64::NAN)),
            elongation_um: outputs.elongation_um.unwrap_or(f64::NAN),
            counts: outputs.counts,
            quality: outputs.quality as i32,
            flags: outputs.flags.0.into(),
            state: outputs.state.0,
            age_ms: outputs.age_ms,
            calibration: outputs.calibration.unwrap_or(0),
            bits: bit(0, outputs.applied)
                | bit(1, outputs.connected)
                | bit(2, outputs.fault)
                | bit(3, outputs.limited)
                | bit(4, outputs.heartbeat),
        }
    }
}

/// Starts a bridge in `memory` with the calibration in `blob`. Returns 0, or the number of a refusal, which
/// [`trueup_servo_reason`] puts into words.
///
/// # Safety
/// `memory` is aligned and has `size` bytes that nothing else uses from now on; `blob` has `length` bytes that stay as
/// they are for as long as the bridge is used; `settings` is whole.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn trueup_servo_start(
    memory: *mut u8,
    size: usize,
    blob: *const u8,
    length: usize,
    settings: *const CSettings,
    period_ns: u64,
) -> i32 {
    let place = memory.cast::<ServoBridge>();
    if place.is_null()
        || !place.is_aligned()
        || size < mem::size_of::<ServoBridge>()
        || blob.is_null()
    {
        return error_code::MEMORY_MISMATCH;
    }
    // SAFETY: not null; the caller's word for the rest.
    let (blob, settings) = unsafe { (slice::from_raw_parts(blob, length), settings.as_ref()) };
    let Some(settings) = settings else { return error_code::MEMORY_MISMATCH };
    match ServoBridge::new(blob, &settings.to_settings(), period_ns) {
        // SAFETY: aligned and large enough, as looked at above; the memory is the bridge's own.
        Ok(servo) => unsafe {
            ptr::write(place, servo);
            0
        },
        Err(refusal) => error_code::from_servo_error(&refusal),
    }
}

/// Runs a servo period. Returns 0, or the number of a refusal: then `outputs` is as it was.
///
/// # Safety
/// `memory` is that of a bridge that was started; `inputs` and `outputs` are whole.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn trueup_servo_step(
    memory: *mut u8,
    inputs: *const CInputs,
    outputs: *mut COutputs,
    period_ns: u64,
) -> i32 {
    // SAFETY: the caller's word; null is looked at.
    let all = unsafe { (memory.cast::<ServoBridge>().as_mut(), inputs.as_ref(), outputs.as_mut()) };
    let (Some(servo), Some(inputs), Some(outputs)) = all else {
        return error_code::MEMORY_MISMATCH;
    };
    match servo.step(&inputs.to_inputs(), period_ns) {
        Ok(all) => {
            *outputs = COutputs::from_outputs(&all, servo.nm_per_unit());
            0
        }
        Err(refusal) => error_code::from_servo_error(&refusal),
    }
}

/// Goes on with the heat from before a restart; `now_s` is the wall's clock, 0: there is none. Without this call the
/// machine counts as cold.
///
/// # Safety
/// `memory` is that of a bridge that was started; `copies` has `TRUEUP_RETAINED_BYTES`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn trueup_servo_resume(memory: *mut u8, copies: *const u8, now_s: u32) {
    // SAFETY: the caller's word; null is looked at. Copies are bytes, which need no alignment.
    let all = unsafe {
        (memory.cast::<ServoBridge>().as_mut(), copies.cast::<RetainedCopies>().as_ref())
    };
    if let (Some(servo), Some(copies)) = all {
        servo.resume(copies, (now_s != 0).then_some(now_s));
    }
}

/// Saves the heat once a second. Returns 1 if it did.
///
/// # Safety
/// As [`trueup_servo_resume`]; another process may read the copies meanwhile, and finds by the CRC which one is whole.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn trueup_servo_retain(memory: *mut u8, copies: *mut u8) -> i32 {
    // SAFETY: as above.
    let all = unsafe {
        (memory.cast::<ServoBridge>().as_mut(), copies.cast::<RetainedCopies>().as_mut())
    };
    let (Some(servo), Some(copies)) = all else { return 0 };
    i32::from(servo.save_retained_state(copies))
}

/// Returns the sentence for the number of a refusal.
#[unsafe(no_mangle)]
pub extern "C" fn trueup_servo_reason(number: i32) -> *const c_char {
    error_code::message(number).as_ptr()
}

/// Refusals as numbers.
mod error_code {
    use super::{BlobError, ServoError};
    use core::ffi::CStr;

    pub const MEMORY_MISMATCH: i32 = 1;

    pub fn from_servo_error(refusal: &ServoError) -> i32 {
        match refusal {
            ServoError::Period(_) => 2,
            ServoError::Calibration(error) => match error {
                BlobError::Magic { .. } => 3,
                BlobError::TooShort { .. } | BlobError::Length { .. } => 4,
                BlobError::Schema { .. } => 5,
                BlobError::Crc { .. } => 6,
                _ => 7,
            },
        }
    }

    pub fn message(number: i32) -> &'static CStr {
        match number {
            0 => c"nothing is wrong",
            MEMORY_MISMATCH => c"the component and its library do not fit together: build it again (trueup linuxcnc component)",
            2 => c"the servo period is none of 0.5, 1, 2 and 4 ms: set [EMCMOT]SERVO_PERIOD to 500000, 1000000, 2000000 or 4000000, and BASE_PERIOD of a base thread to a divisor of it",
            3 => c"the file is no calibration: write it with trueup compile, or run trueup linuxcnc setup again",
            4 => c"the calibration is not whole: write it with trueup compile, or run trueup linuxcnc setup again",
            5 => c"the calibration was written by another version of trueup: run trueup linuxcnc setup again",
            6 => c"the calibration is damaged (its CRC does not fit): run trueup linuxcnc setup again",
            _ => c"the calibration contradicts itself: run trueup compile on the machine file for the details",
        }
    }
}
