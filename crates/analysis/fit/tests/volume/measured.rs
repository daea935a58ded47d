//! The readings of instruments on a drawn machine: run files with the columns of the reference. Each set-up has a place, an alignment, a
//! scale and a direction that is not stated to the fit.

use std::{f64::consts::TAU, fmt::Write as _};

use crate::drawn::{At, Drawn};

/// Noise of a reading in µm, and of a scale in µm/m.
pub const NOISE_UM: f64 = 1.0;
pub const SCALE_UM_PER_M: f64 = 1.0;

const BALLS: &str = "x_mm,y_mm,z_mm,a_deg,b_deg,c_deg,tool_length_mm,setup,measured_dx_um,measured_dy_um,measured_dz_um\n";

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// An artefact on the table.
struct Artefact {
    zero_um: [f64; 3],
    turn_urad: [f64; 3],
    scale_um_per_m: f64,
    number: usize,
}

/// Balls that a probe has touched.
pub struct Balls {
    text: String,
    artefact: Artefact,
    tips_um: [[f64; 3]; 2],
    setups: usize,
}

fn vector(machine: &mut Drawn, sd: f64) -> [f64; 3] {
    [0; 3].map(|_| machine.noise(sd))
}

impl Balls {
    pub fn new(machine: &mut Drawn) -> Self {
        let scale_um_per_m = machine.noise(SCALE_UM_PER_M);
        let tips_um = [vector(machine, 20.0), vector(machine, 20.0)];
        let artefact =
            Artefact { zero_um: [0.0; 3], turn_urad: [0.0; 3], scale_um_per_m, number: 0 };
        let mut balls = Self { text: BALLS.into(), artefact, tips_um, setups: 0 };
        balls.set_up(machine);
        balls
    }

    /// Puts the artefact down anew.
    pub fn set_up(&mut self, machine: &mut Drawn) {
        self.setups += 1;
        self.artefact.number = self.setups;
        self.artefact.zero_um = vector(machine, 300.0);
        self.artefact.turn_urad = vector(machine, 200.0);
    }

    pub fn probe(&mut self, machine: &mut Drawn, at: &At) {
        assert!(machine.is_within(at), "{at:?}");
        let own = machine.on_workpiece_mm(at);
        let Artefact { zero_um, turn_urad, scale_um_per_m, number } = &self.artefact;
        let turned = cross(*turn_urad, own).map(|component| component / 1000.0);
        let lies = [0, 1, 2].map(|n| zero_um[n] + turned[n] + scale_um_per_m * own[n] / 1000.0);
        let lies = machine.workpiece_to_machine(lies, at);
        let tip = usize::from(at.tool_mm != machine.tools_mm[0]);
        let tip = machine.tool_to_machine(self.tips_um[tip], at);
        let error = machine.error_um(at);
        let [x, y, z] = at.mm;
        let [a, b, c] = at.deg;
        write!(self.text, "{x},{y},{z},{a},{b},{c},{},{number}", at.tool_mm).expect("text");
        for n in 0..3 {
            let um = error[n] + lies[n] + tip[n] + machine.noise(NOISE_UM);
            write!(self.text, ",{um:.3}").expect("text");
        }
        self.text.push('\n');
    }

    pub fn csv(self) -> String {
        self.text
    }

    /// Probes a plate of 5 × 5 balls along two axes; the others stand at shares of their travel.
    pub fn plate(
        &mut self,
        machine: &mut Drawn,
        along: [usize; 2],
        others: [f64; 3],
        tool_mm: f64,
    ) {
        for one in 0..5 {
            for other in 0..5 {
                let mut shares = others;
                shares[along[0]] = f64::from(one) / 4.0;
                shares[along[1]] = f64::from(other) / 4.0;
                let mm = [0, 1, 2].map(|n| shares[n] * machine.travel_mm[n]);
                self.probe(machine, &At { mm, deg: [0.0; 3], tool_mm });
            }
        }
    }

