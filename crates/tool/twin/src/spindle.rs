//! A motorised spindle: what heats it, what cools it, and how far its tool tip comes out.
//!
//! ```text
//!  tool  holder │ front bearing      motor        rear bearing │
//!  ─────────────┼────[ Q ]────────[ Q  Q  Q ]────────[ Q ]─────┤   shaft: heat::Rod
//!               0 m: nose, sensor                              length
//! ```
//!
//! - Heat of a bearing (Palmgren): Q = ω·(M_load + M_visc), M_load = f₁·F·d_m,
//!   M_visc = f₀·10⁻⁷·(ν·n)^(2/3)·d_m³ N·mm (ν in mm²/s, n in r/min, d_m in mm). A share goes into the
//!   shaft, the rest into the housing. The preload F may follow the temperature of shaft over housing.
//! - Loss of the motor: idle·(n/n_max)^1.5 + what the cutting load adds.
//! - The shaft loses heat to the air, h = h₀ + h₁·(n/1000)^(2/3) (a turning cylinder), and along the
//!   motor to the coolant. Housing, holder and the sensor's coil are one node each.
//! - Growth of the shaft is the integral of its expansion from the nose to the fixed bearing; at speed
//!   c·(n/1000)² comes on top at once. The sensor in the nose sees these two. The tip has also the
//!   housing, the holder and the tool beyond the sensor, and gives way to the axial force by
//!   load/stiffness. All growth is positive out of the spindle.

use schemars::JsonSchema;
use serde::Deserialize;

use crate::{
    heat_conduction::{BoundaryCondition, HeatBalance, Material, Rod},
    scenario_error::{RuleViolation, keys},
};

/// A spindle as a scenario describes it; the defaults are a 24 000 r/min motorised spindle.
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct SpindleConfig {
    /// Length of the shaft in m.
    pub length_m: f64,
    /// Diameter of the shaft in mm.
    pub diameter_mm: f64,
    /// Into how many cells the shaft is cut.
    pub cells: usize,
    /// The temperature at which all growth is 0, in °C.
    pub reference_c: f64,
    /// The front bearing, from the nose, in m.
    pub front_bearing_m: f64,
    /// The rear bearing, from the nose, in m.
    pub rear_bearing_m: f64,
    /// The bearing that holds the shaft along its axis, from the nose, in m.
    pub fixed_at_m: f64,
    /// Where the motor begins and ends, from the nose, in m.
    pub motor_m: [f64; 2],
    /// Mean diameter of a bearing in mm.
    pub bearing_diameter_mm: f64,
    /// Viscosity of the lubricant in mm²/s.
    pub viscosity_mm2_per_s: f64,
    /// f₀ of the viscous torque.
    pub viscous_factor: f64,
    /// f₁ of the torque under load.
    pub load_factor: f64,
    /// Preload of a bearing at rest in N.
    pub preload_n: f64,
    /// How the preload grows with the front bearing's temperature over the housing's, in 1/K.
    pub preload_per_c: f64,
    /// The share of a bearing's heat that goes into the shaft, 0…1.
    pub shaft_share: f64,
    /// Highest speed in r/min.
    pub max_rpm: f64,
    /// Loss in the rotor at the highest speed without a load, in W.
    pub idle_loss_w: f64,
    /// Loss in the rotor for a newton of cutting force, in W/N.
    pub loss_w_per_n: f64,
    /// Heat transfer to the air at rest in W/(m²·K).
    pub still_h_w_per_m2_k: f64,
    /// Increase of it at 1000 r/min, in W/(m²·K); it rises with the power 2/3 of the speed.
    pub speed_h_w_per_m2_k: f64,
    /// From the shaft along the motor to the coolant, in W/K.
    pub coolant_w_per_k: f64,
    /// Heat capacity of the housing in J/K.
    pub housing_j_per_k: f64,
    /// From the housing to the air in W/K.
    pub housing_air_w_per_k: f64,
    /// From the housing to the coolant in W/K.
    pub housing_coolant_w_per_k: f64,
    /// The length of housing that moves the nose out as it expands, in m; negative: back.
    pub housing_length_m: f64,
    /// Length of tool and holder beyond the sensor in m.
    pub holder_length_m: f64,
    /// Time constant with which the holder follows the nose, in s.
    pub holder_lag_s: f64,
    /// How far the holder stays between the nose's temperature (0) and the air's (1).
    pub holder_air_share: f64,
    /// Time constant of the displacement sensor's coil in s.
    pub coil_lag_s: f64,
    /// How far the coil stays between the nose's temperature (0) and the air's (1).
    pub coil_air_share: f64,
    /// Growth by speed in µm at 1000 r/min; proportional to the square of the speed.
    pub centrifugal_um_per_krpm2: f64,
    /// Axial stiffness in N/µm; 0: rigid.
    pub stiffness_n_per_um: f64,
}

