//! The paper's axis, as constant and slope: hand-computed, at two places, and taken back.

use super::*;
use std::{vec, vec::Vec};
use trueup_core::{
    calibration::AxisThermalModel,
    cnc::{AxisPosition, LinearAxis, TravelDirection},
    design_parameters::TEMPERATURE_CHANNEL_COUNT,
    lag::SmoothingFactor,
    temperature_channels::RawTemperatures,
    thermal::{THERMAL_LAW_SEGMENT_SIZE, ThermalExpansionLaw, ThermalLawSegment},
    thermometer::{RawTemperatureReading, Thermometer},
    units::{Nanometres, Position, Temperature},
};
use trueup_link::{
    layout::{CONTROL_PERIOD_MS, STATUS_ID},
    receiver::OffsetReceiver,
    status::{StatusItem, decode},
};

/// tanβ = (T − 23 °C)·14.21 µm/m, and K₀ = (T − 23 °C)·2 µm.
fn encode_law_segment() -> [u8; THERMAL_LAW_SEGMENT_SIZE] {
    ThermalLawSegment {
        start: Temperature(23 * Temperature::PER_KELVIN),
        // 2 µm = 2000 nm · 256, times 1.024 K, times 16.
        constant_slope: 8_388_608,
        // 1.421e-4 nm per 10 nm, times 2³⁶ · 1.024 · 16.
        gradient_slope: 159_990_376,
        ..ThermalLawSegment::default()
    }
    .to_bytes()
}

struct SlopeTestRig<'a> {
    node: Node<'a>,
    counters: [u8; 2],
    offsets: OffsetReceiver,
    last: [Nanometres; 3],
}

impl SlopeTestRig<'_> {
    /// This many milliseconds; the status items with their times.
    fn run_for_ms(
        &mut self,
        ms: u32,
        kelvin_tenths: i32,
        x_mm: i32,
        engage: bool,
    ) -> Vec<(u32, StatusItem)> {
        let mut items = vec![];
        let mut raw: RawTemperatures = [RawTemperatureReading::NONE; TEMPERATURE_CHANNEL_COUNT];
        // A count a tenth of a kelvin.
        raw[3] = RawTemperatureReading(kelvin_tenths * 256);
        for _ in 0..ms {
            let now = self.node.now().0;
            if now.is_multiple_of(CONTROL_PERIOD_MS) {
                let control = Control { engage, ..Control::REFERENCED };
                self.receive(0, |counter| frames::encode_control(control, counter));
                let position = AxisPosition {
                    axis: LinearAxis::X,
                    position: Position(x_mm * Position::PER_MILLIMETRE),
                    direction: TravelDirection::Positive,
                };
                self.receive(1, |counter| frames::encode_position(position, counter));
            }
            let input = TickInput { temperatures: Some(&raw), ..TickInput::default() };
            for frame in self.node.tick(1, input) {
                if let Ok(Some(output)) = self.offsets.accept(&frame) {
                    self.last = output.offset.unwrap_or_default();
                }
            }
            let sent_frames =
                self.node.next_service_frame().filter(|frame| frame.id() == STATUS_ID);
            items.extend(
                sent_frames.map(|frame| (self.node.now().0, decode(&frame).expect("ours").item)),
            );
        }
        items
    }

    fn receive(&mut self, number: usize, frame: impl Fn(u8) -> Frame) {
        let counter = self.counters[number];
        self.counters[number] = counter.wrapping_add(1);
        self.node.receive(Interface::Can, &frame(counter)).expect("in order");
    }
}

/// Returns the last slope of X.
fn last_x_slope_item(items: &[(u32, StatusItem)]) -> (Option<i16>, i16) {
    let of_x = |(_, item): &(u32, StatusItem)| match *item {
        StatusItem::Slope { axis: 0, constant, slope } => Some((constant, slope)),
        _ => None,
    };
    items.iter().rev().find_map(of_x).expect("every 1.5 s")
}

