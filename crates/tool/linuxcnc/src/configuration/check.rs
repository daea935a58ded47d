//! Finds the obstacles to offsets in a configuration, and says what they will cost or reach.

use trueup_machine::InputFileError;

use super::{
    OffsetEntryPoint,
    finding::{ConfigurationFinding, OffsetRequirements, Severity},
    hal_files::HalFiles,
    ini_file::IniFile,
    input_signals,
    installed_setup::find_manual_setup,
    joints::{
        DEFAULT_HEADROOM_RATIO, Headroom, Joint, LOW_HEADROOM_WARNING_RATIO, REFERENCE_REVERSAL_UM,
        compute_offset_av_ratio, read_joints, rest_to_rest_time_s,
    },
    wiring,
};
use crate::ini_settings::IniSettings;

/// Servo periods that are supported, in ns.
const SUPPORTED_SERVO_PERIOD_RANGE_NS: std::ops::RangeInclusive<f64> = 0.5e6..=4e6;
/// Without a board a servo period may differ by this from one that is supported, in ns.
const SERVO_PERIOD_TOLERANCE_NS: f64 = 1e3;
/// `OFFSET_AV_RATIO` may be so large.
const MAX_OFFSET_AV_RATIO: f64 = 0.9;
const AXIS_NAMES: [&str; 3] = ["X", "Y", "Z"];
const PERCENT_PER_UNIT: f64 = 100.0;
const MS_PER_S: f64 = 1e3;
const UM_PER_MM: f64 = 1e3;

/// Result of a check.
#[derive(Clone, Debug, Default)]
pub struct CheckReport {
    /// Errors and warnings in the order of the checks.
    pub findings: Vec<ConfigurationFinding>,
    /// Statements about what the offsets will do, a line each.
    pub facts: Vec<String>,
    /// The lines to be added by hand, where setup cannot change the configuration.
    pub by_hand: Option<String>,
}

impl CheckReport {
    /// Returns true if nothing stands in the way.
    #[must_use]
    pub fn is_usable(&self) -> bool {
        self.findings.iter().all(|finding| finding.severity != Severity::Error)
    }
}

/// Checks a configuration.
#[must_use]
pub fn check(ini: &IniFile, hal: &HalFiles, demand: &OffsetRequirements) -> CheckReport {
    let mut report = CheckReport::default();
    for section in ["HAL", "TRUEUP", "KINS", "TRAJ", "EMCMOT"] {
        check_duplicate_section(ini, section, &mut report);
    }
    check_hal_files(ini, hal, &mut report);
    let is_closed = !report.is_usable();
    let Some(base) = check_base_settings(ini, &mut report) else { return report };
    let joints = match read_joints(ini) {
        Ok(joints) => joints,
        Err(error) => {
            report.findings.push(error.into());
            return report;
        }
    };
    if is_closed {
        report.by_hand = Some(wiring::generate_manual_hal_lines(ini, hal, &joints, demand));
    }
    report.facts.push(format!(
        "offsets enter {}, up to {} um/s; servo period {} ms",
        match demand.entry {
            OffsetEntryPoint::Eoffset => "as external offsets of the axes",
            OffsetEntryPoint::Joint => "between the joints and their drives",
        },
        demand.slew_um_per_s,
        base.cycle_s * MS_PER_S
    ));
    for joint in &joints {
        for section in [joint.section_name(), format!("AXIS_{}", AXIS_NAMES[joint.axis])] {
            check_duplicate_section(ini, &section, &mut report);
        }
        check_double_compensation(ini, joint, demand, &mut report);
    }
    match demand.entry {
        OffsetEntryPoint::Joint => {
            joints.iter().for_each(|joint| check_joint_headroom(joint, &base, demand, &mut report))
        }
        OffsetEntryPoint::Eoffset => {
            check_external_offsets(ini, &joints, &base, demand, &mut report)
        }
    }
    check_soft_limits(ini, &joints, &base, demand, &mut report);
    if let Some(no_board) = &demand.no_board {
        check_servo_period(ini, &base, &mut report);
        if no_board.has_heat && !hal.has_signal("trueup-confirm") {
            report.facts.push(
                "the machine file has models by heat. At the first start, and without the \
                 stored state of the last one, offsets wait. They come when the thermometers \
                 agree or you confirm that the machine is cold. To confirm, use the signal \
                 trueup-confirm, or halcmd setp trueup.0.confirm 1, then 0"
                    .into(),
            );
        }
    }
    report.findings.extend(input_signals::find_missing_inputs(demand, ini, hal));
    // What is connected by hand occupies the pins that setup would take.
    if report.is_usable() && find_manual_setup(ini, hal).is_none() {
        report.findings.extend(
            wiring::generate_hal_files(ini, hal, &joints, demand).err().unwrap_or_default(),
        );
    }
    report
}

