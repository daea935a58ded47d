//! The effect of each cause on an elongation.

use std::f64::consts::TAU;

use super::{
    cause::HiddenCause,
    effect_shape::{
        EffectShape, NamedParameters, PredictedRun, fixed_parameter_effect, linear_effect, map_runs,
    },
    model_equations::{apply_first_order_lag, sinusoid, warmup_heat_fraction},
    spindle_bench::{
        COOLANT_PRESSURE_COLUMN, COOLANT_VALVE_COLUMN, ElongationSource, SpindleBench,
    },
};
use trueup_twin::noise::RandomStream;

/// `law` on each believed value of each run.
fn map_predictions(runs: &[PredictedRun], law: impl Fn(f64) -> f64) -> Vec<Vec<f64>> {
    map_runs(runs, |run| run.believed_um.iter().map(|&p| law(p)).collect())
}

/// Returns the shape of `cause` on `bench`; `None` where it is only noise.
pub(super) fn draw_effect_shape(
    cause: HiddenCause,
    bench: &SpindleBench,
    stream: &mut RandomStream,
) -> Option<EffectShape> {
    let runs = &bench.runs[..];
    let duration_s = runs[0].column("time_s").last().copied().unwrap_or(0.0);
    Some(match cause {
        HiddenCause::CleanWhite | HiddenCause::CleanCorrelated => return None,
        HiddenCause::SensorOffset => {
            linear_effect(cause, "offset_um", map_predictions(runs, |_| 1.0))
        }
        HiddenCause::SensorGain | HiddenCause::GrowthAmplitude => {
            let name = if cause == HiddenCause::SensorGain { "gain" } else { "scale" };
            EffectShape {
                at: Box::new(move |factor| {
                    NamedParameters::from_parameters(&[(name, 1.0 + factor)])
                }),
                ..linear_effect(cause, "", map_predictions(runs, |p| p))
            }
        }
        HiddenCause::SensorCurvature => {
            linear_effect(cause, "per_um", map_predictions(runs, |p| p * p))
        }
        HiddenCause::SensorSaturation => draw_sensor_saturation(runs, stream),
        HiddenCause::SensorTemperatureDrift => {
            lagged_column_effect(cause, runs, "temp_coil_c", 0.0)
        }
        HiddenCause::TimeShift => draw_time_shift(runs, duration_s, stream),
        HiddenCause::ThermalLag | HiddenCause::CoolingAsymmetry => {
            return Some(draw_lag_error(cause, bench, stream));
        }
        HiddenCause::ThermometerLag => {
            let (lag_s, parts_c) = bench.late.as_ref()?;
            let ElongationSource::Temperature { k_um_per_c, reference_c, .. } = &bench.source
            else {
                return None;
            };
            let of = |(run, part_c): (&PredictedRun, &Vec<f64>)| -> Vec<f64> {
                let grown = part_c.iter().map(|c| k_um_per_c * (c - reference_c));
                grown.zip(&run.believed_um).map(|(grown, p)| grown - p).collect()
            };
            let um = runs.iter().zip(parts_c).map(of).collect();
            fixed_parameter_effect(cause, vec![("time_constant_s", *lag_s)], um)
        }
        HiddenCause::SlowMode => return Some(draw_slow_thermal_mode(bench, duration_s, stream)),
        HiddenCause::ExtraHeatPath => {
            let column = stream.choose(&["temp_table_c", "temp_ambient_c"]);
            let lag_s =
                if stream.bernoulli(0.33) { 0.0 } else { stream.uniform(300.0, 3000.0).round() };
            lagged_column_effect(cause, runs, column, lag_s)
        }
        HiddenCause::GrowthRate => draw_time_constant_error(bench, stream)?,
        HiddenCause::CentrifugalGrowth => linear_effect(
            cause,
            "um_per_krpm2",
            map_runs(runs, |run| {
                run.column("spindle_rpm").iter().map(|rpm| (rpm / 1000.0).powi(2)).collect()
            }),
        ),
        // A tool is pushed back by what pushes it: a compliance is never negative.
        HiddenCause::CuttingLoad => EffectShape {
            has_sign: false,
            ..linear_effect(
                cause,
                "um_per_n",
                map_runs(runs, |run| run.column("load_n").iter().map(|load_n| -load_n).collect()),
            )
        },
        HiddenCause::Dependence => return Some(coolant_effect(runs)),
        HiddenCause::ReferenceInstrument => draw_reference_instrument_error(runs, stream),
        HiddenCause::PreloadChange => draw_preload_change(bench, stream),
        HiddenCause::CriticalSpeed => draw_critical_speed(bench, stream),
        HiddenCause::Step
        | HiddenCause::Drift
        | HiddenCause::PeriodicInTime
        | HiddenCause::Outliers => {
            return Some(draw_generic_effect(cause, runs, stream));
        }
        // The rest belongs to axes; `HiddenCause::bases` sends none of them here.
        _ => return None,
    })
}

