//! The bridge as a whole, tick by tick: what each row of its table promises.

mod conditions;
mod floods;
mod heat;
mod jumps;
mod learned;
mod needs;
mod rates;
mod sources;
mod steady;
mod timeouts;

use super::*;
use crate::{
    calibration::AxisThermalModel,
    cnc::{AxisPosition, Control, LinearAxis, SpindleState, TravelDirection},
    displacement_sensor::{SensorLaw, SensorSlope},
    kinematics,
    lag::SmoothingFactor,
    testing::minimal_calibration,
    thermal::ThermalExpansionLaw,
    thermometer::{RawTemperatureReading, Thermometer},
    units::{MicroDegrees, Position, SensorReading, Temperature},
};

/// 1024 nm a code exactly, zero at code 1000, 1 µm in a millisecond.
fn calibration() -> Calibration<'static> {
    let mut calibration = minimal_calibration();
    calibration.spindle.chain[0] = Some(ElongationSource::Sensor);
    calibration.spindle.sensor = SensorLaw {
        k0: Nanometres(0),
        zero: SensorReading(1000 << 10),
        slope: SensorSlope(1 << 28),
    };
    calibration
}
const ENGAGED: Control = Control::ENGAGED;

/// A bridge with the hand that feeds it.
struct Rig {
    bridge: Bridge<'static>,
    state: BridgeState,
    now: TimestampMs,
    last: Output,
}

impl Rig {
    fn new(calibration: Calibration<'static>) -> Self {
        let bridge = Bridge::new(calibration);
        Self { state: bridge.initial_state(), bridge, now: TimestampMs(0), last: Output::default() }
    }

    fn control(&mut self, control: Control) {
        self.bridge.receive(&mut self.state, CncMessage::Control(control));
    }

    fn tick(&mut self, codes: Option<[AdcCode; CODES_PER_TICK]>) -> Output {
        self.now = self.now.wrapping_add_ms(1);
        let input =
            TickInput { codes: codes.as_ref(), speed: Some(Rpm(24_000)), temperatures: None };
        self.last = self.bridge.tick(&mut self.state, self.now, input);
        self.last
    }

    /// Codes that are alive but average to `code`.
    fn run(&mut self, ms: u32, code: u16) -> Output {
        for _ in 0..ms {
            let codes = core::array::from_fn(|n| match n % 4 {
                0 => AdcCode(code - 1),
                2 => AdcCode(code + 1),
                _ => AdcCode(code),
            });
            self.tick(Some(codes));
        }
        self.last
    }

    /// Runs as [`Self::run`] does, with a `Control` every 20 ms.
    fn run_engaged(&mut self, ms: u32, code: u16) -> Output {
        for n in 0..ms {
            if n % 20 == 0 {
                self.control(ENGAGED);
            }
            self.run(1, code);
        }
        self.last
    }

    fn z_nm(&self) -> i32 {
        self.last.offset.expect("available")[2].0
    }
}

#[test]
fn a_spindle_that_grows_is_lifted() {
    let mut rig = Rig::new(calibration());
    // 50 codes are 51.2 µm of growth: the tool tip is too low, the offset goes up.
    let output = rig.run_engaged(200, 1050);
    assert_eq!(output.quality, OffsetQuality::Live);
    assert_eq!(output.offset, Some([Nanometres(0), Nanometres(0), Nanometres(51_200)]));
    assert_eq!(output.flags, OffsetFlags::NONE);
    assert_eq!(output.age_ms, 0);
}

#[test]
fn nothing_is_engaged_before_the_first_control() {
    let mut rig = Rig::new(calibration());
    let output = rig.run(5_000, 1050);
    assert_eq!((output.quality, output.offset), (OffsetQuality::Off, Some([Nanometres(0); 3])));
    assert!(!output.flags.contains(OffsetFlags::CNC_LOST), "what was never there is not lost");
}

