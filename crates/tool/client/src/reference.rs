//! The reference of a bridge: in force or offered, its value, age, and by whom.

use std::time::{SystemTime, UNIX_EPOCH};

use anyhow::Result;
use serde_json::{Value, json};
use trueup_store::write_log::{WriteKind, WriteOrigin};

use crate::{
    sdo_object::{self, ObjectAddress},
    session::Session,
    write_log::format_utc,
};

/// Elongation, X, Y and Z in nm.
pub type ReferenceNm = [i32; 4];

/// Value of the object for the age where it is not known.
const UNKNOWN_AGE_S: u32 = u32::MAX;

/// The reference of a bridge.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BridgeReference {
    /// In force; `None`: errors count from the calibration's own zero.
    pub in_force: Option<ReferenceNm>,
    /// Offered: it waits for `Confirm`.
    pub offered: Option<ReferenceNm>,
    /// Whether it was taken by `Zero` or offered from a file, and over which line.
    pub origin: Option<(WriteKind, WriteOrigin)>,
    /// When, in seconds since 1970 (UTC).
    pub utc_s: Option<u32>,
    /// How long ago, in seconds.
    pub age_s: Option<u32>,
}

impl BridgeReference {
    /// Reads it from the bridge. One of a firmware before 0.3 offers none, and does not say by whom and when.
    ///
    /// # Errors
    /// The line breaks, or the bridge does not answer.
    pub fn read(session: &mut Session) -> Result<Self> {
        let mut all = Self::default();
        if sdo_object::read_number(session, sdo_object::REFERENCE_ACTIVE)? != 0 {
            all.in_force = Some(read_components(session, sdo_object::REFERENCE_COMPONENTS)?);
        }
        let offered = read_components(session, sdo_object::OFFERED_REFERENCE_COMPONENTS).ok();
        all.offered = offered.filter(|nm| !nm.contains(&sdo_object::NOT_AVAILABLE));
        if all.in_force.is_none() && all.offered.is_none() {
            return Ok(all);
        }
        let optional = |session: &mut Session, at| sdo_object::read_number(session, at).ok();
        let origin = optional(session, sdo_object::REFERENCE_ORIGIN);
        all.origin = origin.and_then(|number| {
            let [what, origin, ..] = number.to_le_bytes();
            let what = WriteKind::ALL.into_iter().find(|kind| *kind as u8 == what)?;
            Some((what, WriteOrigin::ALL.into_iter().find(|candidate| *candidate as u8 == origin)?))
        });
        all.utc_s =
            optional(session, sdo_object::REFERENCE_UTC_SECONDS).filter(|utc_s| *utc_s != 0);
        all.age_s = optional(session, sdo_object::REFERENCE_AGE_SECONDS)
            .filter(|age_s| *age_s != UNKNOWN_AGE_S);
        if let (None, Some(utc_s), Some(now_s)) = (all.age_s, all.utc_s, unix_time_s()) {
            all.age_s = Some(now_s.saturating_sub(utc_s));
        }
        Ok(all)
    }

    /// Returns the one that counts, or would.
    #[must_use]
    pub fn effective_value(&self) -> Option<ReferenceNm> {
        self.offered.or(self.in_force)
    }

    /// Value, by whom, when, and whether it is in force.
    #[must_use]
    pub fn to_text(&self) -> String {
        let Some(nm) = self.effective_value() else { return "the calibration's own zero".into() };
        let by = match self.origin {
            Some((WriteKind::Offered, line)) => {
                format!("restored from a file over {}", line.as_str())
            }
            Some((_, line)) => format!("taken by Zero of the CNC over {}", line.as_str()),
            None => "taken by Zero".into(),
        };
        let when = match (self.utc_s, self.age_s) {
            (Some(utc_s), Some(age_s)) => {
                format!("{}, {} ago", format_utc(utc_s), format_age(age_s))
            }
            (Some(utc_s), None) => format_utc(utc_s),
            (None, Some(age_s)) => format!("{} ago", format_age(age_s)),
            (None, None) => "its age is not known: the board had no time of day".into(),
        };
        let state = match self.offered {
            Some(_) => {
                "OFFERED, not in force: Confirm takes it, Zero replaces it, trueup bridge forget-reference declines it"
            }
            None => "in force",
        };
        format!("{}; {by}, {when}; {state}", format_reference(nm))
    }

