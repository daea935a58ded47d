//! `trueup bridge`: what can be asked of a bridge. How it is spoken to is in `trueup-client`.

pub mod info;
pub mod load;
pub mod monitor;
