//! Whether a slot holds an image that may run: header, bounds, floor, CRC, signature.

use core::fmt;

use embedded_storage::nor_flash::ReadNorFlash;

use crate::{
    crc,
    flash_layout::Slot,
    hash::Sha256,
    image_header::{FirmwareVersion, HEADER_SIZE, HeaderError, ImageHeader, SIGNATURE_SIZE},
};

/// Bytes that are read at once.
const READ_CHUNK_BYTES: usize = 256;

/// A public key that signatures are checked against.
pub trait VerifyingKey {
    /// Returns whether the signature of a message holds.
    fn verify(&self, message: &[u8], signature: &[u8; SIGNATURE_SIZE]) -> bool;
}

/// Why an image must not run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ImageDefect {
    /// The slot has no valid header.
    Header(HeaderError),
    /// The slot cannot be read.
    Unreadable,
    /// The image is linked for the other slot.
    OtherSlot,
    /// Its length is no multiple of four, below the smallest image, or more than a slot holds.
    Length,
    /// Its version is below the floor.
    BelowFloor {
        /// The oldest version that may start.
        floor: FirmwareVersion,
    },
    /// The floor that it requires is above its own version: once confirmed it would bar itself.
    OwnFloor,
    /// Its CRC does not hold.
    Crc,
    /// Its digest does not hold, though its CRC does.
    Digest,
    /// Its signature does not hold.
    Signature,
}

impl fmt::Display for ImageDefect {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Header(error) => error.fmt(f),
            Self::Unreadable => f.write_str("cannot be read"),
            Self::OtherSlot => f.write_str("is linked for the other slot"),
            Self::Length => f.write_str("has a length that no image has"),
            Self::BelowFloor { floor } => {
                write!(f, "is older than {floor}, the oldest that may start")
            }
            Self::OwnFloor => f.write_str("asks for a floor above its own version"),
            Self::Crc => f.write_str("is damaged: its CRC does not hold"),
            Self::Digest => f.write_str("is damaged: its SHA-256 does not hold"),
            Self::Signature => f.write_str("is not signed with this board's key"),
        }
    }
}

impl core::error::Error for ImageDefect {}

/// An image, as its header describes it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Image {
    /// Names this very image.
    pub tag: u32,
    /// Its header.
    pub header: ImageHeader,
}

/// Checks a header by itself: it is one, for this slot of `slot_size` bytes, and not below the floor.
///
/// # Errors
/// [`ImageDefect`].
pub fn check_header(
    bytes: &[u8; HEADER_SIZE],
    slot: Slot,
    slot_size: u32,
    floor: FirmwareVersion,
) -> Result<Image, ImageDefect> {
    /// The header and two vectors.
    const MIN_IMAGE_LENGTH: u32 = 512 + 8;
    let (tag, header) = ImageHeader::decode(bytes).map_err(ImageDefect::Header)?;
    if header.slot != slot {
        return Err(ImageDefect::OtherSlot);
    }
    if !(MIN_IMAGE_LENGTH..=slot_size).contains(&header.length) || !header.length.is_multiple_of(4)
    {
        return Err(ImageDefect::Length);
    }
    if header.version < floor {
        return Err(ImageDefect::BelowFloor { floor });
    }
    if header.floor > header.version {
        return Err(ImageDefect::OwnFloor);
    }
    Ok(Image { tag, header })
}

/// Reads and checks the header of a slot, as [`check_header`].
///
/// # Errors
/// [`ImageDefect`].
pub fn read_header<S: ReadNorFlash>(
    slots: &mut S,
    slot: Slot,
    floor: FirmwareVersion,
) -> Result<Image, ImageDefect> {
    let bytes = read_header_bytes(slots, slot)?;
    check_header(&bytes, slot, slot_size(slots), floor)
}

/// Checks the image of a slot against its CRC and, if a key is given, its digest and signature. `between` is called
/// after each part of 256 bytes, because all of it may take longer than a watchdog waits.
///
/// # Errors
/// [`ImageDefect`].
pub fn check_image<S: ReadNorFlash, K: VerifyingKey>(
    slots: &mut S,
    image: &Image,
    key: Option<&K>,
    mut between: impl FnMut(),
) -> Result<(), ImageDefect> {
    let header = &image.header;
    // The header is read once more, so that the bytes that were checked are those that are used.
    let bytes = read_header_bytes(slots, header.slot)?;
    if ImageHeader::decode(&bytes) != Ok((image.tag, *header)) {
        return Err(ImageDefect::Crc);
    }
    if key.is_some_and(|key| !key.verify(ImageHeader::signed_bytes(&bytes), &header.signature)) {
        return Err(ImageDefect::Signature);
    }
    between();
    let mut crc = crc::incremental_checksum();
    let mut sha = key.map(|_| Sha256::new());
    let start = slot_offset(slots, header.slot);
    let mut part = [0; READ_CHUNK_BYTES];
    let mut at = HEADER_SIZE;
    let length = usize::try_from(header.length).map_err(|_| ImageDefect::Length)?;
    while at < length {
        let size = length.saturating_sub(at).min(READ_CHUNK_BYTES);
        let bytes = part.get_mut(..size).ok_or(ImageDefect::Unreadable)?;
        let offset = u32::try_from(at).map_err(|_| ImageDefect::Length)?;
        slots.read(start.saturating_add(offset), bytes).map_err(|_| ImageDefect::Unreadable)?;
        crc.update(bytes);
        if let Some(sha) = &mut sha {
            sha.update(bytes);
        }
        at = at.saturating_add(size);
        between();
    }
    if crc.finalize() != header.crc {
        return Err(ImageDefect::Crc);
    }
    let is_it = sha.is_none_or(|sha| sha.digest() == header.digest);
    if is_it { Ok(()) } else { Err(ImageDefect::Digest) }
}

pub(crate) fn read_header_bytes<S: ReadNorFlash>(
    slots: &mut S,
    slot: Slot,
) -> Result<[u8; HEADER_SIZE], ImageDefect> {
    let mut bytes = [0; HEADER_SIZE];
    let start = slot_offset(slots, slot);
    slots.read(start, &mut bytes).map_err(|_| ImageDefect::Unreadable)?;
    Ok(bytes)
}

/// Bytes of a slot: half of the flash that holds both.
pub(crate) fn slot_size<S: ReadNorFlash>(slots: &S) -> u32 {
    u32::try_from(slots.capacity() / 2).unwrap_or(0)
}

/// Offset of a slot in the flash that holds both.
pub(crate) fn slot_offset<S: ReadNorFlash>(slots: &S, slot: Slot) -> u32 {
    match slot {
        Slot::A => 0,
        Slot::B => slot_size(slots),
    }
}
