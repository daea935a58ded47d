//! A bridge that says what a test wants, every millisecond, over TCP.

use std::{
    io::{ErrorKind, Read as _, Write as _},
    net::{TcpListener, TcpStream},
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicI32, Ordering},
    },
    thread::{self, JoinHandle},
    time::Duration,
};

use anyhow::Result;
use trueup_core::{
    cnc::{Output, Quality},
    units::Nanometres,
};
use trueup_link::{
    frames::{offset_xy, offset_z},
    slcan::encode_line,
};

/// Its offsets, and whether it lives.
#[derive(Debug, Default)]
struct Shared {
    offset_nm: [AtomicI32; 3],
    is_silent: AtomicBool,
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
        let listener = TcpListener::bind("127.0.0.1:0")?;
        listener.set_nonblocking(true)?;
        let port = listener.local_addr()?.port();
        let shared = Arc::new(Shared::default());
        let of_thread = shared.clone();
        let thread = Some(thread::spawn(move || serve(&listener, &of_thread)));
        Ok(Self { shared, port, thread })
    }

    /// Returns where the component finds it.
    pub fn address(&self) -> String {
        format!("tcp:127.0.0.1:{}", self.port)
    }

    /// Says these offsets from now on, in µm.
    pub fn say(&self, um: [f64; 3]) {
        for (place, um) in self.shared.offset_nm.iter().zip(um) {
            place.store((um * 1e3).round() as i32, Ordering::Relaxed);
        }
    }

    /// Says nothing, or something again.
    pub fn silence(&self, is_silent: bool) {
        self.shared.is_silent.store(is_silent, Ordering::Relaxed);
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

fn serve(listener: &TcpListener, shared: &Shared) {
    while !shared.stop.load(Ordering::Relaxed) {
        if let Ok((stream, _)) = listener.accept() {
            // The component opens the line again.
            speak(stream, shared).ok();
        }
        thread::sleep(Duration::from_millis(5));
    }
}

fn speak(mut stream: TcpStream, shared: &Shared) -> std::io::Result<()> {
    stream.set_nodelay(true)?;
    stream.set_nonblocking(true)?;
    let mut counter = 0_u8;
    let mut heard = [0; 4_096];
    while !shared.stop.load(Ordering::Relaxed) {
        match stream.read(&mut heard) {
            Ok(0) => return Ok(()),
            Err(error) if error.kind() != ErrorKind::WouldBlock => return Err(error),
            _ => {}
        }
        if !shared.is_silent.load(Ordering::Relaxed) {
            let offset =
                shared.offset_nm.each_ref().map(|nm| Nanometres(nm.load(Ordering::Relaxed)));
            let output =
                Output { offset: Some(offset), quality: Quality::Live, ..Output::default() };
            for frame in [offset_xy(&output, counter), offset_z(&output, counter)] {
                stream.write_all(encode_line(&frame).as_bytes())?;
            }
            counter = counter.wrapping_add(1);
        }
        thread::sleep(Duration::from_millis(1));
    }
    Ok(())
}
