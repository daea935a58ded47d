//! A PLC that keeps the rules of `docs/modbus.md` and no others, behind the gateway by TCP or on the board's own RS-485
//! line, while its line and the bridge's are cut at random moments, in the middle of a frame, for 20 ms to 3.5 s. Time
//! is virtual; the board's application, the link, the gateway's hub and the protocol are those that run.
//!
//! In every cycle: what the PLC uses is what the board sent a moment ago; no offset is used, and none is live, once a
//! line has been away for long enough; and no step, neither of the board's offset nor of what the PLC applies, is
//! above the slew limit. At the end all is well again by itself.

mod support;

use std::{collections::VecDeque, f64::consts::TAU, time::Duration};

use anyhow::{Context as _, Result, ensure};
use rand::{Rng as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use support::FAST_MACHINE;
use trueup_core::{
    bridge::TickInput as Samples,
    cnc::{Control, OffsetQuality},
    units::AdcCode,
};
use trueup_emulator::plc_requests::{
    MODBUS_UNIT_ID, build_read_request_pdu, build_write_request_pdu, encode_rtu_frame,
};
use trueup_gateway::{
    hub::{Hub, MasterId},
    pinned_calibration::{CalibrationPolicy, PinnedCalibration},
};
use trueup_link::slcan::{Port, SlcanClient, client::OPEN_SEQUENCE, encode_line};
use trueup_machine::{MachineFile, compile};
use trueup_modbus::{
    holding_block,
    input_block::{InputBlock, InputRegisters},
    rtu::{FrameTiming, Slave},
    server::{RegisterStore, RegistersBusy, ResponseBuffer, Transport, handle_request},
};
use trueup_node::node::{Interface, Node};

/// The machine file's default.
const SLEW_NM_PER_MS: f64 = 20.0;
/// The PLC's cycle: it writes, then reads.
const CYCLE_MS: u64 = 20;
/// The gateway looks at the bridge's line so often.
const TURN_MS: u64 = 2;
/// The page's rules: nothing new for so long, held for so long; let go for so long before it engages.
const STALE_MS: u64 = 100;
const HELD_MS: u64 = 2_000;
const RELEASED_MS: u64 = 200;
/// After so long without an offset it engages anew.
const GIVEN_UP_MS: u64 = 1_000;
/// No offset comes through a line that has been away for so long: the gateway's 100 ms, and what is on its way.
const LAST_MS: u64 = 130;
/// The board has lost its CNC by then: the link timeout of 500 ms, and what is on its way.
const LOST_MS: u64 = 560;
/// This many milliseconds are a moment.
const MOMENTS: usize = 60;
/// When nothing is cut any more, all is well after so long.
const SETTLE_MS: u64 = 20_000;

/// Which line is away.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Cut {
    None,
    /// Between PLC and gateway, or PLC and board.
    Plc,
    /// Answers alone are lost on it: what was written has been taken.
    Answers,
    /// Between gateway and board.
    Bridge,
}

/// How the PLC reaches the board.
enum Path {
    Gateway { hub: Box<Hub>, port: Box<Port>, client: SlcanClient, master: MasterId },
    Board { slave: Box<Slave> },
}

/// The hub as one master reaches it.
struct HubBridge<'h>(&'h mut Hub, Duration, MasterId);

impl RegisterStore for HubBridge<'_> {
    fn input_registers(&mut self) -> InputRegisters {
        self.0.input_registers()
    }

    fn holding_registers(&mut self) -> holding_block::HoldingRegisters {
        self.0.holding_registers()
    }

    fn write_holding_registers(
        &mut self,
        block: &holding_block::HoldingRegisters,
    ) -> Result<(), RegistersBusy> {
        self.0.accept_block(self.1, self.2, block).map(drop)
    }
}

/// The node as its slave reaches it.
struct Direct<'n, 'b>(&'n mut Node<'b>);

impl RegisterStore for Direct<'_, '_> {
    fn input_registers(&mut self) -> InputRegisters {
        self.0.input_block().encode()
    }

    fn holding_registers(&mut self) -> holding_block::HoldingRegisters {
        self.0.holding_registers()
    }

    fn write_holding_registers(
        &mut self,
        block: &holding_block::HoldingRegisters,
    ) -> Result<(), RegistersBusy> {
        self.0.receive_registers(block)
    }
}

