//! Spindles: as they are healthy, what their users write, what they do in a shift, and their faults.

use super::{
    MachineKind, PhysicalFault,
    machine_kind::{
        CONTROLLED_ROOM_TEMPERATURE_C, FaultVariation, base_scenario, build_thermometer_configs,
    },
};
use trueup_twin::{
    heat_conduction::Material,
    noise::RandomStream,
    path::{Segment, SegmentKind as Piece},
    scenario::{CoolantConfig, MeasuredQuantity, Scenario},
    sensors::{DisplacementConfig, Spot},
    spindle::SpindleConfig,
    tool::ToolConfig,
};

/// A row a minute.
const ROW_INTERVAL_S: f64 = 60.0;
/// The tools of a magazine.
pub(super) const TOOL_NUMBERS: [u16; 4] = [2, 5, 7, 11];
/// A shift, in s.
const SHIFT_DURATION_S: f64 = 25_000.0;

/// Returns the machine that is drawn, and its user's file.
pub(super) fn draw(kind: MachineKind, stream: &mut RandomStream) -> (Scenario, String) {
    let max_rpm = (stream.uniform(8.0, 24.0) * 10.0).round() * 100.0;
    let mut spindle = SpindleConfig {
        cells: 20,
        max_rpm,
        // Rigid, and nothing grows beyond what is modelled.
        stiffness_n_per_um: 0.0,
        holder_length_m: 0.0,
        holder_lag_s: stream.uniform(1000.0, 2500.0),
        holder_air_share: stream.uniform(0.3, 0.6),
        // Bearings of slow spindles have stiffer oil, or nothing would become warm.
        viscosity_mm2_per_s: 20.0 * (24_000.0 / max_rpm).powf(1.5),
        ..SpindleConfig::default()
    };
    let mut spots = vec![("front", Spot::Front), ("ambient", Spot::Ambient)];
    let head = "[machine]\nname = \"a spindle\"\nkind = \"3-axis\"\n[spindle]\n";
    let mut sensor = None;
    let machine = if kind == MachineKind::SensorSpindle {
        spindle.housing_length_m = 0.0;
        spots.push(("coil", Spot::Coil));
        sensor = Some(DisplacementConfig {
            runout_um: 0.03,
            noise_um: 0.02,
            ..DisplacementConfig::default()
        });
        format!(
            "{head}source = \"sensor\"\n[spindle.sensor]\nk0_um = 0.0\nzero_counts = 5048.0\n\
             um_per_count = {:?}\ntemperature = \"temp_coil_c\"\n",
            500.0 / 32768.0
        )
    } else {
        // The nose bearing is the fixed one: the shaft grows away from the tool, the housing towards it.
        spindle.fixed_at_m = 0.0;
        spindle.centrifugal_um_per_krpm2 = 0.0;
        spindle.load_factor = 0.0;
        spindle.housing_length_m = stream.uniform(0.15, 0.35);
        spindle.housing_j_per_k = stream.uniform(60_000.0, 150_000.0);
        let um_per_c = spindle.housing_length_m * Material::STEEL.expansion_per_k * 1e6;
        if matches!(kind, MachineKind::ThermometerSpindle | MachineKind::ToolSpindle) {
            spots.push(("housing", Spot::Housing));
            format!(
                "{head}source = \"temperature\"\n[spindle.temperature]\n\
                 sensor = \"temp_housing_c\"\nreference_c = {CONTROLLED_ROOM_TEMPERATURE_C:?}\nk_um_per_c = {um_per_c:?}\n"
            )
        } else {
            warmup_machine_file_toml(head, &spindle, um_per_c)
        }
    };
    let scenario = Scenario {
        interval_s: ROW_INTERVAL_S,
        coolant: CoolantConfig { temperature_c: CONTROLLED_ROOM_TEMPERATURE_C, air_share: 0.0 },
        spindle: Some(spindle),
        sensor,
        thermometer: build_thermometer_configs(spots),
        ..base_scenario(kind, MeasuredQuantity::Elongation)
    };
    (scenario, machine)
}

/// Returns the file of one who has recorded a start from cold: a housing of one node follows its bearings' heat
/// with one time constant, and the heat of viscous bearings is proportional to the speed to the power 5/3.
fn warmup_machine_file_toml(head: &str, spindle: &SpindleConfig, um_per_c: f64) -> String {
    /// This many time constants until it counts as warm: what is missing then is below 10⁻⁵.
    const TIME_CONSTANTS_UNTIL_WARM: f64 = 12.0;
    let w_per_k = spindle.housing_air_w_per_k + spindle.housing_coolant_w_per_k;
    let bearings_w = 2.0 * spindle.bearing_heat_w(spindle.max_rpm, 0.0);
    let warm_c = (1.0 - spindle.shaft_share) * bearings_w / w_per_k;
    format!(
        "{head}source = \"warmup\"\n[spindle.warmup]\nlag_s = 0.0\nwarm_s = {:?}\nmax_um = {:?}\n\
         exponent = {TIME_CONSTANTS_UNTIL_WARM:?}\nrated_rpm = {:?}\nspeed_exponent = {:?}\n",
        TIME_CONSTANTS_UNTIL_WARM * spindle.housing_j_per_k / w_per_k,
        um_per_c * warm_c,
        spindle.max_rpm,
        5.0 / 3.0
    )
}

