//! A running virtual bridge for any client: its serial line on a TCP port, fed by a run file or by
//! a plant.
//!
//! The port is this process's own, with QEMU's line behind it, so that a port in use is a clear
//! error, clients may come and go, and the first `O` can be seen: with it the replay starts.

use std::{
    io::{self, Read as _, Write as _},
    net::{TcpListener, TcpStream},
    os::unix::net::UnixStream,
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
    thread,
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result, bail};
use rustix::{
    net::sockopt::{set_socket_recv_buffer_size, set_socket_send_buffer_size},
    process::{Pid, Signal, kill_process},
};
use trueup_core::{cnc::Output, units::NANOMETRES_PER_MICROMETRE};
use trueup_link::{receiver::OffsetReceiver, slcan::CR};
use trueup_pipe::Block;

mod opening_handshake;

use self::opening_handshake::{OpeningHandshake, is_response_end};
use crate::{
    analogue_front_end::AnalogueFrontEnd,
    board::{MAX_BATCH_BLOCKS, SERIAL_BUFFER_BYTES, VirtualBoard},
    cnc_emulator::{CncEmulator, ReceivedFrames},
    gauge::SimulatedGauge,
    operator_controls::OperatorControls,
    plant::{BoardResponse, Plant},
    replay::{MachineSnapshot, RunReplay},
};

/// The source of the machine's samples and time.
pub enum SampleSource {
    /// A run file, at a multiple of real time, or as fast as it goes.
    Run {
        /// The run file that is played.
        replay: RunReplay,
        /// Milliseconds of the board in a millisecond of the clock; `None`: no pacing.
        speed: Option<f64>,
    },
    /// A plant, in lock-step.
    Plant(Plant),
}

/// The operator's side of the virtual machine, next to the bridge.
pub struct OperatorStation {
    /// The hand at the CNC.
    pub hand: OperatorControls,
    /// The gauge at the tool.
    pub gauge: SimulatedGauge,
}

/// Blocks handed over at once while time is not paced.
const UNPACED_BATCH_BLOCKS: u32 = 20;
/// Bytes that may wait for a client, a third of a second: offsets in a queue grow old. When it is
/// full the board's time stands still until he reads.
const CLIENT_QUEUE_BYTES: usize = 16 * 1024;
/// The board's clock may fall behind by this much before it slips.
const MAX_BACKLOG_MS: f64 = 200.0;
/// Time for which the first row is held before the run begins again, in s of the board: the bridge takes the offset of a hot
/// machine back at its slew limit, and a gauge that is read before shows both.
const COLD_START_HOLD_S: f64 = 10.0;

/// Serves until `stop` is set or the source ends.
///
/// # Errors
/// QEMU ends, or the source is broken.
pub fn serve(
    image: &std::path::Path,
    calibration: &[u8],
    front_end: AnalogueFrontEnd,
    listener: TcpListener,
    source: SampleSource,
    at_machine: &OperatorStation,
    stop: Arc<AtomicBool>,
) -> Result<()> {
    let mut board = VirtualBoard::boot(image, calibration)?;
    trueup_output::write_diagnostic(format_args!(
        "the bridge is up in QEMU (process {})",
        board.qemu_mut().process_id()
    ));
    kill_qemu_after_stop(stop.clone(), board.qemu_mut().process_id());
    let result = run_board(&mut board, front_end, listener, source, at_machine, &stop);
    // Whatever broke because it was stopped is not an error.
    if stop.load(Ordering::Relaxed) { Ok(()) } else { result }
}

/// Ends QEMU if serving has not ended a second after `stop`: a client that does not read stops QEMU, and with it
/// every thread that waits for the board.
fn kill_qemu_after_stop(stop: Arc<AtomicBool>, qemu: u32) {
    const KILL_GRACE_PERIOD: Duration = Duration::from_secs(1);
    thread::spawn(move || {
        while !stop.load(Ordering::Relaxed) {
            thread::sleep(Duration::from_millis(50));
        }
        thread::sleep(KILL_GRACE_PERIOD);
        if let Some(pid) = i32::try_from(qemu).ok().and_then(Pid::from_raw) {
            // It may have ended in the meantime.
            kill_process(pid, Signal::KILL).ok();
        }
    });
}

/// Returns whether serving has to stop, and prints what the board has logged.
///
/// # Errors
/// QEMU has ended.
fn print_log_and_poll_stop(board: &mut VirtualBoard, stop: &AtomicBool) -> Result<bool> {
    print_board_log(board);
    board.qemu_mut().check_running()?;
    Ok(stop.load(Ordering::Relaxed))
}

