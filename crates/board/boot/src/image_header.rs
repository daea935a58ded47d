//! The header in front of an image: the only declaration of its layout, for the boot program, the
//! application, the tool and the release.
//!
//! | offset | content, little-endian |
//! |---|---|
//! | 0 | Ed25519 signature (RFC 8032) of bytes 64 to 507: through the digest it holds for the whole image |
//! | 64 | `TRUEUPFW` |
//! | 72 | `u32` format, 1 |
//! | 76 | `u32` slot that the image is linked for: 0 A, 1 B |
//! | 80 | `u32` bytes of the file, this header included; a multiple of 4 |
//! | 84 | `u32` CRC-32/AUTOSAR of the bytes behind the header |
//! | 88 | `u32` version: major, minor, patch, build, a byte each from the highest |
//! | 92 | `u32` floor: the oldest version that may start once this one is confirmed |
//! | 96 | 20 bytes of the commit, zeros if it is not known |
//! | 116 | 32 bytes: SHA-256 (FIPS 180-4) of the bytes behind the header |
//! | 148 | 0xFF |
//! | 508 | `u32` CRC-32/AUTOSAR of bytes 0 to 507: names this very image, its *tag* |
//! | 512 | the image: its vector table, which must lie on a multiple of 512 bytes |
//!
//! The signature is over a digest and not over the image itself, because Ed25519 hashes with SHA-512, which costs a
//! 32-bit core three times as much a byte. The tag is the CRC of the signature too, so it is not signed.

use core::fmt;

use crate::{crc, flash_layout::Slot, hash::Sha256};

/// Bytes of the header.
pub const HEADER_SIZE: usize = 512;
/// Bytes of a signature.
pub const SIGNATURE_SIZE: usize = 64;
/// Bytes of the digest.
pub(crate) const DIGEST_SIZE: usize = 32;
/// Bytes of a commit's hash.
pub(crate) const COMMIT_HASH_SIZE: usize = 20;
const HEADER_MAGIC: [u8; 8] = *b"TRUEUPFW";
const IMAGE_HEADER_FORMAT_VERSION: u32 = 1;
/// The tag's offset.
const TAG_OFFSET: usize = HEADER_SIZE - 4;

/// A version; later ones are larger.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct FirmwareVersion(pub u32);

impl FirmwareVersion {
    /// Returns the version of these numbers.
    #[must_use]
    pub const fn new(major: u8, minor: u8, patch: u8, build: u8) -> Self {
        Self(u32::from_be_bytes([major, minor, patch, build]))
    }

    /// Reads `1.2.3` or `1.2.3.4`; `None`: it is neither, or a number is above 255.
    #[must_use]
    pub fn parse(text: &str) -> Option<Self> {
        let mut numbers = [0; 4];
        let mut count = 0_usize;
        for word in text.split('.') {
            *numbers.get_mut(count)? = word.parse().ok()?;
            count = count.saturating_add(1);
        }
        (count >= 3).then_some(Self(u32::from_be_bytes(numbers)))
    }
}

impl fmt::Display for FirmwareVersion {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [major, minor, patch, build] = self.0.to_be_bytes();
        write!(f, "{major}.{minor}.{patch}")?;
        if build == 0 { Ok(()) } else { write!(f, ".{build}") }
    }
}

/// The header, decoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ImageHeader {
    /// The slot that the image is linked for.
    pub slot: Slot,
    /// Bytes of the file: header and image.
    pub length: u32,
    /// CRC of the image.
    pub crc: u32,
    /// The image's version.
    pub version: FirmwareVersion,
    /// The oldest version that may start once this image is confirmed.
    pub floor: FirmwareVersion,
    /// Commit that the image was built from; zeros: not known.
    pub commit: [u8; COMMIT_HASH_SIZE],
    /// SHA-256 of the image.
    pub digest: [u8; DIGEST_SIZE],
    /// Signature of [`Self::signed_bytes`].
    pub signature: [u8; SIGNATURE_SIZE],
}

