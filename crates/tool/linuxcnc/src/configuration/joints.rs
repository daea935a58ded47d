//! Which joint moves which axis, and what is left of its speed and acceleration for an offset at the joint.
//!
//! An offset at the joint is added to what the planner commands. The planner uses `MAX_VELOCITY` and `MAX_ACCELERATION`
//! of the joint to the full, so the offset may use only what the drive has above them: its headroom, which the INI file
//! states as `STEPGEN_MAXVEL` and `STEPGEN_MAXACCEL`. Where one is missing or 0, `DEFAULT_HEADROOM_RATIO` is assumed.

use trueup_machine::{InputFileError, Location};

use super::ini_file::{IniFile, IniValue};
use crate::{
    NANOMETRES_PER_MILLIMETRE,
    joint_offsets::{JointSettings, MAX_JOINTS},
};

/// Headroom of a drive whose INI file states none, as a share of what the planner uses.
pub(crate) const DEFAULT_HEADROOM_RATIO: f64 = 0.2;
/// Below this share of headroom an offset is slow enough for a warning.
pub(crate) const LOW_HEADROOM_WARNING_RATIO: f64 = 0.05;
/// A reversal of this length measures how fast an offset is.
pub(crate) const REFERENCE_REVERSAL_UM: f64 = 6.0;
/// Joints move by this where the INI file states no `MAX_VELOCITY` or `MAX_ACCELERATION`, in machine units.
const DEFAULT_JOINT_MOTION_LIMIT: f64 = 1.0;
const MICROMETRES_PER_MILLIMETRE: f64 = 1e3;
const AXIS_LETTERS: &str = "XYZABCUVW";

/// The headroom of a drive above the planner's use.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Headroom {
    /// Largest value of the planner, in machine units per second (squared).
    pub planner: f64,
    /// Largest value of the drive, if the INI file states one.
    pub stated: Option<f64>,
}

impl Headroom {
    /// Returns the headroom as a share of the planner's value; negative if the drive has less than the planner uses.
    #[must_use]
    pub(crate) fn relative_headroom(&self) -> f64 {
        self.stated.map_or(DEFAULT_HEADROOM_RATIO, |drive| drive / self.planner - 1.0)
    }

    /// Returns what an offset may use, in machine units per second (squared); at least 0.
    #[must_use]
    pub(crate) fn available_headroom(&self) -> f64 {
        (self.relative_headroom() * self.planner).max(0.0)
    }
}

/// A joint that gets an offset.
#[derive(Clone, Debug, PartialEq)]
pub struct Joint {
    /// LinuxCNC's number.
    pub number: usize,
    /// Index of its axis: X, Y, Z.
    pub axis: usize,
    /// Speed.
    pub velocity: Headroom,
    /// Acceleration.
    pub acceleration: Headroom,
    /// `MIN_LIMIT` and `MAX_LIMIT`, in machine units, where stated.
    pub limits: [Option<f64>; 2],
    /// Place of `STEPGEN_MAXACCEL`, else of the section.
    pub place: Location,
}

impl Joint {
    /// Returns the name of the joint's section.
    #[must_use]
    pub(crate) fn section_name(&self) -> String {
        format!("JOINT_{}", self.number)
    }

    /// Returns the fastest change of an offset in mm/s, not above `slew_mm_per_s`.
    #[must_use]
    pub(crate) fn max_offset_rate_mm_per_s(&self, slew_mm_per_s: f64, mm_per_unit: f64) -> f64 {
        slew_mm_per_s.min(self.velocity.available_headroom() * mm_per_unit)
    }
}

/// Returns the time of a jump of an offset from rest to rest, in seconds; infinite where it cannot move.
#[must_use]
pub(crate) fn rest_to_rest_time_s(way_mm: f64, mm_per_s: f64, mm_per_s2: f64) -> f64 {
    if mm_per_s <= 0.0 || mm_per_s2 <= 0.0 {
        return f64::INFINITY;
    }
    if (way_mm * mm_per_s2).sqrt() <= mm_per_s {
        2.0 * (way_mm / mm_per_s2).sqrt()
    } else {
        way_mm / mm_per_s + mm_per_s / mm_per_s2
    }
}

