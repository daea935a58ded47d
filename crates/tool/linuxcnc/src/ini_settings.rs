//! The few lines of LinuxCNC's .ini that decide how offsets move.
//!
//! LinuxCNC exports the file's name as `INI_FILE_NAME` to everything it starts. Keys that are read:
//! `[EMCMOT]SERVO_PERIOD`, `[TRAJ]LINEAR_UNITS`, and `MAX_VELOCITY`, `MAX_ACCELERATION`,
//! `OFFSET_AV_RATIO` of `[AXIS_X]`, `[AXIS_Y]`, `[AXIS_Z]`, and `[TRAJ]COORDINATES`: a lathe has no Y. As LinuxCNC does it, the first section of a name
//! alone counts, the first line with a name wins, `#` and `;` begin a comment, and what is not there has LinuxCNC's own default.

use crate::{NANOMETRES_PER_MICROMETRE, NANOMETRES_PER_MILLIMETRE, offset_follower::RateLimits};

/// LinuxCNC's default of `[EMCMOT]SERVO_PERIOD`, in ns.
const DEFAULT_SERVO_PERIOD_NS: f64 = 1e6;
/// A servo cycle of a second is none.
const MAX_SERVO_PERIOD_NS: f64 = 1e9;
/// Millimetres in an inch.
const MM_PER_INCH: f64 = 25.4;
const MICROMETRES_PER_MILLIMETRE: f64 = 1e3;
/// `OFFSET_AV_RATIO` may give this much more speed than the slew limit without a remark.
const MAX_OFFSET_RATE_TO_SLEW_RATIO: f64 = 1.5;

/// How an axis moves, in mm and seconds.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AxisMotionLimits {
    /// `MAX_VELOCITY`, if stated.
    pub velocity_mm_per_s: Option<f64>,
    /// `MAX_ACCELERATION`, if stated.
    pub acceleration_mm_per_s2: Option<f64>,
    /// `OFFSET_AV_RATIO`: the share of both that external offsets get; 0 switches them off.
    pub ratio: f64,
}

impl AxisMotionLimits {
    /// Returns how fast LinuxCNC itself lets an offset of this axis change, µm/s; to a billionth, which is arithmetic.
    fn max_offset_rate_um_per_s(&self) -> Option<f64> {
        let most = self.velocity_mm_per_s? * self.ratio * MICROMETRES_PER_MILLIMETRE;
        Some((most * 1e9).round() / 1e9)
    }
}

/// Content of the file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IniSettings {
    /// The servo cycle in seconds.
    pub cycle_s: f64,
    /// Millimetres in a machine unit: 1 or 25.4.
    pub mm_per_unit: f64,
    /// X, Y and Z.
    pub axes: [AxisMotionLimits; 3],
    /// Which of them the machine has.
    pub has: [bool; 3],
}

/// What LinuxCNC takes where a file states nothing.
impl Default for IniSettings {
    fn default() -> Self {
        let axes = [AxisMotionLimits::default(); 3];
        Self { cycle_s: DEFAULT_SERVO_PERIOD_NS * 1e-9, mm_per_unit: 1.0, axes, has: [true; 3] }
    }
}