#[test]
fn it_takes_both_engage_and_referenced() {
    for (engage, referenced) in [(true, false), (false, true), (false, false)] {
        let mut rig = Rig::new(calibration());
        for _ in 0..20 {
            rig.control(Control { engage, referenced, ..Control::default() });
            rig.run(20, 1050);
        }
        assert_eq!(rig.last.quality, OffsetQuality::Off);
        assert_eq!(rig.z_nm(), 0);
    }
}

#[test]
fn engaging_and_disengaging_ramp_at_the_slew_limit_and_report_it() {
    let mut rig = Rig::new(calibration());
    rig.run(100, 1050);
    let mut before = 0;
    for ms in 1..=52 {
        rig.run_engaged(1, 1050);
        assert!((rig.z_nm() - before).abs() <= 1_000, "at {ms} ms");
        assert_eq!(rig.last.flags.contains(OffsetFlags::SLEWING), ms < 52);
        before = rig.z_nm();
    }
    assert_eq!(before, 51_200);
    rig.control(Control { engage: false, ..ENGAGED });
    for left in (0..=51).rev() {
        rig.run(1, 1050);
        assert_eq!(
            rig.last.quality,
            if left > 0 || rig.z_nm() > 0 { OffsetQuality::RampingOut } else { OffsetQuality::Off }
        );
    }
    assert_eq!((rig.z_nm(), rig.last.quality), (0, OffsetQuality::Off));
}

#[test]
fn a_silent_cnc_is_lost_after_500_ms_held_for_2_s_and_ramped_out() {
    let mut rig = Rig::new(calibration());
    rig.run_engaged(200, 1050);
    rig.control(ENGAGED);
    rig.run(500, 1050);
    assert_eq!(rig.last.quality, OffsetQuality::Live);
    rig.run(1, 1050);
    assert_eq!(rig.last.quality, OffsetQuality::Hold);
    assert!(rig.last.flags.contains(OffsetFlags::CNC_LOST));
    // While it is held the spindle may grow as it likes.
    rig.run(1_999, 1090);
    assert_eq!((rig.last.quality, rig.z_nm()), (OffsetQuality::Hold, 51_200));
    rig.run(1, 1090);
    assert_eq!((rig.last.quality, rig.z_nm()), (OffsetQuality::RampingOut, 50_200));
    rig.run(60, 1090);
    assert_eq!((rig.last.quality, rig.z_nm()), (OffsetQuality::Off, 0));
    assert!(rig.last.flags.contains(OffsetFlags::CNC_LOST));
    // It comes back: no jump.
    rig.run_engaged(1, 1090);
    assert_eq!((rig.last.quality, rig.z_nm()), (OffsetQuality::Live, 1_000));
    assert!(!rig.last.flags.contains(OffsetFlags::CNC_LOST));
}

#[test]
fn a_broken_wire_holds_then_ramps_out_then_is_not_available() {
    let mut rig = Rig::new(calibration());
    rig.run_engaged(200, 1050);
    for ms in 1..=2_100_u32 {
        if ms % 20 == 0 {
            rig.control(ENGAGED);
        }
        let before = rig.last.offset.map_or(0, |offset| offset[2].0);
        rig.tick(Some([AdcCode(0); CODES_PER_TICK]));
        let after = rig.last.offset.map_or(0, |offset| offset[2].0);
        assert!((after - before).abs() <= 1_000, "a jump at {ms} ms");
        assert!(rig.last.flags.contains(OffsetFlags::SENSOR_FAULT));
        if ms <= 2_000 {
            assert_eq!((rig.last.quality, after), (OffsetQuality::Hold, 51_200), "at {ms} ms");
        }
    }
    assert_eq!((rig.last.quality, rig.last.offset), (OffsetQuality::Fault, None));
    assert_eq!(rig.last.age_ms, 255);
    // The wire is mended: 10 ms of good codes and a full filter later it ramps in again.
    rig.run_engaged(13, 1050);
    assert_ne!(rig.last.quality, OffsetQuality::Live);
    rig.run_engaged(1, 1050);
    assert_eq!((rig.last.quality, rig.z_nm()), (OffsetQuality::Live, 1_000));
    rig.run_engaged(60, 1050);
    assert_eq!(rig.z_nm(), 51_200);
}

