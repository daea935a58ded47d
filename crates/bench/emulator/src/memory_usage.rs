//! How large the firmware images are, from their ELF files.

use std::{fmt::Write as _, fs, path::Path};

use anyhow::{Context as _, Result, ensure};
use object::{Object as _, ObjectSection as _, ObjectSegment as _, SectionFlags, elf};

use crate::firmware_images::{self, Board};

/// Memory of the chip that an image takes, in bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MemoryUsage {
    /// Code, constants, and the start values of variables.
    pub flash: u64,
    /// Variables; the stack has the rest.
    pub ram: u64,
    /// Instructions among the flash.
    pub code: u64,
}

/// The flash and RAM of the STM32F405RG.
const FLASH_SIZE: u64 = 1024 * 1024;
const RAM_SIZE: u64 = 128 * 1024;

/// Measures an image.
///
/// # Errors
/// It cannot be read, or has no code: a link that went wrong in silence.
pub fn measure_memory_usage(image: &Path) -> Result<MemoryUsage> {
    let bytes = fs::read(image).with_context(|| format!("cannot read {}", image.display()))?;
    let elf = object::File::parse(&*bytes)?;
    let in_ram = |address: u64| (0x2000_0000..0x2000_0000 + RAM_SIZE).contains(&address);
    let flash = elf.segments().map(|segment| segment.file_range().1).sum();
    let ram = elf.segments().filter(|part| in_ram(part.address())).map(|part| part.size()).sum();
    let is_code = |flags| matches!(flags, SectionFlags::Elf { sh_flags } if sh_flags & u64::from(elf::SHF_EXECINSTR) != 0);
    let code = elf.sections().filter(|part| is_code(part.flags())).map(|part| part.size()).sum();
    ensure!(code > 0, "{} has no code: was it linked without its script?", image.display());
    Ok(MemoryUsage { flash, ram, code })
}

/// Builds both images and prints their sizes.
///
/// # Errors
/// An image does not build, or is empty.
pub fn build_size_report() -> Result<String> {
    let mut text = String::from("image          flash          RAM   (code)\n");
    for board in Board::ALL {
        let size = measure_memory_usage(&firmware_images::build_board_image(board)?)?;
        writeln!(
            text,
            "{:<10} {:>6} B {:>2} %   {:>6} B {:>2} %   {:>6} B",
            board.cargo_feature(),
            size.flash,
            size.flash * 100 / FLASH_SIZE,
            size.ram,
            size.ram * 100 / RAM_SIZE,
            size.code,
        )?;
    }
    Ok(text)
}
