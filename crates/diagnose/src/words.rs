//! What a cause means for a person at the machine: one sentence, and what to measure next.

use crate::{
    model::{Kind, Part},
    terms,
};

/// The cause in a sentence.
pub(crate) fn sentence(part: &Part) -> String {
    let value = |index: usize| part.values.get(index).copied().unwrap_or(0.0);
    let minutes = |seconds: f64| {
        if seconds < 120.0 {
            format!("{seconds:.0} s")
        } else {
            format!("{:.1} min", seconds / 60.0)
        }
    };
    match &part.kind {
        Kind::SensorOffset => format!("The zero of the sensor is off by {:+.2} µm.", value(0)),
        Kind::SensorGain => format!(
            "The tool moves {:.4} µm for each micrometre that the sensor shows.",
            1.0 + value(0)
        ),
        Kind::SensorCurvature => format!(
            "The sensor's characteristic is bent: at 50 µm it is off by {:+.2} µm.",
            value(0) * 2500.0
        ),
        Kind::SensorSaturation => format!("The sensor shows nothing above {:.1} µm.", value(0)),
        Kind::SensorTemperatureDrift { column } => {
            format!("The sensor shows {:+.3} µm for each kelvin of its own {column}.", -value(0))
        }
        Kind::TimeShift => format!(
            "The measurement and the model's inputs are {:.1} s apart: two clocks differ.",
            value(0)
        ),
        Kind::ThermalLag => format!(
            "The machine grows later than its thermometer warms, by a time constant of {}.",
            minutes(value(0))
        ),
        Kind::SlowMode => format!(
            "Beside what the model knows something grows by {:+.2} µm, with a time constant of {}.",
            value(1),
            minutes(value(0))
        ),
        Kind::SlowModeOf { column } => format!(
            "A second, slower path goes with {column}: {:+.3} µm/K behind {}.",
            value(1),
            minutes(value(0))
        ),
        Kind::ExtraHeatPath { column, has_lag } => {
            let behind = if *has_lag {
                format!(", behind a time constant of {}", minutes(value(0)))
            } else {
                String::new()
            };
            format!(
                "Heat that the model does not know moves the tool: {:+.3} µm for each kelvin of \
                 {column}{behind}.",
                value(usize::from(*has_lag))
            )
        }
        Kind::GrowthAmplitude => {
            format!("The growth is {:.3} times what the model says.", 1.0 + value(0))
        }
        Kind::GrowthRate => {
            format!("The spindle warms up with a time constant of {}.", minutes(value(0)))
        }
        Kind::CoolingAsymmetry => {
            format!("It cools down with a time constant of its own: {}.", minutes(value(0)))
        }
        Kind::ExpansionSlope => {
            format!("The axis expands by {:+.3} µm/(m·K) more than believed.", value(0))
        }
        Kind::ReferenceTemperature => format!(
            "The axis is right at another temperature, {:+.2} K from the believed one.",
            value(0)
        ),
        Kind::CentrifugalGrowth => format!(
            "Speed itself stretches the spindle: {:+.3} µm at 10 000 r/min.",
            value(0) * 100.0
        ),
        Kind::CuttingLoad => {
            format!("The cut pushes the tool back by {:.2} µm for 1000 N.", value(0) * 1000.0)
        }
        Kind::PitchScale => {
            format!("The scale or the screw is off by {:+.2} µm for each metre.", value(0))
        }
        Kind::PitchError { points, both_ways, .. } => format!(
            "The scale or the screw is uneven: a table of {points} points{} says by how much.",
            if *both_ways { " for each direction" } else { "" }
        ),
        Kind::PitchPeriodic { harmonics } => {
            let (harmonic, size) = harmonics
                .iter()
                .zip(part.values[1..].chunks(2))
                .map(|(harmonic, pair)| (f64::from(*harmonic), pair[0].hypot(pair[1])))
                .fold((1.0, 0.0), |most, wave| if wave.1 > most.1 { wave } else { most });
            format!(
                "The error repeats every {:.4} mm with an amplitude of {size:.2} µm.",
                value(0) / harmonic
            )
        }
        Kind::Backlash => format!(
            "Approached in the negative direction the axis stands {:+.2} µm further.",
            value(0)
        ),
        Kind::PositionDependentBacklash => {
            format!("The backlash changes by {:+.2} µm over a metre of the axis.", value(0))
        }
        Kind::Straightness { along, .. } => {
            format!("The guide of the {} axis is not straight.", along.name().to_uppercase())
        }
        Kind::CrossAxis { axis } => format!(
            "The axis moves by {:+.2} µm for each metre of {}.",
            value(0),
            axis.name().to_uppercase()
        ),
        Kind::Step => {
            format!("At {:.0} s something slipped by {:+.2} µm, once.", value(0), value(1))
        }
        Kind::Drift => format!("It wanders by {:+.3} µm an hour.", value(0)),
        Kind::ReferenceInstrument { is_angled, .. } => {
            let text = terms::instrument(*is_angled, part);
            format!("It is {text}. The machine is not to be compensated for it.")
        }
        Kind::Curve { column, .. } => {
            format!("Something goes with {column}.")
        }
    }
}

