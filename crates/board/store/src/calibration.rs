//! The calibration as the host sends it and the board stores it: one blob, little-endian, read in
//! place.
//!
//! A fixed part of `FIXED_PART_SIZE` bytes, the tables that it refers to, and a CRC. A table is given by
//! a reference: `u16` offset from the start of the blob, `u16` number of records.
//!
//! | offset | field | unit |
//! |---|---|---|
//! | 0 | magic `TRUP`; `u16` schema 4; `u16` length of all of the blob in bytes | |
//! | 8 | 3 × `i32` largest offset on X, Y, Z | nm, 0…4 000 000 |
//! | 20 | `u32` slew limit; `u32` link timeout; `u32` hold | nm/s, up to 10⁷; ms, up to 60 000 and 600 000 |
//! | 32 | 3 × `i32` tool direction at angles 0 | 2⁻³⁰, together a unit vector |
//! | 44 | 2 × `u8`: first and second axis that turn the tool (1, 2, 3: A, B, C); 2 × `u8`: caps of what was learned of the growth, of each axis | 0.1 %, 0…250 |
//! | 48 | 3 × `u8`: sources of the elongation in their order (1 sensor, 2 temperature, 3 warm-up); `u8` cap of what was learned of its zero | 0.1 µm, 0…200 |
//! | 52 | `i32` K₀, V₀, tanβ of the sensor | nm; 1/1024 code; 2⁻²⁸ nm per 1/1024 code |
//! | 64 | `u32` channel, `u32` smoothing factor, law of the spindle's temperature | |
//! | 76 | `u32` lag, `i32` largest (1/256 nm), 2 × `u32` smoothing factors, `i32` 1/(1 − e⁻ᵏ) of the warm-up; its power curve | |
//! | 112 | 8 × temperature channel: `u8` kind (1 PT100, 2 linear), `u8` shift, `u16` fastest change (0.1 K/min, up to 6000; 0: the default); `i32` zero, `i32` slope | |
//! | 208 | 3 × linear axis, 80 bytes each | |
//! | 448 | 6 × straightness curve, 16 bytes each, in the order of [`STRAIGHTNESS_AXIS_PAIRS`](trueup_core::calibration::STRAIGHTNESS_AXIS_PAIRS) | |
//! | 544 | 6 × `i32` squareness, in the same order | 2⁻³⁶ nm per 10 nm |
//! | 568 | `u32` smoothing factor of the spindle's temperature while it falls | |
//! | 572 | terms of a diagnosis: a table of 24 bytes each | |
//! | 576 | `u16` way back from one source to another; `u16` switches, bit 0 the service switch, bit 1 mains of 60 Hz; `i32` thermometers of a cold machine agree within | nm/s, up to 1000; 2⁻¹² mK, 0…5 K |
//! | 584 | 3 × `u32` number of the board's chip, the lowest word first; 0: any board | |
//! | 596 | the machine's name and its serial number: tables of a byte each, UTF-8 | |
//! | 604 | the tables, in the order of their references | |
//! | length − 4 | CRC-32/AUTOSAR of all bytes before it | |
//!
//! A linear axis: `u32` channel (255: none), `u32` smoothing factor, `i32` origin, law; pitch: `i32` start,
//! `u32` step, forward, reverse; second drive: `u32` axis across (255: none), `i32` first, `i32`
//! second, `i32` start, `u32` step, forward, reverse; `i32` backlash, `u32` hysteresis, `u32` ramp;
//! `u32` smoothing factor while it falls; `u32` rapid traverse, 10 nm/ms (0: none). A curve: segments, index, `i32` first knot, `u32` bucket shift. A law is a reference to
//! [pieces](trueup_core::thermal), a pitch table one to `i32` in 1/256 nm.
//!
//! A term: `u8` kind, `u8` target (0 elongation, 1, 2, 3: X, Y, Z), `u8` channel or axis, `u8` binary
//! places of the coefficient; `i32` constant (1/256 nm); four words:
//!
//! | kind | words |
//! |---|---|
//! | 0 offset | none |
//! | 1 gain, 2 curvature, 6 speed, 7 load | `i32` coefficient |
//! | 3 saturation | `i32` limit |
//! | 4 heat | `i32` coefficient, `u32` smoothing factor, `i32` reference |
//! | 5 time | `i32` coefficient, `u32` smoothing factor |
//! | 8 position | `i32` gradient |
//! | 9 reversed | `i32` width, `i32` gradient |
//! | 10 table | as a pitch |
//! | 11 curve | as a curve |
//! | 12 wave | `i32` amplitude, `u32` phase, `u64` turns |
//! | 13 tilt | `i32` zero of the lever, `i32` gradient |
//! | 14 tilt by a curve | `i32` zero of the lever; segments, index, `i32` first knot as of a curve |
//! | 15 heat by the speed | `i32` coefficient, `u32` smoothing factor; in the place of a channel the power of the speed, 1 or 2 |
//! | 16 tool | `i32` level of other tools; a table of `u32` number, `i32` level, 32 at most, rising; `u8` factor, 0, 0, 0 |
//! | 17 condition | `i32` level off, `i32` level on; `u32` smoothing factor; `u8` factor, `u8` 1 if it counts as on while it is not known, 0, 0 |
//! | 18 the volume, at most one, the last | a table of one record of 312 bytes, below |
//! | 19 slope by heat | as heat |
//!
//! A condition's bit stands in the place of the channel. Factors: 0 none, 1 n², 2 the growth, 3 the position.
//! Firmware that does not know a kind refuses the blob by the number of the kind and its place.
//!
//! A tilt has two axes: the one that tilts, and 16 times the one of the lever. The bucket shift of its
//! curve stands where a coefficient has its binary places. Its angle is an error at a lever of 2²⁷·10 nm.
//!
//! The volume: 3 × `u8` linear axes from the workpiece to the tool (0, 1, 2: X, Y, Z), `u8` how many of them move the
//! workpiece; of X, Y and Z each 3 × `i32` point, and about X, Y and Z each `i32` slope and a curve, both as errors at a
//! lever of 2²⁷·10 nm; 3 × `i32` from the nose to the tip; 2 × rotary axis: `u8` 1, 2, 3: A, B, C (0: none), `u8` 1 if it
//! moves the workpiece, 0, 0; 3 × `i32` point; 3 × `i32` shift; 3 × `i32` tilt at that lever.
//!
//! The checks go from the outside in: a blob of another schema is distinguished from a damaged one
//! before the CRC is looked at, because its CRC may lie elsewhere. After that every reference, range
//! and table is checked once, so that the tick can rely on them.

