//! The table of the firmware: bounds that its code does not say by itself, each with the reason.
//!
//! A line is named where a function has several loops. `cargo xtask bounds` names declarations that nothing needs.

use crate::table::{
    CopyLength, Excluded, LoopBound, Once,
    Rounds::{self, Byte, Copied, Length, Mask, Micros, Odd, Terms, Times, Together, Tools},
    Spot, Table,
};

/// Microseconds for which the core stands still while a word of the flash is programmed, at the longest (DS8626, flash memory
/// programming; 16 typically).
pub(crate) const STALL_US: f64 = 100.0;

const fn bound(
    function: &'static str,
    line: &'static str,
    rounds: Rounds,
    reason: &'static str,
) -> LoopBound {
    LoopBound { at: Spot { function, line }, rounds, reason }
}

const fn copy(
    function: &'static str,
    line: &'static str,
    bytes: u32,
    reason: &'static str,
) -> CopyLength {
    CopyLength { at: Spot { function, line }, bytes, reason }
}

const fn excluded(function: &'static str, line: &'static str, reason: &'static str) -> Excluded {
    Excluded { at: Spot { function, line }, reason }
}

const EXCLUSIVE: &str = "an exclusive store fails only where an interrupt came in between, and the entry of that one is \
                         priced with a round of this";
const TERMS: &str = "at most 16 terms (`MAX_TERMS`, `core/src/dimensions.rs`)";
const COPY: &str = "a word or a byte each, `compiler_builtins`";
const ODD: &str = "the bytes that no whole word has, `compiler_builtins`";

const RARE: &str =
    "of n events log₂(n) are in the log: one entry at a time is in every response, as blocking";
const ONCE: &str =
    "logged once in the life of a start: one entry at a time is in every response, as blocking";

/// Puts a word into the log, letter by letter.
pub const WORDS: &str = "defmt::export::str";

/// The declarations.
pub const FIRMWARE: Table = Table {
    loops: LOOPS,
    copies: COPIES,
    calls: &[],
    excluded: EXCLUDED,
    lines: LINES,
    once: ONCES,
};

