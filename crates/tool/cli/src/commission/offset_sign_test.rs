//! The test of the sign: a calibration under which the tool has grown by 10 µm whatever the machine does, so
//! that the CNC has to lift it by 10 µm; or under which an axis stands 10 µm too far, so that it has to be
//! brought back. Signs are where a part is lost; 10 µm lose none.

use trueup_client::state_text::offset_um;
use trueup_core::cnc::{OffsetQuality, Output};
use trueup_machine::{
    Machine,
    machine_file::{ElongationSource, LinearAxis, MachineKind, PitchErrorTable, Spindle, Warmup},
};

use crate::UserError;

/// The growth that is pretended, in µm.
const SIMULATED_ERROR_UM: f64 = 10.0;
/// The offset is there when it is within this, in µm: ten steps of the wire, a tenth of a dial's division.
const OFFSET_TOLERANCE_UM: f64 = 0.1;
/// Half of the growth: nearer to it than to nothing, and as far the other way.
const SIGN_TEST_TOLERANCE_UM: f64 = SIMULATED_ERROR_UM / 2.0;
/// A slope that turns 10 V into less than 0.1 µm and is still none of 0.
const NEGLIGIBLE_SLOPE_UM_PER_COUNT: f64 = 1e-6;

/// Returns what is to be done at the machine.
pub fn setup_instructions(machine: &Machine, axis: Option<LinearAxis>) -> String {
    match axis.map(axis_letter) {
        None if machine.kind == MachineKind::Lathe => {
            "  disengage; set a gauge between turret and chuck to zero, along Z, against a part that does not turn (nothing may touch a turning part). Start the spindle if it has no sensor; then engage at the CNC"
                .into()
        }
        None => "  set all angles to 0, and a gauge at the spindle's housing, along the tool, \
            to zero, disengaged (nothing may touch what turns). Start the spindle if it has no \
            sensor; then engage at the CNC"
            .into(),
        Some(axis) => format!(
            "  home the machine, let {axis} stand, and set a gauge along {axis} to zero, disengaged; then \
             engage at the CNC"
        ),
    }
}

/// Returns what is asked for then.
pub fn reading_prompt(machine: &Machine, axis: Option<LinearAxis>) -> String {
    match axis.map(axis_letter) {
        None if machine.kind == MachineKind::Lathe => {
            "how far has the turret moved, in µm (+ towards the chuck, - away from it)".into()
        }
        None => "how far has the housing moved, in µm (+ the way the tool points, - the other way)"
            .into(),
        Some(axis) => format!("how far has {axis} moved, in µm (+ in its positive direction)"),
    }
}

/// As it stands on the machine.
fn axis_letter(axis: LinearAxis) -> String {
    axis.name().to_uppercase()
}

/// Along what the error is: the tool, or an axis.
pub fn error_direction(machine: &Machine, axis: Option<LinearAxis>) -> [f64; 3] {
    match axis {
        None => machine.tool_direction,
        Some(axis) => LinearAxis::ALL.map(|other| f64::from(u8::from(other == axis))),
    }
}

/// Returns the machine under that calibration: of an axis, or of the tool.
pub fn sign_test_machine(
    machine: &Machine,
    axis: Option<LinearAxis>,
) -> Result<Machine, UserError> {
    let mut test = machine.clone();
    for (axis, direction) in machine.limits.max_um.into_iter().zip(error_direction(machine, axis)) {
        if (direction * SIMULATED_ERROR_UM).abs() > axis {
            let rule =
                format!("limits.max_um is below the {SIMULATED_ERROR_UM} µm of the sign test");
            return Err(UserError(rule));
        }
    }
    test.terms.clear();
    test.straightness.clear();
    test.squareness.clear();
    (test.volume.angular, test.volume.rotary) = (Vec::new(), Vec::new());
    for axis in &mut test.axes {
        (axis.thermal, axis.pitch, axis.backlash, axis.dual) = (None, None, None, None);
    }
    if let Some(axis) = axis {
        test.spindle = Spindle::default();
        // Ends are held: the error is there wherever the axis stands.
        let forward_um = vec![SIMULATED_ERROR_UM; 2];
        let everywhere =
            PitchErrorTable { start_mm: 0.0, step_mm: 1.0, forward_um, reverse_um: None };
        test.axes[axis.index()].pitch = Some(everywhere);
        return Ok(test);
    }
    test.spindle.temperature = None;
    let has_input = machine.inputs.as_ref().is_some_and(|inputs| inputs.sensor.is_some());
    match test.spindle.sensor.as_mut().filter(|_| has_input) {
        Some(sensor) => {
            sensor.k0_um = SIMULATED_ERROR_UM;
            sensor.um_per_count = NEGLIGIBLE_SLOPE_UM_PER_COUNT;
            sensor.temperature = None;
            (test.spindle.source, test.spindle.warmup) = (Some(ElongationSource::Sensor), None);
        }
        None => {
            test.spindle.sensor = None;
            test.spindle.source = Some(ElongationSource::Warmup);
            // Warm after ten seconds at any speed.
            test.spindle.warmup = Some(Warmup {
                lag_s: 0.0,
                warm_s: 10.0,
                max_um: SIMULATED_ERROR_UM,
                exponent: 4.0,
                cool_s: None,
                rated_rpm: None,
                speed_exponent: 0.0,
            });
        }
    }
    Ok(test)
}