/// LinuxCNC reads the first section of a name alone: lines of a second one have no effect.
fn check_duplicate_section(ini: &IniFile, section: &str, report: &mut CheckReport) {
    if let Some(place) = ini.find_duplicate_section(section) {
        report.findings.push(ConfigurationFinding::warning(
            place,
            format!("a second [{section}]: LinuxCNC reads the first one alone"),
            "move its lines into the first one",
        ));
    }
}

/// HAL files that cannot be followed.
fn check_hal_files(ini: &IniFile, hal: &HalFiles, report: &mut CheckReport) {
    let by_hand = "setup cannot change it; add the lines by hand that are printed with this check";
    if let Some(value) = ini.value("HAL", "TWOPASS") {
        let what =
            "[HAL]TWOPASS: LinuxCNC collects loadrt lines of all files before it runs the rest";
        report.findings.push(ConfigurationFinding::error(value.place, what, by_hand));
    }
    for value in &hal.tcl {
        let what = format!("HALFILE = {}: a Tcl file may connect anything", value.text);
        report.findings.push(ConfigurationFinding::error(value.place.clone(), what, by_hand));
    }
}

/// Units and servo period.
fn check_base_settings(ini: &IniFile, report: &mut CheckReport) -> Option<IniSettings> {
    let base = match IniSettings::parse(&ini.to_text()) {
        Ok(base) => base,
        Err(error) => {
            let place = ini.line_location(error.place.0, error.place.1);
            report.findings.push(ConfigurationFinding::error(place, error.rule, ""));
            return None;
        }
    };
    let period_ns = base.cycle_s * 1e9;
    // A billionth of rounding.
    if !SUPPORTED_SERVO_PERIOD_RANGE_NS.contains(&period_ns.round()) {
        let place = ini.value("EMCMOT", "SERVO_PERIOD").map(|value| value.place);
        report.findings.push(ConfigurationFinding::error(
            place.unwrap_or_else(|| ini.section_location("EMCMOT")),
            format!("[EMCMOT]SERVO_PERIOD = {} ns: 0.5 to 4 ms are supported", period_ns.round()),
            "set it between 500000 and 4000000",
        ));
    }
    Some(base)
}

/// The node's tick is a millisecond, and a servo period is half of one or some.
fn check_servo_period(ini: &IniFile, base: &IniSettings, report: &mut CheckReport) {
    let us = (base.cycle_s * 1e6).round();
    if ![500.0, 1_000.0, 2_000.0, 4_000.0].contains(&us) {
        let place = ini.value("EMCMOT", "SERVO_PERIOD").map(|value| value.place);
        report.findings.push(ConfigurationFinding::error(
            place.unwrap_or_else(|| ini.section_location("EMCMOT")),
            format!(
                "[EMCMOT]SERVO_PERIOD = {} ns: without a board it is 0.5, 1, 2 or 4 ms",
                us * 1e3
            ),
            "set it to 500000, 1000000, 2000000 or 4000000",
        ));
    }
    let thread = ini.number("EMCMOT", "BASE_PERIOD").ok().flatten();
    let Some((thread_ns, place)) = thread.filter(|(ns, _)| *ns > 0.0) else { return };
    let period_ns = base.cycle_s * 1e9;
    let made_ns = (period_ns / thread_ns).round().max(1.0) * thread_ns;
    if (made_ns - period_ns).abs() > SERVO_PERIOD_TOLERANCE_NS {
        report.findings.push(ConfigurationFinding::warning(
            place,
            format!(
                "[EMCMOT]BASE_PERIOD = {thread_ns} ns: with a base thread LinuxCNC makes the \
                 servo period a multiple of it, {made_ns} ns. Without a board that is refused, \
                 and the feed is held"
            ),
            "set it to a divisor of SERVO_PERIOD, such as 25000",
        ));
    }
}

