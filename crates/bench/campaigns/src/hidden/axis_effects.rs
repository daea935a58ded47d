//! The effect of each cause on the error of an axis.

use super::{
    axis::{AxisBench, walk},
    cause::Hidden,
    growth_effects::of_any_series,
    laws::{even_knots, lagged, line, spline, stepped, wave},
    shape::{Named, Run, Shape, fixed, linear, on_each},
};
use trueup_twin::{axes::NAMES as AXES, noise::Stream};

/// Returns the shape of `cause` on `bench`; `None` where it is only noise.
pub(super) fn shape(cause: Hidden, bench: &AxisBench, stream: &mut Stream) -> Option<Shape> {
    let runs = &bench.runs[..];
    let mm = |axis: usize| format!("{}_mm", AXES[axis]);
    let (main_mm, other_mm) = (mm(bench.main), mm(bench.other));
    let along = |law: &dyn Fn(f64, f64) -> f64| along(bench, law);
    let where_reverse = |d: f64| if d < 0.0 { 1.0 } else { 0.0 };
    Some(match cause {
        Hidden::ThermalLag
        | Hidden::ExpansionConstant
        | Hidden::ExpansionSlope
        | Hidden::ReferenceTemperature => {
            return thermal(cause, bench, stream);
        }
        Hidden::PitchScale => linear(cause, "um_per_m", along(&|mm, _| mm / 1000.0)),
        Hidden::Backlash => linear(cause, "width_um", along(&|_, d| where_reverse(d))),
        Hidden::PositionDependentBacklash => {
            linear(cause, "um_per_m", along(&|mm, d| mm / 1000.0 * where_reverse(d)))
        }
        Hidden::FeedDependentBacklash => by_feed(bench, stream),
        Hidden::PitchError => pitch_error(bench, stream)?,
        Hidden::PitchPeriodic => pitch_periodic(bench, stream),
        Hidden::Straightness => {
            let (knots, controls) = bent(bench, stream);
            let um = along(&|mm, _| spline(&knots, &controls, mm));
            Shape {
                column: Some(main_mm.clone()),
                at: Box::new(move |factor| Named {
                    parameters: Vec::new(),
                    tables: vec![
                        ("knots_mm", knots.clone()),
                        ("control_um", controls.iter().map(|um| factor * um).collect()),
                    ],
                }),
                ..linear(cause, "", um)
            }
        }
        Hidden::CrossAxis => {
            let um =
                on_each(runs, |run| run.column(&other_mm).iter().map(|mm| mm / 1000.0).collect());
            Shape { column: Some(other_mm.clone()), ..linear(cause, "um_per_m", um) }
        }
        Hidden::ReferenceInstrument => chirp(bench, stream),
        Hidden::PreSliding => return pre_sliding(bench, stream),
        Hidden::Abbe => {
            let (knots, controls) = bent(bench, stream);
            tilted(cause, bench, &|mm| spline(&knots, &controls, mm), 0.0, {
                let (knots, controls) = (knots.clone(), controls.clone());
                move |factor| tilt_table(&knots, &controls, factor)
            })
        }
        Hidden::AngularError => angular_error(bench, stream),
        Hidden::AxisExpansion => expansion(bench, stream),
        Hidden::Step | Hidden::Drift | Hidden::DriftByRun | Hidden::Outliers => {
            of_any_series(cause, runs, stream)
        }
        // The rest is noise, or belongs to elongations; `Hidden::bases` sends none of them here.
        _ => return None,
    })
}

/// Computes a law of the position on the main axis, in mm, and the direction of approach in each row of each run.
fn along(bench: &AxisBench, law: &dyn Fn(f64, f64) -> f64) -> Vec<Vec<f64>> {
    let main_mm = format!("{}_mm", AXES[bench.main]);
    let direction = format!("dir_{}", AXES[bench.error]);
    on_each(&bench.runs, |run| {
        let rows = run.column(&main_mm).iter().zip(run.column(&direction));
        rows.map(|(&mm, &d)| law(mm, d)).collect()
    })
}