#[test]
fn an_axis_is_sent_as_constant_and_slope_about_its_origin() {
    let pieces = [encode_law_segment()];
    let mut calibration = sensor_only_calibration();
    calibration.spindle = Default::default();
    calibration.limits.slew_nm_per_s = 1_000_000;
    calibration.thermometers[3] = Some(Thermometer::Linear { zero: 0, slope: 1_600, shift: 0 });
    calibration.axes[0].thermal = Some(AxisThermalModel {
        channel: 3,
        smoothing: SmoothingFactor::NO_LAG,
        smoothing_falling: SmoothingFactor::NO_LAG,
        origin: Position(500 * Position::PER_MILLIMETRE),
        law: ThermalExpansionLaw { pieces: &pieces },
    });
    let node = Node::new(calibration.into());
    let mut rig = SlopeTestRig {
        node,
        counters: [0; 2],
        offsets: OffsetReceiver::new(),
        last: Default::default(),
    };
    rig.run_for_ms(200, 249, 2_500, false);
    // 1.9 K: 27.0 µm/m too far, and 3.8 µm. At 2.5 m, 2 m from the origin: −57.8 µm.
    let items = rig.run_for_ms(3_500, 249, 2_500, true);
    assert!((rig.last[0].0 + 57_798).abs() <= 10, "{:?}", rig.last);
    assert_eq!(last_x_slope_item(&items), (Some(-38), -270));
    // Elsewhere the offset is another, constant and slope are the same.
    let items = rig.run_for_ms(3_500, 249, 0, true);
    assert!((rig.last[0].0 - 9_700).abs() <= 10, "{:?}", rig.last);
    assert_eq!(last_x_slope_item(&items), (Some(-38), -270));
    let others =
        items.iter().filter(|(_, item)| matches!(item, StatusItem::Slope { axis: 1.., .. }));
    let none = |pair: &(u32, StatusItem)| {
        matches!(pair.1, StatusItem::Slope { constant: Some(0), slope: 0, .. })
    };
    assert!(others.clone().count() >= 4 && others.clone().all(none), "Y and Z have none");
    // The state keeps coming at least once a second.
    let items = rig.run_for_ms(6_000, 249, 0, true);
    let states: Vec<u32> = items
        .iter()
        .filter_map(|(at, item)| matches!(item, StatusItem::State(_)).then_some(*at))
        .collect();
    assert!(states.windows(2).all(|pair| pair[1] - pair[0] <= 1_000), "{states:?}");
    // Disengaged both go to 0.
    let items = rig.run_for_ms(3_500, 249, 2_500, false);
    assert_eq!((rig.last[0].0, last_x_slope_item(&items)), (0, (Some(0), 0)));
}

#[test]
fn a_slope_goes_on_its_way_no_faster_than_the_slew_limit_at_its_place() {
    let pieces = [encode_law_segment()];
    let mut calibration = sensor_only_calibration();
    calibration.spindle = Default::default();
    // 4 µm/s: 6 µm in 1.5 s, at 4 m 1.5 µm/m.
    calibration.limits.slew_nm_per_s = 4_000;
    calibration.thermometers[3] = Some(Thermometer::Linear { zero: 0, slope: 1_600, shift: 0 });
    calibration.axes[0].thermal = Some(AxisThermalModel {
        channel: 3,
        smoothing: SmoothingFactor::NO_LAG,
        smoothing_falling: SmoothingFactor::NO_LAG,
        origin: Position(0),
        law: ThermalExpansionLaw { pieces: &pieces },
    });
    let node = Node::new(calibration.into());
    let mut rig = SlopeTestRig {
        node,
        counters: [0; 2],
        offsets: OffsetReceiver::new(),
        last: Default::default(),
    };
    rig.run_for_ms(200, 249, 4_000, false);
    let items = rig.run_for_ms(9_000, 249, 4_000, true);
    let slopes: Vec<i16> = items
        .iter()
        .filter_map(|(_, item)| match *item {
            StatusItem::Slope { axis: 0, slope, .. } => Some(slope),
            _ => None,
        })
        .collect();
    assert!(slopes.len() >= 5 && *slopes.last().expect("some") < -40, "{slopes:?}");
    assert!(slopes.windows(2).all(|pair| (0..=15).contains(&(pair[0] - pair[1]))), "{slopes:?}");
    // What is sent is what is applied, on its way too.
    let (constant, slope) = last_x_slope_item(&rig.run_for_ms(1_500, 249, 4_000, true));
    let sum_nm = i32::from(constant.expect("available")) * 100 + i32::from(slope) * 400;
    // The newest is up to 1.5 s old: 6 µm.
    assert!((rig.last[0].0 - sum_nm).abs() <= 6_100, "{sum_nm} {:?}", rig.last);
}