/// The measurement that would settle what is open about `kind`, against `rival` where there is one.
pub(crate) fn next_test(kind: &Kind, rival: Option<&str>) -> String {
    let name = kind.name();
    let pair = rival.map(|rival| {
        let mut pair = [name, rival];
        pair.sort_unstable();
        pair
    });
    let text = match (pair, kind) {
        (Some(["pitch-scale", "reference-temperature"]), _) => {
            "Measure the axis at two temperatures that are at least 5 K apart: a wrong scale stays \
             the same, a wrong reference temperature changes with the slope."
        }
        (Some(["expansion-slope", "pitch-scale"]), _) => {
            "Measure the axis cold and warm: a scale stays, an expansion grows with temperature."
        }
        (Some(["drift", _] | [_, "drift"]), _) => {
            "Repeat the run on another day and in another order: a drift follows the clock, a cause \
             follows its input."
        }
        (Some([_, "slow-mode"] | ["slow-mode", _]), _) => {
            "Record a run with two heatings and a long cool-down in between, until nothing moves: \
             only then do two slow paths part."
        }
        (Some(["extra-heat-path", "extra-heat-path"]), _) => {
            "Warm the two places one after the other, not together."
        }
        (_, Kind::ExtraHeatPath { .. } | Kind::SlowModeOf { .. } | Kind::SlowMode) => {
            "Record a run at least three times as long as the slow time constant, with a cool-down, \
             on another day: it must be predicted without a new fit."
        }
        (_, Kind::ThermalLag | Kind::CoolingAsymmetry | Kind::GrowthRate) => {
            "Record a start from cold and a stop from warm, each until nothing moves any more."
        }
        (_, Kind::SensorGain | Kind::SensorOffset | Kind::SensorCurvature) => {
            "Move the sensor's target by known gauge blocks over its whole range, up and down."
        }
        (_, Kind::SensorSaturation) => {
            "Read the sensor against a dial gauge just below and above the limit."
        }
        (_, Kind::SensorTemperatureDrift { .. }) => {
            "Warm the sensor alone in front of a target that stands still."
        }
        (_, Kind::CentrifugalGrowth) => {
            "Change the speed quickly, up and down: what comes at once is not heat."
        }
        (_, Kind::CuttingLoad) => {
            "Press on the tool with a force gauge at standstill and read the dial."
        }
        (_, Kind::GrowthAmplitude) => "Repeat the run at another speed and compare the factor.",
        (_, Kind::ExpansionSlope | Kind::ReferenceTemperature) => {
            "Measure the axis at both ends at two temperatures that are at least 5 K apart."
        }
        (_, Kind::PitchPeriodic { .. }) => {
            "Measure one turn of the screw in steps of a twentieth of the period, and a second turn \
             elsewhere: it must repeat with the same phase."
        }
        (_, Kind::PitchScale | Kind::PitchError { .. }) => {
            "Measure once more by ISO 230-2 at targets that are no multiples of the screw's pitch."
        }
        (_, Kind::Backlash | Kind::PositionDependentBacklash) => {
            "Approach one position seven times from each side, at mid-travel and near both ends."
        }
        (_, Kind::Straightness { .. } | Kind::CrossAxis { .. }) => {
            "Turn the straight edge by 180° and measure again: what turns with it is the edge's."
        }
        (_, Kind::Step) => "Find what happened at that time, and repeat the run.",
        (_, Kind::Drift) => "Repeat the run on another day: a drift that repeats has a cause.",
        (_, Kind::TimeShift) => "Compare the two clocks at the start and the end of a run.",
        (_, Kind::ReferenceInstrument { .. }) => {
            "Measure again with another instrument, or with this one shifted by a third of its \
             period: what shifts with it is its own."
        }
        (_, Kind::Curve { .. }) => "Vary this column alone.",
    };
    text.to_string()
}