/// A shift: speeds one after the other, a stop among them, and cuts.
pub(super) fn add_day_programme(scenario: &mut Scenario, stream: &mut RandomStream) {
    let max_rpm = scenario.spindle.as_ref().map_or(0.0, |spindle| spindle.max_rpm);
    let piece = |spindle_rpm: f64, load_n: f64, duration_s: f64| Segment {
        spindle_rpm,
        load_n,
        duration_s: Some(duration_s),
        ..Segment::from_kind(Piece::Spindle)
    };
    let (mut passed_s, mut share_before) = (0.0, 0.0);
    while passed_s < SHIFT_DURATION_S {
        let shares: Vec<f64> =
            [0.0, 0.3, 0.5, 0.7, 1.0].into_iter().filter(|share| *share != share_before).collect();
        let share = stream.choose(&shares);
        let minutes = stream.log_uniform(15.0, 60.0).round();
        let load_n = (stream.uniform(2.0, 15.0)).round() * 100.0;
        let has_cut = share > 0.0 && stream.bernoulli(0.6);
        let spindle_rpm = share * max_rpm;
        if has_cut {
            let cut_s = (minutes / 3.0).round() * 60.0;
            scenario.segment.push(piece(spindle_rpm, 0.0, cut_s));
            scenario.segment.push(piece(spindle_rpm, load_n, cut_s));
            scenario.segment.push(piece(spindle_rpm, 0.0, minutes * 60.0 - 2.0 * cut_s));
        } else {
            scenario.segment.push(piece(spindle_rpm, 0.0, minutes * 60.0));
        }
        (passed_s, share_before) = (passed_s + minutes * 60.0, share);
    }
}

/// Changes the tool before each piece at another speed, all of [`TOOL_NUMBERS`] in turn: each is used in a shift.
pub(super) fn insert_tool_changes(scenario: &mut Scenario, stream: &mut RandomStream) {
    let (mut magazine, mut tool, mut before_rpm) = (Vec::new(), TOOL_NUMBERS[0], 0.0);
    for segment in &mut scenario.segment {
        if segment.spindle_rpm > 0.0 && segment.spindle_rpm != before_rpm {
            if magazine.is_empty() {
                magazine = TOOL_NUMBERS.to_vec();
            }
            tool = magazine.swap_remove(stream.uniform_integer(0, magazine.len() - 1));
        }
        before_rpm = segment.spindle_rpm;
        segment.tool = Some(tool);
    }
    scenario.tool =
        TOOL_NUMBERS.map(|number| ToolConfig { number, centrifugal_um_per_krpm2: 0.0 }).into();
}

/// A fault of a spindle or its sensor.
pub(super) fn apply_fault(
    scenario: &mut Scenario,
    fault: PhysicalFault,
    size: f64,
    way: &FaultVariation,
) {
    if let Some(sensor) = &mut scenario.sensor {
        match fault {
            PhysicalFault::SensorGain => sensor.gain = (way.gain * 0.1 * size).exp(),
            PhysicalFault::CoilTemperature => sensor.coil_um_per_c = way.coil * 0.1 * size,
            _ => {}
        }
    }
    let Some(spindle) = &mut scenario.spindle else { return };
    match fault {
        PhysicalFault::UnseenHolder => spindle.holder_length_m = 0.05 * size,
        PhysicalFault::AxialStiffness => spindle.stiffness_n_per_um = 200.0 / size,
        PhysicalFault::SpeedGrowth => spindle.centrifugal_um_per_krpm2 = 0.01 * size,
        PhysicalFault::ToolGrowth => {
            for (tool, share) in scenario.tool.iter_mut().zip(way.tools) {
                tool.centrifugal_um_per_krpm2 = 0.01 * size * share;
            }
        }
        PhysicalFault::ColdTool => spindle.holder_length_m = 0.05 * size,
        PhysicalFault::LostCooling => {
            let flow = (-0.2 * size).exp();
            spindle.housing_coolant_w_per_k *= flow;
            spindle.coolant_w_per_k *= flow;
        }
        _ => {}
    }
}