    /// Returns the same as JSON members.
    #[must_use]
    pub fn to_json(&self) -> Value {
        let um = |nm: ReferenceNm| {
            let [elongation, x, y, z] = nm.map(|nm| f64::from(nm) / 1_000.0);
            json!({ "elongation_um": elongation, "x_um": x, "y_um": y, "z_um": z })
        };
        json!({
            "in_force": self.in_force.map(um),
            "offered": self.offered.map(um),
            "by": self.origin.map(|(what, _)| what.as_str()),
            "line": self.origin.map(|(_, line)| line.as_str()),
            "utc": self.utc_s.map(format_utc),
            "age_s": self.age_s,
        })
    }
}

fn read_components(session: &mut Session, places: [ObjectAddress; 4]) -> Result<ReferenceNm> {
    let mut nm = [0; 4];
    for (place, at) in nm.iter_mut().zip(places) {
        *place = sdo_object::read_number(session, at)?.cast_signed();
    }
    Ok(nm)
}

/// Seconds since 1970 by this computer.
pub(crate) fn unix_time_s() -> Option<u32> {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).ok()?;
    u32::try_from(since.as_secs()).ok()
}

/// Returns a reference in µm.
#[must_use]
pub fn format_reference(nm: ReferenceNm) -> String {
    let parts = ["elongation", "X", "Y", "Z"].into_iter().zip(nm);
    let parts = parts.map(|(name, nm)| format!("{name} {:+.2} µm", f64::from(nm) / 1_000.0));
    parts.collect::<Vec<_>>().join(", ")
}

/// Returns an age in its largest unit that is below two of the next.
fn format_age(age_s: u32) -> String {
    match age_s {
        0..120 => format!("{age_s} s"),
        120..7_200 => format!("{} min", age_s / 60),
        7_200..172_800 => format!("{} h", age_s / 3_600),
        _ => format!("{} days", age_s / 86_400),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reference_is_reported_with_value_age_by_whom_and_whether_it_counts() {
        let mut reference = BridgeReference::default();
        assert_eq!(reference.to_text(), "the calibration's own zero");
        reference.in_force = Some([32_840, 0, -1_500, 0]);
        reference.origin = Some((WriteKind::Zeroed, WriteOrigin::Can));
        reference.age_s = Some(10_900);
        assert_eq!(
            reference.to_text(),
            "elongation +32.84 µm, X +0.00 µm, Y -1.50 µm, Z +0.00 µm; taken by Zero of the CNC over can, 3 h ago; \
             in force"
        );
        (reference.offered, reference.in_force) = (reference.in_force, None);
        (reference.utc_s, reference.age_s) = (Some(1_709_164_800), Some(90));
        reference.origin = Some((WriteKind::Offered, WriteOrigin::Serial));
        let text = reference.to_text();
        assert!(
            text.contains(
                "restored from a file over serial, 2024-02-29T00:00:00Z, 90 s ago; OFFERED"
            )
        );
        assert_eq!(reference.to_json()["offered"]["elongation_um"], 32.84);
        (reference.utc_s, reference.age_s, reference.origin) = (None, None, None);
        assert!(reference.to_text().contains("its age is not known"), "{}", reference.to_text());
    }

    #[test]
    fn an_age_is_stated_in_its_unit() {
        for (age_s, expected) in [(0, "0 s"), (119, "119 s"), (120, "2 min"), (7_199, "119 min")] {
            assert_eq!(format_age(age_s), expected);
        }
        assert_eq!((format_age(7_200), format_age(400_000)), ("2 h".into(), "4 days".into()));
    }
}
