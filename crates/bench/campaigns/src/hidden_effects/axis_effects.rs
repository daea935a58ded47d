//! The effect of each cause on the error of an axis.

use super::{
    axis_bench::{AxisBench, draw_detrended_random_walk},
    cause::HiddenCause,
    effect_shape::{
        EffectShape, NamedParameters, PredictedRun, fixed_parameter_effect, linear_effect, map_runs,
    },
    growth_effects::draw_generic_effect,
    model_equations::{
        apply_first_order_lag, clamped_uniform_knots, evaluate_spline, fit_line,
        interpolate_uniform_table, sinusoid,
    },
};
use trueup_twin::{axes::AXIS_NAMES as AXES, noise::RandomStream};

/// Returns the shape of `cause` on `bench`; `None` where it is only noise.
pub(super) fn draw_effect_shape(
    cause: HiddenCause,
    bench: &AxisBench,
    stream: &mut RandomStream,
) -> Option<EffectShape> {
    let runs = &bench.runs[..];
    let mm = |axis: usize| format!("{}_mm", AXES[axis]);
    let (main_mm, other_mm) = (mm(bench.main), mm(bench.other));
    let along = |law: &dyn Fn(f64, f64) -> f64| evaluate_law_along_axis(bench, law);
    let where_reverse = |d: f64| if d < 0.0 { 1.0 } else { 0.0 };
    Some(match cause {
        HiddenCause::ThermalLag
        | HiddenCause::ExpansionConstant
        | HiddenCause::ExpansionSlope
        | HiddenCause::ReferenceTemperature => {
            return draw_thermal_error(cause, bench, stream);
        }
        HiddenCause::PitchScale => linear_effect(cause, "um_per_m", along(&|mm, _| mm / 1000.0)),
        HiddenCause::Backlash => linear_effect(cause, "width_um", along(&|_, d| where_reverse(d))),
        HiddenCause::PositionDependentBacklash => {
            linear_effect(cause, "um_per_m", along(&|mm, d| mm / 1000.0 * where_reverse(d)))
        }
        HiddenCause::FeedDependentBacklash => draw_feed_dependent_backlash(bench, stream),
        HiddenCause::PitchError => draw_pitch_error(bench, stream)?,
        HiddenCause::PitchPeriodic => draw_periodic_pitch_error(bench, stream),
        HiddenCause::Straightness => {
            let (knots, controls) = draw_detrended_spline(bench, stream);
            let um = along(&|mm, _| evaluate_spline(&knots, &controls, mm));
            EffectShape {
                column: Some(main_mm.clone()),
                at: Box::new(move |factor| NamedParameters {
                    parameters: Vec::new(),
                    tables: vec![
                        ("knots_mm", knots.clone()),
                        ("control_um", controls.iter().map(|um| factor * um).collect()),
                    ],
                }),
                ..linear_effect(cause, "", um)
            }
        }
        HiddenCause::CrossAxis => {
            let um =
                map_runs(runs, |run| run.column(&other_mm).iter().map(|mm| mm / 1000.0).collect());
            EffectShape { column: Some(other_mm.clone()), ..linear_effect(cause, "um_per_m", um) }
        }
        HiddenCause::ReferenceInstrument => draw_reference_instrument_error(bench, stream),
        HiddenCause::PreSliding => return draw_pre_sliding_error(bench, stream),
        HiddenCause::Abbe => {
            let (knots, controls) = draw_detrended_spline(bench, stream);
            tilt_effect(cause, bench, &|mm| evaluate_spline(&knots, &controls, mm), 0.0, {
                let (knots, controls) = (knots.clone(), controls.clone());
                move |factor| tilt_parameters(&knots, &controls, factor)
            })
        }
        HiddenCause::AngularError => draw_angular_error(bench, stream),
        HiddenCause::AxisExpansion => draw_axis_expansion(bench, stream),
        HiddenCause::Step
        | HiddenCause::Drift
        | HiddenCause::DriftByRun
        | HiddenCause::Outliers => draw_generic_effect(cause, runs, stream),
        // The rest is noise, or belongs to elongations; `HiddenCause::bases` sends none of them here.
        _ => return None,
    })
}

/// Computes a law of the position on the main axis, in mm, and the direction of approach in each row of each run.
fn evaluate_law_along_axis(bench: &AxisBench, law: &dyn Fn(f64, f64) -> f64) -> Vec<Vec<f64>> {
    let main_mm = format!("{}_mm", AXES[bench.main]);
    let direction = format!("dir_{}", AXES[bench.error]);
    map_runs(&bench.runs, |run| {
        let rows = run.column(&main_mm).iter().zip(run.column(&direction));
        rows.map(|(&mm, &d)| law(mm, d)).collect()
    })
}

