//! The bridge in the servo thread gives the same offsets, to the bit, as the host's node at the end of a line.
//!
//! The one side is the C interface, in memory and with structures as C has them. The other is a node of its own and a
//! component of its own, between which every frame goes through the text of the serial line; its codes and deliveries are
//! computed here, from the definitions. Both get the same random machine: axes that move, stand and reverse, a sensor with
//! noise that freezes, breaks and jumps, thermometers that fail, an operator who lets go.

#![allow(unsafe_code, reason = "the C interface")]
#![allow(clippy::print_stdout, reason = "a test prints its figures")]

use std::{path::Path, time::Duration};

use trueup_core::{
    bridge::TickInput,
    cnc::MachineConditions,
    design_parameters::{CODES_PER_TICK, TEMPERATURE_CHANNEL_COUNT},
    thermometer::RawTemperatureReading,
    units::AdcCode,
};
use trueup_link::{frame::Frame, slcan};
use trueup_linuxcnc_core::{
    component::{Component, ComponentInputs, ComponentOptions, ComponentOutputs},
    joint_offsets::{JointReading, JointSettings, MAX_JOINTS},
    offset_follower::{AxisReading, RateLimits},
    offset_target::OffsetLimits,
};
use trueup_machine::{MachineFile, compile};
use trueup_node::{
    configuration::NodeConfiguration,
    node::{Interface, Node},
};
use trueup_servo::ffi::{
    BRIDGE_MEMORY_ALIGNMENT, BRIDGE_MEMORY_BYTES, CInputs, COutputs, CSettings,
    trueup_servo_reason, trueup_servo_start, trueup_servo_step,
};
use trueup_store::calibration::decode;

const MACHINE: &str = r#"
[machine]
name = "head"
kind = "head-head"
head_axes = ["c", "a"]
[inputs]
sensor = { volts_full_scale = 10.0, counts_full_scale = 32768, divider = 0.328 }
temp_screw_c = { channel = 0, kind = "pt100" }
temp_bed_c = { channel = 3, kind = "linear", zero_v = 0.0, c_per_v = 10.0, full_scale_v = 10.0 }
[spindle]
source = "sensor"
[spindle.sensor]
k0_um = 0.0
zero_counts = 5048.0
um_per_count = 0.0152587890625
[spindle.tools]
default = { um_per_krpm2 = 0.012 }
7 = { um_per_krpm2 = 0.021 }
[axis.x.pitch]
start_mm = -500.0
step_mm = 100.0
forward_um = [0.0, 3.0, 7.5, 9.0, 8.0, 12.5, 17.0, 16.0, 21.0, 20.0, 24.0]
[axis.x.thermal]
mode = "position"
sensor = "temp_screw_c"
reference_c = 23.0
slope_um_per_m_per_c = 14.21
lag_s = 30.0
[axis.y.backlash]
width_um = 6.0
ramp_mm = 0.05
[axis.z.thermal]
mode = "constant"
sensor = "temp_bed_c"
reference_c = 20.0
constant_um_per_c = 2.0
[straightness.z_of_y]
order = 4
knots_mm = [0.0, 0.0, 0.0, 0.0, 500.0, 1000.0, 1000.0, 1000.0, 1000.0]
control_um = [0.0, -17.0, -40.0, -17.0, 0.0]
[limits]
slew_um_per_s = 1200.0
"#;
const CODES_PER_V: f64 = 0.328 / 3.3 * 4096.0;
const RESOLUTION_V: f64 = 0.0005;

/// Numbers that look random: xorshift64.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0
    }

    /// From −1 to 1.
    fn around(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }

    fn one_in(&mut self, n: u64) -> bool {
        self.next().is_multiple_of(n)
    }
}

/// A machine whose pins are read by both sides.
struct World {
    random: Random,
    pins: CInputs,
    speed: [f64; 3],
    level_v: f64,
    is_frozen: bool,
    is_broken: bool,
}

