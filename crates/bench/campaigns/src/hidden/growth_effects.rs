//! The effect of each cause on an elongation.

use std::f64::consts::TAU;

use super::{
    cause::Hidden,
    elongation::{Bench, COOLANT_PRESSURE, COOLANT_SWITCH, ElongationSource},
    laws::{lagged, warmup_heat, wave},
    shape::{Named, Run, Shape, fixed, linear, on_each},
};
use trueup_twin::noise::Stream;

/// `law` on each believed value of each run.
fn on_believed(runs: &[Run], law: impl Fn(f64) -> f64) -> Vec<Vec<f64>> {
    on_each(runs, |run| run.believed_um.iter().map(|&p| law(p)).collect())
}

/// Returns the shape of `cause` on `bench`; `None` where it is only noise.
pub(super) fn shape(cause: Hidden, bench: &Bench, stream: &mut Stream) -> Option<Shape> {
    let runs = &bench.runs[..];
    let first = &runs[0];
    let duration_s = first.column("time_s").last().copied().unwrap_or(0.0);
    Some(match cause {
        Hidden::CleanWhite | Hidden::CleanCorrelated => return None,
        Hidden::SensorOffset => linear(cause, "offset_um", on_believed(runs, |_| 1.0)),
        Hidden::SensorGain => Shape {
            at: Box::new(|factor| Named::of(&[("gain", 1.0 + factor)])),
            ..linear(cause, "", on_believed(runs, |p| p))
        },
        Hidden::GrowthAmplitude => Shape {
            at: Box::new(|factor| Named::of(&[("scale", 1.0 + factor)])),
            ..linear(cause, "", on_believed(runs, |p| p))
        },
        Hidden::SensorCurvature => linear(cause, "per_um", on_believed(runs, |p| p * p)),
        Hidden::SensorSaturation => saturation(runs, stream),
        Hidden::SensorTemperatureDrift => by_column(cause, runs, "temp_coil_c", 0.0),
        Hidden::TimeShift => {
            let interval_s = duration_s / (first.believed_um.len() - 1) as f64;
            let shift_s = (stream.sign() * stream.uniform(1.3, 6.0) * interval_s).round();
            let um = on_each(runs, |run| {
                let (time_s, p) = (run.column("time_s"), &run.believed_um);
                let shifted = |row: usize| at_time(time_s, p, time_s[row] - shift_s) - p[row];
                (0..p.len()).map(shifted).collect()
            });
            fixed(cause, vec![("shift_s", shift_s)], um)
        }
        Hidden::ThermalLag | Hidden::CoolingAsymmetry => {
            return Some(other_lag(cause, bench, stream));
        }
        Hidden::ThermometerLag => {
            let (lag_s, parts_c) = bench.late.as_ref()?;
            let ElongationSource::Temperature { k_um_per_c, reference_c, .. } = &bench.source
            else {
                return None;
            };
            let of = |(run, part_c): (&Run, &Vec<f64>)| -> Vec<f64> {
                let grown = part_c.iter().map(|c| k_um_per_c * (c - reference_c));
                grown.zip(&run.believed_um).map(|(grown, p)| grown - p).collect()
            };
            let um = runs.iter().zip(parts_c).map(of).collect();
            fixed(cause, vec![("time_constant_s", *lag_s)], um)
        }
        Hidden::SlowMode => return Some(slow_mode(bench, duration_s, stream)),
        Hidden::ExtraHeatPath => {
            let column = stream.pick(&["temp_table_c", "temp_ambient_c"]);
            let lag_s =
                if stream.chance(0.33) { 0.0 } else { stream.uniform(300.0, 3000.0).round() };
            by_column(cause, runs, column, lag_s)
        }
        Hidden::GrowthRate => growth_rate(bench, stream)?,
        Hidden::CentrifugalGrowth => linear(
            cause,
            "um_per_krpm2",
            on_each(runs, |run| {
                run.column("spindle_rpm").iter().map(|rpm| (rpm / 1000.0).powi(2)).collect()
            }),
        ),
        // A tool is pushed back by what pushes it: a compliance is never negative.
        Hidden::CuttingLoad => Shape {
            has_sign: false,
            ..linear(
                cause,
                "um_per_n",
                on_each(runs, |run| run.column("load_n").iter().map(|load_n| -load_n).collect()),
            )
        },
        Hidden::Dependence => return Some(on_coolant(runs)),
        Hidden::ReferenceInstrument => instrument(runs, stream),
        Hidden::PreloadChange => {
            let above_rpm = (stream.uniform(0.4, 0.65) * bench.max_rpm).round();
            let um = on_each(runs, |run| {
                let rows = run.believed_um.iter().zip(run.column("spindle_rpm"));
                rows.map(|(p, &rpm)| if rpm > above_rpm { *p } else { 0.0 }).collect()
            });
            Shape {
                at: Box::new(move |factor| {
                    Named::of(&[("scale", 1.0 + factor), ("above_rpm", above_rpm)])
                }),
                ..linear(cause, "", um)
            }
        }
        Hidden::CriticalSpeed => critical_speed(bench, stream),
        Hidden::Step | Hidden::Drift | Hidden::PeriodicInTime | Hidden::Outliers => {
            return Some(of_any_series(cause, runs, stream));
        }
        // The rest belongs to axes; `Hidden::bases` sends none of them here.
        _ => return None,
    })
}

