//! The hub between a bridge and masters that say what the test says.

use super::*;
use trueup_client::pinned_calibration::CalibrationPolicy;
use trueup_core::{cnc::CncMessage, units::Nanometres};
use trueup_link::{
    frames::{encode_offset_xy, encode_offset_z},
    receiver::CncReceiver,
    status::{FrameRejectReason, Status, encode},
};

fn ms(ms: u64) -> Duration {
    Duration::from_millis(ms)
}

/// Returns a hub that engages whatever calibration the bridge runs on.
fn hub() -> Hub {
    Hub::new(PinnedCalibration::new(CalibrationPolicy::Any))
}

fn transmit(hub: &mut Hub, now: u64, offset: Option<i32>) {
    let quality = if offset.is_some() { OffsetQuality::Live } else { OffsetQuality::Fault };
    let offset = offset.map(|nm| [nm, -nm, nm].map(Nanometres));
    let output = Output { offset, quality, age_ms: 2, ..Output::default() };
    let counter = hub.current_input_block().counter.wrapping_add(1) as u8;
    for frame in [encode_offset_xy(&output, counter), encode_offset_z(&output, counter)] {
        hub.receive(ms(now), &AdapterMessage::Frame(frame));
    }
    hub.refresh_input_block(ms(now));
}

fn read(hub: &Hub) -> InputBlock {
    InputBlock::decode(&hub.input_registers()).expect("a block is whole")
}

fn z_nm(input: &InputBlock) -> Option<i32> {
    input.output.offset.map(|[_, _, z]| z.0)
}

#[test]
fn before_anything_was_received_nothing_is_available() {
    let hub = hub();
    assert_eq!((z_nm(&read(&hub)), read(&hub).output.quality), (None, OffsetQuality::Fault));
}

#[test]
fn the_counter_moves_with_each_pair_and_stands_without() {
    let mut hub = hub();
    transmit(&mut hub, 1, Some(1_000));
    let first = read(&hub);
    assert_eq!((z_nm(&first), first.age_ms), (Some(1_000), 2));
    for now in 2..=101 {
        hub.refresh_input_block(ms(now));
        assert_eq!(read(&hub), first, "an old offset gets no new counter");
    }
    transmit(&mut hub, 102, Some(1_010));
    assert_eq!(read(&hub).counter, first.counter.wrapping_add(1));
    assert_eq!(z_nm(&read(&hub)), Some(1_010));
}

#[test]
fn a_silent_bridge_is_reported_by_a_gateway_that_lives() {
    let mut hub = hub();
    transmit(&mut hub, 1, Some(1_000));
    let mut last = read(&hub).counter;
    for now in 102..110 {
        hub.refresh_input_block(ms(now));
        let input = read(&hub);
        assert_eq!((z_nm(&input), input.output.quality), (None, OffsetQuality::Fault));
        assert_eq!(input.counter, last.wrapping_add(1));
        last = input.counter;
    }
    assert_eq!(read(&hub).age_ms, 2 + 108);
}

#[test]
fn half_a_pair_changes_nothing_and_a_damaged_one_is_counted() {
    let mut hub = hub();
    transmit(&mut hub, 1, Some(1_000));
    let before = read(&hub);
    let output = Output { offset: Some([Nanometres(9); 3]), ..Output::default() };
    let counter = hub.current_input_block().counter.wrapping_add(1) as u8;
    hub.receive(ms(2), &AdapterMessage::Frame(encode_offset_xy(&output, counter)));
    let whole = encode_offset_z(&output, counter);
    let mut data = *whole.data();
    data[7] ^= 1;
    hub.receive(ms(2), &AdapterMessage::Frame(Frame::new(whole.id(), &data).expect("eight bytes")));
    hub.refresh_input_block(ms(2));
    assert_eq!(read(&hub), before);
    assert_eq!(hub.counters().crc_errors, 1);
}

#[test]
fn status_is_reported_until_it_is_too_old() {
    let mut hub = hub();
    let items = [
        StatusItem::Temperatures { pair: 0, centi_c: [Some(2_345), None] },
        StatusItem::State(StateBits::RESTARTED),
        StatusItem::Calibration(7),
    ];
    for (counter, item) in (0..).zip(items) {
        let status = Status { last_refused: FrameRejectReason::None, item };
        hub.receive(ms(0), &AdapterMessage::Frame(encode(&status, counter)));
    }
    transmit(&mut hub, 3_400, Some(0));
    let input = read(&hub);
    assert_eq!((input.centi_c[0], input.state, input.calibration), (Some(2_345), 1, 7));
    transmit(&mut hub, 3_401, Some(0));
    let input = read(&hub);
    assert_eq!((input.centi_c[0], input.state, input.calibration), (None, 0, 0));
}