/// Returns an uneven scale or screw, with a table for each direction; `None` where the path has no even targets.
fn draw_pitch_error(bench: &AxisBench, stream: &mut RandomStream) -> Option<EffectShape> {
    let (start_mm, step_mm, count) = bench.grid?;
    let forward = draw_detrended_random_walk(count, 1.0, stream);
    let own = draw_detrended_random_walk(count, 0.6, stream);
    let reverse: Vec<f64> = forward.iter().zip(&own).map(|(f, o)| f + o).collect();
    let um = evaluate_law_along_axis(bench, &|mm, d| {
        interpolate_uniform_table(start_mm, step_mm, if d < 0.0 { &reverse } else { &forward }, mm)
    });
    Some(EffectShape {
        at: Box::new(move |factor| {
            let scaled = |table: &[f64]| table.iter().map(|um| factor * um).collect();
            NamedParameters {
                parameters: vec![("start_mm", start_mm), ("step_mm", step_mm)],
                tables: vec![("forward_um", scaled(&forward)), ("reverse_um", scaled(&reverse))],
            }
        }),
        ..linear_effect(HiddenCause::PitchError, "", um)
    })
}

/// Returns an error that repeats with each turn or graduation, with its second harmonic.
fn draw_periodic_pitch_error(bench: &AxisBench, stream: &mut RandomStream) -> EffectShape {
    let length_mm = bench.travel_mm[1] - bench.travel_mm[0];
    let period_mm = stream.log_uniform(2.0, 20.0_f64.min(length_mm / 6.0));
    let second = if stream.bernoulli(0.5) { 0.0 } else { stream.uniform(0.2, 0.5) };
    let phase_rad = stream.uniform(0.0, std::f64::consts::TAU);
    let second_rad = stream.uniform(0.0, std::f64::consts::TAU);
    let um = evaluate_law_along_axis(bench, &|mm, _| {
        let turns = mm / period_mm;
        sinusoid(turns, phase_rad) + second * sinusoid(2.0 * turns, second_rad)
    });
    EffectShape {
        has_sign: false,
        at: Box::new(move |factor| {
            NamedParameters::from_parameters(&[
                ("amplitude_um", factor),
                ("period_mm", period_mm),
                ("phase_rad", phase_rad),
                ("second_amplitude_um", factor * second),
                ("second_phase_rad", second_rad),
            ])
        }),
        ..linear_effect(HiddenCause::PitchPeriodic, "", um)
    }
}

/// Returns an axis that tilts along its way: in proportion to the position, or by a curve.
fn draw_angular_error(bench: &AxisBench, stream: &mut RandomStream) -> EffectShape {
    let lever_zero_mm =
        if stream.bernoulli(0.5) { 0.0 } else { stream.uniform(0.0, 400.0).round() };
    let origin = ("origin_mm", lever_zero_mm);
    if stream.bernoulli(0.5) {
        tilt_effect(
            HiddenCause::AngularError,
            bench,
            &|mm| mm / 1000.0,
            lever_zero_mm,
            move |factor| NamedParameters::from_parameters(&[("urad_per_m", factor), origin]),
        )
    } else {
        let (knots, controls) = draw_detrended_spline(bench, stream);
        tilt_effect(
            HiddenCause::AngularError,
            bench,
            &|mm| evaluate_spline(&knots, &controls, mm),
            lever_zero_mm,
            {
                let (knots, controls) = (knots.clone(), controls.clone());
                move |factor| NamedParameters {
                    parameters: vec![origin],
                    ..tilt_parameters(&knots, &controls, factor)
                }
            },
        )
    }
}

/// Another width at each feed, wider the faster the axis comes: its friction and its mass take up more.
fn draw_feed_dependent_backlash(bench: &AxisBench, stream: &mut RandomStream) -> EffectShape {
    let feeds = bench.feeds_mm_per_min.clone();
    let mut width = stream.uniform(0.0, 1.0);
    let mut widths = vec![width];
    for _ in 1..feeds.len() {
        width += stream.uniform(0.6, 1.4);
        widths.push(width);
    }
    let direction = format!("dir_{}", AXES[bench.error]);
    let um = map_runs(&bench.runs, |run| {
        let rows = run.column("feed_mm_per_min").iter().zip(run.column(&direction));
        rows.map(|(feed, direction)| {
            let of_feed = feeds.iter().position(|there| there == feed);
            if *direction < 0.0 { of_feed.map_or(0.0, |number| widths[number]) } else { 0.0 }
        })
        .collect()
    });
    EffectShape {
        column: Some("feed_mm_per_min".into()),
        at: Box::new(move |factor| NamedParameters {
            parameters: Vec::new(),
            tables: vec![
                ("feeds_mm_per_min", feeds.clone()),
                ("width_um", widths.iter().map(|um| factor * um).collect()),
            ],
        }),
        ..linear_effect(HiddenCause::FeedDependentBacklash, "", um)
    }
}

