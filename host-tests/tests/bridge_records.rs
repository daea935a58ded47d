//! Records of a bridge in the closed loop with the virtual machine tool: the CNC adds what the board
//! says, an instrument reads what is left, and `diagnose` and `fit` find the machine's own constants
//! from such a record, whether the bridge was off, on, or switched on and off in the middle of it.
//!
//! The board's application runs in this process, on its calibration and through its frames. None of
//! its laws here has a memory, so a row that stands for half a minute of the machine is held only until
//! filter and slew have come to rest.
#![allow(clippy::print_stdout, reason = "a test prints its figures")]

use std::{borrow::Cow, fmt::Write as _, path::Path};

use trueup_core::{
    bridge::TickInput,
    cnc::{AxisPosition, Control, LinearAxis, Output, TravelDirection},
    design_parameters::TEMPERATURE_CHANNEL_COUNT,
    temperature_channels::RawTemperatures,
    thermometer::RawTemperatureReading,
    units::Position,
};
use trueup_diagnose::{DiagnosisOptions, DiagnosisReport, diagnose, diagnose_with_options};
use trueup_emulator::{analogue_front_end::AnalogueFrontEnd, replay};
use trueup_fit::{elongation, pitch, thermal};
use trueup_link::{frames, receiver::OffsetReceiver};
use trueup_machine::{
    Machine, MachineFile, RunFile,
    applied_offsets::UncompensatedRun,
    compile,
    inputs::{CountScale, LinearInput, TemperatureInputKind},
    machine_file::Quantity,
};
use trueup_node::node::{Interface, Node};
use trueup_twin::{
    Scenario,
    machine::{DriveCommand, SimulatedMachine as Truth},
};

/// Of the machine file: the counts at 10 V go to 0.33 of the ADC's range.
const DIVIDER: f64 = 0.33;
/// How long the board sees a row, in ms.
const HELD_MS: u32 = 800;
/// From one row to the next in the life of the machine, in s.
const ROW_S: f64 = 30.0;
const ROWS: usize = 240;
/// 2 V at 0 °C and 10 K/V, through the divider of the wiring.
const LINEAR: TemperatureInputKind = TemperatureInputKind::Linear(LinearInput {
    zero_counts: 2.0,
    counts_per_c: 0.1,
    scale: CountScale::Volt { full_scale_v: 10.0, divider: 0.328 },
});

/// When the CNC engages the bridge.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Engaged {
    Never,
    Always,
    InTheMiddle,
}

impl Engaged {
    fn at(self, row: usize) -> bool {
        match self {
            Self::Never => false,
            Self::Always => true,
            Self::InTheMiddle => (ROWS / 3..2 * ROWS / 3).contains(&row),
        }
    }
}

/// A spindle whose tip is where its sensor is, but the sensor shows 0.8 of it: the true gain is 1.25.
const SPINDLE: &str = "name = \"spindle\"\nmeasure = [\"elongation\"]\n\
    [spindle]\nholder_length_m = 0.0\nhousing_length_m = 0.0\nstiffness_n_per_um = 0.0\n\
    [sensor]\ngain = 0.8\nnoise_um = 0.03\n\
    [thermometer.front]\nat = \"front\"\nnoise_c = 0.02\n\
    [[segment]]\nkind = \"spindle\"\nduration_s = 60.0\n";
const SPINDLE_BELIEVED: &str = "[machine]\nname = \"m\"\nkind = \"3-axis\"\n\
    [inputs]\nsensor = { volts_full_scale = 10.0, counts_full_scale = 32768, divider = 0.33 }\n\
    [spindle]\nsource = \"sensor\"\n\
    [spindle.sensor]\nk0_um = 0.0\nzero_counts = 5048.0\num_per_count = 0.0152587890625\n\
    [limits]\nmax_um = { x = 4000, y = 4000, z = 4000 }\nslew_um_per_s = 10000\n";

/// An axis whose screw expands by 1.25 times what is believed.
const AXIS: &str = "name = \"axis\"\nmeasure = [\"dx\"]\nstart_mm = [100.0, 0.0, 0.0]\n\
    [thermometer.screw]\nat = \"screw_x\"\nnoise_c = 0.01\n\
    [axis.x]\nscrew_um_per_m_per_c = 12.5\nscrew_heating_c = 0.6\n\
    [[segment]]\nkind = \"positions\"\naxis = \"x\"\nrange_mm = [0.0, 900.0]\ntargets = 3\ncycles = 1\nfeed_mm_per_min = 6000.0\n";
