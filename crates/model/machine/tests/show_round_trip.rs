//! A calibration that is shown compiles back to the same one: bit for bit without curves, and
//! within a tenth of a nanometre with them.

use std::path::Path;

use trueup_core::{
    calibration::{Calibration, ElongationSource},
    displacement_sensor::{SensorLaw, SensorSlope},
    learned_changes::LearnedLimits,
    limits::CompensationLimits,
    tool_direction::ToolDirection,
    units::{Nanometres, SensorReading, Temperature},
};
use trueup_machine::{CompiledCalibration, MachineFile, compile, decompile};
use trueup_store::calibration::{
    MAX_BLOB_SIZE, MAX_HOLD_MS, MAX_LEARNED_LIMITS, MAX_LINK_TIMEOUT_MS, MAX_OFFSET_NM,
    MAX_REJOIN_NM_PER_S, MAX_SLEW_NM_PER_S, decode, encode,
};

/// Repeatable random numbers (xorshift).
struct Random(u64);

impl Random {
    fn bits(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0
    }

    /// From `from` to below `to`.
    fn uniform(&mut self, from: f64, to: f64) -> f64 {
        from + (to - from) * (self.bits() >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// Any integer, small ones as likely as large ones.
    fn integer(&mut self) -> i32 {
        let shift = self.bits() % 32;
        (self.bits() as i32) >> shift
    }

    fn unit_vector(&mut self) -> [f64; 3] {
        loop {
            let mut v = [(); 3].map(|()| self.uniform(-1.0, 1.0));
            // Every third in a plane, and every ninth along an axis.
            for component in &mut v {
                if self.bits().is_multiple_of(3) {
                    *component = 0.0;
                }
            }
            let length = v.iter().map(|c| c * c).sum::<f64>().sqrt();
            if length > 0.1 {
                return v.map(|component| component / length);
            }
        }
    }

    /// Draws a sensor, a direction and limits that the compiler could have written. Returns `calibration` with them.
    fn change<'c>(&mut self, calibration: &Calibration<'c>) -> Calibration<'c> {
        let mut calibration = *calibration;
        calibration.kinematics.zero = stored(self.unit_vector());
        calibration.limits = CompensationLimits {
            max: [(); 3]
                .map(|()| Nanometres(self.uniform(0.0, f64::from(MAX_OFFSET_NM) + 1.0) as i32)),
            slew_nm_per_s: (self.integer() as u32 % (MAX_SLEW_NM_PER_S + 1)).max(1),
            link_timeout_ms: (self.integer() as u32 % (MAX_LINK_TIMEOUT_MS + 1)).max(1),
            hold_ms: self.integer() as u32 % (MAX_HOLD_MS + 1),
            rejoin_nm_per_s: (self.integer() as u32 % (MAX_REJOIN_NM_PER_S + 1)).max(1),
            learned: LearnedLimits {
                growth: (self.integer() as u8).min(MAX_LEARNED_LIMITS.growth),
                axes: (self.integer() as u8).min(MAX_LEARNED_LIMITS.axes),
                zero: (self.integer() as u8).min(MAX_LEARNED_LIMITS.zero),
            },
        };
        calibration.cold_within = Temperature(self.integer() & 0x0F_FFFF);
        calibration.names.board = [(); 3].map(|()| self.integer().unsigned_abs());
        loop {
            let sensor = SensorLaw {
                k0: Nanometres(self.integer()),
                zero: SensorReading(self.integer()),
                slope: SensorSlope(self.integer()),
            };
            let ends = [0, 4096 * 1024].map(|reading| {
                let grown = f64::from(reading) - f64::from(sensor.zero.0);
                f64::from(sensor.k0.0) + grown * f64::from(sensor.slope.0) / 2_f64.powi(28)
            });
            if ends.iter().all(|nm| nm.abs() < f64::from(i32::MAX - 10)) {
                calibration.spindle.sensor = sensor;
                return calibration;
            }
        }
    }

    /// Numbers with this many decimals, as TOML.
    fn numbers(&mut self, count: usize, most: f64, decimals: usize) -> String {
        let numbers: Vec<String> =
            (0..count).map(|_| format!("{:.decimals$}", self.uniform(-most, most))).collect();
        format!("[{}]", numbers.join(", "))
    }
}

fn stored(unit_vector: [f64; 3]) -> ToolDirection {
    ToolDirection(
        unit_vector.map(|component| (component * f64::from(ToolDirection::ONE)).round() as i32),
    )
}

fn compiled(toml: &str) -> CompiledCalibration {
    let machine = MachineFile::parse(toml, Path::new("m.toml"))
        .unwrap_or_else(|error| panic!("{error}\n{toml}"));
    compile(&machine).unwrap_or_else(|error| panic!("{error}\n{toml}"))
}

