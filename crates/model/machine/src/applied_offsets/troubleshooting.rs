//! Where a CNC may apply an offset otherwise than once, control by control, and the sentences for the user.

use super::factor_estimate::FactorEstimate;

/// The possible faults of each control.
const TROUBLESHOOTING_HINTS: [&str; 5] = [
    "LinuxCNC: axis.L.eoffset-scale (trueup.0.scale, 10⁻⁶ mm for a count of 1 nm) and the sign \
     of axis.L.eoffset-counts. Also axis.L.eoffset-enable, [AXIS_L] OFFSET_AV_RATIO (absent or \
     0: the offset is never applied), or another owner that adds to the counts.",
    "SINUMERIK 840D: the words of DB 900 and their unit (0.01 µm to mm). The sign of the \
     temperature compensation: a positive $SA_TEMP_COMP_ABS_VALUE (SD43900) or \
     $SC_TOOL_TEMP_COMP (SD42960) moves the axis negative. MD32750 $MA_TEMP_COMP_TYPE. SD43900 \
     and SD42960 both written add the offset twice. An axis programmed in diameter.",
    "FANUC: the external machine coordinate system shift by G000 to G002. Look at its sign (the \
     shift is the offset itself) and the least input increment (1 or 0.1 µm). Also EREND for \
     each axis, and an axis in diameter (1006#3).",
    "HEIDENHAIN: the sign and the unit of the PLC's axis offset, and whether the PLC program adds it in two places.",
    "Modbus: the unit of the offset registers (0.01 µm), the order of the two words, signed 32 \
     bits. Also the scale and the sign in the PLC program behind the gateway.",
];

/// Factors that faults have.
const FAULT_FACTORS: [f64; 4] = [-1.0, 0.0, 0.5, 2.0];

impl FactorEstimate {
    /// Returns the factor of a fault that the interval holds, else the estimate.
    #[must_use]
    pub fn fault_factor_or_estimate(&self) -> f64 {
        let is_held = |fault: &f64| self.ci95[0] <= *fault && *fault <= self.ci95[1];
        FAULT_FACTORS.into_iter().find(is_held).unwrap_or(self.value)
    }

    /// Returns what the machine does with an offset, and of which kind of fault that is.
    #[must_use]
    pub fn describe(&self) -> String {
        let Self { value, ci95: [low, high] } = *self;
        let holds = |factor: f64| low <= factor && factor <= high || (value - factor).abs() < 0.1;
        let kind = if holds(0.0) {
            "the offset is not applied at all: the bridge is not engaged, or the CNC ignores it"
        } else if holds(-1.0) {
            "it is applied with the wrong sign"
        } else if value < 0.0 {
            "it is applied with the wrong sign and the wrong scale"
        } else if holds(0.5) {
            "half of it is applied: a radius for a diameter, or a scale"
        } else if holds(2.0) {
            "it is applied twice: a diameter for a radius, two places that both add it, or a scale"
        } else {
            "it is applied with the wrong scale"
        };
        format!(
            "For 1 µm of offset the machine moves {value:.3} µm (95 %: {low:.3} … {high:.3}), not 1: {kind}."
        )
        .replace('-', "−")
    }

    /// Returns where to look, a sentence for each control, after what holds for all.
    #[must_use]
    pub fn troubleshooting_steps() -> Vec<String> {
        let first = "The fault is between the bridge and the axis, not in the machine file: change no constant. Correct it \
                     in the CNC, check it with a dial gauge, and record again.";
        std::iter::once(first).chain(TROUBLESHOOTING_HINTS).map(Into::into).collect()
    }
}

/// Returns which record decides between the factor and a constant of the model.
#[must_use]
pub fn repeat_run_instruction() -> &'static str {
    "Record the same once more with the bridge disengaged (Engage off, offsets at 0), and give \
     both records. With the bridge engaged, a wrong factor in the CNC looks like another size \
     of the error."
}
