//! Heat conduction along a rod, in one dimension and over time, by finite volumes.
//!
//! Every cell i has a heat capacity C, exchanges heat with its neighbours through a conductance G
//! and with what surrounds it through a conductance S, and may hold a source Q:
//!
//! ```text
//! C_i·dT_i/dt = G_{i−1}·(T_{i−1} − T_i) + G_i·(T_{i+1} − T_i) + S_i·(U_i − T_i) + Q_i
//! ```
//!
//! The heat that leaves one cell enters the next, so that heat is conserved to rounding. Between the middles
//! of two cells of lengths a and b the resistance is a/(2kA) + b/(2kA). An end is held, cooled by a
//! film (resistance a/(2kA) + 1/(hA)), or insulated. Time is stepped by the θ rule, θ = 1 backward
//! Euler (first order, never oscillates) or θ = 1/2 Crank–Nicolson (second order); each step solves
//! a tridiagonal system by Thomas's elimination, which needs no pivoting because the diagonal
//! dominates.
//!
//! Measured by `tests/heat.rs` (`cargo test -p trueup-twin --test heat -- --show-output`), with 40
//! cells: the first eigenvalue of the slab off by 0.062 % between held faces and by 0.007 % under a
//! film of Bi = 1, the steady profile with a source by 0.012 %; order 2.00 in space, 0.99 (θ = 1) and
//! 2.01 (θ = 1/2) in time; energy closed within 1e-16 of the heat that moved.

/// The material of a rod.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Material {
    /// Thermal conductivity in W/(m·K).
    pub conductivity_w_per_m_k: f64,
    /// Density times specific heat in J/(m³·K).
    pub capacity_j_per_m3_k: f64,
    /// Linear expansion in 1/K.
    pub expansion_per_k: f64,
}

impl Material {
    /// Bearing and tool steel.
    pub const STEEL: Self = Self {
        conductivity_w_per_m_k: 45.0,
        capacity_j_per_m3_k: 7850.0 * 460.0,
        expansion_per_k: 11.5e-6,
    };
}

/// The boundary condition at an end of a rod.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum BoundaryCondition {
    /// No heat passes.
    Insulated,
    /// The face is held at a temperature, in °C.
    Held(f64),
    /// The face is in a fluid.
    Film {
        /// Heat transfer coefficient in W/(m²·K).
        h_w_per_m2_k: f64,
        /// The fluid's temperature in °C.
        fluid_c: f64,
    },
}

/// A rod of equal cells, its ends left and right.
#[derive(Clone, Debug)]
pub struct Rod {
    length_m: f64,
    area_m2: f64,
    material: Material,
    temperatures_c: Vec<f64>,
    /// Heat put into each cell, in W.
    pub sources_w: Vec<f64>,
    /// Conductance from each cell to what surrounds it, in W/K.
    pub sides_w_per_k: Vec<f64>,
    /// The temperature of what surrounds each cell, in °C.
    pub surroundings_c: Vec<f64>,
    /// Boundary condition at the left end.
    pub left: BoundaryCondition,
    /// Boundary condition at the right end.
    pub right: BoundaryCondition,
    /// 1: backward Euler; 1/2: Crank–Nicolson.
    theta: f64,
    scratch: Scratch,
}

/// Room for a step, kept so that a step allocates nothing.
#[derive(Clone, Debug)]
struct Scratch {
    upper: Vec<f64>,
    right: Vec<f64>,
}

/// Where the heat of one step went, in J.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct HeatBalance {
    /// Put in by the sources.
    pub from_sources_j: f64,
    /// Come in through the sides (negative: gone).
    pub through_sides_j: f64,
    /// Come in through the two ends (negative: gone).
    pub through_ends_j: f64,
}

impl HeatBalance {
    /// Returns all that has come in.
    #[must_use]
    pub fn total_heat_input_j(&self) -> f64 {
        self.from_sources_j + self.through_sides_j + self.through_ends_j
    }
}

impl Rod {
    /// Returns a rod of `cells` equal cells (at least 1) at `start_c`, insulated all round, without
    /// sources; `theta` from 1/2 to 1.
    #[must_use]
    pub fn new(
        length_m: f64,
        area_m2: f64,
        material: Material,
        cells: usize,
        start_c: f64,
        theta: f64,
    ) -> Self {
        let cells = cells.max(1);
        Self {
            length_m,
            area_m2,
            material,
            temperatures_c: vec![start_c; cells],
            sources_w: vec![0.0; cells],
            sides_w_per_k: vec![0.0; cells],
            surroundings_c: vec![start_c; cells],
            left: BoundaryCondition::Insulated,
            right: BoundaryCondition::Insulated,
            theta: theta.clamp(0.5, 1.0),
            scratch: Scratch { upper: vec![0.0; cells], right: vec![0.0; cells] },
        }
    }

    /// Returns the temperature of each cell in °C, from left to right.
    #[must_use]
    pub fn temperatures_c(&self) -> &[f64] {
        &self.temperatures_c
    }

