//! The real firmware on the virtual board, in real time, behind a line that can be cut and damaged.
//!
//! ```text
//!  growth ─► front end ─► VirtualBoard ─► serial ─► (damage) ─► TCP ─► the component
//! ```
#![allow(clippy::print_stderr, reason = "a test prints its figures")]

use std::{
    io::{ErrorKind, Read, Write},
    net::{Shutdown, TcpListener, TcpStream},
    os::unix::net::UnixStream,
    path::Path,
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result};
use rand::{Rng as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use trueup_emulator::{
    analogue_front_end::AnalogueFrontEnd, board::VirtualBoard, firmware_images, serve,
};
use trueup_link::slcan::CR;
use trueup_machine::{Machine, compile};
use trueup_pipe::Block;

/// The board's clock may fall behind by this much before it slips, on a busy computer.
const LARGEST_BACKLOG_MS: u32 = 100;
/// Blocks handed over at once: their frames are as late as the first of them.
const MAX_BATCH: u32 = 10;
/// Where the sensor stands at no growth, and its slope, as in the machine file.
const ZERO_COUNTS: f64 = 5_048.0;
const UM_PER_COUNT: f64 = 500.0 / 32_768.0;
const VOLTS_PER_COUNT: f64 = 10.0 / 32_768.0;

/// Damage of lines on their way.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Damage {
    /// The share of lines with a wrong character.
    pub altered: f64,
    /// The share of lines that are lost.
    pub dropped: f64,
    /// The share of lines that change places with the next.
    pub swapped: f64,
    /// The share of lines that come twice.
    pub doubled: f64,
}

#[derive(Debug)]
struct Shared {
    growth_um: AtomicU64,
    plugged: AtomicBool,
    stop: AtomicBool,
    restart: AtomicBool,
    damage: Mutex<Damage>,
    serial: Mutex<Option<UnixStream>>,
    client: Mutex<Option<TcpStream>>,
}