/// Lets the board live through what the source has.
fn run_board(
    board: &mut VirtualBoard,
    mut front_end: AnalogueFrontEnd,
    listener: TcpListener,
    source: SampleSource,
    OperatorStation { hand, gauge }: &OperatorStation,
    stop: &AtomicBool,
) -> Result<()> {
    let opening = Arc::new(OpeningHandshake::default());
    let received = Arc::new(ReceivedFrames::default());
    serve_clients(listener, board.try_clone_serial()?, opening.clone(), received.clone())?;
    let mut stand_in = CncEmulator::default();
    let mut live = |board: &mut VirtualBoard,
                    situation: &dyn Fn(f64) -> MachineSnapshot,
                    count: u32|
     -> Result<Option<Output>> {
        let mut offsets = OffsetReceiver::new();
        let mut last = None;
        let mut left = count;
        while left > 0 {
            let batch = left.min(MAX_BATCH_BLOCKS);
            left -= batch;
            let blocks: Vec<Block> = (0..batch)
                .map(|_| {
                    let now = MachineSnapshot {
                        control: hand.next_control(),
                        ..situation(front_end.time_s())
                    };
                    Block {
                        codes: front_end.convert_block(|_| now.sensor_volts),
                        speed: now.speed,
                        service_switch: hand.is_service_switch_closed(),
                        temperatures: now.temperatures,
                        frames: stand_in.next_frames(&now, &received),
                    }
                })
                .collect();
            for (_, frame) in board.step(&blocks)? {
                last = offsets.accept(&frame).ok().flatten().or(last);
            }
        }
        print_board_log(board);
        Ok(last)
    };
    match source {
        SampleSource::Run { replay, speed } => {
            trueup_output::write_diagnostic("the replay starts when a client opens the channel");
            while !opening.is_complete() {
                if print_log_and_poll_stop(board, stop)? {
                    return Ok(());
                }
                thread::sleep(Duration::from_millis(5));
            }
            let mut pace = Pacer::new(speed);
            let mut lived_s = 0.0;
            let mut began_s = 0.0;
            let mut is_cold = false;
            while !stop.load(Ordering::Relaxed) {
                match pace.take_due_ms() {
                    0 => thread::sleep(Duration::from_micros(300)),
                    mut due => {
                        // In parts, so that the gauge keeps up with what a client has received.
                        while due > 0 {
                            let part = due.min(UNPACED_BATCH_BLOCKS);
                            due -= part;
                            if hand.take_restart_request() {
                                (began_s, is_cold) = (lived_s + COLD_START_HOLD_S, true);
                            }
                            let output =
                                live(board, &|time| replay.snapshot_at(time - began_s), part)?;
                            gauge.update(replay.growth_um(lived_s - began_s), output.as_ref());
                            lived_s += f64::from(part) / 1_000.0;
                            if is_cold && lived_s >= began_s {
                                is_cold = false;
                                trueup_output::write_diagnostic("the run begins again");
                            }
                        }
                    }
                }
            }
        }
        SampleSource::Plant(mut plant) => {
            while let Some((situation, ms)) =
                plant.next_step(|| print_log_and_poll_stop(board, stop))?
            {
                if let Some(output) = live(board, &|_| situation, ms)? {
                    plant.last_answer = BoardResponse::from(&output);
                }
                plant.send_response()?;
                if print_log_and_poll_stop(board, stop)? {
                    break;
                }
            }
            trueup_output::write_diagnostic("the plant has closed its line");
        }
    }
    Ok(())
}

impl From<&Output> for BoardResponse {
    fn from(output: &Output) -> Self {
        let um = |nm: i32| f64::from(nm) / f64::from(NANOMETRES_PER_MICROMETRE);
        Self {
            offset_um: match output.offset {
                None => [None; 3],
                Some(offset) => offset.map(|axis| Some(um(axis.0))),
            },
            quality: output.quality as u8,
        }
    }
}

/// How much of the board's time is due.
struct Pacer {
    speed: Option<f64>,
    last: Instant,
    owed_ms: f64,
    slipped: bool,
}

impl Pacer {
    fn new(speed: Option<f64>) -> Self {
        Self { speed, last: Instant::now(), owed_ms: 0.0, slipped: false }
    }

    /// Milliseconds of the board that are due now.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0…backlog")]
    fn take_due_ms(&mut self) -> u32 {
        let Some(speed) = self.speed else { return UNPACED_BATCH_BLOCKS };
        let now = Instant::now();
        self.owed_ms += now.duration_since(self.last).as_secs_f64() * 1_000.0 * speed;
        self.last = now;
        let largest = MAX_BACKLOG_MS * speed.max(1.0);
        if self.owed_ms > largest {
            if !self.slipped {
                trueup_output::write_diagnostic(format_args!(
                    "this machine is too slow for {speed} times real time: time slips"
                ));
                self.slipped = true;
            }
            self.owed_ms = largest;
        }
        let due = self.owed_ms.floor();
        self.owed_ms -= due;
        due as u32
    }
}