    /// Puts the cells at other temperatures; `by_position_m` is asked for the middle of each.
    pub fn set_temperatures_c(&mut self, by_position_m: impl Fn(f64) -> f64) {
        let cell_m = self.cell_length_m();
        for (cell, temperature_c) in self.temperatures_c.iter_mut().enumerate() {
            *temperature_c = by_position_m((cell as f64 + 0.5) * cell_m);
        }
    }

    /// Returns the length of a cell in m.
    #[must_use]
    pub fn cell_length_m(&self) -> f64 {
        self.length_m / self.temperatures_c.len() as f64
    }

    /// Returns the cell in which `position_m` from the left end lies; the nearest one outside.
    #[must_use]
    pub(crate) fn cell_index_at(&self, position_m: f64) -> usize {
        // A cast from f64 saturates.
        ((position_m / self.cell_length_m()) as usize).min(self.temperatures_c.len() - 1)
    }

    /// Returns the heat above 0 °C that is stored, in J.
    #[must_use]
    pub fn stored_heat_j(&self) -> f64 {
        self.cell_capacity_j_per_k() * self.temperatures_c.iter().sum::<f64>()
    }

    /// Returns how much longer the cells `from..to` are than at `reference_c`, in m: the integral of the
    /// expansion.
    #[must_use]
    pub fn thermal_expansion_m(&self, from: usize, to: usize, reference_c: f64) -> f64 {
        let above = self.temperatures_c[from..to].iter().map(|t| t - reference_c).sum::<f64>();
        self.material.expansion_per_k * self.cell_length_m() * above
    }

    fn cell_capacity_j_per_k(&self) -> f64 {
        self.material.capacity_j_per_m3_k * self.area_m2 * self.cell_length_m()
    }

    /// Between the middles of two neighbours, in W/K.
    fn cell_conductance_w_per_k(&self) -> f64 {
        self.material.conductivity_w_per_m_k * self.area_m2 / self.cell_length_m()
    }

    /// From the middle of the outermost cell to what is at the end: W/K, and its temperature.
    fn boundary_conductance_and_temperature(&self, end: BoundaryCondition) -> (f64, f64) {
        let half_cell = 2.0 * self.cell_conductance_w_per_k();
        match end {
            BoundaryCondition::Insulated => (0.0, 0.0),
            BoundaryCondition::Held(face_c) => (half_cell, face_c),
            BoundaryCondition::Film { h_w_per_m2_k, fluid_c } if h_w_per_m2_k > 0.0 => {
                (1.0 / (1.0 / half_cell + 1.0 / (h_w_per_m2_k * self.area_m2)), fluid_c)
            }
            BoundaryCondition::Film { .. } => (0.0, 0.0),
        }
    }

    /// Steps on by `dt_s`, above 0. Returns where the heat went; its sum is the change of
    /// [`Self::stored_heat_j`] but for rounding.
    pub fn step(&mut self, dt_s: f64) -> HeatBalance {
        let count = self.temperatures_c.len();
        let last = count - 1;
        let (capacity, link) = (self.cell_capacity_j_per_k(), self.cell_conductance_w_per_k());
        let (left, left_c) = self.boundary_conductance_and_temperature(self.left);
        let (right, right_c) = self.boundary_conductance_and_temperature(self.right);
        let theta = self.theta;
        // Only the new temperatures and the mean of old and new matter: the change d of each cell is
        // solved for, (C/Δt − θ·K)·d = K·T_old + Q.
        let t = &self.temperatures_c;
        for cell in 0..count {
            let (before, after) =
                (if cell == 0 { left } else { link }, if cell == last { right } else { link });
            let before_c = if cell == 0 { left_c } else { t[cell - 1] };
            let after_c = if cell == last { right_c } else { t[cell + 1] };
            let side = self.sides_w_per_k[cell];
            let flow = before * (before_c - t[cell])
                + after * (after_c - t[cell])
                + side * (self.surroundings_c[cell] - t[cell])
                + self.sources_w[cell];
            let diagonal = capacity / dt_s + theta * (before + after + side);
            let lower = if cell == 0 { 0.0 } else { -theta * link };
            let upper = if cell == last { 0.0 } else { -theta * link };
            let (upper_before, right_before) = match cell.checked_sub(1) {
                Some(before) => (self.scratch.upper[before], self.scratch.right[before]),
                None => (0.0, 0.0),
            };
            let pivot = diagonal - lower * upper_before;
            self.scratch.upper[cell] = upper / pivot;
            self.scratch.right[cell] = (flow - lower * right_before) / pivot;
        }
        let mut change_after = 0.0;
        let mut account = HeatBalance::default();
        for cell in (0..count).rev() {
            let change = self.scratch.right[cell] - self.scratch.upper[cell] * change_after;
            change_after = change;
            let weighted_c = self.temperatures_c[cell] + theta * change;
            account.from_sources_j += dt_s * self.sources_w[cell];
            account.through_sides_j +=
                dt_s * self.sides_w_per_k[cell] * (self.surroundings_c[cell] - weighted_c);
            if cell == 0 {
                account.through_ends_j += dt_s * left * (left_c - weighted_c);
            }
            if cell == last {
                account.through_ends_j += dt_s * right * (right_c - weighted_c);
            }
            self.temperatures_c[cell] += change;
        }
        account
    }
}
