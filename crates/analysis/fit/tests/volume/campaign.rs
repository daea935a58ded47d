//! How much of the volumetric error is gone at places that were not measured, and how often an interval holds the truth.

use std::path::Path;

use trueup_fit::volume::{
    self, NORMAL_QUANTILE_975, VolumeFitOptions, VolumeReport, reading::Pose,
};
use trueup_machine::{Machine, MachineFile, RunFile};

use crate::{
    drawn::{At, Drawn},
    forms::Law,
    measured::{Balls, NOISE_UM, SCALE_UM_PER_M, circles, diagonals},
};

const HELD_OUT: usize = 300;

/// Which measurements.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Plan {
    /// A ball plate in three heights on spacers, with two tools; a sphere at angles where there are rotary axes.
    Plate,
    /// A sphere, step diagonals and circles.
    Sphere,
}

fn measure(machine: &mut Drawn, plan: Plan) -> Vec<String> {
    let tools = machine.tools_mm;
    let has_rotary = !machine.rotary().is_empty();
    let mut balls = Balls::new(machine);
    match plan {
        Plan::Plate => {
            // The plate stays where it is: with the longer tool Z stands higher by what it is longer.
            let travel_mm = machine.travel_mm[2];
            let longer_mm = tools[1] - tools[0];
            for (tool_mm, z_mm) in
                [(tools[0], 0.0), (tools[1], longer_mm), (tools[0], 0.0), (tools[1], longer_mm)]
            {
                for height in [0.0, 0.5, 1.0] {
                    let share = (height * (travel_mm - longer_mm) + z_mm) / travel_mm;
                    balls.plate(machine, [0, 1], [0.0, 0.0, share], tool_mm);
                }
            }
            if has_rotary {
                spheres(machine, &mut balls);
            }
            vec![balls.csv()]
        }
        Plan::Sphere => {
            for place in 0..9 {
                let shares = [
                    0.1 + 0.4 * f64::from(place % 3),
                    0.1 + 0.4 * f64::from(place / 3),
                    0.1 + 0.4 * f64::from((place + place / 3) % 3),
                ];
                let mm = [0, 1, 2].map(|n| shares[n] * machine.travel_mm[n]);
                for tool_mm in tools {
                    balls.probe(machine, &At { mm, deg: [0.0; 3], tool_mm });
                }
                balls.set_up(machine);
            }
            if has_rotary {
                spheres(machine, &mut balls);
            }
            vec![balls.csv(), diagonals(machine), circles(machine)]
        }
    }
}

/// Probes a sphere at angles: near the middle, then away from the lines, where tilts show.
fn spheres(machine: &mut Drawn, balls: &mut Balls) {
    for shares in [[0.4, 0.6, 0.5], [0.25, 0.3, 0.3], [0.75, 0.3, 0.6]] {
        balls.set_up(machine);
        balls.sphere_at_angles(machine, shares, 12);
    }
}

/// The figures of one machine.
#[derive(Debug)]
struct Outcome {
    before_um: f64,
    after_um: f64,
    covered: [usize; 2],
    was_better: bool,
}

impl Outcome {
    fn gone(&self) -> f64 {
        1.0 - self.after_um / self.before_um
    }
}

fn corrected(report: &VolumeReport, file: &str) -> Machine {
    let path = Path::new("drawn.toml");
    let text = report.edit.apply(file, path).expect("sections fit into the file");
    let machine = MachineFile::parse(&text, path).unwrap_or_else(|error| panic!("{error}\n{text}"));
    trueup_machine::compile::compile(&machine).unwrap_or_else(|error| panic!("{error}\n{text}"));
    machine
}

/// Returns the error that is predicted at a pose.
fn predicted_um(machine: &Machine, at: &At) -> [f64; 3] {
    use trueup_machine::model::{ReferenceModel, RowInputs};
    let mut model = ReferenceModel::new(machine);
    let situation = RowInputs {
        position_mm: at.mm,
        angle_deg: at.deg,
        direction: [1.0; 3],
        tool_length_mm: Some(at.tool_mm),
        ..RowInputs::UNKNOWN
    };
    model.step(&situation).error_um()
}

/// Returns the RMS of errors without what a zero, an alignment and the tips of the tools take away.
fn volumetric_um(machine: &Drawn, poses: &[At], errors: &[[f64; 3]]) -> f64 {
    let mut columns: Vec<Vec<f64>> = Vec::new();
    for n in 0..12 {
        let column = poses.iter().flat_map(|at| {
            let mut one = [0.0; 3];
            one[n % 3] = 1.0;
            let [x, y, z] = machine.on_workpiece_mm(at);
            let is_long = at.tool_mm != machine.tools_mm[0];
            match n / 3 {
                0 => machine.workpiece_to_machine(one, at),
                1 => machine
                    .workpiece_to_machine([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]][n % 3], at),
                it if is_long == (it == 2) => machine.tool_to_machine(one, at),
                _ => [0.0; 3],
            }
        });
        columns.push(column.collect());
    }
    let columns = trueup_numerics::least_squares::normal_equations::orthonormalise(columns);
    let mut left: Vec<f64> = errors.iter().flatten().copied().collect();
    for column in &columns {
        let share: f64 = column.iter().zip(&left).map(|(a, b)| a * b).sum();
        left.iter_mut().zip(column).for_each(|(left, value)| *left -= share * value);
    }
    (left.iter().map(|value| value * value).sum::<f64>() / poses.len() as f64).sqrt()
}

