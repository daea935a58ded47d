//! The virtual board: the firmware's tasks in QEMU, fed by the host.
//!
//! One folder of the host holds what this board is wired to: `calibration.bin`, `loaded.bin` (what
//! a CANopen master has loaded; it counts instead, if it is whole), `flash.bin` (what outlasts the
//! power), the pipe `samples` (blocks of one millisecond, CAN frames among them) and the
//! pipe `frames` (what the board sends on its CAN). They are read and written by semihosting, which
//! is fast but stops the whole emulator while it waits; so the board never reads before the host has
//! rung: a byte on USART2 says how many blocks are in the pipe. Between them the CPU sleeps and the serial line is
//! free. Of the announced blocks as many as fit the buffer come with one call, because the call costs far
//! more than the bytes; they are then lived through one by one.
//!
//! Time is what the samples say. Nothing here depends on how fast the host is, so the same blocks
//! give the same frames.

mod flash;
mod stubs;

use core::{
    cell::RefCell,
    sync::atomic::{AtomicBool, AtomicU32, Ordering},
};

use cortex_m::{
    asm,
    interrupt::Mutex,
    peripheral::{NVIC, SCB},
};
use embedded_hal_nb::serial::{Read as _, Write as _};
use heapless::{Deque, Vec};
use semihosting::{
    fs::File,
    io::{Read as _, Write as _},
};
use stm32f4xx_hal::{
    interrupt,
    pac::{self, Interrupt, USART1, USART2},
    prelude::*,
    rcc,
    serial::{self, Rx, Serial, Tx},
};
use trueup_core::{
    temperature_channels::RawTemperatures,
    units::{AdcCode, TimestampMs},
};
use trueup_link::frame::Frame;
use trueup_modbus::rtu::FrameTiming;
use trueup_node::reset_info::ResetInfo;
use trueup_pipe::{self as pipe, BoardRecord};
use trueup_store::calibration;

use crate::liveness::{self, Task};

use super::{
    Block, BlockCodes, CanErrorState, Parts, PlcInterface, StartupFaults,
    TEMPERATURE_CHANNEL_COUNT, TransmitState, reference_store, retained_ram,
};

use defmt_semihosting as _;
pub use flash::Flash;
pub use stubs::{BackupDomain, BrownOutLevel, Rs485, SelfTest, SilenceTimer, StatusLed, Watchdog};

/// Blocks that the host has announced and the board has not read.
static ANNOUNCED_BLOCKS: AtomicU32 = AtomicU32::new(0);
/// The sample clock, for the time stamps of frames.
static NOW_MS: AtomicU32 = AtomicU32::new(0);
/// The block that `DMA2_STREAM0` is about to take.
static RECEIVED_BLOCK: Mutex<RefCell<Option<(BlockCodes, Block)>>> = Mutex::new(RefCell::new(None));
/// Frames that `CAN1_RX0` is about to take: it empties this before the next block comes.
static CAN_RX_QUEUE: Mutex<RefCell<Deque<Frame, 8>>> = Mutex::new(RefCell::new(Deque::new()));
const _: () = assert!(pipe::FRAMES_PER_BLOCK <= 8);
/// Frames on their way to the host: what one batch of 255 blocks can send, and its end mark.
static CAN_TX_QUEUE: Mutex<RefCell<Vec<BoardRecord, 1024>>> = Mutex::new(RefCell::new(Vec::new()));

/// The service switch is closed, by the last block.
static IS_SWITCH_CLOSED: AtomicBool = AtomicBool::new(false);
/// The board is to start anew once the batch is done.
static IS_RESTART_REQUESTED: AtomicBool = AtomicBool::new(false);

/// A process that starts is a machine that was cold for a day, as `predict` takes it.
pub const IS_MACHINE_COLD_AT_START: bool = true;

/// Raises the transmitter: no tick comes before the host sends samples, and the host may wait for an answer.
pub fn transmit_without_tick() {
    NVIC::pend(Interrupt::DMA2_STREAM7);
}

/// Blocks that are read at once: 4 KB.
const MAX_BLOCKS_PER_READ: usize = 32;
/// Blocks per `SysTick`: 10 ms.
const BLOCKS_PER_SUPERVISOR_TURN: u32 = 10;

