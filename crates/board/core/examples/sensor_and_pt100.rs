//! A displacement sensor and a PT100 in the integers of the board: `cargo run -p trueup-core --example sensor_and_pt100`.
#![allow(clippy::print_stdout, reason = "an example prints")]

use trueup_core::{
    displacement_sensor::{SensorLaw, SensorSlope},
    pt100,
    units::{MicroOhms, Nanometres, SensorReading, Temperature},
};

/// Prints the elongation of a sensor and the temperature of a PT100.
pub fn main() {
    // 0.5 µm for each code of the converter; a reading is 1/1024 of a code, a slope 2⁻²⁸ nm per reading.
    let slope = SensorSlope(500 << 18);
    let law = SensorLaw { k0: Nanometres(0), zero: SensorReading(600 << 10), slope };
    let Nanometres(nm) = law.elongation(SensorReading(640 << 10));
    println!("40 codes above zero: {nm} nm");
    assert_eq!(nm, 20_000);

    let boiling = pt100::temperature_from_resistance(MicroOhms(138_505_500));
    let Temperature(units) = boiling.expect("it is in the range of a PT100");
    println!("138.5055 ohm: {} mK", units / Temperature::PER_MILLIKELVIN);
    assert!((99_990..=100_010).contains(&(units / Temperature::PER_MILLIKELVIN)));
}
