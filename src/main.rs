//! The trueup bridge: a spindle's displacement sensor in, offsets for the CNC out.
//!
//! ```text
//!  converter ─► sample ──────────────┬─► OffsetXY, OffsetZ ─► CAN
//!                 ▲    frames, E2E   └─► SLCAN lines ─► transmit ──────► serial line
//!                 │  └► service: heartbeat, emergencies, SDO answers ─► both
//!                 │ Control, Spindle
//!  CAN ─► can_receive ─► node ◄─ listen ◄─ serial_receive ◄──────────── serial line
//!  10 ms ─► supervise: converter, self-test, watchdog, lamp, log; what is taken and loaded is stored
//!              └► thermometers: one of eight asked; all of them to sample, every 100 ms
//! ```
//!
//! | task | trigger | priority | arrives | deadline | reads | writes |
//! |---|---|---|---|---|---|---|
//! | `serial_receive` | USART1, a pause or half a ring of bytes | 9 | 0.24 ms; 128 bytes, 10.8 µs each | 1.39 ms, the other half | USART1, DMA | byte queue |
//! | `serial_dma_progress` | DMA2 stream 2, half a ring of bytes | 9 | 1.39 ms | 1.39 ms | | |
//! | `sample` | DMA2 stream 0, 20 codes | 8 | 1 ms | 1 ms, the next block | samples, temperatures | node, port, CAN |
//! | `modbus_line` | USART3, a byte from the PLC, room for one to it | 10 | 95 µs; at 16 MHz 573 µs | 95 µs, the next byte at 115 200 Bd; at 16 MHz 573 µs, 19 200 Bd | USART3 | byte queues |
//! | `can_receive_0`, `_1` | CAN1, a frame in the FIFO | 7 | 2 ms; at 144 MHz never; at 16 MHz never | 2 ms, the next cycle of 2 × 3 frames | CAN | node |
//! | `listen` | bytes in the queue | 5 | 0.24 ms; 128 bytes, 10.8 µs each, 22 a line | 1,024 bytes (11 ms) | byte queue | port, node |
//! | `supervise` | `SysTick`, 10 ms | 2 | 10 ms | 100 ms, the watchdog | node, image, registers, stack | samples, watchdog, lamp, flash |
//! | `service` | 2 ms since its last turn | 4 | 2 ms | 10 ms | node | node, port, CAN |
//! | `modbus` | TIM5, 3.5 characters of silence; 16 bytes in the queue | 3 | 0.75 ms; 64 bytes, 95 µs each; at 16 MHz 1.6 ms | 4.5 ms, 48 bytes; at 16 MHz 27 ms | byte queue, node | node, byte queue |
//! | `transmit` | lines in the port, room on the line | 6 | 0.25 ms | 5 ms of frames in the port | port | USART1, DMA |
//! | `poll` | `transmit`, where its DMA is dead | 1 | never while the DMA lives | the same | port | USART1 |
//! | `thermometers` | `supervise` | 1 | 10 ms | 1 s, then the channels count as bad | SPI2 | temperatures |
//! | `idle` | nothing else to do | 0 | | | | |
//!
//! `arrives`: how often a task starts at the most. A pause of the serial line comes once a line of 22 bytes. A PLC raises
//! `modbus` by a silence of 1.75 ms and by 16 bytes of 95 µs. `sample`, `service` and `supervise` raise `transmit` 1.6 times in a
//! millisecond, and the pieces that have left 2.4 times: each has what one of these has queued, or follows a full one of 1.38 ms. Without
//! its crystal (144 and 16 MHz) a board has no CAN. `cargo xtask bounds` reads this table.
//!
//! Measured on the model of the chip, all lines busy and a `Zero` stored (host-tests, `chip` `waits`; docs/robustness.md): no
//! task waits for half its deadline, on 16 MHz for two thirds. Interrupts are off for 12 µs at the longest, 110 µs on 16 MHz,
//! each time for the log: only a PLC at 115 200 Bd may lose a byte by that, and only on 16 MHz, and the serial line where its
//! DMA is dead.
//!
//! Each task says when it begins and ends a turn ([`liveness`]); the watchdog is fed by that. The tasks are the same on
//! every board; [`board`] is what differs. `trueup-core` computes, `trueup-link` has the messages; both are tested on the host.
#![no_std]
#![no_main]