/// Returns an uneven scale or screw, with a table for each direction; `None` where the path has no even targets.
fn pitch_error(bench: &AxisBench, stream: &mut Stream) -> Option<Shape> {
    let (start_mm, step_mm, count) = bench.grid?;
    let forward = walk(count, 1.0, stream);
    let own = walk(count, 0.6, stream);
    let reverse: Vec<f64> = forward.iter().zip(&own).map(|(f, o)| f + o).collect();
    let um = along(bench, &|mm, d| {
        stepped(start_mm, step_mm, if d < 0.0 { &reverse } else { &forward }, mm)
    });
    Some(Shape {
        at: Box::new(move |factor| {
            let scaled = |table: &[f64]| table.iter().map(|um| factor * um).collect();
            Named {
                parameters: vec![("start_mm", start_mm), ("step_mm", step_mm)],
                tables: vec![("forward_um", scaled(&forward)), ("reverse_um", scaled(&reverse))],
            }
        }),
        ..linear(Hidden::PitchError, "", um)
    })
}

/// Returns an error that repeats with each turn or graduation, with its second harmonic.
fn pitch_periodic(bench: &AxisBench, stream: &mut Stream) -> Shape {
    let length_mm = bench.travel_mm[1] - bench.travel_mm[0];
    let period_mm = stream.log_uniform(2.0, 20.0_f64.min(length_mm / 6.0));
    let second = if stream.chance(0.5) { 0.0 } else { stream.uniform(0.2, 0.5) };
    let phase_rad = stream.uniform(0.0, std::f64::consts::TAU);
    let second_rad = stream.uniform(0.0, std::f64::consts::TAU);
    let um = along(bench, &|mm, _| {
        let turns = mm / period_mm;
        wave(turns, phase_rad) + second * wave(2.0 * turns, second_rad)
    });
    Shape {
        has_sign: false,
        at: Box::new(move |factor| {
            Named::of(&[
                ("amplitude_um", factor),
                ("period_mm", period_mm),
                ("phase_rad", phase_rad),
                ("second_amplitude_um", factor * second),
                ("second_phase_rad", second_rad),
            ])
        }),
        ..linear(Hidden::PitchPeriodic, "", um)
    }
}

/// Returns an axis that tilts along its way: in proportion to the position, or by a curve.
fn angular_error(bench: &AxisBench, stream: &mut Stream) -> Shape {
    let lever_zero_mm = if stream.chance(0.5) { 0.0 } else { stream.uniform(0.0, 400.0).round() };
    let origin = ("origin_mm", lever_zero_mm);
    if stream.chance(0.5) {
        tilted(Hidden::AngularError, bench, &|mm| mm / 1000.0, lever_zero_mm, move |factor| {
            Named::of(&[("urad_per_m", factor), origin])
        })
    } else {
        let (knots, controls) = bent(bench, stream);
        tilted(Hidden::AngularError, bench, &|mm| spline(&knots, &controls, mm), lever_zero_mm, {
            let (knots, controls) = (knots.clone(), controls.clone());
            move |factor| Named {
                parameters: vec![origin],
                ..tilt_table(&knots, &controls, factor)
            }
        })
    }
}

/// Another width at each feed, wider the faster the axis comes: its friction and its mass take up more.
fn by_feed(bench: &AxisBench, stream: &mut Stream) -> Shape {
    let feeds = bench.feeds_mm_per_min.clone();
    let mut width = stream.uniform(0.0, 1.0);
    let mut widths = vec![width];
    for _ in 1..feeds.len() {
        width += stream.uniform(0.6, 1.4);
        widths.push(width);
    }
    let direction = format!("dir_{}", AXES[bench.error]);
    let um = on_each(&bench.runs, |run| {
        let rows = run.column("feed_mm_per_min").iter().zip(run.column(&direction));
        rows.map(|(feed, direction)| {
            let of_feed = feeds.iter().position(|there| there == feed);
            if *direction < 0.0 { of_feed.map_or(0.0, |number| widths[number]) } else { 0.0 }
        })
        .collect()
    });
    Shape {
        column: Some("feed_mm_per_min".into()),
        at: Box::new(move |factor| Named {
            parameters: Vec::new(),
            tables: vec![
                ("feeds_mm_per_min", feeds.clone()),
                ("width_um", widths.iter().map(|um| factor * um).collect()),
            ],
        }),
        ..linear(Hidden::FeedDependentBacklash, "", um)
    }
}

