//! What is shown of a calibration compiles back to the same blob, bit for bit.

use std::path::Path;

use trueup_core::{
    calibration::Calibration,
    limits::Limits,
    sensor::{SensorLaw, Slope},
    tool::Direction,
    units::{Nanometres, Reading},
};
use trueup_link::calibration::{MAX_OFFSET_NM, decode, encode};
use trueup_machine::{MachineFile, compile, show};

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

    /// A calibration that the compiler could have written.
    fn calibration(&mut self) -> Calibration {
        let one = f64::from(Direction::ONE);
        loop {
            let sensor = SensorLaw {
                k0: Nanometres(self.integer()),
                zero: Reading(self.integer()),
                slope: Slope(self.integer()),
            };
            let ends = [0, 4096 * 1024].map(|reading| {
                let grown = f64::from(reading) - f64::from(sensor.zero.0);
                f64::from(sensor.k0.0) + grown * f64::from(sensor.slope.0) / 2_f64.powi(28)
            });
            if ends.iter().any(|nm| nm.abs() > f64::from(i32::MAX - 10)) {
                continue;
            }
            return Calibration {
                sensor,
                tool_direction: Direction(
                    self.unit_vector().map(|component| (component * one).round() as i32),
                ),
                limits: Limits {
                    max: [(); 3].map(|()| {
                        Nanometres(self.uniform(0.0, f64::from(MAX_OFFSET_NM) + 1.0) as i32)
                    }),
                    slew_nm_per_s: (self.integer() as u32).max(1),
                    link_timeout_ms: (self.integer() as u32).max(1),
                    hold_ms: self.integer() as u32,
                },
            };
        }
    }
}

fn assert_comes_back(calibration: &Calibration) {
    let blob = encode(calibration);
    let shown = show::show(&decode(&blob).expect("the test's own calibration is right"));
    let machine = MachineFile::parse(&shown.toml, Path::new("shown.toml"))
        .unwrap_or_else(|error| panic!("{error}\n{}\n{calibration:?}", shown.toml));
    let compiled = compile(&machine)
        .unwrap_or_else(|error| panic!("{error}\n{}\n{calibration:?}", shown.toml));
    assert_eq!(encode(&compiled.calibration), blob, "{calibration:?}\n{}", shown.toml);
    assert_eq!(shown.largest_difference_nm, Ok(compiled.largest_difference_nm));
}

#[test]
fn random_calibrations_come_back_bit_for_bit() {
    let mut random = Random(0x9e37_79b9_7f4a_7c15);
    for _ in 0..20_000 {
        assert_comes_back(&random.calibration());
    }
}

/// Directions near the diagonal are those that scaling alone would move by more than half a place.
#[test]
fn random_directions_near_the_diagonal_come_back_bit_for_bit() {
    let mut random = Random(0x2545_f491_4f6c_dd1d);
    let one = f64::from(Direction::ONE);
    let calibration = random.calibration();
    for _ in 0..20_000 {
        let v = [(); 3].map(|()| random.uniform(0.5, 1.0));
        let length = v.iter().map(|c| c * c).sum::<f64>().sqrt();
        let tool_direction = Direction(v.map(|c| (c / length * one).round() as i32));
        assert_comes_back(&Calibration { tool_direction, ..calibration });
    }
}
