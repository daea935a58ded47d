//! All that a board holds, in one file: its calibration, its reference, what it has learned, its log.
//!
//! The file is JSON. A checksum covers what goes back into a board, so that an edited number is found: a reference
//! moves every tool. Files of version 0.2 have none; their reference is bounded like any other
//! ([`trueup_core::bridge::Bridge::permits`]) and has to be confirmed at the CNC, as every restored one.

use anyhow::{Result, bail};
use crc::{CRC_32_ISO_HDLC, Crc};
use serde_json::{Value, json};
use trueup_core::{
    bridge::{Bridge, Reference},
    units::{Fine, Nanometres as Nm},
};
use trueup_store::calibration::{decode, identity};

use crate::{
    load, object,
    reference::{BridgeReference, Nanometres, micrometres_text},
    session::Session,
    writes,
};

/// Name of the file's format.
const FORMAT: &str = "trueup-bridge-1";
/// Keys of the parts of the reference in the file.
const REFERENCE: [&str; 4] = ["elongation_nm", "x_nm", "y_nm", "z_nm"];
/// Keys that the checksum covers, in this order.
const PROTECTED: [&str; 8] = [
    "format",
    "machine",
    "machine_serial",
    "board_serial",
    "calibration_crc",
    "calibration",
    "reference",
    "learned",
];

/// Whose board it is.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Owner {
    /// The name of its machine; empty: none.
    pub machine: String,
    /// The serial number of its machine; empty: none.
    pub serial: String,
    /// The hash of its chip's number, eight hexadecimal digits; empty: not known.
    pub board: String,
}

impl Owner {
    /// Asks the bridge.
    ///
    /// # Errors
    /// The line breaks, or the bridge does not answer.
    pub fn ask(session: &mut Session) -> Result<Self> {
        // An empty name is refused.
        let text = |session: &mut Session, at| object::text(session, at).unwrap_or_default();
        Ok(Self {
            machine: text(session, object::MACHINE_NAME),
            serial: text(session, object::MACHINE_SERIAL),
            board: format!("{:08x}", object::number(session, object::SERIAL_NUMBER)?),
        })
    }

    /// Returns whether both may be the same; what one does not know does not differ.
    #[must_use]
    pub fn is_same(&self, other: &Self) -> bool {
        let boards = [&self.board, &other.board];
        (&self.machine, &self.serial) == (&other.machine, &other.serial)
            && (boards[0] == boards[1] || boards.iter().any(|board| board.is_empty()))
    }

    /// In words.
    #[must_use]
    pub fn text(&self) -> String {
        let mut text = match &self.machine[..] {
            "" => "a machine without a name".to_owned(),
            name => format!("\"{name}\""),
        };
        for (what, number) in [("serial", &self.serial), ("board", &self.board)] {
            if !number.is_empty() {
                text += &format!(", {what} {number}");
            }
        }
        text
    }
}

/// The content of a board when it was saved.
#[derive(Clone, Debug, PartialEq)]
pub struct SavedBoard {
    all: Value,
    /// The blob of its calibration.
    pub calibration: Vec<u8>,
    /// Its reference, in force or offered, in nm.
    pub reference: Option<Nanometres>,
}

impl SavedBoard {
    /// Reads all of it. `progress` receives how many bytes of the calibration have come, and of how many.
    ///
    /// # Errors
    /// The line breaks, or the bridge has no valid calibration.
    pub fn ask(session: &mut Session, progress: impl FnMut(usize, Option<u32>)) -> Result<Self> {
        let text = |session: &mut Session, at| object::text(session, at).unwrap_or_default();
        let Some(calibration) = load::running(session, progress)? else {
            bail!("the bridge has no valid calibration: there is nothing to save");
        };
        if let Err(rule) = decode(&calibration) {
            bail!(
                "the calibration that the bridge has sent is damaged ({rule}): nothing is saved; try again"
            );
        }
        let crc = identity(&calibration);
        let waiting = match object::number(session, object::NEW_CRC)? {
            0 => None,
            it if it == crc => None,
            _ => Some(hex(&object::read(session, object::NEW, |_, _| ())?)),
        };
        let reference = BridgeReference::ask(session)?;
        let parts = reference.value().map(|nm| {
            REFERENCE.into_iter().zip(nm).map(|(name, nm)| (name.to_owned(), json!(nm))).collect()
        });
        let learned =
            object::LEARNED.map(|at| object::number(session, at).unwrap_or_default().cast_signed());
        let log = object::read(session, object::WRITES, |_, _| ()).unwrap_or_default();
        let owner = Owner::ask(session)?;
        let mut all = json!({
            "format": FORMAT,
            "device": text(session, object::NAME),
            "hardware": text(session, object::HARDWARE),
            "software": text(session, object::SOFTWARE),
            "machine": owner.machine,
            "machine_serial": owner.serial,
            "board_serial": owner.board,
            "calibration_crc": format!("{crc:08x}"),
            "calibration": hex(&calibration),
            "calibration_for_the_next_start": waiting,
            "reference": parts.map(Value::Object),
            "reference_state": reference.json(),
            "learned": learned,
            "writes": writes::writes(&log).iter().map(writes::json).collect::<Vec<_>>(),
        });
        all["checksum"] = json!(checksum(&all));
        Ok(Self { all, calibration, reference: reference.value() })
    }