impl World {
    fn new() -> Self {
        let pins = CInputs {
            position: [0.0, 300.0, 10.0],
            request: [0.0; 3],
            eoffset: [0.0; 3],
            angles_deg: [0.0; 2],
            spindle_rpm: 0.0,
            load_n: 0.0,
            sensor_v: 2.0,
            temperature_c: [f64::NAN; TEMPERATURE_CHANNEL_COUNT],
            joint_now: [0.0; MAX_JOINTS],
            joint_command: [0.0; MAX_JOINTS],
            joint_reference: [0.0; MAX_JOINTS],
            tool: 7,
            conditions: 0,
            joint_homing: 0,
            bits: 0b111,
        };
        let mut world = Self {
            random: Random(0x1234_5678_9abc_def1),
            pins,
            speed: [0.0; 3],
            level_v: 2.0,
            is_frozen: false,
            is_broken: false,
        };
        world.pins.temperature_c[0] = 22.0;
        world.pins.temperature_c[3] = 21.0;
        world
    }

    /// Lives a millisecond.
    fn step(&mut self) {
        let Self { random, pins, .. } = self;
        for (position, speed) in pins.position.iter_mut().zip(&mut self.speed) {
            if random.one_in(700) {
                *speed = if random.one_in(3) { 0.0 } else { 0.5 * random.around() };
            }
            *position = (*position + *speed).clamp(-480.0, 980.0);
        }
        pins.joint_command = [0.0; MAX_JOINTS];
        pins.joint_command[..3].copy_from_slice(&pins.position);
        if random.one_in(5_000) {
            pins.angles_deg = [180.0 * random.around(), 90.0 * random.around()];
        }
        if random.one_in(9_000) {
            pins.spindle_rpm = if random.one_in(3) { 0.0 } else { 18_000.0 * random.around() };
        }
        if random.one_in(20_000) {
            pins.tool = [-1, 0, 7, 12, 70_000][(random.next() % 5) as usize];
            pins.load_n = 500.0 * random.around();
        }
        for (flag, seldom) in [(0, 30_000), (1, 40_000), (2, 50_000), (3, 8_000), (4, 9_000)] {
            // Let go and taken again soon, by chance.
            let is_set = pins.bits >> flag & 1 == 1;
            let changes = if is_set == (flag < 3) { seldom } else { 600 };
            if random.one_in(changes) {
                pins.bits ^= 1 << flag;
            }
        }
        if random.one_in(10_000) {
            self.is_frozen = !self.is_frozen;
        }
        if random.one_in(if self.is_broken { 2_000 } else { 60_000 }) {
            self.is_broken = !self.is_broken;
        }
        self.level_v = (self.level_v + 0.0005 * random.around()).clamp(0.5, 9.0);
        if !self.is_frozen {
            pins.sensor_v = self.level_v + 0.002 * random.around();
        }
        if self.is_broken {
            pins.sensor_v = if random.one_in(2) { f64::NAN } else { 11.0 };
        }
        for channel in [0, 3] {
            let celsius = &mut pins.temperature_c[channel];
            if random.one_in(200_000) {
                *celsius = f64::NAN;
            } else if celsius.is_nan() && random.one_in(20_000) {
                *celsius = 22.0;
            }
            *celsius += 2e-5 * random.around();
        }
    }

    /// A drive that has taken what it was asked for.
    fn take(&mut self, outputs: &COutputs) {
        self.pins.joint_now[..3].copy_from_slice(&outputs.joint_offset[..3]);
    }
}

/// The host's node and component, at the two ends of a line.
struct Host<'a> {
    node: Node<'a>,
    component: Component,
    codes: [AdcCode; CODES_PER_TICK],
    volts: f64,
    position_mm: Option<[f64; 3]>,
    temperatures: [RawTemperatureReading; TEMPERATURE_CHANNEL_COUNT],
    ms: u64,
}

