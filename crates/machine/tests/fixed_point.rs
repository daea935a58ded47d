//! The board's integers against the reference model in `f64`, with everything switched on.
//!
//! | what | bound |
//! |---|---|
//! | the sum of all parts, on each axis | 10 nm |
//! | growth by the warm-up model, any speed | 1 nm of 80 µm |
//! | a lagging axis over a two-hour ramp, rows of 60 s | 5 nm on 5 m |
//! | the blob of a whole gantry | 16384 bytes, 24 a segment of a curve with its index |
//!
//! Machines come from a seeded generator as the text that a user would write. Signs are held to
//! what the hand finds from `docs/physics.md`, on three ways: the model, the compiled calibration, and
//! the offset that leaves the bridge.

use std::{fmt::Write, path::Path};

use trueup_core::{
    bridge::{Bridge, Input, State},
    calibration::{AXIS_PAIRS, Calibration},
    cnc::{AxisPosition, Command, Control, Heading, LinearAxis, Quality, Rotary},
    curve::SEGMENT_SIZE,
    dimensions::CHANNELS,
    dimensions::CODES_PER_TICK,
    heat::Heat,
    place::Place,
    thermometer::Raw,
    travel::Travel,
    units::{Code, Fine, MicroDegrees, Millis, Nanometres, Position, Reading, Rpm, Temperature},
};
use trueup_machine::{
    Compiled, Machine, MachineFile, RunFile, compile,
    file::Source,
    model::{Reference, Situation},
};
use trueup_numerics::line::{Summary, fit_line};

/// The bound on the sum of all parts.
const BOUND_NM: f64 = 10.0;
/// X, Y and Z of the paper's gantry.
const TRAVEL_MM: [f64; 3] = [14_300.0, 3_000.0, 2_500.0];
const COLUMNS: [&str; 4] = ["temp_x_c", "temp_y_c", "temp_z_c", "temp_front_c"];
const UNITS_PER_MM: f64 = Position::PER_MILLIMETRE as f64;
const UNITS_PER_C: f64 = Temperature::PER_KELVIN as f64;
const RATED_RPM: f64 = 24_000.0;

/// A linear congruential generator, its upper bits.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u32 {
        self.0 =
            self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 32) as u32
    }

    /// 0 to `below` − 1.
    fn below(&mut self, below: u32) -> u32 {
        ((u64::from(self.next()) * u64::from(below)) >> 32) as u32
    }

    fn uniform(&mut self, from: f64, to: f64) -> f64 {
        from + (to - from) * (f64::from(self.next()) + 0.5) / 4_294_967_296.0
    }

    fn either(&mut self, one: f64, other: f64) -> f64 {
        if self.below(2) == 0 { one } else { other }
    }
}

fn list(values: impl IntoIterator<Item = f64>) -> String {
    let values: Vec<String> = values.into_iter().map(|value| format!("{value:?}")).collect();
    format!("[{}]", values.join(", "))
}

/// 128 errors that wander.
fn pitch_table(random: &mut Random) -> String {
    let mut um = random.uniform(-20.0, 20.0);
    list((0..128).map(|_| {
        um += random.uniform(-6.0, 6.0);
        um
    }))
}

/// Start and step of 128 points over the travel, with room left at both ends.
fn pitch_places(random: &mut Random, travel_mm: f64) -> String {
    let start = random.uniform(0.0, 0.02) * travel_mm;
    let step = (travel_mm * random.uniform(0.93, 0.97) / 127.0 * 1e3).round() / 1e3;
    format!("start_mm = {:?}, step_mm = {step:?}", (start * 1e3).round() / 1e3)
}

