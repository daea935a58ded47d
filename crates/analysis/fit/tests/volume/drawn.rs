//! Machines with all errors of a volume drawn, and what instruments read of them.
//!
//! The truth is that of the virtual machine: rotations and translations of whole bodies, which shares no line with the model. The
//! set-up of an instrument (place, alignment, scale, beam, centre) is drawn as well and is not stated to the fit.

use std::fmt::Write as _;

use rand::{Rng as _, SeedableRng as _, seq::IndexedRandom as _};
use rand_chacha::ChaCha8Rng;
use trueup_twin::{
    axes::{AxesConfig, AxisConfig, AxisName, SimulatedAxes, StraightnessConfig},
    cubic_spline::CubicSpline,
    rigid_bodies::{Body, MovingAxis, error_um},
};

use crate::forms::{Law, normal};

/// Kind, the rotary axes under the workpiece from it to the bed, and those of the tool from the frame.
const KINDS: [(&str, &[usize], &[usize]); 8] = [
    ("3-axis", &[], &[]),
    ("table-table", &[2, 0], &[]),
    ("3-axis", &[], &[]),
    ("head-table", &[2], &[1]),
    ("head-head", &[], &[2, 0]),
    ("table-table", &[2, 1], &[]),
    ("head-table", &[0], &[2]),
    ("head-head", &[], &[2, 1]),
];

const LETTERS: [&str; 3] = ["x", "y", "z"];
const TURNS: [&str; 3] = ["a", "b", "c"];
const DRIVES: [MovingAxis; 6] =
    [MovingAxis::X, MovingAxis::Y, MovingAxis::Z, MovingAxis::A, MovingAxis::B, MovingAxis::C];
const NAMES: [AxisName; 3] = [AxisName::X, AxisName::Y, AxisName::Z];

/// Where the axes stand, and the length of the tool.
#[derive(Clone, Copy, Debug)]
pub struct At {
    pub mm: [f64; 3],
    pub deg: [f64; 3],
    pub tool_mm: f64,
}

/// A machine, as it is and as its file states it.
pub struct Drawn {
    pub file: String,
    pub travel_mm: [f64; 3],
    pub tools_mm: [f64; 2],
    pub random: ChaCha8Rng,
    pub kind: usize,
    axes: AxesConfig,
    bodies: Vec<Body>,
    lines_mm: [[f64; 3]; 3],
}

pub fn turned(vector: [f64; 3], about: usize, deg: f64) -> [f64; 3] {
    let (sin, cos) = deg.to_radians().sin_cos();
    let (u, v) = ((about + 1) % 3, (about + 2) % 3);
    let mut turned = vector;
    turned[u] = cos * vector[u] - sin * vector[v];
    turned[v] = sin * vector[u] + cos * vector[v];
    turned
}

impl Drawn {
    pub fn new(seed: u64, law: Law) -> Self {
        Self::of(seed, None, law)
    }

    /// Draws a machine of smooth errors, `size` times the usual ones.
    pub fn of_size(seed: u64, size: f64) -> Self {
        Self::of(seed, Some(size), Law::Polynomials)
    }

    /// `None` draws the size as well.
    fn of(seed: u64, stated: Option<f64>, law: Law) -> Self {
        let random = &mut ChaCha8Rng::seed_from_u64(seed);
        let kind = seed as usize % KINDS.len();
        let (name, table, head) = KINDS[kind];
        let travel_mm = [
            *[500.0, 650.0, 800.0].choose(random).expect("three"),
            *[400.0, 500.0, 600.0].choose(random).expect("three"),
            *[350.0, 450.0, 500.0].choose(random).expect("three"),
        ];
        let tool_mm = random.random_range(60.0_f64..120.0).round();
        let tools_mm = [tool_mm, tool_mm + 100.0];
        let mut linear = [0, 1, 2];
        linear.rotate_left(random.random_range(0..3));
        if random.random() {
            linear.swap(0, 1);
        }
        let under = seed as usize / KINDS.len() % 4;
        let mut chain = String::from("w");
        table.iter().for_each(|n| write!(chain, " {}'", TURNS[*n].to_uppercase()).expect("text"));
        linear[..under]
            .iter()
            .for_each(|n| write!(chain, " {}'", LETTERS[*n].to_uppercase()).expect("text"));
        chain.push_str(" b");
        linear[under..]
            .iter()
            .for_each(|n| write!(chain, " {}", LETTERS[*n].to_uppercase()).expect("text"));
        head.iter().for_each(|n| write!(chain, " {}", TURNS[*n].to_uppercase()).expect("text"));
        chain.push_str(" t");
        // How good a machine it is.
        let drawn = random.random_range(-0.7_f64..0.7).exp();
        let size = stated.unwrap_or(drawn);
        let mut axes = AxesConfig::default();
        for n in 0..3 {
            let pitch = law.form(random, travel_mm[n], 4.0 * size, 20.0 * size);
            axes.axes.insert(NAMES[n], AxisConfig { pitch, ..AxisConfig::default() });
            for m in (0..3).filter(|m| *m != n) {
                let points = law.form(random, travel_mm[m], 3.0 * size, 0.0);
                let um_per_m = 20.0 * size * normal(random);
                let (error, along) = (NAMES[n], NAMES[m]);
                axes.straightness.push(StraightnessConfig { error, along, points, um_per_m });
            }
        }
        let middle = travel_mm.map(|mm| 0.5 * mm);
        let mut lines_mm = [[0.0; 3]; 3];
        let around = |random: &mut ChaCha8Rng, mm: f64| {
            std::array::from_fn::<f64, 3, _>(|_| {
                (mm * (2.0 * random.random::<f64>() - 1.0)).round()
            })
        };
        for n in table {
            let off = around(random, 40.0);
            lines_mm[*n] = [middle[0] + off[0], middle[1] + off[1], middle[2] - tool_mm + off[2]];
        }
        for n in head {
            let off = around(random, 20.0);
            lines_mm[*n] = [off[0], off[1], 120.0 + off[2]];
        }
        let plain = |axis: usize, workpiece, at_mm| Body {
            axis: DRIVES[axis],
            workpiece,
            at_mm,
            turn_x: CubicSpline::default(),
            turn_y: CubicSpline::default(),
            turn_z: CubicSpline::default(),
            shift_um: [0.0; 3],
            tilt_urad: [0.0; 3],
        };
        let rotary = |random: &mut ChaCha8Rng, n: usize, workpiece| {
            let mut shift_um = std::array::from_fn(|_| 15.0 * size * normal(random));
            shift_um[n] = 0.0;
            let tilt_urad = std::array::from_fn(|_| 15.0 * size * normal(random));
            Body { shift_um, tilt_urad, ..plain(3 + n, workpiece, lines_mm[n]) }
        };
        let mut bodies: Vec<Body> = table.iter().map(|n| rotary(random, *n, true)).collect();
        for (place, n) in linear.into_iter().enumerate() {
            let mut turn = || law.form(random, travel_mm[n], 6.0 * size, 15.0 * size);
            let (turn_x, turn_y, turn_z) = (turn(), turn(), turn());
            bodies.push(Body { turn_x, turn_y, turn_z, ..plain(n, place < under, middle) });
        }
        bodies.extend(head.iter().map(|n| rotary(random, *n, false)));
        let names: Vec<&str> = head.iter().map(|n| TURNS[*n]).collect();
        let mut file = format!(
            "[machine]\nname = \"drawn\"\nkind = \"{name}\"\nhead_axes = {names:?}\nchain = \"{chain}\"\n\n[tool]\nlength_mm = {tool_mm:?}\n"
        );
        for n in table.iter().chain(head) {
            write!(file, "\n[rotary.{}]\npoint_mm = {:?}\n", TURNS[*n], lines_mm[*n])
                .expect("text");
        }
        let random = random.clone();
        Self { file, travel_mm, tools_mm, random, kind, axes, bodies, lines_mm }
    }

