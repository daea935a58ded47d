//! The terms that a diagnosis has added to the machine's model: up to
//! [`MAX_TERMS`](crate::design_parameters::MAX_TERMS), in their order.
//!
//! A term of the elongation gives p a new value; one of an axis adds to its error:
//!
//! ```text
//! gain        p + m·p                    heat      + m·(lag_τ(T) − T_ref)
//! curvature   p + m·(p²/2²⁴)             time      + m·(1 − e^(−t/τ))
//! saturation  min(p, limit)              speed     + m·n²
//! position    + gradient·P               load      + m·F
//! heat slope  + m·(lag_τ(T) − T_ref)·P/2²⁷
//! reversed    + β·(w + gradient·P)       wave      + a·sin(2π·P/L + φ)
//!                                        speed heat + m·lag_τ(n) or m·lag_τ(n²), from 0
//! tool        + m(tool)·f                condition + (m₀ + (m₁ − m₀)·lag_τ(s))·f
//! ```
//!
//! f is 1, n², P, or the growth by the source's own law, and s is 1 while the condition holds (`category`).
//! A table or a curve of the position, and an angle, a gradient or a curve, times a [lever](Tilt) are added as well.
//! Each also adds a constant. β is the fraction of the approach
//! in the negative direction ([`travel`](crate::reversal)). m is a number with its own binary point
//! ([`ScaledCoefficient`](crate::fixed_point::ScaledCoefficient)), so that a coefficient of any size keeps 30 bits. Heat and time are stepped every
//! 100 ms with the rest of the heat; the others are computed where they are needed.
//!
//! Everything is 1/256 nm. Measured worst error against `f64`, from the largest to the smallest
//! coefficients: half of that unit for each product, and 0.004 nm for a wave of 100 µm.

mod category;
mod combined_effect;
mod effect;
mod evaluation_order;
mod term_states;
#[cfg(test)]
mod tests;
mod tilt;

pub use category::{CategoryFactor, ConditionLevels, ToolTable, UNIT_STEP};
pub use combined_effect::{OperatingPoint, apply_elongation_terms, compute_axis_errors};
pub use effect::{
    Effect, HEAT_SLOPE_BITS, SpeedExponent, Target, Term, Terms, thermal_term_indices,
};
pub use evaluation_order::{category_factor, elongation_term_prefix_length};
pub use term_states::TermStates;
pub use tilt::{REFERENCE_LEVER, Tilt};