/// Everything that the format knows, switched on.
fn whole_machine(seed: u64) -> String {
    let r = &mut Random(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15));
    let mut text = String::from(
        "[machine]\nname = \"gantry\"\nkind = \"head-head\"\nhead_axes = [\"c\", \"a\"]\n[inputs]\n\
         sensor = { volts_full_scale = 10.0, counts_full_scale = 32768, divider = 0.33 }\n",
    );
    for (channel, column) in COLUMNS.iter().enumerate() {
        let kind = if channel % 2 == 0 {
            "kind = \"pt100\""
        } else {
            "kind = \"linear\", zero_counts = 4000, counts_per_c = 16"
        };
        writeln!(text, "{column} = {{ channel = {channel}, {kind} }}").unwrap();
    }
    let source = ["sensor", "temperature", "warmup"][seed as usize % 3];
    writeln!(text, "[spindle]\nsource = \"{source}\"\n[spindle.sensor]").unwrap();
    let slope = 500.0 / 32_768.0 * r.uniform(0.8, 1.3) * r.either(1.0, -1.0);
    writeln!(text, "k0_um = {:?}", r.uniform(-30.0, 30.0)).unwrap();
    writeln!(text, "zero_counts = {:?}", r.uniform(3000.0, 8000.0)).unwrap();
    writeln!(text, "um_per_count = {slope:?}").unwrap();
    writeln!(text, "[spindle.temperature]\nsensor = \"{}\"\nreference_c = 21.3", COLUMNS[3])
        .unwrap();
    writeln!(text, "k_um_per_c = {:?}\nlag_s = 120.0", r.uniform(1.0, 9.0)).unwrap();
    writeln!(text, "[spindle.warmup]\nlag_s = 60.0\nwarm_s = 5400.0\nmax_um = 80.0").unwrap();
    writeln!(text, "exponent = {:?}\ncool_s = 1500.0", r.uniform(1.0, 5.0)).unwrap();
    let power = ["1", "1.4", "2.3"][r.below(3) as usize];
    writeln!(text, "rated_rpm = {RATED_RPM:?}\nspeed_exponent = {power}").unwrap();

    // The warm-up goes with time, and lags that are settled do not.
    let lag_s = if source == "warmup" { 0.0 } else { 1630.0 };
    for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
        let travel = TRAVEL_MM[axis];
        writeln!(text, "[axis.{name}.thermal]\nmode = \"both\"\nsensor = \"{}\"", COLUMNS[axis])
            .unwrap();
        writeln!(text, "origin_mm = {:?}\nlag_s = {lag_s:?}", r.uniform(-100.0, travel / 2.0))
            .unwrap();
        if (seed as usize / 3 + axis).is_multiple_of(2) {
            let rows: Vec<String> = [8.0, 17.0, 23.0, 31.0, 42.0, 47.0]
                .iter()
                .map(|&t| {
                    let c = t + r.uniform(-1.5, 1.5);
                    let um_per_m = (c - 22.0) * 11.0 + r.uniform(-20.0, 20.0);
                    list([c, r.uniform(-40.0, 40.0), um_per_m])
                })
                .collect();
            writeln!(text, "table = [{}]", rows.join(", ")).unwrap();
        } else {
            writeln!(text, "reference_c = {:?}", r.uniform(19.0, 25.0)).unwrap();
            writeln!(text, "constant_um_per_c = {:?}", r.uniform(-5.0, 5.0)).unwrap();
            writeln!(text, "slope_um_per_m_per_c = {:?}", r.uniform(8.0, 14.21)).unwrap();
        }
        let places = pitch_places(r, travel).replace(", ", "\n");
        writeln!(text, "[axis.{name}.pitch]\n{places}\nforward_um = {}", pitch_table(r)).unwrap();
        if axis == 1 {
            // Backlash belongs to an axis without a reverse table.
            writeln!(text, "[axis.y.backlash]\nwidth_um = {:?}", r.uniform(-9.0, 9.0)).unwrap();
            writeln!(text, "ramp_mm = 0.05\nhysteresis_um = 1.0").unwrap();
        } else {
            writeln!(text, "reverse_um = {}", pitch_table(r)).unwrap();
        }
        if axis == 0 {
            let (first, second) = if r.below(2) == 0 { (-350.0, 3420.5) } else { (2900.25, 80.0) };
            writeln!(text, "[axis.x.dual]\nacross = \"y\"\nfirst_mm = {first:?}").unwrap();
            let places = pitch_places(r, travel);
            let tables = [pitch_table(r), pitch_table(r)];
            writeln!(text, "second_mm = {second:?}\npitch = {{ {places}, ").unwrap();
            text.pop();
            writeln!(text, "forward_um = {}, reverse_um = {} }}", tables[0], tables[1]).unwrap();
        }
    }
    for (error, along) in AXIS_PAIRS {
        let name = |axis: LinearAxis| ["x", "y", "z"][axis as usize];
        let travel = TRAVEL_MM[along as usize];
        // 64 segments, the widest up to ten times as wide as the narrowest.
        let widths: Vec<f64> = (0..64).map(|_| r.uniform(1.0, 10.0)).collect();
        let sum: f64 = widths.iter().sum();
        let start = r.uniform(0.0, 0.02) * travel;
        let mut knots = vec![start; 4];
        let mut end = start;
        for width in widths {
            end += width / sum * travel * 0.96;
            knots.push(end);
        }
        knots.extend([end; 3]);
        let amplitude = r.uniform(20.0, 200.0);
        let (mut um, step) = (0.0_f64, f64::min(amplitude, 50.0));
        let wander = |n: usize| {
            // At a clamped end the control points lie a third of a segment apart.
            let step = if (3..64).contains(&n) { step } else { step / 5.0 };
            um = (um + r.uniform(-step, step)).clamp(-amplitude, amplitude);
            um
        };
        let control: Vec<f64> = (0..67).map(wander).collect();
        writeln!(text, "[straightness.{}_of_{}]\norder = 4", name(error), name(along)).unwrap();
        writeln!(text, "knots_mm = {}\ncontrol_um = {}", list(knots), list(control)).unwrap();
    }
    writeln!(text, "[squareness]").unwrap();
    for name in ["x_of_y", "x_of_z", "y_of_x", "y_of_z", "z_of_x", "z_of_y"] {
        writeln!(text, "{name}_um_per_m = {:?}", r.uniform(-60.0, 60.0)).unwrap();
    }
    text
}

fn parse(text: &str) -> Machine {
    MachineFile::parse(text, Path::new("m.toml")).unwrap_or_else(|error| panic!("{error}\n{text}"))
}

fn compiled(text: &str) -> (Machine, Compiled) {
    let machine = parse(text);
    let compiled = compile(&machine).unwrap_or_else(|error| panic!("{error}"));
    (machine, compiled)
}

/// What does not depend on the position: one moment of temperatures, sensor and angles.
struct Moment {
    time_s: f64,
    reading: Reading,
    rpm: u16,
    temperatures: [Option<Temperature>; CHANNELS],
    angles: [MicroDegrees; 2],
}

impl Moment {
    fn random(random: &mut Random, time_s: f64) -> Self {
        let mut temperatures = [None; CHANNELS];
        for temperature in temperatures.iter_mut().take(COLUMNS.len()) {
            let celsius = random.uniform(5.0, 50.0);
            *temperature = Some(Temperature((celsius * UNITS_PER_C).round() as i32));
        }
        let angle =
            |random: &mut Random| MicroDegrees(random.below(720_000_001) as i32 - 360_000_000);
        Self {
            time_s,
            reading: Reading(random.below(4_096 << 10) as i32),
            rpm: [0, 24_000, random.below(30_001) as u16][random.below(3) as usize],
            temperatures,
            angles: [angle(random), angle(random)],
        }
    }
}

