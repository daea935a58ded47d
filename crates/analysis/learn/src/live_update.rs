//! The parts of a learned machine file that a bridge can take while it runs on the user's own, and those that need
//! a new calibration, at rest.
//!
//! A bridge takes five numbers while it runs ([`trueup_core::learned_changes`]): a share of the growth and of each
//! axis's expansion, and the zero of the growth. By the sources of the growth, with a' for what was learned:
//!
//! | source | share | zero |
//! |---|---|---|
//! | sensor, K₀ + (V − V₀)·tanβ | tanβ'/tanβ − 1 | K₀' − (1 + share)·K₀ |
//! | temperature, k·(T − T₀) | k'/k − 1 | k'·(T₀ − T₀') |
//! | warm-up, Smax·… | Smax'/Smax − 1 | 0 |
//!
//! An axis has one share: where its constant and its slope have changed by different ones, where a backlash, a
//! table or the amplitude of a term has changed, the bridge cannot have it before the file is loaded.

use trueup_core::learned_changes::{LEARNED_PART_COUNT, LearnedLimits};
use trueup_machine::{
    InputFileError, Machine, compile,
    decompile::calibration_changes::describe_changes,
    machine_file::{ElongationSource, LearnedChangeLimits, LinearAxis},
};

/// Units of a share, and of the zero in µm.
const UNITS_PER_FRACTION: f64 = 1e5;
const ZERO_UNITS_PER_UM: f64 = 1e3;
/// The parts, as a user calls them.
const LEARNED_PART_NAMES: [&str; LEARNED_PART_COUNT] = [
    "growth of the spindle",
    "expansion of X",
    "expansion of Y",
    "expansion of Z",
    "zero of the growth",
];

/// The parts of a learned file that a bridge takes while it runs, and the rest.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LiveUpdate {
    /// Each part, in the bridge's units: 10⁻⁵ of itself, the zero in nm.
    pub amounts: [i16; LEARNED_PART_COUNT],
    /// The parts that it cannot take, a sentence each: these need the new file, at rest.
    pub rest: Vec<String>,
}

impl LiveUpdate {
    /// From the file that the bridge runs on to the one that was learned, within the caps of the first.
    ///
    /// # Errors
    /// One of them is not for a board.
    pub fn from_difference(runs: &Machine, learned: &Machine) -> Result<Self, InputFileError> {
        // What the bridge makes of the first by what it is sent: the rest is where that differs from the second.
        let mut sent = runs.clone();
        let mut live = Self::default();
        let [share, zero_um] = apply_growth_difference(&mut sent, learned);
        live.set_amount_within_limit(0, share * UNITS_PER_FRACTION, runs);
        for (place, axis) in LinearAxis::ALL.into_iter().enumerate() {
            let share = apply_expansion_difference(&mut sent, learned, axis);
            live.set_amount_within_limit(place + 1, share * UNITS_PER_FRACTION, runs);
        }
        live.set_amount_within_limit(LEARNED_PART_COUNT - 1, zero_um * ZERO_UNITS_PER_UM, runs);
        // Caps do not make a correction.
        sent.limits.learned = learned.limits.learned;
        let [sent, learned] = [compile(&sent)?, compile(learned)?];
        let differences = describe_changes(&sent.calibration(), &learned.calibration());
        live.rest.extend(
            differences.into_iter().map(|difference| format!("{difference}: only by the new file")),
        );
        Ok(live)
    }

    /// Requests this many units of a part, as far as its cap permits.
    fn set_amount_within_limit(&mut self, part: usize, units: f64, runs: &Machine) {
        let most = f64::from(to_board_limits(runs.limits.learned).max_change(part));
        let units = units.round();
        let held = units.clamp(-most, most);
        if held != units {
            self.rest.push(format!(
                "{}: {:+.3} was learned, [limits.learned] permits {:.1}: the rest only by the new file",
                LEARNED_PART_NAMES[part],
                units / 1_000.0,
                most / 1_000.0
            ));
        }
        self.amounts[part] = held as i16;
    }
}

/// These amounts in words; `None`: all are 0.
#[must_use]
pub fn describe_amounts(amounts: &[i32; LEARNED_PART_COUNT]) -> Option<String> {
    let parts = LEARNED_PART_NAMES.into_iter().zip(amounts).enumerate();
    let parts = parts.filter(|(_, (_, amount))| **amount != 0).map(|(part, (name, amount))| {
        let unit = if part == LEARNED_PART_COUNT - 1 { "µm" } else { "%" };
        format!("{name} {:+.3} {unit}", f64::from(*amount) / 1_000.0)
    });
    let parts: Vec<String> = parts.collect();
    (!parts.is_empty()).then(|| parts.join(", "))
}