impl IniSettings {
    /// Reads the text of a file.
    ///
    /// # Errors
    /// A value of those that count is not a number, a servo cycle that cannot be, or a unit that LinuxCNC
    /// does not know; with its place.
    pub fn parse(text: &str) -> Result<Self, IniError> {
        let found = |section: &str, key: &str| find_value(text, section, key);
        let number = |section: &str, key: &str| -> Result<Option<f64>, IniError> {
            let Some((place, value)) = found(section, key) else { return Ok(None) };
            let number = value.parse::<f64>().ok().filter(|number| number.is_finite());
            let rule = || format!("[{section}]{key} = {value} is not a number");
            number.map(Some).ok_or_else(|| IniError { place, rule: rule() })
        };
        let mm_per_unit = match found("TRAJ", "LINEAR_UNITS") {
            None => 1.0,
            Some((place, value)) => match value.to_ascii_lowercase().as_str() {
                "mm" | "metric" => 1.0,
                "in" | "inch" | "imperial" => MM_PER_INCH,
                _ => {
                    let rule = format!("[TRAJ]LINEAR_UNITS = {value} is neither mm nor inch");
                    return Err(IniError { place, rule });
                }
            },
        };
        let period_ns = number("EMCMOT", "SERVO_PERIOD")?.unwrap_or(DEFAULT_SERVO_PERIOD_NS);
        if let Some((place, value)) = found("EMCMOT", "SERVO_PERIOD")
            && !(period_ns > 0.0 && period_ns <= MAX_SERVO_PERIOD_NS)
        {
            let rule = format!("[EMCMOT]SERVO_PERIOD = {value} is not above 0 and at most 1e9 ns");
            return Err(IniError { place, rule });
        }
        let mut axes = [AxisMotionLimits::default(); 3];
        for (axis, section) in axes.iter_mut().zip(["AXIS_X", "AXIS_Y", "AXIS_Z"]) {
            let length = |key| Ok(number(section, key)?.map(|number| number * mm_per_unit));
            *axis = AxisMotionLimits {
                velocity_mm_per_s: length("MAX_VELOCITY")?,
                acceleration_mm_per_s2: length("MAX_ACCELERATION")?,
                ratio: number(section, "OFFSET_AV_RATIO")?.unwrap_or(0.0),
            };
        }
        let letters = found("TRAJ", "COORDINATES").map(|(_, letters)| letters.to_ascii_uppercase());
        let has = ['X', 'Y', 'Z']
            .map(|axis| letters.as_ref().is_none_or(|letters| letters.contains(axis)));
        Ok(Self { cycle_s: period_ns * 1e-9, mm_per_unit, axes, has })
    }

    /// Returns how fast the offsets of X, Y and Z may change with this slew limit.
    #[must_use]
    pub fn offset_rate_limits(&self, slew_um_per_s: f64) -> [RateLimits; 3] {
        self.axes.map(|axis| RateLimits {
            slew_nm_per_s: slew_um_per_s * NANOMETRES_PER_MICROMETRE,
            cycle_s: self.cycle_s,
            acceleration_nm_per_s2: axis
                .acceleration_mm_per_s2
                .map(|acceleration| acceleration * axis.ratio * NANOMETRES_PER_MILLIMETRE)
                .filter(|&acceleration| acceleration > 0.0)
                .unwrap_or(f64::INFINITY),
            planner_keeps_slew: axis
                .max_offset_rate_um_per_s()
                .is_some_and(|most| most <= slew_um_per_s),
        })
    }

    /// Returns what in the file is not compatible with this slew limit, a sentence each: an axis whose
    /// `OFFSET_AV_RATIO` is missing, too small, or so large that LinuxCNC itself would not keep it.
    #[must_use]
    pub fn find_slew_limit_conflicts(&self, slew_um_per_s: f64) -> Vec<String> {
        let mut remarks = Vec::new();
        for ((axis, name), has) in self.axes.iter().zip(["X", "Y", "Z"]).zip(self.has) {
            if !has {
                continue;
            }
            if axis.ratio == 0.0 {
                remarks.push(format!(
                    "[AXIS_{name}]OFFSET_AV_RATIO is 0 or missing: LinuxCNC will not move this axis"
                ));
                continue;
            }
            let (Some(velocity), Some(max_offset_rate_um_per_s)) =
                (axis.velocity_mm_per_s, axis.max_offset_rate_um_per_s())
            else {
                continue;
            };
            let proper = slew_um_per_s / MICROMETRES_PER_MILLIMETRE / velocity;
            if max_offset_rate_um_per_s < slew_um_per_s {
                remarks.push(format!(
                    "[AXIS_{name}]OFFSET_AV_RATIO lets offsets change by {max_offset_rate_um_per_s:.1} um/s \
                     only, the slew limit is {slew_um_per_s} um/s; {proper:.6} would do"
                ));
            } else if max_offset_rate_um_per_s > MAX_OFFSET_RATE_TO_SLEW_RATIO * slew_um_per_s {
                remarks.push(format!(
                    "[AXIS_{name}]OFFSET_AV_RATIO lets offsets change by {max_offset_rate_um_per_s:.1} um/s; \
                     with {proper:.6} LinuxCNC itself would keep the slew limit of \
                     {slew_um_per_s} um/s"
                ));
            }
        }
        remarks
    }
}