mod board;
#[cfg(feature = "faults")]
mod faults;
mod liveness;
mod plc;
mod startup;
mod supervision;

use core::sync::atomic::{AtomicU32, Ordering};

/// The sample clock, for the log.
static NOW_MS: AtomicU32 = AtomicU32::new(0);
defmt::timestamp!("{=u32} ms", NOW_MS.load(Ordering::Relaxed));

#[rtic::app(device = stm32f4xx_hal::pac, peripherals = true)]
mod app {
    use super::{NOW_MS, Ordering};
    use crate::{
        board::{
            self, BlockCodes, CalibrationBuffer, CanRx, CanTx, Idle, Rs485, Sampler, SelfTest,
            SerialRx, SerialTx, ServiceSwitch, SilenceTimer, Thermometers, TransmitState,
        },
        liveness::{self, Task},
        plc::{SharedRegisters, queue_response},
        startup::init_node_in_place,
        supervision::{SUPERVISOR_PERIOD_MS, Supervisor, log_live_values},
    };
    use core::mem::MaybeUninit;
    use heapless::spsc::{Consumer, Producer, Queue};
    use stm32f4xx_hal::pac::Interrupt;
    use trueup_canopen::emergency::{Fault, Faults};
    use trueup_core::{bridge::TickInput, temperature_channels::RawTemperatures};
    use trueup_link::{
        byte_queue::{ByteQueue, Reader, Writer},
        frame::Frame,
        slcan::{LineSplitter, Port},
    };
    use trueup_modbus::{
        rtu::{RxByte, Slave},
        server::ResponseBuffer,
    };
    use trueup_node::{
        configuration::NodeConfiguration,
        node::{Interface, Node, OffsetFrames},
    };
    use trueup_store::{rate_limit::StorePermit, retained_state};

    /// The tasks that other tasks start have an interrupt that no pin uses. A pended interrupt cannot
    /// be lost: raised while its task runs, it makes it run again.
    const LISTEN_INTERRUPT: Interrupt = Interrupt::EXTI0;
    const POLL_INTERRUPT: Interrupt = Interrupt::EXTI1;
    /// The DMA raises this one too, when there is room for more.
    const TRANSMIT_INTERRUPT: Interrupt = Interrupt::DMA2_STREAM7;
    const THERMOMETERS_INTERRUPT: Interrupt = Interrupt::EXTI2;
    const SERVICE_INTERRUPT: Interrupt = Interrupt::EXTI3;
    /// Bytes between the interrupt that takes them and the task that reads them.
    const SERIAL_RX_QUEUE_LENGTH: usize = 1024;
    /// The same of the PLC's line: 6 ms at 115 200 Bd.
    const PLC_RX_QUEUE_LENGTH: usize = 64;
    /// From this number of them on they are taken though the line has not paused; the others are room for the time that takes.
    const PLC_BATCH_LENGTH: usize = 16;
    /// An answer of up to 61 bytes.
    const MODBUS_TX_QUEUE_LENGTH: usize = 64;

    #[shared]
    struct Shared {
        /// Where it lies for good: it is large, and moving it would cost the stack its size each time.
        node: &'static mut Node<'static>,
        port: Port,
        serial_out: SerialTx,
        can_out: CanTx,
        samples: Sampler,
        /// Readings of the thermometers, until a tick takes them.
        temperatures: Option<RawTemperatures>,
    }

    #[local]
    struct Local {
        serial_in: SerialRx,
        rs485: Rs485,
        to_modbus: Producer<'static, RxByte>,
        from_modbus: Consumer<'static, u8>,
        slave: Slave,
        silence: SilenceTimer,
        received: Consumer<'static, RxByte>,
        answer: Producer<'static, u8>,
        can_in_0: CanRx,
        can_in_1: CanRx,
        thermometers: Thermometers,
        to_listen: Writer<'static, SERIAL_RX_QUEUE_LENGTH>,
        from_serial: Reader<'static, SERIAL_RX_QUEUE_LENGTH>,
        supervision: Supervisor,
        service_switch: ServiceSwitch,
        self_test: SelfTest,
        idle: Idle,
    }