/// Returns what the axis's heat does otherwise than believed.
fn draw_thermal_error(
    cause: HiddenCause,
    bench: &AxisBench,
    stream: &mut RandomStream,
) -> Option<EffectShape> {
    let law = bench.thermal.as_ref()?;
    let position = format!("{}_mm", AXES[bench.error]);
    let follow = |run: &PredictedRun, lag_s: f64| {
        apply_first_order_lag(run.column("time_s"), run.column("temp_screw_c"), lag_s, lag_s)
    };
    let apart = |other: &dyn Fn(f64, f64) -> f64, from_s: f64| {
        map_runs(&bench.runs, |run| {
            let (believed_c, true_c) = (follow(run, from_s), follow(run, law.true_lag_s));
            let rows = run.column(&position).iter().enumerate();
            rows.map(|(row, &mm)| other(true_c[row], mm) - law.error_um(believed_c[row], mm))
                .collect()
        })
    };
    let shape = match cause {
        HiddenCause::ThermalLag => {
            let tau_s = law.true_lag_s;
            fixed_parameter_effect(
                cause,
                vec![("time_constant_s", tau_s)],
                apart(&|c, mm| law.error_um(c, mm), law.lag_s),
            )
        }
        HiddenCause::ReferenceTemperature => {
            let shift_c = stream.random_sign() * stream.uniform(0.7, 3.0);
            // Next to a hidden lag it is that of the temperature which the axis follows.
            let um = apart(&|c, mm| law.error_um(c - shift_c, mm), law.true_lag_s);
            let mut shape = fixed_parameter_effect(cause, vec![("shift_c", shift_c)], um);
            let training = &bench.runs[..bench.runs.len() - 1];
            let mm = training.iter().flat_map(|run| run.column(&position).to_vec()).collect();
            shape.imitators.push((HiddenCause::PitchScale, mm));
            shape
        }
        HiddenCause::ExpansionConstant => {
            let shifting = |c: f64, mm: f64| law.error_um(c, mm) + (c - law.reference_c);
            let constant = law.constant_um_per_c;
            EffectShape {
                at: Box::new(move |factor| {
                    NamedParameters::from_parameters(&[("um_per_c", constant + factor)])
                }),
                ..linear_effect(cause, "", apart(&shifting, law.true_lag_s))
            }
        }
        // Next to a hidden lag the slope is that over the temperature that the axis follows.
        _ => {
            let steeper = |c: f64, mm: f64| {
                law.error_um(c, mm) + (c - law.reference_c) * (mm - law.origin_mm) / 1000.0
            };
            let slope = law.slope_um_per_m_per_c;
            EffectShape {
                at: Box::new(move |factor| {
                    NamedParameters::from_parameters(&[("um_per_m_per_c", slope + factor)])
                }),
                ..linear_effect(cause, "", apart(&steeper, law.true_lag_s))
            }
        }
    };
    Some(EffectShape { column: Some("temp_screw_c".into()), ..shape })
}

/// Returns a smooth curve over the main axis, as knots and control points, whose best straight line over the
/// training rows is 0: a slope would be another cause.
fn draw_detrended_spline(bench: &AxisBench, stream: &mut RandomStream) -> (Vec<f64>, Vec<f64>) {
    let [low, high] = bench.travel_mm;
    let controls = stream.uniform_integer(6, 10);
    let knots = clamped_uniform_knots(low, high, controls);
    let mut control: Vec<f64> = (0..controls).map(|_| stream.standard_normal()).collect();
    let training = &bench.runs[..bench.runs.len() - 1];
    let column = format!("{}_mm", AXES[bench.main]);
    let mm: Vec<f64> = training.iter().flat_map(|run| run.column(&column).to_vec()).collect();
    let um: Vec<f64> = mm.iter().map(|&mm| evaluate_spline(&knots, &control, mm)).collect();
    let (level, slope) = fit_line(&mm, &um);
    for (i, um) in control.iter_mut().enumerate() {
        // A straight line's control points lie on it at the means of the inner knots.
        let at_mm = knots[i + 1..i + 4].iter().sum::<f64>() / 3.0;
        *um -= level + slope * at_mm;
    }
    (knots, control)
}

/// Returns the tilt `urad` at a position of the main axis, times the lever along the other one, which is 0
/// at `lever_zero_mm`.
fn tilt_effect(
    cause: HiddenCause,
    bench: &AxisBench,
    urad: &dyn Fn(f64) -> f64,
    lever_zero_mm: f64,
    at: impl Fn(f64) -> NamedParameters + 'static,
) -> EffectShape {
    let (main_mm, lever_mm) =
        (format!("{}_mm", AXES[bench.main]), format!("{}_mm", AXES[bench.other]));
    let um = map_runs(&bench.runs, |run| {
        let rows = run.column(&main_mm).iter().zip(run.column(&lever_mm));
        rows.map(|(&mm, &lever_mm)| urad(mm) * (lever_mm - lever_zero_mm) / 1000.0).collect()
    });
    EffectShape { column: Some(lever_mm), at: Box::new(at), ..linear_effect(cause, "", um) }
}