/// LinuxCNC's own compensation of the screw, together with ours.
fn check_double_compensation(
    ini: &IniFile,
    joint: &Joint,
    demand: &OffsetRequirements,
    report: &mut CheckReport,
) {
    let (section, axis) = (joint.section_name(), AXIS_NAMES[joint.axis]);
    let ours = demand.corrects_screw.map(|corrects| corrects[joint.axis]);
    let comp_file = ini.value(&section, "COMP_FILE").filter(|value| !value.text.is_empty());
    let backlash = match ini.number(&section, "BACKLASH") {
        Ok(number) => number.filter(|(width, _)| *width != 0.0),
        Err(error) => return report.findings.push(error.into()),
    };
    let found = [
        comp_file.map(|value| (value.place, format!("[{section}]COMP_FILE"), "take the line out")),
        backlash.map(|backlash| {
            (backlash.1, format!("[{section}]BACKLASH = {}", backlash.0), "set it to 0")
        }),
    ];
    for (place, what, mend) in found.into_iter().flatten() {
        report.findings.push(match ours {
            Some(true) => ConfigurationFinding::error(
                place,
                format!("{what}: LinuxCNC and the machine file would both correct {axis}"),
                format!("{mend}, or take pitch and backlash of {axis} out of the machine file"),
            ),
            None => ConfigurationFinding::error(
                place,
                format!("{what}: without a machine file it is not known whether {axis} would be corrected twice"),
                format!("{mend}, or give --machine with a file that corrects neither pitch nor backlash of {axis}"),
            ),
            Some(false) => ConfigurationFinding::warning(
                place,
                format!("{what}: LinuxCNC's own compensation may take speed and acceleration to 150 % of the limits"),
                format!("let the machine file correct {axis}, and {mend}"),
            ),
        });
    }
}