impl Default for SpindleConfig {
    fn default() -> Self {
        Self {
            length_m: 0.5,
            diameter_mm: 90.0,
            cells: 40,
            reference_c: 20.0,
            front_bearing_m: 0.06,
            rear_bearing_m: 0.42,
            fixed_at_m: 0.42,
            motor_m: [0.15, 0.35],
            bearing_diameter_mm: 70.0,
            viscosity_mm2_per_s: 20.0,
            viscous_factor: 1.0,
            load_factor: 0.0013,
            preload_n: 300.0,
            preload_per_c: 0.0,
            shaft_share: 0.25,
            max_rpm: 24_000.0,
            idle_loss_w: 100.0,
            loss_w_per_n: 0.1,
            still_h_w_per_m2_k: 10.0,
            speed_h_w_per_m2_k: 6.0,
            coolant_w_per_k: 12.0,
            housing_j_per_k: 120_000.0,
            housing_air_w_per_k: 20.0,
            housing_coolant_w_per_k: 40.0,
            housing_length_m: 0.05,
            holder_length_m: 0.12,
            holder_lag_s: 1500.0,
            holder_air_share: 0.6,
            coil_lag_s: 600.0,
            coil_air_share: 0.5,
            centrifugal_um_per_krpm2: 0.01,
            stiffness_n_per_um: 100.0,
        }
    }
}

impl SpindleConfig {
    /// Heat of one bearing at `spindle_rpm` under `preload_n`, in W.
    ///
    /// ```
    /// use trueup_twin::spindle::SpindleConfig;
    /// let spindle = SpindleConfig { viscous_factor: 0.0, ..SpindleConfig::default() };
    /// // Load alone: 0.0013 · 300 N · 70 mm = 27.3 N·mm; at 6000 r/min, ω = 628.3 rad/s.
    /// assert!((spindle.bearing_heat_w(6000.0, 300.0) - 0.0273 * 628.318_530_7).abs() < 1e-6);
    /// ```
    #[must_use]
    pub fn bearing_heat_w(&self, spindle_rpm: f64, preload_n: f64) -> f64 {
        let speed_rpm = spindle_rpm.abs();
        let mean_mm = self.bearing_diameter_mm;
        let load_nmm = self.load_factor * preload_n.max(0.0) * mean_mm;
        let viscous_nmm = self.viscous_factor
            * 1e-7
            * (self.viscosity_mm2_per_s * speed_rpm).powf(2.0 / 3.0)
            * mean_mm.powi(3);
        speed_rpm * std::f64::consts::TAU / 60.0 * (load_nmm + viscous_nmm) * 1e-3
    }

    /// The first rule that is broken.
    pub(crate) fn check(&self) -> Result<(), RuleViolation> {
        for (key, value) in
            keys!(self: length_m, diameter_mm, bearing_diameter_mm, max_rpm, housing_j_per_k)
        {
            if value <= 0.0 {
                return Err(RuleViolation::new(key, format!("must be above 0, not {value}")));
            }
        }
        RuleViolation::require_non_negative(
            &keys!(self: viscosity_mm2_per_s, viscous_factor, load_factor, preload_n, idle_loss_w, loss_w_per_n, still_h_w_per_m2_k, speed_h_w_per_m2_k, coolant_w_per_k, housing_air_w_per_k, housing_coolant_w_per_k, holder_lag_s, coil_lag_s, stiffness_n_per_um),
        )?;
        RuleViolation::require_fractions(
            &keys!(self: shaft_share, holder_air_share, coil_air_share),
        )?;
        let on_shaft = 0.0..=self.length_m;
        for (key, value) in [
            ("front_bearing_m", self.front_bearing_m),
            ("rear_bearing_m", self.rear_bearing_m),
            ("fixed_at_m", self.fixed_at_m),
            ("motor_m", self.motor_m[0]),
            ("motor_m", self.motor_m[1]),
        ] {
            if !on_shaft.contains(&value) {
                let rule = format!("must be on the shaft, 0…{}, not {value}", self.length_m);
                return Err(RuleViolation::new(key, rule));
            }
        }
        if self.motor_m[1] <= self.motor_m[0] {
            return Err(RuleViolation::new("motor_m", "must end after its beginning".into()));
        }
        if !(2..=2000).contains(&self.cells) {
            let rule = format!("must be from 2 to 2000, not {}", self.cells);
            return Err(RuleViolation::new("cells", rule));
        }
        Ok(())
    }
}