/// Returns a sensor whose range ends within the growth of the training and of the hold-out.
fn saturation(runs: &[Run], stream: &mut Stream) -> Shape {
    let cause = Hidden::SensorSaturation;
    let training = &runs[..runs.len() - 1];
    let exceeded_by = |runs: &[Run], share: f64| {
        let mut all: Vec<f64> = runs.iter().flat_map(|run| run.believed_um.clone()).collect();
        all.sort_by(f64::total_cmp);
        all[((1.0 - share) * all.len() as f64) as usize]
    };
    // Also the hold-out must reach it, else nothing could be gained there.
    let in_training_um = exceeded_by(training, stream.uniform(0.15, 0.4));
    let limit_um = in_training_um.min(exceeded_by(&runs[training.len()..], 0.15));
    fixed(cause, vec![("limit_um", limit_um)], on_believed(runs, |p| (limit_um - p).min(0.0)))
}

/// Another time constant than the believed one, longer or shorter; `None` where the growth is no warm-up.
fn growth_rate(bench: &Bench, stream: &mut Stream) -> Option<Shape> {
    let ElongationSource::Warmup(law) = &bench.source else { return None };
    let other = stream.uniform(1.3, 2.0);
    let tau_s = law.heating_s() * if stream.chance(0.5) { other } else { 1.0 / other };
    let cool_s = law.cool_s.unwrap_or(law.heating_s());
    let um = on_each(&bench.runs, |run| {
        let (time_s, rpm) = (run.column("time_s"), run.column("spindle_rpm"));
        let h = warmup_heat(time_s, rpm, law.lag_s, tau_s, cool_s);
        h.iter().zip(&run.believed_um).map(|(h, p)| law.max_um * h - p).collect()
    });
    Some(fixed(Hidden::GrowthRate, vec![("time_constant_s", tau_s)], um))
}