/// Returns the first value with this key in this section, and its line and column.
fn find_value<'a>(text: &'a str, section: &str, key: &str) -> Option<((usize, usize), &'a str)> {
    let (mut here, mut is_over) = ("", false);
    for (index, whole) in text.lines().enumerate() {
        let line = whole.trim();
        if line.starts_with(['#', ';']) {
            continue;
        }
        if let Some(rest) = line.strip_prefix('[') {
            is_over |= here == section;
            here = rest.split(']').next().unwrap_or_default().trim();
        } else if here == section
            && !is_over
            && let Some((name, value)) = line.split_once('=')
            && name.trim() == key
        {
            let column = whole.find('=').map_or(1, |at| whole[..at].chars().count() + 2);
            let blanks = value.len() - value.trim_start().len();
            let value = value.split(['#', ';']).next().unwrap_or_default();
            return Some(((index + 1, column + blanks), value.trim()));
        }
    }
    None
}

/// A value that cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{}:{}: {rule}", .place.0, .place.1)]
pub struct IniError {
    /// Its line and column, from 1.
    pub place: (usize, usize),
    /// The fault.
    pub rule: String,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_counts_is_read_in_mm_and_the_rest_passed_over() {
        let text = "# a machine\n[EMCMOT]\nSERVO_PERIOD = 500000\n[TRAJ]\nLINEAR_UNITS = inch\n\
                    [AXIS_X]\n#OFFSET_AV_RATIO = 0.9\nOFFSET_AV_RATIO = 0.2 # a fifth\n\
                    MAX_VELOCITY=2\nMAX_ACCELERATION = 20\nMAX_VELOCITY = 9\n[AXIS_Y]\n[AXIS_X]\n\
                    OFFSET_AV_RATIO = 0.3\n[AXIS_Y]\nMAX_VELOCITY = 1\n";
        let ini = IniSettings::parse(text).expect("reads");
        assert_eq!((ini.cycle_s, ini.mm_per_unit), (0.0005, 25.4));
        assert_eq!(ini.axes[0].velocity_mm_per_s, Some(50.8));
        assert_eq!(ini.axes[0].acceleration_mm_per_s2, Some(508.0));
        assert_eq!(ini.axes[0].ratio, 0.2);
        assert_eq!(ini.axes[1], AxisMotionLimits::default());
    }

    /// Returns an .ini with this in `[AXIS_X]`, and a second and a third axis that are as they should be.
    fn with_x(x: &str) -> IniSettings {
        let proper = "MAX_VELOCITY = 100\nOFFSET_AV_RATIO = 0.0002\n";
        let text = format!("[AXIS_X]\n{x}\n[AXIS_Y]\n{proper}[AXIS_Z]\n{proper}");
        IniSettings::parse(&text).expect("reads")
    }

    #[test]
    fn an_axis_that_the_slew_limit_does_not_fit_is_remarked_upon() {
        for (x, remark) in [
            // 50 mm/s · 0.0002 = 10 µm/s, and 20 µm/s of 50 mm/s are 0.0004.
            (
                "MAX_VELOCITY = 50\nOFFSET_AV_RATIO = 0.0002",
                "[AXIS_X]OFFSET_AV_RATIO lets offsets change by 10.0 um/s only, the slew limit is \
                 20 um/s; 0.000400 would do",
            ),
            // 200 mm/s · 0.1 = 20 mm/s, and 20 µm/s of 200 mm/s are 0.0001.
            (
                "MAX_VELOCITY = 200\nOFFSET_AV_RATIO = 0.1",
                "[AXIS_X]OFFSET_AV_RATIO lets offsets change by 20000.0 um/s; with 0.000100 \
                 LinuxCNC itself would keep the slew limit of 20 um/s",
            ),
            (
                "MAX_VELOCITY = 50",
                "[AXIS_X]OFFSET_AV_RATIO is 0 or missing: LinuxCNC will not move this axis",
            ),
        ] {
            assert_eq!(with_x(x).find_slew_limit_conflicts(20.0), [remark]);
        }
    }

