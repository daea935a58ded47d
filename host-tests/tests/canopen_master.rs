//! The CANopen side of the running virtual bridge: PyPI `canopen` as the master, with the bridge's
//! own EDS file; and what becomes of a loaded calibration when the power goes and comes back.

mod support;

use std::{
    collections::VecDeque,
    fs,
    process::{Command, Stdio},
};

use anyhow::{Context as _, Result, ensure};
use serde_json::{Value, json};
use support::{BridgeProcess, FAST_MACHINE, GROWN_RUN, GROWN_UM, file};
use trueup_canopen::{EDS, dictionary::OBJECTS, sdo::AbortCode};
use trueup_core::{
    cnc::{Control, OffsetQuality, Output},
    units::Rpm,
};
use trueup_emulator::{
    analogue_front_end::AnalogueFrontEnd, board::VirtualBoard, firmware_images, setup,
};
use trueup_link::{
    frame::Frame,
    frames,
    layout::{SDO_REQUEST_ID, SDO_RESPONSE_ID},
    receiver::OffsetReceiver,
};
use trueup_machine::{CompiledCalibration, MachineFile, compile};
use trueup_pipe::{Block, FRAMES_PER_BLOCK};
use trueup_store::calibration::calibration_crc;

/// Returns the fast machine, with growth times `gain`.
fn compiled(gain: f64) -> Result<CompiledCalibration> {
    let folder = tempfile::tempdir()?;
    let machine = file(&folder, "machine.toml", FAST_MACHINE)?;
    let mut machine = MachineFile::read(machine.as_ref())?;
    machine.spindle.sensor.as_mut().context("it has one")?.um_per_count *= gain;
    Ok(compile(&machine)?)
}

#[test]
#[ignore = "long: every object, every abort code"]
fn pypi_canopen_reads_every_object_loads_a_calibration_and_gets_each_abort_code() -> Result<()> {
    let python = setup::ensure_python()?;
    let folder = tempfile::tempdir()?;
    let machine = file(&folder, "machine.toml", FAST_MACHINE)?;
    let run = file(&folder, "run.csv", GROWN_RUN)?;
    let eds = file(&folder, "trueup.eds", EDS)?;
    let new = compiled(0.5)?;
    let calibration = folder.path().join("new.bin");
    fs::write(&calibration, new.blob())?;

    let mut bridge = BridgeProcess::start(&["--machine", &machine, "--run", &run])?;
    let output = Command::new(python)
        .arg(setup::project_root().join("host-tests/python/canopen_master.py"))
        .arg(format!("socket://{}", bridge.address()))
        .args([eds.as_ref(), calibration.as_os_str()])
        .stdin(Stdio::null())
        .output()?;
    let stderr = String::from_utf8_lossy(&output.stderr);
    ensure!(output.status.success(), "{stderr}\nthe bridge: {}", bridge.command.log());
    let saw: Value = serde_json::from_slice(&output.stdout)?;
    println!("{saw:#}");

    let entries: usize = OBJECTS.iter().map(|object| object.entries.len()).sum();
    let values = saw["values"].as_object().context("values")?;
    assert_eq!((values.len(), &saw["wrong"]), (entries, &json!([])), "each, with its type");
    assert_eq!(values["1000:0"], 404);
    assert_eq!(values["1008:0"], "trueup bridge");
    assert_eq!(values["2010:6"], "abort 06010001");

    let misuses = saw["misuses"].as_array().context("misuses")?;
    for it in misuses {
        assert_eq!(it["abort"], it["expected"], "{it}");
    }
    println!("{entries} entries read, {} misuses refused", misuses.len());

    let running = compiled(1.0)?;
    let hex: String = running.blob().iter().map(|byte| format!("{byte:02x}")).collect();
    assert_eq!(saw["running"], hex);
    assert_eq!(saw["running_in_blocks"], hex, "a block download of python-canopen");
    for equal in ["read_back_is_equal", "running_again_is_equal"] {
        assert_eq!(saw[equal], json!(true), "{equal}");
    }
    assert_eq!(saw["new_crc"], calibration_crc(new.blob()));
    // The offsets went on all the while, a pair a millisecond.
    assert_eq!(saw["gaps"], 0);
    let elongation = saw["engaged"]["elongation_nm"].as_f64().context("a number")?;
    let offset = saw["engaged"]["offset_z_nm"].as_f64().context("a number")?;
    for nm in [elongation, offset] {
        assert!((nm / 1_000.0 - GROWN_UM).abs() < 0.3, "{nm} nm");
    }

    assert_eq!((&saw["first_state"], &saw["states"]), (&json!(0), &json!([0, 4, 5])));
    let rate = saw["heartbeats_per_s"].as_f64().context("a rate")?;
    assert!((40.0..60.0).contains(&rate), "{rate} heartbeats a second");
    let codes: Vec<u64> = saw["emergencies"]
        .as_array()
        .into_iter()
        .flatten()
        .filter_map(|entry| entry[0].as_u64())
        .collect();
    for code in [0x8100, 0x8130] {
        let at = codes
            .iter()
            .position(|candidate| *candidate == code)
            .with_context(|| format!("{code:#x}"))?;
        assert!(codes[at..].contains(&0), "its end was reported: {codes:x?}");
    }
    assert!(saw["history"].as_array().is_some_and(|all| all.contains(&json!(0x0004_8130))));
    // Network management: what is unprotected stops nothing and restarts nothing in use.
    let engaged = &saw["engaged"];
    assert_eq!(
        (&engaged["quality_after_nmt"], &engaged["clock_goes_on"]),
        (&json!(1), &json!(true))
    );
    assert_eq!(saw["after_reset_communication"], json!([100, 100]));
    let restart = &saw["restart"];
    assert_eq!(restart["runs_on_the_new_one"], json!(true), "{restart}");
    assert_eq!(restart["running_crc"], calibration_crc(new.blob()), "{restart}");
    assert_eq!(restart["new_crc"], 0, "{restart}");
    let clock = |name: &str| restart[name].as_u64().context("a clock");
    assert!(clock("clock")? < clock("clock_before")?, "{restart}");
    bridge.command.signal("TERM")?;
    assert!(bridge.command.end()?.status.success());
    Ok(())
}