/// Returns the `OFFSET_AV_RATIO` that lets an offset change by the slew limit and no faster.
#[must_use]
pub(crate) fn compute_offset_av_ratio(
    velocity_mm_per_s: Option<f64>,
    slew_um_per_s: f64,
) -> Option<f64> {
    let velocity = velocity_mm_per_s.filter(|velocity| *velocity > 0.0)?;
    let exact = slew_um_per_s / MICROMETRES_PER_MILLIMETRE / velocity;
    // Down, so that LinuxCNC keeps the limit, but not to 0, which moves nothing.
    Some(((exact * 1e6).floor() / 1e6).clamp(1e-6, 0.9))
}

/// Returns the joints of X, Y and Z in the order of their numbers.
///
/// # Errors
/// Kinematics other than `trivkins`, joints that do not fit them, or a value that is not a number.
pub(crate) fn read_joints(ini: &IniFile) -> Result<Vec<Joint>, InputFileError> {
    let letters = read_joint_axis_letters(ini)?;
    let mut joints = Vec::new();
    for (number, letter) in letters.chars().enumerate() {
        let Some(axis) = "XYZ".find(letter) else { continue };
        let section = format!("JOINT_{number}");
        let positive = |key: &str| -> Result<Option<(f64, Location)>, InputFileError> {
            Ok(ini.number(&section, key)?.filter(|(value, _)| *value > 0.0))
        };
        let headroom = |planner: &str, drive: &str| -> Result<Headroom, InputFileError> {
            let planner = positive(planner)?.map_or(DEFAULT_JOINT_MOTION_LIMIT, |number| number.0);
            Ok(Headroom { planner, stated: positive(drive)?.map(|number| number.0) })
        };
        let limit = |key: &str| Ok(ini.number(&section, key)?.map(|number| number.0));
        let stated = ini
            .value(&section, "STEPGEN_MAXACCEL")
            .or_else(|| ini.value(&section, "MAX_ACCELERATION"));
        joints.push(Joint {
            number,
            axis,
            velocity: headroom("MAX_VELOCITY", "STEPGEN_MAXVEL")?,
            acceleration: headroom("MAX_ACCELERATION", "STEPGEN_MAXACCEL")?,
            limits: [limit("MIN_LIMIT")?, limit("MAX_LIMIT")?],
            place: stated.map_or_else(|| ini.section_location(&section), |stated| stated.place),
        });
    }
    if joints.len() > MAX_JOINTS {
        let rule =
            format!("{} joints move X, Y and Z, and `moveoff` has {MAX_JOINTS}", joints.len());
        return Err(InputFileError::new(ini.section_location("KINS"), rule));
    }
    Ok(joints)
}

/// Returns how the component moves the joints, by the channels of `moveoff`.
///
/// # Errors
/// As `read_joints`, and a joint whose drive leaves nothing for an offset.
pub fn build_joint_settings(
    ini: &IniFile,
    mm_per_unit: f64,
    slew_mm_per_s: f64,
) -> Result<[Option<JointSettings>; MAX_JOINTS], InputFileError> {
    let mut all = [None; MAX_JOINTS];
    for (settings, joint) in all.iter_mut().zip(read_joints(ini)?) {
        let nm = |units: f64| units * mm_per_unit * NANOMETRES_PER_MILLIMETRE;
        let mm_per_s = joint.max_offset_rate_mm_per_s(slew_mm_per_s, mm_per_unit);
        let mm_per_s2 = joint.acceleration.available_headroom() * mm_per_unit;
        if mm_per_s <= 0.0 || mm_per_s2 <= 0.0 {
            let rule = format!(
                "joint {}: nothing is left for an offset ({mm_per_s} mm/s, {mm_per_s2} mm/s²)",
                joint.number
            );
            return Err(InputFileError::new(joint.place, rule).with_help(
                "state STEPGEN_MAXVEL and STEPGEN_MAXACCEL above MAX_VELOCITY and MAX_ACCELERATION; `trueup linuxcnc check` has the details",
            ));
        }
        *settings = Some(JointSettings {
            number: joint.number,
            axis: joint.axis,
            limits_nm: [
                joint.limits[0].map_or(f64::NEG_INFINITY, nm),
                joint.limits[1].map_or(f64::INFINITY, nm),
            ],
            mm_per_s,
            mm_per_s2,
        });
    }
    Ok(all)
}

