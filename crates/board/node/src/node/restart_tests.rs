//! Tests of the state that a restart keeps, and of time that samples do not count.

use super::*;
use crate::node::sensor_only_calibration;
use trueup_core::{
    calibration::{Calibration, ElongationSource, SpindleWarmupModel},
    cnc::SpindleState,
    design_parameters::CODES_PER_TICK,
    lag::SmoothingFactor,
    units::{AdcCode, Nanometres, Rpm},
    warmup::WarmupModel,
};

/// Returns a spindle without a sensor that grows by 80 µm, with a time constant of 20 s.
fn warmup_calibration() -> Calibration<'static> {
    let mut calibration = sensor_only_calibration();
    calibration.limits.slew_nm_per_s = 10_000;
    calibration.spindle.chain = [Some(ElongationSource::Warmup), None, None];
    calibration.spindle.warmup = Some(SpindleWarmupModel {
        law: WarmupModel {
            lag_ms: 0,
            max: Nanometres(80_000).to_fine(),
            // 1 − e^(−0.1/20) in Q32.
            smoothing_heating: SmoothingFactor(21_421_336),
            smoothing_cooling: SmoothingFactor(21_421_336),
            full: 1 << WarmupModel::FULL_FRACTION_BITS,
        },
        power: Default::default(),
    });
    calibration
}

/// A node with the CNC that engages it, after the engage sequence.
struct NodeWithCnc {
    node: Node<'static>,
    counter: u8,
}

impl NodeWithCnc {
    fn with_calibration(calibration: Calibration<'static>) -> Self {
        Self { node: Node::new(calibration.into()), counter: 0 }
    }

    fn send_control(&mut self, control: Control) {
        for frame in [
            frames::encode_control(control, self.counter),
            frames::encode_spindle(SpindleState { speed: Rpm(12_000), load_n: 0 }, self.counter),
        ] {
            self.node.receive(Interface::Can, &frame).expect("in order");
        }
        self.counter = self.counter.wrapping_add(1);
    }

    /// Released for 60 ms, then engaged.
    fn send_control_for(&mut self, ms: u32, control: Control) -> Output {
        for n in 0..ms {
            if n % 20 == 0 {
                self.send_control(control);
            }
            self.node.tick(1, TickInput::default());
            self.node.next_service_frame();
        }
        *self.node.last_output()
    }
}

fn z_offset_nm(output: &Output) -> i32 {
    output.offset.expect("available")[2].0
}

#[test]
fn a_reset_keeps_the_warm_up_and_the_reference_and_the_offset_comes_back_as_it_was() {
    let mut before = NodeWithCnc::with_calibration(warmup_calibration());
    before.send_control_for(60, Control::REFERENCED);
    before.send_control_for(20_000, Control::ENGAGED);
    let grown = z_offset_nm(before.node.last_output());
    assert!((grown - 50_600).abs() < 500, "63 % of 80 µm: {grown}");
    let retained = before.node.retained_state();

    let mut after = NodeWithCnc::with_calibration(warmup_calibration());
    after.node.resume(Some(&retained), 0);
    assert_eq!(
        after.send_control_for(60, Control::ENGAGED).offset,
        None,
        "engaged by level is not enough"
    );
    after.send_control_for(60, Control::REFERENCED);
    after.send_control_for(8_000, Control::ENGAGED);
    before.send_control_for(8_120, Control::ENGAGED);
    let (without, with) =
        (z_offset_nm(before.node.last_output()), z_offset_nm(after.node.last_output()));
    assert!((without - with).abs() < 1_000, "{without} without the reset, {with} with it");
}

#[test]
fn over_a_power_cut_of_known_length_the_spindle_cools_and_the_reference_stays() {
    let mut before = NodeWithCnc::with_calibration(warmup_calibration());
    before.send_control_for(60, Control::REFERENCED);
    before.send_control_for(20_000, Control::ENGAGED);
    let grown = z_offset_nm(before.node.last_output());
    let retained = before.node.retained_state();
    let mut after = NodeWithCnc::with_calibration(warmup_calibration());
    after.node.resume(Some(&retained), 20);
    // The spindle stands: what is left after 20 s without power, and 8 s with.
    let standing = |life: &mut NodeWithCnc, ms: u32| {
        for n in 0..ms {
            if n % 20 == 0 {
                let control = if n < 60 { Control::REFERENCED } else { Control::ENGAGED };
                let spindle = SpindleState { speed: Rpm(0), load_n: 0 };
                for frame in [
                    frames::encode_control(control, life.counter),
                    frames::encode_spindle(spindle, life.counter),
                ] {
                    life.node.receive(Interface::Can, &frame).expect("in order");
                }
                life.counter = life.counter.wrapping_add(1);
            }
            life.node.tick(1, TickInput::default());
            life.node.next_service_frame();
        }
        *life.node.last_output()
    };
    let output = standing(&mut after, 8_000);
    assert_eq!(
        (output.quality, after.node.faults(&output).state_bits().0),
        (OffsetQuality::Live, 0)
    );
    let expected = f64::from(grown) * (-28.0_f64 / 20.0).exp();
    assert!(
        (f64::from(z_offset_nm(&output)) - expected).abs() < 200.0,
        "{output:?} for {expected}"
    );
}