/// Returns a 3-axis machine of `sections`.
fn machine(sections: &str) -> CompiledCalibration {
    compiled(&format!("[machine]\nname = \"mill\"\nkind = \"3-axis\"\n{sections}"))
}

const PAPER: &str = include_str!("../../../../data/paper_spindle.toml");

fn assert_comes_back(calibration: &Calibration<'_>) {
    let mut room = [0; MAX_BLOB_SIZE];
    let blob = encode(calibration, &mut room).expect("small enough");
    let shown =
        decompile::decompile_to_toml(&decode(blob).expect("the test's own calibration is right"));
    let compiled = compiled(&shown.toml);
    assert_eq!(compiled.blob(), blob, "{calibration:?}\n{}", shown.toml);
    assert_eq!(shown.largest_difference_nm, Ok(compiled.largest_difference_nm));
}

/// By how much what is shown compiles to something else, in nm, as its first line says.
fn difference_nm(compiled: &CompiledCalibration) -> f64 {
    let shown = decompile::decompile_to_toml(&compiled.calibration());
    let nm = shown.largest_difference_nm.unwrap_or_else(|reason| panic!("{reason}"));
    assert!(nm < 1.0, "{nm}");
    let first = shown.toml.lines().next().unwrap_or_default();
    if first.starts_with("# Compiles back to the same calibration. ") {
        return 0.0;
    }
    let rest = first.strip_prefix("# Compiles back to within ").expect("it says how near");
    let (number, _) = rest.split_once(" nm of the board's calibration. ").expect("in nm");
    number.parse().expect("a number")
}

#[test]
fn random_sensors_come_back_bit_for_bit() {
    let mut random = Random(0x9e37_79b9_7f4a_7c15);
    let paper = compiled(PAPER);
    assert_eq!(paper.calibration().spindle.chain, [Some(ElongationSource::Sensor), None, None]);
    for _ in 0..20_000 {
        assert_comes_back(&random.change(&paper.calibration()));
    }
}

/// Directions near the diagonal are those that scaling alone would move by more than half a place.
#[test]
fn random_directions_near_the_diagonal_come_back_bit_for_bit() {
    let mut random = Random(0x2545_f491_4f6c_dd1d);
    let paper = compiled(PAPER);
    let mut calibration = paper.calibration();
    for _ in 0..20_000 {
        let v = [(); 3].map(|()| random.uniform(0.5, 1.0));
        let length = v.iter().map(|c| c * c).sum::<f64>().sqrt();
        calibration.kinematics.zero = stored(v.map(|c| c / length));
        assert_comes_back(&calibration);
    }
}

#[test]
fn random_pitch_tables_come_back_bit_for_bit() {
    let mut random = Random(0x1234_5678_9abc_def1);
    for round in 0..300 {
        let count = 1 + (random.bits() % 300) as usize;
        // Whole hundredths: a step between two of the board's is refused in a long table.
        let step_mm = random.uniform(10.0, 15_000.0 / count as f64 + 10.0).round() + 0.25;
        let (start_mm, decimals) = (random.uniform(-5_000.0, 2_000.0), (round % 10) as usize);
        let forward = random.numbers(count, 40.0, decimals);
        let reverse = match round % 3 {
            0 => String::new(),
            _ => format!("reverse_um = {}", random.numbers(count, 40.0, decimals)),
        };
        let second = random.numbers(7, 40.0, decimals);
        let (first_mm, second_mm) = (random.uniform(-9.0, 9.0), random.uniform(100.0, 3e3));
        let compiled = machine(&format!(
            "[axis.z.pitch]\nstart_mm = {start_mm}\nstep_mm = {step_mm}\nforward_um = {forward}\n\
             {reverse}\n[axis.z.dual]\nacross = \"y\"\nfirst_mm = {first_mm}\n\
             second_mm = {second_mm}\npitch = {{ start_mm = -7.25, step_mm = 900, \
             forward_um = {second} }}"
        ));
        assert_comes_back(&compiled.calibration());
    }
}

