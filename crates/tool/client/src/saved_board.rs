//! All that a board holds, in one file: its calibration, its reference, what it has learned, its log.
//!
//! The file is JSON. A checksum covers what goes back into a board, so that an edited number is found: a reference
//! moves every tool. Files of version 0.2 have none; their reference is bounded like any other
//! ([`trueup_core::bridge::Bridge::is_reference_permitted`]) and has to be confirmed at the CNC, as every restored one.

use anyhow::{Result, bail};
use crc::{CRC_32_ISO_HDLC, Crc};
use serde_json::{Value, json};
use trueup_core::{
    bridge::{Bridge, ReferenceErrors},
    units::{FineNanometres, Nanometres as Nm},
};
use trueup_store::calibration::{calibration_crc, decode};

use crate::{
    calibration_load,
    reference::{BridgeReference, ReferenceNm, format_reference},
    sdo_object,
    session::Session,
    write_log,
};

/// Name of the file's format.
const BACKUP_FORMAT_NAME: &str = "trueup-bridge-1";
/// Keys of the parts of the reference in the file.
const REFERENCE_KEYS: [&str; 4] = ["elongation_nm", "x_nm", "y_nm", "z_nm"];
/// Keys that the checksum covers, in this order.
const CHECKSUMMED_KEYS: [&str; 8] = [
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
pub struct BoardIdentity {
    /// The name of its machine; empty: none.
    pub machine: String,
    /// The serial number of its machine; empty: none.
    pub serial: String,
    /// The hash of its chip's number, eight hexadecimal digits; empty: not known.
    pub board: String,
}

impl BoardIdentity {
    /// Reads it from the bridge.
    ///
    /// # Errors
    /// The line breaks, or the bridge does not answer.
    pub fn read(session: &mut Session) -> Result<Self> {
        // An empty name is refused.
        let text =
            |session: &mut Session, at| sdo_object::read_text(session, at).unwrap_or_default();
        Ok(Self {
            machine: text(session, sdo_object::MACHINE_NAME),
            serial: text(session, sdo_object::MACHINE_SERIAL),
            board: format!("{:08x}", sdo_object::read_number(session, sdo_object::SERIAL_NUMBER)?),
        })
    }

    /// Returns whether both may be the same; what one does not know does not differ.
    #[must_use]
    pub fn is_consistent_with(&self, other: &Self) -> bool {
        let boards = [&self.board, &other.board];
        (&self.machine, &self.serial) == (&other.machine, &other.serial)
            && (boards[0] == boards[1] || boards.iter().any(|board| board.is_empty()))
    }

    /// In words.
    #[must_use]
    pub fn to_text(&self) -> String {
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
    pub reference: Option<ReferenceNm>,
}

impl SavedBoard {
    /// Reads all of it. `progress` receives how many bytes of the calibration have come, and of how many.
    ///
    /// # Errors
    /// The line breaks, or the bridge has no valid calibration.
    pub fn read(session: &mut Session, progress: impl FnMut(usize, Option<u32>)) -> Result<Self> {
        let text =
            |session: &mut Session, at| sdo_object::read_text(session, at).unwrap_or_default();
        let Some(calibration) = calibration_load::read_running_calibration(session, progress)?
        else {
            bail!("the bridge has no valid calibration: there is nothing to save");
        };
        if let Err(rule) = decode(&calibration) {
            bail!(
                "the calibration that the bridge has sent is damaged ({rule}): nothing is saved; try again"
            );
        }
        let crc = calibration_crc(&calibration);
        let waiting = match sdo_object::read_number(session, sdo_object::PENDING_CRC)? {
            0 => None,
            it if it == crc => None,
            _ => Some(encode_hex(&sdo_object::read(
                session,
                sdo_object::PENDING_CALIBRATION,
                |_, _| (),
            )?)),
        };
        let reference = BridgeReference::read(session)?;
        let parts = reference.effective_value().map(|nm| {
            REFERENCE_KEYS
                .into_iter()
                .zip(nm)
                .map(|(name, nm)| (name.to_owned(), json!(nm)))
                .collect()
        });
        let learned = sdo_object::LEARNED_VALUES
            .map(|at| sdo_object::read_number(session, at).unwrap_or_default().cast_signed());
        let log = sdo_object::read(session, sdo_object::WRITE_LOG, |_, _| ()).unwrap_or_default();
        let owner = BoardIdentity::read(session)?;
        let mut all = json!({
            "format": BACKUP_FORMAT_NAME,
            "device": text(session, sdo_object::DEVICE_NAME),
            "hardware": text(session, sdo_object::HARDWARE_VERSION),
            "software": text(session, sdo_object::SOFTWARE_VERSION),
            "machine": owner.machine,
            "machine_serial": owner.serial,
            "board_serial": owner.board,
            "calibration_crc": format!("{crc:08x}"),
            "calibration": encode_hex(&calibration),
            "calibration_for_the_next_start": waiting,
            "reference": parts.map(Value::Object),
            "reference_state": reference.to_json(),
            "learned": learned,
            "writes": write_log::decode_write_records(&log).iter().map(write_log::record_to_json).collect::<Vec<_>>(),
        });
        all["checksum"] = json!(compute_checksum(&all));
        Ok(Self { all, calibration, reference: reference.effective_value() })
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
        if all["format"] != BACKUP_FORMAT_NAME {
            return Err(format!(
                "is not what bridge save writes: format is not {BACKUP_FORMAT_NAME}"
            ));
        }
        let blob = all["calibration"].as_str().and_then(decode_hex);
        let calibration = blob.ok_or("the calibration is not in hexadecimal digits")?;
        let decoded = decode(&calibration).map_err(|error| error.to_string())?;
        if all["calibration_crc"] != format!("{:08x}", calibration_crc(&calibration)) {
            return Err("the calibration is not the one of its CRC".into());
        }
        let reference = match &all["reference"] {
            Value::Null => None,
            parts => Some(parse_reference(parts).ok_or("the reference is not four lengths in nm")?),
        };
        if let Some(nm) = reference
            && !is_reference_permitted(&Bridge::new(decoded), nm)
        {
            let [x, y, z] = decoded.limits.max.map(|max| f64::from(max.0) / 1_000.0);
            return Err(format!(
                "the reference ({}) is larger than a correction may be: max_um of its calibration is x {x}, y {y}, \
                 z {z}",
                format_reference(nm)
            ));
        }
        if !all["checksum"].is_null() && all["checksum"] != compute_checksum(&all) {
            return Err("was changed since bridge save wrote it (its checksum differs). Use the \
                file as it was written, or load the calibration by bridge load and set Zero anew"
                .into());
        }
        Ok(Self { all, calibration, reference })
    }

    /// Returns whether a checksum protects it; files of version 0.2 have none.
    #[must_use]
    pub fn has_checksum(&self) -> bool {
        !self.all["checksum"].is_null()
    }

    /// Whose it was.
    #[must_use]
    pub fn board_identity(&self) -> BoardIdentity {
        let text = |name: &str| self.all[name].as_str().unwrap_or_default().to_owned();
        BoardIdentity {
            machine: text("machine"),
            serial: text("machine_serial"),
            board: text("board_serial"),
        }
    }

    /// Returns the CRC of its calibration.
    #[must_use]
    pub fn calibration_crc(&self) -> u32 {
        calibration_crc(&self.calibration)
    }
}

/// Returns whether it is no larger than the board would take.
fn is_reference_permitted(bridge: &Bridge<'_>, nm: ReferenceNm) -> bool {
    let [elongation, axes @ ..] = nm;
    let fine = |nm: i32| nm.checked_mul(FineNanometres::PER_NANOMETRE).map(FineNanometres);
    let [Some(x), Some(y), Some(z)] = axes.map(fine) else { return false };
    bridge.is_reference_permitted(&ReferenceErrors { elongation: Nm(elongation), axes: [x, y, z] })
}

/// Of what goes back into a board, eight hexadecimal digits.
fn compute_checksum(all: &Value) -> String {
    let text: String =
        CHECKSUMMED_KEYS.into_iter().map(|name| format!("{}\n", all[name])).collect();
    format!("{:08x}", Crc::<u32>::new(&CRC_32_ISO_HDLC).checksum(text.as_bytes()))
}

fn parse_reference(parts: &Value) -> Option<ReferenceNm> {
    let mut nm = [0; 4];
    for (place, name) in nm.iter_mut().zip(REFERENCE_KEYS) {
        *place = parts[name].as_i64().and_then(|nm| i32::try_from(nm).ok())?;
    }
    Some(nm)
}

fn encode_hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn decode_hex(hex: &str) -> Option<Vec<u8>> {
    let (pairs, []) = hex.as_bytes().as_chunks::<2>() else { return None };
    let byte = |pair: &[u8; 2]| u8::from_str_radix(std::str::from_utf8(pair).ok()?, 16).ok();
    pairs.iter().map(byte).collect()
}
