//! A machine that is healthy as drawn, what its user believes, and its record with faults.

use super::{
    PhysicalFault, axis,
    machine_kind::{CONTROLLED_ROOM_TEMPERATURE_C, FaultVariation, MachineKind},
    spindle,
};
use trueup_twin::{ambient::AmbientConfig, noise::RandomStream, scenario::Scenario};

/// A machine.
#[derive(Clone, Debug)]
pub struct Plant {
    /// Its kind.
    pub kind: MachineKind,
    /// The machine file of its user (TOML): what the machine is without a fault.
    pub machine: String,
    /// The quantity that the gauge measures: `elongation` or `dx`.
    pub quantity: &'static str,
    /// The gauge's own noise in µm, standard deviation.
    pub gauge_um: f64,
    seed: u64,
    /// The machine alone: no room yet, and nothing that it does.
    bare: Scenario,
    directions: FaultVariation,
}

impl Plant {
    /// Returns the machine of this kind that `seed` draws.
    #[must_use]
    pub fn draw(kind: MachineKind, seed: u64) -> Self {
        let mut stream = RandomStream::new(seed, "physical machine");
        let directions = FaultVariation {
            gain: stream.random_sign(),
            coil: stream.random_sign(),
            drift: stream.random_sign(),
            mounting: stream.random_sign(),
            wear_along: if stream.bernoulli(0.5) { stream.uniform(0.2, 0.6) } else { 0.0 },
            tools: draw_tool_growth(seed),
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
    pub fn scenario_for_day(&self, number: u64, faults: &[(PhysicalFault, f64)]) -> Scenario {
        let mut stream = RandomStream::new(self.seed, &format!("physical day {number}"));
        let mut scenario = self.bare.clone();
        let swing_c = if self.kind == MachineKind::CompensatedAxis { 1.0 } else { 0.0 };
        scenario.ambient = draw_ambient(swing_c, &mut stream);
        if self.kind.is_axis() {
            axis::add_day_programme(&mut scenario, &mut stream);
        } else {
            spindle::add_day_programme(&mut scenario, &mut stream);
        }
        if self.kind == MachineKind::ToolSpindle {
            let mut stream = RandomStream::new(self.seed, &format!("tools of day {number}"));
            spindle::insert_tool_changes(&mut scenario, &mut stream);
        }
        for &(fault, size) in faults {
            self.apply_fault(&mut scenario, fault, size);
        }
        scenario
    }

    /// Returns the same day of the machine that has not this fault, but all around that comes with its size:
    /// what a fault does is the difference.
    #[must_use]
    pub(crate) fn scenario_without_fault(
        &self,
        number: u64,
        fault: PhysicalFault,
        size: f64,
    ) -> Scenario {
        let mut scenario = self.scenario_for_day(number, &[]);
        if fault == PhysicalFault::MisplacedThermometer {
            scale_ambient_temperature_swing(&mut scenario.ambient, size);
        }
        scenario
    }

    /// Returns the seed of all chance of a day.
    #[must_use]
    pub(crate) fn day_seed(&self, number: u64) -> u64 {
        // Days of one machine, and machines of neighbouring seeds, far apart from each other.
        self.seed.wrapping_mul(0x9e37_79b9_7f4a_7c15).wrapping_add(number)
    }

    fn apply_fault(&self, scenario: &mut Scenario, fault: PhysicalFault, size: f64) {
        let FaultVariation { drift, .. } = self.directions;
        match fault {
            PhysicalFault::Room => {
                scenario.ambient.amplitude_c = 1.0;
                scenario.ambient.wander_c = 0.5;
                scale_ambient_temperature_swing(&mut scenario.ambient, size);
            }
            PhysicalFault::GaugeDrift => scenario.instrument.drift_um_per_h = drift * size,
            _ if self.kind.is_axis() => axis::apply_fault(scenario, fault, size, &self.directions),
            _ => spindle::apply_fault(scenario, fault, size, &self.directions),
        }
        if fault == PhysicalFault::MisplacedThermometer {
            scale_ambient_temperature_swing(&mut scenario.ambient, size);
        }
    }
}

/// Draws what the tools differ by: one does nothing, one grows back, two grow by different amounts.
fn draw_tool_growth(seed: u64) -> [f64; 4] {
    let mut stream = RandomStream::new(seed, "tools");
    let mut shares = vec![0.0, -stream.uniform(0.3, 0.7), stream.uniform(0.4, 0.7), 1.0];
    [(); 4].map(|()| shares.swap_remove(stream.uniform_integer(0, shares.len() - 1)))
}

/// Returns a room that swings by `swing_c` over the day and wanders by half of that, from some hour on.
fn draw_ambient(swing_c: f64, stream: &mut RandomStream) -> AmbientConfig {
    AmbientConfig {
        mean_c: CONTROLLED_ROOM_TEMPERATURE_C,
        amplitude_c: swing_c,
        warmest_h: stream.uniform(0.0, 24.0),
        trend_c_per_h: 0.0,
        wander_c: 0.5 * swing_c,
        wander_s: 3600.0,
    }
}

fn scale_ambient_temperature_swing(room: &mut AmbientConfig, size: f64) {
    room.amplitude_c *= size;
    room.wander_c *= size;
}
