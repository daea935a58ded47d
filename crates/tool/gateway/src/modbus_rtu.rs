//! Modbus RTU on a serial port of this computer: for a PLC that has no network.
//!
//! A driver hands bytes on in heaps: the silences within a frame are not seen here, and where a frame
//! ends is recognised by a silence that is longer than any of a driver's own.

use std::{
    io::{self, Write as _},
    time::{Duration, Instant},
};

use serialport::{DataBits, Parity, SerialPort, StopBits};
use trueup_client::duplex_stream::{DuplexStream, is_timeout};
use trueup_modbus::{
    rtu::{FrameTiming, Slave},
    server::ResponseBuffer,
};

use crate::{
    backoff::Backoff, bridge::SharedHub, gateway_status::SharedPlcStatus, modbus_tcp::HubView,
};

/// How long a read waits: the silence is looked at so often.
const READ_TIMEOUT: Duration = Duration::from_millis(2);
/// A USB adapter keeps bytes for 16 ms (FTDI's latency timer as delivered); a little more ends a frame.
const FRAME_TIMING: FrameTiming = FrameTiming { within_us: u32::MAX, behind_us: 20_000 };
/// Its number among the masters; those of TCP begin behind it.
const MASTER_ID: u64 = 0;

/// How the line is set; 8 data bits.
#[derive(Clone, Debug)]
pub struct SerialSettings {
    /// The serial device.
    pub device: String,
    /// Its speed.
    pub baud: u32,
    /// Its parity; without one there are two stop bits, as the standard has it.
    pub parity: Parity,
}

impl SerialSettings {
    /// Opens it.
    ///
    /// # Errors
    /// There is no such device, or it is another's.
    pub fn open(&self) -> io::Result<DuplexStream> {
        let stop = if self.parity == Parity::None { StopBits::Two } else { StopBits::One };
        let port = serialport::new(&self.device, self.baud)
            .data_bits(DataBits::Eight)
            .parity(self.parity)
            .stop_bits(stop)
            .timeout(READ_TIMEOUT)
            .open()?;
        let reader: Box<dyn SerialPort> = port.try_clone()?;
        Ok((Box::new(reader), Box::new(port)))
    }
}

/// Answers the master on a line until the end; one that breaks is opened again.
pub fn serve(
    shared: &SharedHub,
    mut open: impl FnMut() -> io::Result<DuplexStream>,
    unit: u8,
    end: &SharedPlcStatus,
) {
    let mut pause = Backoff::default();
    while !shared.is_stop_requested() {
        let broken = match open() {
            Ok(ends) => {
                end.update(|end| (end.is_up, end.why) = (true, None));
                pause = Backoff::default();
                let broken = serve_requests(shared, ends, unit, end);
                shared.lock_hub().unregister_master(MASTER_ID);
                broken
            }
            Err(error) => Err(error),
        };
        let Err(error) = broken else { return };
        end.update(|end| (end.is_up, end.why) = (false, Some(error.to_string())));
        pause.wait(shared);
    }
}

fn serve_requests(
    shared: &SharedHub,
    ends: DuplexStream,
    unit: u8,
    end: &SharedPlcStatus,
) -> io::Result<()> {
    let (mut reader, mut writer) = ends;
    let mut registers = HubView { shared, master: MASTER_ID };
    let mut slave = Slave::new(unit, FRAME_TIMING);
    let mut response = ResponseBuffer::new();
    let mut bytes = [0; 256];
    let start = Instant::now();
    // It wraps after 71 minutes, which a slave is made for.
    let now_us = || start.elapsed().as_micros() as u32;
    while !shared.is_stop_requested() {
        match reader.read(&mut bytes) {
            Ok(0) => return Err(io::ErrorKind::UnexpectedEof.into()),
            Ok(length) => bytes[..length].iter().for_each(|byte| slave.receive(now_us(), *byte)),
            Err(error) if is_timeout(&error) => {}
            Err(error) => return Err(error),
        }
        if slave.poll(now_us(), &mut registers, &mut response) {
            writer.write_all(&response)?;
            writer.flush()?;
            end.update(|end| end.given += 1);
        }
    }
    Ok(())
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;
    use serialport::TTYPort;
    use std::{
        io::Read as _,
        sync::{
            Arc,
            atomic::{AtomicBool, Ordering},
        },
        thread,
    };
    use trueup_client::pinned_calibration::{CalibrationPolicy, PinnedCalibration};

    /// Read input register 0 of unit 1, with its checksum.
    const READ_REQUEST: [u8; 8] = [1, 4, 0, 0, 0, 1, 0x31, 0xCA];
    /// The layout, 1.
    const LAYOUT_RESPONSE: [u8; 7] = [1, 4, 2, 0, 1, 0x78, 0xF0];

    fn query(master: &mut TTYPort, part: usize) -> Option<[u8; 7]> {
        for part in READ_REQUEST.chunks(part) {
            master.write_all(part).expect("the line is open");
            thread::sleep(Duration::from_millis(3));
        }
        let mut answer = [0; 7];
        master.read_exact(&mut answer).ok().map(|()| answer)
    }

    #[test]
    fn a_master_on_a_serial_line_is_answered_however_the_bytes_come_and_a_line_that_breaks_is_opened_again()
     {
        let (mut master, slave) = TTYPort::pair().expect("this machine has pseudo terminals");
        master.set_timeout(Duration::from_secs(2)).expect("a terminal");
        let stop = Arc::new(AtomicBool::new(false));
        let shared = SharedHub::new(stop.clone(), PinnedCalibration::new(CalibrationPolicy::Any));
        let end = SharedPlcStatus::default();
        let (theirs, ours) = (shared.clone(), end.clone());
        let mut tries = 0;
        let thread = thread::spawn(move || {
            let open = move || {
                tries += 1;
                if tries == 1 {
                    return Err(io::ErrorKind::NotFound.into());
                }
                let mut port = slave.try_clone_native().map_err(io::Error::from)?;
                port.set_timeout(READ_TIMEOUT)?;
                let reader = port.try_clone_native().map_err(io::Error::from)?;
                Ok((Box::new(reader) as _, Box::new(port) as _))
            };
            serve(&theirs, open, 1, &ours);
        });
        for part in [8, 3, 1] {
            assert_eq!(query(&mut master, part), Some(LAYOUT_RESPONSE), "{part} bytes at a time");
        }
        master.write_all(&[0xFF; 9]).expect("noise");
        thread::sleep(Duration::from_millis(60));
        assert_eq!(query(&mut master, 8), Some(LAYOUT_RESPONSE), "after noise");
        stop.store(true, Ordering::Relaxed);
        thread.join().expect("it ends");
        assert_eq!(end.snapshot().given, 4);
    }
}