/// Both sides of the comparison.
struct Bench<'m> {
    machine: &'m Machine,
    calibration: Calibration<'m>,
    reference: Reference<'m>,
    heat: Heat,
    worst: Worst,
}

/// The largest difference with its inputs.
#[derive(Clone, Debug, Default)]
struct Worst {
    nm: f64,
    inputs: String,
}

impl Worst {
    fn or(self, other: Self) -> Self {
        if other.nm > self.nm { other } else { self }
    }
}

impl<'m> Bench<'m> {
    fn new(machine: &'m Machine, compiled: &'m Compiled) -> Self {
        let calibration = compiled.calibration();
        let (reference, heat) = (Reference::new(machine), Heat::default());
        Self { machine, calibration, reference, heat, worst: Worst::default() }
    }

    fn warms_up(&self) -> bool {
        self.machine.spindle.source == Some(Source::Warmup)
    }

    /// Goes on to another moment: lags settle there, the warm-up takes its `steps` of 100 ms.
    fn go_to(&mut self, moment: &Moment, steps: u32) {
        if !self.warms_up() {
            self.heat = Heat::default();
            self.reference = Reference::new(self.machine);
        }
        for _ in 0..steps {
            self.heat.step(&self.calibration, &moment.temperatures, Some(Rpm(moment.rpm)));
        }
    }

    fn board_nm(&self, moment: &Moment, position: [i32; 3], reverse: [bool; 3]) -> [i32; 3] {
        let mut place = Place::default();
        for axis in 0..3 {
            place.position[axis] = Position(position[axis]);
            let direction = if reverse[axis] { -1 } else { 1 };
            let config = &self.calibration.axes[axis].travel;
            place.travel[axis] = Travel::new();
            place.travel[axis].update(config, Position(position[axis]), direction);
        }
        let elongation = match self.machine.spindle.source {
            Some(Source::Sensor) => self.calibration.spindle.sensor.elongation(moment.reading),
            Some(Source::Temperature) => self.heat.by_temperature(),
            Some(Source::Warmup) => self.heat.by_running_time(),
            None => Nanometres::ZERO,
        };
        let tool = self.calibration.kinematics.direction(moment.angles).fine_error(elongation);
        let errors = self.calibration.errors(&self.heat, &place);
        std::array::from_fn(|axis| {
            let parts = errors.axes[axis];
            let sum = parts.thermal.plus(parts.positioning).plus(parts.guides).plus(tool[axis]);
            assert!(sum != Fine(i32::MAX) && sum != Fine(i32::MIN), "the test leaves the range");
            sum.rounded().0
        })
    }

    fn model_nm(&mut self, moment: &Moment, position: [i32; 3], reverse: [bool; 3]) -> [f64; 3] {
        let celsius = |channel: usize| {
            f64::from(moment.temperatures[channel].expect("all of them are there").0) / UNITS_PER_C
        };
        let temperatures: [(&str, f64); 4] =
            std::array::from_fn(|channel| (COLUMNS[channel], celsius(channel)));
        let [c, a] = moment.angles.map(|angle| f64::from(angle.0) / 1e6);
        let situation = Situation {
            time_s: Some(moment.time_s),
            // A count of the paper's chain is an eighth of a code, 128 reading units.
            sensor_counts: f64::from(moment.reading.0) / 128.0,
            spindle_rpm: Some(moment.rpm.into()),
            load_n: None,
            temperatures_c: &temperatures,
            position_mm: position.map(|units| f64::from(units) / UNITS_PER_MM),
            angle_deg: [a, f64::NAN, c],
            direction: reverse.map(|reverse| if reverse { -1.0 } else { 1.0 }),
        };
        self.reference.step(&situation).error_um().map(|um| um * 1_000.0)
    }

    fn compare(&mut self, moment: &Moment, position: [i32; 3], reverse: [bool; 3]) {
        let board = self.board_nm(moment, position, reverse);
        let model = self.model_nm(moment, position, reverse);
        for axis in 0..3 {
            let nm = (f64::from(board[axis]) - model[axis]).abs();
            if nm.is_nan() || nm > self.worst.nm {
                assert!(nm <= BOUND_NM, "{nm} nm at {position:?} {reverse:?}");
                let name = ["X", "Y", "Z"][axis];
                let inputs = format!(
                    "error of {name}: board {} nm, model {:.3} nm at {position:?} ·10 nm, reverse \
                     {reverse:?}, {:?}, {:?}, {} r/min, angles C A {:?}, {:?}, {:.1} s",
                    board[axis],
                    model[axis],
                    &moment.temperatures[..4],
                    moment.reading,
                    moment.rpm,
                    moment.angles,
                    self.machine.spindle.source,
                    moment.time_s
                );
                self.worst = Worst { nm, inputs };
            }
        }
    }

    /// Both sides at random, a new moment after every `stay` points.
    fn sweep(&mut self, random: &mut Random, count: u32, stay: u32) {
        // The model's first row is where its time starts; the board's first step follows.
        self.model_nm(&Moment::random(random, 0.0), [0; 3], [false; 3]);
        let mut moment = Moment::random(random, 0.1);
        self.go_to(&moment, 1);
        for n in 0..count {
            if n % stay == 0 && n > 0 {
                let steps = if self.warms_up() { 1 + random.below(3_000) } else { 1 };
                moment = Moment::random(random, moment.time_s + f64::from(steps) * 0.1);
                self.go_to(&moment, steps);
            }
            let (position, reverse) = anywhere(random);
            self.compare(&moment, position, reverse);
        }
    }
}