use trueup_core::calibration::Calibration;

use crate::crc;

mod blob_codec;
mod blob_fields;
mod blob_format;
mod error;
mod records;
mod terms;
#[cfg(test)]
pub(crate) mod tests;
mod volume;

use blob_codec::{Field as _, Reader, Writer};
pub(crate) use blob_format::FIXED_PART_SIZE;
use blob_format::{BLOB_MAGIC, CRC_SIZE, HEADER_SIZE, SCHEMA_VERSION};
pub use blob_format::{
    MAX_BLOB_SIZE, MAX_COLD_TOLERANCE, MAX_HOLD_MS, MAX_LEARNED_LIMITS, MAX_LINK_TIMEOUT_MS,
    MAX_OFFSET_NM, MAX_REJOIN_NM_PER_S, MAX_SLEW_NM_PER_S,
};
pub use error::{BlobError, CalibrationTooLarge};
use records::FixedPart;

/// Writes the blob of a calibration, also of one that [`decode`] would refuse; gives its bytes.
///
/// # Errors
/// [`CalibrationTooLarge`]: it does not fit `out` (or [`MAX_BLOB_SIZE`]).
pub fn encode<'o>(
    calibration: &Calibration<'_>,
    out: &'o mut [u8],
) -> Result<&'o [u8], CalibrationTooLarge> {
    let room = out.len().min(MAX_BLOB_SIZE);
    let mut to = Writer::new(out);
    // The length is known at the end.
    to.write_bytes(&[0; HEADER_SIZE]);
    FixedPart::from_calibration(calibration).write(&mut to);

    let bytes = to.tables_end().saturating_add(CRC_SIZE);
    let (true, Ok(length)) = (bytes <= room, u16::try_from(bytes)) else {
        return Err(CalibrationTooLarge { bytes });
    };
    to.write_at(0, |to| {
        to.write_bytes(&BLOB_MAGIC);
        to.write_bytes(&SCHEMA_VERSION.to_le_bytes());
        to.write_bytes(&length.to_le_bytes());
    });
    let blob = to.finish().get_mut(..bytes).ok_or(CalibrationTooLarge { bytes })?;
    crc::write_crc(blob);
    Ok(blob)
}

/// Returns the bytes of the blob at the start of `bytes`, checked for being whole: what [`decode`] reads.
///
/// # Errors
/// As [`decode`].
pub fn validate_blob(bytes: &[u8]) -> Result<&[u8], BlobError> {
    let too_short = BlobError::TooShort { len: bytes.len() };
    let &[m0, m1, m2, m3, schema_low, schema_high, length_low, length_high] =
        bytes.first_chunk().ok_or(too_short)?;
    let magic = [m0, m1, m2, m3];
    if magic != BLOB_MAGIC {
        return Err(BlobError::Magic { found: magic });
    }
    let schema = u16::from_le_bytes([schema_low, schema_high]);
    if schema != SCHEMA_VERSION {
        return Err(BlobError::Schema { found: schema });
    }
    let length = u16::from_le_bytes([length_low, length_high]);
    let least = FIXED_PART_SIZE.saturating_add(CRC_SIZE);
    if !(least..=MAX_BLOB_SIZE).contains(&length.into()) {
        return Err(BlobError::Length { found: length });
    }
    let blob = bytes.get(..length.into()).ok_or(too_short)?;
    let (content, crc) = blob.split_last_chunk().ok_or(too_short)?;
    let (stored, computed) = (u32::from_le_bytes(*crc), crc::checksum(content));
    if stored != computed {
        return Err(BlobError::Crc { stored, computed });
    }
    Ok(blob)
}

/// Returns the identity of a calibration: the CRC of its blob, whole as [`validate_blob`] finds it; 0 of none.
#[must_use]
pub fn calibration_crc(whole: &[u8]) -> u32 {
    u32::from_le_bytes(*whole.last_chunk().unwrap_or(&[0; CRC_SIZE]))
}

/// Returns the calibration in a blob; its tables stay where they are. Bytes after the blob are not looked
/// at, so that a whole slot of flash can be given.
///
/// # Errors
/// [`BlobError`] with the place and the value at fault; nothing of such a blob must be used.
pub fn decode(bytes: &[u8]) -> Result<Calibration<'_>, BlobError> {
    let blob = validate_blob(bytes)?;
    let content = blob.get(..blob.len().saturating_sub(CRC_SIZE)).unwrap_or_default();
    let mut from = Reader::new(content, HEADER_SIZE);
    let calibration = FixedPart::read(&mut from).into_calibration();
    from.finish(calibration)
}