/// Returns the axis letter of each joint.
fn read_joint_axis_letters(ini: &IniFile) -> Result<String, InputFileError> {
    let Some(kinematics) = ini.value("KINS", "KINEMATICS") else {
        return Err(InputFileError::new(ini.section_location("KINS"), "[KINS]KINEMATICS is missing")
            .with_help("an offset needs to know which joint moves which axis: KINEMATICS = trivkins coordinates=XYZ"));
    };
    let mut words = kinematics.without_comment().split_whitespace();
    let module = words.next().unwrap_or_default();
    if module != "trivkins" {
        return Err(InputFileError::new(
            kinematics.place.clone(),
            format!("[KINS]KINEMATICS = {module}: an offset at an axis is an offset at its joint with trivkins alone"),
        )
        .with_help("other kinematics are not supported; only with trivkins each joint belongs to one axis"));
    }
    let coordinates = words.find_map(|word| word.strip_prefix("coordinates="));
    let letters: String = coordinates
        .unwrap_or(AXIS_LETTERS)
        .to_ascii_uppercase()
        .chars()
        .filter(|character| AXIS_LETTERS.contains(*character))
        .collect();
    let joints = ini.number("KINS", "JOINTS")?;
    let Some((joints, place)) = joints else {
        return Err(InputFileError::new(ini.section_location("KINS"), "[KINS]JOINTS is missing")
            .with_help(format!("state the number of joints: JOINTS = {}", letters.len())));
    };
    let too_many = joints > letters.len() as f64 || joints < 1.0;
    let too_few = coordinates.is_some() && joints < letters.len() as f64;
    if too_many || too_few || joints.fract() != 0.0 {
        let rule = format!(
            "[KINS]JOINTS = {joints} does not fit {} coordinates of [KINS]KINEMATICS",
            letters.len()
        );
        return Err(InputFileError::new(place, rule).with_help("both have to be the same"));
    }
    let all = joints as usize;
    let letters: String = letters.chars().take(all).collect();
    if let Some(traj) = ini.value("TRAJ", "COORDINATES") {
        check_traj_coordinates(&letters, &traj)?;
    }
    Ok(letters)
}