/// Positions to 4 % outside of the travel, and directions.
fn anywhere(random: &mut Random) -> ([i32; 3], [bool; 3]) {
    let position = TRAVEL_MM
        .map(|travel| (random.uniform(-0.04, 1.04) * travel * UNITS_PER_MM).round() as i32);
    (position, [(); 3].map(|()| random.below(2) == 1))
}

/// Where something begins or ends on each axis: knots and pitch points, in position units.
fn corners(machine: &Machine, axis: usize) -> Vec<i32> {
    let mut places_mm: Vec<f64> = machine
        .straightness
        .iter()
        .filter(|curve| curve.along.index() == axis)
        .flat_map(|curve| curve.spline.knots_mm.iter().copied())
        .collect();
    let own = &machine.axes[axis];
    let tables = own.pitch.iter().chain(own.dual.iter().map(|dual| &dual.pitch));
    for pitch in tables {
        places_mm
            .extend((0..pitch.forward_um.len()).map(|n| pitch.start_mm + pitch.step_mm * n as f64));
    }
    if axis == 1 {
        let beam = machine.axes[0].dual.as_ref().expect("a gantry");
        places_mm.extend([beam.first_mm, beam.second_mm]);
    }
    places_mm.iter().map(|mm| (mm * UNITS_PER_MM).round() as i32).collect()
}

#[test]
fn a_whole_gantry_fits_the_board_with_at_most_24_bytes_a_segment() {
    for seed in 0..12 {
        let (_, compiled) = compiled(&whole_machine(seed));
        let calibration = compiled.calibration();
        let bytes = compiled.blob().len();
        let (mut segments, mut of_curves) = (0, 0);
        for curve in &calibration.straightness {
            let parts = (curve.segments().len(), curve.index().len());
            segments += parts.0;
            of_curves += parts.0 * SEGMENT_SIZE + 2 * parts.1;
        }
        let each = of_curves as f64 / segments as f64;
        println!(
            "seed {seed}: {bytes} bytes, {segments} segments of {each:.2} bytes, worst part {:.4} nm",
            compiled.largest_difference_nm
        );
        assert_eq!(segments, 6 * 64);
        assert!(bytes <= 16_384 && each <= 24.0);
    }
}

#[test]
fn the_sum_of_everything_is_within_10_nm_at_every_knot_and_every_pitch_point() {
    let mut worst = Worst::default();
    let mut count = 0;
    for seed in 100..106 {
        let (machine, compiled) = compiled(&whole_machine(seed));
        let mut bench = Bench::new(&machine, &compiled);
        let random = &mut Random(seed);
        let mut time_s = 0.0;
        let start = Moment::random(random, time_s);
        bench.model_nm(&start, [0; 3], [false; 3]);
        for axis in 0..3 {
            for corner in corners(&machine, axis) {
                time_s += 0.1;
                let moment = Moment::random(random, time_s);
                bench.go_to(&moment, 1);
                for beside in [-1, 0, 1] {
                    let (mut position, mut reverse) = anywhere(random);
                    position[axis] = corner + beside;
                    for way in [false, true] {
                        reverse[axis] = way;
                        bench.compare(&moment, position, reverse);
                        count += 1;
                    }
                }
            }
        }
        worst = worst.or(bench.worst);
    }
    println!("{count} corners: {:.3} nm, {}", worst.nm, worst.inputs);
    assert!(count > 30_000);
}

fn random_points(machines: u64, count: u32) {
    let mut worst = [Worst::default(), Worst::default(), Worst::default()];
    for seed in 0..machines {
        let (machine, compiled) = compiled(&whole_machine(1_000 + seed));
        let mut bench = Bench::new(&machine, &compiled);
        bench.sweep(&mut Random(seed), count / machines as u32, 50);
        let source = machine.spindle.source.expect("every machine has one") as usize;
        worst[source] = std::mem::take(&mut worst[source]).or(bench.worst);
    }
    for worst in worst {
        println!("{count} points: {:.3} nm, {}", worst.nm, worst.inputs);
    }
}

#[test]
fn the_sum_of_everything_is_within_10_nm_at_random() {
    random_points(6, 200_000 + 4);
}

#[test]
#[ignore = "campaign: cargo test -p trueup-machine --test fixed_point -- --ignored --show-output"]
fn campaign_the_sum_of_everything_is_within_10_nm_at_ten_million_points() {
    random_points(60, 10_000_020);
}

// Signs: each part by itself, on all three ways.

/// A bridge with the hand that feeds it.
struct Rig<'c> {
    bridge: Bridge<'c>,
    state: State,
    ms: u32,
    raw: [Raw; CHANNELS],
    position_mm: [f64; 3],
    heading: [Heading; 3],
    angles_deg: [f64; 2],
    /// Counts of the paper's chain, whole codes.
    counts: u16,
    rpm: u16,
}

impl<'c> Rig<'c> {
    fn new(compiled: &'c Compiled) -> Self {
        Self {
            bridge: Bridge::new(compiled.calibration()),
            state: State::default(),
            ms: 0,
            raw: [Raw::NONE; CHANNELS],
            position_mm: [0.0; 3],
            heading: [Heading::Positive; 3],
            angles_deg: [0.0; 2],
            counts: 5_048,
            rpm: 24_000,
        }
    }

