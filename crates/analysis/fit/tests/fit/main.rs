//! `fit` on curves whose constants are known, on the papers' figures and on measured data, in one program, so
//! that what the tests share is built and linked once.

mod backlash_by_feed;
mod circle;
mod circle_drawn;
mod elongation;
mod fitted_blobs;
mod pitch;
mod pitch_real;
mod pitch_rules;
mod pitch_support;
mod straightness;
mod straightness_bed;
mod straightness_paper;
mod support;
mod table1;
mod thermal;
mod warmup;