const AXIS_BELIEVED: &str = "[machine]\nname = \"m\"\nkind = \"3-axis\"\n\
    [inputs]\ntemp_screw_c = { channel = 0, kind = \"linear\", zero_v = 2.0, c_per_v = 10.0 }\n\
    [axis.x.thermal]\nmode = \"position\"\nsensor = \"temp_screw_c\"\nreference_c = 20.0\n\
    slope_um_per_m_per_c = 10.0\norigin_mm = 0.0\n\
    [limits]\nmax_um = { x = 4000, y = 4000, z = 4000 }\nslew_um_per_s = 10000\n";

fn machine(text: &str) -> Machine {
    MachineFile::parse(text, Path::new("m.toml")).expect("right")
}

/// The board's application, with the CNC that it talks to.
struct Loop<'a> {
    node: Node<'a>,
    front_end: AnalogueFrontEnd,
    offsets: OffsetReceiver,
    last: Output,
    heading: TravelDirection,
    ms: u32,
    counter: u8,
}

impl<'a> Loop<'a> {
    fn new(node: Node<'a>) -> Self {
        Self {
            node,
            front_end: AnalogueFrontEnd::new(DIVIDER, 1),
            offsets: OffsetReceiver::new(),
            last: Output::default(),
            heading: TravelDirection::Positive,
            ms: 0,
            counter: 0,
        }
    }

    /// Holds this on the board's inputs; what it says in the end.
    fn hold(&mut self, volts: f64, screw_c: f64, x_mm: f64, engage: bool) -> Output {
        let mut temperatures: RawTemperatures =
            [RawTemperatureReading::NONE; TEMPERATURE_CHANNEL_COUNT];
        temperatures[0] = replay::raw_reading_from_celsius(LINEAR, screw_c);
        for _ in 0..HELD_MS {
            if self.ms.is_multiple_of(20) {
                // Engaged once, because before that nothing is available, off neither.
                let engage = (engage || self.ms < 200) && self.ms >= 60;
                let control = Control { engage, ..Control::REFERENCED };
                let at = AxisPosition {
                    axis: LinearAxis::X,
                    position: Position((x_mm * f64::from(Position::PER_MILLIMETRE)).round() as i32),
                    direction: self.heading,
                };
                for frame in [
                    frames::encode_control(control, self.counter),
                    frames::encode_position(at, self.counter),
                ] {
                    self.node.receive(Interface::Can, &frame).expect("in order");
                }
                self.counter = self.counter.wrapping_add(1);
            }
            self.ms += 1;
            let codes = self.front_end.convert_block(|_| volts);
            let input =
                TickInput { codes: Some(&codes), speed: None, temperatures: Some(&temperatures) };
            for frame in self.node.tick(1, input) {
                self.last = self.offsets.accept(&frame).expect("whole").unwrap_or(self.last);
            }
        }
        self.last
    }
}

/// Returns the record of a machine that the bridge corrects with what is believed: what the monitor writes, and
/// next to it what an instrument reads, 0.1 µm good.
fn record(truth: &str, believed: &str, engaged: Engaged, is_axis: bool) -> RunFile {
    record_of(truth, believed, engaged, is_axis, 1.0)
}

