//! Gantries with everything switched on, from a seeded generator, as the text that a user would write.

use std::{fmt::Write, path::Path};

use trueup_core::{
    calibration::STRAIGHTNESS_AXIS_PAIRS,
    cnc::LinearAxis,
    units::{Position, Temperature},
};
use trueup_machine::{CompiledCalibration, Machine, MachineFile, compile};

/// X, Y and Z of the paper's gantry.
pub const TRAVEL_MM: [f64; 3] = [14_300.0, 3_000.0, 2_500.0];
pub const COLUMNS: [&str; 4] = ["temp_x_c", "temp_y_c", "temp_z_c", "temp_front_c"];
pub const UNITS_PER_MM: f64 = Position::PER_MILLIMETRE as f64;
pub const UNITS_PER_C: f64 = Temperature::PER_KELVIN as f64;
pub const RATED_RPM: f64 = 24_000.0;

/// A linear congruential generator, its upper bits.
pub struct Random(pub u64);

impl Random {
    pub fn next(&mut self) -> u32 {
        self.0 =
            self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 32) as u32
    }

    /// 0 to `below` − 1.
    pub fn below(&mut self, below: u32) -> u32 {
        ((u64::from(self.next()) * u64::from(below)) >> 32) as u32
    }

    pub fn uniform(&mut self, from: f64, to: f64) -> f64 {
        from + (to - from) * (f64::from(self.next()) + 0.5) / 4_294_967_296.0
    }

    pub fn either(&mut self, one: f64, other: f64) -> f64 {
        if self.below(2) == 0 { one } else { other }
    }
}

pub fn list(values: impl IntoIterator<Item = f64>) -> String {
    let values: Vec<String> = values.into_iter().map(|value| format!("{value:?}")).collect();
    format!("[{}]", values.join(", "))
}

/// 128 errors that wander.
pub fn pitch_table(random: &mut Random) -> String {
    let mut um = random.uniform(-20.0, 20.0);
    list((0..128).map(|_| {
        um += random.uniform(-6.0, 6.0);
        um
    }))
}

/// Start and step of 128 points over the travel, with room left at both ends.
pub fn pitch_places(random: &mut Random, travel_mm: f64) -> String {
    let start = random.uniform(0.0, 0.02) * travel_mm;
    let step = (travel_mm * random.uniform(0.93, 0.97) / 127.0 * 1e3).round() / 1e3;
    format!("start_mm = {:?}, step_mm = {step:?}", (start * 1e3).round() / 1e3)
}

/// Everything that the format knows, switched on.
pub fn whole_machine(seed: u64) -> String {
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
    write_straightness(&mut text, r);
    writeln!(text, "[squareness]").unwrap();
    for name in ["x_of_y", "x_of_z", "y_of_x", "y_of_z", "z_of_x", "z_of_y"] {
        writeln!(text, "{name}_um_per_m = {:?}", r.uniform(-60.0, 60.0)).unwrap();
    }
    text
}

/// Writes the six curves, each of 64 segments.
fn write_straightness(text: &mut String, r: &mut Random) {
    for (error, along) in STRAIGHTNESS_AXIS_PAIRS {
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
}

pub fn parse(text: &str) -> Machine {
    MachineFile::parse(text, Path::new("m.toml")).unwrap_or_else(|error| panic!("{error}\n{text}"))
}

pub fn compiled(text: &str) -> (Machine, CompiledCalibration) {
    let machine = parse(text);
    let compiled = compile(&machine).unwrap_or_else(|error| panic!("{error}"));
    (machine, compiled)
}
