//! Self-test of the board: at the start, whether its RAM holds what is written into it, and then all the
//! time whether the image and the registers are what they were.

use stm32f4xx_hal::{pac::CRC, rcc::Rcc};

use super::{
    crash_record::{self, Core, StopReason},
    image::Image,
    ram_test,
    registers::Registers,
    restart,
    stack::Watermark,
};

/// The self-test, a piece at each turn of the supervisor.
pub struct SelfTest {
    image: Image,
    ram_failed: bool,
    /// `None` until the first turn, when every part is up.
    registers: Option<Registers>,
    watermark: Watermark,
}

impl SelfTest {
    /// The RAM was tested before anything ran; the image is checked now.
    pub fn start(unit: CRC, rcc: &mut Rcc) -> Self {
        let failed = ram_test::failed();
        if let Some(address) = failed {
            defmt::error!("dead: RAM at {=u32:#x}", address);
        }
        let (image, watermark) = (Image::start(unit, rcc), Watermark::new());
        Self { image, ram_failed: failed.is_some(), registers: None, watermark }
    }

    /// A turn of the supervisor. A register that has changed ends this start.
    pub fn turn(&mut self) {
        let was_bad = self.image.is_bad();
        self.image.turn();
        if self.image.is_bad() && !was_bad {
            defmt::error!("dead: image, it has changed");
        }
        let registers = self.registers.get_or_insert_with(Registers::read);
        if let Some(changed) = registers.changed() {
            defmt::error!("a register has changed: {}", changed);
            let core = Core { address: changed.address, ..Core::default() };
            crash_record::leave(StopReason::Registers, core, None);
            restart();
        }
    }

    /// Returns whether the board is damaged, and no offset may be given.
    pub fn is_damaged(&self) -> bool {
        self.ram_failed || self.image.is_bad()
    }

    /// Returns how many bytes of the stack were never used; called at each turn.
    pub fn free_stack(&mut self) -> u16 {
        self.watermark.turn()
    }
}