/// A PLC's program by the page.
#[derive(Default)]
struct Plc {
    counter: u16,
    seen: Option<u16>,
    /// When an offset that may be used last came, and what it was.
    fresh_ms: u64,
    target: [i32; 3],
    applied: [f64; 3],
    is_engaged: bool,
    engaged_ms: u64,
    released_ms: u64,
}

impl Plc {
    fn block(&mut self, now: u64) -> Vec<u8> {
        let has_none = now - self.fresh_ms.max(self.engaged_ms) > GIVEN_UP_MS;
        if self.is_engaged && has_none {
            (self.is_engaged, self.released_ms) = (false, now);
        }
        if !self.is_engaged && self.applied == [0.0; 3] && now - self.released_ms > RELEASED_MS {
            (self.is_engaged, self.engaged_ms) = (true, now);
        }
        self.counter = self.counter.wrapping_add(1);
        build_write_request_pdu(
            if self.is_engaged { Control::ENGAGED } else { Control::REFERENCED },
            self.counter,
        )
    }

    /// Takes what was read; whether it is used.
    fn take(&mut self, now: u64, registers: &InputRegisters) -> bool {
        let Some(input) = InputBlock::decode(registers) else { return false };
        let is_new = self.seen.replace(input.counter) != Some(input.counter);
        let Some(offset) = input.output.offset.filter(|_| is_new) else { return false };
        self.target = offset.map(|offset| offset.0);
        self.fresh_ms = now;
        true
    }

    /// Goes one step on: follows, holds, or takes back. Returns the largest step of an axis, in nm.
    fn follow(&mut self, now: u64) -> f64 {
        let without = now - self.fresh_ms;
        let (is_held, is_lost) = (without > STALE_MS, without > STALE_MS + HELD_MS);
        let most = SLEW_NM_PER_MS * CYCLE_MS as f64;
        let mut largest = 0.0_f64;
        for (applied, target) in self.applied.iter_mut().zip(self.target) {
            let goal = if is_lost { 0.0 } else { f64::from(target) };
            let step = if is_held && !is_lost { 0.0 } else { (goal - *applied).clamp(-most, most) };
            *applied += step;
            largest = largest.max(step.abs());
        }
        largest
    }
}

/// Counts of a run.
#[derive(Debug, Default)]
struct Counts {
    cuts: [u32; 4],
    used: u32,
    live: u32,
    held: u32,
    engaged: u32,
    largest_step_nm: f64,
}

struct World<'b> {
    node: Node<'b>,
    path: Path,
    plc: Plc,
    random: ChaCha8Rng,
    now: u64,
    cut: Cut,
    since: u64,
    /// Offsets from the board in the last moments, in nm.
    offsets: VecDeque<Option<[i32; 3]>>,
    reported: Counts,
}