/// The surroundings and the drive of the spindle over one step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OperatingConditions {
    /// Speed in r/min.
    pub spindle_rpm: f64,
    /// Axial cutting force in N; positive pushes the tool back into the spindle.
    pub load_n: f64,
    /// Air in °C.
    pub ambient_c: f64,
    /// Coolant in °C.
    pub coolant_c: f64,
}

/// How far each part has grown, in µm, positive out of the spindle.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GrowthComponents {
    /// The shaft from the nose to the fixed bearing.
    pub shaft_um: f64,
    /// By centrifugal force; it grows with the square of the speed.
    pub centrifugal_um: f64,
    /// The housing under the nose.
    pub housing_um: f64,
    /// Tool and holder beyond the sensor.
    pub holder_um: f64,
    /// The tool by centrifugal force, beyond the sensor ([`crate::tool`]).
    pub tool_um: f64,
    /// Under the cutting force; negative where it pushes the tool back.
    pub elastic_um: f64,
}

impl GrowthComponents {
    /// Returns what a sensor in the nose sees.
    #[must_use]
    pub fn growth_at_sensor_um(&self) -> f64 {
        self.shaft_um + self.centrifugal_um
    }

    /// Returns what the tool tip does: the elongation.
    #[must_use]
    pub(crate) fn growth_at_tip_um(&self) -> f64 {
        self.growth_at_sensor_um()
            + self.housing_um
            + self.holder_um
            + self.tool_um
            + self.elastic_um
    }
}

/// Temperatures in °C that a thermometer may be put on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpindleTemperatures {
    /// The shaft at the front bearing.
    pub front_c: f64,
    /// The shaft at the rear bearing.
    pub rear_c: f64,
    /// The shaft in the middle of the motor.
    pub motor_c: f64,
    /// The shaft at the nose.
    pub nose_c: f64,
    /// The housing under the nose.
    pub housing_c: f64,
    /// Tool and holder.
    pub holder_c: f64,
    /// The coil of the displacement sensor.
    pub coil_c: f64,
}

/// A spindle on its way through a run.
#[derive(Clone, Debug)]
pub struct SimulatedSpindle {
    config: SpindleConfig,
    shaft: Rod,
    housing_c: f64,
    holder_c: f64,
    coil_c: f64,
    front: usize,
    rear: usize,
    fixed: usize,
    motor: (usize, usize),
    drive: OperatingConditions,
}

impl SimulatedSpindle {
    /// Cold: everything at `start_c`, standing still.
    #[must_use]
    pub fn new(config: &SpindleConfig, start_c: f64) -> Self {
        let radius_m = config.diameter_mm * 0.5e-3;
        let area_m2 = std::f64::consts::PI * radius_m * radius_m;
        // Backward Euler: a spindle is switched on and off, and must not ring.
        let shaft = Rod::new(config.length_m, area_m2, Material::STEEL, config.cells, start_c, 1.0);
        let (first, last) =
            (shaft.cell_index_at(config.motor_m[0]), shaft.cell_index_at(config.motor_m[1]));
        Self {
            front: shaft.cell_index_at(config.front_bearing_m),
            rear: shaft.cell_index_at(config.rear_bearing_m),
            fixed: shaft.cell_index_at(config.fixed_at_m),
            motor: (first, last.max(first + 1).min(config.cells)),
            shaft,
            config: config.clone(),
            housing_c: start_c,
            holder_c: start_c,
            coil_c: start_c,
            drive: OperatingConditions {
                spindle_rpm: 0.0,
                load_n: 0.0,
                ambient_c: start_c,
                coolant_c: start_c,
            },
        }
    }