/// Returns a sensor whose range ends within the growth of the training and of the hold-out.
fn draw_sensor_saturation(runs: &[PredictedRun], stream: &mut RandomStream) -> EffectShape {
    let cause = HiddenCause::SensorSaturation;
    let training = &runs[..runs.len() - 1];
    let exceeded_by = |runs: &[PredictedRun], share: f64| {
        let mut all: Vec<f64> = runs.iter().flat_map(|run| run.believed_um.clone()).collect();
        all.sort_by(f64::total_cmp);
        all[((1.0 - share) * all.len() as f64) as usize]
    };
    // Also the hold-out must reach it, else nothing could be gained there.
    let in_training_um = exceeded_by(training, stream.uniform(0.15, 0.4));
    let limit_um = in_training_um.min(exceeded_by(&runs[training.len()..], 0.15));
    fixed_parameter_effect(
        cause,
        vec![("limit_um", limit_um)],
        map_predictions(runs, |p| (limit_um - p).min(0.0)),
    )
}

/// Returns a shift in time between the readings and the inputs, of a few rows.
fn draw_time_shift(
    runs: &[PredictedRun],
    duration_s: f64,
    stream: &mut RandomStream,
) -> EffectShape {
    let interval_s = duration_s / (runs[0].believed_um.len() - 1) as f64;
    let shift_s = (stream.random_sign() * stream.uniform(1.3, 6.0) * interval_s).round();
    let um = map_runs(runs, |run| {
        let (time_s, p) = (run.column("time_s"), &run.believed_um);
        let shifted = |row: usize| interpolate_at(time_s, p, time_s[row] - shift_s) - p[row];
        (0..p.len()).map(shifted).collect()
    });
    fixed_parameter_effect(HiddenCause::TimeShift, vec![("shift_s", shift_s)], um)
}

/// Returns a growth that has another scale above a speed.
fn draw_preload_change(bench: &SpindleBench, stream: &mut RandomStream) -> EffectShape {
    let above_rpm = (stream.uniform(0.4, 0.65) * bench.max_rpm).round();
    let um = map_runs(&bench.runs, |run| {
        let rows = run.believed_um.iter().zip(run.column("spindle_rpm"));
        rows.map(|(p, &rpm)| if rpm > above_rpm { *p } else { 0.0 }).collect()
    });
    EffectShape {
        at: Box::new(move |factor| {
            NamedParameters::from_parameters(&[("scale", 1.0 + factor), ("above_rpm", above_rpm)])
        }),
        ..linear_effect(HiddenCause::PreloadChange, "", um)
    }
}

/// Another time constant than the believed one, longer or shorter; `None` where the growth is no warm-up.
fn draw_time_constant_error(
    bench: &SpindleBench,
    stream: &mut RandomStream,
) -> Option<EffectShape> {
    let ElongationSource::Warmup(law) = &bench.source else { return None };
    let other = stream.uniform(1.3, 2.0);
    let tau_s =
        law.heating_time_constant_s() * if stream.bernoulli(0.5) { other } else { 1.0 / other };
    let cool_s = law.cool_s.unwrap_or(law.heating_time_constant_s());
    let um = map_runs(&bench.runs, |run| {
        let (time_s, rpm) = (run.column("time_s"), run.column("spindle_rpm"));
        let h = warmup_heat_fraction(time_s, rpm, law.lag_s, tau_s, cool_s);
        h.iter().zip(&run.believed_um).map(|(h, p)| law.max_um * h - p).collect()
    });
    Some(fixed_parameter_effect(HiddenCause::GrowthRate, vec![("time_constant_s", tau_s)], um))
}