/// As the board has them.
fn to_board_limits(caps: LearnedChangeLimits) -> LearnedLimits {
    let tenths = |cap: f64| (cap * 10.0).round() as u8;
    LearnedLimits {
        growth: tenths(caps.growth_percent),
        axes: tenths(caps.axes_percent),
        zero: tenths(caps.zero_um),
    }
}

/// Returns the share and the zero in µm by which the growth differs. `sent` gets the values of `learned`.
fn apply_growth_difference(sent: &mut Machine, learned: &Machine) -> [f64; 2] {
    let (to, from) = (&mut sent.spindle, &learned.spindle);
    let none = [0.0; 2];
    if to.source != from.source {
        return none;
    }
    match to.source {
        Some(ElongationSource::Sensor) => {
            let (Some(to), Some(from)) = (&mut to.sensor, &from.sensor) else { return none };
            let factor = from.um_per_count / to.um_per_count;
            let zero_um = from.k0_um - factor * to.k0_um;
            (to.um_per_count, to.k0_um) = (from.um_per_count, from.k0_um);
            [factor - 1.0, zero_um]
        }
        Some(ElongationSource::Temperature) => {
            let (Some(to), Some(from)) = (&mut to.temperature, &from.temperature) else {
                return none;
            };
            if to.k_um_per_c == 0.0 {
                return none;
            }
            let factor = from.k_um_per_c / to.k_um_per_c;
            let zero_um = from.k_um_per_c * (to.reference_c - from.reference_c);
            (to.k_um_per_c, to.reference_c) = (from.k_um_per_c, from.reference_c);
            [factor - 1.0, zero_um]
        }
        Some(ElongationSource::Warmup) => {
            let (Some(to), Some(from)) = (&mut to.warmup, &from.warmup) else { return none };
            if to.max_um == 0.0 {
                return none;
            }
            let factor = from.max_um / to.max_um;
            to.max_um = from.max_um;
            [factor - 1.0, 0.0]
        }
        None => none,
    }
}