const LOOPS: &[LoopBound] = &[
    // The tasks.
    bound("liveness::TurnGuard", "fetch_or", Times(2), EXCLUSIVE),
    bound("liveness::LivenessMonitor::call", "swap", Times(2), EXCLUSIVE),
    bound("app::can_receive", "while let Some(frame)", Times(3), "a FIFO of three (RM0090 32.7.4)"),
    bound("Incoming::read", "", Byte, "the ring of the DMA"),
    bound("byte_queue::Reader", "", Byte, "the queue of bytes"),
    bound("app::modbus_line", "enqueue", Times(2), "a byte received, one in the shift register"),
    bound("app::modbus", "while let Some(received)", Byte, "the queue of bytes"),
    bound("app::modbus", "for byte in &*it.response", Times(61), "the longest answer, `ANSWER`"),
    bound("CanOut::send", "if !self.on_the_bus", Times(2), "the frames of a tick, `Frames`"),
    bound("Port::send_all", "", Times(2), "the frames of a tick, `Frames`"),
    bound("bytes_of_line", "", Times(8), "the bytes of a frame"),
    bound("slcan::Fields::data", "", Times(8), "the bytes of a frame"),
    bound("slcan::Fields::end", "", Times(30), "a line, `MAX_LINE`"),
    // The board.
    bound("Registers::changed", "", Times(56), "the registers that are watched, `WATCHED`"),
    bound("Watermark::turn", "", Times(256), "`PIECE`, `src/board/stm32f405/stack.rs`"),
    bound("image::Image::feed", "", Times(256), "`PIECE`, `src/board/stm32f405/image.rs`"),
    bound("Backup::set", "for key in KEYS", Times(2), "two keys"),
    bound("Flash::unlocked", "for key in UNLOCK", Times(2), "two keys"),
    bound(
        "nor_flash::NorFlash>::write",
        "as_chunks",
        Length { argument: 3, per: 4, more: 0 },
        "a word each",
    ),
    bound(
        "nor_flash::ReadNorFlash>::read",
        "",
        Length { argument: 3, per: 4, more: 0 },
        "a word each",
    ),
    bound("LinearInputs::take", "", Times(125), "`MAX_CODES`, `linear_inputs.rs`"),
    bound("Selected::operate", "", Times(9), "the registers of a converter, and the first byte"),
    bound("SpiDevice>::transaction", "", Times(2), "the operations of one selection"),
    bound("SerialOut::poll_out", "", Times(16), "`POLLED_AT_ONCE`, `serial.rs`"),
    // The store.
    bound(
        "Log<F>::append",
        "for _ in 0..attempts",
        Times(3),
        "`ATTEMPTS`, `store/src/reference.rs`",
    ),
    bound("log::write_part", "", Length { argument: 3, per: 1, more: 0 }, "a byte each"),
    bound("writes::identity", "", Times(96), "the names of a machine and a board"),
    bound("retained::save", "", Times(2), "two copies"),
    bound("retained::encode", "", Times(21), "`MAX_LAGS`, `core/src/heat_memory.rs`"),
    bound("crc32::update_table", "", Length { argument: 2, per: 1, more: 0 }, "a byte each"),
    // The correction.
    bound(
        "Bridge::step_thermal",
        "",
        Length { argument: 1, per: 1, more: 0 },
        "a round a millisecond",
    ),
    bound("lag::Lag::follow", "", Times(32), "a bit of the number of steps in each round"),
    bound("Heat::memory", "", Times(4), "three axes and the spindle"),
    bound("heat::agree", "", Times(8), "the thermometers, `CHANNELS`"),
    bound("thermal::Law::at", "", Times(16), "halves at most 2¹⁶ pieces"),
    bound("Law::depends_on_position", "", Times(64), "the pieces of a law"),
    bound("Agreement::step", "", Times(3), "the sources, `ElongationSource::ALL`"),
    bound("Bridge>::first_available", "", Times(3), "the sources, `ElongationSource::ALL`"),
    bound("fall_back_is_dead", "", Times(3), "the sources, `ElongationSource::ALL`"),
    bound("term::sum::axis_errors", "", Terms, TERMS),
    bound("term::sum::walk", "", Terms, TERMS),
    bound("TermStates::with_categories", "", Terms, TERMS),
    bound("TermStates::select", "", Terms, TERMS),
    bound("TermStates::sum_up", "", Terms, TERMS),
    bound(
        "ToolTable::level",
        "",
        Tools,
        "at most 32 tools (`MAX_TOOLS`, `core/src/dimensions.rs`)",
    ),
    bound(
        "CachedErrors::moved",
        "GUIDES_OVER",
        Times(3),
        "the two guides of an axis, and once to come to their list",
    ),
    bound("CachedVolume::errors", "", Times(3), "three guides, and the three angles of each"),
    bound("Volume::tip", "", Times(2), "two rotary axes"),
    bound("Volume::table", "", Times(2), "two rotary axes"),
    // The wire.
    bound("e2e::crc_of::{{closure}}", "", Times(8), "the bytes of a frame"),
    bound("e2e::crc_of", "", Times(32), "the registers of a block of a PLC"),
    bound("server::checksum", "", Times(256), "a serial frame, `MAX_FRAME`, `modbus/src/rtu.rs`"),
    bound(
        "rmodbus::calc_crc16",
        "for i in",
        Length { argument: 1, per: 1, more: 0 },
        "a byte each",
    ),
    bound(
        "plc::Registers",
        "block.values()",
        Times(6),
        "three positions, angles, spindle, conditions",
    ),
    bound("cnc::Cnc::decode", "", Times(3), "three axes"),
    bound("protect::put_long", "", Times(2), "two registers"),
    bound(
        "server::answered",
        "",
        Times(125),
        "registers of a request (Modbus application protocol 6.3)",
    ),
    bound("input::Input::encode", "", Times(3), "three axes"),
    bound("Emergencies::error", "", Times(8), "`HISTORY`, `canopen/src/emergency.rs`"),
    bound("Object::entry", "", Times(64), "the entries of an object"),
    bound("dictionary::object", "", Times(64), "the objects"),
    bound("health::Health::mend", "", Together(20), "the codes of a block, `CODES_PER_TICK`"),
    bound("sdo::block::Block::take", "", Times(7), "a segment of at most seven bytes"),
    bound("sdo::number_of", "", Times(4), "a number of at most four bytes"),
    // The log.
    bound(
        "encoding::inner::Encoder::write",
        "",
        Length { argument: 1, per: 1, more: 0 },
        "a byte each",
    ),
    // Libraries.
    bound(
        "extend_from_slice",
        "",
        Times(260),
        "the longest answer, `MAX_FRAME`, `modbus/src/server.rs`",
    ),
    bound("VecInner<T,LenT,S>::resize", "", Times(260), "`MAX_FRAME`, `modbus/src/server.rs`"),
    bound(
        "u64_div_rem",
        "",
        Mask(32),
        "`pow`, a bit of 32, is halved in each round, and the quotient is complete with its last bit (`delegate.rs` of \
         `compiler_builtins`)",
    ),
    bound("copy_forward_bytes", "", Odd { argument: 2 }, ODD),
    bound("set_bytes_bytes", "", Odd { argument: 1 }, ODD),
    bound("copy_forward_aligned_words", "", Copied { argument: 2, per: 4 }, COPY),
    bound("copy_forward_misaligned_words", "", Copied { argument: 2, per: 4 }, COPY),
    bound("copy_backward_aligned_words", "", Copied { argument: 2, per: 4 }, COPY),
    bound("copy_backward_misaligned_words", "", Copied { argument: 2, per: 4 }, COPY),
    bound("mem::impls::compare_bytes", "", Length { argument: 2, per: 1, more: 1 }, COPY),
    bound("__aeabi_memcpy4", "", Copied { argument: 2, per: 4 }, COPY),
    bound("set_bytes_words", "", Copied { argument: 1, per: 4 }, COPY),
    bound("__aeabi_memset4", "", Copied { argument: 1, per: 4 }, COPY),
    // Waits for the chip.
    bound(
        "serial::SerialOut::poll",
        "",
        Micros(11),
        "a byte leaves at 921 600 Bd; one that does not is dropped",
    ),
    bound(
        "Flash",
        "is_idle(flash)",
        Micros(100),
        "a word of the flash (DS8626, programming time), at its longest",
    ),
    bound("thermometers::Selected::exchange", "", Micros(10), "8 bits at 1.0 MHz or more"),
];

