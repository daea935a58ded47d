//! The file of an update: the signed image for slot A, then that for slot B, nothing in between. Either may be there
//! alone.
//!
//! All that can be known without the key is checked here, before a board is touched: headers, lengths, CRC and SHA-256.
//! The signature is checked by the board, which has the key.

use embedded_storage::nor_flash::{ErrorType, NorFlashError, NorFlashErrorKind, ReadNorFlash};
use trueup_boot::{
    flash_layout::{SLOT_SIZE, Slot},
    image_check::{Image, ImageDefect, VerifyingKey, check_header, check_image},
    image_header::{FirmwareVersion, HEADER_SIZE, HeaderError, ImageHeader, SIGNATURE_SIZE},
};

/// The most bytes of a file: two full slots, and one to see that it is longer.
pub const MAX_FIRMWARE_READ_BYTES: u64 = 2 * SLOT_SIZE as u64 + 1;

/// A firmware for one slot: its bytes, header first, as they go to the board.
#[derive(Debug, PartialEq, Eq)]
pub struct SlotFirmware {
    /// Tag and header; the slot is in it.
    pub image: Image,
    /// Header and image.
    pub bytes: Vec<u8>,
}

/// A file that was read: one part, or two of the same version and floor, A first.
#[derive(Debug, PartialEq, Eq)]
pub struct FirmwareFile {
    parts: Vec<SlotFirmware>,
}

const REFETCH_HINT: &str = "Fetch the file again, and compare its SHA-256 with that of the release";
const SUPPLIER_HINT: &str = "Ask the maker of the file for a whole one";

/// The rule that a file breaks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FirmwareFileErrorKind {
    /// The file ends within the header.
    #[error("ends within the header of {HEADER_SIZE} bytes. {REFETCH_HINT}")]
    ShortHeader,
    /// Header or image are not those of a firmware, or are damaged.
    #[error("{}", defect_text(*.0))]
    Defect(ImageDefect),
    /// The file ends before the image does, which its header says is this long, header included.
    #[error(
        "the part that begins here has {length} bytes by its header, and the file ends before. {REFETCH_HINT}"
    )]
    Truncated {
        /// Bytes of this part.
        length: u32,
    },
    /// The part for slot B comes first, or a slot has two parts.
    #[error("the parts are in the wrong order: slot A comes first, then slot B. {SUPPLIER_HINT}")]
    Order,
    /// Version or floor of the second part are not those of the first.
    #[error(
        "both parts must have the same version and floor, and the first is {first}, the second {second}. {SUPPLIER_HINT}"
    )]
    OtherVersion {
        /// Version of the first part.
        first: FirmwareVersion,
        /// Version of the second one.
        second: FirmwareVersion,
    },
    /// Bytes follow the second part.
    #[error("bytes follow the part for slot B. {REFETCH_HINT}")]
    TooLong,
}

/// Why a file is no update.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("byte {at}: {rule}")]
pub struct FirmwareFileError {
    /// Offset of the byte in the file from which on it is wrong.
    pub at: usize,
    /// The rule that it breaks there.
    pub rule: FirmwareFileErrorKind,
}

fn defect_text(defect: ImageDefect) -> String {
    match defect {
        ImageDefect::Header(HeaderError::Format) => {
            "has a header of a later format. Update this tool first".into()
        }
        ImageDefect::Header(_) => format!(
            "is no firmware for a slot, or its header is damaged. An ELF or HEX file is for a probe: trueup firmware; \
             otherwise: {REFETCH_HINT}"
        ),
        ImageDefect::Crc | ImageDefect::Digest => format!("{defect}. {REFETCH_HINT}"),
        _ => format!("{defect}. {SUPPLIER_HINT}"),
    }
}

impl FirmwareFile {
    /// Reads a file.
    ///
    /// # Errors
    /// [`FirmwareFileError`].
    pub fn parse(file: &[u8]) -> Result<Self, FirmwareFileError> {
        let mut parts: Vec<SlotFirmware> = Vec::new();
        let mut at = 0;
        while at < file.len() || parts.is_empty() {
            let wrong = |rule| FirmwareFileError { at, rule };
            if parts.len() == 2 {
                return Err(wrong(FirmwareFileErrorKind::TooLong));
            }
            let part = parse_part(&file[at..]).map_err(wrong)?;
            let header = part.image.header;
            if let [first] = &parts[..] {
                let first = first.image.header;
                if (first.slot, header.slot) != (Slot::A, Slot::B) {
                    return Err(wrong(FirmwareFileErrorKind::Order));
                }
                let (first, second) =
                    ((first.version, first.floor), (header.version, header.floor));
                if first != second {
                    let rule =
                        FirmwareFileErrorKind::OtherVersion { first: first.0, second: second.0 };
                    return Err(wrong(rule));
                }
            }
            at += part.bytes.len();
            parts.push(part);
        }
        Ok(Self { parts })
    }