impl<'a> Host<'a> {
    fn new(blob: &'a [u8]) -> Self {
        let law = decode(blob).expect("compiled");
        let pace = RateLimits {
            slew_nm_per_s: law.limits.slew_nm_per_s.into(),
            cycle_s: 1e-3,
            acceleration_nm_per_s2: f64::INFINITY,
            planner_keeps_slew: false,
        };
        let mut joints = [None; MAX_JOINTS];
        for (number, joint) in joints.iter_mut().enumerate().take(3) {
            let limits_nm = [-500e6, 1_000e6];
            *joint = Some(JointSettings {
                number,
                axis: number,
                limits_nm,
                mm_per_s: 1.0,
                mm_per_s2: 1.0,
            });
        }
        let limits = OffsetLimits {
            max_nm: law.limits.max.map(|max| max.0),
            stale: Duration::from_millis(100),
            hold: Duration::from_millis(law.limits.hold_ms.into()),
        };
        let options = ComponentOptions {
            limits,
            pace: [pace; 3],
            position_period: Duration::from_millis(1),
            sends_rotary: true,
            against_um: [Some(0.0), Some(6.0), None],
            joints,
        };
        let node = Node::new(NodeConfiguration { blob, ..law.into() });
        Self {
            node,
            component: Component::new(Duration::ZERO, options),
            codes: [AdcCode(0); CODES_PER_TICK],
            volts: f64::NAN,
            position_mm: None,
            temperatures: [RawTemperatureReading::NONE; TEMPERATURE_CHANNEL_COUNT],
            ms: 0,
        }
    }

    fn step(&mut self, pins: &CInputs) -> ComponentOutputs {
        let nm = |mm: f64| mm * 1e6;
        let bit = |number: u32| pins.bits >> number & 1 == 1;
        let mut joints = [JointReading::default(); MAX_JOINTS];
        for (n, joint) in joints.iter_mut().enumerate() {
            *joint = JointReading {
                now_nm: nm(pins.joint_now[n]),
                command_nm: nm(pins.joint_command[n]),
                reference_nm: nm(pins.joint_reference[n]),
                homing: false,
            };
        }
        let inputs = ComponentInputs {
            enable: bit(0),
            machine_on: bit(1),
            homed: bit(2),
            zero: bit(3),
            service: false,
            confirm: bit(4),
            // Of the period before.
            position_mm: self.position_mm.replace(pins.position).unwrap_or(pins.position),
            readings: [AxisReading::default(); 3],
            joints,
            angles_deg: pins.angles_deg,
            spindle_rpm: pins.spindle_rpm,
            load_n: pins.load_n,
            conditions: u16::try_from(pins.tool)
                .ok()
                .map(|tool| MachineConditions { tool, bits: 0 }),
        };
        let (outputs, frames) = self.component.step(Duration::from_millis(self.ms), &inputs);
        for frame in &frames {
            self.node.receive(Interface::Serial, &over_the_line(frame)).ok();
        }
        self.ms += 1;
        let codes = self.sample(pins.sensor_v);
        let channel = (self.ms % TEMPERATURE_CHANNEL_COUNT as u64) as usize;
        self.temperatures[channel] = delivery(channel, pins.temperature_c[channel]);
        let input = TickInput {
            codes: codes.then_some(&self.codes),
            speed: None,
            temperatures: Some(&self.temperatures),
        };
        let now = Duration::from_millis(self.ms);
        let ticked = self.node.tick(1, input);
        for frame in ticked.into_iter().chain(self.node.next_service_frame()) {
            self.component.receive(now, &slcan::AdapterMessage::Frame(over_the_line(&frame)));
        }
        outputs
    }

