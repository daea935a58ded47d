//! Challenges: a believed machine that is right but for one hidden effect, and the answer.
//!
//! [`draw_test_case`] makes runs (CSV), a machine file (TOML) and, apart from them, the [`GroundTruth`]. Speeds,
//! loads, heat, paths, the size and the sign of the effect all come from the seed. For each row
//!
//! ```text
//! measured = believed + Σ effects + noise, rounded to the instrument's last digit
//! ```
//!
//! and `believed` is exactly what the machine file says of the written columns: this module works it
//! out by code of its own, from the rounded values that the file shows. The host's model gives the same
//! on every row within 1e-9 µm (`crates/tool/cli/tests/cli/simulate.rs`).
//!
//! # Conventions
//! - The table of causes (`docs/reference.md`, Causes) says what each effect does to p, the believed
//!   value, and names its parameters. In a pair both effects act on p and are added; a slope next to a
//!   lag is the slope over the lagged temperature, so that the two together are one machine.
//! - The ratio is RMS(effect)/RMS(noise) over the training rows, of a pair for each of the two. Noise
//!   includes the rounding. On an axis, whose measurement has an arbitrary zero, the effect counts
//!   less its mean over the training rows; an elongation has a true zero and counts in full.
//! - Time begins at 0 in each run, but for `step` and `drift`: there the hold-out is the same session
//!   continued, its `time_s` goes on, and the effect with it.
//! - Temperatures and the warm-up state settle as `docs/reference.md`, Machine file says.
//! - A table of tanβ that bends over T makes `reference-temperature` identifiable; where tanβ is
//!   straight, which is drawn as often, or does not bend where the axis was, `pitch-scale` explains the
//!   same, and is in `rivals`. So is, next to a slow mode of the bearing, the path of a motor whose
//!   temperature is correlated with it: a rival is what would leave so little that the likelihoods of the two
//!   differ by less than 6.
//! - [`GroundTruth::expected`] of a pair is that of the one which is harder to compensate.
//! - A reference that comes with an effect (T_ref of a heat path, of a coil's drift) is in its
//!   parameters as `reference_c`. A step's `at_s` is that of the training run.
//! - `unnamed-abbe` is an `angular-error` whose draws are older than its name: [`HiddenCause::expected_name`].
//! - A column `temp_cabinet_c` and `humidity_percent` have nothing to do with anything.

mod axis_bench;
mod axis_effects;
mod cause;
mod cause_pairs;
mod effect_shape;
mod growth_effects;
mod model_equations;
mod path_plan;
mod spindle_bench;
mod test_case;

pub use cause::{ExpectedDiagnosis, HiddenCause};
pub use cause_pairs::DISTINGUISHABLE_PAIRS;

use cause::BaseModel;

use trueup_twin::noise::RandomStream;

/// Runs, what the user believes, and the truth.
#[derive(Clone, Debug, PartialEq)]
pub struct TestCase {
    /// The training runs, each a run file (CSV) of its own; at least one.
    pub runs: Vec<String>,
    /// A run that is not to be trained on (CSV).
    pub holdout: String,
    /// The machine file (TOML): right but for the hidden effect.
    pub machine: String,
    /// The measured quantity: `elongation`, `dx`, `dy` or `dz`.
    pub quantity: &'static str,
    /// The hidden effects: the right answer.
    pub truth: GroundTruth,
}

/// The hidden effects of a challenge, and the parts of its data.
#[derive(Clone, Debug, PartialEq)]
pub struct GroundTruth {
    /// None where there is only noise; two in a pair.
    pub effects: Vec<HiddenEffect>,
    /// The answer expected from a diagnosis.
    pub expected: ExpectedDiagnosis,
    /// RMS of the noise (with the rounding) over the training rows, in µm.
    pub noise_rms_um: f64,
    /// Correlation of the noise from row to row; 0: white.
    pub noise_rho: f64,
    /// The instrument's last digit in µm.
    pub quantum_um: f64,
    /// The machine file's prediction of each row of `runs`, one after the other, in µm.
    pub believed_um: Vec<f64>,
    /// The sum of the effects on each row of `runs`, in µm, without noise.
    pub effect_um: Vec<f64>,
    /// The machine file's prediction of each row of `holdout`, in µm.
    pub holdout_believed_um: Vec<f64>,
    /// The sum of the effects on each row of `holdout`, in µm, without noise.
    pub holdout_effect_um: Vec<f64>,
    /// The measured values less the two above, for each row of `holdout`, in µm; NaN where nothing was
    /// measured. A perfect diagnosis leaves this.
    pub holdout_noise_um: Vec<f64>,
}

/// One hidden effect.
#[derive(Clone, Debug, PartialEq)]
pub struct HiddenEffect {
    /// The hidden cause.
    pub cause: HiddenCause,
    /// The column that it depends on, where there is a choice.
    pub column: Option<String>,
    /// The parameters by the names of the table of causes, in the units that the names say; next to
    /// them what else was drawn (`reference_c`, `phase_rad`).
    pub parameters: Vec<(&'static str, f64)>,
    /// Parameters that are lists, likewise.
    pub tables: Vec<(&'static str, Vec<f64>)>,
    /// RMS over the training rows in µm, by the convention of the ratio.
    pub rms_um: f64,
    /// Causes that explain these data as well as the true one.
    pub rivals: Vec<HiddenCause>,
    /// Its effect on each row of the training runs, in µm.
    pub um: Vec<f64>,
    /// Its effect on each row of the hold-out, in µm.
    pub holdout_um: Vec<f64>,
}

impl HiddenEffect {
    /// Returns the parameter `name`, if the effect has it.
    #[must_use]
    pub fn parameter(&self, name: &str) -> Option<f64> {
        self.parameters.iter().find(|(there, _)| *there == name).map(|&(_, value)| value)
    }
}

impl GroundTruth {
    /// Returns the largest reduction that a diagnosis can reach on the hold-out run: 1 − RMS(noise) over
    /// RMS(effect + noise).
    #[must_use]
    pub fn max_holdout_rms_reduction(&self) -> f64 {
        let (mut noise, mut all) = (0.0, 0.0);
        for (effect, left) in self.holdout_effect_um.iter().zip(&self.holdout_noise_um) {
            if !left.is_nan() {
                noise += left * left;
                all += (effect + left) * (effect + left);
            }
        }
        1.0 - (noise / all).sqrt()
    }
}

/// Returns a challenge with `cause` in it, `ratio` times as large as the noise (RMS). Where `cause` is only
/// noise, `ratio` counts for nothing. Above 0; 0.5 is hard, 5 is plain.
#[must_use]
pub fn draw_test_case(cause: HiddenCause, ratio: f64, seed: u64) -> TestCase {
    let mut stream = RandomStream::new(seed, cause.name());
    let base = stream.choose(cause.base_models());
    test_case::build_test_case(base, &[cause], ratio, seed, stream)
}

/// Returns a challenge with two causes in it, each `ratio` times as large as the noise. `None` if there is
/// no machine on which both can be distinguished.
#[must_use]
pub fn draw_test_case_with_cause_pair(
    first: HiddenCause,
    second: HiddenCause,
    ratio: f64,
    seed: u64,
) -> Option<TestCase> {
    let shared: Vec<BaseModel> = first
        .base_models()
        .iter()
        .copied()
        .filter(|base| second.base_models().contains(base))
        .collect();
    if shared.is_empty() || first == second {
        return None;
    }
    let mut stream = RandomStream::new(seed, &format!("{} {}", first.name(), second.name()));
    let base = stream.choose(&shared);
    Some(test_case::build_test_case(base, &[first, second], ratio, seed, stream))
}