#[test]
fn constant_and_slope_are_reported_while_all_three_are_fresh() {
    let mut hub = hub();
    hub.expect_slopes(ms(0));
    let send = |hub: &mut Hub, at: u64, axes: std::ops::Range<u8>, counter: u8| {
        for axis in axes {
            let item = StatusItem::Slope { axis, constant: Some(-120), slope: -270 };
            let status = Status { last_refused: FrameRejectReason::None, item };
            hub.receive(ms(at), &AdapterMessage::Frame(encode(&status, counter + axis)));
        }
    };
    // Layout 2; K₀ of X in 0.01 µm; its slope in 0.1 µm/m.
    let read = |hub: &Hub| {
        let block = hub.input_registers_with_slopes();
        let k0 = i32::from(block[2].cast_signed()) << 16 | i32::from(block[3]);
        (block[0], k0, block[28].cast_signed())
    };
    const NONE: (u16, i32, i16) = (2, i32::MIN, 0);
    send(&mut hub, 0, 0..2, 0);
    transmit(&mut hub, 0, Some(0));
    assert_eq!(read(&hub), NONE, "Z is missing");
    send(&mut hub, 0, 2..3, 0);
    transmit(&mut hub, 1, Some(0));
    assert_eq!(read(&hub), (2, -1_200, -270));
    assert_eq!(hub.take_messages(), [""; 0]);
    transmit(&mut hub, 4_601, Some(0));
    assert_eq!(read(&hub), NONE, "too old");
    transmit(&mut hub, 9_300, Some(0));
    assert!(hub.take_messages()[0].contains("sends no slopes"));
    transmit(&mut hub, 19_300, Some(0));
    assert_eq!(hub.take_messages(), [""; 0], "reported once");
}

fn engaged() -> CncData {
    CncData { control: Control::ENGAGED, ..CncData::default() }
}

#[test]
fn only_a_new_block_of_the_one_master_becomes_a_frame() {
    let mut hub = hub();
    assert_eq!(hub.accept_block(ms(0), 1, &engaged().encode(5)), Ok(BlockOutcome::Accepted));
    assert_eq!(hub.take_due_frames().len(), 1);
    let bad = {
        let mut block = engaged().encode(6);
        block[1] ^= 1;
        block
    };
    for (block, why) in [
        (engaged().encode(5), BlockRejectReason::Repeated),
        (bad, BlockRejectReason::Damaged),
        (engaged().encode(99), BlockRejectReason::WrongSequence),
    ] {
        assert_eq!(hub.accept_block(ms(40), 1, &block), Ok(BlockOutcome::Rejected(why)));
        assert!(hub.take_due_frames().is_empty() && hub.holding_registers()[0] == 5);
    }
    transmit(&mut hub, 50, Some(0));
    assert_eq!((read(&hub).last_refused, read(&hub).refused), (4, 3));
    assert_eq!(hub.accept_block(ms(60), 1, &engaged().encode(100)), Ok(BlockOutcome::Accepted));
    // Another one: kept out and reported, until the first is silent or gone.
    let other = engaged().encode(7_000);
    assert_eq!(hub.accept_block(ms(70), 2, &other), Err(RegistersBusy));
    transmit(&mut hub, 71, Some(0));
    assert_eq!(read(&hub).state, StateBits::SECOND_MASTER.0);
    assert_eq!(hub.accept_block(ms(560), 2, &other), Err(RegistersBusy));
    assert_eq!(hub.fresh_control(ms(560)), Some(Control::ENGAGED));
    assert_eq!(hub.fresh_control(ms(561)), None);
    assert_eq!(hub.accept_block(ms(561), 2, &other), Ok(BlockOutcome::Accepted));
    assert_eq!(hub.accept_block(ms(570), 1, &engaged().encode(101)), Err(RegistersBusy));
    hub.unregister_master(1);
    assert_eq!(hub.accept_block(ms(571), 1, &engaged().encode(101)), Err(RegistersBusy));
    hub.unregister_master(2);
    assert_eq!(hub.accept_block(ms(572), 1, &engaged().encode(3)), Ok(BlockOutcome::Accepted));
    hub.take_due_frames();
    assert!(hub.take_due_frames().is_empty(), "nothing is repeated by itself");
}