/// Returns a reference instrument whose error repeats over its range.
fn draw_reference_instrument_error(
    runs: &[PredictedRun],
    stream: &mut RandomStream,
) -> EffectShape {
    let cause = HiddenCause::ReferenceInstrument;
    let training = &runs[..runs.len() - 1];
    let (low, high) = training
        .iter()
        .flat_map(|run| &run.believed_um)
        .fold((f64::MAX, f64::MIN), |(low, high), &p| (low.min(p), high.max(p)));
    let period_um = (high - low) / stream.uniform(4.0, 10.0);
    let phase_rad = stream.uniform(0.0, std::f64::consts::TAU);
    EffectShape {
        has_sign: false,
        at: Box::new(move |factor| {
            NamedParameters::from_parameters(&[
                ("amplitude_um", factor),
                ("period_um", period_um),
                ("phase_rad", phase_rad),
            ])
        }),
        ..linear_effect(cause, "", map_predictions(runs, |p| sinusoid(p / period_um, phase_rad)))
    }
}

/// Draws a shaft that bows under its unbalance. A bowed shaft stands shorter or, as its bearings' balls are
/// forced to one side, further out. The part of the bow that turns with the unbalance is, by the
/// response of a rotor with damping ζ,
///
/// ```text
/// e = a·r²·(1 − r²)/((1 − r²)² + (2·ζ·r)²)      r = n/n_c
/// ```
///
/// outwards below the critical speed n_c, none at it, and inwards above. No cause turns its sign with
/// the speed: `centrifugal-growth` only rises.
fn draw_critical_speed(bench: &SpindleBench, stream: &mut RandomStream) -> EffectShape {
    let critical_rpm = (stream.uniform(0.45, 0.75) * bench.max_rpm).round();
    let damping = stream.uniform(0.08, 0.2);
    let um = map_runs(&bench.runs, |run| {
        let bow = |rpm: &f64| {
            let square = (rpm / critical_rpm).powi(2);
            let off = 1.0 - square;
            square * off / (off * off + 4.0 * damping * damping * square)
        };
        run.column("spindle_rpm").iter().map(bow).collect()
    });
    EffectShape {
        at: Box::new(move |factor| {
            NamedParameters::from_parameters(&[
                ("amplitude_um", factor),
                ("critical_rpm", critical_rpm),
                ("damping", damping),
            ])
        }),
        ..linear_effect(HiddenCause::CriticalSpeed, "", um)
    }
}

/// Returns what the coolant does by its pressure, or while it is on.
fn coolant_effect(runs: &[PredictedRun]) -> EffectShape {
    let has_pressure = !runs[0].column(COOLANT_PRESSURE_COLUMN).is_empty();
    let column = if has_pressure { COOLANT_PRESSURE_COLUMN } else { COOLANT_VALVE_COLUMN };
    let reference = runs[0].column(column).first().copied().unwrap_or(0.0);
    let zero = if has_pressure { reference } else { 0.0 };
    let um = map_runs(runs, |run| run.column(column).iter().map(|x| x - zero).collect());
    EffectShape {
        column: Some(column.to_string()),
        at: Box::new(move |factor| {
            if has_pressure {
                return NamedParameters::from_parameters(&[("um_per_unit", factor)]);
            }
            let tables = vec![("levels", vec![0.0, 1.0]), ("level_um", vec![0.0, factor])];
            NamedParameters { parameters: Vec::new(), tables }
        }),
        ..linear_effect(HiddenCause::Dependence, "", um)
    }
}

/// c·(lag_τ(T) − T_ref) of `column`, T_ref what it was at the very first row.
fn lagged_column_effect(
    cause: HiddenCause,
    runs: &[PredictedRun],
    column: &'static str,
    lag_s: f64,
) -> EffectShape {
    let reference_c = runs[0].column(column).first().copied().unwrap_or(0.0);
    let um = map_runs(runs, |run| {
        let followed =
            apply_first_order_lag(run.column("time_s"), run.column(column), lag_s, lag_s);
        followed.iter().map(|c| c - reference_c).collect()
    });
    EffectShape {
        column: Some(column.to_string()),
        at: Box::new(move |factor| {
            let mut named = NamedParameters::from_parameters(&[
                ("um_per_c", factor),
                ("reference_c", reference_c),
            ]);
            if cause != HiddenCause::SensorTemperatureDrift {
                named.parameters.push(("time_constant_s", lag_s));
            }
            named
        }),
        ..linear_effect(cause, "", um)
    }
}