const COPIES: &[CopyLength] = &[
    copy(
        "Port::take",
        "",
        128,
        "a piece of the DMA, `PIECE`, `serial_dma.rs`; one that is polled out is shorter",
    ),
    copy(
        "Port::move_up",
        "",
        240,
        "what waits in the port, `TX_CAPACITY`, without a piece: that of `poll` is 16",
    ),
    copy("Port::queue", "", 22, "the line of a frame, `MAX_FRAME_LINE`"),
    copy("Frame::new", "", 8, "the bytes of a frame"),
    copy("writes::identity", "", 96, "the names of a machine and a board, `core/src/names.rs`"),
    copy("upload_segment", "", 7, "a segment of SDO"),
    copy("download_segment", "", 7, "a segment of SDO"),
    copy("load::Slot::append", "", 7, "a segment of SDO"),
    copy("Writes::push", "zip(", 24, "`SIZE`, `store/src/writes.rs`"),
    copy("retained::encode", "", 28, "`LAG_SIZE`, `store/src/retained.rs`"),
    copy("arm::__aeabi_memcpy4", "", 3, "what no whole word has"),
    copy(
        "OUTLINED_FUNCTION",
        "",
        254,
        "a serial frame without its CRC, `MAX_FRAME`, `modbus/src/rtu.rs`",
    ),
    copy(
        "server::answered",
        "frame.parse",
        254,
        "a serial frame without its CRC, `MAX_FRAME`, `modbus/src/rtu.rs`",
    ),
    copy("server::answered", "frame.finalize", 59, "the longest answer without its CRC"),
    copy(WORDS, "", 9, "the words in the log, those of `WriteKind::word` the longest"),
];

