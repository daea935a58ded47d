//! The heat conduction against closed forms: eigenvalues, steady states, orders, energy.

use std::f64::consts::PI;

use trueup_twin::heat_conduction::{BoundaryCondition, Material, Rod};

/// Numbers that are easy to reckon with: the diffusivity is 1e-5 m²/s.
const METAL: Material =
    Material { conductivity_w_per_m_k: 40.0, capacity_j_per_m3_k: 4e6, expansion_per_k: 1e-5 };
const DIFFUSIVITY: f64 = 1e-5;
const LENGTH_M: f64 = 0.2;
const AREA_M2: f64 = 1e-3;
const EULER: f64 = 1.0;
const CRANK_NICOLSON: f64 = 0.5;

fn rod(cells: usize, theta: f64) -> Rod {
    Rod::new(LENGTH_M, AREA_M2, METAL, cells, 0.0, theta)
}

/// By how much the slab's first mode decays in a second, from two times that are far enough on for
/// the others to have died.
fn decay(mut rod: Rod, from_s: f64, to_s: f64, dt_s: f64) -> f64 {
    let middle = rod.temperatures_c().len() / 2;
    let mut at = |from_s: f64, to_s: f64| {
        for _ in 0..((to_s - from_s) / dt_s).round() as usize {
            rod.step(dt_s);
        }
        rod.temperatures_c()[middle]
    };
    let (early, late) = (at(0.0, from_s), at(from_s, to_s));
    (early / late).ln() / (to_s - from_s)
}

#[test]
fn the_first_eigenvalue_of_the_slab_between_held_faces_is_pi_over_its_length() {
    let exact = DIFFUSIVITY * (PI / LENGTH_M).powi(2);
    let mut rod = rod(40, CRANK_NICOLSON);
    (rod.left, rod.right) = (BoundaryCondition::Held(0.0), BoundaryCondition::Held(0.0));
    rod.set_temperatures_c(|_| 1.0);
    let off = decay(rod, 400.0, 900.0, 1.0) / exact - 1.0;
    println!("held faces, 40 cells: eigenvalue off by {:.4} %", off * 100.0);
    assert!(off.abs() < 1e-3);
}

/// ζ·tan ζ = Bi; at Bi = 1 ζ = 0.860334 (over the half length, insulated at the other end).
#[test]
fn the_first_eigenvalue_of_the_slab_under_a_film_solves_biots_equation() {
    let h = 40.0 / LENGTH_M; // Bi = h·L/k = 1
    let (mut low, mut high) = (0.1_f64, 1.5_f64);
    for _ in 0..80 {
        let middle = 0.5 * (low + high);
        if middle * middle.tan() < 1.0 { low = middle } else { high = middle }
    }
    assert!((low - 0.860_334).abs() < 1e-6);
    let exact = DIFFUSIVITY * (low / LENGTH_M).powi(2);
    let mut rod = rod(40, CRANK_NICOLSON);
    rod.right = BoundaryCondition::Film { h_w_per_m2_k: h, fluid_c: 0.0 };
    rod.set_temperatures_c(|_| 1.0);
    let off = decay(rod, 4000.0, 9000.0, 5.0) / exact - 1.0;
    println!("film, Bi = 1, 40 cells: eigenvalue off by {:.4} %", off * 100.0);
    assert!(off.abs() < 1e-3);
}

/// Insulated on the left, film on the right, a source all along:
/// T = T_fluid + q·L/h + q·(L² − x²)/(2k).
#[test]
fn the_steady_state_with_a_source_is_the_parabola() {
    let (q, h) = (2e5, 300.0); // W/m³, W/(m²·K)
    let cells = 40;
    let mut rod = rod(cells, EULER);
    rod.right = BoundaryCondition::Film { h_w_per_m2_k: h, fluid_c: 20.0 };
    rod.sources_w.fill(q * AREA_M2 * LENGTH_M / cells as f64);
    for _ in 0..200 {
        rod.step(1e5);
    }
    let mut worst = 0.0_f64;
    for (cell, there) in rod.temperatures_c().iter().enumerate() {
        let x = (cell as f64 + 0.5) * rod.cell_length_m();
        let rise = q * LENGTH_M / h + q * (LENGTH_M * LENGTH_M - x * x) / (2.0 * 40.0);
        worst = worst.max(((there - 20.0) / rise - 1.0).abs());
    }
    println!("steady state with a source, 40 cells: off by at most {:.5} %", worst * 100.0);
    assert!(worst < 1e-3);
}

