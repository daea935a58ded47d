//! Tool and conditions: followed at the slew limit, awaited, held where they are lost, then by their defaults.

use super::*;
use crate::{
    cnc::MachineConditions,
    term::{CategoryFactor, ConditionLevels, Effect, Target, Term, ToolTable},
};

/// Tool 7 grows by 15 nm at N, every other by half of it; X moves by 6 µm while bit 2 is on, or not known.
static LEVELS: [[u8; 8]; 1] = [[7, 0, 0, 0, 0, 0, 0, 0x20]];

fn machine() -> Calibration<'static> {
    let mut machine = minimal_calibration();
    let tools =
        ToolTable { levels: &LEVELS, other: 1 << 28, shift: 37, times: CategoryFactor::Speed2 };
    let smoothing = SmoothingFactor::NO_LAG;
    let on = 6_000 * 256;
    let clamp = ConditionLevels {
        bit: 2,
        default: true,
        off: 0,
        on,
        shift: 0,
        smoothing,
        times: CategoryFactor::One,
    };
    let term = |target, effect| Some(Term { target, constant: FineNanometres::ZERO, effect });
    machine.terms[0] = term(Target::Elongation, Effect::Tool(tools));
    machine.terms[1] = term(Target::Axis(LinearAxis::X), Effect::Condition(clamp));
    machine.limits.slew_nm_per_s = 20_000;
    machine
}

const N: u16 = 1_000;
const CLAMPED: MachineConditions = MachineConditions { tool: 7, bits: 1 << 2 };

struct Said {
    rig: Rig,
    ms: u32,
}

impl Said {
    fn new() -> Self {
        Self { rig: Rig::new(machine()), ms: 0 }
    }

    /// Engaged, at N r/min, with `Conditions` every 50 ms if the CNC says some; each step is held to the slew limit.
    fn run(&mut self, ms: u32, conditions: Option<MachineConditions>) -> Output {
        for _ in 0..ms {
            let before = self.rig.last.offset;
            if self.ms.is_multiple_of(20) {
                self.rig.control(ENGAGED);
                let spindle = CncMessage::Spindle(SpindleState { speed: Rpm(N), load_n: 0 });
                self.rig.bridge.receive(&mut self.rig.state, spindle);
            }
            if let Some(conditions) = conditions.filter(|_| self.ms.is_multiple_of(50)) {
                self.rig.bridge.receive(&mut self.rig.state, CncMessage::Conditions(conditions));
            }
            self.ms += 1;
            let output = self.rig.tick(None);
            for (now, before) in
                output.offset.into_iter().flatten().zip(before.into_iter().flatten())
            {
                assert!(now.0.abs_diff(before.0) <= 21, "{} ms: {before:?} to {now:?}", self.ms);
            }
        }
        self.rig.last
    }
}

/// −(6 µm) on X where clamped; on Z against the growth along −Z.
fn offset(tool_nm: i32, x_nm: i32) -> Option<[Nanometres; 3]> {
    Some([Nanometres(-x_nm), Nanometres(0), Nanometres(tool_nm)])
}

/// 10⁶ · 2²⁹/2³⁷ units of 1/256 nm.
const TOOL_7_NM: i32 = 15;
const OTHER_NM: i32 = 8;

#[test]
fn a_tool_and_a_condition_are_followed_at_the_slew_limit() {
    let mut sender = Said::new();
    let output = sender.run(1_000, Some(CLAMPED));
    assert_eq!((output.quality, output.offset), (OffsetQuality::Live, offset(TOOL_7_NM, 6_000)));
    sender.run(1, Some(MachineConditions { tool: 8, bits: 0 }));
    let output = sender.run(100, Some(MachineConditions { tool: 8, bits: 0 }));
    assert!(output.flags.contains(OffsetFlags::SLEWING), "300 ms for 6 µm");
    let output = sender.run(1_000, Some(MachineConditions { tool: 8, bits: 0 }));
    assert_eq!((output.quality, output.offset), (OffsetQuality::Live, offset(OTHER_NM, 0)));
    assert!(!sender.rig.bridge.lost_inputs(&sender.rig.state).conditions);
}

#[test]
fn lost_they_are_held_and_then_the_defaults_stand_in_for_them() {
    let mut sender = Said::new();
    let open = MachineConditions { tool: 7, bits: 0 };
    let before = sender.run(2_000, Some(open));
    assert_eq!((before.quality, before.offset), (OffsetQuality::Live, offset(TOOL_7_NM, 0)));
    // The last is 50 ms old: four link timeouts of 500 ms less that.
    assert_eq!(sender.run(1_950, None).quality, OffsetQuality::Live);
    for ms in 1..=2_000 {
        let output = sender.run(1, None);
        assert_eq!(
            (output.quality, output.offset),
            (OffsetQuality::Hold, before.offset),
            "{ms} ms"
        );
        assert!(sender.rig.bridge.lost_inputs(&sender.rig.state).conditions);
    }
    let output = sender.run(1, None);
    assert_eq!(output.quality, OffsetQuality::TemperatureModel, "by the defaults");
    let output = sender.run(1_000, None);
    assert_eq!(
        (output.quality, output.offset),
        (OffsetQuality::TemperatureModel, offset(OTHER_NM, 6_000))
    );
    sender.run(100, Some(open));
    assert_eq!(sender.rig.last.quality, OffsetQuality::Live, "they are back");
    assert_eq!(sender.run(1_000, Some(open)).offset, before.offset);
}

#[test]
fn after_a_start_they_are_awaited_and_a_cnc_that_never_sends_them_gets_the_defaults() {
    let mut sender = Said::new();
    let output = sender.run(2_000, None);
    assert_eq!(output.offset, offset(0, 0), "nothing is followed before they come");
    assert!(!sender.rig.bridge.lost_inputs(&sender.rig.state).conditions, "not yet");
    let output = sender.run(1_000, None);
    assert_eq!(
        (output.quality, output.offset),
        (OffsetQuality::TemperatureModel, offset(OTHER_NM, 6_000))
    );
    assert!(sender.rig.bridge.lost_inputs(&sender.rig.state).conditions);
}

#[test]
fn a_machine_without_such_terms_needs_none() {
    let mut rig = Rig::new(calibration());
    assert_eq!(rig.run_engaged(3_000, 1_050).quality, OffsetQuality::Live);
    assert!(!rig.bridge.lost_inputs(&rig.state).conditions);
}
