//! `trueup gateway`: the bridge for controls with a PLC. Its work is done in `trueup-gateway`.

use std::{
    env,
    net::{SocketAddr, TcpListener, ToSocketAddrs as _},
    path::PathBuf,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread,
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result};
use clap::{Args, Subcommand, ValueEnum};
use trueup_client::{
    pinned_calibration::{CalibrationPolicy, PinnedCalibration, default_state_path},
    port::PortAddress,
};
use trueup_gateway::{
    bridge::{self, SharedHub},
    gateway_status::{self, PlcStatus, SharedPlcStatus},
    journal::JournalLimiter,
    modbus_rtu, modbus_tcp,
    s7::{self, BlockExchangeSettings, client::CpuAddress},
};

use trueup_machine::compile;

use crate::{CommandOutcome, UserError, input_files, output};

/// How often a message to the user is looked for.
const POLL_INTERVAL: Duration = Duration::from_millis(50);
/// How long `--once` waits for the first valid offsets, and for the PLC.
const ONCE_TIMEOUT: Duration = Duration::from_secs(5);

#[derive(Subcommand)]
pub enum Command {
    /// Serves the bridge as Modbus registers over TCP, until Ctrl-C.
    ///
    /// Any number of masters read, one writes. The table of registers: docs/modbus.md.
    /// Exit 3 with --once: it could listen, but no valid offsets came.
    Modbus {
        #[command(flatten)]
        bridge: BridgeArgs,
        /// Where masters connect. Only this computer's reach it unless you name another address:
        /// anyone who reaches it can engage the bridge.
        #[arg(long, value_name = "ADDR:PORT", default_value = "127.0.0.1:502")]
        listen: String,
        /// Answers a master on this serial port instead, in RTU mode.
        #[arg(long, value_name = "DEVICE", conflicts_with = "listen")]
        serial: Option<String>,
        /// The speed of that port.
        #[arg(long, default_value_t = 19_200, requires = "serial", value_parser = clap::value_parser!(u32).range(1_200..=1_000_000))]
        baud: u32,
        /// Its parity; without one there are two stop bits.
        #[arg(long, value_enum, default_value_t = Parity::Even, requires = "serial")]
        parity: Parity,
        /// The unit that is answered, in addition to 255.
        #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u8).range(1..=247))]
        unit: u8,
    },
    /// Writes the bridge's offsets into a data block of an S7, and reads positions and Control out of
    /// it, until Ctrl-C.
    ///
    /// The block and the PLC's program: integrations/siemens-840d.
    /// Exit 3 with --once: the block was written, but no valid offsets came.
    S7 {
        #[command(flatten)]
        bridge: BridgeArgs,
        /// Where the CPU is: HOST, or HOST:PORT.
        #[arg(long, value_name = "HOST")]
        plc: String,
        /// The number of the data block.
        #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
        db: u16,
        /// The CPU's rack.
        #[arg(long, default_value_t = 0, value_parser = clap::value_parser!(u8).range(0..=7))]
        rack: u8,
        /// The CPU's slot: 2 in a 300 and an 840D sl, 1 or 0 in a 1500.
        #[arg(long, default_value_t = 2, value_parser = clap::value_parser!(u8).range(0..=31))]
        slot: u8,
        /// Values to write: the offsets, or the constant and the slope of each axis, which the NCK multiplies by its
        /// own position. For long axes that warm up; it needs a PLC program with slopes (trueup_ob1_slope.awl).
        #[arg(long, value_enum, default_value_t = OutputMode::Offsets)]
        mode: OutputMode,
        /// How often a second it is written.
        #[arg(long, value_name = "HZ", default_value_t = 100, value_parser = clap::value_parser!(u32).range(1..=500))]
        rate: u32,
    },
}

#[derive(Clone, Copy, ValueEnum)]
pub enum OutputMode {
    Offsets,
    Slope,
}

#[derive(Clone, Copy, ValueEnum)]
pub enum Parity {
    Even,
    Odd,
    None,
}