    /// 20 codes whose sum is that of the sample, the smaller ones first; of a sample that has come again the nearest.
    fn sample(&mut self, volts: f64) -> bool {
        let before = std::mem::replace(&mut self.volts, volts);
        if !volts.is_finite() {
            self.volts = f64::NAN;
            return false;
        }
        let exact = (volts * CODES_PER_V).clamp(0.0, 4095.0);
        if volts == before || (volts - before).abs() < RESOLUTION_V / 2.0 {
            self.codes = [AdcCode((exact + 0.5).floor() as u16); CODES_PER_TICK];
            return true;
        }
        let above = ((exact - exact.floor()) * 20.0 + 0.5).floor() as usize;
        for (place, code) in self.codes.iter_mut().enumerate() {
            *code = AdcCode(exact.floor() as u16 + u16::from(place >= CODES_PER_TICK - above));
        }
        true
    }
}

/// IEC 60751, and the linear chain of the machine file: 0.1 V a kelvin behind a divider of 0.328, in 1/256 codes.
fn delivery(channel: usize, t: f64) -> RawTemperatureReading {
    if !t.is_finite() {
        return RawTemperatureReading::NONE;
    }
    let exact = match channel {
        0 => 1e8 * (1.0 + 3.9083e-3 * t + -5.775e-7 * t * t + 0.0),
        3 => 256.0 * t * 0.1 * CODES_PER_V,
        _ => return RawTemperatureReading::NONE,
    };
    RawTemperatureReading(exact.round() as i32)
}

/// A frame as the text of the serial line has it.
fn over_the_line(frame: &Frame) -> Frame {
    let line = slcan::encode_line(frame);
    slcan::decode_line(line.trim_end_matches('\r').as_bytes()).expect("what was encoded")
}

/// Memory as C has it.
#[repr(C, align(16))]
struct Memory([u8; BRIDGE_MEMORY_BYTES]);

fn settings() -> CSettings {
    let mut settings = CSettings {
        mm_per_unit: 1.0,
        codes_per_v: CODES_PER_V,
        resolution_v: RESOLUTION_V,
        against_um: [0.0, 6.0, f64::NAN],
        acceleration: [0.0; 3],
        joint_min: [-500.0; MAX_JOINTS],
        joint_max: [1_000.0; MAX_JOINTS],
        joint_axis: [-1; MAX_JOINTS],
        temperature_timeout_ms: 0,
        planner_keeps_slew: 0,
        sends_rotary: 1,
    };
    settings.joint_axis[..3].copy_from_slice(&[0, 1, 2]);
    settings
}

fn blob() -> Vec<u8> {
    let machine = MachineFile::parse(MACHINE, Path::new("m.toml")).expect("a machine file");
    compile(&machine).expect("a calibration").blob().to_vec()
}

fn outputs() -> COutputs {
    COutputs {
        offset_um: [0.0; 3],
        applied_um: [0.0; 3],
        joint_offset: [0.0; MAX_JOINTS],
        joint_min: [0.0; MAX_JOINTS],
        joint_max: [0.0; MAX_JOINTS],
        temperature_c: [0.0; TEMPERATURE_CHANNEL_COUNT],
        elongation_um: 0.0,
        counts: [0; 3],
        quality: 0,
        flags: 0,
        state: 0,
        age_ms: 0,
        calibration: 0,
        bits: 0,
    }
}

