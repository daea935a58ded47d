//! The table of the firmware: bounds that its code does not say by itself, each with the reason.
//!
//! A line is named where a function has several loops. `cargo xtask bounds` names declarations that nothing needs.

use crate::declarations::{
    CopyLengthBound, DeclarationTable, ExcludedCode,
    IterationBound::{
        AtMost, Length, Mask, Microseconds, PerStoredBytes, PerTerm, PerTool, PerWaitingByte,
        RemainderBytes, Together,
    },
    LoopBound, RateLimitedFunction, copy_length_bound, excluded_code, loop_bound,
};

/// Microseconds for which the core stands still while a word of the flash is programmed, at the longest (DS8626, flash memory
/// programming; 16 typically).
pub(crate) const MAX_FLASH_PROGRAM_STALL_US: f64 = 100.0;

const EXCLUSIVE_STORE_REASON: &str = "an exclusive store fails only where an interrupt came in between, and the entry of that one is \
                         priced with a round of this";
const MAX_TERMS_REASON: &str = "at most 16 terms (`MAX_TERMS`, `core/src/design_parameters.rs`)";
const COPY_LOOP_REASON: &str = "a word or a byte each, `compiler_builtins`";
const REMAINDER_BYTES_REASON: &str = "the bytes that no whole word has, `compiler_builtins`";

const LOG_ON_POWER_OF_TWO_REASON: &str =
    "of n events log₂(n) are in the log: one entry at a time is in every response, as blocking";
const LOGGED_ONCE_REASON: &str =
    "logged once in the life of a start: one entry at a time is in every response, as blocking";

/// Puts a word into the log, letter by letter.
pub const LOG_STRING_FUNCTION: &str = "defmt::export::str";

/// The declarations.
pub const FIRMWARE_DECLARATIONS: DeclarationTable = DeclarationTable {
    loops: LOOP_BOUNDS,
    copies: COPY_LENGTH_BOUNDS,
    calls: &[],
    excluded: EXCLUDED_CALLS,
    lines: LINE_END_EXCLUSIONS,
    once: CALLED_ONCE_FUNCTIONS,
};

