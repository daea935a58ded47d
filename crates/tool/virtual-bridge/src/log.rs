//! The board's log, decoded with the image it came from.

use std::{fs, path::Path};

use anyhow::{Context as _, Result, anyhow};
use defmt_decoder::{DecodeError, Table};

/// A decoder for the log of one image.
pub struct LogDecoder {
    table: Table,
}

impl LogDecoder {
    /// Returns the decoder for an image.
    ///
    /// # Errors
    /// It cannot be read, or it logs nothing.
    pub fn from_image(image: &Path) -> Result<Self> {
        let elf = fs::read(image).with_context(|| format!("cannot read {}", image.display()))?;
        let table =
            Table::parse(&elf)?.ok_or_else(|| anyhow!("{} has no log strings", image.display()))?;
        Ok(Self { table })
    }

    /// Decodes a stream of bytes, one call of `line` for each line of the log, until it ends.
    ///
    /// # Errors
    /// The stream cannot be read, or does not fit the image.
    pub fn decode_stream(
        &self,
        mut source: impl std::io::Read,
        mut line: impl FnMut(String),
    ) -> Result<()> {
        let mut stream = self.table.new_stream_decoder();
        let mut bytes = [0; 1024];
        loop {
            let length = source.read(&mut bytes)?;
            if length == 0 {
                return Ok(());
            }
            stream.received(&bytes[..length]);
            loop {
                match stream.decode() {
                    Ok(frame) => line(frame.display(false).to_string()),
                    Err(DecodeError::UnexpectedEof) => break,
                    Err(DecodeError::Malformed) if self.table.encoding().can_recover() => {}
                    Err(error) => return Err(error.into()),
                }
            }
        }
    }
}