#[test]
fn missing_samples_are_flagged_held_and_end_in_not_available() {
    let mut rig = Rig::new(calibration());
    rig.run_engaged(200, 1050);
    let mut hold_ends = 0;
    for ms in 1..=2_200_u32 {
        rig.control(ENGAGED);
        rig.tick(None);
        assert_eq!(rig.last.flags.contains(OffsetFlags::SAMPLES_MISSING), ms > SAMPLES_TIMEOUT_MS);
        if rig.last.quality == OffsetQuality::Hold {
            hold_ends = ms;
        }
    }
    assert_eq!(hold_ends, SAMPLES_TIMEOUT_MS + 2_000);
    assert_eq!((rig.last.quality, rig.last.offset), (OffsetQuality::Fault, None));
}

#[test]
fn a_board_without_samples_is_not_available_from_the_first_tick() {
    let mut rig = Rig::new(calibration());
    let output = rig.tick(None);
    assert_eq!((output.quality, output.offset), (OffsetQuality::Fault, None));
    assert_eq!((output.flags, output.age_ms), (OffsetFlags::SAMPLES_MISSING, 255));
}

#[test]
fn zero_takes_the_present_growth_as_reference_by_a_ramp() {
    let mut rig = Rig::new(calibration());
    rig.run_engaged(200, 1050);
    rig.control(Control { zero: true, ..ENGAGED });
    rig.run(1, 1050);
    assert_eq!(rig.z_nm(), 50_200, "one step at the slew limit");
    rig.run(60, 1050);
    assert_eq!(rig.z_nm(), 0);
    // 10 codes more are 10.24 µm since the reference; the bit that stays set does nothing.
    rig.control(Control { zero: true, ..ENGAGED });
    rig.run(60, 1060);
    assert_eq!(rig.z_nm(), 10_240);
}

#[test]
fn a_cnc_that_starts_with_zero_set_has_asked_for_nothing() {
    let mut rig = Rig::new(calibration());
    rig.run(100, 1050);
    rig.control(Control { zero: true, ..ENGAGED });
    rig.run(100, 1050);
    assert_eq!(rig.z_nm(), 51_200);
}

#[test]
fn the_clamp_is_reported() {
    let mut rig = Rig::new(calibration());
    let output = rig.run_engaged(900, 1900);
    assert_eq!(rig.z_nm(), 500_000);
    assert!(output.flags.contains(OffsetFlags::CLAMPED));
}

#[test]
fn without_a_speed_the_window_is_200_ms_and_it_says_so() {
    let mut rig = Rig::new(calibration());
    for ms in 0..450_u16 {
        let codes = core::array::from_fn(|n| AdcCode(1000 + (n % 2) as u16 + ms % 2));
        let input = TickInput { codes: Some(&codes), ..TickInput::default() };
        let output = rig.bridge.tick(&mut rig.state, TimestampMs(u32::from(ms) + 1), input);
        assert!(output.flags.contains(OffsetFlags::SPEED_UNKNOWN));
        assert_eq!(rig.state.elongation().is_some(), ms >= 399, "at {ms} ms");
    }
}

#[test]
fn the_speed_of_the_cnc_wins_while_it_is_fresh() {
    let mut rig = Rig::new(calibration());
    let spindle = SpindleState { speed: Rpm(60_000), load_n: 0 };
    rig.bridge.receive(&mut rig.state, CncMessage::Spindle(spindle));
    for ms in 1..=3 {
        let codes = core::array::from_fn(|n| AdcCode(1000 + (n % 2) as u16));
        rig.bridge.tick(
            &mut rig.state,
            TimestampMs(ms),
            TickInput { codes: Some(&codes), ..TickInput::default() },
        );
    }
    // Two windows of 5 samples are full after 2 ms; two of 200 ms would not be.
    assert!(rig.state.elongation().is_some());
}

/// 100 µm/m per kelvin above 20 °C at X, seen by a chain of 1 count a kelvin on channel 3.
const LAW: [[u8; 20]; 1] = [piece_bytes()];