/// Brings the board up.
#[allow(unsafe_code, reason = "registers of the emulated chip, and interrupts")]
pub fn start(
    _core: cortex_m::Peripherals,
    device: pac::Peripherals,
    buffer_of_load: &'static mut super::CalibrationBuffer,
) -> Parts {
    liveness::set_background_task(Task::Start);
    // QEMU has no RCC: its oscillator bits never come up, and the HAL waits for none on HSI.
    let mut rcc = device.RCC.freeze(rcc::Config::hsi());
    let port_a = device.GPIOA.split(&mut rcc);

    let cnc = serial::Config::default().baudrate(921_600.bps());
    let cnc: Serial<USART1> = Serial::new(device.USART1, (port_a.pa9, port_a.pa10), cnc, &mut rcc)
        .expect("16 MHz reach 921 600 Bd");
    let (serial_out, mut serial_in) = cnc.split();
    serial_in.listen();

    let doorbell = serial::Config::default();
    let doorbell: Serial<USART2> =
        Serial::new(device.USART2, (port_a.pa2, port_a.pa3), doorbell, &mut rcc)
            .expect("16 MHz reach 115 200 Bd");
    let (mut ready, mut doorbell) = doorbell.split();
    doorbell.listen();
    // SAFETY: the handler below touches nothing but an atomic and the receive register, so no
    // critical section of the tasks relies on this interrupt being masked.
    unsafe { NVIC::unmask(Interrupt::USART2) };

    let buffer = cortex_m::singleton!(: BlockBuffer = [0; _]).expect("the board starts once");
    // The tables of the calibration are read where they lie, so it stays for good.
    let blob: &'static mut [u8] = cortex_m::singleton!(: [u8; calibration::MAX_BLOB_SIZE] = [0; _])
        .expect("the board starts once");
    let mut length = Store::load(blob);
    let mut is_older = false;
    if calibration::decode(&blob[..length]).is_err() {
        is_older = length > 0;
        length =
            open_file(c"calibration.bin").map_or(0, |mut file| read_until_full(&mut file, blob));
    }
    let blob: &'static [u8] = blob;
    let blob = calibration::validate_blob(&blob[..length]);
    let calibration =
        blob.and_then(|blob| Ok((calibration::calibration_crc(blob), calibration::decode(blob)?)));
    let calibration_is_good = calibration.is_ok();
    let identity = calibration.as_ref().map_or(0, |(identity, _)| *identity);
    let references = reference_store::open(Flash::load(), identity, || ());
    let samples =
        open_file(c"samples").expect("the host makes this pipe before it starts the board");
    let frames =
        File::create(c"frames").expect("the host makes this pipe before it starts the board");
    // The host waits for this byte before it rings.
    nb::block!(ready.write(b'R')).expect("a USART cannot fail to send");

    Parts {
        samples: Sampler,
        serial_in: SerialRx(serial_in),
        serial_out: SerialTx(serial_out),
        plc: PlcInterface {
            unit: 1,
            timing: FrameTiming::from_baud(19_200),
            line: Rs485,
            silence: SilenceTimer,
        },
        can_in: [CanRx, CanRx],
        can_out: CanTx,
        watchdog: Watchdog,
        brown_out: BrownOutLevel,
        lamp: StatusLed,
        idle: Idle { samples, frames, buffer },
        thermometers: Thermometers,
        service_switch: ServiceSwitch,
        calibration: calibration.map(|(_, calibration)| calibration),
        references,
        faults: StartupFaults::default(),
        start: ResetInfo::default(),
        self_test: SelfTest,
        serial_number: 1,
        chip: [1, 0, 0],
        blob: if calibration_is_good { blob.unwrap_or_default() } else { &[] },
        is_older,
        is_example: false,
        retained: retained_ram::take_retained_copies(),
        backup: BackupDomain,
        loading: Some((buffer_of_load, Store)),
    }
}

fn open_file(name: &core::ffi::CStr) -> Option<File> {
    File::open(name).ok()
}

/// Reads until the buffer is full or the file ends; gives the number of bytes.
fn read_until_full(file: &mut File, buffer: &mut [u8]) -> usize {
    let mut length = 0;
    while let Ok(more @ 1..) = file.read(&mut buffer[length..]) {
        length += more;
    }
    length
}

/// The doorbell: how many blocks the host has put into the pipe.
#[interrupt]
#[allow(unsafe_code, reason = "registers of the emulated chip, and interrupts")]
fn USART2() {
    // SAFETY: no other code reads the receive side of USART2; reading the data register is what
    // clears the interrupt.
    let usart = unsafe { &*USART2::ptr() };
    if usart.sr().read().rxne().bit_is_set() {
        ANNOUNCED_BLOCKS.fetch_add(u32::from(usart.dr().read().dr().bits()), Ordering::Relaxed);
    }
}

/// Where samples come from: what [`Idle`] has read.
pub struct Sampler;