    /// Returns the file.
    ///
    /// # Errors
    /// None that a value of this kind has.
    pub fn to_text(&self) -> Result<String> {
        Ok(serde_json::to_string_pretty(&self.all)? + "\n")
    }

    /// Reads a file.
    ///
    /// # Errors
    /// The rule that it breaks.
    pub fn parse(text: &str) -> Result<Self, String> {
        let all: Value = serde_json::from_str(text)
            .map_err(|error| format!("is not what bridge save writes: {error}"))?;
        if all["format"] != FORMAT {
            return Err(format!("is not what bridge save writes: format is not {FORMAT}"));
        }
        let blob = all["calibration"].as_str().and_then(bytes_of);
        let calibration = blob.ok_or("the calibration is not in hexadecimal digits")?;
        let decoded = decode(&calibration).map_err(|error| error.to_string())?;
        if all["calibration_crc"] != format!("{:08x}", identity(&calibration)) {
            return Err("the calibration is not the one of its CRC".into());
        }
        let reference = match &all["reference"] {
            Value::Null => None,
            parts => Some(reference_of(parts).ok_or("the reference is not four lengths in nm")?),
        };
        if let Some(nm) = reference
            && !is_permitted(&Bridge::new(decoded), nm)
        {
            let [x, y, z] = decoded.limits.max.map(|max| f64::from(max.0) / 1_000.0);
            return Err(format!(
                "the reference ({}) is larger than a correction may be: max_um of its calibration is x {x}, y {y}, \
                 z {z}",
                micrometres_text(nm)
            ));
        }
        if !all["checksum"].is_null() && all["checksum"] != checksum(&all) {
            return Err("was changed since bridge save wrote it (its checksum differs): use the file as it was \
                        written, or load the calibration by bridge load and set Zero anew"
                .into());
        }
        Ok(Self { all, calibration, reference })
    }

    /// Returns whether a checksum protects it; files of version 0.2 have none.
    #[must_use]
    pub fn is_protected(&self) -> bool {
        !self.all["checksum"].is_null()
    }

    /// Whose it was.
    #[must_use]
    pub fn owner(&self) -> Owner {
        let text = |name: &str| self.all[name].as_str().unwrap_or_default().to_owned();
        Owner {
            machine: text("machine"),
            serial: text("machine_serial"),
            board: text("board_serial"),
        }
    }

    /// Returns the CRC of its calibration.
    #[must_use]
    pub fn crc(&self) -> u32 {
        identity(&self.calibration)
    }
}

/// Returns whether it is no larger than the board would take.
fn is_permitted(bridge: &Bridge<'_>, nm: Nanometres) -> bool {
    let [elongation, axes @ ..] = nm;
    let fine = |nm: i32| nm.checked_mul(Fine::PER_NANOMETRE).map(Fine);
    let [Some(x), Some(y), Some(z)] = axes.map(fine) else { return false };
    bridge.permits(&Reference { elongation: Nm(elongation), axes: [x, y, z] })
}

/// Of what goes back into a board, eight hexadecimal digits.
fn checksum(all: &Value) -> String {
    let text: String = PROTECTED.into_iter().map(|name| format!("{}\n", all[name])).collect();
    format!("{:08x}", Crc::<u32>::new(&CRC_32_ISO_HDLC).checksum(text.as_bytes()))
}

fn reference_of(parts: &Value) -> Option<Nanometres> {
    let mut nm = [0; 4];
    for (place, name) in nm.iter_mut().zip(REFERENCE) {
        *place = parts[name].as_i64().and_then(|nm| i32::try_from(nm).ok())?;
    }
    Some(nm)
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn bytes_of(hex: &str) -> Option<Vec<u8>> {
    let (pairs, []) = hex.as_bytes().as_chunks::<2>() else { return None };
    let byte = |pair: &[u8; 2]| u8::from_str_radix(std::str::from_utf8(pair).ok()?, 16).ok();
    pairs.iter().map(byte).collect()
}