    #[test]
    fn an_axis_that_a_lathe_has_not_is_passed_over() {
        let fits = "MAX_VELOCITY = 100\nOFFSET_AV_RATIO = 0.0002\n";
        let of = |letters: &str| {
            let text = format!("[TRAJ]\nCOORDINATES = {letters}\n[AXIS_X]\n{fits}[AXIS_Z]\n{fits}");
            IniSettings::parse(&text).expect("reads").find_slew_limit_conflicts(20.0)
        };
        assert!(of("XZ").is_empty() && of("x z").is_empty());
        assert_eq!(of("XYZ").len(), 1);
    }

    #[test]
    fn a_ratio_that_fits_and_a_speed_that_is_not_stated_are_passed_over() {
        // 100 mm/s · 0.00029 = 29 µm/s: less than half as much again.
        for x in ["MAX_VELOCITY = 100\nOFFSET_AV_RATIO = 0.00029", "OFFSET_AV_RATIO = 0.0001"] {
            assert_eq!(with_x(x).find_slew_limit_conflicts(20.0), [""; 0]);
        }
    }

    #[test]
    fn a_pace_has_the_planners_share_of_the_acceleration_where_there_is_one() {
        let x = "MAX_ACCELERATION = 500\nOFFSET_AV_RATIO = 0.25";
        let [x, y, _] = with_x(x).offset_rate_limits(20.0);
        // 500 mm/s² · 0.25 = 125 mm/s².
        let slew = RateLimits {
            slew_nm_per_s: 2e4,
            cycle_s: 1e-3,
            acceleration_nm_per_s2: 1.25e8,
            planner_keeps_slew: false,
        };
        assert_eq!(x, slew);
        let unknown = RateLimits { acceleration_nm_per_s2: f64::INFINITY, ..slew };
        // Y's share of its speed is the slew limit.
        assert_eq!(y, RateLimits { planner_keeps_slew: true, ..unknown });
        // An acceleration without a share moves nothing, and must not divide by 0.
        assert_eq!(with_x("MAX_ACCELERATION = 500").offset_rate_limits(20.0)[0], unknown);
    }

    #[test]
    fn linuxcnc_keeps_the_slew_limit_where_its_share_of_the_speed_is_no_more() {
        for (ratio, keeps) in
            [("0.0025", true), ("0.0024", true), ("0.002501", false), ("0.1", false)]
        {
            let x = format!("MAX_VELOCITY = 200\nOFFSET_AV_RATIO = {ratio}");
            assert_eq!(
                with_x(&x).offset_rate_limits(500.0)[0].planner_keeps_slew,
                keeps,
                "{ratio}"
            );
        }
    }

    #[test]
    fn an_empty_file_says_what_linuxcnc_takes_by_itself() {
        assert_eq!(IniSettings::parse(""), Ok(IniSettings::default()));
        assert_eq!(IniSettings::default().cycle_s, 1e-3);
    }

    #[test]
    fn a_value_that_cannot_be_is_reported_with_its_place() {
        let error =
            IniSettings::parse("[AXIS_Z]\nOFFSET_AV_RATIO = lots\n").expect_err("no number");
        assert_eq!(error.to_string(), "2:19: [AXIS_Z]OFFSET_AV_RATIO = lots is not a number");
        assert!(IniSettings::parse("[TRAJ]\nLINEAR_UNITS = cubits\n").is_err());
        for period in ["0", "-1000000", "1e10"] {
            let error = IniSettings::parse(&format!("[EMCMOT]\nSERVO_PERIOD={period}\n"));
            let rule = format!("2:14: [EMCMOT]SERVO_PERIOD = {period} is not above 0");
            assert!(error.expect_err(period).to_string().starts_with(&rule));
        }
    }
}