/// Returns what the axis's heat does otherwise than believed.
fn thermal(cause: Hidden, bench: &AxisBench, stream: &mut Stream) -> Option<Shape> {
    let law = bench.thermal.as_ref()?;
    let position = format!("{}_mm", AXES[bench.error]);
    let follow = |run: &Run, lag_s: f64| {
        lagged(run.column("time_s"), run.column("temp_screw_c"), lag_s, lag_s)
    };
    let apart = |other: &dyn Fn(f64, f64) -> f64, from_s: f64| {
        on_each(&bench.runs, |run| {
            let (believed_c, true_c) = (follow(run, from_s), follow(run, law.true_lag_s));
            let rows = run.column(&position).iter().enumerate();
            rows.map(|(row, &mm)| other(true_c[row], mm) - law.error_um(believed_c[row], mm))
                .collect()
        })
    };
    let shape = match cause {
        Hidden::ThermalLag => {
            let tau_s = law.true_lag_s;
            fixed(
                cause,
                vec![("time_constant_s", tau_s)],
                apart(&|c, mm| law.error_um(c, mm), law.lag_s),
            )
        }
        Hidden::ReferenceTemperature => {
            let shift_c = stream.sign() * stream.uniform(0.7, 3.0);
            // Next to a hidden lag it is that of the temperature which the axis follows.
            let um = apart(&|c, mm| law.error_um(c - shift_c, mm), law.true_lag_s);
            let mut shape = fixed(cause, vec![("shift_c", shift_c)], um);
            let training = &bench.runs[..bench.runs.len() - 1];
            let mm = training.iter().flat_map(|run| run.column(&position).to_vec()).collect();
            shape.imitators.push((Hidden::PitchScale, mm));
            shape
        }
        Hidden::ExpansionConstant => {
            let shifting = |c: f64, mm: f64| law.error_um(c, mm) + (c - law.reference_c);
            let constant = law.constant_um_per_c;
            Shape {
                at: Box::new(move |factor| Named::of(&[("um_per_c", constant + factor)])),
                ..linear(cause, "", apart(&shifting, law.true_lag_s))
            }
        }
        // Next to a hidden lag the slope is that over the temperature that the axis follows.
        _ => {
            let steeper = |c: f64, mm: f64| {
                law.error_um(c, mm) + (c - law.reference_c) * (mm - law.origin_mm) / 1000.0
            };
            let slope = law.slope_um_per_m_per_c;
            Shape {
                at: Box::new(move |factor| Named::of(&[("um_per_m_per_c", slope + factor)])),
                ..linear(cause, "", apart(&steeper, law.true_lag_s))
            }
        }
    };
    Some(Shape { column: Some("temp_screw_c".into()), ..shape })
}

/// Returns a smooth curve over the main axis, as knots and control points, whose best straight line over the
/// training rows is 0: a slope would be another cause.
fn bent(bench: &AxisBench, stream: &mut Stream) -> (Vec<f64>, Vec<f64>) {
    let [low, high] = bench.travel_mm;
    let controls = stream.whole(6, 10);
    let knots = even_knots(low, high, controls);
    let mut control: Vec<f64> = (0..controls).map(|_| stream.normal()).collect();
    let training = &bench.runs[..bench.runs.len() - 1];
    let column = format!("{}_mm", AXES[bench.main]);
    let mm: Vec<f64> = training.iter().flat_map(|run| run.column(&column).to_vec()).collect();
    let um: Vec<f64> = mm.iter().map(|&mm| spline(&knots, &control, mm)).collect();
    let (level, slope) = line(&mm, &um);
    for (i, um) in control.iter_mut().enumerate() {
        // A straight line's control points lie on it at the means of the inner knots.
        let at_mm = knots[i + 1..i + 4].iter().sum::<f64>() / 3.0;
        *um -= level + slope * at_mm;
    }
    (knots, control)
}