    /// Returns the version of all parts.
    #[must_use]
    pub fn version(&self) -> FirmwareVersion {
        self.parts[0].image.header.version
    }

    /// Returns the part for a slot; `None`: the file has none for it.
    #[must_use]
    pub(crate) fn part_for_slot(&self, slot: Slot) -> Option<&SlotFirmware> {
        self.parts.iter().find(|part| part.image.header.slot == slot)
    }
}

/// Reads the part at the beginning of these bytes.
fn parse_part(bytes: &[u8]) -> Result<SlotFirmware, FirmwareFileErrorKind> {
    let header: &[u8; HEADER_SIZE] =
        bytes.first_chunk().ok_or(FirmwareFileErrorKind::ShortHeader)?;
    let (_, decoded) = ImageHeader::decode(header)
        .map_err(|error| FirmwareFileErrorKind::Defect(ImageDefect::Header(error)))?;
    // Which version may start is the board's to know.
    let image = check_header(header, decoded.slot, SLOT_SIZE, FirmwareVersion(0))
        .map_err(FirmwareFileErrorKind::Defect)?;
    let length = decoded.length as usize;
    let bytes =
        bytes.get(..length).ok_or(FirmwareFileErrorKind::Truncated { length: decoded.length })?;
    let mut flash = ReadOnlySlotFlash { slot: decoded.slot, bytes };
    check_image(&mut flash, &image, Some(&DummyKey), || ())
        .map_err(FirmwareFileErrorKind::Defect)?;
    Ok(SlotFirmware { image, bytes: bytes.to_vec() })
}

/// The flash of both slots, with a part in one of them.
struct ReadOnlySlotFlash<'b> {
    slot: Slot,
    bytes: &'b [u8],
}

/// A read outside of the part.
#[derive(Debug)]
struct OutOfRangeError;

impl NorFlashError for OutOfRangeError {
    fn kind(&self) -> NorFlashErrorKind {
        NorFlashErrorKind::OutOfBounds
    }
}

impl ErrorType for ReadOnlySlotFlash<'_> {
    type Error = OutOfRangeError;
}

impl ReadNorFlash for ReadOnlySlotFlash<'_> {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), OutOfRangeError> {
        let start = u32::from(self.slot.number()) * SLOT_SIZE;
        let from = offset.checked_sub(start).ok_or(OutOfRangeError)? as usize;
        let part = self.bytes.get(from..from + bytes.len()).ok_or(OutOfRangeError)?;
        bytes.copy_from_slice(part);
        Ok(())
    }

    fn capacity(&self) -> usize {
        2 * SLOT_SIZE as usize
    }
}

/// Stands for the key that only the board has, so that the digest is checked too.
struct DummyKey;