/// Measures a machine, and fits.
fn fit(drawn: &mut Drawn, plan: Plan) -> VolumeReport {
    let runs: Vec<RunFile> = measure(drawn, plan)
        .iter()
        .map(|text| RunFile::from_reader(text.as_bytes(), Path::new("run.csv")).expect("a run"))
        .collect();
    let file = MachineFile::parse(&drawn.file, Path::new("drawn.toml")).expect("a machine");
    let options = VolumeFitOptions {
        instrument_um: Some(NOISE_UM),
        scale_um_per_m: Some(SCALE_UM_PER_M),
        artefact_um: None,
    };
    volume::fit(&runs, &file, &options).expect("a fit")
}

fn outcome(seed: u64, plan: Plan, law: Law) -> Outcome {
    let mut drawn = Drawn::new(seed, law);
    let mut report = fit(&mut drawn, plan);
    let machine = corrected(&report, &drawn.file);
    let poses: Vec<At> = (0..HELD_OUT).map(|_| drawn.pose(None)).collect();
    let errors: Vec<[f64; 3]> = poses.iter().map(|at| drawn.error_um(at)).collect();
    let left: Vec<[f64; 3]> = poses
        .iter()
        .zip(&errors)
        .map(|(at, error)| {
            let predicted = predicted_um(&machine, at);
            [0, 1, 2].map(|n| error[n] - predicted[n])
        })
        .collect();
    // A length between two places with one tool and the same angles: no zero and no alignment is in it.
    let mut covered = [0; 2];
    for _ in 0..100 {
        let from = drawn.pose(None);
        let to = At { mm: drawn.pose(None).mm, ..from };
        let way = [0, 1, 2].map(|n| to.mm[n] - from.mm[n]);
        let length = way.iter().map(|value| value * value).sum::<f64>().sqrt();
        let toward = way.map(|component| component / length);
        let [start, end] = [&from, &to].map(|at| drawn.error_um(at));
        let truth: f64 = (0..3).map(|n| toward[n] * (end[n] - start[n])).sum();
        let pose = |at: &At| Pose { position_mm: at.mm, angle_deg: at.deg, tool_mm: at.tool_mm };
        let [um, sd] = report.model.error_difference_with_std_um(&pose(&from), &pose(&to), toward);
        covered[0] += usize::from((um - truth).abs() <= NORMAL_QUANTILE_975 * sd);
        covered[1] += 1;
    }
    let [before_um, after_um] =
        [&errors, &left].map(|errors| volumetric_um(&drawn, &poses, errors));
    let outcome =
        Outcome { before_um, after_um, covered, was_better: report.has_significant_improvement() };
    if std::env::var_os("TRUEUP_VOLUMES_EACH").is_some() {
        println!(
            "{plan:?} {seed}: {outcome:?} gone {:.3} noise {:?} held out {:?}",
            outcome.gone(),
            report.noise_um,
            report.held_out
        );
        for it in &report.known {
            println!(
                "  {} open {:.2} size {:.2} ± {:.2} {} {:?} {}",
                it.error,
                it.open,
                it.size,
                it.half_width,
                if it.is_known { "known" } else { "-" },
                it.confused_with,
                it.next_test
            );
        }
        report.warnings.iter().for_each(|warning| println!("  {warning}"));
    }
    outcome
}

/// Prints the figures of a plan, and returns median and least share that is gone, and the share of intervals that hold.
fn figures(plan: Plan, seeds: &[u64], law: Law) -> [f64; 3] {
    let outcomes =
        trueup_numerics::parallel::parallel_map(seeds, true, |seed| outcome(*seed, plan, law));
    let mut gone: Vec<f64> = outcomes.iter().map(Outcome::gone).collect();
    let sum = |n: usize| outcomes.iter().map(|outcome| outcome.covered[n]).sum::<usize>() as f64;
    let worst = gone.iter().copied().fold(f64::INFINITY, f64::min);
    let figures = [trueup_numerics::robust::median(&mut gone), worst, sum(0) / sum(1)];
    let mean =
        |of: fn(&Outcome) -> f64| outcomes.iter().map(of).sum::<f64>() / outcomes.len() as f64;
    println!(
        "{plan:?}, {law:?}: {} machines, {:.2} µm RMS before, {:.2} after; gone: median {:.3}, worst {:.3}; intervals hold {:.3}; not written {}",
        outcomes.len(),
        mean(|outcome| outcome.before_um),
        mean(|outcome| outcome.after_um),
        figures[0],
        figures[1],
        figures[2],
        outcomes.iter().filter(|outcome| !outcome.was_better).count()
    );
    figures
}

