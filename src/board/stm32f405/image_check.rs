//! Whether the image in the flash is the one that was built: its CRC, by the unit of the chip (section 4),
//! all the time, a piece at each turn of the supervisor, and without a boot program at the start too. Where the unit is
//! dead, the core works it out itself: twenty times slower.
//!
//! The build writes length and CRC into the image after it is linked ([`IMAGE_CHECKSUM`]; `trueup_emulator::image_check`). An
//! image that went another way has none: it runs, and says that it cannot be checked.

use core::ptr::{addr_of, read_volatile};

use stm32f4xx_hal::{
    pac::CRC,
    rcc::{Enable as _, Rcc, Reset as _},
};

/// Where the image begins (`build.rs`).
const IMAGE_START_ADDRESS: u32 = include!(concat!(env!("OUT_DIR"), "/start.in"));
/// Words a turn: 1 KB every 10 ms, so that an image of 138 KB has its turn every 1.4 s.
const WORDS_PER_STEP: u32 = 256;
/// The unit's polynomial; it begins with ones and takes the highest bit first.
const POLYNOMIAL: u32 = 0x04C1_1DB7;
/// Effect of each half of a byte on the CRC, for [`step`].
const CRC_NIBBLE_TABLE: [u32; 16] = {
    let mut steps = [0; 16];
    let mut half = 0;
    while half < 16 {
        let mut crc = (half as u32) << 28;
        let mut bit = 0;
        while bit < 4 {
            crc = if crc >> 31 == 0 { crc << 1 } else { crc << 1 ^ POLYNOMIAL };
            bit += 1;
        }
        steps[half] = crc;
        half += 1;
    }
    steps
};
/// Bytes that the linker may fill (`memory.x`).
const MAX_IMAGE_BYTES: u32 = 512 * 1024;
/// As the linker leaves it.
const UNSEALED: u32 = u32::MAX;

#[repr(C)]
struct ImageChecksum {
    /// Bytes of the image, a multiple of four.
    length: u32,
    /// Its CRC, without these two words.
    crc: u32,
}

#[used]
#[unsafe(export_name = "TRUEUP_IMAGE_CHECK")]
#[allow(unsafe_code, reason = "a name that the build knows")]
static IMAGE_CHECKSUM: ImageChecksum = ImageChecksum { length: UNSEALED, crc: UNSEALED };

/// Verdict on the image.
#[derive(Clone, Copy, PartialEq, Eq, defmt::Format)]
pub enum ImageStatus {
    /// It is the one that was built.
    Intact,
    /// It says no CRC.
    Unsealed,
    /// It is another one.
    Damaged,
}

/// The check that goes on.
pub struct ImageChecker {
    unit: CRC,
    /// The CRC so far, where the unit does not work.
    by_core: Option<u32>,
    at: u32,
    verdict: ImageStatus,
}

impl ImageChecker {
    /// Begins, and without a boot program checks it once.
    pub fn start(unit: CRC, rcc: &mut Rcc) -> Self {
        CRC::enable(rcc);
        CRC::reset(rcc);
        let mut image =
            Self { unit, by_core: None, at: IMAGE_START_ADDRESS, verdict: ImageStatus::Unsealed };
        image.feed(core::iter::once(0));
        if image.crc() != update_crc(u32::MAX, 0) {
            defmt::error!("dead: CRC unit, the core checks the image");
            image.by_core = Some(u32::MAX);
        }
        image.verdict = match read_stored_checksum() {
            (UNSEALED, UNSEALED) => ImageStatus::Unsealed,
            (length, _) if length > MAX_IMAGE_BYTES || length % 4 != 0 => ImageStatus::Damaged,
            _ => ImageStatus::Intact,
        };
        image.restart();
        // The boot program has verified the bytes of a slot a moment ago.
        while image.verdict == ImageStatus::Intact
            && !cfg!(feature = "slots")
            && !image.check_next_words()
        {}
        match image.verdict {
            ImageStatus::Intact => {
                defmt::info!("image: CRC {=u32:#010x}, whole", read_stored_checksum().1)
            }
            ImageStatus::Unsealed => defmt::warn!("image: no CRC was built in, it is not checked"),
            ImageStatus::Damaged => defmt::error!("dead: image, its CRC is wrong"),
        }
        image
    }

    /// Returns whether no offset may be given.
    pub fn is_corrupt(&self) -> bool {
        self.verdict == ImageStatus::Damaged
    }

    /// Takes the next piece; `true`: it was the last one.
    #[allow(unsafe_code, reason = "words of the flash")]
    pub fn check_next_words(&mut self) -> bool {
        if self.verdict != ImageStatus::Intact {
            return true;
        }
        let (length, crc) = read_stored_checksum();
        let end = IMAGE_START_ADDRESS.saturating_add(length);
        let own = addr_of!(IMAGE_CHECKSUM) as u32;
        let stop = end.min(self.at + 4 * WORDS_PER_STEP);
        let places = (self.at..stop).step_by(4).filter(|at| *at != own && *at != own + 4);
        // SAFETY: words of the flash: `length` is at most [`MAX`].
        let words = places.map(|at| unsafe { read_volatile(at as *const u32) });
        self.at = stop;
        self.feed(words);
        let is_over = self.at >= end;
        if is_over {
            if self.crc() != crc {
                self.verdict = ImageStatus::Damaged;
            }
            self.restart();
        }
        is_over
    }

    fn restart(&mut self) {
        self.at = IMAGE_START_ADDRESS;
        match &mut self.by_core {
            Some(crc) => {
                *crc = u32::MAX;
            }
            None => {
                self.unit.cr().write(|w| w.reset().set_bit());
            }
        }
    }

    #[allow(unsafe_code, reason = "registers of the CRC unit")]
    fn feed(&mut self, words: impl Iterator<Item = u32>) {
        match &mut self.by_core {
            Some(crc) => *crc = words.fold(*crc, update_crc),
            None => {
                let unit = self.unit.dr();
                for word in words {
                    // SAFETY: any word.
                    unit.write(|w| unsafe { w.bits(word) });
                }
            }
        }
    }

    fn crc(&self) -> u32 {
        self.by_core.unwrap_or_else(|| self.unit.dr().read().bits())
    }
}

/// Returns what the unit would make of a word: half a byte at a time.
fn update_crc(crc: u32, word: u32) -> u32 {
    (0..8).fold(crc ^ word, |crc, _| crc << 4 ^ CRC_NIBBLE_TABLE[(crc >> 28) as usize])
}

/// Length and CRC as the build has written them.
#[allow(unsafe_code, reason = "a static that the build changes after the compiler has seen it")]
fn read_stored_checksum() -> (u32, u32) {
    // SAFETY: the static is there; volatile, because its value is not the one that was compiled.
    unsafe {
        (
            read_volatile(addr_of!(IMAGE_CHECKSUM.length)),
            read_volatile(addr_of!(IMAGE_CHECKSUM.crc)),
        )
    }
}