    /// The offset after so many milliseconds, in nm.
    fn offset_nm(&mut self, ms: u32) -> [i32; 3] {
        let mut last = None;
        for _ in 0..ms {
            self.ms += 1;
            let (bridge, state) = (&self.bridge, &mut self.state);
            let control = Control { engage: true, referenced: true, zero: false };
            bridge.hear(state, Command::Control(control));
            for axis in LinearAxis::ALL {
                let position = (self.position_mm[axis as usize] * UNITS_PER_MM).round() as i32;
                let direction = self.heading[axis as usize];
                let heard = AxisPosition { axis, position: Position(position), direction };
                bridge.hear(state, Command::Position(heard));
            }
            let angles =
                self.angles_deg.map(|degrees| MicroDegrees((degrees * 1e6).round() as i32));
            bridge.hear(state, Command::Rotary(Rotary { angles }));
            let code = self.counts / 8;
            let codes: [Code; CODES_PER_TICK] = std::array::from_fn(|n| match n % 4 {
                0 => Code(code - 1),
                2 => Code(code + 1),
                _ => Code(code),
            });
            let input = Input {
                codes: Some(&codes),
                speed: Some(Rpm(self.rpm)),
                temperatures: Some(&self.raw),
            };
            last = Some(bridge.tick(state, Millis(self.ms), input));
        }
        let output = last.expect("at least a millisecond");
        assert_eq!(output.quality, Quality::Live, "{:?}", output.flags);
        output.offset.expect("live").map(|nm| nm.0)
    }

    /// Seed 002's chain, 16 counts a kelvin above 4000.
    fn heat_to(&mut self, channel: usize, celsius: f64) {
        self.raw[channel] = Raw(((4_000.0 + 16.0 * celsius) * 256.0).round() as i32);
    }
}

/// A machine of `sections` with wide limits, `kind` and `inputs` as a user writes them.
fn machine_of(kind: &str, sections: &str) -> String {
    format!(
        "[machine]\nname = \"mill\"\nkind = {kind}\n[inputs]\n\
         sensor = {{ volts_full_scale = 10.0, counts_full_scale = 32768, divider = 0.33 }}\n\
         temp_x_c = {{ channel = 2, kind = \"linear\", zero_counts = 4000, counts_per_c = 16 }}\n\
         [limits]\nmax_um = {{ x = 5000, y = 5000, z = 5000 }}\nslew_um_per_s = 1000000\n{sections}"
    )
}

const PAPERS_SENSOR: &str = "[spindle]\nsource = \"sensor\"\n[spindle.sensor]\nk0_um = 0.0\n\
                             zero_counts = 5048.0\num_per_count = 0.0152587890625\n";

/// The model says `error_nm`; the board's offset is its opposite.
fn assert_signs(
    machine: &Machine,
    rig: &mut Rig<'_>,
    ms: u32,
    situation: &Situation<'_>,
    error_nm: [f64; 3],
) {
    let model = Reference::new(machine).step(situation).error_um();
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

fn at(position_mm: [f64; 3]) -> Situation<'static> {
    Situation { position_mm, direction: [1.0; 3], angle_deg: [0.0; 3], ..Situation::UNKNOWN }
}

#[test]
fn growth_seen_by_the_sensor_is_an_error_downwards_and_an_offset_upwards() {
    let (machine, compiled) = compiled(&machine_of("\"3-axis\"", PAPERS_SENSOR));
    let mut rig = Rig::new(&compiled);
    // 4096 counts above zero: 62.5 µm of growth.
    rig.counts = 9_144;
    let situation = Situation { sensor_counts: 9_144.0, ..at([0.0; 3]) };
    assert_signs(&machine, &mut rig, 500, &situation, [0.0, 0.0, -62_500.0]);
    let law = compiled.calibration().spindle.sensor;
    assert_eq!(law.elongation(Reading(9_144 * 128)), Nanometres(62_500));
}

#[test]
fn a_spindle_warmer_than_its_reference_is_lifted() {
    let sections = "[spindle]\nsource = \"temperature\"\n[spindle.temperature]\n\
                    sensor = \"temp_x_c\"\nreference_c = 20\nk_um_per_c = 2\n";
    let (machine, compiled) = compiled(&machine_of("\"3-axis\"", sections));
    let mut rig = Rig::new(&compiled);
    rig.heat_to(2, 25.5);
    let situation = Situation { temperatures_c: &[("temp_x_c", 25.5)], ..at([0.0; 3]) };
    assert_signs(&machine, &mut rig, 500, &situation, [0.0, 0.0, -11_000.0]);
}

#[test]
fn a_spindle_that_has_run_warm_is_lifted() {
    let sections = "[spindle]\nsource = \"warmup\"\n[spindle.warmup]\nlag_s = 1\nwarm_s = 5\n\
                    max_um = 80\nexponent = 4\n";
    let (machine, compiled) = compiled(&machine_of("\"3-axis\"", sections));
    let mut rig = Rig::new(&compiled);
    let mut reference = Reference::new(&machine);
    let row = |time_s| Situation { time_s: Some(time_s), ..at([0.0; 3]) };
    assert_eq!(reference.step(&row(0.0)).error_um(), [0.0; 3]);
    assert_eq!(reference.step(&row(6.0)).error_um(), [0.0, 0.0, -80.0]);
    assert_eq!(rig.offset_nm(800), [0; 3]);
    assert_eq!(rig.offset_nm(5_400), [0, 0, 80_000]);
}

#[test]
fn the_papers_axis_has_gone_270_um_too_far_and_is_taken_back() {
    let sections = "[axis.x.thermal]\nmode = \"position\"\nsensor = \"temp_x_c\"\n\
                    reference_c = 23\nslope_um_per_m_per_c = 14.21\n";
    let (machine, compiled) = compiled(&machine_of("\"3-axis\"", sections));
    let mut rig = Rig::new(&compiled);
    for (celsius, metres, nm) in
        [(42.0, 1.0, 269_990.0), (23.0, 1.0, 0.0), (22.0, 1.0, -14_210.0), (42.0, -0.5, -134_995.0)]
    {
        rig.heat_to(2, celsius);
        rig.position_mm[0] = metres * 1_000.0;
        let temperatures = [("temp_x_c", celsius)];
        let situation =
            Situation { temperatures_c: &temperatures, ..at([metres * 1_000.0, 0.0, 0.0]) };
        assert_signs(&machine, &mut rig, 800, &situation, [nm, 0.0, 0.0]);
    }
}

