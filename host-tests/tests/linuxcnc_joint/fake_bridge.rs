//! A bridge that says what a test wants, every millisecond, over TCP.

use std::{
    io::{self, ErrorKind, Read as _, Write as _},
    net::{TcpListener, TcpStream},
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicI32, AtomicU32, Ordering},
    },
    thread::{self, JoinHandle},
    time::Duration,
};

use anyhow::Result;
use trueup_core::{
    cnc::{OffsetQuality, Output},
    units::Nanometres,
};
use trueup_link::{
    frames::{encode_offset_xy, encode_offset_z},
    slcan::encode_line,
    status::{self, FrameRejectReason, Status, StatusItem},
};

/// Turns between two reports of its calibration.
const STATUS_TURNS: u32 = 100;

/// Its offsets, and whether it lives.
#[derive(Debug, Default)]
struct Shared {
    offset_nm: [AtomicI32; 3],
    /// CRC of its calibration; 0: it says nothing of it.
    calibration: AtomicU32,
    is_silent: AtomicBool,
    is_dead: AtomicBool,
    stop: AtomicBool,
}

/// A bridge that lives.
pub struct FakeBridge {
    shared: Arc<Shared>,
    port: u16,
    thread: Option<JoinHandle<()>>,
}

impl FakeBridge {
    /// Starts it without an offset.
    pub fn start() -> Result<Self> {
        let listener = listen(0)?;
        let port = listener.local_addr()?.port();
        let shared = Arc::new(Shared::default());
        let of_thread = shared.clone();
        let thread = Some(thread::spawn(move || serve(listener, port, &of_thread)));
        Ok(Self { shared, port, thread })
    }

    /// Returns where the component finds it.
    pub fn address(&self) -> String {
        format!("tcp:127.0.0.1:{}", self.port)
    }

    /// Says these offsets from now on, in µm.
    pub fn set_offset(&self, um: [f64; 3]) {
        for (place, um) in self.shared.offset_nm.iter().zip(um) {
            place.store((um * 1e3).round() as i32, Ordering::Relaxed);
        }
    }

    /// Says from now on that it runs on the calibration with this CRC.
    pub fn run_on(&self, crc: u32) {
        self.shared.calibration.store(crc, Ordering::Relaxed);
    }

    /// Says nothing, or something again.
    pub fn silence(&self, is_silent: bool) {
        self.shared.is_silent.store(is_silent, Ordering::Relaxed);
    }

    /// Kills it, so that its port refuses, or starts it again.
    pub fn kill(&self, is_dead: bool) {
        self.shared.is_dead.store(is_dead, Ordering::Relaxed);
    }
}

impl Drop for FakeBridge {
    fn drop(&mut self) {
        self.shared.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            // A panic of the thread has failed the test already.
            thread.join().ok();
        }
    }
}

fn listen(port: u16) -> io::Result<TcpListener> {
    let listener = TcpListener::bind(("127.0.0.1", port))?;
    listener.set_nonblocking(true)?;
    Ok(listener)
}

fn serve(first: TcpListener, port: u16, shared: &Shared) {
    let mut listener = Some(first);
    while !shared.stop.load(Ordering::Relaxed) {
        if shared.is_dead.load(Ordering::Relaxed) {
            listener = None;
        } else if listener.is_none() {
            // The kernel may hold the port for a moment.
            listener = listen(port).ok();
        }
        if let Some(Ok((stream, _))) = listener.as_ref().map(TcpListener::accept) {
            // The component opens the line again.
            speak(stream, shared).ok();
        }
        thread::sleep(Duration::from_millis(5));
    }
}

fn speak(mut stream: TcpStream, shared: &Shared) -> io::Result<()> {
    stream.set_nodelay(true)?;
    stream.set_nonblocking(true)?;
    let (mut counter, mut turns, mut statuses) = (0_u8, 0_u32, 0_u8);
    let mut received = [0; 4_096];
    while !shared.stop.load(Ordering::Relaxed) && !shared.is_dead.load(Ordering::Relaxed) {
        match stream.read(&mut received) {
            Ok(0) => return Ok(()),
            Err(error) if error.kind() != ErrorKind::WouldBlock => return Err(error),
            _ => {}
        }
        if !shared.is_silent.load(Ordering::Relaxed) {
            let offset =
                shared.offset_nm.each_ref().map(|nm| Nanometres(nm.load(Ordering::Relaxed)));
            let output =
                Output { offset: Some(offset), quality: OffsetQuality::Live, ..Output::default() };
            for frame in [encode_offset_xy(&output, counter), encode_offset_z(&output, counter)] {
                stream.write_all(encode_line(&frame).as_bytes())?;
            }
            counter = counter.wrapping_add(1);
            let calibration = shared.calibration.load(Ordering::Relaxed);
            if calibration != 0 && turns.is_multiple_of(STATUS_TURNS) {
                let item = StatusItem::Calibration(calibration);
                let reported = status::encode(
                    &Status { last_refused: FrameRejectReason::None, item },
                    statuses,
                );
                stream.write_all(encode_line(&reported).as_bytes())?;
                statuses = statuses.wrapping_add(1);
            }
            turns = turns.wrapping_add(1);
        }
        thread::sleep(Duration::from_millis(1));
    }
    Ok(())
}