/// Returns the same of a CNC that moves the tool by `factor` times what the bridge says.
fn record_of(truth: &str, believed: &str, engaged: Engaged, is_axis: bool, factor: f64) -> RunFile {
    let compiled = compile(&machine(believed)).expect("it fits the board");
    let mut board = Loop::new(Node::new(compiled.calibration().into()));
    let scenario = Scenario::parse(truth, Path::new("s.toml")).expect("right");
    let mut truth = Truth::new(&scenario, 3);
    let name = if is_axis { "measured_dx_um" } else { "measured_elongation_um" };
    let sensor = if is_axis { "temp_screw_c" } else { "sensor_counts" };
    let mut text = format!(
        "time_s,x_mm,dir_x,offset_x_um,offset_y_um,offset_z_um,quality,calibration_crc,{sensor},{name}\n"
    );
    for row in 0..ROWS {
        let cell = |column: usize| [-0.11, 0.07, 0.02, 0.13, -0.05, -0.09, 0.04][column % 7];
        // Heated for two thirds of the time, by speed or by travel.
        let works = row % 90 < 60;
        let x_mm = [100.0, 500.0, 900.0, 300.0, 700.0][row % 5];
        for step in 0..30 {
            let on_way = if works && step % 2 == 0 { 900.0 - x_mm } else { x_mm };
            let x_mm = if step == 29 { x_mm } else { on_way };
            let spindle_rpm = if works { 18_000.0 } else { 0.0 };
            let position_mm = [x_mm, 0.0, 0.0];
            truth.step(
                ROW_S / 30.0,
                &DriveCommand { position_mm, spindle_rpm, ..DriveCommand::default() },
            );
        }
        let volts = truth.read_sensor_volts().unwrap_or(0.0);
        let screw_c = truth.read_temperatures_c()[0].1;
        let output = board.hold(volts, screw_c, x_mm, engaged.at(row));
        let offset_um = output.offset.map(|all| all.map(|nm| f64::from(nm.0) / 1000.0));
        // The CNC moves the tool by what the bridge says; without a word it stays where it is.
        let moved_um = offset_um.unwrap_or_default().map(|um| factor * um);
        let left_um = if is_axis {
            truth.tip_error_um()[0] + moved_um[0]
        } else {
            // The tool points down: a lift takes away what the instrument sees of the growth.
            truth.elongation_um() - moved_um[2]
        };
        let offset =
            |axis: usize| offset_um.map_or(String::new(), |all| format!("{:.3}", all[axis]));
        writeln!(
            text,
            "{},{x_mm},1,{},{},{},{},{},{:.4},{:.3}",
            ROW_S * row as f64,
            offset(0),
            offset(1),
            offset(2),
            output.quality as u8,
            compiled.crc(),
            if is_axis { screw_c } else { volts * 3276.8 },
            left_um + cell(row),
        )
        .expect("a string grows");
    }
    RunFile::from_reader(text.as_bytes(), Path::new("bridge.csv")).expect("a run file")
}

/// A value with its interval.
type Known = (f64, [f64; 2]);

/// Each record gives the constant within its interval, and all of them the same within theirs.
fn agree(what: &str, truth: f64, all: &[(Engaged, Known)]) {
    for (engaged, (value, ci95)) in all {
        println!("{what}, {engaged:?}: {value:.5} ({:.5}…{:.5})", ci95[0], ci95[1]);
        let half = (ci95[1] - ci95[0]) / 2.0;
        assert!(half < 0.02 * truth, "{what}, {engaged:?}: {half} is no interval");
        // What the board rounds, and the sensor's last digit, are in no interval.
        assert!((value - truth).abs() < half + 0.002 * truth, "{what}, {engaged:?}: {value}");
        for (_, (_, other)) in all {
            assert!(ci95[0] <= other[1] && other[0] <= ci95[1], "{what}: {ci95:?} and {other:?}");
        }
    }
}

fn found(believed: &str, run: &RunFile, cause: &str, parameter: &str) -> Known {
    let machine = machine(believed);
    // With the bridge engaged all the time a CNC has to be known.
    let options = DiagnosisOptions { is_applied_once: true, ..DiagnosisOptions::default() };
    let report =
        diagnose_with_options(&machine, std::slice::from_ref(run), &[], options, &mut |_, _| {})
            .expect("comparable")
            .report;
    let all: Vec<_> =
        report.findings.iter().map(|finding| (&finding.cause, &finding.column)).collect();
    println!("{:?} {all:?} {:?}", report.verdict, report.notes);
    let finding = report.findings.iter().find(|finding| finding.cause == cause);
    let finding = finding.unwrap_or_else(|| panic!("no {cause} in {all:?}"));
    assert!(finding.claimed, "{cause} is not claimed");
    assert!(
        all.iter()
            .all(|(_, column)| column.as_ref().is_none_or(|column| column.starts_with("temp_"))),
        "what the bridge says of itself explains nothing: {all:?}"
    );
    let it = &finding.parameters[parameter];
    let number = |value: &serde_json::Value| value.as_f64().expect("a number");
    (number(&it["value"]), [number(&it["ci95"][0]), number(&it["ci95"][1])])
}

const ALL: [Engaged; 3] = [Engaged::Never, Engaged::Always, Engaged::InTheMiddle];