/// `[TRAJ]COORDINATES` names no axis without a joint.
fn check_traj_coordinates(letters: &str, traj: &IniValue) -> Result<(), InputFileError> {
    let axes = traj.without_comment().to_ascii_uppercase();
    match axes
        .chars()
        .find(|character| AXIS_LETTERS.contains(*character) && !letters.contains(*character))
    {
        Some(axis) => Err(InputFileError::new(
            traj.place.clone(),
            format!(
                "[TRAJ]COORDINATES = {}: no joint of [KINS]KINEMATICS moves {axis}",
                traj.without_comment()
            ),
        )
        .with_help(format!(
            "with trivkins the joints move {letters}; state coordinates= in [KINS]KINEMATICS"
        ))),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::{super::hal_files::tests::configuration, *};

    fn of(kins: &str, joints: &str) -> Result<Vec<Joint>, InputFileError> {
        let text = format!("[KINS]\n{kins}\n{joints}");
        joints_of(&text)
    }

    fn joints_of(text: &str) -> Result<Vec<Joint>, InputFileError> {
        super::read_joints(&configuration(&[("m.ini", text)]).1)
    }

    fn axes(joints: &[Joint]) -> Vec<(usize, usize)> {
        joints.iter().map(|joint| (joint.number, joint.axis)).collect()
    }

    #[test]
    fn a_joint_belongs_to_its_letter_and_two_to_one_axis_of_a_gantry() {
        let plain = of("KINEMATICS = trivkins\nJOINTS = 3", "").expect("trivial");
        assert_eq!(axes(&plain), [(0, 0), (1, 1), (2, 2)]);
        let gantry = of("KINEMATICS = trivkins coordinates=xyzy kinstype=BOTH\nJOINTS = 4", "")
            .expect("gantry");
        assert_eq!(axes(&gantry), [(0, 0), (1, 1), (2, 2), (3, 1)]);
        let lathe = of("KINEMATICS = trivkins coordinates=XZ\nJOINTS = 2", "").expect("lathe");
        assert_eq!(axes(&lathe), [(0, 0), (1, 2)]);
        let five = of("KINEMATICS = trivkins coordinates=AXCYZ\nJOINTS = 5", "").expect("five");
        assert_eq!(axes(&five), [(1, 0), (3, 1), (4, 2)]);
    }

    #[test]
    fn other_kinematics_and_joints_that_do_not_fit_are_refused() {
        for (kins, phrase) in [
            ("KINEMATICS = xyzac-trt-kins\nJOINTS = 5", "xyzac-trt-kins"),
            ("KINEMATICS = trivkins coordinates=XYZ\nJOINTS = 4", "does not fit 3"),
            ("KINEMATICS = trivkins coordinates=XYZY\nJOINTS = 3", "does not fit 4"),
            ("KINEMATICS = trivkins\nJOINTS = 2.5", "does not fit"),
            ("KINEMATICS = trivkins", "JOINTS is missing"),
            ("JOINTS = 3", "KINEMATICS is missing"),
        ] {
            let error = of(kins, "").expect_err(kins);
            assert!(error.rule.contains(phrase) && error.help.is_some(), "{kins}: {error}");
        }
        let text = "[KINS]\nKINEMATICS = trivkins\nJOINTS = 2\n[TRAJ]\nCOORDINATES = X Z\n";
        assert!(joints_of(text).expect_err("Z has no joint").rule.contains("moves Z"));
    }

    #[test]
    fn headroom_is_what_the_drive_has_above_the_planner() {
        let text = "[JOINT_0]\nMAX_ACCELERATION = 1000\nSTEPGEN_MAXACCEL = 1250\nMAX_VELOCITY = 30\n\
                    [JOINT_1]\nMAX_ACCELERATION = 400\nSTEPGEN_MAXACCEL = 0\nSTEPGEN_MAXVEL = 31\nMAX_VELOCITY = 30\n\
                    [JOINT_2]\nMAX_ACCELERATION = 400\nSTEPGEN_MAXACCEL = 300\n";
        let joints = of("KINEMATICS = trivkins\nJOINTS = 3", text).expect("reads");
        let left: Vec<f64> =
            joints.iter().map(|joint| joint.acceleration.available_headroom()).collect();
        assert_eq!(left, [250.0, 80.0, 0.0]);
        assert!(
            (joints[1].velocity.available_headroom() - 1.0).abs() < 1e-9
                && joints[0].velocity.available_headroom() == 6.0
        );
        assert!(joints[2].acceleration.relative_headroom() < 0.0);
        assert_eq!(joints[1].max_offset_rate_mm_per_s(0.5, 25.4), 0.5);
    }

    #[test]
    fn a_joint_that_can_never_follow_is_refused_with_its_line() {
        for (drive, line) in
            [("STEPGEN_MAXACCEL = 1000", Some(6)), ("STEPGEN_MAXVEL = 30", Some(5)), ("", None)]
        {
            let text = format!(
                "[KINS]\nKINEMATICS = trivkins\nJOINTS = 1\n[JOINT_0]\nMAX_ACCELERATION = 1000\n{drive}\nMAX_VELOCITY = 30\n"
            );
            let settings = build_joint_settings(&configuration(&[("m.ini", &text)]).1, 1.0, 0.5);
            let error = settings.err();
            assert_eq!(error.as_ref().map(|error| error.place.line), line, "{drive}: {error:?}");
        }
    }

    #[test]
    fn a_reversal_takes_two_ramps_or_ramps_and_a_steady_part() {
        // 2·√(0.006/200) s; and 0.1/1.2 + 1.2/200 s.
        assert!((rest_to_rest_time_s(0.006, 1.2, 200.0) - 0.010_954).abs() < 1e-6);
        assert!((rest_to_rest_time_s(0.1, 1.2, 200.0) - (0.1 / 1.2 + 0.006)).abs() < 1e-12);
        assert_eq!(rest_to_rest_time_s(0.006, 0.0, 200.0), f64::INFINITY);
    }
}
