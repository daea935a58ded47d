//! `[limits]`: how far and how fast an offset may go, and how long silence is tolerated.

use super::{
    LinearAxis,
    read::Section,
    write::section::{NewSection, Value},
};
use crate::location::BadInput;

/// How far and how fast an offset may go, and how long silence is tolerated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// The largest offset on X, Y and Z in µm, either way; at least 0.
    pub max_um: [f64; 3],
    /// The fastest change of an offset in µm a second, above 0.
    pub slew_um_per_s: f64,
    /// Without the CNC's sign of life for so long it counts as lost; at least 1.
    pub link_timeout_ms: u32,
    /// How long the last offset is held before it is taken back to 0.
    pub hold_ms: u32,
    /// How fast the difference between two sources of the elongation is taken back, in µm a second, above 0.
    pub rejoin_um_per_s: f64,
    /// How far what was learned may change the parts of the correction while the bridge runs.
    pub learned: LearnedCaps,
}

/// How far what was learned may change the parts of the correction while the bridge runs, either way.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LearnedCaps {
    /// The growth of the spindle, in percent of itself.
    pub growth_percent: f64,
    /// The expansion of each axis, in percent of itself.
    pub axes_percent: f64,
    /// The zero of the growth, in µm.
    pub zero_um: f64,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            max_um: [200.0, 200.0, 500.0],
            slew_um_per_s: 20.0,
            link_timeout_ms: 500,
            hold_ms: 2000,
            rejoin_um_per_s: 0.01,
            learned: LearnedCaps::default(),
        }
    }
}

pub(super) fn read(section: &Section<'_>) -> Result<Limits, BadInput> {
    let mut limits = Limits::default();
    if let Some(max) = section.section("max_um")? {
        let axes = LinearAxis::ALL.map(LinearAxis::name);
        for (limit, axis) in limits.max_um.iter_mut().zip(axes) {
            *limit = max.not_negative(axis)?.unwrap_or(*limit);
        }
    }
    limits.slew_um_per_s = section.positive("slew_um_per_s")?.unwrap_or(limits.slew_um_per_s);
    limits.link_timeout_ms =
        section.whole("link_timeout_ms", 1, u32::MAX)?.unwrap_or(limits.link_timeout_ms);
    limits.hold_ms = section.whole("hold_ms", 0, u32::MAX)?.unwrap_or(limits.hold_ms);
    limits.rejoin_um_per_s = section.positive("rejoin_um_per_s")?.unwrap_or(limits.rejoin_um_per_s);
    if let Some(learned) = section.section("learned")? {
        let caps = &mut limits.learned;
        for (key, cap) in [
            ("growth_percent", &mut caps.growth_percent),
            ("axes_percent", &mut caps.axes_percent),
            ("zero_um", &mut caps.zero_um),
        ] {
            *cap = learned.not_negative(key)?.unwrap_or(*cap);
        }
    }
    Ok(limits)
}

pub(super) fn write(limits: &Limits) -> NewSection {
    let axes = LinearAxis::ALL.map(|axis| axis.name().to_string());
    let max_um = axes.into_iter().zip(limits.max_um.map(Value::Number)).collect();
    let LearnedCaps { growth_percent, axes_percent, zero_um } = limits.learned;
    let section = NewSection::new("limits")
        .with("max_um", Value::Inline(max_um))
        .number("slew_um_per_s", limits.slew_um_per_s)
        .whole("link_timeout_ms", limits.link_timeout_ms)
        .whole("hold_ms", limits.hold_ms)
        .number("rejoin_um_per_s", limits.rejoin_um_per_s);
    // As most have it: nothing.
    if limits.learned == LearnedCaps::default() {
        return section;
    }
    let caps =
        [("growth_percent", growth_percent), ("axes_percent", axes_percent), ("zero_um", zero_um)];
    let caps = caps.map(|(key, cap)| (key.to_string(), Value::Number(cap)));
    section.with("learned", Value::Inline(caps.into()))
}