const fn piece_bytes() -> [u8; 20] {
    // 1e-3 nm per position unit and kelvin, Q36, 1.024 K, Q4: 1 125 899 906.8.
    let words = [20 * 4_096_000, 0, 0, 0, 1_125_899_907_i32];
    let mut bytes = [0; 20];
    let mut n = 0;
    while n < 20 {
        bytes[n] = words[n / 4].to_le_bytes()[n % 4];
        n += 1;
    }
    bytes
}

fn expanding() -> Calibration<'static> {
    let mut calibration = minimal_calibration();
    // One count a kelvin: 16 000 units per 1/256 count.
    calibration.thermometers[3] = Some(Thermometer::Linear { zero: 0, slope: 16_000, shift: 0 });
    let law = ThermalExpansionLaw { pieces: &LAW };
    calibration.axes[0].thermal = Some(AxisThermalModel {
        channel: 3,
        smoothing: SmoothingFactor::NO_LAG,
        smoothing_falling: SmoothingFactor::NO_LAG,
        origin: Position(0),
        law,
    });
    calibration
}

fn warm(rig: &mut Rig, ms: u32, kelvin: Option<i32>, x_mm: i32) -> Output {
    for _ in 0..ms {
        rig.control(ENGAGED);
        rig.bridge.receive(
            &mut rig.state,
            CncMessage::Position(AxisPosition {
                axis: LinearAxis::X,
                position: Position(x_mm * Position::PER_MILLIMETRE),
                direction: TravelDirection::Positive,
            }),
        );
        let mut raw = [RawTemperatureReading::NONE; TEMPERATURE_CHANNEL_COUNT];
        raw[3] = kelvin
            .map_or(RawTemperatureReading::NONE, |kelvin| RawTemperatureReading(kelvin * 256));
        rig.now = rig.now.wrapping_add_ms(1);
        let input = TickInput { temperatures: Some(&raw), speed: Some(Rpm(0)), codes: None };
        rig.last = rig.bridge.tick(&mut rig.state, rig.now, input);
    }
    rig.last
}

#[test]
fn an_axis_that_has_grown_is_taken_back_along_itself() {
    let mut rig = Rig::new(expanding());
    // 1 K and 1 m: +100 µm of error, so the offset is −100 µm; and it needs no sensor.
    let output = warm(&mut rig, 300, Some(21), 1_000);
    assert_eq!(output.offset, Some([Nanometres(-100_000), Nanometres(0), Nanometres(0)]));
    assert_eq!((output.quality, output.flags), (OffsetQuality::Live, OffsetFlags::NONE));
    // On the other side of the origin the error turns round.
    let output = warm(&mut rig, 300, Some(21), -1_000);
    assert_eq!(output.offset, Some([Nanometres(100_000), Nanometres(0), Nanometres(0)]));
}

#[test]
fn a_part_beyond_its_limit_is_held_and_reported() {
    let mut rig = Rig::new(expanding());
    let output = warm(&mut rig, 500, Some(24), 1_000);
    assert_eq!(output.offset, Some([Nanometres(-200_000), Nanometres(0), Nanometres(0)]));
    assert!(output.flags.contains(OffsetFlags::CLAMPED));
}

#[test]
fn a_broken_thermometer_holds_then_ramps_out_then_is_not_available() {
    let mut rig = Rig::new(expanding());
    warm(&mut rig, 300, Some(21), 1_000);
    // A spark of 300 ms is nothing; the fourth bad reading is a fault.
    let output = warm(&mut rig, 299, None, 1_000);
    assert_eq!((output.quality, output.flags), (OffsetQuality::Live, OffsetFlags::NONE));
    let output = warm(&mut rig, 200, None, 1_000);
    assert_eq!(output.quality, OffsetQuality::Hold);
    assert!(output.flags.contains(OffsetFlags::SENSOR_FAULT));
    assert_eq!(output.offset.unwrap()[0], Nanometres(-100_000));
    let output = warm(&mut rig, 2_500, None, 1_000);
    assert_eq!((output.quality, output.offset), (OffsetQuality::Fault, None));
    let output = warm(&mut rig, 500, Some(21), 1_000);
    assert_eq!(output.quality, OffsetQuality::Live);
}

