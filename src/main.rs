//! The trueup bridge: a spindle's displacement sensor in, offsets for the CNC out.
//!
//! ```text
//!  converter ─► sample ──────────────┬─► OffsetXY, OffsetZ, heartbeat ─► CAN
//!                 ▲    frames, E2E   └─► SLCAN lines ─► transmit ──────► serial line
//!                 │ Control, Spindle
//!  CAN ─► can_receive ─► node ◄─ listen ◄─ serial_receive ◄──────────── serial line
//!  10 ms ─► supervise: converter restarted, watchdog fed, lamp, log
//! ```
//!
//! | task | trigger | priority | deadline | reads | writes |
//! |---|---|---|---|---|---|
//! | `serial_receive` | USART1, a byte | 5 | 10.8 µs, the next byte | USART1 | byte queue |
//! | `sample` | DMA2 stream 0, 20 codes | 4 | 1 ms, the next block | samples | node, port, CAN |
//! | `can_receive` | CAN1, a frame | 3 | 2 frames (94 µs) in a FIFO of 3 | CAN | node |
//! | `listen` | bytes in the queue | 3 | 256 bytes (2.8 ms) | byte queue | port, node |
//! | `supervise` | `SysTick`, 10 ms | 2 | 100 ms, the watchdog | node | samples, watchdog, lamp |
//! | `transmit` | lines in the port | 1 | 5 ms of frames in the port | port | USART1 |
//! | `idle` | nothing else to do | 0 | | | |
//!
//! The tasks are the same on every board; what a board is, is behind [`board`]. What the bridge
//! computes is in `trueup-core`, what it says in `trueup-link`, both tested on the host.
#![no_std]
#![no_main]
#![deny(unsafe_code)]

#[allow(unsafe_code, reason = "registers and linker sections; each use says why it is sound")]
mod board;

use core::sync::atomic::{AtomicU32, Ordering};

/// The sample clock, for the log.
static NOW_MS: AtomicU32 = AtomicU32::new(0);
defmt::timestamp!("{=u32} ms", NOW_MS.load(Ordering::Relaxed));

#[rtic::app(device = stm32f4xx_hal::pac, peripherals = true)]
mod app {
    use super::{NOW_MS, Ordering};
    use crate::board::{self, CanIn, CanOut, Idle, Lamp, Samples, SerialIn, SerialOut, Watchdog};
    use heapless::spsc::{Consumer, Producer, Queue};
    use micromath::F32Ext as _;
    use stm32f4xx_hal::pac::Interrupt;
    use trueup_core::{bridge::Input, cnc::Quality};
    use trueup_link::{
        node::{Frames, Node},
        slcan::Port,
    };

    /// The two tasks that other tasks start have an interrupt that no pin uses. A pended interrupt
    /// cannot be lost: raised while its task runs, it makes it run again.
    const LISTEN: Interrupt = Interrupt::EXTI0;
    const TRANSMIT: Interrupt = Interrupt::EXTI1;
    /// Bytes between the interrupt that takes them and the task that reads them.
    const QUEUE: usize = 256;
    /// What `N` answers on the serial line.
    const SERIAL_NUMBER: u16 = 1;
    const SUPERVISION_MS: u32 = 10;
    const LOG_PERIOD_MS: u32 = 1_000;

    #[shared]
    struct Shared {
        node: Node<'static>,
        port: Port,
        can_out: CanOut,
        samples: Samples,
        /// When `transmit` last had nothing left to send.
        drained_ms: u32,
    }

    #[local]
    struct Local {
        serial_in: SerialIn,
        serial_out: SerialOut,
        can_in: CanIn,
        to_listen: Producer<'static, u8>,
        from_serial: Consumer<'static, u8>,
        supervision: Supervision,
        idle: Idle,
    }

    /// What `supervise` remembers.
    pub struct Supervision {
        watchdog: Watchdog,
        lamp: Lamp,
        blocks: u32,
        silent: bool,
        until_log_ms: u32,
    }

    #[init(local = [queue: Queue<u8, QUEUE> = Queue::new()])]
    fn init(cx: init::Context) -> (Shared, Local) {
        let parts = board::start(cx.core, cx.device);
        let faults = parts.faults;
        if let Err(error) = &parts.calibration {
            defmt::error!("calibration refused: {}", defmt::Display2Format(error));
        }
        let (to_listen, from_serial) = cx.local.queue.split();
        defmt::info!("trueup bridge {} is up", env!("CARGO_PKG_VERSION"));
        let shared = Shared {
            node: Node::new(parts.calibration.ok(), faults.crystal || faults.pll || faults.can),
            port: Port::new(SERIAL_NUMBER),
            can_out: parts.can_out,
            samples: parts.samples,
            drained_ms: 0,
        };
        let supervision = Supervision {
            watchdog: parts.watchdog,
            lamp: parts.lamp,
            blocks: 0,
            silent: false,
            until_log_ms: 0,
        };
        let local = Local {
            serial_in: parts.serial_in,
            serial_out: parts.serial_out,
            can_in: parts.can_in,
            to_listen,
            from_serial,
            supervision,
            idle: parts.idle,
        };
        (shared, local)
    }

    /// A millisecond of codes becomes an offset.
    #[task(binds = DMA2_STREAM0, priority = 4, shared = [node, port, can_out, samples])]
    fn sample(cx: sample::Context) {
        let sample::SharedResources { mut node, mut port, mut can_out, mut samples, .. } =
            cx.shared;
        let Some(block) = samples.lock(Samples::take) else { return };
        let input = Input {
            codes: Some(&block.codes),
            speed: block.speed,
            temperatures: block.temperatures.as_ref(),
        };
        let frames = node.lock(|node| {
            let frames = node.tick(1, input);
            NOW_MS.store(node.now().0, Ordering::Relaxed);
            frames
        });
        can_out.lock(|can| port.lock(|port| send(&frames, can, port)));
    }