    #[init(local = [queue: ByteQueue<SERIAL_RX_QUEUE_LENGTH> = ByteQueue::new(), buffer: CalibrationBuffer = [0; _],
                    bytes_heard: Queue<RxByte, PLC_RX_QUEUE_LENGTH> = Queue::new(), bytes_said: Queue<u8, MODBUS_TX_QUEUE_LENGTH> = Queue::new(),
                    place: MaybeUninit<Node<'static>> = MaybeUninit::uninit()])]
    fn init(cx: init::Context) -> (Shared, Local) {
        let mut parts = board::start(cx.core, cx.device, cx.local.buffer);
        let faults = parts.faults;
        if let Err(error) = &parts.calibration {
            defmt::error!("calibration refused: {}", error);
        }
        let (buffer, store) = parts.loading.unzip();
        let (references, kept) = parts.references;
        let own = faults
            .active_faults()
            .fold(Faults::default(), |all, fault| all.with_fault_if(true, fault));
        let configure = |calibration| NodeConfiguration {
            calibration,
            blob: parts.blob,
            buffer,
            is_degraded: faults.uses_fallback(),
            faults: own
                .with_fault_if(parts.is_example, Fault::ExampleConstants)
                .with_fault_if(parts.self_test.is_damaged(), Fault::SelfTest),
            questions: Faults::default().with_fault_if(parts.is_older, Fault::OlderCalibration),
            start: parts.start,
            serial_number: parts.serial_number,
            commit: board::COMMIT_HASH_PREFIX,
            writes: references.last_writes().clone(),
        };
        let node = init_node_in_place(cx.local.place, parts.calibration.as_ref().ok(), configure);
        // That of an example belongs to no machine.
        if let Some((standing, supply)) = kept.standing.filter(|_| !parts.is_example) {
            if !node.restore_reference_status(standing, kept.taken) {
                defmt::error!("the stored reference is larger than a correction may be: not used");
            }
            node.set_supply_baseline_level(supply);
        }
        if !parts.is_example {
            node.check_identity(kept.named, parts.chip);
        }
        let off_s = parts.backup.restore(parts.retained);
        match retained_state::load(parts.retained) {
            None if board::IS_MACHINE_COLD_AT_START => {}
            kept => node.resume(kept.as_ref(), off_s),
        }
        let mut supervision = Supervisor::new(
            parts.watchdog,
            parts.brown_out,
            parts.lamp,
            references,
            store,
            parts.retained,
            parts.backup,
        );
        // The time without power counts once: the next reset goes on from here.
        if off_s > 0 {
            supervision.save_retained_state(&node.retained_state());
        }
        let (to_listen, from_serial) = cx.local.queue.split();
        let (to_modbus, received) = cx.local.bytes_heard.split();
        let (answer, from_modbus) = cx.local.bytes_said.split();
        defmt::info!("trueup bridge {} is up", env!("CARGO_PKG_VERSION"));
        #[cfg(feature = "faults")]
        defmt::error!("a test build: it breaks on command");
        let shared = Shared {
            node,
            port: Port::new(board::short_serial_number(parts.serial_number)),
            serial_out: parts.serial_out,
            can_out: parts.can_out,
            samples: parts.samples,
            temperatures: None,
        };
        let [can_in_0, can_in_1] = parts.can_in;
        let local = Local {
            serial_in: parts.serial_in,
            rs485: parts.plc.line,
            to_modbus,
            from_modbus,
            slave: Slave::new(parts.plc.unit, parts.plc.timing),
            silence: parts.plc.silence,
            received,
            answer,
            can_in_0,
            can_in_1,
            thermometers: parts.thermometers,
            to_listen,
            from_serial,
            supervision,
            service_switch: parts.service_switch,
            self_test: parts.self_test,
            idle: parts.idle,
        };
        (shared, local)
    }