/// Headroom of a joint.
fn check_joint_headroom(
    joint: &Joint,
    base: &IniSettings,
    demand: &OffsetRequirements,
    report: &mut CheckReport,
) {
    let section = joint.section_name();
    let acceleration = &joint.acceleration;
    let share = acceleration.relative_headroom() * PERCENT_PER_UNIT;
    let slew_mm_per_s = demand.slew_um_per_s / UM_PER_MM;
    let mm_per_s = joint.max_offset_rate_mm_per_s(slew_mm_per_s, base.mm_per_unit);
    let time_s = rest_to_rest_time_s(
        REFERENCE_REVERSAL_UM / UM_PER_MM,
        mm_per_s,
        acceleration.available_headroom() * base.mm_per_unit,
    );
    let line = |key: &str, headroom: &Headroom| {
        format!(
            "[{section}]{key} = {}",
            round_to_millionth(headroom.planner * (1.0 + DEFAULT_HEADROOM_RATIO))
        )
    };
    let mend = format!(
        "if the drive has more, state it: {}; if not, lower MAX_ACCELERATION of joint and axis",
        line("STEPGEN_MAXACCEL", acceleration)
    );
    if acceleration.stated.is_some() && acceleration.available_headroom() <= 0.0 {
        let what = format!(
            "[{section}]STEPGEN_MAXACCEL leaves nothing above MAX_ACCELERATION: an offset cannot move"
        );
        report.findings.push(ConfigurationFinding::error(joint.place.clone(), what, mend));
        return;
    }
    if joint.velocity.stated.is_some() && joint.velocity.available_headroom() <= 0.0 {
        let what = format!(
            "[{section}]STEPGEN_MAXVEL leaves nothing above MAX_VELOCITY: an offset cannot move"
        );
        let mend =
            format!("if the drive has more, state it: {}", line("STEPGEN_MAXVEL", &joint.velocity));
        report.findings.push(ConfigurationFinding::error(joint.place.clone(), what, mend));
        return;
    }
    if share < LOW_HEADROOM_WARNING_RATIO * PERCENT_PER_UNIT {
        let what = format!(
            "[{section}]: the drive has {share:.1} % of acceleration above the planner's: a reversal of {REFERENCE_REVERSAL_UM} um takes {:.1} ms",
            time_s * MS_PER_S
        );
        report.findings.push(ConfigurationFinding::warning(joint.place.clone(), what, mend));
    }
    if mm_per_s < slew_mm_per_s {
        let what = format!(
            "[{section}]: the drive has {:.1} um/s of speed above MAX_VELOCITY, and offsets may change by {} um/s",
            mm_per_s * UM_PER_MM,
            demand.slew_um_per_s
        );
        let mend = format!(
            "the smaller one holds; if the drive has more, state it: {}",
            line("STEPGEN_MAXVEL", &joint.velocity)
        );
        report.findings.push(ConfigurationFinding::warning(joint.place.clone(), what, mend));
    }
    let assumed = match acceleration.stated {
        Some(_) => String::new(),
        None => format!(" (assumed: state it by {})", line("STEPGEN_MAXACCEL", acceleration)),
    };
    report.facts.push(format!(
        "joint {} ({}): headroom {share:.0} % of acceleration{assumed}; a reversal of {REFERENCE_REVERSAL_UM} um takes {:.1} ms",
        joint.number,
        AXIS_NAMES[joint.axis],
        time_s * MS_PER_S
    ));
}

/// Cost and speed of external offsets.
fn check_external_offsets(
    ini: &IniFile,
    joints: &[Joint],
    base: &IniSettings,
    demand: &OffsetRequirements,
    report: &mut CheckReport,
) {
    for (axis, name) in AXIS_NAMES.iter().enumerate() {
        if joints.iter().all(|joint| joint.axis != axis) {
            continue;
        }
        let section = format!("AXIS_{name}");
        let motion = &base.axes[axis];
        let stated = ini.value(&section, "OFFSET_AV_RATIO");
        let place = stated
            .as_ref()
            .map_or_else(|| ini.section_location(&section), |stated| stated.place.clone());
        let Some(proper) = compute_offset_av_ratio(motion.velocity_mm_per_s, demand.slew_um_per_s)
        else {
            let what = format!(
                "[{section}]MAX_VELOCITY is missing: an external offset gets a share of it"
            );
            report.findings.push(ConfigurationFinding::error(place, what, "state it"));
            continue;
        };
        if ini.find_section_header(&section).is_none() {
            let what = format!("[{section}] is missing: OFFSET_AV_RATIO belongs there");
            report.findings.push(ConfigurationFinding::error(
                place,
                what,
                format!("add [{section}] with MAX_VELOCITY"),
            ));
            continue;
        }
        let ratio = if stated.is_some() { motion.ratio } else { proper };
        if !(0.0..=MAX_OFFSET_AV_RATIO).contains(&ratio) || ratio == 0.0 {
            let what =
                format!("[{section}]OFFSET_AV_RATIO = {ratio}: LinuxCNC moves no offset of {name}");
            report.findings.push(ConfigurationFinding::error(
                place,
                what,
                format!("above 0 and at most {MAX_OFFSET_AV_RATIO}; {proper:.6} would do"),
            ));
            continue;
        }
        let velocity = motion.velocity_mm_per_s.unwrap_or_default() * ratio;
        let acceleration = motion.acceleration_mm_per_s2.unwrap_or(base.mm_per_unit) * ratio;
        if stated.is_some() && velocity * UM_PER_MM < demand.slew_um_per_s * 0.999 {
            let what = format!(
                "[{section}]OFFSET_AV_RATIO lets offsets change by {:.1} um/s, and the slew limit is {} um/s",
                velocity * UM_PER_MM,
                demand.slew_um_per_s
            );
            report.findings.push(ConfigurationFinding::warning(
                place,
                what,
                format!("{proper:.6} would do"),
            ));
        }
        let slew = velocity.min(demand.slew_um_per_s / UM_PER_MM);
        report.facts.push(format!(
            "axis {name}: OFFSET_AV_RATIO = {ratio:.6}{}: programs lose {:.3} % of speed and acceleration; a reversal of {REFERENCE_REVERSAL_UM} um takes {:.0} ms",
            if stated.is_some() { "" } else { " (setup adds it)" },
            ratio * PERCENT_PER_UNIT,
            rest_to_rest_time_s(REFERENCE_REVERSAL_UM / UM_PER_MM, slew, acceleration) * MS_PER_S
        ));
    }
}

