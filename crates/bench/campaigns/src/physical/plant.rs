//! A machine that is healthy as drawn, what its user believes, and its record with faults.

use super::{
    Fault, axis,
    kind::{Directions, HELD_C, Kind},
    spindle,
};
use trueup_twin::{ambient::AmbientConfig, noise::Stream, scenario::Scenario};

/// A machine.
#[derive(Clone, Debug)]
pub struct Plant {
    /// Its kind.
    pub kind: Kind,
    /// The machine file of its user (TOML): what the machine is without a fault.
    pub machine: String,
    /// The quantity that the gauge measures: `elongation` or `dx`.
    pub quantity: &'static str,
    /// The gauge's own noise in µm, standard deviation.
    pub gauge_um: f64,
    seed: u64,
    /// The machine alone: no room yet, and nothing that it does.
    bare: Scenario,
    directions: Directions,
}

impl Plant {
    /// Returns the machine of this kind that `seed` draws.
    #[must_use]
    pub fn draw(kind: Kind, seed: u64) -> Self {
        let mut stream = Stream::new(seed, "physical machine");
        let directions = Directions {
            gain: stream.sign(),
            coil: stream.sign(),
            drift: stream.sign(),
            mounting: stream.sign(),
            wear_along: if stream.chance(0.5) { stream.uniform(0.2, 0.6) } else { 0.0 },
            tools: tools(seed),
        };
        let gauge_um = stream.log_uniform(0.1, 0.4);
        let (mut bare, machine, quantity) = if kind.is_axis() {
            let (bare, machine) = axis::draw(kind, &mut stream);
            (bare, machine, "dx")
        } else {
            let (bare, machine) = spindle::draw(kind, &mut stream);
            (bare, machine, "elongation")
        };
        bare.instrument.noise_um = gauge_um;
        bare.instrument.quantum_um = 0.01;
        Self { kind, machine, quantity, gauge_um, seed, bare, directions }
    }

    /// Returns what the machine is and does on a day of its own, with `faults` and their sizes.
    #[must_use]
    pub fn day(&self, number: u64, faults: &[(Fault, f64)]) -> Scenario {
        let mut stream = Stream::new(self.seed, &format!("physical day {number}"));
        let mut scenario = self.bare.clone();
        let swing_c = if self.kind == Kind::CompensatedAxis { 1.0 } else { 0.0 };
        scenario.ambient = room(swing_c, &mut stream);
        if self.kind.is_axis() {
            axis::programme(&mut scenario, &mut stream);
        } else {
            spindle::programme(&mut scenario, &mut stream);
        }
        if self.kind == Kind::ToolSpindle {
            let mut stream = Stream::new(self.seed, &format!("tools of day {number}"));
            spindle::change_tools(&mut scenario, &mut stream);
        }
        for &(fault, size) in faults {
            self.damage(&mut scenario, fault, size);
        }
        scenario
    }

    /// Returns the same day of the machine that has not this fault, but all around that comes with its size:
    /// what a fault does is the difference.
    #[must_use]
    pub fn day_without(&self, number: u64, fault: Fault, size: f64) -> Scenario {
        let mut scenario = self.day(number, &[]);
        if fault == Fault::MisplacedThermometer {
            swing(&mut scenario.ambient, size);
        }
        scenario
    }

    /// Returns the seed of all chance of a day.
    #[must_use]
    pub fn seed_of_day(&self, number: u64) -> u64 {
        // Days of one machine, and machines of neighbouring seeds, far apart from each other.
        self.seed.wrapping_mul(0x9e37_79b9_7f4a_7c15).wrapping_add(number)
    }

    fn damage(&self, scenario: &mut Scenario, fault: Fault, size: f64) {
        let Directions { drift, .. } = self.directions;
        match fault {
            Fault::Room => {
                scenario.ambient.amplitude_c = 1.0;
                scenario.ambient.wander_c = 0.5;
                swing(&mut scenario.ambient, size);
            }
            Fault::GaugeDrift => scenario.instrument.drift_um_per_h = drift * size,
            _ if self.kind.is_axis() => axis::damage(scenario, fault, size, &self.directions),
            _ => spindle::damage(scenario, fault, size, &self.directions),
        }
        if fault == Fault::MisplacedThermometer {
            swing(&mut scenario.ambient, size);
        }
    }
}

/// Draws what the tools differ by: one does nothing, one grows back, two grow by different amounts.
fn tools(seed: u64) -> [f64; 4] {
    let mut stream = Stream::new(seed, "tools");
    let mut shares = vec![0.0, -stream.uniform(0.3, 0.7), stream.uniform(0.4, 0.7), 1.0];
    [(); 4].map(|()| shares.swap_remove(stream.whole(0, shares.len() - 1)))
}

/// Returns a room that swings by `swing_c` over the day and wanders by half of that, from some hour on.
fn room(swing_c: f64, stream: &mut Stream) -> AmbientConfig {
    AmbientConfig {
        mean_c: HELD_C,
        amplitude_c: swing_c,
        warmest_h: stream.uniform(0.0, 24.0),
        trend_c_per_h: 0.0,
        wander_c: 0.5 * swing_c,
        wander_s: 3600.0,
    }
}

fn swing(room: &mut AmbientConfig, size: f64) {
    room.amplitude_c *= size;
    room.wander_c *= size;
}