/// Shows what the board has logged.
fn print_board_log(board: &VirtualBoard) {
    for line in board.take_log() {
        trueup_output::write_diagnostic(format_args!("board: {line}"));
    }
}

/// A client of the port.
struct PortClient {
    stream: TcpStream,
    /// Has got nothing yet: what the board says first may be the end of a line that began for
    /// another client. Some programs take that for a frame, so it is not sent.
    is_new: bool,
}

/// Joins the clients of a port, one at a time, to the board's line.
fn serve_clients(
    listener: TcpListener,
    line: UnixStream,
    opening: Arc<OpeningHandshake>,
    received: Arc<ReceivedFrames>,
) -> Result<()> {
    let client: Arc<Mutex<Option<PortClient>>> = Arc::default();
    let mut from_board = line.try_clone()?;
    let to_client = client.clone();
    let answered = opening.clone();
    thread::spawn(move || {
        let mut bytes = [0; 4096];
        let mut in_line = false;
        while let Ok(length @ 1..) = from_board.read(&mut bytes) {
            let mut reported = &bytes[..length];
            answered.count_responses(reported);
            let stream = lock(&to_client).as_mut().and_then(|client| {
                if client.is_new && in_line {
                    let end = reported.iter().position(|&byte| is_response_end(byte));
                    reported = end.map_or(&[], |end| &reported[end + 1..]);
                    client.is_new = end.is_none();
                } else {
                    client.is_new = false;
                }
                client.stream.try_clone().ok()
            });
            in_line = !is_response_end(bytes[length - 1]);
            // With no client, or one that has just gone, the bytes have no receiver.
            if let Some(mut stream) = stream {
                stream.write_all(reported).ok();
            }
        }
    });
    thread::spawn(move || {
        for stream in listener.incoming().flatten() {
            if let Err(error) = serve_client(stream, &client, &line, &opening, &received) {
                trueup_output::write_diagnostic(format_args!("a client is gone: {error}"));
            }
            lock(&client).take();
        }
    });
    Ok(())
}

fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// One client, until it goes. The next one waits in the port's queue.
fn serve_client(
    mut stream: TcpStream,
    client: &Mutex<Option<PortClient>>,
    mut line: &UnixStream,
    opening: &OpeningHandshake,
    received: &ReceivedFrames,
) -> io::Result<()> {
    stream.set_nodelay(true)?;
    set_socket_send_buffer_size(&stream, CLIENT_QUEUE_BYTES)?;
    let peer = stream.peer_addr()?;
    trueup_output::write_diagnostic(format_args!("client {peer} is connected"));
    *lock(client) = Some(PortClient { stream: stream.try_clone()?, is_new: true });
    let mut bytes = [0; 4096];
    let mut command: Vec<u8> = Vec::new();
    loop {
        let length = stream.read(&mut bytes)?;
        if length == 0 {
            trueup_output::write_diagnostic(format_args!(
                "client {peer} has closed its connection"
            ));
            return Ok(());
        }
        for &byte in &bytes[..length] {
            if byte != CR {
                command.push(byte);
                command.truncate(32);
                continue;
            }
            let reported = std::mem::take(&mut command);
            opening.count_line(reported.trim_ascii_start() == b"O");
            received.record_line(reported.trim_ascii_start());
        }
        line.write_all(&bytes[..length])?;
    }
}

/// Opens the port of `tcp:HOST:PORT`. Little waits on the way from a client to a board that is slow to
/// take it, as on a serial line: the newest position is worth more than all that came before.
///
/// # Errors
/// It is not such an address, or the port is in use.
pub fn listen(address: &str) -> Result<TcpListener> {
    let address = parse_tcp_address(address)?;
    let listener = TcpListener::bind(address).with_context(|| {
        format!("cannot listen at tcp:{address}; is another program, or another bridge, using it?")
    })?;
    set_socket_recv_buffer_size(&listener, SERIAL_BUFFER_BYTES)?;
    Ok(listener)
}

/// Returns the `HOST:PORT` of `tcp:HOST:PORT`.
///
/// # Errors
/// It has another form.
pub(crate) fn parse_tcp_address(address: &str) -> Result<&str> {
    match address.strip_prefix("tcp:") {
        Some(rest) if rest.contains(':') => Ok(rest),
        _ => bail!("\"{address}\" is not an address of the form tcp:HOST:PORT"),
    }
}