#[test]
fn a_block_that_may_have_waited_in_a_stalled_line_is_not_used() {
    // In step, 5 s of nothing, then all that had waited, then in step again.
    let mut hub = hub();
    hub.register_master(ms(0), 1);
    let times = (20..=1_000).step_by(20).chain([6_000; 100]).chain((6_040..7_000).step_by(20));
    let mut used = Vec::new();
    for (counter, now) in (0..).zip(times) {
        let taken = hub.accept_block(ms(now), 1, &engaged().encode(counter));
        if taken == Ok(BlockOutcome::Accepted) {
            used.push(now);
        }
    }
    hub.refresh_input_block(ms(7_000));
    assert_eq!(used.iter().filter(|now| **now <= 1_000).count(), 50);
    assert!(used.iter().all(|now| *now != 6_000), "nothing of the backlog");
    assert_eq!(used.iter().find(|now| **now > 1_000), Some(&6_040));
    assert_eq!((read(&hub).last_refused, read(&hub).refused), (REJECT_REASON_STALE, 100));
    // What comes long after its connection was made, alike.
    hub.unregister_master(1);
    hub.register_master(ms(8_000), 2);
    assert_eq!(hub.accept_block(ms(9_000), 2, &engaged().encode(0)), Ok(BlockOutcome::MayBeOld));
    assert_eq!(hub.accept_block(ms(9_100), 2, &engaged().encode(1)), Ok(BlockOutcome::Accepted));
}

#[test]
fn a_slow_plc_and_a_fast_one_are_used_at_their_pace() {
    for (period, unused) in [(1_000, 1), (1, 0), (499, 0)] {
        let mut hub = hub();
        hub.register_master(ms(0), 1);
        let of = |counter: u16| ms(u64::from(counter + 1) * period);
        let used = (0..50).filter(|counter| {
            hub.accept_block(of(*counter), 1, &engaged().encode(*counter))
                == Ok(BlockOutcome::Accepted)
        });
        assert_eq!(used.count(), 50 - unused, "{period} ms");
    }
}

/// Lets the bridge report its calibration at this time.
fn runs_on(hub: &mut Hub, now: u64, counter: u8, crc: u32) {
    let status =
        Status { last_refused: FrameRejectReason::None, item: StatusItem::Calibration(crc) };
    hub.receive(ms(now), &AdapterMessage::Frame(encode(&status, counter)));
}

#[test]
fn only_a_bridge_on_the_pinned_calibration_is_engaged() {
    let mut hub = Hub::new(PinnedCalibration::new(CalibrationPolicy::Machine {
        crc: 7,
        path: "m.toml".into(),
    }));
    let mut receiver = CncReceiver::new();
    let mut counter = 0;
    let mut sends = |hub: &mut Hub, now: u64| {
        counter += 1;
        let cnc_data =
            CncData { control: Control { zero: true, ..Control::ENGAGED }, ..CncData::default() };
        assert_eq!(
            hub.accept_block(ms(now), 1, &cnc_data.encode(counter)),
            Ok(BlockOutcome::Accepted)
        );
        let frames = hub.take_due_frames();
        match receiver.accept(frames.first().expect("a Control")) {
            Ok(Some(CncMessage::Control(control))) => (control.engage, control.zero),
            other => panic!("{other:?}"),
        }
    };
    transmit(&mut hub, 0, Some(0));
    assert_eq!(sends(&mut hub, 10), (false, false), "it has not reported what it runs on");
    runs_on(&mut hub, 20, 0, 8);
    transmit(&mut hub, 20, Some(0));
    assert_eq!(sends(&mut hub, 40), (false, false), "another");
    transmit(&mut hub, 41, Some(0));
    assert_eq!(read(&hub).last_refused, REJECT_REASON_CALIBRATION);
    let messages = hub.take_messages();
    assert!(messages.len() == 1 && messages[0].contains("00000008"), "{messages:?}");
    runs_on(&mut hub, 60, 1, 7);
    transmit(&mut hub, 60, Some(0));
    assert_eq!(sends(&mut hub, 70), (true, true), "the pinned one");
    // It restarts, with whatever: not engaged until it has reported on what it runs.
    transmit(&mut hub, 80, None);
    transmit(&mut hub, 90, Some(0));
    assert_eq!(sends(&mut hub, 100), (false, false));
    runs_on(&mut hub, 110, 2, 7);
    transmit(&mut hub, 110, Some(0));
    assert_eq!(sends(&mut hub, 130), (true, true));
    // It is away for long.
    hub.refresh_input_block(ms(2_200));
    transmit(&mut hub, 2_210, Some(0));
    hub.unregister_master(1);
    hub.register_master(ms(2_211), 1);
    assert_eq!(sends(&mut hub, 2_220), (false, false));
}