/// θ in µrad as a spline over the travel.
fn tilt_parameters(knots: &[f64], controls: &[f64], factor: f64) -> NamedParameters {
    NamedParameters {
        parameters: Vec::new(),
        tables: vec![
            ("knots_mm", knots.to_vec()),
            ("control_urad", controls.iter().map(|urad| factor * urad).collect()),
        ],
    }
}

/// Draws a screw or a scale that grows with its temperature, which follows its thermometer late or at once, while
/// the machine file says nothing of it. A warm part is longer: c is never negative.
fn draw_axis_expansion(bench: &AxisBench, stream: &mut RandomStream) -> EffectShape {
    let tau_s =
        if stream.bernoulli(0.33) { 0.0 } else { stream.log_uniform(100.0, 2500.0).round() };
    let reference_c = stream.uniform(18.0, 22.0).round();
    let origin_mm = if stream.bernoulli(0.7) { 0.0 } else { bench.travel_mm[1] };
    let position = format!("{}_mm", AXES[bench.error]);
    let um = map_runs(&bench.runs, |run| {
        let part_c =
            apply_first_order_lag(run.column("time_s"), run.column("temp_screw_c"), tau_s, tau_s);
        let rows = part_c.iter().zip(run.column(&position));
        rows.map(|(c, mm)| (c - reference_c) * (mm - origin_mm) / 1000.0).collect()
    });
    EffectShape {
        column: Some("temp_screw_c".into()),
        has_sign: false,
        at: Box::new(move |factor| {
            NamedParameters::from_parameters(&[
                ("um_per_m_per_c", factor),
                ("time_constant_s", tau_s),
                ("reference_c", reference_c),
                ("origin_mm", origin_mm),
            ])
        }),
        ..linear_effect(HiddenCause::AxisExpansion, "", um)
    }
}

/// Returns the instrument's own error: periodic in the inverse of its reading, as that of a triangulating
/// laser is, so no pitch of the axis explains it.
fn draw_reference_instrument_error(bench: &AxisBench, stream: &mut RandomStream) -> EffectShape {
    let length_mm = bench.travel_mm[1] - bench.travel_mm[0];
    let stand_off_mm = length_mm * stream.uniform(0.8, 2.0);
    // From reading 0 to the travel's length the phase turns so often.
    let turns = stream.uniform(7.0, 18.0);
    let scale_mm = turns / (1.0 / stand_off_mm - 1.0 / (stand_off_mm + length_mm));
    let phase_rad = stream.uniform(0.0, std::f64::consts::TAU);
    let um = map_runs(&bench.runs, |run| {
        let reading = run.column("instrument_mm").iter();
        reading.map(|mm| sinusoid(scale_mm / (mm + stand_off_mm), phase_rad)).collect()
    });
    EffectShape {
        column: Some("instrument_mm".into()),
        has_sign: false,
        at: Box::new(move |factor| {
            NamedParameters::from_parameters(&[
                ("amplitude_um", factor),
                ("scale_mm", scale_mm),
                ("stand_off_mm", stand_off_mm),
                ("phase_rad", phase_rad),
            ])
        }),
        ..linear_effect(HiddenCause::ReferenceInstrument, "", um)
    }
}

/// The believed backlash does not come at once after a reversal, but over a way.
fn draw_pre_sliding_error(bench: &AxisBench, stream: &mut RandomStream) -> Option<EffectShape> {
    let width_um = bench.backlash_um?;
    let way_mm = stream.uniform(0.03, 0.08);
    let column = format!("{}_mm", AXES[bench.main]);
    let um = map_runs(&bench.runs, |run| {
        let mut lost_um = 0.0;
        let mut before_mm = run.column(&column).first().copied().unwrap_or(0.0);
        let rows = run.column(&column).iter().zip(run.column(&format!("dir_{}", AXES[bench.main])));
        rows.map(|(&mm, &direction)| {
            let settled_um = if direction < 0.0 { width_um } else { 0.0 };
            let left = (-(mm - before_mm).abs() / way_mm).exp();
            lost_um = settled_um + (lost_um - settled_um) * left;
            before_mm = mm;
            lost_um - settled_um
        })
        .collect()
    });
    Some(fixed_parameter_effect(
        HiddenCause::PreSliding,
        vec![("way_mm", way_mm), ("width_um", width_um)],
        um,
    ))
}