#[test]
fn without_the_position_that_it_needs_it_does_not_follow_and_says_that_the_cnc_is_lost() {
    let mut rig = Rig::new(expanding());
    warm(&mut rig, 300, Some(21), 1_000);
    for _ in 0..501 {
        rig.control(ENGAGED);
        rig.tick(None);
    }
    assert_eq!(rig.last.quality, OffsetQuality::Hold);
    assert!(rig.last.flags.contains(OffsetFlags::CNC_LOST));
}

#[test]
fn zero_takes_all_of_the_present_error() {
    let mut rig = Rig::new(expanding());
    warm(&mut rig, 300, Some(21), 1_000);
    rig.control(Control { zero: true, ..ENGAGED });
    let output = warm(&mut rig, 300, Some(21), 1_000);
    assert_eq!(output.offset, Some([Nanometres(0); 3]));
    // 200 µm at 2 m, of which 100 count as none.
    let output = warm(&mut rig, 300, Some(21), 2_000);
    assert_eq!(output.offset, Some([Nanometres(-100_000), Nanometres(0), Nanometres(0)]));
    let reference = rig.state.reference();
    assert_eq!(reference.axes, [FineNanometres(25_600_000), FineNanometres(0), FineNanometres(0)]);
}

#[test]
fn an_axis_that_is_not_square_errs_along_the_other_where_it_goes() {
    let mut machine = minimal_calibration();
    // X over Y, 10 µm/m.
    machine.squareness[0] = crate::gradient::Gradient(6_871_948);
    let mut rig = Rig::new(machine);
    for (y_mm, x_nm) in [(1_000, -10_000), (0, 0), (2_000, -20_000), (-500, 5_000)] {
        for _ in 0..100 {
            rig.control(ENGAGED);
            let position = Position(y_mm * Position::PER_MILLIMETRE);
            let received = AxisPosition {
                axis: LinearAxis::Y,
                position,
                direction: TravelDirection::Positive,
            };
            rig.bridge.receive(&mut rig.state, CncMessage::Position(received));
            rig.tick(None);
        }
        assert_eq!(rig.last.offset, Some([Nanometres(x_nm), Nanometres(0), Nanometres(0)]));
    }
}

#[test]
fn a_tilted_head_takes_growth_to_both_axes() {
    let mut machine = calibration();
    machine.kinematics.axes = [Some(kinematics::RotaryAxis::A), None];
    let mut rig = Rig::new(machine);
    // Without an angle nobody knows where the tool points.
    assert_eq!(rig.run_engaged(200, 1050).quality, OffsetQuality::Off);
    for _ in 0..300 {
        let angles = [MicroDegrees(30_000_000), MicroDegrees(0)];
        rig.bridge.receive(&mut rig.state, CncMessage::Rotary(RotaryAxisAngles { angles }));
        rig.run_engaged(1, 1100);
    }
    // 102.4 µm along (0, 0.5, −0.866): error (0, 51.2, −88.681), offset its opposite.
    let expected = [Nanometres(0), Nanometres(-51_200), Nanometres(88_681)];
    assert_eq!(rig.last.offset, Some(expected));
}

#[test]
fn it_reports_the_time_of_its_last_tick_and_the_noise_since_the_last_request() {
    let mut rig = Rig::new(calibration());
    rig.run(5, 1050);
    assert_eq!(rig.state.now(), TimestampMs(5));
    // −1, 0, 1, 0: every other second difference is 2. The first block goes on from nothing.
    assert_eq!(
        rig.state.take_noise_statistics(),
        crate::sensor_health::NoiseStatistics { squares: 4 * 40, count: 80 }
    );
    assert_eq!(rig.state.take_noise_statistics(), crate::sensor_health::NoiseStatistics::default());
}