/// Growth in the steady state between held faces: the mean of a straight line times the length.
#[test]
fn growth_is_the_integral_of_the_expansion() {
    let mut rod = rod(20, EULER);
    (rod.left, rod.right) = (BoundaryCondition::Held(20.0), BoundaryCondition::Held(50.0));
    for _ in 0..200 {
        rod.step(1e5);
    }
    let grown_um = rod.thermal_expansion_m(0, 20, 20.0) * 1e6;
    // 0.2 m · 1e-5/K · 15 K
    assert!((grown_um - 30.0).abs() < 1e-9, "{grown_um}");
}

/// Returns the error of the half wave between held faces, which decays by its own eigenvalue: exact everywhere and always.
fn error_after(cells: usize, theta: f64, dt_s: f64, end_s: f64) -> f64 {
    let mut rod = rod(cells, theta);
    (rod.left, rod.right) = (BoundaryCondition::Held(0.0), BoundaryCondition::Held(0.0));
    rod.set_temperatures_c(|x| (PI * x / LENGTH_M).sin());
    for _ in 0..(end_s / dt_s).round() as usize {
        rod.step(dt_s);
    }
    let left = (-DIFFUSIVITY * (PI / LENGTH_M).powi(2) * end_s).exp();
    let square: f64 = rod
        .temperatures_c()
        .iter()
        .enumerate()
        .map(|(cell, there)| {
            let x = (cell as f64 + 0.5) * rod.cell_length_m();
            (there - left * (PI * x / LENGTH_M).sin()).powi(2)
        })
        .sum();
    (square / cells as f64).sqrt()
}

fn small(errors: &[f64]) -> String {
    errors.iter().map(|error| format!("{error:.2e}")).collect::<Vec<_>>().join(", ")
}

fn order(coarse: f64, fine: f64) -> f64 {
    (coarse / fine).log2()
}

#[test]
fn halving_the_cells_quarters_the_error() {
    let errors = [10, 20, 40, 80].map(|cells| error_after(cells, CRANK_NICOLSON, 0.25, 200.0));
    let orders = [0, 1, 2].map(|i| order(errors[i], errors[i + 1]));
    println!("space, 10 to 80 cells: errors {}, orders {orders:.3?}", small(&errors));
    assert!(orders.iter().all(|order| (1.9..2.1).contains(order)));
}

#[test]
fn halving_the_step_halves_eulers_error_and_quarters_crank_nicolsons() {
    // Cells so small that their error is far below that of the steps.
    for (theta, expected, steps) in
        [(EULER, 1.0, [40.0, 20.0, 10.0, 5.0]), (CRANK_NICOLSON, 2.0, [80.0, 40.0, 20.0, 10.0])]
    {
        let errors = steps.map(|dt_s| error_after(800, theta, dt_s, 400.0));
        let orders = [0, 1, 2].map(|i| order(errors[i], errors[i + 1]));
        println!("time, theta {theta}: errors {}, orders {orders:.3?}", small(&errors));
        assert!(orders.iter().all(|order| (order - expected).abs() < 0.1));
    }
}

/// A rod with everything: sources, sides, a film and a held end, steps of all lengths.
#[test]
fn the_energy_that_came_in_is_the_energy_that_is_stored() {
    for theta in [EULER, CRANK_NICOLSON, 0.7] {
        let mut rod = rod(33, theta);
        rod.left = BoundaryCondition::Held(35.0);
        rod.right = BoundaryCondition::Film { h_w_per_m2_k: 55.0, fluid_c: 12.0 };
        rod.sources_w[7] = 90.0;
        rod.sides_w_per_k.fill(0.05);
        rod.surroundings_c.fill(18.0);
        let start_j = rod.stored_heat_j();
        let (mut came_j, mut moved_j) = (0.0, 0.0);
        for step in 0..5000 {
            if step % 700 == 0 {
                rod.sources_w[20] = if rod.sources_w[20] == 0.0 { 60.0 } else { 0.0 };
            }
            let account = rod.step(0.1 * f64::from(1 + step % 97));
            came_j += account.total_heat_input_j();
            moved_j += account.from_sources_j.abs()
                + account.through_sides_j.abs()
                + account.through_ends_j.abs();
        }
        let left_over = (rod.stored_heat_j() - start_j - came_j).abs() / moved_j;
        println!("theta {theta}: energy closed within {left_over:.1e} of what moved");
        assert!(left_over < 1e-12);
    }
}

#[test]
fn an_insulated_rod_keeps_its_heat_and_becomes_even() {
    let mut rod = rod(16, EULER);
    rod.set_temperatures_c(|x| 100.0 * x);
    let stored_heat_j = rod.stored_heat_j();
    for _ in 0..1000 {
        rod.step(100.0);
    }
    assert!((rod.stored_heat_j() / stored_heat_j - 1.0).abs() < 1e-12);
    assert!(rod.temperatures_c().iter().all(|c| (c - 10.0).abs() < 1e-6));
}