    /// Steps on by `dt_s`, above 0, under `drive`. Returns where the shaft's heat went.
    pub fn step(&mut self, dt_s: f64, drive: &OperatingConditions) -> HeatBalance {
        let config = &self.config;
        self.drive = *drive;
        let krpm = drive.spindle_rpm.abs() / 1000.0;
        let front_c = self.shaft.temperatures_c()[self.front];
        let stiffening = 1.0 + config.preload_per_c * (front_c - self.housing_c);
        let bearing_w =
            config.bearing_heat_w(drive.spindle_rpm, config.preload_n * stiffening.max(0.0));
        // A lathe's cut does not heat a motor that stands still.
        let load_w = if krpm > 0.0 { config.loss_w_per_n * drive.load_n.abs() } else { 0.0 };
        let motor_w = config.idle_loss_w * (krpm * 1000.0 / config.max_rpm).powf(1.5) + load_w;

        self.shaft.sources_w.fill(0.0);
        self.shaft.sources_w[self.front] += config.shaft_share * bearing_w;
        self.shaft.sources_w[self.rear] += config.shaft_share * bearing_w;
        let (first, end) = self.motor;
        let cells = (end - first) as f64;
        for source_w in &mut self.shaft.sources_w[first..end] {
            *source_w += motor_w / cells;
        }
        let h = config.still_h_w_per_m2_k + config.speed_h_w_per_m2_k * krpm.powf(2.0 / 3.0);
        let air_w_per_k =
            h * std::f64::consts::PI * config.diameter_mm * 1e-3 * self.shaft.cell_length_m();
        self.shaft.sides_w_per_k.fill(air_w_per_k);
        self.shaft.surroundings_c.fill(drive.ambient_c);
        for cell in first..end {
            // Two neighbours in parallel: the sum of the conductances, at their weighted mean.
            let coolant = config.coolant_w_per_k / cells;
            self.shaft.sides_w_per_k[cell] = air_w_per_k + coolant;
            self.shaft.surroundings_c[cell] = (air_w_per_k * drive.ambient_c
                + coolant * drive.coolant_c)
                / (air_w_per_k + coolant).max(f64::MIN_POSITIVE);
        }
        let film = BoundaryCondition::Film { h_w_per_m2_k: h, fluid_c: drive.ambient_c };
        (self.shaft.left, self.shaft.right) = (film, film);
        let account = self.shaft.step(dt_s);

        // The two nodes, exactly for a drive that is constant over the step.
        let out_w_per_k = config.housing_air_w_per_k + config.housing_coolant_w_per_k;
        let in_w = 2.0 * (1.0 - config.shaft_share) * bearing_w
            + config.housing_air_w_per_k * drive.ambient_c
            + config.housing_coolant_w_per_k * drive.coolant_c;
        self.housing_c = if out_w_per_k > 0.0 {
            let settled_c = in_w / out_w_per_k;
            let left = (-dt_s * out_w_per_k / config.housing_j_per_k).exp();
            settled_c + (self.housing_c - settled_c) * left
        } else {
            self.housing_c + dt_s * in_w / config.housing_j_per_k
        };
        let nose_c = self.shaft.temperatures_c()[0];
        let follow = |node_c: f64, air_share: f64, lag_s: f64| {
            let settled_c = air_share * drive.ambient_c + (1.0 - air_share) * nose_c;
            let left = if lag_s > 0.0 { (-dt_s / lag_s).exp() } else { 0.0 };
            settled_c + (node_c - settled_c) * left
        };
        self.holder_c = follow(self.holder_c, config.holder_air_share, config.holder_lag_s);
        self.coil_c = follow(self.coil_c, config.coil_air_share, config.coil_lag_s);
        account
    }

    /// Takes another tool out of the magazine, in air of `ambient_c`: it warms behind the nose from now on.
    pub(crate) fn load_cold_tool(&mut self, ambient_c: f64) {
        self.holder_c = ambient_c;
    }

    /// Returns the shaft, for an account of its heat.
    #[must_use]
    pub fn shaft(&self) -> &Rod {
        &self.shaft
    }

    /// Returns the current growth.
    #[must_use]
    pub fn growth(&self) -> GrowthComponents {
        let config = &self.config;
        let expansion = Material::STEEL.expansion_per_k;
        let krpm = self.drive.spindle_rpm / 1000.0;
        let stiffness = config.stiffness_n_per_um;
        let nodes_um =
            |length_m: f64, c: f64| length_m * expansion * (c - config.reference_c) * 1e6;
        GrowthComponents {
            shaft_um: self.shaft.thermal_expansion_m(0, self.fixed, config.reference_c) * 1e6,
            centrifugal_um: config.centrifugal_um_per_krpm2 * krpm * krpm,
            housing_um: nodes_um(config.housing_length_m, self.housing_c),
            holder_um: nodes_um(config.holder_length_m, self.holder_c),
            tool_um: 0.0,
            elastic_um: if stiffness > 0.0 { -self.drive.load_n / stiffness } else { 0.0 },
        }
    }

    /// Returns the temperatures as they are now.
    #[must_use]
    pub fn temperatures(&self) -> SpindleTemperatures {
        let shaft = self.shaft.temperatures_c();
        SpindleTemperatures {
            front_c: shaft[self.front],
            rear_c: shaft[self.rear],
            motor_c: shaft[(self.motor.0 + self.motor.1) / 2],
            nose_c: shaft[0],
            housing_c: self.housing_c,
            holder_c: self.holder_c,
            coil_c: self.coil_c,
        }
    }
}