#[test]
fn an_axis_that_falls_short_is_sent_further() {
    // The example of 10 mm commanded and 9 moved, a hundredth of it: 10 µm short.
    let sections = "[axis.y.pitch]\nstart_mm = 0\nstep_mm = 10\nforward_um = [0, -10]\n\
                    reverse_um = [3, -7]\n";
    let (machine, compiled) = compiled(&machine_of("\"3-axis\"", sections));
    let mut rig = Rig::new(&compiled);
    for (mm, direction, nm) in [
        (10.0, 1.0, -10_000.0),
        (2.5, 1.0, -2_500.0),
        (10.0, -1.0, -7_000.0),
        (-4.0, -1.0, 3_000.0),
    ] {
        rig.position_mm[1] = mm;
        rig.heading[1] = if direction < 0.0 { Heading::Negative } else { Heading::Positive };
        let situation = Situation { direction: [1.0, direction, 1.0], ..at([0.0, mm, 0.0]) };
        assert_signs(&machine, &mut rig, 10, &situation, [0.0, nm, 0.0]);
    }
}

#[test]
fn backlash_is_an_error_of_the_negative_approach_alone() {
    for width_um in [4.0, -2.5] {
        let sections = format!("[axis.x.backlash]\nwidth_um = {width_um:?}\n");
        let (machine, compiled) = compiled(&machine_of("\"3-axis\"", &sections));
        let mut rig = Rig::new(&compiled);
        for (mm, direction) in [(0.0, 1.0), (-1.0, -1.0), (5.0, 1.0), (4.0, -1.0)] {
            rig.position_mm[0] = mm;
            rig.heading[0] = if direction < 0.0 { Heading::Negative } else { Heading::Positive };
            let error = if direction < 0.0 { width_um * 1_000.0 } else { 0.0 };
            let situation = Situation { direction: [direction, 1.0, 1.0], ..at([mm, 0.0, 0.0]) };
            assert_signs(&machine, &mut rig, 10, &situation, [error, 0.0, 0.0]);
        }
    }
}

#[test]
fn straightness_adds_up_across_the_axes() {
    // Each a straight line from 0 at 0 to so many µm at 100 mm.
    let curves = [
        ("x_of_y", 1),
        ("x_of_z", 2),
        ("y_of_x", 4),
        ("y_of_z", 8),
        ("z_of_x", 16),
        ("z_of_y", 32),
    ];
    let mut sections = String::new();
    for (name, um) in curves {
        writeln!(
            sections,
            "[straightness.{name}]\norder = 2\nknots_mm = [0, 0, 100, 100]\ncontrol_um = [0, {um}]"
        )
        .unwrap();
    }
    let (machine, compiled) = compiled(&machine_of("\"3-axis\"", &sections));
    let mut rig = Rig::new(&compiled);
    for (position, error_nm) in [
        ([100.0, 0.0, 0.0], [0.0, 4_000.0, 16_000.0]),
        ([0.0, 100.0, 0.0], [1_000.0, 0.0, 32_000.0]),
        ([0.0, 0.0, 100.0], [2_000.0, 8_000.0, 0.0]),
        // Outside, the ends are held.
        ([50.0, 150.0, 25.0], [1_500.0, 4_000.0, 40_000.0]),
        ([-9.0, -9.0, -9.0], [0.0; 3]),
    ] {
        rig.position_mm = position;
        assert_signs(&machine, &mut rig, 10, &at(position), error_nm);
    }
}

#[test]
fn squareness_is_the_error_of_the_first_axis_over_a_metre_of_the_second() {
    let sections = "[squareness]\nx_of_y_um_per_m = 12\nz_of_x_um_per_m = -30\n";
    let (machine, compiled) = compiled(&machine_of("\"3-axis\"", sections));
    let mut rig = Rig::new(&compiled);
    let position = [2_000.0, -500.0, 700.0];
    rig.position_mm = position;
    assert_signs(&machine, &mut rig, 10, &at(position), [-6_000.0, 0.0, -60_000.0]);
}

#[test]
fn a_tilted_head_takes_half_a_millimetre_to_y_and_z() {
    // 0.5 mm at once: k0 stands for the growth.
    let sections = PAPERS_SENSOR.replace("k0_um = 0.0", "k0_um = 500.0");
    let kind = "\"head-head\"\nhead_axes = [\"c\", \"a\"]";
    let (machine, compiled) = compiled(&machine_of(kind, &sections));
    let mut rig = Rig::new(&compiled);
    let calibration = compiled.calibration();
    for (c, a, error_nm) in [
        (0.0, 30.0, [0.0, 250_000.0, -433_012.7]),
        (90.0, 30.0, [-250_000.0, 0.0, -433_012.7]),
        (0.0, -30.0, [0.0, -250_000.0, -433_012.7]),
        (180.0, 90.0, [0.0, -500_000.0, 0.0]),
    ] {
        rig.angles_deg = [c, a];
        let situation =
            Situation { sensor_counts: 5_048.0, angle_deg: [a, f64::NAN, c], ..at([0.0; 3]) };
        assert_signs(&machine, &mut rig, 800, &situation, error_nm);
        let angles = [c, a].map(|degrees| MicroDegrees((degrees * 1e6) as i32));
        let error = calibration.kinematics.direction(angles).error(Nanometres(500_000));
        assert_eq!(error.map(|nm| f64::from(nm.0)), error_nm.map(f64::round));
    }
}