    /// A frame from the bus.
    #[task(binds = CAN1_RX0, priority = 3, local = [can_in], shared = [node])]
    fn can_receive(mut cx: can_receive::Context) {
        while let Some(frame) = cx.local.can_in.receive() {
            // What is refused is counted there and shows in the log.
            cx.shared.node.lock(|node| node.hear(&frame)).ok();
        }
    }

    /// A byte from the serial line: saved before the next one comes, understood later.
    #[task(binds = USART1, priority = 5, local = [serial_in, to_listen])]
    fn serial_receive(cx: serial_receive::Context) {
        while let Some(byte) = cx.local.serial_in.read() {
            // A full queue loses the byte; the line it belongs to is then refused and counted.
            cx.local.to_listen.enqueue(byte).ok();
        }
        rtic::pend(LISTEN);
    }

    /// Bytes become lines, lines become frames.
    #[task(binds = EXTI0, priority = 3, local = [from_serial], shared = [port, node])]
    fn listen(mut cx: listen::Context) {
        while let Some(byte) = cx.local.from_serial.dequeue() {
            if let Some(frame) = cx.shared.port.lock(|port| port.receive(byte)) {
                cx.shared.node.lock(|node| node.hear(&frame)).ok();
            }
        }
        rtic::pend(TRANSMIT);
    }

    /// Every 10 ms: is all well? On a board whose converter is dead this is what keeps the CNC
    /// informed.
    #[task(binds = SysTick, priority = 2, local = [supervision],
           shared = [node, port, can_out, samples, drained_ms])]
    fn supervise(cx: supervise::Context) {
        let supervise::SharedResources {
            mut node,
            mut port,
            mut can_out,
            mut samples,
            mut drained_ms,
            ..
        } = cx.shared;
        let Supervision { watchdog, lamp, blocks, silent, until_log_ms } = cx.local.supervision;

        let blocks_now = node.lock(|node| node.blocks());
        if blocks_now == *blocks {
            if !*silent {
                defmt::error!("no samples: the converter is restarted until they come");
            }
            *silent = true;
            samples.lock(Samples::restart);
            let frames = node.lock(|node| {
                let frames = node.tick(SUPERVISION_MS, Input::default());
                NOW_MS.store(node.now().0, Ordering::Relaxed);
                frames
            });
            can_out.lock(|can| port.lock(|port| send(&frames, can, port)));
        } else {
            if *silent {
                defmt::warn!("samples come again");
            }
            *silent = false;
        }
        *blocks = blocks_now;

        let (now, quality) = node.lock(|node| (node.now().0, node.last().quality));
        lamp.set(match quality {
            Quality::Live => true,
            Quality::Fault => now % 200 < 100,
            _ => now % 1_000 < 500,
        });
        // Reaching this line shows that no task above hangs; the port shows that `transmit` does
        // not.
        if now.wrapping_sub(drained_ms.lock(|drained| *drained)) < LOG_PERIOD_MS {
            watchdog.feed();
        }
        *until_log_ms = until_log_ms.saturating_sub(SUPERVISION_MS);
        if *until_log_ms == 0 {
            *until_log_ms = LOG_PERIOD_MS;
            port.lock(|port| node.lock(|node| log(node, port)));
        }
        rtic::pend(TRANSMIT);
    }

    /// Lines to the serial line, byte by byte. It polls, because the emulator has neither the
    /// interrupt nor the DMA for it, and because no task waits below it.
    #[task(binds = EXTI1, priority = 1, local = [serial_out], shared = [port, node, drained_ms])]
    fn transmit(mut cx: transmit::Context) {
        while let Some(byte) = cx.shared.port.lock(Port::pop) {
            cx.local.serial_out.write(byte);
        }
        let now = cx.shared.node.lock(|node| node.now().0);
        cx.shared.drained_ms.lock(|drained| *drained = now);
    }

    #[idle(local = [idle])]
    fn idle(cx: idle::Context) -> ! {
        cx.local.idle.run()
    }

    /// Frames to both wires.
    fn send(frames: &Frames, can: &mut CanOut, port: &mut Port) {
        for frame in frames {
            can.send(frame);
        }
        // All or none, so that a full port never splits a pair; what is dropped is counted.
        if port.send_all(frames) {
            rtic::pend(TRANSMIT);
        }
    }

    /// The live values, once a second, and what was refused since the start.
    fn log(node: &mut Node<'_>, port: &Port) {
        let noise = node.take_noise();
        let rms = (noise.squares as f32 / (6.0 * noise.count.max(1) as f32)).sqrt();
        let last = node.last();
        defmt::info!(
            "quality {=u8}, z {=i32} nm, flags {=u8:#010b}, noise {=u32} thousandths of a code",
            last.quality as u8,
            last.offset.map_or(0, |offset| offset[2].0),
            last.flags.0,
            (rms * 1_000.0) as u32,
        );
        let (frames, lines) = (node.receiver().counters(), port.counters());
        let refused = [frames.crc_errors, frames.sequence_errors, lines.malformed, lines.dropped];
        if refused != [0; 4] {
            defmt::warn!("refused: CRC, sequence, lines; lines dropped: {}", refused);
        }
    }
}