/// Returns where the largest offsets lead beyond the joints' limits, as a component at the joints says at its start.
///
/// # Errors
/// The configuration cannot be followed.
pub fn check_joint_limits(
    ini: &IniFile,
    demand: &OffsetRequirements,
) -> Result<Vec<ConfigurationFinding>, InputFileError> {
    let (mut report, joints) = (CheckReport::default(), read_joints(ini)?);
    if let Some(base) = check_base_settings(ini, &mut report) {
        check_soft_limits(ini, &joints, &base, demand, &mut report);
    }
    Ok(report.findings)
}

/// Room between the ranges of programs and the joints' limits.
fn check_soft_limits(
    ini: &IniFile,
    joints: &[Joint],
    base: &IniSettings,
    demand: &OffsetRequirements,
    report: &mut CheckReport,
) {
    for joint in joints {
        let (axis, max_um) = (AXIS_NAMES[joint.axis], demand.max_um[joint.axis]);
        let section = format!("AXIS_{axis}");
        let max = max_um / UM_PER_MM / base.mm_per_unit;
        let limits = ["MIN_LIMIT", "MAX_LIMIT"].map(|key| ini.number(&section, key));
        let [low, high] = match limits {
            [Ok(low), Ok(high)] => [low, high],
            [Err(error), _] | [_, Err(error)] => {
                report.findings.push(error.into());
                continue;
            }
        };
        if let (Some(low), Some(high)) = (&low, &high)
            && high.0 - low.0 <= 2.0 * max
        {
            let what = format!(
                "[{section}]: {} to {} leaves no room for offsets of {max_um} um",
                low.0, high.0
            );
            report.findings.push(ConfigurationFinding::error(
                low.1.clone(),
                what,
                "make limits.max_um of the machine file smaller",
            ));
            continue;
        }
        for (sign, of_axis, of_joint, key) in
            [(-1.0, &low, joint.limits[0], "MIN_LIMIT"), (1.0, &high, joint.limits[1], "MAX_LIMIT")]
        {
            let (Some((of_axis, place)), Some(of_joint)) = (of_axis, of_joint) else { continue };
            let reaches = of_axis + sign * max;
            // A billionth of rounding.
            if (reaches - of_joint) * sign > 1e-9 {
                let what = format!(
                    "[{section}]{key} = {of_axis} and an offset of {max_um} um are {}, beyond [{}]{key} = {of_joint}: \
                     close to it the offset stands back",
                    round_to_millionth(reaches),
                    joint.section_name()
                );
                let mend = format!(
                    "leave room for it: [{section}]{key} = {}, or [{}]{key} = {} if the machine can go there",
                    round_to_millionth(of_joint - sign * max),
                    joint.section_name(),
                    round_to_millionth(reaches)
                );
                report.findings.push(ConfigurationFinding::warning(place.clone(), what, mend));
            }
        }
    }
}

/// Rounds to a millionth, which is arithmetic.
fn round_to_millionth(value: f64) -> f64 {
    (value * 1e6).round() / 1e6
}