#[test]
fn random_laws_lags_and_backlash_come_back_bit_for_bit() {
    let mut random = Random(0x0fed_cba9_8765_4321);
    for round in 0..500 {
        let mode = ["constant", "position", "both"][round % 3];
        let mut number = |from, to| random.uniform(from, to);
        let k = number(0.05, 25.0);
        let (lag_s, warm_s) = (number(0.0, 100.0), number(2_000.0, 20_000.0));
        let compiled = machine(&format!(
            "[inputs]\ntemp_a_c = {{ channel = 7, kind = \"pt100\", max_c_per_min = 599.9 }}\ntemp_b_c = {{ channel = 2, \
             kind = \"linear\", zero_counts = {}, counts_per_c = {} }}\n\
             [spindle]\nsource = \"temperature\"\n\
             [spindle.temperature]\nsensor = \"temp_b_c\"\nreference_c = {}\nk_um_per_c = {}\n\
             lag_s = {}\n[spindle.warmup]\nlag_s = {lag_s}\nwarm_s = {warm_s}\nmax_um = {}\n\
             exponent = {k}\ncool_s = {}\n\
             [axis.y.thermal]\nmode = \"{mode}\"\nsensor = \"temp_a_c\"\nreference_c = {}\n\
             constant_um_per_c = {}\nslope_um_per_m_per_c = {}\norigin_mm = {}\nlag_s = {}\n\
             [axis.y.backlash]\nwidth_um = {}\nramp_mm = {}\nhysteresis_um = {}\n\
             [squareness]\ny_of_z_um_per_m = {}\n",
            number(-8_000.0, 8_000.0),
            number(0.1, 10_000.0),
            number(-10.0, 40.0),
            number(-5.0, 5.0),
            number(0.0, 20_000.0),
            number(-300.0, 300.0),
            number(10.0, 20_000.0),
            number(-10.0, 40.0),
            number(-20.0, 20.0),
            number(-30.0, 30.0),
            number(-9_000.0, 9_000.0),
            number(0.0, 5_000.0),
            number(-50.0, 50.0),
            number(0.0, 3.0),
            number(0.0, 30.0),
            number(-500.0, 500.0),
        ));
        assert_comes_back(&compiled.calibration());
    }
}

#[test]
fn speed_exponents_come_back_bit_for_bit() {
    let exponents = [0.33, 0.5, 1.0, 1.333, 1.5, 2.0, 2.5, 3.0, 3.5];
    let speeds = [3_000.5, 12_345.0, 24_000.0, 40_000.0, 60_000.0];
    for (speed_exponent, rated_rpm) in
        exponents.into_iter().flat_map(|p| speeds.map(|speed| (p, speed)))
    {
        let compiled = machine(&format!(
            "[spindle]\nsource = \"warmup\"\n[spindle.warmup]\nlag_s = 60\nwarm_s = 5400\n\
             max_um = 80\nexponent = 4\nrated_rpm = {rated_rpm:?}\n\
             speed_exponent = {speed_exponent:?}"
        ));
        let shown = decompile::decompile_to_toml(&compiled.calibration()).toml;
        for line in [
            format!("\nrated_rpm = {rated_rpm:?}\n"),
            format!("\nspeed_exponent = {speed_exponent:?}\n"),
        ] {
            assert!(shown.contains(&line), "{line}{shown}");
        }
        assert_comes_back(&compiled.calibration());
    }
}

#[test]
fn random_tables_over_temperature_come_back_within_a_tenth_of_a_nanometre() {
    let mut random = Random(0x7777_1234_5555_9999);
    let mut worst: f64 = 0.0;
    for _ in 0..300 {
        let rows = 1 + random.bits() % 20;
        let mut t = random.uniform(-10.0, 15.0);
        let mut table = String::new();
        for _ in 0..rows {
            let (constant, slope) = (random.uniform(-90.0, 90.0), random.uniform(-300.0, 300.0));
            table += &format!("[{t}, {constant}, {slope}], ");
            t += random.uniform(4.0, 10.0);
        }
        let compiled = machine(&format!(
            "[inputs]\ntemp_a_c = {{ channel = 1, kind = \"pt100\" }}\n[axis.x.thermal]\n\
             mode = \"both\"\nsensor = \"temp_a_c\"\ntable = [{table}]"
        ));
        worst = worst.max(difference_nm(&compiled));
    }
    println!("tables over temperature: {worst:.4} nm");
    assert!(worst < 0.1);
}

#[test]
fn random_curves_come_back_within_a_tenth_of_a_nanometre() {
    let mut random = Random(0x5555_aaaa_1357_2468);
    let mut worst: f64 = 0.0;
    for round in 0..200 {
        let order = 2 + round % 3;
        let spans = 1 + (random.bits() % 60) as usize;
        let mut knot = random.uniform(-3_000.0, 0.0);
        let mut knots = vec![knot.to_string(); order];
        for _ in 1..spans {
            knot += random.uniform(120.0, 300.0);
            knots.push(knot.to_string());
        }
        knots.extend(vec![(knot + 250.0).to_string(); order]);
        // Beyond 262 µm the compiler halves segments.
        let most = [10.0, 200.0][usize::from(round % 5 == 0)];
        let control = random.numbers(spans + order - 1, most, 3);
        let compiled = machine(&format!(
            "[straightness.y_of_x]\norder = {order}\nknots_mm = [{}]\ncontrol_um = {control}",
            knots.join(", ")
        ));
        worst = worst.max(difference_nm(&compiled));
    }
    println!("curves: {worst:.4} nm");
    assert!(worst < 0.1);
}