    /// A millisecond of codes becomes an offset.
    #[task(binds = DMA2_STREAM0, priority = 8,
           shared = [node, port, can_out, samples, temperatures])]
    fn sample(cx: sample::Context) {
        let _turn = liveness::begin_task(Task::Sample);
        let mut shared = cx.shared;
        let mut codes = BlockCodes::default();
        let Some(block) = shared.samples.lock(|adc| adc.take_block(&mut codes)) else { return };
        let temperatures = block.temperatures.or_else(|| shared.temperatures.lock(Option::take));
        let (codes, speed) = (Some(&codes), block.speed);
        let input = TickInput { codes, speed, temperatures: temperatures.as_ref() };
        let frames = shared.node.lock(|node| run_tick(node, 1, input));
        shared.can_out.lock(|can| shared.port.lock(|port| send_frames(&frames, can, port)));
        rtic::pend(TRANSMIT_INTERRUPT);
    }

    /// A frame from the bus, in the first FIFO.
    #[task(binds = CAN1_RX0, priority = 7, local = [can_in_0], shared = [node])]
    fn can_receive_0(mut cx: can_receive_0::Context) {
        let _turn = liveness::begin_task(Task::CanReceive0);
        while let Some(frame) = cx.local.can_in_0.receive() {
            // What is refused is counted there and shows in the log.
            cx.shared.node.lock(|node| node.receive(Interface::Can, &frame)).ok();
        }
    }

    /// A frame from the bus, in the second FIFO.
    #[task(binds = CAN1_RX1, priority = 7, local = [can_in_1], shared = [node])]
    fn can_receive_1(mut cx: can_receive_1::Context) {
        let _turn = liveness::begin_task(Task::CanReceive1);
        while let Some(frame) = cx.local.can_in_1.receive() {
            cx.shared.node.lock(|node| node.receive(Interface::Can, &frame)).ok();
        }
    }

    /// Bytes from the serial line: saved before more come, understood later.
    #[task(binds = USART1, priority = 9, local = [serial_in, to_listen])]
    fn serial_receive(cx: serial_receive::Context) {
        let _turn = liveness::begin_task(Task::SerialReceive);
        let mut batch = cx.local.to_listen.begin_batch();
        // A full queue loses the byte; the line it belongs to is then refused and counted.
        cx.local.serial_in.read(|byte| _ = batch.push(byte));
        drop(batch);
        rtic::pend(LISTEN_INTERRUPT);
    }

    /// The ring of the DMA is half full or full, and the line has not paused.
    #[task(binds = DMA2_STREAM2, priority = 9)]
    fn serial_dma_progress(_: serial_dma_progress::Context) {
        rtic::pend(Interrupt::USART1);
    }

    /// Bytes become lines, lines become frames. The answers wait for the next tick, and leave with the offsets.
    #[task(binds = EXTI0, priority = 5, local = [from_serial, lines: LineSplitter = LineSplitter::new()],
           shared = [port, node])]
    fn listen(mut cx: listen::Context) {
        let _turn = liveness::begin_task(Task::Listen);
        while let Some(byte) = cx.local.from_serial.pop() {
            let Some(line) = cx.local.lines.push(byte) else { continue };
            if let Some(frame) = cx.shared.port.lock(|port| port.receive_line(line)) {
                cx.shared.node.lock(|node| node.receive(Interface::Serial, &frame)).ok();
            }
        }
        board::transmit_without_tick();
    }

    /// Bytes from the PLC, each with its time, and those of an answer to it.
    #[task(binds = USART3, priority = 10, local = [rs485, to_modbus, from_modbus])]
    fn modbus_line(cx: modbus_line::Context) {
        let _turn = liveness::begin_task(Task::ModbusLine);
        // One: the next is a character's time away, and raises the interrupt again.
        if let Some(received) = cx.local.rs485.receive_byte() {
            // A full queue loses the byte; the checksum of its frame shows that.
            cx.local.to_modbus.enqueue(received).ok();
        }
        cx.local.rs485.send(|| cx.local.from_modbus.dequeue());
        if cx.local.to_modbus.len() >= PLC_BATCH_LENGTH {
            rtic::pend(Interrupt::TIM5);
        }
    }

    /// Bytes become requests, requests are answered.
    #[task(binds = TIM5, priority = 3, shared = [node],
           local = [slave, silence, received, answer, response: ResponseBuffer = ResponseBuffer::new()])]
    fn modbus(cx: modbus::Context) {
        let _turn = liveness::begin_task(Task::Modbus);
        let it = cx.local;
        while let Some(received) = it.received.dequeue() {
            it.slave.push(received);
        }
        // Read behind the bytes: no time of theirs is later.
        let now_us = it.silence.now_us();
        if it.slave.poll(now_us, &mut SharedRegisters(cx.shared.node), it.response) {
            queue_response(it.answer, it.response);
            rtic::pend(Interrupt::USART3);
        }
    }

    /// Every 10 ms: is all well? On a board whose converter is dead this is what keeps the CNC
    /// informed.
    #[task(binds = SysTick, priority = 2, local = [supervision, service_switch, self_test],
           shared = [node, port, can_out, samples, temperatures])]
    fn supervise(cx: supervise::Context) {
        let turn = liveness::begin_task(Task::Supervise);
        let (mut shared, it, self_test) = (cx.shared, cx.local.supervision, cx.local.self_test);
        if let Some(code) = shared.samples.lock(|samples| samples.read_internal_reference_code()) {
            shared.node.lock(|node| node.receive_supply_code(code));
        }
        let is_closed = cx.local.service_switch.is_closed();
        shared.node.lock(|node| node.update_service_switch(is_closed));
        if it.are_samples_missing(shared.node.lock(|node| node.sample_block_count())) {
            shared.samples.lock(Sampler::restart);
        }
        // This clock goes on whatever becomes of the samples, and with it every timeout.
        if let Some(behind_ms) = shared.node.lock(|node| node.advance_clock(SUPERVISOR_PERIOD_MS)) {
            let temperatures = shared.temperatures.lock(Option::take);
            let input = TickInput { temperatures: temperatures.as_ref(), ..TickInput::default() };
            let frames = shared.node.lock(|node| run_tick(node, behind_ms, input));
            shared.can_out.lock(|can| shared.port.lock(|port| send_frames(&frames, can, port)));
        }
        let (now, quality) = shared.node.lock(|node| (node.now().0, node.last_output().quality));
        Supervisor::log_zero_outcome(shared.node.lock(|node| node.take_zero_outcome()));
        // One record at a time: what else is to be stored waits for a later turn.
        it.advance_store_rate_limiter();
        if let Some(permit) = it.store_permit() {
            it.store_reference_status(&mut shared.node, permit);
        }
        // Looked at and stored outside the lock: neither holds up a tick.
        if let Some(mut load) = shared.node.lock(|node| node.take_received_calibration()) {
            let outcome = it.store_calibration(&mut load);
            shared.node.lock(|node| node.finish_load(load, outcome));
        }
        if let Some(blob) = shared.node.lock(|node| node.take_calibration_to_restore()) {
            let is_stored = it.store_running_calibration(blob);
            shared.node.lock(|node| node.finish_calibration_drop(is_stored));
        }
        #[cfg(feature = "slots")]
        it.update_firmware(&mut shared.node);
        let bus = shared.can_out.lock(CanTx::take_worst_error_state);
        shared.node.lock(|node| {
            node.set_or_clear_fault(bus.warning, Fault::CanWarning);
            node.set_or_clear_fault(bus.passive, Fault::CanPassive);
            node.set_or_clear_fault(bus.off, Fault::CanOff);
        });
        if let Some(question) = shared.node.lock(|node| node.take_confirmed_fault())
            && !it.store_confirmation(question, shared.node.lock(|node| node.calibration_blob()))
        {
            shared.node.lock(|node| node.set_fault(Fault::Store));
        }
        if let Some(permit) = it.store_permit() {
            it.store_pending_write(&mut shared.node, permit);
        }
        if shared.node.lock(|node| node.take_restart_request()) {
            defmt::info!("restart, as a CANopen master asks");
            // What waits would be lost.
            it.store_reference_status(&mut shared.node, StorePermit::before_restart());
            while it.store_pending_write(&mut shared.node, StorePermit::before_restart()) {}
            it.save_retained_state(&shared.node.lock(|node| node.retained_state()));
            // No more lines; those that wait go out meanwhile, for half a line is none that a client expects.
            shared.port.lock(Port::close);
            it.announce_restart();
            board::restart();
        }
        it.update_status_led(now, quality);
        #[cfg(feature = "faults")]
        crate::faults::inject_fault();
        self_test.run_step();
        let free_stack = self_test.scan_unused_stack_bytes();
        shared.node.lock(|node| {
            node.set_free_stack_bytes(free_stack);
            if self_test.is_damaged() {
                node.set_self_test_failed();
            }
        });
        // Reaching this line shows that no task above hangs; the turns of those below are counted.
        it.feed_watchdog(&turn, quality);
        if it.advance_log_timer() {
            it.save_retained_state(&shared.node.lock(|node| node.retained_state()));
            #[cfg(feature = "slots")]
            if let Some(slots) = it.slot_states() {
                shared.node.lock(|node| node.set_slot_states(slots));
            }
            shared.port.lock(|port| shared.node.lock(|node| log_live_values(node, port)));
        }
        rtic::pend(THERMOMETERS_INTERRUPT);
        rtic::pend(TRANSMIT_INTERRUPT);
    }

    /// Sends what a CANopen node has to say in addition to the offsets. Nothing of it is in the tick.
    #[task(binds = EXTI3, priority = 4, shared = [node, port, can_out])]
    fn service(cx: service::Context) {
        let _turn = liveness::begin_task(Task::Service);
        let mut shared = cx.shared;
        // It stays due, and the next tick asks again.
        if shared.can_out.lock(CanTx::is_busy) {
            return;
        }
        if let Some(frame) = shared.node.lock(|node| node.next_service_frame()) {
            shared.can_out.lock(|can| shared.port.lock(|port| send_frames(&[frame], can, port)));
        }
    }

    /// Lines to the serial line, as much as its DMA takes at once.
    #[task(binds = DMA2_STREAM7, priority = 6, shared = [serial_out, port])]
    fn transmit(cx: transmit::Context) {
        let _turn = liveness::begin_task(Task::Transmit);
        let now = NOW_MS.load(Ordering::Relaxed);
        let (mut out, mut port) = (cx.shared.serial_out, cx.shared.port);
        // What is queued behind this look raises the task again.
        let is_waiting = port.lock(|port| port.has_waiting_bytes());
        let fill = |piece: &mut [u8]| port.lock(|port| port.drain_into(piece));
        let sent = out.lock(|out| out.send(now, is_waiting, fill));
        if sent == TransmitState::MorePending {
            rtic::pend(POLL_INTERRUPT);
        }
    }

    /// The same where the DMA is dead: a few bytes are polled out, as long as nothing else waits.
    #[task(binds = EXTI1, priority = 1, shared = [serial_out, port])]
    fn poll(cx: poll::Context) {
        let _turn = liveness::begin_task(Task::Transmit);
        let (mut out, mut port) = (cx.shared.serial_out, cx.shared.port);
        let sent =
            out.lock(|out| out.transmit_polled(|piece| port.lock(|port| port.drain_into(piece))));
        if sent == TransmitState::MorePending {
            rtic::pend(POLL_INTERRUPT);
        }
    }

    /// One thermometer is read. Its bus is polled: no task waits below it.
    #[task(binds = EXTI2, priority = 1, local = [thermometers], shared = [temperatures])]
    fn thermometers(mut cx: thermometers::Context) {
        let _turn = liveness::begin_task(Task::Thermometers);
        if let Some(all) = cx.local.thermometers.poll_next_channel() {
            cx.shared.temperatures.lock(|temperatures| *temperatures = Some(all));
        }
    }

    #[idle(local = [idle])]
    fn idle(cx: idle::Context) -> ! {
        cx.local.idle.run()
    }

    /// Runs a tick of the node, whose time becomes that of the log.
    fn run_tick(node: &mut Node<'_>, elapsed_ms: u32, input: TickInput<'_>) -> OffsetFrames {
        let frames = node.tick(elapsed_ms, input);
        NOW_MS.store(node.now().0, Ordering::Relaxed);
        if node.is_service_frame_due() {
            rtic::pend(SERVICE_INTERRUPT);
        }
        frames
    }

    /// Frames to both wires.
    fn send_frames<const N: usize>(frames: &[Frame; N], can: &mut CanTx, port: &mut Port) {
        for frame in frames {
            can.send(frame);
        }
        // All or none, so that a full port never splits a pair; what is dropped is counted.
        if port.send_all(frames) {
            rtic::pend(TRANSMIT_INTERRUPT);
        }
    }
}