impl World<'_> {
    /// A millisecond of the board, and of the gateway's line to it.
    fn tick(&mut self) -> Result<()> {
        self.now += 1;
        let mean = 1_000.0 + 200.0 * (TAU * self.now as f64 / 60_000.0).sin();
        let codes = std::array::from_fn(|i| AdcCode(mean as u16 + (i % 2) as u16));
        let before = self.node.last_output().offset;
        let frames = self.node.tick(1, Samples { codes: Some(&codes), ..Samples::default() });
        self.node.next_service_frame();
        let after = self.node.last_output().offset;
        for (was, is) in before.iter().flatten().zip(after.iter().flatten()) {
            let step = f64::from(is.0.abs_diff(was.0));
            ensure!(
                step <= SLEW_NM_PER_MS + 1.0,
                "the board steps by {step} nm at {} ms",
                self.now
            );
        }
        self.offsets.push_front(after.map(|all| all.map(|offset| offset.0)));
        self.offsets.truncate(MOMENTS);
        let has_no_plc = matches!(self.cut, Cut::Plc | Cut::Bridge);
        let is_away = has_no_plc && self.now.saturating_sub(self.since) > LOST_MS;
        ensure!(
            !(is_away && self.node.last_output().quality == OffsetQuality::Live),
            "live, though {:?} was cut {} ms ago",
            self.cut,
            self.now - self.since
        );
        let Path::Gateway { hub, port, client, .. } = &mut self.path else { return Ok(()) };
        let now = Duration::from_millis(self.now);
        port.send_all(&frames);
        let mut bytes: Vec<u8> = std::iter::from_fn(|| port.pop()).collect();
        if self.cut == Cut::Bridge {
            // In the middle of a line, when it begins.
            let goes =
                if self.now == self.since { self.random.random_range(0..=bytes.len()) } else { 0 };
            bytes.truncate(goes);
        }
        for event in bytes.iter().filter_map(|byte| client.receive(*byte)) {
            hub.receive(now, &event);
        }
        if self.now.is_multiple_of(TURN_MS) {
            hub.refresh_input_block(now);
            let lines: Vec<u8> = hub
                .take_due_frames()
                .iter()
                .flat_map(|frame| encode_line(frame).into_bytes())
                .collect();
            let goes = if self.cut == Cut::Bridge { 0 } else { lines.len() };
            for received in lines[..goes].iter().filter_map(|byte| port.receive(*byte)) {
                self.node.receive(Interface::Serial, &received).ok();
            }
        }
        Ok(())
    }

    /// Sends a request to where the path leads. Returns what comes back of the answer.
    fn query(&mut self, pdu: &[u8]) -> Option<Vec<u8>> {
        let mut request = match self.path {
            Path::Gateway { .. } => {
                let length = (pdu.len() as u16 + 1).to_be_bytes();
                [&[0, 7, 0, 0][..], &length, &[MODBUS_UNIT_ID], pdu].concat()
            }
            Path::Board { .. } => encode_rtu_frame(MODBUS_UNIT_ID, pdu),
        };
        if self.cut == Cut::Plc {
            let goes = self.random.random_range(0..request.len());
            request.truncate(goes);
        }
        let mut response = ResponseBuffer::new();
        let is_answered = match &mut self.path {
            // Half a request is waited for, and then the connection is closed.
            Path::Gateway { hub, master, .. } => {
                let mut reached = HubBridge(hub, Duration::from_millis(self.now), *master);
                handle_request(
                    Transport::Tcp,
                    MODBUS_UNIT_ID,
                    &request,
                    &mut reached,
                    &mut response,
                )
            }
            Path::Board { slave } => {
                let mut now_us = (self.now * 1_000) as u32;
                for byte in &request {
                    now_us = now_us.wrapping_add(96);
                    slave.receive(now_us, *byte);
                }
                slave.poll(now_us.wrapping_add(1_750), &mut Direct(&mut self.node), &mut response)
            }
        };
        let comes_back = matches!(self.cut, Cut::None | Cut::Bridge);
        (is_answered && comes_back).then(|| response.to_vec())
    }

    /// A cycle of the PLC.
    fn cycle(&mut self) -> Result<()> {
        let block = self.plc.block(self.now);
        self.query(&block);
        // By a serial line the next request comes when the first is over.
        (0..CYCLE_MS / 2).try_for_each(|_| self.tick())?;
        let head = if matches!(self.path, Path::Gateway { .. }) { 9 } else { 3 };
        if let Some(answer) = self.query(&build_read_request_pdu()) {
            let (words, _) = answer.get(head..head + 56).context("the block")?.as_chunks::<2>();
            let words: Vec<u16> = words.iter().map(|word| u16::from_be_bytes(*word)).collect();
            if self.plc.take(self.now, &words.try_into().ok().context("28 registers")?) {
                self.reported.used += 1;
                let away = self.now.saturating_sub(self.since);
                ensure!(
                    self.cut == Cut::None || away <= LAST_MS,
                    "an offset is used {away} ms after {:?} was cut",
                    self.cut
                );
                let on_wire = |nm: i32| (nm.abs() + 5) / 10 * 10 * nm.signum();
                let offsets = self.offsets.iter().flatten();
                ensure!(
                    offsets.map(|values| values.map(on_wire)).any(|words| words == self.plc.target),
                    "{:?} was not sent in the last moments, at {} ms",
                    self.plc.target,
                    self.now
                );
            }
        }
        let step = self.plc.follow(self.now);
        self.reported.largest_step_nm = self.reported.largest_step_nm.max(step);
        ensure!(step <= SLEW_NM_PER_MS * CYCLE_MS as f64, "a step of {step} nm at {} ms", self.now);
        match self.node.last_output().quality {
            OffsetQuality::Live => self.reported.live += 1,
            OffsetQuality::Hold => self.reported.held += 1,
            _ => {}
        }
        self.reported.engaged += u32::from(self.plc.is_engaged);
        (0..CYCLE_MS / 2).try_for_each(|_| self.tick())
    }

    /// A line goes, or comes back.
    fn change(&mut self, to: Cut) {
        self.reported.cuts[to as usize] += 1;
        if let Path::Gateway { hub, port, master, .. } = &mut self.path {
            match self.cut {
                // A new connection, of which the gateway may not know that the old one has gone.
                Cut::Plc | Cut::Answers => {
                    if self.random.random() {
                        hub.unregister_master(*master);
                    }
                    *master += 1;
                }
                // The one that opens the line reports it.
                Cut::Bridge => open(port),
                Cut::None => {}
            }
        }
        (self.cut, self.since) = (to, self.now + 1);
    }
}