impl Sampler {
    pub fn take_block(&mut self, codes: &mut BlockCodes) -> Option<Block> {
        let (received, block) = cortex_m::interrupt::free(|cs| RECEIVED_BLOCK.borrow(cs).take())?;
        *codes = received;
        Some(block)
    }

    /// There is no converter that could have stopped.
    pub fn restart(&mut self) {}

    /// Nor one that has a supply.
    pub fn read_internal_reference_code(&mut self) -> Option<AdcCode> {
        None
    }
}

/// The service switch, which comes with the samples.
pub struct ServiceSwitch;

impl ServiceSwitch {
    pub fn is_closed(&mut self) -> bool {
        IS_SWITCH_CLOSED.load(Ordering::Relaxed)
    }
}

/// Bytes from the CNC.
pub struct SerialRx(Rx<USART1>);

impl SerialRx {
    pub fn read(&mut self, mut take: impl FnMut(u8)) {
        while let Ok(byte) = self.0.read() {
            take(byte);
        }
    }
}

/// Bytes to the CNC.
pub struct SerialTx(#[expect(dead_code, reason = "holds that half of the USART")] Tx<USART1>);

impl SerialTx {
    /// Sends all that waits, which `fill` gives a piece at a time, byte by byte.
    pub fn send(
        &mut self,
        _now_ms: u32,
        _is_waiting: bool,
        fill: impl FnMut(&mut [u8]) -> usize,
    ) -> TransmitState {
        self.transmit_polled(fill)
    }

    /// Sends the same way as [`Self::send`].
    pub fn transmit_polled(&mut self, mut fill: impl FnMut(&mut [u8]) -> usize) -> TransmitState {
        let mut piece = [0; 16];
        loop {
            let count = fill(&mut piece);
            piece[..count].iter().for_each(|byte| self.write_byte(*byte));
            if count < piece.len() {
                return TransmitState::Idle;
            }
        }
    }

    /// The emulated USART is always ready, so that its status is not read first: each such read wakes
    /// QEMU's main loop, and halves what the line carries.
    #[allow(unsafe_code, reason = "registers of the emulated chip, and interrupts")]
    fn write_byte(&mut self, byte: u8) {
        // SAFETY: this half of the USART is owned by `self`, and a data register takes any byte.
        let usart = unsafe { &*USART1::ptr() };
        // SAFETY: as above.
        usart.dr().write(|w| unsafe { w.dr().bits(byte.into()) });
    }
}

/// Frames from the bus, which on this board come with the samples.
pub struct CanRx;

impl CanRx {
    pub fn receive(&mut self) -> Option<Frame> {
        cortex_m::interrupt::free(|cs| CAN_RX_QUEUE.borrow(cs).borrow_mut().pop_front())
    }
}

/// Frames to the bus, which on this board go to the host by the batch.
pub struct CanTx;

impl CanTx {
    /// There is no bus to be off.
    pub fn take_worst_error_state(&mut self) -> CanErrorState {
        CanErrorState::default()
    }

    /// Nothing waits: the host takes it all.
    pub fn is_busy(&mut self) -> bool {
        false
    }

    pub fn send(&mut self, frame: &Frame) {
        let time = TimestampMs(NOW_MS.load(Ordering::Relaxed));
        let record = BoardRecord::Frame { time, frame: *frame };
        // A full buffer means a board that sends more than any batch can cause; the host sees the
        // gap in the counters.
        cortex_m::interrupt::free(|cs| CAN_TX_QUEUE.borrow(cs).borrow_mut().push(record).ok());
    }
}

/// Their temperatures come with the samples.
pub struct Thermometers;

impl Thermometers {
    pub fn poll_next_channel(&mut self) -> Option<RawTemperatures> {
        None
    }
}

/// The calibration that a master has loaded: a file of the host, used from the next start.
pub struct Store;

impl Store {
    /// Reads its bytes into `place`. Returns how many there are.
    fn load(place: &mut [u8]) -> usize {
        open_file(c"loaded.bin").map_or(0, |mut file| read_until_full(&mut file, place))
    }

    /// Stores a calibration. Returns whether it was stored.
    pub fn store(&mut self, blob: &[u8], _feed: impl FnMut()) -> bool {
        semihosting::fs::write(c"loaded.bin", blob).is_ok()
    }
}

/// Starts the board anew at the end of the batch: the host learns of it there, and rings no more until
/// the board is up again.
pub fn restart() {
    IS_RESTART_REQUESTED.store(true, Ordering::Relaxed);
}

/// Announced blocks as they come from the pipe.
type BlockBuffer = [u8; MAX_BLOCKS_PER_READ * pipe::BLOCK_SIZE];

/// Work of the CPU when no task has any: it makes time pass.
pub struct Idle {
    samples: File,
    frames: File,
    buffer: &'static mut BlockBuffer,
}

impl Idle {
    pub fn run(&mut self) -> ! {
        liveness::set_background_task(Task::Idle);
        loop {
            liveness::heartbeat(Task::Idle);
            let mut left = Self::wait_for_blocks() as usize;
            while left > 0 {
                let count = left.min(MAX_BLOCKS_PER_READ);
                left -= count;
                self.process_blocks(count);
            }
            self.end_batch();
        }
    }

    /// Sleeps until the host rings. With interrupts masked the bell cannot ring between the look
    /// and the sleep: `wfi` wakes for a pending interrupt all the same.
    #[allow(unsafe_code, reason = "registers of the emulated chip, and interrupts")]
    fn wait_for_blocks() -> u32 {
        loop {
            cortex_m::interrupt::disable();
            let announced = ANNOUNCED_BLOCKS.swap(0, Ordering::Relaxed);
            if announced == 0 {
                asm::wfi();
            }
            // SAFETY: idle runs outside every critical section.
            unsafe { cortex_m::interrupt::enable() };
            if announced > 0 {
                return announced;
            }
        }
    }

    /// Reads announced blocks, no more of them than fit the buffer, and lives through them.
    fn process_blocks(&mut self, count: usize) {
        let bytes = &mut self.buffer[..count * pipe::BLOCK_SIZE];
        if read_until_full(&mut self.samples, bytes) < bytes.len() {
            defmt::panic!("the host closed the samples in the middle of a block");
        }
        for bytes in bytes.as_chunks().0 {
            let Ok(block) = pipe::Block::decode(bytes) else {
                defmt::panic!("the host sent a block that is none");
            };
            Self::process_block(&block);
        }
    }

    /// Raises the interrupts that one block stands for. Every task has a higher priority than this
    /// one, so they are done when the next line runs.
    fn process_block(block: &pipe::Block) {
        let now = NOW_MS.load(Ordering::Relaxed).wrapping_add(1);
        NOW_MS.store(now, Ordering::Relaxed);
        let mut received = false;
        cortex_m::interrupt::free(|cs| {
            let mut from_bus = CAN_RX_QUEUE.borrow(cs).borrow_mut();
            for frame in block.frames.into_iter().flatten() {
                received |= from_bus.push_back(frame).is_ok();
            }
            IS_SWITCH_CLOSED.store(block.service_switch, Ordering::Relaxed);
            let codes: BlockCodes = block.codes;
            let temperatures: Option<[_; TEMPERATURE_CHANNEL_COUNT]> = Some(block.temperatures);
            let rest = Block { speed: block.speed, temperatures };
            RECEIVED_BLOCK.borrow(cs).replace(Some((codes, rest)));
        });
        if received {
            trigger_interrupt(|| NVIC::pend(Interrupt::CAN1_RX0));
        }
        trigger_interrupt(|| NVIC::pend(Interrupt::DMA2_STREAM0));
        if now.is_multiple_of(BLOCKS_PER_SUPERVISOR_TURN) {
            trigger_interrupt(SCB::set_pendst);
        }
    }

    /// Hands the host what the batch has sent, and says that it is done.
    fn end_batch(&mut self) {
        let records = cortex_m::interrupt::free(|cs| CAN_TX_QUEUE.borrow(cs).take());
        let time = TimestampMs(NOW_MS.load(Ordering::Relaxed));
        let restart = IS_RESTART_REQUESTED.load(Ordering::Relaxed);
        let end =
            if restart { BoardRecord::Restart { time } } else { BoardRecord::EndOfBatch { time } };
        let mut bytes: Vec<u8, 4096> = Vec::new();
        for record in records.iter().chain([&end]).map(BoardRecord::encode) {
            if bytes.extend_from_slice(&record).is_err() {
                self.write_frames(&bytes);
                bytes.clear();
                bytes.extend_from_slice(&record).expect("it was just emptied");
            }
        }
        self.write_frames(&bytes);
        if restart {
            SCB::sys_reset();
        }
    }

    fn write_frames(&mut self, bytes: &[u8]) {
        if self.frames.write_all(bytes).is_err() {
            defmt::panic!("the host no longer takes frames");
        }
    }
}

/// Raises an interrupt and lets it in before the next instruction.
fn trigger_interrupt(pend: impl FnOnce()) {
    pend();
    asm::dsb();
    asm::isb();
}

/// Says why, and ends the emulator: the host then knows.
#[panic_handler]
fn panic(info: &core::panic::PanicInfo) -> ! {
    defmt::error!("{}", defmt::Display2Format(info));
    semihosting::process::exit(1)
}