const LOOP_BOUNDS: &[LoopBound] = &[
    // The tasks.
    loop_bound("liveness::TaskGuard", "fetch_or", AtMost(2), EXCLUSIVE_STORE_REASON),
    loop_bound(
        "liveness::LivenessMonitor::check_for_hang",
        "swap",
        AtMost(2),
        EXCLUSIVE_STORE_REASON,
    ),
    loop_bound("app::can_receive", "while let Some(frame)", AtMost(3), "a FIFO of 3 (RM0090)"),
    loop_bound("RxStream::read", "", PerWaitingByte, "the ring of the DMA"),
    loop_bound("byte_queue::Reader", "", PerWaitingByte, "the queue of bytes"),
    loop_bound("app::modbus", "while let Some(received)", PerWaitingByte, "the queue of bytes"),
    loop_bound("plc::queue_response", "", AtMost(61), "the longest answer, `ANSWER`"),
    loop_bound("Port::send_all", "", AtMost(2), "the frames of a tick, `Frames`"),
    loop_bound("encode_line_bytes", "", AtMost(8), "the bytes of a frame"),
    loop_bound("Port::queue", "", AtMost(22), "the line of a frame, `MAX_FRAME_LINE_LEN`"),
    loop_bound("slcan::LineParser::parse_data", "", AtMost(8), "the bytes of a frame"),
    loop_bound("slcan::LineParser::expect_end", "", AtMost(30), "a line, `MAX_LINE_LEN`"),
    // The board.
    loop_bound("RegisterSnapshot::find_changed", "", AtMost(56), "the registers, `WATCHED`"),
    loop_bound("StackWatermark::scan_next_words", "", AtMost(256), "`PIECE`, `stack_watermark.rs`"),
    loop_bound(
        "image_check::ImageChecker::feed",
        "",
        AtMost(256),
        "`WORDS_PER_TURN`, `src/board/stm32f405/image_check.rs`",
    ),
    loop_bound("BackupDomain::set_clock", "for key in UNLOCK_KEYS", AtMost(2), "two keys"),
    loop_bound("Flash::with_unlocked", "for key in UNLOCK_KEYS", AtMost(2), "two keys"),
    loop_bound(
        "nor_flash::NorFlash>::write",
        "as_chunks",
        Length { argument: 3, per: 4, more: 0 },
        "a word each",
    ),
    loop_bound(
        "nor_flash::ReadNorFlash>::read",
        "",
        Length { argument: 3, per: 4, more: 0 },
        "a word each",
    ),
    loop_bound("LinearInputs::read_means", "", AtMost(125), "`MAX_CODES_PER_CHANNEL`"),
    loop_bound("SpiDevice>::transaction", "", AtMost(9), "its registers, and the first byte"),
    loop_bound("SerialTx::transmit_polled", "", AtMost(16), "`MAX_POLLED_BYTES`, `serial.rs`"),
    // The store.
    loop_bound(
        "FlashLog<F>::append",
        "for _ in 0..attempts",
        AtMost(3),
        "`ATTEMPTS`, `store/src/reference.rs`",
    ),
    loop_bound(
        "flash_log::write_and_verify",
        "",
        Length { argument: 3, per: 1, more: 0 },
        "a byte each",
    ),
    loop_bound("retained_state::save", "", AtMost(2), "two copies"),
    loop_bound("retained_state::encode", "", AtMost(21), "`MAX_LAGS`, `core/src/retained_lags.rs`"),
    loop_bound("crc32::update_table", "", Length { argument: 2, per: 1, more: 0 }, "a byte each"),
    // The correction.
    loop_bound(
        "Bridge::step_thermal",
        "",
        Length { argument: 1, per: 1, more: 0 },
        "a round a millisecond",
    ),
    loop_bound("lag::Lag::follow", "", AtMost(32), "a bit of the number of steps in each round"),
    loop_bound("MachineThermalState::retained_lags", "", AtMost(4), "three axes and the spindle"),
    loop_bound("thermal_state::temperatures_agree", "", AtMost(8), "the thermometers, `CHANNELS`"),
    loop_bound("thermal::ThermalExpansionLaw::evaluate", "", AtMost(16), "halves 2¹⁶ pieces"),
    loop_bound("ThermalExpansionLaw::depends_on_position", "", AtMost(64), "the pieces of a law"),
    loop_bound(
        "SourceAgreementMonitor::step",
        "",
        AtMost(3),
        "the sources, `ElongationSource::ALL`",
    ),
    loop_bound(
        "Bridge>::first_fresh_in_chain",
        "",
        AtMost(3),
        "the sources, `ElongationSource::ALL`",
    ),
    loop_bound("has_fallback_failed", "", AtMost(3), "the sources, `ElongationSource::ALL`"),
    loop_bound("term::combined_effect::compute_axis_errors", "", PerTerm, MAX_TERMS_REASON),
    loop_bound("term::combined_effect::apply_terms_in_order", "", PerTerm, MAX_TERMS_REASON),
    loop_bound("TermStates::apply_category_terms", "", PerTerm, MAX_TERMS_REASON),
    loop_bound("TermStates::set_conditions", "", PerTerm, MAX_TERMS_REASON),
    loop_bound("TermStates::update_category_sum", "", PerTerm, MAX_TERMS_REASON),
    loop_bound(
        "ToolTable::level",
        "",
        PerTool,
        "at most 32 tools (`MAX_TOOLS`, `core/src/design_parameters.rs`)",
    ),
    loop_bound(
        "CachedErrors::update_guideway_errors",
        "STRAIGHTNESS_INDICES_BY_AXIS",
        AtMost(3),
        "the two guides of an axis, and once to come to their list",
    ),
    loop_bound(
        "CachedErrors::update_axis_positions",
        "in LinearAxis::ALL",
        AtMost(3),
        "the axes, `LinearAxis::ALL`",
    ),
    loop_bound(
        "CachedVolumetricErrors::compute_errors",
        "",
        AtMost(3),
        "three guides, and the three angles of each",
    ),
    loop_bound(
        "VolumetricErrorModel::compute_tip_and_tool_error",
        "",
        AtMost(2),
        "two rotary axes",
    ),
    loop_bound("VolumetricErrorModel::compute_workpiece_error", "", AtMost(2), "two rotary axes"),
    // The wire.
    loop_bound("e2e::compute_crc::{{closure}}", "", AtMost(8), "the bytes of a frame"),
    loop_bound(
        "e2e::continue_crc",
        "",
        AtMost(7),
        "a segment, in `append_bytes` of `sdo/block_download.rs`",
    ),
    loop_bound("e2e::compute_crc", "", AtMost(32), "the registers of a block of a PLC"),
    loop_bound(
        "server::checksum",
        "",
        AtMost(256),
        "a serial frame, `MAX_FRAME_BYTES`, `modbus/src/rtu.rs`",
    ),
    loop_bound(
        "rmodbus::calc_crc16",
        "for i in",
        Length { argument: 1, per: 1, more: 0 },
        "a byte each",
    ),
    loop_bound(
        "plc::SharedRegisters",
        "block.commands()",
        AtMost(6),
        "three positions, angles, spindle, conditions",
    ),
    loop_bound("holding_block::CncData::decode", "", AtMost(3), "three axes"),
    loop_bound("e2e::write_u32", "", AtMost(2), "two registers"),
    loop_bound(
        "server::execute_request",
        "",
        AtMost(125),
        "registers of a request (Modbus application protocol 6.3)",
    ),
    loop_bound("input_block::InputBlock::encode", "", AtMost(3), "three axes"),
    loop_bound(
        "EmergencyProducer::history_entry",
        "",
        AtMost(8),
        "`HISTORY`, `canopen/src/emergency.rs`",
    ),
    loop_bound("Object::entry", "", AtMost(64), "the entries of an object"),
    loop_bound("dictionary::find_object", "", AtMost(64), "the objects"),
    loop_bound(
        "sensor_health::SensorHealthMonitor::replace_outliers",
        "",
        Together(20),
        "the codes of a block, `CODES_PER_TICK`",
    ),
    loop_bound("sdo::number_from_bytes", "", AtMost(4), "a number of at most four bytes"),
    // The log.
    loop_bound(
        "encoding::inner::Encoder::write",
        "",
        Length { argument: 1, per: 1, more: 0 },
        "a byte each",
    ),
    // Libraries.
    loop_bound(
        "extend_from_slice",
        "",
        AtMost(61),
        "the longest answer: no more registers are read than the longest block has (`MAX_BLOCK_REGISTERS`, `modbus/src/server.rs`)",
    ),
    loop_bound("VecInner<T,LenT,S>::resize", "", AtMost(61), "as `extend_from_slice`"),
    loop_bound(
        "u64_div_rem",
        "",
        Mask(32),
        "`pow`, a bit of 32, is halved in each round, and the quotient is complete with its last bit (`delegate.rs` of \
         `compiler_builtins`)",
    ),
    loop_bound("copy_forward_bytes", "", RemainderBytes { argument: 2 }, REMAINDER_BYTES_REASON),
    loop_bound("set_bytes_bytes", "", RemainderBytes { argument: 1 }, REMAINDER_BYTES_REASON),
    loop_bound(
        "copy_forward_aligned_words",
        "",
        PerStoredBytes { argument: 2, per: 4 },
        COPY_LOOP_REASON,
    ),
    loop_bound(
        "copy_forward_misaligned_words",
        "",
        PerStoredBytes { argument: 2, per: 4 },
        COPY_LOOP_REASON,
    ),
    loop_bound(
        "copy_backward_aligned_words",
        "",
        PerStoredBytes { argument: 2, per: 4 },
        COPY_LOOP_REASON,
    ),
    loop_bound(
        "copy_backward_misaligned_words",
        "",
        PerStoredBytes { argument: 2, per: 4 },
        COPY_LOOP_REASON,
    ),
    loop_bound(
        "mem::impls::compare_bytes",
        "",
        Length { argument: 2, per: 1, more: 1 },
        COPY_LOOP_REASON,
    ),
    loop_bound("__aeabi_memcpy4", "", PerStoredBytes { argument: 2, per: 4 }, COPY_LOOP_REASON),
    loop_bound("set_bytes_words", "", PerStoredBytes { argument: 1, per: 4 }, COPY_LOOP_REASON),
    loop_bound("__aeabi_memset4", "", PerStoredBytes { argument: 1, per: 4 }, COPY_LOOP_REASON),
    // Waits for the chip.
    loop_bound(
        "serial::SerialTx::write_byte",
        "",
        Microseconds(11),
        "a byte leaves at 921 600 Bd; one that does not is dropped",
    ),
    loop_bound(
        "Flash",
        "is_idle(flash)",
        Microseconds(100),
        "a word of the flash (DS8626, programming time), at its longest",
    ),
    loop_bound(
        "thermometers::SelectedConverter::exchange_byte",
        "",
        Microseconds(10),
        "8 bits at 1.0 MHz or more",
    ),
];