impl VerifyingKey for DummyKey {
    fn verify(&self, _message: &[u8], _signature: &[u8; SIGNATURE_SIZE]) -> bool {
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BODY: usize = 100;
    const PART: usize = HEADER_SIZE + BODY;

    fn signed(slot: Slot, minor: u8, change: impl FnOnce(&mut ImageHeader)) -> Vec<u8> {
        let body = [minor ^ slot.number(); BODY];
        let version = FirmwareVersion::new(1, minor, 0, 0);
        let mut header =
            ImageHeader::new_unsigned(&body, slot, version, FirmwareVersion::new(1, 0, 0, 0));
        change(&mut header);
        [&header.encode()[..], &body].concat()
    }

    fn part(slot: Slot, minor: u8) -> Vec<u8> {
        signed(slot, minor, |_| ())
    }

    fn refused(file: &[u8]) -> (usize, FirmwareFileErrorKind) {
        let error = FirmwareFile::parse(file).expect_err("no update");
        assert!(error.to_string().starts_with(&format!("byte {}: ", error.at)), "{error}");
        (error.at, error.rule)
    }

    #[test]
    fn both_parts_or_one_alone_are_read_back_byte_for_byte() {
        let (a, b) = (part(Slot::A, 2), part(Slot::B, 2));
        for (file, has) in [
            ([&a[..], &b].concat(), [true, true]),
            (a.clone(), [true, false]),
            (b.clone(), [false, true]),
        ] {
            let read = FirmwareFile::parse(&file).expect("an update");
            assert_eq!(read.version(), FirmwareVersion::new(1, 2, 0, 0));
            for (slot, bytes, has) in [(Slot::A, &a, has[0]), (Slot::B, &b, has[1])] {
                assert_eq!(read.part_for_slot(slot).map(|part| &part.bytes), has.then_some(bytes));
            }
        }
    }

    #[test]
    fn any_flipped_bit_is_seen_in_its_part() {
        let file = [part(Slot::A, 2), part(Slot::B, 2)].concat();
        for bit in 0..8 * file.len() {
            let mut other = file.clone();
            other[bit / 8] ^= 1 << (bit % 8);
            let (at, rule) = refused(&other);
            assert_eq!(at, bit / 8 / PART * PART, "bit {bit}: {rule:?}");
        }
    }

    #[test]
    fn truncated_swapped_doubled_and_mixed_files_say_the_byte_and_the_rule() {
        let (a, b) = (part(Slot::A, 2), part(Slot::B, 2));
        let length = PART as u32;
        let both = [&a[..], &b].concat();
        assert_eq!(refused(&[]), (0, FirmwareFileErrorKind::ShortHeader));
        assert_eq!(refused(&a[..511]), (0, FirmwareFileErrorKind::ShortHeader));
        assert_eq!(refused(&both[..PART - 1]), (0, FirmwareFileErrorKind::Truncated { length }));
        assert_eq!(refused(&both[..PART + 1]), (PART, FirmwareFileErrorKind::ShortHeader));
        assert_eq!(
            refused(&both[..2 * PART - 4]),
            (PART, FirmwareFileErrorKind::Truncated { length })
        );
        assert_eq!(refused(&[&b[..], &a].concat()), (PART, FirmwareFileErrorKind::Order));
        assert_eq!(refused(&[&a[..], &a].concat()), (PART, FirmwareFileErrorKind::Order));
        assert_eq!(
            refused(&[&both[..], &[0xFF]].concat()),
            (2 * PART, FirmwareFileErrorKind::TooLong)
        );
        let newer = [&a[..], &part(Slot::B, 3)].concat();
        let (first, second) = (FirmwareVersion::new(1, 2, 0, 0), FirmwareVersion::new(1, 3, 0, 0));
        assert_eq!(refused(&newer), (PART, FirmwareFileErrorKind::OtherVersion { first, second }));
        let other_floor = signed(Slot::B, 2, |header| header.floor = FirmwareVersion(1));
        let rule = FirmwareFileErrorKind::OtherVersion { first, second: first };
        assert_eq!(refused(&[&a[..], &other_floor].concat()), (PART, rule));
        assert_eq!(
            refused(b"\x7FELF").1,
            FirmwareFileErrorKind::ShortHeader,
            "another file, shorter than a header"
        );
        let elf = [&b"\x7FELF"[..], &[0; 600]].concat();
        assert_eq!(
            refused(&elf),
            (0, FirmwareFileErrorKind::Defect(ImageDefect::Header(HeaderError::NoHeader)))
        );
    }

    #[test]
    fn what_a_header_must_not_say_is_refused_though_nothing_is_damaged() {
        let defect = |change: fn(&mut ImageHeader)| refused(&signed(Slot::A, 2, change)).1;
        assert_eq!(
            defect(|header| header.floor = FirmwareVersion(u32::MAX)),
            FirmwareFileErrorKind::Defect(ImageDefect::OwnFloor)
        );
        assert_eq!(
            defect(|header| header.length += 1),
            FirmwareFileErrorKind::Defect(ImageDefect::Length)
        );
        assert_eq!(
            defect(|header| header.length = SLOT_SIZE + 4),
            FirmwareFileErrorKind::Defect(ImageDefect::Length)
        );
        assert_eq!(
            defect(|header| header.crc ^= 1),
            FirmwareFileErrorKind::Defect(ImageDefect::Crc)
        );
        assert_eq!(
            defect(|header| header.digest[7] ^= 1),
            FirmwareFileErrorKind::Defect(ImageDefect::Digest)
        );
    }
}