/// Returns a lag where there was none, or another one while it falls.
fn draw_lag_error(
    cause: HiddenCause,
    bench: &SpindleBench,
    stream: &mut RandomStream,
) -> EffectShape {
    let runs = &bench.runs[..];
    let other = stream.uniform(1.7, 3.0);
    let other = if stream.bernoulli(0.5) { other } else { 1.0 / other };
    match &bench.source {
        ElongationSource::Warmup(law) => {
            let cool_s = (law.heating_time_constant_s() * other).round();
            let truth = super::model_equations::WarmupLaw { cool_s: Some(cool_s), ..*law };
            let um = map_runs(runs, |run| {
                let grown = truth.growth_um(run.column("time_s"), run.column("spindle_rpm"));
                grown.iter().zip(&run.believed_um).map(|(grown, p)| grown - p).collect()
            });
            fixed_parameter_effect(cause, vec![("time_constant_s", cool_s)], um)
        }
        ElongationSource::Temperature { k_um_per_c, reference_c, lag_s } => {
            let (rising_s, falling_s) = if cause == HiddenCause::ThermalLag {
                let tau_s = stream.log_uniform(300.0, 2500.0).round();
                (tau_s, tau_s)
            } else {
                (*lag_s, (lag_s * other).round())
            };
            let um = map_runs(runs, |run| {
                let (time_s, c) = (run.column("time_s"), run.column("temp_front_c"));
                let followed = apply_first_order_lag(time_s, c, rising_s, falling_s);
                let grown = followed.iter().map(|c| k_um_per_c * (c - reference_c));
                grown.zip(&run.believed_um).map(|(grown, p)| grown - p).collect()
            });
            let shape = fixed_parameter_effect(cause, vec![("time_constant_s", falling_s)], um);
            EffectShape { column: Some("temp_front_c".to_string()), ..shape }
        }
        // `HiddenCause::bases` sends neither cause to a sensor.
        ElongationSource::Sensor { .. } => {
            fixed_parameter_effect(cause, Vec::new(), map_predictions(runs, |_| 0.0))
        }
    }
}

/// Returns a part of the machine that warms up more slowly than what is modelled.
fn draw_slow_thermal_mode(
    bench: &SpindleBench,
    duration_s: f64,
    stream: &mut RandomStream,
) -> EffectShape {
    let runs = &bench.runs[..];
    if let ElongationSource::Temperature { reference_c, .. } = bench.source {
        let tau_s = stream.log_uniform(1500.0, 6000.0).round();
        let um = map_runs(runs, |run| {
            let followed = apply_first_order_lag(
                run.column("time_s"),
                run.column("temp_front_c"),
                tau_s,
                tau_s,
            );
            followed.iter().map(|c| c - reference_c).collect()
        });
        // The motor's thermometer, where there is one, may show the same.
        let training = &runs[..runs.len() - 1];
        let motor = |lag_s: f64| -> Vec<f64> {
            let of = |run: &PredictedRun| {
                apply_first_order_lag(
                    run.column("time_s"),
                    run.column("temp_motor_c"),
                    lag_s,
                    lag_s,
                )
            };
            training.iter().flat_map(of).collect()
        };
        let has_motor = !runs[0].column("temp_motor_c").is_empty();
        let lags_s = (0..24).filter(|_| has_motor).map(|n| 100.0 * 1.25_f64.powi(n));
        return EffectShape {
            imitators: lags_s.map(|lag_s| (HiddenCause::ExtraHeatPath, motor(lag_s))).collect(),
            column: Some("temp_front_c".to_string()),
            at: Box::new(move |factor| {
                NamedParameters::from_parameters(&[
                    ("um_per_c", factor),
                    ("time_constant_s", tau_s),
                    ("reference_c", reference_c),
                ])
            }),
            ..linear_effect(HiddenCause::SlowMode, "", um)
        };
    }
    let tau_s = (duration_s * stream.uniform(0.06, 0.22)).round();
    let um = map_runs(runs, |run| {
        run.column("time_s").iter().map(|time_s| 1.0 - (-time_s / tau_s).exp()).collect()
    });
    EffectShape {
        at: Box::new(move |factor| {
            NamedParameters::from_parameters(&[
                ("amplitude_um", factor),
                ("time_constant_s", tau_s),
            ])
        }),
        ..linear_effect(HiddenCause::SlowMode, "", um)
    }
}

