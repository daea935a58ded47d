//! The CRC of everything that is stored: CRC-32/AUTOSAR, polynomial 0xF4ACFB13.

use crc::{CRC_32_AUTOSAR, Crc};

static CRC: Crc<u32> = Crc::<u32>::new(&CRC_32_AUTOSAR);

/// Returns the CRC over these bytes.
pub(crate) fn checksum(bytes: &[u8]) -> u32 {
    CRC.checksum(bytes)
}

/// Returns a CRC of parts.
pub(crate) fn digest() -> crc::Digest<'static, u32> {
    CRC.digest()
}

/// Puts the CRC of all bytes before them into the last four.
pub(crate) fn write_crc(bytes: &mut [u8]) {
    if let Some((content, crc)) = bytes.split_last_chunk_mut() {
        *crc = checksum(content).to_le_bytes();
    }
}

/// Returns the bytes before the CRC in the last four; `None`: it does not fit them.
pub(crate) fn verify_and_strip_crc(bytes: &[u8]) -> Option<&[u8]> {
    let (content, crc) = bytes.split_last_chunk()?;
    (checksum(content) == u32::from_le_bytes(*crc)).then_some(content)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_crc_is_that_of_autosar() {
        assert_eq!(checksum(b"123456789"), 0x1697_D06A);
        let mut sealed = *b"1234567890123";
        write_crc(&mut sealed[..9 + 4]);
        assert_eq!(sealed[9..], 0x1697_D06A_u32.to_le_bytes());
        assert_eq!(verify_and_strip_crc(&sealed), Some(&b"123456789"[..]));
        sealed[3] ^= 1;
        assert_eq!(verify_and_strip_crc(&sealed), None);
    }
}
