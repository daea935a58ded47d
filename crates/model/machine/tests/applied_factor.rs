//! The factor by which a CNC applies the offsets: found where rows with and without them exist, unknown where they do
//! not, and 1 on a CNC that is right, whatever else is wrong with the machine.

use std::{borrow::Cow, fmt::Write as _, path::Path};

use trueup_machine::{
    Machine, MachineFile, RunFile,
    applied_offsets::{
        FactorEstimate, OffsetApplication, UncompensatedRun, estimate_offset_application,
        is_fully_compensated,
    },
    machine_file::Quantity,
};
use trueup_numerics::random::RandomGenerator;

const SPINDLE: &str = "[machine]\nname = \"m\"\nkind = \"3-axis\"\n[spindle]\nsource = \"temperature\"\n\
    [spindle.temperature]\nsensor = \"temp_front_c\"\nreference_c = 20.0\nk_um_per_c = 2.4\nlag_s = 0.0\n";
const AXIS: &str = "[machine]\nname = \"m\"\nkind = \"3-axis\"\n[axis.x.thermal]\nmode = \"position\"\n\
    sensor = \"temp_front_c\"\nreference_c = 20.0\nslope_um_per_m_per_c = 11.0\norigin_mm = 0.0\n";

/// When the bridge is engaged.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Engaged {
    Never,
    Always,
    InTheMiddle,
    AtTheEnd,
    OnAndOff,
}

impl Engaged {
    fn at(self, share: f64) -> bool {
        match self {
            Self::Never => false,
            Self::Always => true,
            Self::InTheMiddle => (0.35..0.7).contains(&share),
            Self::AtTheEnd => share > 0.6,
            Self::OnAndOff => (share * 10.0) as u32 % 2 == 1,
        }
    }
}

/// A machine and what is wrong with it.
#[derive(Clone, Copy, Debug)]
struct Case {
    factor: f64,
    /// True error over the believed one.
    gain: f64,
    /// The part is so late behind its thermometer, in s.
    lag_s: f64,
    /// Drift of something else over the record, in µm.
    drift_um: f64,
    gauge_um: f64,
    thermometer_c: f64,
    rows: usize,
}

const RIGHT: Case = Case {
    factor: 1.0,
    gain: 1.0,
    lag_s: 0.0,
    drift_um: 0.0,
    gauge_um: 0.5,
    thermometer_c: 0.02,
    rows: 240,
};

/// Returns a record of a shift: warm for 60 %, then cooling.
fn record(case: Case, engaged: Engaged, quantity: Quantity, seed: u64) -> RunFile {
    let mut generator = RandomGenerator::new(seed);
    let (mut front_c, mut part_c) = (20.0_f64, 20.0_f64);
    let axis = quantity == Quantity::Dx;
    let (column, offset) = if axis { ("dx", "x") } else { (quantity.name(), "z") };
    let mut text =
        format!("time_s,x_mm,temp_front_c,offset_{offset}_um,quality,measured_{column}_um\n");
    for row in 0..case.rows {
        let share = row as f64 / case.rows as f64;
        let to_c = if share < 0.6 { 32.0 } else { 20.0 };
        front_c += (to_c - front_c) * (1.0 - (-30.0_f64 / 900.0).exp());
        let behind = if case.lag_s > 0.0 { 1.0 - (-30.0 / case.lag_s).exp() } else { 1.0 };
        part_c += (front_c - part_c) * behind;
        let x_mm = [100.0, 500.0, 900.0, 300.0, 700.0][row % 5];
        let per_c = if axis { 11.0 * x_mm / 1000.0 } else { 2.4 };
        let (believed, real) = (per_c * (front_c - 20.0), case.gain * per_c * (part_c - 20.0));
        let is_on = engaged.at(share);
        // The offset of an elongation lifts the tool.
        let sign = if quantity == Quantity::Elongation { 1.0 } else { -1.0 };
        let offset_um = if is_on { sign * believed } else { 0.0 };
        let along = if quantity == Quantity::Elongation { -offset_um } else { offset_um };
        let error = if quantity == Quantity::Dz { -real } else { real };
        let along = if quantity == Quantity::Dz { -along } else { along };
        let written = if quantity == Quantity::Dz { -offset_um } else { offset_um };
        let measured = error
            + case.factor * along
            + case.drift_um * share
            + case.gauge_um * generator.normal();
        let seen_c = front_c + case.thermometer_c * generator.normal();
        writeln!(
            text,
            "{},{x_mm},{seen_c:.4},{written:.2},{},{measured:.3}",
            30 * row,
            u8::from(is_on)
        )
        .expect("a string grows");
    }
    RunFile::from_reader(text.as_bytes(), Path::new("r.csv")).expect("a run file")
}

fn machine(quantity: Quantity) -> Machine {
    let text = if quantity == Quantity::Dx { AXIS } else { SPINDLE };
    MachineFile::parse(text, Path::new("m.toml")).expect("right")
}

fn found(records: &[RunFile], quantity: Quantity) -> OffsetApplication {
    let machine = machine(quantity);
    let runs: Vec<UncompensatedRun<'_>> = records
        .iter()
        .map(|run| {
            UncompensatedRun::from_run(Cow::Borrowed(run), Some(&machine), Some(quantity))
                .expect("right")
                .0
        })
        .collect();
    estimate_offset_application(&runs, Some(&machine), quantity)
}

