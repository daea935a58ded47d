//! The CRC of records, headers and images: CRC-32/AUTOSAR, polynomial 0xF4ACFB13, as of everything stored.

use crc::{CRC_32_AUTOSAR, Crc};

static CRC: Crc<u32> = Crc::<u32>::new(&CRC_32_AUTOSAR);

/// Returns the CRC of these bytes.
pub(crate) fn checksum(bytes: &[u8]) -> u32 {
    CRC.checksum(bytes)
}

/// Returns a CRC of parts.
pub(crate) fn incremental_checksum() -> crc::Digest<'static, u32> {
    CRC.digest()
}