#[derive(Args)]
pub struct BridgeArgs {
    /// Where the bridge is: tcp:HOST:PORT, a serial device, or a CAN interface (can0).
    #[arg(long, value_name = "PORT")]
    port: String,
    /// Engages only a bridge that runs on what this machine file makes. Without it: only one that runs on what it
    /// ran on at the first contact.
    #[arg(long, value_name = "M.toml")]
    machine: Option<PathBuf>,
    /// Keeps the calibration of the first contact in this file. Without this: gateway-PORT.calibration in
    /// $STATE_DIRECTORY, $XDG_STATE_HOME/trueup or ~/.local/state/trueup.
    #[arg(long, value_name = "FILE", conflicts_with = "machine")]
    state: Option<PathBuf>,
    /// Engages a bridge on any calibration.
    #[arg(long, conflicts_with_all = ["machine", "state"])]
    any_calibration: bool,
    /// Try once whether both ends are there, say how they are, and end.
    #[arg(long)]
    once: bool,
    /// Writes a line each second, for a person who watches. Without this: one each five minutes and
    /// at each change, at most 1 MB a day. What changes too often is counted in the next line.
    #[arg(long, conflicts_with = "once")]
    watch: bool,
}

/// Serves a PLC.
pub fn run(command: &Command) -> Result<CommandOutcome> {
    let stop = Arc::new(AtomicBool::new(false));
    let flag = stop.clone();
    ctrlc::set_handler(move || flag.store(true, Ordering::Relaxed)).context("signal handler")?;
    let (Command::Modbus { bridge, .. } | Command::S7 { bridge, .. }) = command;
    let pinned = pinned_calibration_from_args(bridge)?;
    trueup_output::enable_background_output();
    if let Some(why) = pinned.refusal() {
        trueup_output::write_diagnostic(format_args!("warning: {why}"));
    }
    let shared = SharedHub::new(stop.clone(), pinned);
    let ended = match command {
        Command::Modbus { bridge, serial: Some(device), baud, parity, unit, .. } => {
            let parity = match parity {
                Parity::Even => serialport::Parity::Even,
                Parity::Odd => serialport::Parity::Odd,
                Parity::None => serialport::Parity::None,
            };
            let line = modbus_rtu::SerialSettings { device: device.clone(), baud: *baud, parity };
            run_modbus_rtu(&shared, bridge, line, *unit)
        }
        Command::Modbus { bridge, listen, unit, .. } => {
            run_modbus_tcp(&shared, bridge, &resolve_listen_addresses("--listen", listen)?, *unit)
        }
        Command::S7 { bridge, plc, db, rack, slot, mode, rate } => {
            let place = CpuAddress { address: plc.clone(), rack: *rack, slot: *slot };
            let period = Duration::from_secs(1) / *rate;
            let mode = match mode {
                OutputMode::Offsets => s7::InputBlockContent::Offsets,
                OutputMode::Slope => s7::InputBlockContent::Slope,
            };
            run_s7_gateway(&shared, bridge, &BlockExchangeSettings { place, db: *db, period, mode })
        }
    };
    stop.store(true, Ordering::Relaxed);
    ended
}

/// On which calibration the bridge has to run to be engaged.
fn pinned_calibration_from_args(bridge: &BridgeArgs) -> Result<PinnedCalibration> {
    let state = || {
        bridge
            .state
            .clone()
            .unwrap_or_else(|| default_state_path(&bridge.port, |name| env::var_os(name)))
    };
    Ok(PinnedCalibration::new(match &bridge.machine {
        _ if bridge.any_calibration => CalibrationPolicy::Any,
        Some(path) => {
            let crc = compile(&input_files::read_machine(path)?)?.crc();
            CalibrationPolicy::Machine { crc, path: path.clone() }
        }
        None => CalibrationPolicy::FirstContact(state()),
    }))
}

/// Returns the addresses that the value of an option stands for.
pub fn resolve_listen_addresses(option: &str, listen: &str) -> Result<Vec<SocketAddr>, UserError> {
    let wrong = |why: String| UserError(format!("{option} \"{listen}\": {why}; ADDR:PORT"));
    Ok(listen.to_socket_addrs().map_err(|error| wrong(error.to_string()))?.collect())
}

fn start_bridge_thread(shared: &SharedHub, bridge: &BridgeArgs) -> Result<thread::JoinHandle<()>> {
    let port = PortAddress::parse(&bridge.port)?;
    Ok(bridge::spawn_bridge_thread(shared.clone(), move || port.open()))
}