/// Runs both side by side, and compares every offset, goal of a joint and quality.
fn compare(ticks: u64) {
    // The bridge lives as long as the process.
    let blob: &'static [u8] = blob().leak();
    let mut memory = Box::new(Memory([0; BRIDGE_MEMORY_BYTES]));
    let start = |memory: &mut Memory| {
        let place = memory.0.as_mut_ptr();
        // SAFETY: the memory is aligned and as large as it has to be, and the calibration stays.
        unsafe {
            trueup_servo_start(
                place,
                BRIDGE_MEMORY_BYTES,
                blob.as_ptr(),
                blob.len(),
                &settings(),
                1_000_000,
            )
        }
    };
    assert_eq!(start(&mut memory), 0);
    let (mut world, mut host, mut outputs) = (World::new(), Host::new(blob), outputs());
    let (mut seen, mut largest) = ([0_u64; 7], [0.0_f64; 3]);
    for tick in 0..ticks {
        world.step();
        let expected = host.step(&world.pins);
        // SAFETY: the bridge was started in this memory.
        let number = unsafe {
            trueup_servo_step(memory.0.as_mut_ptr(), &world.pins, &mut outputs, 1_000_000)
        };
        assert_eq!(number, 0);
        let bits = |um: [f64; 3]| um.map(f64::to_bits);
        assert_eq!(bits(outputs.offset_um), bits(expected.offset_um), "tick {tick}");
        assert_eq!(outputs.quality, expected.quality as i32, "tick {tick}");
        assert_eq!(outputs.flags, u32::from(expected.flags.0), "tick {tick}");
        for (n, joint) in expected.joints.iter().enumerate() {
            let ours = [outputs.joint_offset[n], outputs.joint_min[n], outputs.joint_max[n]];
            let theirs = [joint.offset_nm, joint.min_nm, joint.max_nm].map(|nm| nm / 1e6);
            assert_eq!(ours.map(f64::to_bits), theirs.map(f64::to_bits), "tick {tick}, joint {n}");
        }
        seen[outputs.quality as usize] += 1;
        for (largest, um) in largest.iter_mut().zip(outputs.offset_um) {
            *largest = largest.max(um.abs());
        }
        world.take(&outputs);
    }
    println!(
        "{ticks} ticks, the same to the bit; of each quality {seen:?}; largest offset {largest:.2?} um"
    );
    // What is compared has to have happened.
    assert!(
        seen[1] > ticks / 10 && [0, 4, 5, 6].iter().all(|quality| seen[*quality] > 0),
        "{seen:?}"
    );
    assert!(largest.iter().all(|um| *um > 5.0), "{largest:?}");
}

#[test]
fn a_minute_and_a_half_of_offsets_are_those_of_the_hosts_node_to_the_bit() {
    compare(100_000);
}

#[test]
#[ignore = "long: 10^7 ticks"]
fn ten_million_offsets_are_those_of_the_hosts_node_to_the_bit() {
    compare(10_000_000);
}

#[test]
fn what_is_no_calibration_and_other_servo_periods_are_refused_with_the_reason() {
    let blob: &'static [u8] = blob().leak();
    let mut memory = Box::new(Memory([0; BRIDGE_MEMORY_BYTES]));
    let mut start = |blob: &'static [u8], size: usize, period_ns: u64| {
        let place = memory.0.as_mut_ptr();
        // SAFETY: the memory is aligned, and no size that is given is above it.
        let number = unsafe {
            trueup_servo_start(place, size, blob.as_ptr(), blob.len(), &settings(), period_ns)
        };
        // SAFETY: a text of the library.
        unsafe { std::ffi::CStr::from_ptr(trueup_servo_reason(number)) }.to_str().expect("ASCII")
    };
    for period in [500_000, 1_000_000, 999_900, 2_000_000, 4_000_000] {
        assert_eq!(start(blob, BRIDGE_MEMORY_BYTES, period), "nothing is wrong");
    }
    for period in [0, 250_000, 750_000, 1_002_000, 3_000_000, 8_000_000, u64::MAX] {
        assert!(start(blob, BRIDGE_MEMORY_BYTES, period).contains("SERVO_PERIOD"), "{period}");
    }
    let changed = |at: usize, to: u8| -> &'static [u8] {
        let mut bytes = blob.to_vec();
        bytes[at] = to;
        bytes.leak()
    };
    for (bytes, reason) in [
        (&blob[..0], "not whole"),
        (&blob[..blob.len() - 1], "not whole"),
        (changed(0, 0), "no calibration"),
        (changed(4, 99), "another version"),
        (changed(40, blob[40] ^ 1), "CRC"),
    ] {
        assert!(start(bytes, BRIDGE_MEMORY_BYTES, 1_000_000).contains(reason), "{reason}");
    }
    assert!(start(blob, 1_000, 1_000_000).contains("do not fit"));
    assert_eq!(BRIDGE_MEMORY_BYTES % BRIDGE_MEMORY_ALIGNMENT, 0);
}