#[test]
fn a_spindles_gain_is_the_same_with_the_bridge_off_on_and_switched() {
    let records = ALL.map(|engaged| (engaged, record(SPINDLE, SPINDLE_BELIEVED, engaged, false)));
    let gains = records
        .each_ref()
        .map(|(engaged, run)| (*engaged, found(SPINDLE_BELIEVED, run, "sensor-gain", "gain")));
    agree("gain", 1.25, &gains);
    let fitted = records.each_ref().map(|(engaged, run)| {
        let machine = machine(SPINDLE_BELIEVED);
        let (run, _) = UncompensatedRun::from_run(
            Cow::Borrowed(run),
            Some(&machine),
            Some(Quantity::Elongation),
        )
        .expect("a record");
        let report = elongation::fit_elongation(
            &[run],
            Some(&machine),
            &elongation::ElongationFitOptions::default(),
        )
        .expect("it can be fitted");
        let it = report.parameter("um_per_count").expect("fitted");
        (*engaged, (it.value, it.ci95.expect("fitted")))
    });
    agree("um_per_count", 1.25 * 500.0 / 32768.0, &fitted);
    // The bridge was engaged where the test says so.
    let qualities = records.each_ref().map(|(_, run)| run.column("quality").expect("written"));
    assert!(qualities[0].iter().all(|quality| *quality == 0.0));
    assert!(qualities[1].iter().skip(1).all(|quality| *quality == 1.0), "{:?}", qualities[1]);
    assert!([0.0, 1.0].iter().all(|value| qualities[2].contains(value)));
}

#[test]
fn an_axiss_expansion_is_the_same_with_the_bridge_off_on_and_switched() {
    let records = ALL.map(|engaged| (engaged, record(AXIS, AXIS_BELIEVED, engaged, true)));
    let slopes = records.each_ref().map(|(engaged, run)| {
        (*engaged, found(AXIS_BELIEVED, run, "expansion-slope", "um_per_m_per_c"))
    });
    agree("slope", 12.5, &slopes);
    let fitted = records.each_ref().map(|(engaged, run)| {
        let machine = machine(AXIS_BELIEVED);
        let (run, _) =
            UncompensatedRun::from_run(Cow::Borrowed(run), Some(&machine), Some(Quantity::Dx))
                .expect("a record");
        let axis = trueup_machine::machine_file::LinearAxis::X;
        let report =
            thermal::fit(&[run], axis, Some(&machine), &thermal::ThermalFitOptions::default())
                .expect("it can be fitted");
        let it = report.parameter("slope_um_per_m_per_c").expect("fitted");
        (*engaged, (it.value, it.ci95.expect("fitted")))
    });
    agree("fitted slope", 12.5, &fitted);
}

#[test]
fn a_screw_that_was_measured_before_is_corrected_between_its_points_from_where_it_stands() {
    // Feed-forward: measured five times there and back, stored as tables, laid in from the position and the direction.
    let error_um = |mm: f64, is_up: bool| {
        12.0 * (mm / 110.0).sin() + 0.01 * mm - if is_up { 0.0 } else { 5.0 }
    };
    let mut text = String::from("run,x_mm,dir_x,measured_dx_um\n");
    for run in 0..5 {
        let noise = |n: usize| [0.21, -0.13, 0.05, -0.17, 0.09, 0.16, -0.2][(n + 3 * run) % 7];
        for (n, at) in (0..=40).chain((0..=40).rev()).enumerate() {
            let (mm, is_up) = (f64::from(at) * 10.0, n <= 40);
            let um = error_um(mm, is_up) + noise(n);
            writeln!(text, "{run},{mm},{},{um:.3}", if is_up { 1 } else { -1 }).expect("a string");
        }
    }
    let run = RunFile::from_reader(text.as_bytes(), Path::new("laser.csv")).expect("a run file");
    let (run, _) = UncompensatedRun::from_run(Cow::Owned(run), None, None).expect("no bridge");
    let axis = trueup_machine::machine_file::LinearAxis::X;
    let fitted = pitch::fit(&run, axis, &pitch::PitchFitOptions::default());
    let edit = fitted.expect("the rules are kept").report.edit;
    let before = "[machine]\nname = \"m\"\nkind = \"3-axis\"\n\
                  [limits]\nmax_um = { x = 100, y = 100, z = 100 }\nslew_um_per_s = 10000\n";
    let written = edit.apply(before, Path::new("m.toml")).expect("a machine file");
    let compiled = compile(&machine(&written)).expect("it fits the board");
    let mut board = Loop::new(Node::new(compiled.calibration().into()));
    let (mut worst, mut largest) = (0.0_f64, 0.0_f64);
    for (mm, is_up) in [(33.3, true), (208.8, true), (391.0, true), (391.0, false), (107.7, false)]
    {
        board.heading = if is_up { TravelDirection::Positive } else { TravelDirection::Negative };
        let offset = board.hold(0.0, 20.0, mm, true).offset.expect("live");
        let um = f64::from(offset[0].0) / 1_000.0;
        // The zero of the laser is arbitrary, and so is that of the table: its first point going up.
        worst = worst.max((um + error_um(mm, is_up)).abs());
        largest = largest.max(um.abs());
    }
    println!("offsets up to {largest:.2} µm leave {worst:.3} µm");
    assert!(largest > 10.0 && worst < 0.35, "{largest} {worst}");
}