    /// Probes a sphere that stays on the table while the rotary axes turn, where the axes can follow.
    pub fn sphere_at_angles(&mut self, machine: &mut Drawn, shares: [f64; 3], count: usize) {
        let mm = [0, 1, 2].map(|n| shares[n] * machine.travel_mm[n]);
        let [tool_mm, longer_mm] = machine.tools_mm;
        let place = machine.on_workpiece_mm(&At { mm, deg: [0.0; 3], tool_mm });
        for tool_mm in [tool_mm, longer_mm] {
            let mut done = 0;
            for _ in 0..20 * count {
                let mut at = machine.pose(None);
                (at.tool_mm, at.mm) = (tool_mm, mm);
                let off = machine.on_workpiece_mm(&at);
                let way = machine.workpiece_to_machine([0, 1, 2].map(|n| place[n] - off[n]), &at);
                at.mm = [0, 1, 2].map(|n| mm[n] + way[n]);
                if machine.is_within(&at) && done < count {
                    self.probe(machine, &at);
                    done += 1;
                }
            }
        }
    }
}

/// Returns step diagonals along the four body diagonals.
pub fn diagonals(machine: &mut Drawn) -> String {
    const STEPS: usize = 8;
    let mut text = String::from("x_mm,y_mm,z_mm,tool_length_mm,setup,measured_diagonal_um\n");
    let scale = machine.noise(SCALE_UM_PER_M);
    for setup in 0..4 {
        let mm = |n: usize, done: usize| {
            let share = done as f64 / STEPS as f64;
            let share = if n + 1 == setup { 1.0 - share } else { share };
            share * machine.travel_mm[n]
        };
        let way = [0, 1, 2].map(|n| mm(n, STEPS) - mm(n, 0));
        let length = way.iter().map(|component| component * component).sum::<f64>().sqrt();
        let toward = way.map(|component| component / length);
        let mut rows: Vec<[f64; 3]> = Vec::new();
        for step in 0..STEPS {
            for moved in 0..3 {
                rows.push([0, 1, 2].map(|n| mm(n, step + usize::from(n < moved))));
            }
        }
        rows.push([0, 1, 2].map(|n| mm(n, STEPS)));
        let beam = vector(machine, 300.0);
        let zero = machine.noise(100.0);
        for mm in rows {
            let at = At { mm, deg: [0.0; 3], tool_mm: machine.tools_mm[0] };
            let error = machine.error_um(&at);
            let along: f64 = (0..3).map(|n| toward[n] * mm[n]).sum();
            // The beam is turned across itself; along it nothing changes to first order.
            let tilt = (0..3).map(|n| beam[n] * (mm[n] - along * toward[n])).sum::<f64>() / 1000.0;
            let um = (0..3).map(|n| toward[n] * error[n]).sum::<f64>()
                + zero
                + tilt
                + scale * along / 1000.0
                + machine.noise(NOISE_UM);
            let [x, y, z] = mm;
            writeln!(text, "{x},{y},{z},{},{setup},{um:.3}", at.tool_mm).expect("text");
        }
    }
    text
}

/// Returns circles of a ball bar in the three planes, each at two places of the third axis, in both directions.
pub fn circles(machine: &mut Drawn) -> String {
    let mut text = String::from("x_mm,y_mm,z_mm,tool_length_mm,setup,run,dir,measured_dr_um\n");
    let mut number = 0;
    for still in 0..3 {
        let [u, v] = [(still + 1) % 3, (still + 2) % 3];
        let radius = (0.48 * machine.travel_mm[u].min(machine.travel_mm[v])).min(300.0);
        for share in [0.1, 0.9] {
            number += 1;
            let setup = vector(machine, 20.0);
            let servo = machine.noise(2.0);
            for sense in [1.0, -1.0] {
                for n in 0..180 {
                    let angle = sense * TAU * f64::from(n) / 180.0 + 0.01;
                    let (sin, cos) = angle.sin_cos();
                    let mut mm = machine.travel_mm.map(|mm| share * mm);
                    mm[u] = 0.5 * machine.travel_mm[u] + radius * cos;
                    mm[v] = 0.5 * machine.travel_mm[v] + radius * sin;
                    let at = At { mm, deg: [0.0; 3], tool_mm: machine.tools_mm[0] };
                    let error = machine.error_um(&at);
                    let um = error[u] * cos
                        + error[v] * sin
                        + setup[0]
                        + setup[1] * cos
                        + setup[2] * sin
                        + servo * sense * (2.0 * angle).sin()
                        + machine.noise(NOISE_UM);
                    let [x, y, z] = mm;
                    writeln!(text, "{x},{y},{z},{},{number},{number},{sense},{um:.3}", at.tool_mm)
                        .expect("text");
                }
            }
        }
    }
    text
}