const EXCLUDED: &[Excluded] = &[
    excluded(
        "app::supervise",
        "store_calibration",
        "a loaded calibration is looked at and stored at rest alone: no offset is followed meanwhile, the watchdog is fed \
         in between",
    ),
    excluded(
        "Supervision::store_running",
        "",
        "the running calibration is stored again at rest alone, on the operator's command",
    ),
    excluded(
        "BrownOut::raise",
        "",
        "the option bytes are written once in the life of a board, after two seconds without an offset",
    ),
    excluded(
        "Channel::copy_wrapping",
        "pivot",
        "a single byte is never split: the cursor is below the size of the buffer (`defmt-rtt`)",
    ),
    excluded("CanOut::note_late", "defmt::warn", RARE),
    excluded("CanIn::note_overrun", "defmt::warn", RARE),
    excluded("SerialIn::take_polled", "defmt::warn", RARE),
    excluded("SerialIn::take_moved", "defmt::error", ONCE),
    excluded("SerialOut::send", "defmt::error", ONCE),
    excluded(
        "SerialIn::take_moved",
        "incoming.restart()",
        "the line is overrun where its DMA stands: it is started anew once, and is dead the second time",
    ),
    excluded(
        "app::supervise",
        "tick(node, behind_ms",
        "the supervisor ticks where no block has come for 10 ms: there is no offset to be late for",
    ),
    excluded(
        "SerialOut::send",
        "give_up",
        "once, when the DMA of the serial line has died: its last bytes are polled out",
    ),
];

const LINES: &[Excluded] = &[
    excluded("Port::receive", "Request::read", "a line is read at its end"),
    excluded("Port::receive", "self.reply", "a line is answered at its end"),
    excluded("Port::receive", "malformed", "a line is refused at its end"),
    excluded("Port::receive", "self.answer", "a line is refused at its end"),
    excluded("app::listen", "node.receive", "a frame is a line"),
];

const ONCES: &[Once] = &[
    Once {
        function: "errors::CachedErrors::at",
        period_us: 1e9,
        burst: 0,
        reason: "all errors are computed whole once after a start, when they are first asked for (`bridge::errors`)",
    },
    Once {
        function: "Node::receive_control",
        period_us: 10_000.0,
        burst: 0,
        reason: "a CNC sends one `Control` in 10 ms, a PLC one in a block",
    },
    Once {
        function: "sdo::Objects for trueup_node::node::Node>::write",
        period_us: 2_000.0,
        burst: 0,
        reason: "a client of SDO waits for the answer before it asks again, and one is sent every 2 ms",
    },
    Once {
        function: "sdo::Objects for trueup_node::node::Node>::read",
        period_us: 2_000.0,
        burst: 0,
        reason: "a client of SDO waits for the answer before it asks again, and one is sent every 2 ms",
    },
    Once {
        function: "Port::move_up",
        period_us: 1_380.0,
        burst: 0,
        reason: "bytes stay in the port where a piece of 128 is full, which takes 1.38 ms to leave (`PIECE`, `serial_dma.rs`)",
    },
    Once {
        function: "registers::<impl trueup_node::node::Node>::receive_value",
        period_us: 1_000.0,
        burst: 6,
        reason: "six values of a block, whose 49 bytes and silence take 6.4 ms at 115 200 Bd",
    },
    Once {
        function: "protect::is_whole",
        period_us: 2_900.0,
        burst: 2,
        reason: "two CRCs of a block, whose 43 bytes and silence take 5.8 ms at 115 200 Bd",
    },
    Once {
        function: "server::checksum",
        period_us: 6_000.0,
        burst: 2,
        reason: "two of a frame, by its bytes: the longest of 256 takes 24 ms at 115 200 Bd. Half of that, because a frame of 8 bytes \
                 takes 1.1 ms and what does not grow with it counts as well",
    },
    Once {
        function: "rmodbus::calc_crc16",
        period_us: 6_000.0,
        burst: 2,
        reason: "as `server::checksum`",
    },
    Once {
        function: "trueup_store::reference::References<F>::append",
        period_us: 50_000.0,
        burst: 0,
        reason: "`STORE_PERIOD_MS`, `store/src/pace.rs`; without it where a restart follows",
    },
    Once {
        function: "Supervision::retain",
        period_us: 1_000_000.0,
        burst: 0,
        reason: "`LOG_PERIOD_MS`, `src/supervision.rs`; once more where a restart follows",
    },
];