/// What a fit says of a machine without any error.
struct Sound {
    /// Errors that are known, and those of them that are claimed to be there.
    known: usize,
    claimed: usize,
    /// Whether a correction is written, and the RMS error that it makes at places that were not measured.
    is_written: bool,
    made_um: f64,
}

fn sound(seed: u64, plan: Plan) -> Sound {
    let mut drawn = Drawn::of_size(seed, 0.0);
    let report = fit(&mut drawn, plan);
    let machine = corrected(&report, &drawn.file);
    let poses: Vec<At> = (0..HELD_OUT).map(|_| drawn.pose(None)).collect();
    let made: Vec<[f64; 3]> = poses.iter().map(|at| predicted_um(&machine, at)).collect();
    let known = || report.known.iter().filter(|assessment| assessment.is_known);
    Sound {
        known: known().count(),
        claimed: known().filter(|assessment| assessment.is_there).count(),
        is_written: !report.edit.is_empty(),
        made_um: volumetric_um(&drawn, &poses, &made),
    }
}

/// Prints the figures of machines without any error, and returns the share of known errors that are claimed.
fn false_claims(plan: Plan, seeds: &[u64]) -> f64 {
    let all = trueup_numerics::parallel::parallel_map(seeds, true, |seed| sound(*seed, plan));
    let known: usize = all.iter().map(|sound| sound.known).sum();
    let claimed: usize = all.iter().map(|sound| sound.claimed).sum();
    let share = claimed as f64 / known as f64;
    println!(
        "{plan:?}, no error: {} machines; {claimed} of {known} known errors claimed ({:.2} %), on {} machines; written on {}, which makes at most {:.2} µm RMS",
        all.len(),
        100.0 * share,
        all.iter().filter(|sound| sound.claimed > 0).count(),
        all.iter().filter(|sound| sound.is_written).count(),
        all.iter().map(|sound| sound.made_um).fold(0.0, f64::max)
    );
    share
}

/// Returns a number that the environment states.
fn stated(name: &str) -> Option<u64> {
    std::env::var(name).ok().and_then(|text| text.parse().ok())
}

const PLANS: [Plan; 2] = [Plan::Plate, Plan::Sphere];

/// Returns the seeds of the first `usual` machines, or of those that the environment states.
fn seeds(usual: u64) -> Vec<u64> {
    let first = stated("TRUEUP_VOLUMES_FIRST").unwrap_or(0);
    (first..first + stated("TRUEUP_VOLUMES").unwrap_or(usual)).collect()
}

/// Judges both plans on machines with errors.
fn judge(seeds: &[u64], margin: f64) {
    let figures = PLANS.map(|plan| figures(plan, seeds, Law::Polynomials));
    for ([median, worst, holds], [most, least]) in figures.iter().zip([[0.9, 0.7], [0.75, 0.5]]) {
        assert!(*median >= most && *worst >= least, "gone: median {median}, worst {worst}");
        assert!((holds - 0.95).abs() <= margin, "intervals hold {holds}");
    }
}

#[test]
#[ignore = "campaign: cargo xtask volumes"]
fn campaign_100_drawn_machines() {
    let seeds = seeds(100);
    let claims = PLANS.map(|plan| false_claims(plan, &seeds));
    // Target and margin: 95 ± 2 %.
    judge(&seeds, 0.02);
    // 95 % are promised of each.
    assert!(claims.iter().all(|share| *share <= 0.05), "false claims: {claims:?}");
}

/// Errors of another form than those that the fit was tried on: the figures are printed. By waves no machine may become worse; by a
/// walk, whose form no ball between two others shows, one may.
#[test]
#[ignore = "campaign: cargo xtask volumes --law waves"]
fn campaign_100_machines_by_another_law() {
    let name = std::env::var("TRUEUP_VOLUMES_LAW").unwrap_or("waves".into());
    let law = Law::named(&name).unwrap_or_else(|| panic!("no law is named {name}"));
    let seeds = seeds(100);
    for [_, worst, _] in PLANS.map(|plan| figures(plan, &seeds, law)) {
        assert!(law == Law::Walk || worst >= 0.0, "a machine has become worse: {worst}");
    }
}

#[test]
#[ignore = "long: eight drawn machines, measured in two ways"]
fn most_of_the_error_of_eight_drawn_machines_is_gone() {
    // Fewer intervals: 800 lengths, eight machines.
    judge(&seeds(8), 0.04);
}