/// Returns the tilt `urad` at a position of the main axis, times the lever along the other one, which is 0
/// at `lever_zero_mm`.
fn tilted(
    cause: Hidden,
    bench: &AxisBench,
    urad: &dyn Fn(f64) -> f64,
    lever_zero_mm: f64,
    at: impl Fn(f64) -> Named + 'static,
) -> Shape {
    let (main_mm, lever_mm) =
        (format!("{}_mm", AXES[bench.main]), format!("{}_mm", AXES[bench.other]));
    let um = on_each(&bench.runs, |run| {
        let rows = run.column(&main_mm).iter().zip(run.column(&lever_mm));
        rows.map(|(&mm, &lever_mm)| urad(mm) * (lever_mm - lever_zero_mm) / 1000.0).collect()
    });
    Shape { column: Some(lever_mm), at: Box::new(at), ..linear(cause, "", um) }
}

/// θ in µrad as a spline over the travel.
fn tilt_table(knots: &[f64], controls: &[f64], factor: f64) -> Named {
    Named {
        parameters: Vec::new(),
        tables: vec![
            ("knots_mm", knots.to_vec()),
            ("control_urad", controls.iter().map(|urad| factor * urad).collect()),
        ],
    }
}

/// Draws a screw or a scale that grows with its temperature, which follows its thermometer late or at once, while
/// the machine file says nothing of it. A warm part is longer: c is never negative.
fn expansion(bench: &AxisBench, stream: &mut Stream) -> Shape {
    let tau_s = if stream.chance(0.33) { 0.0 } else { stream.log_uniform(100.0, 2500.0).round() };
    let reference_c = stream.uniform(18.0, 22.0).round();
    let origin_mm = if stream.chance(0.7) { 0.0 } else { bench.travel_mm[1] };
    let position = format!("{}_mm", AXES[bench.error]);
    let um = on_each(&bench.runs, |run| {
        let part_c = lagged(run.column("time_s"), run.column("temp_screw_c"), tau_s, tau_s);
        let rows = part_c.iter().zip(run.column(&position));
        rows.map(|(c, mm)| (c - reference_c) * (mm - origin_mm) / 1000.0).collect()
    });
    Shape {
        column: Some("temp_screw_c".into()),
        has_sign: false,
        at: Box::new(move |factor| {
            Named::of(&[
                ("um_per_m_per_c", factor),
                ("time_constant_s", tau_s),
                ("reference_c", reference_c),
                ("origin_mm", origin_mm),
            ])
        }),
        ..linear(Hidden::AxisExpansion, "", um)
    }
}

/// Returns the instrument's own error: periodic in the inverse of its reading, as that of a triangulating
/// laser is, so no pitch of the axis explains it.
fn chirp(bench: &AxisBench, stream: &mut Stream) -> Shape {
    let length_mm = bench.travel_mm[1] - bench.travel_mm[0];
    let stand_off_mm = length_mm * stream.uniform(0.8, 2.0);
    // From reading 0 to the travel's length the phase turns so often.
    let turns = stream.uniform(7.0, 18.0);
    let scale_mm = turns / (1.0 / stand_off_mm - 1.0 / (stand_off_mm + length_mm));
    let phase_rad = stream.uniform(0.0, std::f64::consts::TAU);
    let um = on_each(&bench.runs, |run| {
        let reading = run.column("instrument_mm").iter();
        reading.map(|mm| wave(scale_mm / (mm + stand_off_mm), phase_rad)).collect()
    });
    Shape {
        column: Some("instrument_mm".into()),
        has_sign: false,
        at: Box::new(move |factor| {
            Named::of(&[
                ("amplitude_um", factor),
                ("scale_mm", scale_mm),
                ("stand_off_mm", stand_off_mm),
                ("phase_rad", phase_rad),
            ])
        }),
        ..linear(Hidden::ReferenceInstrument, "", um)
    }
}

/// The believed backlash does not come at once after a reversal, but over a way.
fn pre_sliding(bench: &AxisBench, stream: &mut Stream) -> Option<Shape> {
    let width_um = bench.backlash_um?;
    let way_mm = stream.uniform(0.03, 0.08);
    let column = format!("{}_mm", AXES[bench.main]);
    let um = on_each(&bench.runs, |run| {
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
    Some(fixed(Hidden::PreSliding, vec![("way_mm", way_mm), ("width_um", width_um)], um))
}
