//! The plain bytes of an image, as a boot loader in ROM takes them: where there is no probe.

use std::{fs, path::Path};

use anyhow::{Context as _, Result, ensure};
use object::{
    LittleEndian, elf,
    read::elf::{ElfFile32, ProgramHeader as _},
};

/// Where the flash of the chip begins.
pub const FLASH_START: u32 = 0x0800_0000;
/// Its size in bytes.
pub(crate) const FLASH_SIZE: usize = 1024 * 1024;

/// Returns what is to be written from [`FLASH_START`] on. Gaps are as erased flash.
///
/// # Errors
/// The image cannot be read, or has bytes outside the flash.
pub fn read_flash_image(image: &Path) -> Result<Vec<u8>> {
    let bytes = fs::read(image).with_context(|| format!("cannot read {}", image.display()))?;
    let file = ElfFile32::<LittleEndian>::parse(&*bytes)?;
    let mut flash = Vec::new();
    for header in file.elf_program_headers() {
        let endian = LittleEndian;
        let part = header.data(endian, &*bytes).ok().context("a segment outside the file")?;
        if header.p_type(endian) != elf::PT_LOAD || part.is_empty() {
            continue;
        }
        // Variables are loaded from where they are stored, not from where they live.
        let start = header.p_paddr(endian).checked_sub(FLASH_START);
        let start = usize::try_from(start.context("a segment below the flash")?)?;
        let end = start + part.len();
        ensure!(end <= FLASH_SIZE, "a segment beyond the flash");
        if flash.len() < end {
            flash.resize(end, 0xFF);
        }
        flash[start..end].copy_from_slice(part);
    }
    Ok(flash)
}