/// Returns the share by which the expansion of an axis differs. `sent` gets both values, scaled alike.
fn apply_expansion_difference(sent: &mut Machine, learned: &Machine, axis: LinearAxis) -> f64 {
    let from = learned.axes[axis.index()].thermal.as_ref();
    let to = sent.axes[axis.index()].thermal.as_mut();
    let (Some(to), Some(from)) = (to, from) else { return 0.0 };
    let uses = [to.mode.has_constant_term(), to.mode.has_position_term()];
    let was = [to.constant_um_per_c, to.slope_um_per_m_per_c];
    let is = [from.constant_um_per_c, from.slope_um_per_m_per_c];
    let largest = [0, 1].into_iter().filter(|n| uses[*n] && was[*n] != 0.0);
    let Some(by) = largest.max_by(|a, b| was[*a].abs().total_cmp(&was[*b].abs())) else {
        return 0.0;
    };
    let factor = is[by] / was[by];
    // The other one goes along; where it was learned to be elsewhere, the new file says so.
    (to.constant_um_per_c, to.slope_um_per_m_per_c) = (was[0] * factor, was[1] * factor);
    factor - 1.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;
    use trueup_machine::MachineFile;

    const SENSOR: &str = "[machine]\nname = \"m\"\nkind = \"3-axis\"\n[inputs]\nsensor = { volts_full_scale = 10.0, \
        counts_full_scale = 32768, divider = 0.33 }\ntemp_screw_c = { channel = 0, kind = \"pt100\" }\n\
        [spindle]\nsource = \"sensor\"\n[spindle.sensor]\nk0_um = 10.0\nzero_counts = 5048.0\num_per_count = 0.015\n\
        [axis.x]\nfeedback = \"screw\"\n[axis.x.thermal]\nmode = \"both\"\nsensor = \"temp_screw_c\"\nreference_c = 23.0\n\
        constant_um_per_c = 2.0\nslope_um_per_m_per_c = 14.21\norigin_mm = 0.0\nlag_s = 0.0\n\
        [axis.x.backlash]\nwidth_um = 4.0\n\
        [limits]\nlearned = { growth_percent = 5, axes_percent = 10, zero_um = 3 }\n";

    fn of(text: &str) -> Machine {
        MachineFile::parse(text, Path::new("m.toml")).expect("right")
    }

    fn live(changes: &[(&str, &str)]) -> LiveUpdate {
        let text = changes.iter().fold(SENSOR.to_string(), |text, (from, to)| {
            assert!(text.contains(from), "{from}");
            text.replace(from, to)
        });
        LiveUpdate::from_difference(&of(SENSOR), &of(&text)).expect("both are for a board")
    }

    #[test]
    fn a_file_that_says_the_same_asks_for_nothing() {
        let live = live(&[]);
        assert_eq!(
            (describe_amounts(&live.amounts.map(i32::from)), live),
            (None, LiveUpdate::default())
        );
    }

    #[test]
    fn a_gain_an_expansion_and_a_zero_become_shares_of_what_the_bridge_has() {
        // 2 % more for each count; K₀ stays 10 µm, of which the share alone would make 10.2.
        let it = live(&[("0.015", "0.0153")]);
        assert_eq!((it.amounts, it.rest), ([2_000, 0, 0, 0, -200], vec![]));
        let it = live(&[("k0_um = 10.0", "k0_um = 8.5")]);
        assert_eq!((it.amounts, it.rest), ([0, 0, 0, 0, -1_500], vec![]));
        let it = live(&[("= 2.0\n", "= 1.9\n"), ("14.21", "13.4995")]);
        assert_eq!(
            describe_amounts(&it.amounts.map(i32::from)).as_deref(),
            Some("expansion of X -5.000 %")
        );
        assert_eq!((it.amounts, it.rest), ([0, -5_000, 0, 0, 0], vec![]));
    }

    #[test]
    fn what_no_share_can_say_or_no_cap_permits_needs_the_new_file() {
        let it = live(&[("width_um = 4.0", "width_um = 5.5")]);
        assert_eq!(it.amounts, [0; LEARNED_PART_COUNT]);
        assert_eq!(it.rest, ["X: backlash, up to 1.50 µm: only by the new file"]);
        // The slope has changed, the constant has not.
        let it = live(&[("14.21", "14.9205")]);
        assert_eq!(it.amounts, [0, 5_000, 0, 0, 0]);
        assert!(it.rest.len() == 1 && it.rest[0].starts_with("X: "), "{:?}", it.rest);
        let it = live(&[("0.015", "0.0165")]);
        assert_eq!(it.amounts, [5_000, 0, 0, 0, -1_000]);
        assert!(it.rest[0].contains("+10.000 was learned"), "{:?}", it.rest);
    }

    #[test]
    fn caps_that_differ_are_no_difference_and_another_source_is_all_of_it() {
        assert_eq!(live(&[("growth_percent = 5", "growth_percent = 6")]), LiveUpdate::default());
        let it = live(&[
            ("0.015", "0.0153"),
            ("[spindle]\nsource = \"sensor\"", "[spindle]\nsource = \"temperature\""),
            (
                "[axis.x]",
                "[spindle.temperature]\nsensor = \"temp_screw_c\"\nreference_c = 20.0\nk_um_per_c = 2.0\n\
                lag_s = 0.0\n[axis.x]",
            ),
        ]);
        assert_eq!(it.amounts, [0; LEARNED_PART_COUNT]);
        assert!(!it.rest.is_empty());
    }

    #[test]
    fn a_constant_that_its_mode_does_not_use_says_nothing_of_the_share() {
        let base = SENSOR
            .replace("\"both\"", "\"position\"")
            .replace("constant_um_per_c = 2.0", "constant_um_per_c = 20.0");
        let after = base.replace("14.21", "14.9205");
        let it = LiveUpdate::from_difference(&of(&base), &of(&after)).expect("right");
        assert_eq!((it.amounts, it.rest), ([0, 5_000, 0, 0, 0], vec![]));
    }

    #[test]
    fn a_temperature_and_a_warm_up_have_theirs() {
        let base = SENSOR.replace("source = \"sensor\"", "source = \"temperature\"")
            + "[spindle.temperature]\nsensor = \"temp_screw_c\"\nreference_c = 20.0\nk_um_per_c = 2.0\nlag_s = 0.0\n";
        let after =
            base.replace("k_um_per_c = 2.0", "k_um_per_c = 2.06").replace("_c = 20.0", "_c = 20.5");
        let it = LiveUpdate::from_difference(&of(&base), &of(&after)).expect("right");
        assert_eq!((it.amounts, it.rest), ([3_000, 0, 0, 0, -1_030], vec![]));
        let base = SENSOR.replace("source = \"sensor\"", "source = \"warmup\"")
            + "[spindle.warmup]\nlag_s = 60.0\nwarm_s = 5400.0\nmax_um = 80.0\nexponent = 4.0\n";
        let it = LiveUpdate::from_difference(&of(&base), &of(&base.replace("80.0", "78.4")))
            .expect("right");
        assert_eq!((it.amounts, it.rest), ([-2_000, 0, 0, 0, 0], vec![]));
    }
}