const COPY_LENGTH_BOUNDS: &[CopyLengthBound] = &[
    copy_length_bound(
        "Port::drain_into",
        "",
        128,
        "a piece of the DMA, `PIECE`, `serial_dma.rs`; one that is polled out is shorter",
    ),
    copy_length_bound(
        "Port::discard_front",
        "",
        240,
        "what waits in the port, `TX_CAPACITY_BYTES`, without a piece: that of `poll` is 16",
    ),
    copy_length_bound("Frame::new", "", 8, "the bytes of a frame"),
    copy_length_bound("upload_segment", "", 7, "a segment of SDO"),
    copy_length_bound("download_segment", "", 7, "a segment of SDO"),
    copy_length_bound("calibration_load::LoadSlot::append", "", 7, "a segment of SDO"),
    copy_length_bound("WriteLog::push", "zip(", 24, "`SIZE`, `store/src/write_log.rs`"),
    copy_length_bound(
        "retained_state::encode",
        "",
        28,
        "`LAG_SIZE`, `store/src/retained_state.rs`",
    ),
    copy_length_bound("arm::__aeabi_memcpy4", "", 3, "what no whole word has"),
    copy_length_bound(
        "OUTLINED_FUNCTION",
        "",
        254,
        "a serial frame without its CRC, `MAX_FRAME_BYTES`, `modbus/src/rtu.rs`",
    ),
    copy_length_bound(
        "server::execute_request",
        "frame.parse",
        254,
        "a serial frame without its CRC, `MAX_FRAME_BYTES`, `modbus/src/rtu.rs`",
    ),
    copy_length_bound(
        "server::execute_request",
        "frame.finalize",
        59,
        "the longest answer without its CRC",
    ),
    copy_length_bound(
        LOG_STRING_FUNCTION,
        "",
        9,
        "the words in the log, those of `WriteKind::word` the longest",
    ),
];

