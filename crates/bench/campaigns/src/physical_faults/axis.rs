//! Axes: as they are healthy, what their users write, how they are measured, and their faults.

use std::collections::BTreeMap;

use super::{
    MachineKind, PhysicalFault,
    machine_kind::{
        CONTROLLED_ROOM_TEMPERATURE_C, FaultVariation, base_scenario, build_thermometer_configs,
    },
};
use trueup_twin::{
    axes::{AxisConfig, AxisName, Feedback, StraightnessConfig},
    cubic_spline::CubicSpline,
    noise::RandomStream,
    path::{Segment, SegmentKind as Piece},
    scenario::{MeasuredQuantity, Scenario},
    sensors::Spot,
};

/// Rows are written at targets alone: no way lasts so long as this, in s.
const DISABLED_ROW_INTERVAL_S: f64 = 1e12;
/// How often the axis is measured in a day.
const MEASUREMENTS_PER_DAY: u32 = 20;
const AXIS_TRAVEL_MM: [f64; 2] = [20.0, 980.0];

/// Returns the machine that is drawn, and its user's file.
pub(super) fn draw(kind: MachineKind, stream: &mut RandomStream) -> (Scenario, String) {
    let on_screw = kind == MachineKind::ScrewAxis;
    let axis = AxisConfig {
        feedback: if on_screw { Feedback::Screw } else { Feedback::Scale },
        screw_heating_c: 0.0,
        screw_lag_s: stream.uniform(900.0, 2000.0),
        scale_lag_s: stream.uniform(900.0, 2500.0),
        reference_c: CONTROLLED_ROOM_TEMPERATURE_C,
        ..AxisConfig::default()
    };
    let head = "[machine]\nname = \"an axis\"\nkind = \"3-axis\"\n";
    let (feedback, spots) = match kind {
        MachineKind::ScrewAxis => {
            ("screw", vec![("screw", Spot::ScrewX), ("ambient", Spot::Ambient)])
        }
        MachineKind::ScaleAxis => {
            ("scale", vec![("scale", Spot::ScaleX), ("ambient", Spot::Ambient)])
        }
        _ => ("scale", vec![("scale", Spot::ScaleX)]),
    };
    let mut machine = format!("{head}[axis.x]\nfeedback = \"{feedback}\"\n");
    if kind == MachineKind::CompensatedAxis {
        machine += &format!(
            "[axis.x.thermal]\nmode = \"position\"\nsensor = \"temp_scale_c\"\n\
             reference_c = {CONTROLLED_ROOM_TEMPERATURE_C:?}\nconstant_um_per_c = 0.0\nslope_um_per_m_per_c = {:?}\n\
             origin_mm = 0.0\nlag_s = 0.0\n",
            axis.scale_um_per_m_per_c
        );
    }
    let scenario = Scenario {
        interval_s: DISABLED_ROW_INTERVAL_S,
        start_mm: [AXIS_TRAVEL_MM[0], 300.0, 200.0],
        thermometer: build_thermometer_configs(spots),
        axis: BTreeMap::from([(AxisName::X, axis)]),
        ..base_scenario(kind, MeasuredQuantity::Dx)
    };
    (scenario, machine)
}

/// A day: the axis works for a while, quickly or hardly at all, and is measured up and down with Y at
/// another place each time.
pub(super) fn add_day_programme(scenario: &mut Scenario, stream: &mut RandomStream) {
    let piece =
        |kind: Piece| Segment { feed_mm_per_min: Some(12_000.0), ..Segment::from_kind(kind) };
    let [low_mm, high_mm] = AXIS_TRAVEL_MM;
    let spread_mm = stream.uniform(5.0, 15.0);
    let mut feed_mm_per_min = 600.0;
    for number in 0..MEASUREMENTS_PER_DAY {
        // It works on as before, or does not.
        if number % 3 == 0 {
            feed_mm_per_min = stream.choose(&[600.0, 6000.0, 15_000.0, 20_000.0]);
        }
        let seconds = stream.uniform(300.0, 900.0);
        let there_and_back_s = 2.0 * (high_mm - low_mm) * 60.0 / feed_mm_per_min;
        let y_mm = stream.uniform(0.0, 600.0).round();
        scenario.segment.push(Segment { to_mm: Some([low_mm, y_mm, 200.0]), ..piece(Piece::Move) });
        scenario.segment.push(Segment {
            to_mm: Some([high_mm, y_mm, 200.0]),
            cycles: Some((seconds / there_and_back_s).ceil() as u32),
            feed_mm_per_min: Some(feed_mm_per_min),
            ..piece(Piece::Move)
        });
        scenario.segment.push(Segment {
            axis: Some(AxisName::X),
            range_mm: Some(AXIS_TRAVEL_MM),
            targets: Some(11),
            dwell_s: Some(3.0),
            spread_mm: Some(spread_mm),
            ..piece(Piece::Positions)
        });
    }
}

/// A fault of an axis or its thermometer.
pub(super) fn apply_fault(
    scenario: &mut Scenario,
    fault: PhysicalFault,
    size: f64,
    way: &FaultVariation,
) {
    let Some(x) = scenario.axis.get_mut(&AxisName::X) else { return };
    match fault {
        PhysicalFault::ScrewHeating => x.screw_heating_c = 0.2 * size,
        PhysicalFault::Wear => {
            let middle_um = 2.0 * size;
            let along_um = way.wear_along * middle_um;
            let [low_mm, high_mm] = AXIS_TRAVEL_MM;
            let half_m = (high_mm - low_mm) / 2000.0;
            x.backlash_um_per_m = along_um / half_m;
            x.backlash_um = middle_um - x.backlash_um_per_m * (low_mm + high_mm) / 2000.0;
        }
        PhysicalFault::Mounting => scenario.straightness.push(StraightnessConfig {
            error: AxisName::X,
            along: AxisName::Y,
            points: CubicSpline::default(),
            um_per_m: way.mounting * 10.0 * size,
        }),
        PhysicalFault::MisplacedThermometer => {
            if let Some(thermometer) = scenario.thermometer.get_mut("scale") {
                thermometer.at = Spot::Ambient;
            }
        }
        _ => {}
    }
}