#[test]
fn two_drives_share_their_errors_across_the_beam() {
    for (first, second, y) in [(0.0, 3_000.0, 750.0), (3_000.0, 0.0, 2_250.0)] {
        let sections = format!(
            "[axis.x.pitch]\nstart_mm = 0\nstep_mm = 100\nforward_um = [4, 4]\n[axis.x.dual]\n\
             across = \"y\"\nfirst_mm = {first:?}\nsecond_mm = {second:?}\n\
             pitch = {{ start_mm = 0, step_mm = 100, forward_um = [8, 8] }}\n"
        );
        let (machine, compiled) = compiled(&machine_of("\"3-axis\"", &sections));
        let mut rig = Rig::new(&compiled);
        // A quarter of the way: 3/4 · 4 + 1/4 · 8; held beyond both drives.
        for (y, nm) in [(y, 5_000.0), (first, 4_000.0), (second, 8_000.0)] {
            rig.position_mm = [50.0, y, 0.0];
            assert_signs(&machine, &mut rig, 10, &at([50.0, y, 0.0]), [nm, 0.0, 0.0]);
        }
        let (beyond_mm, nm) = if second > first { (3_500.0, 8_000.0) } else { (3_500.0, 4_000.0) };
        rig.position_mm = [50.0, beyond_mm, 0.0];
        assert_signs(&machine, &mut rig, 10, &at([50.0, beyond_mm, 0.0]), [nm, 0.0, 0.0]);
    }
}

// Where the paper contradicts itself.

#[test]
fn neither_32768_nor_27648_counts_explain_table_1_and_a_fitted_line_does() {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../data");
    let run = RunFile::read(&data.join("spindle_paper_table1.csv")).expect("the project's own");
    let counts = run.require("sensor_counts").expect("a column of the file");
    let dial_um = run.require("measured_elongation_um").expect("a column of the file");
    let sensor = |k0: f64, um_per_count: f64| {
        let constants =
            format!("k0_um = {k0:?}\nzero_counts = 5048.0\num_per_count = {um_per_count:?}\n");
        let sections = format!("[spindle]\nsource = \"sensor\"\n[spindle.sensor]\n{constants}");
        let (machine, compiled) = compiled(&machine_of("\"3-axis\"", &sections));
        let law = compiled.calibration().spindle.sensor;
        let board_um: Vec<f64> = counts
            .iter()
            .map(|&counts| {
                let nm = f64::from(law.elongation(Reading((counts * 128.0) as i32)).0);
                assert!((nm - machine.elongation_um(counts) * 1_000.0).abs() <= 1.1, "{counts}");
                nm / 1_000.0
            })
            .collect();
        let left: Vec<f64> = dial_um.iter().zip(&board_um).map(|(dial, um)| dial - um).collect();
        let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let through_zero = product(&board_um, dial_um) / product(&board_um, &board_um);
        let line = fit_line(&board_um, dial_um).expect("15 rows with spread");
        (through_zero, line, Summary::of(&left).expect("15 rows").rms, law.slope.0)
    };
    let near = |value: f64, expected: f64, tolerance: f64| {
        assert!((value - expected).abs() <= tolerance, "{value} is not {expected}");
    };
    let (zero, line, rms, paper_slope) = sensor(0.0, 500.0 / 32_768.0);
    println!(
        "32768 counts: gain {zero:.4} through zero, {:.4} with an offset, rms {rms:.2}",
        line.gain
    );
    near(zero, 1.21, 0.01);
    near(line.gain, 1.2975, 0.001);
    near(rms, 9.38, 0.01);
    let (fitted_gain, fitted_offset) = (line.gain, line.offset);
    // An S7 input has 27648 counts at 10 V: 32768/27648 = 1.185 more for each.
    let (zero, line, rms, s7_slope) = sensor(0.0, 500.0 / 27_648.0);
    println!(
        "27648 counts: gain {zero:.4} through zero, {:.4} with an offset, rms {rms:.2}",
        line.gain
    );
    near(f64::from(s7_slope) / f64::from(paper_slope), 32_768.0 / 27_648.0, 1e-7);
    near(line.gain, 1.2975 * 27_648.0 / 32_768.0, 0.001);
    assert!(line.gain > 1.05 && rms > 2.0, "still not the dial's");
    // The linear law is right, its constants are not.
    let (_, line, rms, _) = sensor(fitted_offset, fitted_gain * 500.0 / 32_768.0);
    near(line.gain, 1.0, 1e-4);
    near(rms, 0.835, 0.01);
}

// What is refused.

