//! Length and CRC of an image, written into it after it is linked: the board holds itself against them
//! (`src/board/stm32f405/image_check.rs`).

use std::{fs, path::Path};

use anyhow::{Context as _, Result, ensure};
use object::{Object as _, ObjectSection as _, ObjectSymbol as _};

use crate::flash_image;

/// The image's own words for it: length and CRC.
const IMAGE_CHECK_SYMBOL: &str = "TRUEUP_IMAGE_CHECK";
const IMAGE_CHECK_SIZE: usize = 8;

/// Writes the length and the CRC of an image into it. If its bytes are changed afterwards, call it again.
///
/// # Errors
/// The image cannot be read or written, or has no place for them.
pub fn embed_image_check(image: &Path) -> Result<()> {
    let mut bytes = fs::read(image).with_context(|| image.display().to_string())?;
    let (address, place) =
        find_symbol(&bytes, IMAGE_CHECK_SYMBOL).context("the image has no place for a CRC")?;
    // It begins with its vectors, wherever it is linked for.
    let start =
        find_symbol_address(image, "__vector_table")?.context("the image has no vectors")?;
    let mut flash = flash_image::read_flash_image(image)?
        .split_off(usize::try_from(start - flash_image::FLASH_START)?);
    flash.resize(flash.len().next_multiple_of(4), 0xFF);
    let own = usize::try_from(address - start)?;
    ensure!(
        own + IMAGE_CHECK_SIZE <= flash.len() && own.is_multiple_of(4),
        "its place is not in the image"
    );
    let crc =
        flash[..own].as_chunks().0.iter().chain(flash[own + IMAGE_CHECK_SIZE..].as_chunks().0);
    let crc = crc.fold(u32::MAX, |crc, word| update_crc(crc, u32::from_le_bytes(*word)));
    let words = [u32::try_from(flash.len())?, crc];
    for (place, word) in
        bytes[place..place + IMAGE_CHECK_SIZE].as_chunks_mut().0.iter_mut().zip(words)
    {
        *place = word.to_le_bytes();
    }
    // What the image is padded with up to a word is not in it, and is erased flash on the board.
    fs::write(image, bytes).with_context(|| image.display().to_string())
}

/// Writes bytes into an image, from a symbol on.
///
/// # Errors
/// The image cannot be read or written, or has no such symbol with that many bytes.
pub(crate) fn write_at_symbol(image: &Path, name: &str, content: &[u8]) -> Result<()> {
    let mut bytes = fs::read(image).with_context(|| image.display().to_string())?;
    let (_, place) =
        find_symbol(&bytes, name).with_context(|| format!("the image has no {name}"))?;
    let at = bytes.get_mut(place..place + content.len()).context("beyond the image")?;
    at.copy_from_slice(content);
    fs::write(image, bytes).with_context(|| image.display().to_string())
}

/// CRC-32 by 0x04C1_1DB7, highest bit first, as the chip's unit has it.
fn update_crc(crc: u32, word: u32) -> u32 {
    (0..32).fold(crc ^ word, |crc, _| {
        let shifted = crc << 1;
        if crc >> 31 == 0 { shifted } else { shifted ^ 0x04C1_1DB7 }
    })
}

/// Returns the address of a symbol in an image.
///
/// # Errors
/// The image cannot be read.
pub fn find_symbol_address(image: &Path, name: &str) -> Result<Option<u32>> {
    let bytes = fs::read(image).with_context(|| image.display().to_string())?;
    let file = object::File::parse(&*bytes)?;
    let found = file.symbols().find(|symbol| symbol.name() == Ok(name));
    Ok(found.map(|symbol| u32::try_from(symbol.address())).transpose()?)
}

/// Returns the address of a symbol in a file, and its place there.
fn find_symbol(bytes: &[u8], name: &str) -> Option<(u32, usize)> {
    let file = object::File::parse(bytes).ok()?;
    let symbol = file.symbols().find(|symbol| symbol.name() == Ok(name))?;
    let section = file.section_by_index(symbol.section_index()?).ok()?;
    let (start, _) = section.file_range()?;
    let place = start + (symbol.address() - section.address());
    Some((u32::try_from(symbol.address()).ok()?, usize::try_from(place).ok()?))
}

#[cfg(test)]
mod tests {
    use super::update_crc;

    #[test]
    fn the_crc_is_that_of_the_chips_unit() {
        // AN4187: a word of zeros.
        assert_eq!(update_crc(u32::MAX, 0), 0xC704_DD7B);
        assert_eq!(update_crc(u32::MAX, 0x1234_5678), 0xDF8A_8A2B);
    }
}
