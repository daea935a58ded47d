//! The flashable image boots where nearly everything is dead: in QEMU the crystal, the PLL, the
//! converters and the CAN controller never answer, and the flash cannot be written. It has to come up all the same,
//! name each dead part in its log, and report to the CNC over the serial line that no offset is available.

use std::{
    io::{ErrorKind, Read as _, Write as _},
    time::{Duration, Instant},
};

use anyhow::{Result, bail, ensure};
use trueup_boot::flash_layout::HANDOVER_START;
use trueup_core::cnc::{OffsetFlags, OffsetQuality, Output};
use trueup_emulator::{
    firmware_images::{self, Board},
    qemu::QemuProcess,
    rtt::{QEMU_MONITOR_ARGUMENTS, QemuMonitor},
    setup,
};
use trueup_link::{
    receiver::OffsetReceiver,
    slcan::{AdapterMessage, SlcanClient, client::OPEN_SEQUENCE},
};

/// Boots the image, opens the serial line and waits for offsets. Gives them with the time from the
/// start of QEMU, and the log.
fn boot() -> Result<(Output, Duration, Vec<String>)> {
    let image = firmware_images::build_board_image(Board::Stm32f405)?;
    setup::ensure_qemu()?;
    let started = Instant::now();
    let serial = ["-serial", "unix:serial.sock,server=on,wait=on"];
    let mut qemu =
        QemuProcess::start(&image, &[serial, QEMU_MONITOR_ARGUMENTS].concat(), |_| Ok(()))?;
    let mut stream = qemu.connect("serial.sock")?;
    stream.set_read_timeout(Some(Duration::from_millis(20)))?;
    let (mut client, mut offsets) = (SlcanClient::new(), OffsetReceiver::new());
    let mut bytes = [0; 4096];
    let output = 'wait: loop {
        ensure!(started.elapsed() < Duration::from_secs(20), "the board never says: not available");
        // This board does not say when its line is ready; what comes too early is lost.
        let length = match stream.read(&mut bytes) {
            Ok(length) => length,
            Err(error) if error.kind() == ErrorKind::WouldBlock => {
                stream.write_all(OPEN_SEQUENCE)?;
                continue;
            }
            Err(error) => return Err(error.into()),
        };
        for &byte in &bytes[..length] {
            if let Some(AdapterMessage::Frame(frame)) = client.receive(byte)
                && let Some(output) = offsets.accept(&frame)?
                // The first cycles come before the missing samples count as missing.
                && output.quality == OffsetQuality::Fault
            {
                break 'wait output;
            }
        }
    };
    let took = started.elapsed();
    // A line that nobody reads would stop QEMU, its monitor included.
    drop(stream);
    let mut monitor = QemuMonitor::connect(&mut qemu)?;
    // The converters have half a second of the board's time to answer.
    while started.elapsed() < Duration::from_secs(20) {
        let log = monitor.read_log(&qemu, &image)?;
        if log.iter().any(|line| line.contains("temperature converters")) {
            return Ok((output, took, log));
        }
    }
    bail!("the board never says which temperature converters answer")
}

#[test]
fn it_boots_with_everything_dead_reports_it_and_sends_not_available() {
    // Without -icount QEMU's virtual clock is the host's: the shortest of three boots is the one
    // in which this machine was least busy with other things.
    let (output, took, log) = (0..3)
        .map(|_| boot().expect("the image boots"))
        .min_by_key(|(_, took, _)| *took)
        .expect("three boots");
    println!("not available {} ms after QEMU was started; the log:", took.as_millis());
    log.iter().for_each(|line| println!("  {line}"));

    assert_eq!((output.offset, output.quality), (None, OffsetQuality::Fault));
    assert_eq!(output.age_ms, 255);
    assert!(output.flags.contains(OffsetFlags::SAMPLES_MISSING.union(OffsetFlags::BOARD_DEGRADED)));
    assert!(took < Duration::from_secs(1), "{took:?}");
    let dead = [
        "crystal",
        "PLL",
        "CAN",
        "no samples",
        "store of references",
        "store of calibrations",
        "converters that answer: 0b00000000",
    ];
    for dead in dead {
        let is_logged = log.iter().any(|line| line.to_lowercase().contains(&dead.to_lowercase()));
        assert!(is_logged, "the log does not name: {dead}");
    }
}

#[test]
fn the_plain_bytes_begin_with_a_stack_in_ram_and_an_entry_in_flash() {
    let image = firmware_images::build_board_image(Board::Stm32f405).expect("it builds");
    let bytes = std::fs::read(image.with_extension("bin")).expect("the bytes beside the image");
    let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().expect("four bytes"));
    // The boot program, and the application behind the header of slot A.
    for (begin, room) in [(0, 0x8000), (0x1_0200, 0x3_0000 - 0x200)] {
        let (stack, entry) = (word(begin), word(begin + 4));
        assert_eq!(stack, HANDOVER_START, "the stack begins below what is handed over");
        let code = 0x0800_0000 + begin as u32..0x0800_0000 + begin as u32 + room;
        assert!(code.contains(&entry) && entry % 2 == 1, "Thumb code: {entry:#x}");
    }
    // From 32 to 64 KB is nothing.
    let gap = 0x8000..0x1_0000;
    assert!(bytes[gap.clone()].iter().all(|byte| *byte == 0xFF), "erased flash");
    let size = trueup_emulator::memory_usage::measure_memory_usage(&image).expect("it has code");
    let content = (bytes.len() - gap.len()) as u64;
    assert!(size.flash <= content && content < size.flash + 0x8000, "{size:?}");
}

#[test]
fn the_images_have_code_and_leave_room() {
    for board in Board::ALL {
        let image = firmware_images::build_board_image(board).expect("it builds");
        let size =
            trueup_emulator::memory_usage::measure_memory_usage(&image).expect("it has code");
        println!("{}: {size:?}", board.cargo_feature());
        // Of 128 KB. Both have room for a calibration that is being loaded, 16 KB; `virtual` has the
        // running one in RAM as well.
        assert!(size.code > 10_000 && size.flash < 256 * 1024 && size.ram < 80 * 1024, "{size:?}");
    }
}