/// The example of the format's description, with what the board needs to know of its channels.
#[test]
fn the_gantry_of_the_description_comes_back_whole() {
    let compiled = compiled(GANTRY);
    let shown = decompile::decompile_to_toml(&compiled.calibration());
    let again = self::compiled(&shown.toml);
    let (a, b) = (compiled.calibration(), again.calibration());
    assert_eq!(a.thermometers, b.thermometers);
    assert_eq!(a.spindle, b.spindle);
    assert_eq!(a.kinematics, b.kinematics);
    assert_eq!(a.axes, b.axes);
    assert_eq!(a.squareness, b.squareness);
    assert_eq!(a.limits, b.limits);
    for (a, b) in a.straightness.iter().zip(&b.straightness) {
        assert_eq!((a.first_knot(), a.segments().len()), (b.first_knot(), b.segments().len()));
    }
    let nm = shown.largest_difference_nm.expect("it compiles");
    println!("gantry: {nm:.4} nm");
    assert!(nm < 0.1, "{}", shown.toml);
    for line in [
        "kind = \"head-head\"",
        "head_axes = [\"c\", \"a\"]",
        "source = \"sensor\"",
        "warm_s = 5400.0",
        "exponent = 4.0",
        "k_um_per_c = 2.0",
        "    [42.0, 0.0, 270.0],",
        "forward_um = [0.0, 1.5, 2.0]",
        "reverse_um = [0.5, 2.0, 2.5]",
        "width_um = 4.0",
        "across = \"y\"",
        "second_mm = 3000.0",
        "forward_um = [0.0, 1.0, 2.5]",
        "[straightness.z_of_x]",
        "x_of_y_um_per_m = 11.5",
    ] {
        assert!(shown.toml.lines().any(|shown| shown == line), "{line}\n{}", shown.toml);
    }
}

const GANTRY: &str = r#"
[machine]
name = "gantry"
kind = "head-head"
head_axes = ["c", "a"]
tool_direction = [0.0, 0.0, -1.0]

[inputs]
mains_hz = 60
sensor = { volts_full_scale = 10.0, counts_full_scale = 32768, divider = 0.33 }
temp_screw_c = { channel = 0, kind = "pt100" }
temp_front_c = { channel = 1, kind = "linear", zero_counts = 4000, counts_per_c = 16, max_c_per_min = 0.1 }

[spindle]
source = "sensor"
[spindle.sensor]
k0_um = 0.0
zero_counts = 5048.0
um_per_count = 0.0152587890625
temperature = "temp_coil_c"
[spindle.warmup]
lag_s = 60.0
warm_s = 5400.0
max_um = 80.0
exponent = 4.0
cool_s = 1335.0
rated_rpm = 24000.0
speed_exponent = 0.0
[spindle.temperature]
sensor = "temp_front_c"
reference_c = 20.0
k_um_per_c = 2.0
lag_s = 0.0

[axis.x]
feedback = "screw"
[axis.x.thermal]
mode = "position"
sensor = "temp_screw_c"
reference_c = 23.0
constant_um_per_c = 0.0
slope_um_per_m_per_c = 14.21
origin_mm = 0.0
lag_s = 0.0
table = [[23.0, 0.0, 0.0], [42.0, 0.0, 270.0]]
[axis.x.pitch]
start_mm = 0.0
step_mm = 100.0
forward_um = [0.0, 1.5, 2.0]
reverse_um = [0.5, 2.0, 2.5]
[axis.y.backlash]
width_um = 4.0
ramp_mm = 0.05
hysteresis_um = 1.0
[axis.x.dual]
across = "y"
first_mm = 0.0
second_mm = 3000.0
pitch = { start_mm = 0.0, step_mm = 100.0, forward_um = [0.0, 1.0, 2.5] }

[straightness.z_of_x]
order = 4
knots_mm = [0.0, 0.0, 0.0, 0.0, 500.0, 1000.0, 1000.0, 1000.0, 1000.0]
control_um = [0.0, 3.0, -2.0, 4.0, 0.0]

[squareness]
x_of_y_um_per_m = 11.5

[limits]
max_um = { x = 200.0, y = 200.0, z = 500.0 }
slew_um_per_s = 20.0
link_timeout_ms = 500
hold_ms = 2000
"#;
