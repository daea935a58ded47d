//! Numbers for the tests that look drawn, always the same for a seed.

/// A linear congruential generator; its high half.
pub fn random(seed: &mut u64) -> u32 {
    *seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
    (*seed >> 32) as u32
}