/// Why 512 bytes are no header.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HeaderError {
    /// Nothing is there: erased flash.
    Blank,
    /// It does not say `TRUEUPFW`, or its CRC is wrong.
    NoHeader,
    /// A format that this program does not know.
    Format,
}

impl fmt::Display for HeaderError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Blank => "nothing is there",
            Self::NoHeader => "is no firmware of trueup, or its header is damaged",
            Self::Format => "has a header of a later format",
        })
    }
}

impl core::error::Error for HeaderError {}

impl ImageHeader {
    /// Returns the 512 bytes.
    #[must_use]
    pub fn encode(&self) -> [u8; HEADER_SIZE] {
        let mut bytes = [0xFF; HEADER_SIZE];
        let fields = [
            IMAGE_HEADER_FORMAT_VERSION,
            u32::from(self.slot.number()),
            self.length,
            self.crc,
            self.version.0,
            self.floor.0,
        ];
        let words = fields.iter().flat_map(|word| word.to_le_bytes());
        let content =
            self.signature.into_iter().chain(HEADER_MAGIC).chain(words).chain(self.commit);
        let content = content.chain(self.digest);
        bytes.iter_mut().zip(content).for_each(|(place, byte)| *place = byte);
        if let Some((content, tag)) = bytes.split_last_chunk_mut() {
            *tag = crc::checksum(content).to_le_bytes();
        }
        bytes
    }

    /// Returns the image's tag and the header.
    ///
    /// # Errors
    /// [`HeaderError`].
    pub fn decode(bytes: &[u8; HEADER_SIZE]) -> Result<(u32, Self), HeaderError> {
        if bytes.iter().all(|byte| *byte == 0xFF) {
            return Err(HeaderError::Blank);
        }
        let (content, tag) = bytes.split_last_chunk().ok_or(HeaderError::NoHeader)?;
        let tag = u32::from_le_bytes(*tag);
        let (signature, rest) = content.split_first_chunk().ok_or(HeaderError::NoHeader)?;
        let (magic, rest) = rest.split_first_chunk().ok_or(HeaderError::NoHeader)?;
        if *magic != HEADER_MAGIC || crc::checksum(content) != tag {
            return Err(HeaderError::NoHeader);
        }
        let (fields, rest) = rest.split_first_chunk::<24>().ok_or(HeaderError::NoHeader)?;
        let (commit, rest) = rest.split_first_chunk().ok_or(HeaderError::NoHeader)?;
        let (digest, _) = rest.split_first_chunk().ok_or(HeaderError::NoHeader)?;
        let &[format, slot, length, crc, version, floor] = fields.as_chunks().0 else {
            return Err(HeaderError::NoHeader);
        };
        let slot = match (u32::from_le_bytes(format), u32::from_le_bytes(slot)) {
            (IMAGE_HEADER_FORMAT_VERSION, 0) => Slot::A,
            (IMAGE_HEADER_FORMAT_VERSION, 1) => Slot::B,
            _ => return Err(HeaderError::Format),
        };
        let header = Self {
            slot,
            length: u32::from_le_bytes(length),
            crc: u32::from_le_bytes(crc),
            version: FirmwareVersion(u32::from_le_bytes(version)),
            floor: FirmwareVersion(u32::from_le_bytes(floor)),
            commit: *commit,
            digest: *digest,
            signature: *signature,
        };
        Ok((tag, header))
    }

    /// Returns the part of the header that is signed.
    #[must_use]
    pub fn signed_bytes(bytes: &[u8; HEADER_SIZE]) -> &[u8] {
        bytes.get(SIGNATURE_SIZE..TAG_OFFSET).unwrap_or_default()
    }