    fn table(&self) -> &'static [usize] {
        KINDS[self.kind].1
    }

    fn head(&self) -> &'static [usize] {
        KINDS[self.kind].2
    }

    /// Returns the rotary axes.
    pub fn rotary(&self) -> Vec<usize> {
        self.table().iter().chain(self.head()).copied().collect()
    }

    /// Returns the error of the tip as it is.
    pub fn error_um(&self, at: &At) -> [f64; 3] {
        let mut axes = SimulatedAxes::new(&self.axes, at.mm, 20.0);
        axes.step(1.0, at.mm, 20.0);
        let own = axes.error_um();
        let bodies = error_um(&self.bodies, [0.0, 0.0, -at.tool_mm], at.mm, at.deg);
        [0, 1, 2].map(|n| own[n] + bodies[n])
    }

    /// Returns the place of the tip on the workpiece, and the tip from the nose.
    pub fn on_workpiece_mm(&self, at: &At) -> [f64; 3] {
        let about = |point: [f64; 3], line: [f64; 3], n: usize, deg: f64| {
            let arm = turned([0, 1, 2].map(|k| point[k] - line[k]), n, deg);
            [0, 1, 2].map(|k| line[k] + arm[k])
        };
        let head = self.head().iter().rev();
        let tip = head
            .fold([0.0, 0.0, -at.tool_mm], |tip, &n| about(tip, self.lines_mm[n], n, at.deg[n]));
        let seen = [0, 1, 2].map(|k| at.mm[k] + tip[k]);
        // From the bed to the workpiece.
        self.table().iter().rev().fold(seen, |seen, &n| about(seen, self.lines_mm[n], n, at.deg[n]))
    }

    /// Returns a direction of the workpiece along the machine's axes.
    pub fn workpiece_to_machine(&self, vector: [f64; 3], at: &At) -> [f64; 3] {
        self.table().iter().fold(vector, |vector, &n| turned(vector, n, -at.deg[n]))
    }

    /// Returns a direction of the tool along the machine's axes.
    pub fn tool_to_machine(&self, vector: [f64; 3], at: &At) -> [f64; 3] {
        self.head().iter().rev().fold(vector, |vector, &n| turned(vector, n, at.deg[n]))
    }

    /// Returns whether the axes can go there.
    pub fn is_within(&self, at: &At) -> bool {
        (0..3).all(|n| (0.0..=self.travel_mm[n]).contains(&at.mm[n]))
    }

    /// Draws a pose anywhere in the volume.
    pub fn pose(&mut self, deg: Option<[f64; 3]>) -> At {
        let mm = self.travel_mm.map(|mm| mm * self.random.random::<f64>());
        let tool_mm = self.tools_mm[usize::from(self.random.random::<bool>())];
        let rotary = self.rotary();
        let mut own = [0.0; 3];
        for n in rotary {
            own[n] = self.random.random_range(-90.0..90.0);
        }
        At { mm, deg: deg.unwrap_or(own), tool_mm }
    }

    /// Returns a normal number of this standard deviation.
    pub fn noise(&mut self, sd: f64) -> f64 {
        sd * normal(&mut self.random)
    }
}