/// Returns what may befall any series, whatever it is of.
pub(super) fn draw_generic_effect(
    cause: HiddenCause,
    runs: &[PredictedRun],
    stream: &mut RandomStream,
) -> EffectShape {
    match cause {
        HiddenCause::Step => {
            let time_s = runs[0].column("time_s");
            let row = (stream.uniform(0.3, 0.7) * time_s.len() as f64) as usize;
            let at_s = time_s[row];
            let um = map_runs(runs, |run| {
                run.column("time_s").iter().map(|&t| if t > at_s { 1.0 } else { 0.0 }).collect()
            });
            EffectShape {
                at: Box::new(move |factor| {
                    NamedParameters::from_parameters(&[("at_s", at_s), ("size_um", factor)])
                }),
                ..linear_effect(cause, "", um)
            }
        }
        HiddenCause::DriftByRun => {
            linear_effect(cause, "um_per_run", map_runs(runs, |run| run.column("run").to_vec()))
        }
        HiddenCause::Drift => linear_effect(
            cause,
            "um_per_h",
            map_runs(runs, |run| run.column("time_s").iter().map(|t| t / 3600.0).collect()),
        ),
        HiddenCause::PeriodicInTime => {
            let time_s = runs[0].column("time_s");
            let record_s = time_s[time_s.len() - 1] - time_s[0];
            let interval_s = record_s / (time_s.len() - 1) as f64;
            let period_s = stream.log_uniform(20.0 * interval_s, record_s / 6.0);
            let phase = stream.uniform(0.0, TAU);
            let sinusoid = |t: &f64| (TAU * t / period_s + phase).sin();
            // The phase has it: half a period more is the other sign.
            EffectShape {
                has_sign: false,
                at: Box::new(move |factor| {
                    NamedParameters::from_parameters(&[
                        ("period_s", period_s),
                        ("amplitude_um", factor),
                    ])
                }),
                ..linear_effect(
                    cause,
                    "",
                    map_runs(runs, |run| run.column("time_s").iter().map(sinusoid).collect()),
                )
            }
        }
        _ => {
            let fraction = stream.uniform(0.008, 0.03);
            let both = stream.bernoulli(0.5);
            let um = runs
                .iter()
                .map(|run| {
                    let mut um: Vec<f64> = vec![0.0; run.believed_um.len()];
                    let count = (fraction * um.len() as f64).ceil() as usize;
                    for _ in 0..count.max(3) {
                        let row = stream.uniform_integer(0, um.len() - 1);
                        let sign = if both { stream.random_sign() } else { 1.0 };
                        um[row] = sign * stream.uniform(1.0, 1.5);
                    }
                    um
                })
                .collect::<Vec<_>>();
            let hit: usize = um[..um.len() - 1].iter().flatten().filter(|um| **um != 0.0).count();
            let rows: usize = um[..um.len() - 1].iter().map(Vec::len).sum();
            let fraction = hit as f64 / rows as f64;
            EffectShape {
                at: Box::new(move |_| NamedParameters::from_parameters(&[("fraction", fraction)])),
                ..linear_effect(cause, "", um)
            }
        }
    }
}

/// `p` at a time, straight between the rows and held outside.
fn interpolate_at(time_s: &[f64], p: &[f64], at_s: f64) -> f64 {
    let above = time_s.partition_point(|&there| there <= at_s);
    match (above.checked_sub(1), above < p.len()) {
        (None, _) => p[0],
        (Some(below), false) => p[below],
        (Some(below), true) => {
            let share = (at_s - time_s[below]) / (time_s[above] - time_s[below]);
            p[below] + (p[above] - p[below]) * share
        }
    }
}
