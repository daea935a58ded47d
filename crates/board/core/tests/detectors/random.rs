//! Random numbers for the draws.

use std::{f64::consts::TAU, sync::OnceLock};

use trueup_core::design_parameters::CODES_PER_TICK;

/// A generator of random numbers; normal ones are from a table: a thousand million codes are asked for.
pub struct Random {
    state: u64,
    normal: &'static [f32],
}

impl Random {
    pub fn new(seed: u64) -> Self {
        static TABLE: OnceLock<Vec<f32>> = OnceLock::new();
        let seeded = |seed: u64| seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
        let normal = TABLE.get_or_init(|| {
            let mut random = Self { state: seeded(0), normal: &[] };
            let normal = |_| {
                // Box and Muller.
                let (a, b) = (1.0 - random.uniform(), random.uniform());
                ((-2.0 * a.ln()).sqrt() * (TAU * b).cos()) as f32
            };
            (0..1 << 16).map(normal).collect()
        });
        Self { state: seeded(seed), normal }
    }

    pub fn bits(&mut self) -> u64 {
        self.state ^= self.state << 13;
        self.state ^= self.state >> 7;
        self.state ^= self.state << 17;
        self.state
    }

    /// 0 to below 1.
    pub fn uniform(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1_u64 << 53) as f64
    }

    pub fn between(&mut self, least: f64, most: f64) -> f64 {
        least + (most - least) * self.uniform()
    }

    pub fn normal(&mut self) -> f64 {
        self.normal[(self.bits() >> 48) as usize].into()
    }

    /// Those of a block, four of a draw.
    pub fn normals(&mut self) -> [f32; CODES_PER_TICK] {
        let mut normals = [0.0; CODES_PER_TICK];
        for four in normals.chunks_mut(4) {
            // The low bits of the state alone are poor.
            let mut bits = self.bits().wrapping_mul(0x2545_F491_4F6C_DD1D);
            for normal in four {
                *normal = self.normal[usize::from(bits as u16)];
                bits >>= 16;
            }
        }
        normals
    }
}