const EXCLUDED_CALLS: &[ExcludedCode] = &[
    excluded_code(
        "app::supervise",
        "store_calibration",
        "a loaded calibration is looked at and stored at rest alone: no offset is followed meanwhile, the watchdog is fed \
         in between",
    ),
    excluded_code(
        "Supervisor::store_running_calibration",
        "",
        "the running calibration is stored again at rest alone, on the operator's command",
    ),
    excluded_code(
        "BrownOutLevel::raise_level",
        "",
        "the option bytes are written once in the life of a board, after two seconds without an offset",
    ),
    excluded_code(
        "Channel::copy_wrapping",
        "pivot",
        "a single byte is never split: the cursor is below the size of the buffer (`defmt-rtt`)",
    ),
    excluded_code("CanTx::count_late_frame", "defmt::warn", LOG_ON_POWER_OF_TWO_REASON),
    excluded_code("CanRx::count_overrun", "defmt::warn", LOG_ON_POWER_OF_TWO_REASON),
    excluded_code("SerialRx::read_polled", "defmt::warn", LOG_ON_POWER_OF_TWO_REASON),
    excluded_code("SerialRx::read_dma", "defmt::error", LOGGED_ONCE_REASON),
    excluded_code("SerialTx::send", "defmt::error", LOGGED_ONCE_REASON),
    excluded_code(
        "SerialRx::read_dma",
        "incoming.restart()",
        "the line is overrun where its DMA stands: it is started anew once, and is dead the second time",
    ),
    excluded_code(
        "app::supervise",
        "run_tick(node, behind_ms",
        "the supervisor ticks where no block has come for 10 ms: there is no offset to be late for",
    ),
    excluded_code(
        "SerialTx::send",
        "abort",
        "once, when the DMA of the serial line has died: its last bytes are polled out",
    ),
];

const LINE_END_EXCLUSIONS: &[ExcludedCode] = &[
    excluded_code("Port::receive", "Request::parse", "a line is read at its end"),
    excluded_code("Port::receive", "self.reply", "a line is answered at its end"),
    excluded_code("Port::receive", "malformed", "a line is refused at its end"),
    excluded_code("Port::receive", "self.queue_reply", "a line is refused at its end"),
    excluded_code("app::listen", "port.receive_line", "a line is answered at its end"),
    excluded_code("app::listen", "node.receive", "a frame is a line"),
];