#[test]
fn after_a_power_cut_the_heat_is_not_known_and_confirm_says_that_it_is_cold() {
    let mut life = NodeWithCnc::with_calibration(warmup_calibration());
    life.node.resume(None, 0);
    life.send_control_for(60, Control::REFERENCED);
    let output = life.send_control_for(1_000, Control::ENGAGED);
    assert_eq!((output.quality, output.offset), (OffsetQuality::Fault, None));
    let bits = life.node.faults(&output).state_bits();
    assert_eq!(bits, trueup_link::status::StateBits::HEAT_UNKNOWN);
    life.send_control_for(60, Control { confirm: true, ..Control::ENGAGED });
    let output = life.send_control_for(1_000, Control::ENGAGED);
    assert_eq!(output.quality, OffsetQuality::Live);
    assert_eq!(life.node.faults(&output).state_bits().0, 0);
}

#[test]
fn heat_that_is_not_known_is_waited_for_until_it_no_longer_matters() {
    let mut life = NodeWithCnc::with_calibration(warmup_calibration());
    life.node.resume(None, 0);
    life.send_control_for(60, Control::REFERENCED);
    // 1 mm to 1 µm are ten half-lives of 13.9 s.
    assert_eq!(life.send_control_for(137_000, Control::ENGAGED).offset, None);
    let output = life.send_control_for(3_000, Control::ENGAGED);
    assert_eq!(output.quality, OffsetQuality::Live);
    let bits = life.node.faults(&output).state_bits();
    assert_eq!(bits.0, 0, "and reported no longer");
}

/// One block in ten milliseconds: by the samples time goes ten times slower.
#[test]
fn a_clock_of_its_own_finds_missing_blocks_and_keeps_every_timeout() {
    let alive: [AdcCode; CODES_PER_TICK] =
        core::array::from_fn(|n| AdcCode(700 + u16::from(n == 1)));
    let mut node = Node::new(sensor_only_calibration().into());
    for frame in frames::disengaged_control_frames() {
        node.receive(Interface::Can, &frame).expect("in order");
    }
    node.receive(Interface::Can, &frames::encode_control(Control::ENGAGED, 3)).expect("in order");
    let block = TickInput { codes: Some(&alive), speed: Some(Rpm(12_000)), temperatures: None };
    for _ in 0..30 {
        for _ in 0..10 {
            node.tick(1, block);
        }
        assert_eq!(node.advance_clock(10), None, "as many as there should be");
    }
    assert_eq!(node.last_output().quality, OffsetQuality::Live);
    let before = node.now();
    let mut missing_after_ms = None;
    for ms in (0..3_000).step_by(10) {
        node.tick(1, block);
        if let Some(behind_ms) = node.advance_clock(10) {
            node.tick(behind_ms, TickInput::default());
        }
        let is_missing = node.last_output().flags.contains(OffsetFlags::SAMPLES_MISSING);
        missing_after_ms = missing_after_ms.or(is_missing.then_some(ms));
        assert!(missing_after_ms.is_none() || is_missing, "it flickers at {ms} ms");
    }
    let passed_ms = node.now().duration_ms_since(before);
    assert!((2_980..=3_000).contains(&passed_ms), "{passed_ms} ms by its clock");
    assert!(missing_after_ms.is_some_and(|ms| ms <= 20), "{missing_after_ms:?}");
    assert!(node.last_output().flags.contains(OffsetFlags::CNC_LOST), "silent for 3 s");
    assert_eq!(node.last_output().quality, OffsetQuality::Fault);
}

#[test]
fn a_millisecond_that_is_lost_now_and_then_is_no_missing_block() {
    let mut node = Node::new(sensor_only_calibration().into());
    for turn in 0..10_000 {
        let count = if turn % 150 == 0 { 9 } else { 10 };
        for _ in 0..count {
            node.tick(1, TickInput::default());
        }
        assert_eq!(node.advance_clock(10), None, "at turn {turn}");
    }
}

#[test]
fn a_turn_without_any_block_is_reported_with_its_length_and_one_with_a_block_is_not() {
    for (blocks, missing_ms) in [(0, Some(10)), (1, None), (10, None)] {
        let mut node = Node::new(sensor_only_calibration().into());
        for _ in 0..blocks {
            node.tick(1, TickInput::default());
        }
        assert_eq!(node.advance_clock(10), missing_ms, "{blocks} blocks in 10 ms");
    }
}