fn run_modbus_tcp(
    shared: &SharedHub,
    bridge: &BridgeArgs,
    listen: &[SocketAddr],
    unit: u8,
) -> Result<CommandOutcome> {
    let line = start_bridge_thread(shared, bridge)?;
    let listener = TcpListener::bind(listen).with_context(|| {
        format!(
            "nothing can listen at {listen:?}; a port below 1024 needs the right to it \
             (the systemd unit has it), and no other program there"
        )
    })?;
    let address = listener.local_addr()?;
    trueup_output::write_diagnostic(format_args!(
        "Modbus masters reach the bridge at tcp:{address}, unit {unit} or 255"
    ));
    if !address.ip().is_loopback() {
        trueup_output::write_diagnostic(format_args!(
            "warning: every computer that reaches {address} can engage the bridge"
        ));
    }
    let masters = modbus_tcp::serve(shared.clone(), listener, unit)?;
    let end = || PlcStatus {
        is_up: masters.connection_count() > 0,
        given: masters.response_count(),
        ..PlcStatus::default()
    };
    if bridge.once {
        let is_receiving = wait_for_bridge(shared);
        output::print(gateway_status::build_status_line(shared, &end()))?;
        return Ok(if is_receiving { CommandOutcome::Done } else { CommandOutcome::NotMet });
    }
    monitor_status(shared, bridge, &line, end, end)
}

fn run_modbus_rtu(
    shared: &SharedHub,
    bridge: &BridgeArgs,
    line: modbus_rtu::SerialSettings,
    unit: u8,
) -> Result<CommandOutcome> {
    let thread = start_bridge_thread(shared, bridge)?;
    if bridge.once {
        let is_receiving = wait_for_bridge(shared);
        line.open().with_context(|| format!("the serial device {}", line.device))?;
        let end = PlcStatus { is_up: true, ..PlcStatus::default() };
        output::print(gateway_status::build_status_line(shared, &end))?;
        return Ok(if is_receiving { CommandOutcome::Done } else { CommandOutcome::NotMet });
    }
    let end = SharedPlcStatus::default();
    let (ours, theirs) = (shared.clone(), end.clone());
    let plc = thread::spawn(move || modbus_rtu::serve(&ours, || line.open(), unit, &theirs));
    let outcome = monitor_status(
        shared,
        bridge,
        &thread,
        || end.snapshot(),
        || end.snapshot_and_reset_longest_write(),
    )?;
    plc.join().ok().context("the thread of the PLC")?;
    Ok(outcome)
}

fn run_s7_gateway(
    shared: &SharedHub,
    bridge: &BridgeArgs,
    target: &BlockExchangeSettings,
) -> Result<CommandOutcome> {
    let line = start_bridge_thread(shared, bridge)?;
    if bridge.once {
        let is_receiving = wait_for_bridge(shared);
        s7::write_and_verify(shared, target)?;
        let end = PlcStatus { is_up: true, given: 1, ..PlcStatus::default() };
        output::print(gateway_status::build_status_line(shared, &end))?;
        return Ok(if is_receiving { CommandOutcome::Done } else { CommandOutcome::NotMet });
    }
    let end = SharedPlcStatus::default();
    let (ours, theirs, target) = (shared.clone(), end.clone(), target.clone());
    let plc = thread::spawn(move || s7::serve(&ours, &target, &theirs));
    let outcome = monitor_status(
        shared,
        bridge,
        &line,
        || end.snapshot(),
        || end.snapshot_and_reset_longest_write(),
    )?;
    // It ends with its present write, which cannot last.
    plc.join().ok().context("the thread of the PLC")?;
    Ok(outcome)
}

/// Returns whether the bridge is received within a few seconds.
fn wait_for_bridge(shared: &SharedHub) -> bool {
    let start = Instant::now();
    while start.elapsed() < ONCE_TIMEOUT && !shared.is_stop_requested() {
        if shared.lock_hub().has_fresh_output(shared.now()) {
            return true;
        }
        thread::sleep(POLL_INTERVAL);
    }
    false
}

/// Prints how both ends are, until the end; when, the journal decides.
fn monitor_status(
    shared: &SharedHub,
    bridge: &BridgeArgs,
    line: &thread::JoinHandle<()>,
    look: impl Fn() -> PlcStatus,
    take: impl Fn() -> PlcStatus,
) -> Result<CommandOutcome> {
    let mut journal = JournalLimiter::new(bridge.watch);
    while !shared.is_stop_requested() && !line.is_finished() {
        // Not with the hub held: the reader of the messages may be slow.
        let messages = shared.lock_hub().take_messages();
        let allowed =
            messages.iter().filter(|message| journal.admit_message(shared.now(), message));
        allowed.for_each(trueup_output::write_diagnostic);
        let now = shared.now();
        if journal.is_due(now, &gateway_status::build_status_line(shared, &look())) {
            output::print(
                journal.take_entry(now, gateway_status::build_status_line(shared, &take())),
            )?;
        }
        thread::sleep(POLL_INTERVAL);
    }
    Ok(CommandOutcome::Done)
}