/// A bridge that lives.
pub struct RigBridge {
    shared: Arc<Shared>,
    port: u16,
    threads: Vec<JoinHandle<Result<()>>>,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl RigBridge {
    /// Boots the board for this machine; its line is plugged in.
    pub fn start(machine: &Machine) -> Result<Self> {
        let image = firmware_images::build_virtual_board_image()?;
        let calibration = compile(machine)?.blob().to_vec();
        let divider = machine.inputs.as_ref().and_then(|inputs| inputs.sensor.as_ref());
        let divider = divider.context("a machine with a sensor")?.divider;
        let shared = Arc::new(Shared {
            growth_um: AtomicU64::new(0.0_f64.to_bits()),
            plugged: AtomicBool::new(true),
            stop: AtomicBool::new(false),
            restart: AtomicBool::new(false),
            damage: Mutex::default(),
            serial: Mutex::default(),
            client: Mutex::default(),
        });
        let listener = serve::listen("tcp:127.0.0.1:0")?;
        let port = listener.local_addr()?.port();
        let (living, serving) = (shared.clone(), shared.clone());
        let threads = vec![
            thread::spawn(move || live(&image, &calibration, divider, &living)),
            thread::spawn(move || serve(listener, &serving)),
        ];
        let bridge = Self { shared, port, threads };
        while lock(&bridge.shared.serial).is_none() && !bridge.threads[0].is_finished() {
            thread::sleep(Duration::from_millis(5));
        }
        Ok(bridge)
    }

    /// Where the component finds it.
    pub fn address(&self) -> String {
        format!("tcp:127.0.0.1:{}", self.port)
    }

    /// Lets the spindle grow to this, at once.
    pub fn grow_to(&self, um: f64) {
        self.shared.growth_um.store(um.to_bits(), Ordering::Relaxed);
    }

    /// Pulls the plug or puts it in again.
    pub fn plug(&self, in_it: bool) {
        self.shared.plugged.store(in_it, Ordering::Relaxed);
        if !in_it && let Some(client) = lock(&self.shared.client).take() {
            client.shutdown(Shutdown::Both).ok();
        }
    }

    /// From now on lines are damaged so.
    pub fn damage(&self, damage: Damage) {
        *lock(&self.shared.damage) = damage;
    }

    /// Cuts the board's power and gives it back; waits until it is up.
    pub fn restart(&self) {
        self.shared.restart.store(true, Ordering::Relaxed);
        while self.shared.restart.load(Ordering::Relaxed) && !self.threads[0].is_finished() {
            thread::sleep(Duration::from_millis(5));
        }
    }
}

impl Drop for RigBridge {
    fn drop(&mut self) {
        self.shared.stop.store(true, Ordering::Relaxed);
        self.plug(false);
        for thread in self.threads.drain(..) {
            match thread.join() {
                Ok(Ok(())) => {}
                Ok(Err(error)) => eprintln!("the bridge: {error:#}"),
                Err(_) => eprintln!("the bridge's thread has panicked"),
            }
        }
    }
}

/// The board's time, which is the wall's. QEMU ends with the thread that has started it, so that is
/// this one.
fn live(image: &Path, calibration: &[u8], divider: f64, shared: &Arc<Shared>) -> Result<()> {
    let mut front_end = AnalogueFrontEnd::new(divider, 11);
    let mut board = VirtualBoard::boot(image, calibration)?;
    let mut listener = listen_to(board.try_clone_serial()?, shared);
    *lock(&shared.serial) = Some(board.try_clone_serial()?);
    let mut start = Instant::now();
    let mut lived = 0_u32;
    while !shared.stop.load(Ordering::Relaxed) {
        if shared.restart.load(Ordering::Relaxed) {
            board = board.restart(image, calibration)?;
            *lock(&shared.serial) = Some(board.try_clone_serial()?);
            listener = listen_to(board.try_clone_serial()?, shared);
            (start, lived) = (Instant::now(), 0);
            shared.restart.store(false, Ordering::Relaxed);
        }
        let now = u32::try_from(start.elapsed().as_millis())?;
        let due = now - lived;
        if due == 0 {
            thread::sleep(Duration::from_micros(300));
            continue;
        }
        if due > LARGEST_BACKLOG_MS {
            lived = now - LARGEST_BACKLOG_MS;
        }
        let batch = due.min(MAX_BATCH);
        let growth_um = f64::from_bits(shared.growth_um.load(Ordering::Relaxed));
        let volts = (ZERO_COUNTS + growth_um / UM_PER_COUNT) * VOLTS_PER_COUNT;
        let blocks: Vec<Block> = (0..batch)
            .map(|_| Block { codes: front_end.convert_block(|_| volts), ..Block::default() })
            .collect();
        board.step(&blocks)?;
        lived += batch;
    }
    drop(board);
    listener.join().ok();
    Ok(())
}

/// Passes the board's bytes to the client, if there is one. QEMU stops if they are not read.
fn listen_to(mut serial: UnixStream, shared: &Arc<Shared>) -> JoinHandle<()> {
    let shared = shared.clone();
    thread::spawn(move || {
        let mut noise = Noise::new(1);
        let mut bytes = [0; 4096];
        while let Ok(length @ 1..) = serial.read(&mut bytes) {
            let frames = noise.pass(&bytes[..length], *lock(&shared.damage));
            let client = lock(&shared.client).as_ref().and_then(|client| client.try_clone().ok());
            if let Some(mut client) = client {
                client.write_all(&frames).ok();
            }
        }
    })
}

/// Takes one client after the other; while the plug is out, none.
fn serve(listener: TcpListener, shared: &Arc<Shared>) -> Result<()> {
    listener.set_nonblocking(true)?;
    let mut noise = Noise::new(2);
    while !shared.stop.load(Ordering::Relaxed) {
        let mut stream = match listener.accept() {
            Ok((stream, _)) => stream,
            Err(error) if error.kind() == ErrorKind::WouldBlock => {
                thread::sleep(Duration::from_millis(5));
                continue;
            }
            Err(error) => return Err(error.into()),
        };
        if !shared.plugged.load(Ordering::Relaxed) {
            continue;
        }
        stream.set_nonblocking(false)?;
        stream.set_nodelay(true)?;
        stream.set_write_timeout(Some(Duration::from_secs(1)))?;
        *lock(&shared.client) = Some(stream.try_clone()?);
        let mut bytes = [0; 4096];
        while let Ok(length @ 1..) = stream.read(&mut bytes) {
            let frames = noise.pass(&bytes[..length], *lock(&shared.damage));
            // Between two lives of the board there is nobody who takes it.
            if let Some(serial) = lock(&shared.serial).as_mut() {
                serial.write_all(&frames).ok();
            }
        }
        lock(&shared.client).take();
    }
    Ok(())
}

/// A bad line, which damages SLCAN lines.
struct Noise {
    random: ChaCha8Rng,
    line: Vec<u8>,
    late: Option<Vec<u8>>,
}

impl Noise {
    fn new(seed: u64) -> Self {
        Self { random: ChaCha8Rng::seed_from_u64(seed), line: Vec::new(), late: None }
    }

    fn pass(&mut self, bytes: &[u8], damage: Damage) -> Vec<u8> {
        let mut passed = Vec::with_capacity(bytes.len());
        for &byte in bytes {
            self.line.push(byte);
            if byte == CR {
                let line = std::mem::take(&mut self.line);
                // Answers and commands are left alone: what is tried is frames.
                if line.first() == Some(&b't') {
                    self.damage(line, damage, &mut passed);
                } else {
                    passed.extend(line);
                }
            }
        }
        if damage == Damage::default() {
            passed.extend(self.late.take().unwrap_or_default());
            passed.append(&mut self.line);
        }
        passed
    }

    fn damage(&mut self, mut line: Vec<u8>, damage: Damage, passed: &mut Vec<u8>) {
        let mut happens = |share: f64| share > 0.0 && self.random.random_bool(share);
        let (altered, dropped) = (happens(damage.altered), happens(damage.dropped));
        let (swapped, doubled) = (happens(damage.swapped), happens(damage.doubled));
        if dropped {
            return;
        }
        if altered {
            // Another hexadecimal digit: a frame in form, and wrong.
            let at = self.random.random_range(5..line.len() - 1);
            line[at] = if line[at] == b'7' { b'4' } else { b'7' };
        }
        if swapped && self.late.is_none() {
            self.late = Some(line);
            return;
        }
        passed.extend(&line);
        if doubled {
            passed.extend(&line);
        }
        passed.extend(self.late.take().unwrap_or_default());
    }
}
