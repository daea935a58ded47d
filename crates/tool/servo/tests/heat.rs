//! The heat of the machine outlasts a restart of LinuxCNC, and cools meanwhile; what is damaged or of an unknown time is
//! not believed, as on the board.

use std::path::Path;

use trueup_link::status::StateBits;
use trueup_machine::{MachineFile, compile};
use trueup_servo::{
    ComponentOutputs, ServoBridge, ServoInputs, ServoSettings, sensor::SensorScale,
};
use trueup_store::retained_state::{RETAINED_COPY_SIZE, RetainedCopies};

/// A spindle that grows by 80 µm in some minutes, and a thermometer.
const MACHINE: &str = r#"
[machine]
name = "warm"
kind = "3-axis"
[inputs]
temp_head_c = { channel = 0, kind = "pt100" }
temp_bed_c = { channel = 1, kind = "pt100" }
[spindle]
source = "warmup"
[spindle.warmup]
lag_s = 10.0
warm_s = 300.0
max_um = 80.0
exponent = 4.0
cool_s = 100.0
[thermal_state]
cold_within_c = 0.5
"#;
const PERIOD_NS: u64 = 1_000_000;
const NOW_S: u32 = 1_700_000_000;

fn servo(blob: &'static [u8]) -> ServoBridge {
    let settings = ServoSettings {
        mm_per_unit: 1.0,
        sensor: SensorScale { codes_per_v: 407.0, resolution_v: 0.0003 },
        sends_rotary: false,
        against_um: [0.0; 3],
        acceleration: [0.0; 3],
        planner_keeps_slew: [false; 3],
        joints: [None; 9],
        temperature_timeout_ms: 0,
    };
    ServoBridge::new(blob, &settings, PERIOD_NS).expect("starts")
}

/// Runs for a number of seconds, and returns the last outputs.
fn live(
    servo: &mut ServoBridge,
    copies: &mut RetainedCopies,
    rpm: f64,
    seconds: u32,
) -> ComponentOutputs {
    let mut inputs = ServoInputs {
        enable: true,
        machine_on: true,
        homed: true,
        spindle_rpm: rpm,
        tool: -1,
        sensor_v: f64::NAN,
        temperature_c: [f64::NAN; 8],
        ..ServoInputs::default()
    };
    // A warm head: the machine does not look cold.
    (inputs.temperature_c[0], inputs.temperature_c[1]) = (31.0, 22.0);
    let mut last = ComponentOutputs::default();
    for _ in 0..seconds * 1_000 {
        for (axis, counts) in last.counts.into_iter().enumerate() {
            // LinuxCNC takes every step at once.
            inputs.request[axis] += f64::from(counts) * 1e-6;
            inputs.eoffset[axis] = inputs.request[axis];
        }
        last = servo.step(&inputs, PERIOD_NS).expect("a servo period");
        servo.save_retained_state(copies);
    }
    last
}

fn blob() -> &'static [u8] {
    let machine = MachineFile::parse(MACHINE, Path::new("m.toml")).expect("a machine file");
    compile(&machine).expect("a calibration").blob().to_vec().leak()
}

/// Returns the copies of a spindle that has run for some minutes, and its growth.
fn warm(blob: &'static [u8]) -> (RetainedCopies, f64) {
    let mut copies = [[0; RETAINED_COPY_SIZE]; 2];
    let mut servo = servo(blob);
    // Never run before: nothing is known, and the operator says that it is cold.
    servo.resume(&copies, Some(NOW_S));
    let mut nothing = [[0; RETAINED_COPY_SIZE]; 2];
    let outputs = live(&mut servo, &mut nothing, 0.0, 3);
    assert!(outputs.state.0 & StateBits::HEAT_UNKNOWN.0 != 0, "{outputs:?}");
    let mut cold = self::servo(blob);
    let outputs = live(&mut cold, &mut copies, 18_000.0, 240);
    (copies, outputs.offset_um[2])
}

#[test]
fn copies_that_were_written_without_a_clock_are_not_believed() {
    let blob = blob();
    let (copies, grown_um) = warm(blob);
    assert!(grown_um.abs() > 30.0, "{grown_um} um");
    let after = |off_s: u32| {
        let (mut servo, mut copies) = (servo(blob), copies);
        // 240 s after the start of a clock that was not known: the cold one had none.
        servo.resume(&copies, Some(NOW_S + off_s));
        live(&mut servo, &mut copies, 18_000.0, 12)
    };
    // Written without a clock: the time of cooling is not known.
    let unknown = after(1);
    assert!(unknown.state.0 & StateBits::HEAT_UNKNOWN.0 != 0, "{unknown:?}");
}

#[test]
fn with_a_clock_it_goes_on_and_damaged_copies_are_not_believed() {
    let blob = blob();
    let mut first = servo(blob);
    let (_, cold_um) = warm(blob);
    // A machine that has a clock and is known to be cold: resumed from copies of a cold one, an hour old.
    let mut copies = [[0; RETAINED_COPY_SIZE]; 2];
    let cold = servo(blob).node().retained_state();
    trueup_store::retained_state::save_state(&mut copies, &cold, Some(NOW_S - 3_600));
    first.resume(&copies, Some(NOW_S));
    let warm_um = live(&mut first, &mut copies, 18_000.0, 240).offset_um[2];
    assert!((warm_um - cold_um).abs() < 0.5, "{warm_um} and {cold_um} um");
    let resumed = |copies: &RetainedCopies, now_s: Option<u32>| {
        let (mut servo, mut copies) = (servo(blob), *copies);
        servo.resume(&copies, now_s);
        let outputs = live(&mut servo, &mut copies, 0.0, 12);
        (outputs.offset_um[2], outputs.state.0 & StateBits::HEAT_UNKNOWN.0 != 0)
    };
    let saved_s = NOW_S + 240;
    let (at_once, is_unknown) = resumed(&copies, Some(saved_s));
    assert!(!is_unknown && at_once.abs() > 0.7 * warm_um.abs(), "{at_once} of {warm_um} um");
    let (later, is_unknown) = resumed(&copies, Some(saved_s + 100));
    assert!(!is_unknown && later.abs() < 0.6 * at_once.abs(), "{later} um after 100 s more");
    assert!(later.abs() > 0.2 * at_once.abs(), "{later} um after 100 s more");
    // The clock was set back, or there is none.
    assert!(resumed(&copies, Some(NOW_S - 4_000)).1 && resumed(&copies, None).1);
    // One damaged copy leaves the other, two leave nothing.
    let mut damaged = copies;
    damaged[0][100] ^= 1;
    assert!(!resumed(&damaged, Some(saved_s)).1);
    damaged[1][100] ^= 1;
    assert!(resumed(&damaged, Some(saved_s)).1);
}