/// The bridge gives what takes the error in this direction away.
pub fn is_offset_correct(output: &Output, direction: [f64; 3]) -> bool {
    let is_live = matches!(output.quality, OffsetQuality::Live | OffsetQuality::WarmUpModel);
    let Some(offset) = offset_um(output).filter(|_| is_live) else { return false };
    let along: f64 = offset.iter().zip(direction).map(|(offset, v)| offset * v).sum();
    (along + SIMULATED_ERROR_UM).abs() <= OFFSET_TOLERANCE_UM
}

/// The verdict on the reading.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SignTestVerdict {
    Right,
    Wrong,
    Nothing,
    TooMuch,
}

/// Of the way in µm, positive where the error is: it must have gone back by as much.
pub fn evaluate_sign_test(moved_um: f64) -> SignTestVerdict {
    match moved_um {
        it if (it + SIMULATED_ERROR_UM).abs() <= SIGN_TEST_TOLERANCE_UM => SignTestVerdict::Right,
        it if (it - SIMULATED_ERROR_UM).abs() <= SIGN_TEST_TOLERANCE_UM => SignTestVerdict::Wrong,
        it if it.abs() < SIGN_TEST_TOLERANCE_UM => SignTestVerdict::Nothing,
        _ => SignTestVerdict::TooMuch,
    }
}

impl SignTestVerdict {
    pub fn is_correct(self) -> bool {
        self == Self::Right
    }

    pub fn message(self) -> &'static str {
        match self {
            Self::Right => "the sign is right",
            Self::Wrong => {
                "WRONG SIGN: the CNC applies the offset the wrong way. Change the sign where it adds the \
                 offset (LinuxCNC: eoffset-scale; 840D: the sign in the PLC program), not in the machine \
                 file, and test again"
            }
            Self::Nothing => {
                "nothing has moved: check that the CNC has offsets enabled on this axis, is referenced and engaged; then test again"
            }
            Self::TooMuch => {
                "10 µm were given, but another distance moved: check the unit (mm, 0.1 µm) and the gauge; then test again"
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;
    use trueup_core::{cnc::OffsetFlags, units::Nanometres};
    use trueup_machine::{MachineFile, compile};

    #[test]
    fn the_tip_must_go_back_by_ten_micrometres() {
        for (moved_um, verdict_of_it) in [
            (-10.0, SignTestVerdict::Right),
            (-8.0, SignTestVerdict::Right),
            (10.0, SignTestVerdict::Wrong),
            (12.0, SignTestVerdict::Wrong),
            (0.4, SignTestVerdict::Nothing),
            (-1.0, SignTestVerdict::Nothing),
            (-100.0, SignTestVerdict::TooMuch),
            (10_000.0, SignTestVerdict::TooMuch),
            (f64::NAN, SignTestVerdict::TooMuch),
        ] {
            assert_eq!(evaluate_sign_test(moved_um), verdict_of_it, "{moved_um}");
        }
    }

    #[test]
    fn what_is_given_lifts_the_tool() {
        let output = |z: i32, quality| Output {
            offset: Some([0, 0, z].map(Nanometres)),
            quality,
            flags: OffsetFlags::NONE,
            age_ms: 1,
        };
        let down = [0.0, 0.0, -1.0];
        assert!(is_offset_correct(&output(10_000, OffsetQuality::Live), down));
        assert!(!is_offset_correct(&output(-10_000, OffsetQuality::Live), down));
        assert!(!is_offset_correct(&output(9_000, OffsetQuality::Live), down), "on its way");
        assert!(!is_offset_correct(&output(10_000, OffsetQuality::Hold), down));
        // An axis that stands too far is brought back.
        assert!(is_offset_correct(&output(-10_000, OffsetQuality::Live), [0.0, 0.0, 1.0]));
        assert!(!is_offset_correct(&output(-10_000, OffsetQuality::Live), [1.0, 0.0, 0.0]));
    }

    #[test]
    fn the_test_compiles_for_machines_with_and_without_a_sensor() {
        let of = |text: &str| MachineFile::parse(text, Path::new("m.toml")).expect("right");
        let mut paper = of(include_str!("../../../../../data/paper_spindle.toml"));
        let gantry = of(include_str!("../../../../../data/gantry.toml"));
        for believed in [&paper, &gantry] {
            let test = sign_test_machine(believed, None).expect("its limits leave room");
            compile(&test).expect("the board can run it");
            assert!(test.has_elongation() && test.straightness.is_empty());
        }
        for axis in LinearAxis::ALL {
            let test = sign_test_machine(&gantry, Some(axis)).expect("its limits leave room");
            compile(&test).expect("the board can run it");
            assert!(!test.has_elongation() && test.axes[axis.index()].pitch.is_some());
        }
        paper.limits.max_um[2] = 9.0;
        assert!(sign_test_machine(&paper, None).is_err(), "it would be clamped");
        assert!(sign_test_machine(&paper, Some(LinearAxis::Z)).is_err(), "it would be clamped");
        assert!(sign_test_machine(&paper, Some(LinearAxis::X)).is_ok());
    }
}
