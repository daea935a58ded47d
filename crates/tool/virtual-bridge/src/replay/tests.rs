//! Runs played, and what their rows become.

use super::*;
use std::path::Path;
use trueup_machine::MachineFile;

const LIMITS: &str = "[limits]\nmax_um = { x = 200.0, y = 200.0, z = 500.0 }\n\
    slew_um_per_s = 20.0\nlink_timeout_ms = 500\nhold_ms = 2000\n";

fn machine(text: &str) -> Machine {
    MachineFile::parse(&format!("{text}{LIMITS}"), Path::new("m.toml")).expect("a good machine")
}

fn with_sensor() -> Machine {
    machine(
        "[machine]\nname = \"m\"\nkind = \"3-axis\"\n\
         [inputs]\nsensor = { volts_full_scale = 10, counts_full_scale = 32768, divider = 0.33 }\n\
         [spindle]\nsource = \"sensor\"\n\
         [spindle.sensor]\nk0_um = 0.0\nzero_counts = 5048.0\num_per_count = 0.015\n",
    )
}

fn replay_on(machine: &Machine, text: &str) -> Result<RunReplay, InputFileError> {
    let run = RunFile::from_reader(text.as_bytes(), Path::new("run.csv"))?;
    RunReplay::new(&run, machine, DEFAULT_ROW_DURATION_S)
}

fn replay(text: &str) -> Result<RunReplay, InputFileError> {
    replay_on(&with_sensor(), text)
}

#[test]
fn a_row_holds_until_the_next_and_the_last_for_ever() {
    let replay = replay("time_s,sensor_counts,spindle_rpm\n5,0,\n6,16384,300\n8,,-24000\n")
        .expect("a good run");
    let volts = |time| replay.snapshot_at(time).sensor_volts;
    assert_eq!([volts(0.0), volts(0.999), volts(1.0), volts(1e9)], [0.0, 0.0, 5.0, 5.0]);
    assert_eq!(replay.snapshot_at(0.5).speed, None);
    assert_eq!(replay.snapshot_at(2.9).speed, Some(Rpm(300)));
    assert_eq!(replay.snapshot_at(3.0).speed, Some(Rpm(24_000)));
    assert_eq!(replay.growth_um(1.0), None, "the run does not say");
}

#[test]
fn a_gauge_shows_the_newest_value_of_the_run() {
    let text = "time_s,sensor_counts,measured_elongation_um\n0,0,\n1,0,2.5\n2,0,\n3,0,4\n";
    let replay = replay(text).expect("a good run");
    let shown = [-1.0, 0.5, 1.0, 2.5, 9.0].map(|time| replay.growth_um(time));
    assert_eq!(shown, [0.0, 0.0, 2.5, 2.5, 4.0].map(Some));
}

#[test]
fn what_the_sensor_cannot_give_is_refused_with_its_place() {
    let error = replay("spindle_rpm,sensor_counts\n0,5048\n0,40000\n").expect_err("beyond 10 V");
    assert_eq!(error.to_string(), "run.csv:3:3: sensor_counts 40000 is outside 0…32768");
    let error = replay("sensor_counts,spindle_rpm\n1,70000\n").expect_err("beyond 16 bits");
    assert!(error.to_string().starts_with("run.csv:2:3: spindle_rpm 70000"), "{error}");
    let error = replay("spindle_rpm\n1\n").expect_err("no sensor");
    assert!(error.to_string().contains("sensor_counts"), "{error}");
}

fn without_sensor() -> Machine {
    machine(
        "[machine]\nname = \"m\"\nkind = \"head-head\"\nhead_axes = [\"c\", \"a\"]\n\
         [inputs]\n\
         temp_screw_c = { channel = 2, kind = \"pt100\" }\n\
         temp_bed_c = { channel = 5, kind = \"linear\", zero_counts = 4000.0, \
         counts_per_c = 16.0 }\n",
    )
}

#[test]
fn temperatures_come_as_their_channels_deliver_them() {
    let text = "temp_screw_c,temp_bed_c,temp_else_c\n25,23.5,1\n,24.5,1\n";
    let replay = replay_on(&without_sensor(), text).expect("it needs no sensor");
    let delivered = |time| replay.snapshot_at(time).temperatures;
    // IEC 60751: 109.734656 ohms at 25 °C; 4000 + 16·23.5 counts in 1/256.
    assert!((delivered(0.0)[2].0 - 109_734_656).abs() <= 1);
    assert_eq!(delivered(0.0)[5], RawTemperatureReading(4376 * 256));
    assert_eq!(delivered(1.0)[5], RawTemperatureReading(4392 * 256));
    assert_eq!(
        delivered(0.25)[5],
        RawTemperatureReading(4380 * 256),
        "between two rows by a straight line"
    );
    assert_eq!(delivered(9.0)[5], RawTemperatureReading(4392 * 256), "the last row is held");
    assert_eq!(delivered(1.0)[2], delivered(0.0)[2], "a missing value keeps the one before");
    assert_eq!(delivered(0.0)[0], RawTemperatureReading::NONE);
    assert_eq!(replay.snapshot_at(0.0).sensor_volts, 0.0);
    let uses = |name| RunReplay::uses_column(&without_sensor(), name);
    assert!(uses("temp_screw_c") && uses("a_deg") && uses("dir_x"));
    assert!(!uses("temp_else_c") && !uses("b_deg") && !uses("sensor_counts"));
}

#[test]
fn an_axis_heads_where_the_run_says_or_else_where_it_moves() {
    let text = "x_mm,y_mm,dir_y,a_deg,c_deg\n1,1,-1,,90\n3,1,-1,-33.3335,90\n2,1,1,,\n2,,1,,\n";
    let replay = replay_on(&without_sensor(), text).expect("a good run");
    let at = |row: f64, axis: usize| {
        let there = replay.snapshot_at(row).positions[axis].expect("a position");
        (there.position.0, there.direction as i8)
    };
    let x: Vec<_> = (0..4).map(|row| at(f64::from(row), 0)).collect();
    assert_eq!(x, [(100_000, 0), (300_000, 1), (200_000, -1), (200_000, 0)]);
    let y: Vec<_> = (0..4).map(|row| at(f64::from(row), 1)).collect();
    assert_eq!(y, [(100_000, -1), (100_000, -1), (100_000, 1), (100_000, 1)]);
    assert_eq!(replay.snapshot_at(0.0).positions[2], None);
    assert_eq!(replay.snapshot_at(0.0).rotary, None, "one angle is not yet known");
    // In the order of the head's axes: C, then A.
    let angles = [90_000_000, -33_333_500].map(MicroDegrees);
    assert_eq!(replay.snapshot_at(2.0).rotary, Some(RotaryAxisAngles { angles }));
}
