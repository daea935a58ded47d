//! How many and how often: the numbers that the board, its calibration and its frames are built for.
//!
//! They stand below everything else, so that a module that needs one of them needs nothing more.

/// Temperature channels of a board.
pub const TEMPERATURE_CHANNEL_COUNT: usize = 8;

/// The most terms of a diagnosis that a calibration holds.
pub const MAX_TERMS: usize = 16;

/// The conditions of the machine that the CNC sends, a bit each.
pub const CONDITION_COUNT: u8 = 16;

/// The most tools that a term over the tool knows.
pub const MAX_TOOLS: usize = 32;

/// Conversions of the displacement sensor in one tick: 1 ms at 20 kS/s.
pub const CODES_PER_TICK: usize = 20;

/// The step of everything that follows heat and running time, in milliseconds.
pub const THERMAL_STEP_MS: u32 = 100;
