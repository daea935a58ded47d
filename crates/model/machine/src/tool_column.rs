//! The column of a run that says which tool it is, and the numbers of its labels.

/// The column of a run that says which tool it is.
pub const TOOL_COLUMN: &str = "tool";

/// Returns the number in whose form a label is kept: −1 − FNV-1a of 32 bits.
///
/// ```
/// use trueup_machine::tool_column::label_code;
/// assert_eq!(label_code("drill"), label_code("drill"));
/// assert!(label_code("drill") < 0.0 && label_code("drill") != label_code("mill"));
/// ```
#[must_use]
pub fn label_code(label: &str) -> f64 {
    let hash = label
        .bytes()
        .fold(0x811C_9DC5_u32, |hash, byte| (hash ^ u32::from(byte)).wrapping_mul(0x0100_0193));
    -1.0 - f64::from(hash)
}