    /// Returns the header of this image without a signature.
    #[must_use]
    pub fn new_unsigned(
        image: &[u8],
        slot: Slot,
        version: FirmwareVersion,
        floor: FirmwareVersion,
    ) -> Self {
        // An image of 4 GB is none: its length then says so.
        let length = u32::try_from(HEADER_SIZE.saturating_add(image.len())).unwrap_or(u32::MAX);
        let mut sha = Sha256::new();
        sha.update(image);
        let (crc, digest) = (crc::checksum(image), sha.digest());
        let (commit, signature) = ([0; COMMIT_HASH_SIZE], [0; SIGNATURE_SIZE]);
        Self { slot, length, crc, version, floor, commit, digest, signature }
    }
}

const _: () = assert!(
    SIGNATURE_SIZE + HEADER_MAGIC.len() + 24 + COMMIT_HASH_SIZE + DIGEST_SIZE <= TAG_OFFSET
);

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::ToString as _;

    fn header() -> ImageHeader {
        ImageHeader {
            slot: Slot::B,
            length: 0x1234,
            crc: 0xDEAD_BEEF,
            version: FirmwareVersion::new(1, 2, 3, 0),
            floor: FirmwareVersion::new(1, 0, 0, 7),
            commit: *b"ABCDEFGHIJKLMNOPQRST",
            digest: core::array::from_fn(|n| 200 + n as u8),
            signature: core::array::from_fn(|n| n as u8),
        }
    }

    #[test]
    fn a_header_lies_as_its_table_says_and_is_read_back() {
        let bytes = header().encode();
        assert_eq!(bytes[..4], [0, 1, 2, 3]);
        assert_eq!(bytes[64..72], *b"TRUEUPFW");
        assert_eq!(bytes[72..80], [1, 0, 0, 0, 1, 0, 0, 0]);
        assert_eq!(bytes[80..84], 0x1234_u32.to_le_bytes());
        assert_eq!(bytes[84..88], 0xDEAD_BEEF_u32.to_le_bytes());
        assert_eq!(bytes[88..96], [0, 3, 2, 1, 7, 0, 0, 1]);
        assert_eq!(bytes[96..116], *b"ABCDEFGHIJKLMNOPQRST");
        assert_eq!(bytes[116..148], header().digest);
        assert!(bytes[148..508].iter().all(|byte| *byte == 0xFF));
        let (tag, decoded) = ImageHeader::decode(&bytes).unwrap();
        assert_eq!((tag.to_le_bytes().as_slice(), decoded), (&bytes[508..], header()));
        assert_eq!(ImageHeader::signed_bytes(&bytes), &bytes[64..508]);
    }

    #[test]
    fn any_flipped_bit_is_no_header() {
        let bytes = header().encode();
        for bit in 0..8 * HEADER_SIZE {
            let mut other = bytes;
            other[bit / 8] ^= 1 << (bit % 8);
            assert_eq!(ImageHeader::decode(&other), Err(HeaderError::NoHeader), "bit {bit}");
        }
        assert_eq!(ImageHeader::decode(&[0xFF; HEADER_SIZE]), Err(HeaderError::Blank));
    }

    #[test]
    fn versions_are_read_printed_and_in_order() {
        for (text, version) in [
            ("0.2.0", FirmwareVersion::new(0, 2, 0, 0)),
            ("1.20.3.4", FirmwareVersion::new(1, 20, 3, 4)),
            ("255.255.255.255", FirmwareVersion(u32::MAX)),
        ] {
            assert_eq!(
                (FirmwareVersion::parse(text), version.to_string()),
                (Some(version), text.into())
            );
        }
        for text in ["1", "1.2", "1.2.3.4.5", "1.2.256", "1.2.-3", "", "1..2"] {
            assert_eq!(FirmwareVersion::parse(text), None, "{text}");
        }
        assert!(FirmwareVersion::new(0, 9, 255, 255) < FirmwareVersion::new(0, 10, 0, 0));
        assert!(FirmwareVersion::new(0, 10, 0, 0) < FirmwareVersion::new(0, 10, 0, 1));
    }
}