/// A board on a CAN bus with a master and a CNC.
struct Bus {
    board: VirtualBoard,
    front_end: AnalogueFrontEnd,
    offsets: OffsetReceiver,
    answers: VecDeque<[u8; 8]>,
    last: Option<Output>,
    counter: u8,
    ms: u32,
    confirm: bool,
}

impl Bus {
    fn new(board: VirtualBoard) -> Self {
        let front_end = AnalogueFrontEnd::new(0.33, 5);
        let offsets = OffsetReceiver::new();
        let answers = VecDeque::new();
        Self { board, front_end, offsets, answers, last: None, counter: 0, ms: 0, confirm: false }
    }

    /// Two milliseconds, with a request, and the CNC engaged or not.
    fn step(&mut self, request: Option<[u8; 8]>, engage: bool) -> Result<()> {
        let mut sent = [None; FRAMES_PER_BLOCK];
        sent[1] = request.map(|data| Frame::new(SDO_REQUEST_ID, &data)).transpose()?;
        if self.ms.is_multiple_of(20) {
            let engage = engage && self.ms >= 60;
            let confirm = self.confirm;
            let control = Control { engage, service: !engage, confirm, ..Control::REFERENCED };
            sent[0] = Some(frames::encode_control(control, self.counter));
            self.counter = self.counter.wrapping_add(1);
        }
        self.ms += 2;
        let volts = 9_164.0 * 10.0 / 32_768.0;
        let blocks = [sent, [None; FRAMES_PER_BLOCK]].map(|frames| Block {
            codes: self.front_end.convert_block(|_| volts),
            speed: Some(Rpm(24_000)),
            frames,
            ..Block::default()
        });
        for (_, frame) in self.board.step(&blocks)? {
            if frame.id() == SDO_RESPONSE_ID {
                self.answers.push_back(*frame.data());
            }
            self.last = self.offsets.accept(&frame)?.or(self.last);
        }
        Ok(())
    }