/// Returns the answer to `records`, and whether the machine file stays as it is.
fn answered(believed: &str, records: &[RunFile]) -> (DiagnosisReport, bool) {
    let machine = machine(believed);
    let answer =
        diagnose(&machine, records, &[], None, &mut |_, _| {}).expect("the runs are comparable");
    let stays = answer.render_extended_toml(believed, Path::new("m.toml")).expect("a machine file")
        == believed;
    let all: Vec<_> =
        answer.report.findings.iter().map(|finding| (&finding.cause, finding.claimed)).collect();
    println!("{:?} {all:?} stays {stays}", answer.report.verdict);
    (answer.report, stays)
}

/// Returns the machine file of each machine as it is: only the CNC is wrong.
fn machines() -> [(String, String, bool); 2] {
    let spindle = SPINDLE.replace("gain = 0.8", "gain = 1.0");
    let axis = AXIS_BELIEVED.replace("_per_c = 10.0", "_per_c = 12.5");
    [(spindle, SPINDLE_BELIEVED.into(), false), (AXIS.into(), axis, true)]
}

#[test]
fn a_cnc_that_applies_the_offset_otherwise_is_named_and_no_constant_is_changed() {
    for (truth, believed, is_axis) in machines() {
        let of = |engaged, factor| record_of(&truth, &believed, engaged, is_axis, factor);
        for factor in [-1.0, 0.0, 0.5, 2.0] {
            let records = match factor == 0.5 {
                true => vec![of(Engaged::Never, factor), of(Engaged::Always, factor)],
                false => vec![of(Engaged::InTheMiddle, factor)],
            };
            let (report, stays) = answered(&believed, &records);
            let first = &report.findings[0];
            assert!(first.cause == "applied-factor" && first.claimed && stays, "{factor}");
            assert!(!report.findings.iter().any(|finding| finding.compensated), "{factor}");
            let ci95 = [0, 1].map(|end| first.parameters["factor"]["ci95"][end].as_f64());
            let [low, high] = ci95.map(|end| end.expect("a number"));
            assert!(low < factor && factor < high && high - low < 0.2, "{factor}: {ci95:?}");
            for place in ["eoffset-scale", "SD43900", "FANUC", "HEIDENHAIN", "Modbus"] {
                assert!(first.next_test.contains(place), "{place}");
            }
        }
    }
}

#[test]
fn an_engaged_record_alone_does_not_separate_a_cnc_from_a_constant() {
    for (truth, believed, is_axis) in machines() {
        for factor in [-1.0, 0.5] {
            let record = record_of(&truth, &believed, Engaged::Always, is_axis, factor);
            let (report, stays) = answered(&believed, &[record]);
            assert!(stays && !report.verdict.is_resolved(), "{factor}: {:?}", report.verdict);
            let alternative = |finding: &trueup_diagnose::report::Finding| {
                finding.rivals.iter().any(|alternative| alternative.cause == "applied-factor")
            };
            let open: Vec<_> =
                report.findings.iter().filter(|finding| alternative(finding)).collect();
            assert!(!open.is_empty(), "{factor}");
            assert!(
                open.iter()
                    .all(|finding| !finding.claimed && finding.next_test.contains("disengaged"))
            );
        }
        // A machine and a CNC that are right stay so.
        let record = record_of(&truth, &believed, Engaged::Always, is_axis, 1.0);
        let (report, stays) = answered(&believed, &[record]);
        assert!(stays && report.verdict.is_resolved(), "{:?}", report.verdict);
    }
}
