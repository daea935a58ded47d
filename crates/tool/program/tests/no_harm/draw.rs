//! Machines, ranges and options by chance, and what follows from them by rules of our own.

use std::path::Path;

use trueup_machine::{Machine, MachineFile, machine_file::LinearAxis};
use trueup_program::{MeasurementKind, MeasurementOptions, MeasurementPlan, MeasuringInstrument};

/// A machine and what is asked for.
#[derive(Debug)]
pub struct Draw {
    pub number: u64,
    pub machine: Machine,
    pub options: MeasurementOptions,
}

/// A tool axis by its share of a way; below, no range is asked for.
const SURELY_ALONG: f64 = 0.02;

impl Draw {
    /// Returns a mill, and nothing asked for.
    pub fn plain() -> Self {
        let text =
            "[machine]\nname = \"m\"\nkind = \"3-axis\"\n[axis.x]\ntravel_mm = [0.0, 800.0]\n";
        let machine = MachineFile::parse(text, Path::new("m.toml")).expect("a machine file");
        Self { number: 0, machine, options: MeasurementOptions::default() }
    }

    /// Returns which way retracts a vertical or tool axis.
    pub fn retract(&self, axis: LinearAxis) -> Option<f64> {
        let along = self.machine.tool_direction[axis.index()];
        match along {
            _ if along > SURELY_ALONG => Some(-1.0),
            _ if along < -SURELY_ALONG => Some(1.0),
            _ if axis == LinearAxis::Z => Some(1.0),
            _ => None,
        }
    }

    pub fn is_guarded(&self, axis: LinearAxis) -> bool {
        self.retract(axis).is_some()
    }

    /// Where an axis may be, in mm; everywhere, where nothing is known of it.
    pub fn allowed_mm(&self, axis: LinearAxis) -> [f64; 2] {
        let everywhere = [f64::NEG_INFINITY, f64::INFINITY];
        let margin = self.options.margin_mm;
        let travel = self.machine.axes[axis.index()].travel_mm;
        let [low, high] = travel.map_or(everywhere, |[low, high]| [low + margin, high - margin]);
        let range = self.options.range_mm[axis.index()].unwrap_or(everywhere);
        [low.max(range[0]), high.min(range[1])]
    }

    /// Where runs have seen an axis, in mm.
    pub fn seen_mm(&self, axis: LinearAxis) -> [f64; 2] {
        let [low, high] = self.allowed_mm(axis);
        if low.is_finite() { [low, high] } else { [-100.0, 250.0] }
    }

    /// Returns one of them, by the number.
    pub fn axis(&self) -> LinearAxis {
        LinearAxis::ALL[(self.number % 3) as usize]
    }

    /// Returns whether the axis has room for any program.
    fn has_room(&self, axis: LinearAxis) -> bool {
        let known = self.machine.axes[axis.index()].travel_mm;
        let range = self.options.range_mm[axis.index()];
        let margin = if known.is_none() { self.options.margin_mm } else { 0.0 };
        let [low, high] = self.allowed_mm(axis);
        (known.is_some() || range.is_some())
            && (range.is_some() || !self.is_guarded(axis))
            && high - low - 2.0 * margin > 2.01
    }

    /// Nothing is left out that could be written, and what is left out is reported.
    pub fn is_named_what_is_not_written(
        &self,
        kind: MeasurementKind,
        plans: &[MeasurementPlan],
        notes: &str,
    ) {
        if matches!(
            kind,
            MeasurementKind::Warmup
                | MeasurementKind::Diagonal
                | MeasurementKind::StepDiagonal
                | MeasurementKind::Circle
        ) {
            return;
        }
        for axis in LinearAxis::ALL {
            let requested = self.options.axes.is_empty() || self.options.axes.contains(&axis);
            let ending = format!("-{}", axis.name());
            let is_written = plans.iter().any(|plan| plan.name.ends_with(&ending));
            assert!(!is_written || requested);
            let is_short = notes.contains("strokes from");
            if requested && !is_written && !is_short {
                let why = format!("no program for {}", axis.name());
                assert!(notes.contains(&why) && notes.contains("--range"), "{notes}");
                assert!(!self.has_room(axis), "{self:?}: needlessly {notes}");
            }
        }
    }

    /// A refusal has its reason in the draw.
    pub fn is_right_to_refuse(&self, kind: MeasurementKind, why: &str) {
        let requested: Vec<LinearAxis> = LinearAxis::ALL
            .into_iter()
            .filter(|axis| self.options.axes.is_empty() || self.options.axes.contains(axis))
            .collect();
        let with_room = requested.iter().filter(|axis| self.has_room(**axis)).count();
        let needed = match kind {
            MeasurementKind::Diagonal | MeasurementKind::Circle => 2,
            MeasurementKind::StepDiagonal => 3,
            _ => 1,
        };
        if why.contains("strokes from") || why.contains("a circle of 50 mm would send") {
            return;
        }
        let clearance = why.contains("--clearance") && kind == MeasurementKind::Backlash;
        assert!(with_room < needed || clearance, "{kind:?} {self:?}: needlessly {why}");
        let needs_more = matches!(
            kind,
            MeasurementKind::Diagonal | MeasurementKind::StepDiagonal | MeasurementKind::Circle
        );
        let is_alone = needs_more && why.contains("only");
        assert!(why.contains("--range") || clearance || is_alone, "{why}");
    }
}