    fn transact(&mut self, request: [u8; 8]) -> Result<[u8; 8]> {
        self.step(Some(request), false)?;
        for _ in 0..100 {
            if let Some(answer) = self.answers.pop_front() {
                return Ok(answer);
            }
            self.step(None, false)?;
        }
        anyhow::bail!("no answer to {request:02X?} in 200 ms")
    }

    /// Loads a calibration; gives the last answer.
    fn load(&mut self, blob: &[u8]) -> Result<[u8; 8]> {
        let [a, b, c, d] = u32::try_from(blob.len())?.to_le_bytes();
        let mut answer = self.transact([0x21, 0x00, 0x21, 2, a, b, c, d])?;
        let count = blob.chunks(7).count();
        for (number, part) in blob.chunks(7).enumerate() {
            let head = u8::from(number % 2 == 1) << 4 | u8::from(number + 1 == count);
            let mut data = [0; 8];
            data[0] = head | u8::try_from(7 - part.len())? << 1;
            data[1..=part.len()].copy_from_slice(part);
            answer = self.transact(data)?;
        }
        Ok(answer)
    }

    /// Where Z goes while the CNC engages.
    fn live_z_um(&mut self) -> Result<f64> {
        for _ in 0..400 {
            self.step(None, true)?;
        }
        let last = self.last.context("an offset")?;
        ensure!(last.quality == OffsetQuality::Live, "{last:?}");
        Ok(f64::from(last.offset.context("available")?[2].0) / 1_000.0)
    }
}

#[test]
fn a_loaded_calibration_is_used_from_the_next_start_and_a_dead_store_is_reported() -> Result<()> {
    let image = firmware_images::build_virtual_board_image()?;
    let (old, new) = (compiled(1.0)?, compiled(0.5)?);
    let mut bus = Bus::new(VirtualBoard::boot(&image, old.blob())?);
    let loaded = bus.board.flash_path().with_file_name("loaded.bin");

    // A folder in its place: no file can be opened there.
    fs::create_dir(&loaded)?;
    let [kind, .., a, b, c, d] = bus.load(new.blob())?;
    let refused = (kind, u32::from_le_bytes([a, b, c, d]));
    assert_eq!(refused, (0x80, AbortCode::CannotStore.code()));
    fs::remove_dir(&loaded)?;

    assert_eq!(bus.load(new.blob())?[0] & 0xEF, 0x20);
    assert_eq!(fs::read(&loaded)?, new.blob());
    let z = bus.live_z_um()?;
    assert!((z - GROWN_UM).abs() < 0.3, "{z} µm by the old one, until the next start");

    let mut bus = Bus::new(bus.board.restart(&image, old.blob())?);
    let z = bus.live_z_um()?;
    assert!((z - 0.5 * GROWN_UM).abs() < 0.3, "{z} µm by the new one");

    // One that is damaged in the store is not used, and what is used instead waits for Confirm.
    let mut damaged = new.blob().to_vec();
    damaged[100] ^= 1;
    fs::write(&loaded, damaged)?;
    let mut bus = Bus::new(bus.board.restart(&image, old.blob())?);
    let refused = bus.live_z_um().expect_err("not what was loaded").to_string();
    assert!(refused.contains("Fault"), "{refused}");
    // It is another one than the CNC last engaged on, and an older one: an edge of Confirm answers one question.
    for confirms in [true, false] {
        bus.confirm = confirms;
        let refused = bus.live_z_um().expect_err("a question is open").to_string();
        assert!(refused.contains("Fault"), "{refused}");
    }
    bus.confirm = true;
    let z = bus.live_z_um()?;
    assert!((z - GROWN_UM).abs() < 0.3, "{z} µm by the one it was started with");
    // It is the newest again, and nothing is asked at the next start.
    assert_eq!(fs::read(&loaded)?, old.blob());
    let mut bus = Bus::new(bus.board.restart(&image, new.blob())?);
    let z = bus.live_z_um()?;
    assert!((z - GROWN_UM).abs() < 0.3, "{z} µm by the one that was confirmed");
    Ok(())
}