/// Opens the line as every client does; no frame is in it.
fn open(port: &mut Port) {
    for byte in OPEN_SEQUENCE {
        port.receive(*byte);
    }
}

/// This many cuts; what was counted.
fn cuts(path: Path, count: u32, seed: u64) -> Result<Counts> {
    let folder = tempfile::tempdir()?;
    let file = folder.path().join("machine.toml");
    let machine = FAST_MACHINE.replace("slew_um_per_s = 1000.0", "slew_um_per_s = 20.0");
    std::fs::write(&file, machine)?;
    let compiled = compile(&MachineFile::read(&file)?)?;
    let kinds: &[Cut] = match path {
        Path::Gateway { .. } => &[Cut::Plc, Cut::Answers, Cut::Bridge],
        Path::Board { .. } => &[Cut::Plc, Cut::Answers],
    };
    let mut world = World {
        node: Node::new(compiled.calibration().into()),
        path,
        plc: Plc::default(),
        random: ChaCha8Rng::seed_from_u64(seed),
        now: 0,
        cut: Cut::None,
        since: 0,
        offsets: VecDeque::new(),
        reported: Counts::default(),
    };
    if let Path::Gateway { port, .. } = &mut world.path {
        open(port);
    }
    for _ in 0..count {
        for is_cut in [false, true] {
            let longest = if is_cut { [60, 400, 800, 3_500] } else { [600; 4] };
            let longest = longest[world.random.random_range(0..4)];
            let cut = kinds[world.random.random_range(0..kinds.len())];
            world.change(if is_cut { cut } else { Cut::None });
            let end = world.now + world.random.random_range(20..20 + longest);
            while world.now < end {
                world.cycle()?;
            }
        }
    }
    world.change(Cut::None);
    let end = world.now + SETTLE_MS;
    while world.now < end {
        world.cycle()?;
    }
    let needed = world.node.last_output();
    let is_there = needed.offset.is_some_and(|all| {
        all.iter()
            .zip(world.plc.applied)
            .all(|(is, applied)| (f64::from(is.0) - applied).abs() < 500.0)
    });
    ensure!(
        needed.quality == OffsetQuality::Live && is_there && world.plc.applied[2].abs() > 1_000.0,
        "not well again: {needed:?}, applied {:?}",
        world.plc.applied
    );
    let counts = world.reported;
    ensure!(counts.live > count && counts.held > count && counts.used > count, "{counts:?}");
    Ok(counts)
}

#[test]
fn a_thousand_cuts_of_either_line_make_no_step_and_nothing_old_is_used() -> Result<()> {
    const COUNT: u32 = 1_000;
    let gateway = Path::Gateway {
        hub: Box::new(Hub::new(PinnedCalibration::new(CalibrationPolicy::Any))),
        port: Box::new(Port::new(1)),
        client: SlcanClient::new(),
        master: 1,
    };
    let board = Path::Board {
        slave: Box::new(Slave::new(MODBUS_UNIT_ID, FrameTiming::from_baud(115_200))),
    };
    for (name, path) in [("gateway", gateway), ("board", board)] {
        println!("{name}: {COUNT} cuts, {:?}", cuts(path, COUNT, 1).context(name)?);
    }
    Ok(())
}