const PLANS: [&[Engaged]; 4] = [
    &[Engaged::Never, Engaged::Always],
    &[Engaged::InTheMiddle],
    &[Engaged::AtTheEnd],
    &[Engaged::OnAndOff],
];

fn records(case: Case, plan: &[Engaged], quantity: Quantity, seed: u64) -> Vec<RunFile> {
    let one =
        |(n, engaged): (usize, &Engaged)| record(case, *engaged, quantity, 100 * n as u64 + seed);
    plan.iter().enumerate().map(one).collect()
}

#[test]
fn the_factor_is_found_whatever_else_is_wrong() {
    let cases = [
        RIGHT,
        Case { gain: 1.25, ..RIGHT },
        Case { lag_s: 600.0, ..RIGHT },
        Case { drift_um: 4.0, ..RIGHT },
        Case { thermometer_c: 0.2, ..RIGHT },
        Case { rows: 60, gauge_um: 1.0, ..RIGHT },
    ];
    for quantity in [Quantity::Elongation, Quantity::Dx, Quantity::Dz] {
        for factor in [-1.0, 0.0, 0.5, 1.0, 2.0] {
            for (case, plan) in cases.iter().flat_map(|case| PLANS.map(|plan| (case, plan))) {
                let case = Case { factor, ..*case };
                let it = found(&records(case, plan, quantity, 3), quantity);
                let known = it.factor().expect("an interval");
                let what = format!("{} {plan:?} {case:?}: {it:?}", quantity.name());
                assert!((known.value - factor).abs() < 0.12, "{what}");
                match it {
                    OffsetApplication::Once(_) => assert!(factor == 1.0, "{what}"),
                    OffsetApplication::OtherFactor(_) => assert!(factor != 1.0, "{what}"),
                    _ => panic!("{what}"),
                }
            }
        }
    }
}

#[test]
fn the_interval_holds_the_factor() {
    let (mut held, mut all) = (0, 0);
    for (seed, plan) in (0..10).flat_map(|seed| PLANS.map(|plan| (seed, plan))) {
        for quantity in [Quantity::Elongation, Quantity::Dx] {
            let case = Case { factor: -1.0, gain: 1.1, ..RIGHT };
            let it = found(&records(case, plan, quantity, seed), quantity);
            let [low, high] = it.factor().expect("known").ci95;
            held += u32::from(low < -1.0 && -1.0 < high);
            all += 1;
            assert!(high - low < 0.2, "{low} {high}");
        }
    }
    assert!(held * 20 >= all * 19, "{held} of {all}");
}

#[test]
fn an_engaged_record_alone_does_not_show_the_factor_and_one_without_offsets_has_none() {
    for quantity in [Quantity::Elongation, Quantity::Dx, Quantity::Dz] {
        for factor in [-1.0, 0.0, 0.5, 1.0, 2.0] {
            for thermometer_c in [0.0, 0.02, 0.2] {
                let case = Case { factor, thermometer_c, ..RIGHT };
                let it = found(&records(case, &[Engaged::Always], quantity, 5), quantity);
                assert!(matches!(it, OffsetApplication::Unknown(_)), "{case:?} {it:?}");
            }
        }
        let never = records(RIGHT, &[Engaged::Never], quantity, 5);
        assert_eq!(found(&never, quantity), OffsetApplication::NoOffset);
    }
}

#[test]
fn what_is_left_while_engaged_says_whether_the_sum_is_right() {
    for (factor, gain, nothing) in
        [(1.0, 1.0, true), (1.0, 1.3, false), (0.5, 1.0, false), (2.0, 1.0, false)]
    {
        let case = Case { factor, gain, ..RIGHT };
        let machine = machine(Quantity::Dz);
        let records = records(case, &[Engaged::Always], Quantity::Dz, 8);
        let run = UncompensatedRun::from_run(Cow::Borrowed(&records[0]), Some(&machine), None)
            .expect("right")
            .0;
        assert_eq!(is_fully_compensated(&[run], Quantity::Dz), nothing, "{case:?}");
    }
}

#[test]
fn a_factor_is_taken_out_of_what_was_measured() {
    let text = "measured_dx_um,offset_x_um,quality\n3,-4,1\n-1,0,0\n";
    let run = RunFile::from_reader(text.as_bytes(), Path::new("r.csv")).expect("a run");
    let (run, _) = UncompensatedRun::from_run(Cow::Owned(run), None, None).expect("right");
    assert_eq!(run.applied_offset_um(Quantity::Dx), Some(&[-4.0, 0.0][..]));
    let run = run.with_offset_factor(Quantity::Dx, -0.5);
    assert_eq!(run.column("measured_dx_um"), Some(&[1.0, -1.0][..]));
}

#[test]
fn a_small_offset_in_much_noise_says_nothing() {
    let case = Case { factor: -1.0, gauge_um: 40.0, rows: 40, ..RIGHT };
    let it = found(&records(case, &[Engaged::InTheMiddle], Quantity::Dz, 4), Quantity::Dz);
    assert!(matches!(it, OffsetApplication::Unknown(_)), "{it:?}");
}

#[test]
fn the_sentence_names_the_kind_of_fault() {
    for (value, word) in [
        (-1.0, "wrong sign"),
        (0.0, "not applied at all"),
        (0.5, "radius"),
        (2.0, "twice"),
        (0.7, "wrong scale"),
    ] {
        let description = FactorEstimate { value, ci95: [value - 0.02, value + 0.02] }.describe();
        assert!(description.contains(word), "{description}");
    }
}