#[test]
fn what_cannot_be_run_is_refused_with_its_place_and_the_rule() {
    const HEAD: &str = "[machine]\nname = \"mill\"\nkind = \"3-axis\"\n";
    let warmup = "[spindle]\nsource = \"warmup\"\n[spindle.warmup]\nlag_s = 60\nwarm_s = 5400\n\
                  max_um = 80\nexponent = 0.005\n";
    let curve = |knots: &str, control: &str| {
        format!("[straightness.z_of_x]\norder = 2\nknots_mm = {knots}\ncontrol_um = {control}\n")
    };
    let cases = [
        (
            "[axis.x.pitch]\nstart_mm = 5\nstep_mm = 10\nforward_um = [0, 0, 101]\n".to_string(),
            "4:9",
            "axis.x.pitch rises by 10.1 µm per mm at 15 mm, more than 10",
        ),
        (
            "[axis.x.pitch]\nstart_mm = 0\nstep_mm = 1\nforward_um = [0, 0]\n\
             reverse_um = [0, -10.5]\n"
                .to_string(),
            "4:9",
            "axis.x.pitch rises by -10.5 µm per mm at 0 mm, more than 10",
        ),
        (
            curve("[0, 0, 10, 10]", "[0, 101]"),
            "4:15",
            "straightness.z_of_x rises by 10.1 µm per mm at ",
        ),
        (
            curve("[0, 0, 5, 5.000001, 10, 10]", "[0, 1, 1, 0]"),
            "4:15",
            "straightness.z_of_x has knots at 5 and 5.000001 mm, closer than the board's 10 nm",
        ),
        (
            "[axis.x.thermal]\nmode = \"both\"\nsensor = \"temp_screw_c\"\nreference_c = 20\n"
                .to_string(),
            "6:10",
            "axis.x.thermal.sensor is \"temp_screw_c\", which [inputs] does not describe",
        ),
        (
            "[spindle]\nsource = \"temperature\"\n[spindle.temperature]\nsensor = \"temp_a_c\"\n\
             reference_c = 20\nk_um_per_c = 2\n"
                .to_string(),
            "7:10",
            "spindle.temperature.sensor is \"temp_a_c\", which [inputs] does not describe",
        ),
        (warmup.to_string(), "6:10", "spindle.warmup exponent 0.005 is below the board's 0.008"),
    ];
    for (sections, place, phrase) in cases {
        let error = compile(&parse(&format!("{HEAD}{sections}"))).expect_err(phrase).to_string();
        assert!(error.starts_with(&format!("m.toml:{place}: {phrase}")), "{error}");
    }
    // 3000 points of 4 bytes both ways are 24 kB.
    let points = list(vec![0.5; 3_000]);
    let large = format!(
        "{HEAD}[axis.x.pitch]\nstart_mm = 0\nstep_mm = 1\nforward_um = {points}\nreverse_um = {points}\n"
    );
    let error = compile(&parse(&large)).expect_err("too large").to_string();
    assert!(error.starts_with("m.toml:1:2: machine is too much for the board: "), "{error}");
    assert!(error.ends_with("the tables and curves have to be shorter"), "{error}");
}

// Time.

#[test]
fn any_speed_heats_within_1_nm_of_80_um() {
    let mut worst = (0.0, String::new());
    for speed_exponent in ["0.5", "1", "2.3"] {
        for rated_rpm in [3_000.0, 12_000.0, 24_000.0, 40_000.0_f64] {
            let sections = format!(
                "[spindle]\nsource = \"warmup\"\n[spindle.warmup]\nlag_s = 60\nwarm_s = 5400\n\
                 max_um = 80\nexponent = 4\nrated_rpm = {rated_rpm}\nspeed_exponent = {speed_exponent}\n"
            );
            let (_, compiled) = compiled(&machine_of("\"3-axis\"", &sections));
            let warmup = compiled.calibration().spindle.warmup.expect("written above");
            let p: f64 = speed_exponent.parse().expect("a number");
            let mut here = (0.0, 0);
            for rpm in 1..=u16::MAX {
                let exact = (f64::from(rpm) / rated_rpm).powf(p);
                let drive = f64::from(warmup.drive(Some(Rpm(rpm)))) / f64::from(1 << 28);
                if exact > 4.0 {
                    // Held: far beyond full growth on both sides.
                    assert!((3.99..4.000_001).contains(&drive), "{rpm} r/min: {drive}");
                    continue;
                }
                let nm = (drive - exact).abs() * 80_000.0;
                if nm > here.0 {
                    here = (nm, rpm);
                }
            }
            let segments = (warmup.power.segments().len(), warmup.power.index().len());
            println!(
                "p = {speed_exponent}, rated {rated_rpm}: {:.3} nm at {} r/min; (segments, index) {segments:?}",
                here.0, here.1
            );
            if here.0 > worst.0 {
                worst =
                    (here.0, format!("p = {speed_exponent}, rated {rated_rpm}, {} r/min", here.1));
            }
        }
    }
    println!("drive: {:.3} nm of 80 µm at {}", worst.0, worst.1);
    assert!(worst.0 <= 1.0, "{worst:?}");
}

#[test]
fn a_lagging_axis_is_within_5_nm_over_a_two_hour_ramp() {
    const ROW_S: u32 = 60;
    let sections = "[axis.x.thermal]\nmode = \"position\"\nsensor = \"temp_x_c\"\n\
                    reference_c = 20\nslope_um_per_m_per_c = 14.21\nlag_s = 1630\n";
    let (machine, compiled) = compiled(&machine_of("\"3-axis\"", sections));
    let calibration = compiled.calibration();
    let (mut heat, mut reference) = (Heat::default(), Reference::new(&machine));
    let place =
        Place { position: [Position(500_000_000), Position(0), Position(0)], ..Place::default() };
    let mut worst = (0.0, 0);
    for row in 0..=120 {
        let temperature = Temperature(((20.0 + f64::from(row) / 6.0) * UNITS_PER_C).round() as i32);
        let temperatures = std::array::from_fn(|channel| (channel == 2).then_some(temperature));
        // A row's value holds over the interval that ends with it; the first settles.
        for _ in 0..if row == 0 { 1 } else { ROW_S * 10 } {
            heat.step(&calibration, &temperatures, None);
        }
        let celsius = [("temp_x_c", f64::from(temperature.0) / UNITS_PER_C)];
        let situation = Situation {
            time_s: Some(f64::from(row * ROW_S)),
            temperatures_c: &celsius,
            ..at([5_000.0, 0.0, 0.0])
        };
        let [model_um, ..] = reference.step(&situation).error_um();
        let board = calibration.errors(&heat, &place).axes[0].thermal;
        let nm = (f64::from(board.0) / 256.0 - model_um * 1_000.0).abs();
        if nm > worst.0 {
            worst = (nm, row);
        }
    }
    println!("lag: {:.3} nm on 5 m after {} min", worst.0, worst.1);
    assert!(worst.0 <= 5.0);
}
