//! The origin of a report: version, day and files.

use std::{
    fs::File,
    io::{BufRead as _, BufReader},
    path::Path,
};

use anyhow::{Context as _, Result};
use crc::{CRC_32_ISO_HDLC, Crc};
use time::OffsetDateTime;
use trueup_page::Provenance;

/// The CRC of zip and Ethernet.
const CRC: Crc<u32, crc::Table<16>> = Crc::<u32, crc::Table<16>>::new(&CRC_32_ISO_HDLC);

/// That of a report of today from these files.
pub fn provenance_from_files(files: &[&Path]) -> Result<Provenance> {
    let named = |path: &&Path| Ok((path.display().to_string(), compute_file_crc32(path)?));
    Ok(provenance_from_checksums(files.iter().map(named).collect::<Result<_>>()?))
}

/// The same from files that are read already: their names and contents.
pub fn provenance_from_contents(files: &[(&str, &[u8])]) -> Provenance {
    provenance_from_checksums(
        files.iter().map(|(name, bytes)| ((*name).into(), CRC.checksum(bytes))).collect(),
    )
}

fn provenance_from_checksums(files: Vec<(String, u32)>) -> Provenance {
    let date = OffsetDateTime::now_utc().date().to_string();
    Provenance { version: env!("CARGO_PKG_VERSION").into(), date, files }
}

fn compute_file_crc32(path: &Path) -> Result<u32> {
    let during = || format!("while reading {} again", path.display());
    let mut file = BufReader::with_capacity(1 << 16, File::open(path).with_context(during)?);
    let mut digest = CRC.digest();
    loop {
        let part = file.fill_buf().with_context(during)?;
        if part.is_empty() {
            return Ok(digest.finalize());
        }
        digest.update(part);
        let read = part.len();
        file.consume(read);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_crc_is_that_of_zip() {
        let file = tempfile::NamedTempFile::new().expect("a temporary file");
        std::fs::write(file.path(), "123456789").expect("it is written");
        // The check value of CRC-32/ISO-HDLC.
        assert_eq!(compute_file_crc32(file.path()).expect("it is read"), 0xCBF4_3926);
    }
}
