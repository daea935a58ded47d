//! The computations of the trueup bridge, in integers, on any machine.
//!
//! ```text
//! bridge = health ─► filter (window, revolution_mean) ─► sensor ─► tool ─► limits
//! ```
//!
//! # Words and symbols
//!
//! | symbol | term | unit and format | sign | page | standard |
//! |---|---|---|---|---|---|
//! | e, Δx, Δy, Δz | error: actual minus commanded | nm; 1/256 nm (Q8) while parts are added | + beyond the command | [`axis_errors`], [`tip_error`] | ISO 230-1 |
//! | | offset, the correction: what the CNC adds to its command, −e | nm | opposite to the error | [`limits`] | VIM 2.53 |
//! | s, ΔK | elongation of the spindle | nm | + out of the spindle | [`displacement_sensor`], [`warmup`], [`thermal`] | |
//! | V | tool direction, spindle nose to tool tip, length 1 | Q30 | machine axes | [`tool_direction`], [`kinematics`] | |
//! | P | position of an axis, commanded | 10 nm | machine axis | [`units`], [`machine_position`] | ISO 230-2 |
//! | P₀ | reference position of an expansion | 10 nm | machine axis | [`calibration`] | |
//! | T, T₀ | temperature, reference temperature | 1/4096 mK (Q12 of mK) above 0 °C | | [`thermometer`], [`thermal`] | IEC 60751 |
//! | K₀ | part of an expansion that does not depend on the position | 1/256 nm | as e | [`thermal`] | |
//! | tanβ(T) | part of an expansion by position: gradient | Q36 nm per 10 nm | as e | [`thermal`], [`gradient`] | |
//! | V, V₀, tanβ of the sensor | reading, zero reading, slope | 1/1024 code (Q10); Q28 nm per reading | + grows | [`displacement_sensor`] | |
//! | E_XX … E_ZZ | positioning error: pitch table and backlash | 1/256 nm | as e | [`pitch_table`], [`reversal`] | ISO 230-2 |
//! | E_YX, E_ZX … | straightness error of a motion across it | 1/256 nm | as e | [`curve`] | ISO 230-1 |
//! | E_AX … E_CZ | angular error of a linear axis, as the error at a lever of 1.34 m | 1/256 nm | right-handed | [`volumetric_error`] | ISO 230-1 |
//! | E_XOC, E_AOC … | location error of a rotary axis: shift, tilt of its line | 1/256 nm | as e; right-handed | [`volumetric_error`] | ISO 230-7 |
//! | | squareness error, as a gradient | Q36 nm per 10 nm | as e | [`gradient`] | ISO 230-1 |
//! | B | reversal value; here the width is −B | 1/256 nm | + approached in the negative direction | [`reversal`] | ISO 230-2 |
//! | β | reversal fraction: 0 approached positively, 1 negatively | Q31, 0…1 | | [`reversal`] | |
//! | τ, α | time constant; smoothing factor 1 − e^(−Δt/τ) of a first-order lag | Q32, 0…1, per 100 ms | | [`lag`] | |
//! | h | heat of the warm-up model | Q28, 1 at the rated speed | | [`warmup`] | |
//! | n | spindle speed | r/min, without a sign | | [`revolution_window`], [`term`] | |
//! | F | axial cutting force | 1/256 N | + pushes the tool back | [`term`] | |
//! | m | coefficient of a term | mantissa/2^shift ([`fixed_point::ScaledCoefficient`]) | | [`term`] | |
//!
//! Reference: the error that counts as zero, taken when the operator requests it
//! ([`bridge::ReferenceErrors`]). Source: gives the elongation ([`calibration::ElongationSource`]).
//! Quality, flags: how good an offset is, and why it is not the full correction ([`cnc`]).
//!
//! Configuration ([`calibration`]) and state ([`bridge::BridgeState`]) are apart, time is an argument,
//! and nothing here knows hardware, allocates or panics.
#![no_std]
#![forbid(unsafe_code)]
// A test that overflows fails, which is what a test is for.
#![cfg_attr(
    test,
    allow(
        clippy::arithmetic_side_effects,
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss
    )
)]

pub mod axis_errors;
pub mod bridge;
pub mod calibration;
pub mod cnc;
pub mod curve;
pub mod dead_band_filter;
pub mod design_parameters;
pub mod displacement_sensor;
pub mod fixed_point;
pub mod freeze_detector;
pub mod gradient;
pub mod index_set;
pub mod kinematics;
pub mod lag;
pub mod learned_changes;
pub mod limits;
pub mod machine_position;
pub mod pitch_table;
pub mod pt100;
pub mod retained_lags;
pub mod reversal;
pub mod revolution_mean;
pub mod revolution_window;
pub mod run_out_filter;
pub mod run_out_monitor;
pub mod sensor_health;
pub mod supply_monitor;
pub mod temperature_channels;
pub mod temperature_rate;
pub mod term;
#[cfg(test)]
mod testing;
pub mod thermal;
pub mod thermal_state;
pub mod thermometer;
pub mod tip_error;
pub mod tool_direction;
pub mod trigonometry;
pub mod units;
pub mod volumetric_error;
pub mod warmup;
