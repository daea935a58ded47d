//! Self-test of the board: at the start, whether its RAM holds what is written into it, and then all the
//! time whether the image and the registers are what they were.

use stm32f4xx_hal::{pac::CRC, rcc::Rcc};

use super::{
    crash_record::{self, CoreRegisters, StopReason},
    image_check::ImageChecker,
    ram_test,
    register_check::RegisterSnapshot,
    restart,
    stack_watermark::StackWatermark,
};

/// The self-test, a piece at each turn of the supervisor.
pub struct SelfTest {
    image: ImageChecker,
    ram_failed: bool,
    /// `None` until the first turn, when every part is up.
    registers: Option<RegisterSnapshot>,
    watermark: StackWatermark,
}

impl SelfTest {
    /// The RAM was tested before anything ran; the image is checked now.
    pub fn start(unit: CRC, rcc: &mut Rcc) -> Self {
        let failed = ram_test::failed_address();
        if let Some(address) = failed {
            defmt::error!("dead: RAM at {=u32:#x}", address);
        }
        let (image, watermark) = (ImageChecker::start(unit, rcc), StackWatermark::new());
        Self { image, ram_failed: failed.is_some(), registers: None, watermark }
    }

    /// A turn of the supervisor. A register that has changed ends this start.
    pub fn run_step(&mut self) {
        let was_bad = self.image.is_corrupt();
        self.image.check_next_words();
        if self.image.is_corrupt() && !was_bad {
            defmt::error!("dead: image, it has changed");
        }
        let registers = self.registers.get_or_insert_with(RegisterSnapshot::read);
        if let Some(changed) = registers.find_changed() {
            defmt::error!("a register has changed: {}", changed);
            let core = CoreRegisters { address: changed.address, ..CoreRegisters::default() };
            crash_record::write(StopReason::Registers, core, None);
            restart();
        }
    }

    /// Returns whether the board is damaged, and no offset may be given.
    pub fn is_damaged(&self) -> bool {
        self.ram_failed || self.image.is_corrupt()
    }

    /// Returns how many bytes of the stack were never used; called at each turn.
    pub fn scan_unused_stack_bytes(&mut self) -> u16 {
        self.watermark.scan_next_words()
    }
}