/// Draws in a sequence that is the same each time.
pub struct Draws {
    state: u64,
    number: u64,
    count: u64,
}

impl Draws {
    pub fn new(count: u64) -> Self {
        Self { state: 0x9e37_79b9_7f4a_7c15, number: 0, count }
    }

    /// From 0 to 1: splitmix64.
    fn share(&mut self) -> f64 {
        self.state = self.state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.state;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.share()
    }

    fn chance(&mut self, share: f64) -> bool {
        self.share() < share
    }

    fn one_of<T: Copy>(&mut self, all: &[T]) -> T {
        all[(self.share() * all.len() as f64) as usize]
    }

    /// Returns a length of which small ones are as frequent as large ones, in mm, with odd digits or without.
    fn length_mm(&mut self) -> f64 {
        let length = 10_f64.powf(self.between(0.3, 4.2));
        if self.chance(0.5) { length.round().max(1.0) } else { length }
    }

    fn range_mm(&mut self, travel: Option<[f64; 2]>) -> [f64; 2] {
        let [low, high] = travel.unwrap_or_else(|| {
            let low = self.between(-2000.0, 2000.0);
            [low, low + self.length_mm()]
        });
        let ends = [self.share(), self.share()].map(|share| low + share * (high - low));
        match ends[0] < ends[1] && self.chance(0.8) {
            true => ends,
            false => [low, high],
        }
    }

    fn machine(&mut self) -> Machine {
        let directions = [
            "0.0, 0.0, -1.0",
            "0.0, 0.0, -1.0",
            "0.0, 0.0, 1.0",
            "0.0, -1.0, 0.0",
            "1.0, 0.0, 0.0",
            "0.0, 0.6, -0.8",
            "0.5, -0.5, -0.7",
            "0.003, 0.0, -1.0",
        ];
        let direction = self.one_of(&directions);
        let kind = match self.chance(0.3) {
            true => "kind = \"head-head\"\nhead_axes = [\"c\", \"a\"]",
            false => "kind = \"3-axis\"",
        };
        let mut text =
            format!("[machine]\nname = \"drawn\"\n{kind}\ntool_direction = [{direction}]\n");
        for axis in ["x", "y", "z"] {
            if self.chance(0.85) {
                let low = self.between(-3000.0, 1000.0);
                let low = if self.chance(0.5) { low.round() } else { low };
                let high = low + self.length_mm();
                text += &format!("[axis.{axis}]\ntravel_mm = [{low:?}, {high:?}]\n");
            }
        }
        MachineFile::parse(&text, Path::new("m.toml")).expect("a machine file")
    }
}

impl Iterator for Draws {
    type Item = Draw;

    fn next(&mut self) -> Option<Draw> {
        if self.number == self.count {
            return None;
        }
        self.number += 1;
        let machine = self.machine();
        let range_mm = [0, 1, 2].map(|n| {
            let travel = machine.axes[n].travel_mm;
            self.chance(0.6).then(|| self.range_mm(travel))
        });
        let clearance_mm = self.chance(0.4).then(|| {
            let mm = self.between(5.0, 60.0) * self.one_of(&[1.0, 1.0, -1.0]);
            (self.one_of(&LinearAxis::ALL), mm)
        });
        let axes = match self.chance(0.3) {
            true => vec![self.one_of(&LinearAxis::ALL)],
            false => Vec::new(),
        };
        let options = MeasurementOptions {
            axes,
            range_mm,
            clearance_mm,
            approach_mm_per_min: self.one_of(&[500.0, 250.0, 1200.0]),
            margin_mm: self.one_of(&[2.0, 2.0, 0.0, 0.5, 7.25]),
            feeds_mm_per_min: self.one_of(&[&[1000.0][..], &[2000.0, 100.0]]).to_vec(),
            dwell_s: self.one_of(&[5.0, 2.5]),
            repeats: self.one_of(&[None, Some(1), Some(2)]),
            gauge: self.one_of(&[
                None,
                Some(MeasuringInstrument::Dial),
                Some(MeasuringInstrument::Laser),
            ]),
            heat_s: Some(self.between(1200.0, 1500.0)),
            heat_feed_mm_per_min: self.one_of(&[3000.0, 300.0]),
            ..MeasurementOptions::default()
        };
        Some(Draw { number: self.number, machine, options })
    }
}