const CALLED_ONCE_FUNCTIONS: &[RateLimitedFunction] = &[
    RateLimitedFunction {
        function: "Node::receive_control",
        period_us: 10_000.0,
        burst: 0,
        reason: "a CNC sends one `Control` in 10 ms, a PLC one in a block",
    },
    RateLimitedFunction {
        function: "sdo::ObjectAccess for trueup_node::node::Node>::read|sdo::ObjectAccess for trueup_node::node::Node>::write\
                   |sdo::ObjectAccess for trueup_node::node::Node>::open",
        period_us: 2_000.0,
        burst: 0,
        reason: "an SDO request uses one entry, and its client waits for the answer: one is sent every 2 ms",
    },
    RateLimitedFunction {
        function: "sdo::find_entry",
        period_us: 2_000.0,
        burst: 0,
        reason: "once a request, as above",
    },
    RateLimitedFunction {
        function: "Bridge>::update_axis_position",
        period_us: 2_000.0 / 3.0,
        burst: 3,
        reason: "once an axis in 2 ticks (`ERROR_UPDATE_PERIOD_MS`, `core/src/bridge.rs`): all three at once, and again in 1.4 ms where a \
                 tick was late",
    },
    RateLimitedFunction {
        function: "Bridge>::update_angles",
        period_us: 2_000.0,
        burst: 1,
        reason: "once in 2 ticks, as `update_axis_position`",
    },
    RateLimitedFunction {
        function: "server::handle_request",
        period_us: 1_750.0,
        burst: 1,
        reason: "a frame ends with a silence of 1.75 ms (`FrameTiming`, `modbus/src/rtu.rs`), and one may have begun before",
    },
    RateLimitedFunction {
        function: "plc::queue_response",
        period_us: 1_750.0,
        burst: 1,
        reason: "once a frame, as `server::handle_request`",
    },
    RateLimitedFunction {
        function: "serial_dma::TxStream::send",
        period_us: 420.0,
        burst: 2,
        reason: "a piece has what `sample`, `service` or `supervise` has queued, or follows a full one: once in 1, 2, 10 and 1.38 ms; one \
                 more by each of the first two where they come at once, and together they leave as one",
    },
    RateLimitedFunction {
        function: "Port::discard_front",
        period_us: 1_380.0,
        burst: 0,
        reason: "bytes stay in the port where a piece of 128 is full, which takes 1.38 ms to leave (`PIECE`, `serial_dma.rs`)",
    },
    RateLimitedFunction {
        function: "registers::<impl trueup_node::node::Node>::receive_command",
        period_us: 1_000.0,
        burst: 6,
        reason: "six values of a block, whose 49 bytes and silence take 6.4 ms at 115 200 Bd",
    },
    RateLimitedFunction {
        function: "e2e::has_valid_crc",
        period_us: 2_900.0,
        burst: 2,
        reason: "two CRCs of a block, whose 43 bytes and silence take 5.8 ms at 115 200 Bd",
    },
    RateLimitedFunction {
        function: "server::execute_request",
        period_us: 2_500.0,
        burst: 1,
        reason: "8 bytes or more (`MIN_REQUEST_BYTES`, `modbus/src/server.rs`), 0.76 ms, and a silence of 1.75 ms",
    },
    RateLimitedFunction {
        function: "server::checksum",
        period_us: 8_000.0,
        burst: 2,
        reason: "two of a frame, by its bytes: the longest of 256 takes 24 ms at 115 200 Bd. A third less, because what does not grow with a \
                 frame counts once in the 1.75 ms of its silence as well",
    },
    RateLimitedFunction {
        function: "rmodbus::calc_crc16",
        period_us: 8_000.0,
        burst: 2,
        reason: "as `server::checksum`",
    },
    RateLimitedFunction {
        function: "trueup_store::reference::ReferenceStore<F>::append",
        period_us: 50_000.0,
        burst: 0,
        reason: "`MIN_STORE_INTERVAL_MS`, `store/src/rate_limit.rs`; without it where a restart follows",
    },
    RateLimitedFunction {
        function: "Supervisor::save_retained_state",
        period_us: 1_000_000.0,
        burst: 0,
        reason: "`LOG_PERIOD_MS`, `src/supervision.rs`; once more where a restart follows",
    },
];