/// Returns a reference instrument whose error repeats over its range.
fn instrument(runs: &[Run], stream: &mut Stream) -> Shape {
    let cause = Hidden::ReferenceInstrument;
    let training = &runs[..runs.len() - 1];
    let (low, high) = training
        .iter()
        .flat_map(|run| &run.believed_um)
        .fold((f64::MAX, f64::MIN), |(low, high), &p| (low.min(p), high.max(p)));
    let period_um = (high - low) / stream.uniform(4.0, 10.0);
    let phase_rad = stream.uniform(0.0, std::f64::consts::TAU);
    Shape {
        has_sign: false,
        at: Box::new(move |factor| {
            Named::of(&[
                ("amplitude_um", factor),
                ("period_um", period_um),
                ("phase_rad", phase_rad),
            ])
        }),
        ..linear(cause, "", on_believed(runs, |p| wave(p / period_um, phase_rad)))
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
fn critical_speed(bench: &Bench, stream: &mut Stream) -> Shape {
    let critical_rpm = (stream.uniform(0.45, 0.75) * bench.max_rpm).round();
    let damping = stream.uniform(0.08, 0.2);
    let um = on_each(&bench.runs, |run| {
        let bow = |rpm: &f64| {
            let square = (rpm / critical_rpm).powi(2);
            let off = 1.0 - square;
            square * off / (off * off + 4.0 * damping * damping * square)
        };
        run.column("spindle_rpm").iter().map(bow).collect()
    });
    Shape {
        at: Box::new(move |factor| {
            Named::of(&[
                ("amplitude_um", factor),
                ("critical_rpm", critical_rpm),
                ("damping", damping),
            ])
        }),
        ..linear(Hidden::CriticalSpeed, "", um)
    }
}

/// Returns what the coolant does by its pressure, or while it is on.
fn on_coolant(runs: &[Run]) -> Shape {
    let has_pressure = !runs[0].column(COOLANT_PRESSURE).is_empty();
    let column = if has_pressure { COOLANT_PRESSURE } else { COOLANT_SWITCH };
    let reference = runs[0].column(column).first().copied().unwrap_or(0.0);
    let zero = if has_pressure { reference } else { 0.0 };
    let um = on_each(runs, |run| run.column(column).iter().map(|x| x - zero).collect());
    Shape {
        column: Some(column.to_string()),
        at: Box::new(move |factor| {
            if has_pressure {
                return Named::of(&[("um_per_unit", factor)]);
            }
            let tables = vec![("levels", vec![0.0, 1.0]), ("level_um", vec![0.0, factor])];
            Named { parameters: Vec::new(), tables }
        }),
        ..linear(Hidden::Dependence, "", um)
    }
}

/// c·(lag_τ(T) − T_ref) of `column`, T_ref what it was at the very first row.
fn by_column(cause: Hidden, runs: &[Run], column: &'static str, lag_s: f64) -> Shape {
    let reference_c = runs[0].column(column).first().copied().unwrap_or(0.0);
    let um = on_each(runs, |run| {
        let followed = lagged(run.column("time_s"), run.column(column), lag_s, lag_s);
        followed.iter().map(|c| c - reference_c).collect()
    });
    Shape {
        column: Some(column.to_string()),
        at: Box::new(move |factor| {
            let mut named = Named::of(&[("um_per_c", factor), ("reference_c", reference_c)]);
            if cause != Hidden::SensorTemperatureDrift {
                named.parameters.push(("time_constant_s", lag_s));
            }
            named
        }),
        ..linear(cause, "", um)
    }
}

/// Returns a lag where there was none, or another one while it falls.
fn other_lag(cause: Hidden, bench: &Bench, stream: &mut Stream) -> Shape {
    let runs = &bench.runs[..];
    let other = stream.uniform(1.7, 3.0);
    let other = if stream.chance(0.5) { other } else { 1.0 / other };
    match &bench.source {
        ElongationSource::Warmup(law) => {
            let cool_s = (law.heating_s() * other).round();
            let truth = super::laws::WarmupLaw { cool_s: Some(cool_s), ..*law };
            let um = on_each(runs, |run| {
                let grown = truth.growth_um(run.column("time_s"), run.column("spindle_rpm"));
                grown.iter().zip(&run.believed_um).map(|(grown, p)| grown - p).collect()
            });
            fixed(cause, vec![("time_constant_s", cool_s)], um)
        }
        ElongationSource::Temperature { k_um_per_c, reference_c, lag_s } => {
            let (rising_s, falling_s) = if cause == Hidden::ThermalLag {
                let tau_s = stream.log_uniform(300.0, 2500.0).round();
                (tau_s, tau_s)
            } else {
                (*lag_s, (lag_s * other).round())
            };
            let um = on_each(runs, |run| {
                let (time_s, c) = (run.column("time_s"), run.column("temp_front_c"));
                let followed = lagged(time_s, c, rising_s, falling_s);
                let grown = followed.iter().map(|c| k_um_per_c * (c - reference_c));
                grown.zip(&run.believed_um).map(|(grown, p)| grown - p).collect()
            });
            let shape = fixed(cause, vec![("time_constant_s", falling_s)], um);
            Shape { column: Some("temp_front_c".to_string()), ..shape }
        }
        // `Hidden::bases` sends neither cause to a sensor.
        ElongationSource::Sensor { .. } => fixed(cause, Vec::new(), on_believed(runs, |_| 0.0)),
    }
}

/// Returns a part of the machine that warms up more slowly than what is modelled.
fn slow_mode(bench: &Bench, duration_s: f64, stream: &mut Stream) -> Shape {
    let runs = &bench.runs[..];
    if let ElongationSource::Temperature { reference_c, .. } = bench.source {
        let tau_s = stream.log_uniform(1500.0, 6000.0).round();
        let um = on_each(runs, |run| {
            let followed = lagged(run.column("time_s"), run.column("temp_front_c"), tau_s, tau_s);
            followed.iter().map(|c| c - reference_c).collect()
        });
        // The motor's thermometer, where there is one, may tell the same tale.
        let training = &runs[..runs.len() - 1];
        let motor = |lag_s: f64| -> Vec<f64> {
            let of =
                |run: &Run| lagged(run.column("time_s"), run.column("temp_motor_c"), lag_s, lag_s);
            training.iter().flat_map(of).collect()
        };
        let has_motor = !runs[0].column("temp_motor_c").is_empty();
        let lags_s = (0..24).filter(|_| has_motor).map(|n| 100.0 * 1.25_f64.powi(n));
        return Shape {
            imitators: lags_s.map(|lag_s| (Hidden::ExtraHeatPath, motor(lag_s))).collect(),
            column: Some("temp_front_c".to_string()),
            at: Box::new(move |factor| {
                Named::of(&[
                    ("um_per_c", factor),
                    ("time_constant_s", tau_s),
                    ("reference_c", reference_c),
                ])
            }),
            ..linear(Hidden::SlowMode, "", um)
        };
    }
    let tau_s = (duration_s * stream.uniform(0.06, 0.22)).round();
    let um = on_each(runs, |run| {
        run.column("time_s").iter().map(|time_s| 1.0 - (-time_s / tau_s).exp()).collect()
    });
    Shape {
        at: Box::new(move |factor| {
            Named::of(&[("amplitude_um", factor), ("time_constant_s", tau_s)])
        }),
        ..linear(Hidden::SlowMode, "", um)
    }
}

/// Returns what may befall any series, whatever it is of.
pub(super) fn of_any_series(cause: Hidden, runs: &[Run], stream: &mut Stream) -> Shape {
    match cause {
        Hidden::Step => {
            let time_s = runs[0].column("time_s");
            let row = (stream.uniform(0.3, 0.7) * time_s.len() as f64) as usize;
            let at_s = time_s[row];
            let um = on_each(runs, |run| {
                run.column("time_s").iter().map(|&t| if t > at_s { 1.0 } else { 0.0 }).collect()
            });
            Shape {
                at: Box::new(move |factor| Named::of(&[("at_s", at_s), ("size_um", factor)])),
                ..linear(cause, "", um)
            }
        }
        Hidden::DriftByRun => {
            linear(cause, "um_per_run", on_each(runs, |run| run.column("run").to_vec()))
        }
        Hidden::Drift => linear(
            cause,
            "um_per_h",
            on_each(runs, |run| run.column("time_s").iter().map(|t| t / 3600.0).collect()),
        ),
        Hidden::PeriodicInTime => {
            let time_s = runs[0].column("time_s");
            let record_s = time_s[time_s.len() - 1] - time_s[0];
            let interval_s = record_s / (time_s.len() - 1) as f64;
            let period_s = stream.log_uniform(20.0 * interval_s, record_s / 6.0);
            let phase = stream.uniform(0.0, TAU);
            let wave = |t: &f64| (TAU * t / period_s + phase).sin();
            // The phase has it: half a period more is the other sign.
            Shape {
                has_sign: false,
                at: Box::new(move |factor| {
                    Named::of(&[("period_s", period_s), ("amplitude_um", factor)])
                }),
                ..linear(
                    cause,
                    "",
                    on_each(runs, |run| run.column("time_s").iter().map(wave).collect()),
                )
            }
        }
        _ => {
            let fraction = stream.uniform(0.008, 0.03);
            let both = stream.chance(0.5);
            let um = runs
                .iter()
                .map(|run| {
                    let mut um: Vec<f64> = vec![0.0; run.believed_um.len()];
                    let count = (fraction * um.len() as f64).ceil() as usize;
                    for _ in 0..count.max(3) {
                        let row = stream.whole(0, um.len() - 1);
                        let sign = if both { stream.sign() } else { 1.0 };
                        um[row] = sign * stream.uniform(1.0, 1.5);
                    }
                    um
                })
                .collect::<Vec<_>>();
            let hit: usize = um[..um.len() - 1].iter().flatten().filter(|um| **um != 0.0).count();
            let rows: usize = um[..um.len() - 1].iter().map(Vec::len).sum();
            let fraction = hit as f64 / rows as f64;
            Shape {
                at: Box::new(move |_| Named::of(&[("fraction", fraction)])),
                ..linear(cause, "", um)
            }
        }
    }
}

/// `p` at a time, straight between the rows and held outside.
fn at_time(time_s: &[f64], p: &[f64], at_s: f64) -> f64 {
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
