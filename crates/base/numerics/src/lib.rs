//! The numerics under `fit` and `diagnose`: nothing here knows what a machine tool is.
//!
//! | module | does |
//! |---|---|
//! | [`block_resampling`] | what a term is worth on blocks that were held out |
//! | [`fourier`] | Fourier sums over points at any spacing |
//! | [`least_squares`] | linear, nonlinear and mixed, with intervals |
//! | [`line`](mod@line) | a straight line, judged on the rows that it was not fitted to |
//! | [`noncentral_f`] | how likely a test finds an effect of a given size |
//! | [`noise`] | noise with a memory: its likelihood, its covariance, draws of it |
//! | [`parallel`] | work on all cores |
//! | [`random`] | random numbers that repeat |
//! | [`repeats`] | tables that were measured several times: gross readings, the decision, its power |
//! | [`robust`] | finds gross errors |
#![forbid(unsafe_code)]

pub mod block_resampling;
mod distributions;
pub mod fourier;
pub mod least_squares;
pub mod line;
pub mod noise;
pub mod noncentral_f;
pub mod parallel;
pub mod random;
pub mod repeats;
pub mod robust;

pub use distributions::{f_quantile, t_cdf, t_quantile};
