//! `trueup linuxcnc`: the bridge as a component of LinuxCNC's HAL; its subcommands put it into a configuration.

mod component;
mod configuration;
mod hal_pins;
mod keep;

use std::{
    fs::OpenOptions,
    path::{Path, PathBuf},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
        mpsc::{self, Receiver},
    },
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result};
use clap::Args;
use trueup_client::{
    pinned_calibration::{CalibrationPolicy, PinnedCalibration},
    port::PortAddress,
};
use trueup_core::units::NANOMETRES_PER_MICROMETRE;
use trueup_learn::{LiveUpdate, live_update};
use trueup_linuxcnc::{
    RecordFile,
    component::TEMPERATURE_CHANNEL_COUNT,
    configuration::{OffsetEntryPoint, ini_file::IniFile},
    ini_settings::IniSettings,
    joint_offsets::MAX_JOINTS,
    offset_target,
    run::{self, HalComponentSettings, LearnedCorrectionUpdate},
};
use trueup_machine::{
    Machine, MachineFile, bounded_read, compile,
    machine_file::{LinearAxis, MAX_MACHINE_FILE_BYTES},
    model::max_over_compensation_um,
};
use trueup_output::{escape::escape_line, line_queue::LineQueue};

use crate::{CommandOutcome, UserError, choice::described_choice_parser, input_files};

/// Turns of the loop in a servo cycle: a step is seen to be taken soon after it was.
const POLLS_PER_CYCLE: f64 = 2.5;
/// How often the learned file is looked at: it changes once in half an hour.
const LEARNED_FILE_POLL_INTERVAL: Duration = Duration::from_secs(5);
/// Longest wait at the end for the log.
const LOG_FLUSH_TIMEOUT: Duration = Duration::from_millis(500);

/// Runs as a component of LinuxCNC's HAL: sends commanded positions to a bridge and turns its offsets
/// into external offsets. LinuxCNC starts it: `loadusr -W trueup linuxcnc --port ...`.
///
/// `trueup linuxcnc setup` puts that line and its wires into your configuration.
/// Pins, samples and what to do at tool setting, probing and homing: integrations/linuxcnc.
#[derive(Args)]
#[command(args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
pub struct LinuxCncArgs {
    #[command(subcommand)]
    command: Option<configuration::Command>,
    /// Where the bridge is: tcp:HOST:PORT, a serial device, or can0.
    #[arg(long, value_name = "PORT", required = true)]
    port: Option<String>,
    /// Where offsets enter: as external offsets of the axes, or between the joints and their drives.
    #[arg(long, default_value = "eoffset", value_parser = described_choice_parser(configuration::OFFSET_ENTRY_POINTS))]
    by: OffsetEntryPoint,
    /// Takes the limits from this machine file: the same that the bridge was loaded with.
    #[arg(long, value_name = "M.toml")]
    machine: Option<PathBuf>,
    /// Engages a bridge on any calibration. Without this it has to run on what --machine makes; without --machine
    /// on what it ran on at the first contact.
    #[arg(long, conflicts_with_all = ["state", "strict"])]
    any_calibration: bool,
    /// Keeps the calibration of the first contact in this file. Without this: trueup.calibration (after --name), next to
    /// the .ini.
    #[arg(long, value_name = "FILE")]
    state: Option<PathBuf>,
    /// The rule since 0.3, and no longer an option of its own.
    #[arg(long, requires = "machine", hide = true)]
    strict: bool,
    /// LinuxCNC's .ini: servo period, units, and what is left for offsets.
    #[arg(long, value_name = "FILE", env = "INI_FILE_NAME")]
    ini: Option<PathBuf>,
    /// The fastest change of an offset, in um/s.
    #[arg(long, value_name = "V", value_parser = parse_positive)]
    slew_um_per_s: Option<f64>,
    /// The largest offset on every axis, in um.
    #[arg(long, value_name = "MAX", value_parser = parse_positive)]
    max_um: Option<f64>,
    /// The last offset is held for so long when the bridge is lost.
    #[arg(long, value_name = "MS")]
    hold_ms: Option<u64>,
    /// Without a valid pair of frames for so long the bridge counts as lost.
    #[arg(long, value_name = "MS", default_value_t = 100, value_parser = clap::value_parser!(u64).range(5..=250))]
    stale_ms: u64,
    /// How often the position of a moving axis is sent. A serial line at 921600 baud and a CAN bus
    /// take 2; a bridge in QEMU takes 5.
    #[arg(long, value_name = "MS", default_value_t = 2, value_parser = clap::value_parser!(u64).range(1..=100))]
    position_period_ms: u64,
    /// Sends the angles of angle-1 and angle-2, for a machine whose head turns.
    #[arg(long)]
    rotary: bool,
    /// Writes what it has to say to this file too: LinuxCNC keeps it from the screen.
    #[arg(long, value_name = "FILE")]
    log: Option<PathBuf>,
    /// Writes the last hours of speeds and temperatures to this file, which trueup learn needs together with what is probed.
    #[arg(long, value_name = "RUN.csv", requires = "machine")]
    record: Option<PathBuf>,
    /// The file that trueup learn has written next to the machine file. As far as [limits.learned]
    /// permits, the bridge takes it while it runs, and again after each change of this file. Parts
    /// that it cannot take need the file loaded, at rest. Without this the bridge receives that
    /// nothing was learned.
    #[arg(long, value_name = "LEARNED.toml", requires = "machine")]
    learned: Option<PathBuf>,
    /// How many temp-NN pins there are.
    #[arg(long, value_name = "N", default_value_t = TEMPERATURE_CHANNEL_COUNT as u8, value_parser = clap::value_parser!(u8).range(0..=TEMPERATURE_CHANNEL_COUNT as i64))]
    temperatures: u8,
    /// The name of the component. `loadusr -W` waits for the program's own; for another one,
    /// `loadusr -Wn NAME`.
    #[arg(long, default_value = "trueup")]
    name: String,
}

fn parse_positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(number) if number > 0.0 && number.is_finite() => Ok(number),
        _ => Err("a number above 0".into()),
    }
}

/// Where the component reports what happens: standard error, and a file. Neither delays the servo cycle.
struct ComponentLog(Option<LineQueue>);

impl ComponentLog {
    fn open(path: Option<&Path>) -> Result<Self> {
        let append = |path: &Path| {
            let file = OpenOptions::new().append(true).create(true).open(path);
            file.with_context(|| format!("the log {} cannot be written", path.display()))
        };
        let file = path.map(append).transpose()?;
        Ok(Self(file.map(|file| LineQueue::new("the log", file))))
    }

    fn write(&self, text: &str) {
        trueup_output::write_diagnostic(format_args!("trueup: {text}"));
        if let Some(file) = &self.0 {
            file.push(format!("trueup: {}\n", escape_line(text)));
        }
    }

    /// Waits a short time until the file has all of it.
    fn finish(&self) {
        if let Some(file) = &self.0 {
            file.flush_until(Instant::now() + LOG_FLUSH_TIMEOUT);
        }
    }
}

/// Runs until LinuxCNC ends it, or changes a configuration.
pub fn run(args: &LinuxCncArgs, as_json: bool) -> Result<CommandOutcome> {
    if let Some(command) = &args.command {
        return configuration::run(command, as_json);
    }
    trueup_output::enable_background_output();
    let log = ComponentLog::open(args.log.as_deref())?;
    let port = PortAddress::parse(args.port.as_deref().unwrap_or_default())?;
    let machine = args.machine.as_ref().map(|path| input_files::read_machine(path)).transpose()?;
    let against_um = LinearAxis::ALL
        .map(|axis| machine.as_ref().map(|machine| max_over_compensation_um(machine, axis)));
    // A machine is corrected although nothing can be learned.
    let record = args.record.as_ref().zip(machine.as_ref()).and_then(|(path, machine)| {
        let opened = RecordFile::open(path, machine);
        opened.map_err(|why| log.write(&format!("no record: {}: {why}", path.display()))).ok()
    });
    let compiled = machine.as_ref().map(compile).transpose();
    // What does not compile makes no calibration to be compared: then it is that of the first contact.
    let compiled = if args.strict {
        compiled?
    } else {
        compiled.unwrap_or_else(|why| {
            log.write(&format!("the machine file does not compile: {why}"));
            None
        })
    };
    let calibration = compiled.map(|compiled| compiled.crc());
    let state = || {
        let folder = args.ini.as_deref().and_then(Path::parent).unwrap_or(Path::new(""));
        args.state.clone().unwrap_or_else(|| folder.join(format!("{}.calibration", args.name)))
    };
    let pinned = PinnedCalibration::new(match calibration.zip(args.machine.clone()) {
        _ if args.any_calibration => CalibrationPolicy::Any,
        Some((crc, path)) => CalibrationPolicy::Machine { crc, path },
        None => CalibrationPolicy::FirstContact(state()),
    });
    if let Some(why) = pinned.refusal() {
        log.write(&why);
    }
    let limits = machine.as_ref().map(|machine| machine.limits).unwrap_or_default();
    let slew_um_per_s = args.slew_um_per_s.unwrap_or(limits.slew_um_per_s);
    let ini = match &args.ini {
        Some(path) => {
            let ini = read_ini(path)?;
            if args.by == OffsetEntryPoint::Eoffset {
                ini.find_slew_limit_conflicts(slew_um_per_s)
                    .iter()
                    .for_each(|remark| log.write(remark));
            }
            ini
        }
        None => {
            log.write(
                "no .ini: assuming a servo cycle of 1 ms, millimetres, and slow changes of the offsets",
            );
            IniSettings::default()
        }
    };
    let joints = match args.by {
        OffsetEntryPoint::Eoffset => [None; MAX_JOINTS],
        OffsetEntryPoint::Joint => {
            for beyond in
                configuration::find_joint_limit_violations(args.ini.as_deref(), machine.as_ref())?
            {
                log.write(&beyond);
            }
            configuration::read_joint_settings(args.ini.as_deref(), slew_um_per_s)?
        }
    };
    let settings = HalComponentSettings {
        name: args.name.clone(),
        mm_per_unit: ini.mm_per_unit,
        temperatures: args.temperatures,
        calibration,
        pinned,
        turn: Duration::from_secs_f64(ini.cycle_s / POLLS_PER_CYCLE),
        options: trueup_linuxcnc::ComponentOptions {
            limits: offset_target::OffsetLimits {
                max_nm: limits.max_um.map(|um| um_to_nm(args.max_um.unwrap_or(um))),
                stale: Duration::from_millis(args.stale_ms),
                hold: Duration::from_millis(args.hold_ms.unwrap_or(limits.hold_ms.into())),
            },
            pace: ini.offset_rate_limits(slew_um_per_s),
            position_period: Duration::from_millis(args.position_period_ms),
            sends_rotary: args.rotary,
            against_um,
            joints,
        },
    };
    let stop = Arc::new(AtomicBool::new(false));
    let flag = stop.clone();
    ctrlc::set_handler(move || flag.store(true, Ordering::Relaxed)).context("signal handler")?;
    let learned =
        args.learned.clone().zip(machine).map(|(path, machine)| watch_learned_file(path, machine));
    let news = learned.map(|receiver| move || receiver.try_recv().ok());
    let ended =
        run::run(&settings, move || port.open(), &stop, record, news, |text| log.write(text));
    log.finish();
    ended?;
    Ok(CommandOutcome::Done)
}

/// Looks after the learned file next to the loop, which has no time to read files.
fn watch_learned_file(path: PathBuf, machine: Machine) -> Receiver<LearnedCorrectionUpdate> {
    let (sender, receiver) = mpsc::channel();
    std::thread::spawn(move || {
        let mut before = None;
        loop {
            let now =
                bounded_read::read_text(&path, MAX_MACHINE_FILE_BYTES).map_err(|error| error.rule);
            if before.as_ref() != Some(&now) {
                if sender.send(evaluate_learned_file(&machine, &path, &now)).is_err() {
                    return;
                }
                before = Some(now);
            }
            std::thread::sleep(LEARNED_FILE_POLL_INTERVAL);
        }
    });
    receiver
}

/// Returns what a learned file comes to for a bridge that runs on `machine`. One that cannot be read or is wrong
/// changes nothing.
fn evaluate_learned_file(
    machine: &Machine,
    path: &Path,
    text: &Result<String, String>,
) -> LearnedCorrectionUpdate {
    let name = path.display();
    let live = match text {
        Err(why) => Err(format!("{name}: {why}")),
        Ok(text) => MachineFile::parse(text, path)
            .and_then(|learned| LiveUpdate::from_difference(machine, &learned))
            .map_err(|error| error.to_string()),
    };
    match live {
        Err(why) => LearnedCorrectionUpdate {
            amounts: None,
            notices: vec![format!("nothing new was learned: {why}")],
        },
        Ok(LiveUpdate { amounts, rest }) => {
            let text = live_update::describe_amounts(&amounts.map(i32::from));
            let text = text
                .unwrap_or_else(|| "nothing: the learned values sent before are taken back".into());
            let mut messages = vec![format!("learned values sent to the bridge: {text}")];
            messages.extend(rest);
            LearnedCorrectionUpdate { amounts: Some(amounts), notices: messages }
        }
    }
}

#[allow(clippy::cast_possible_truncation, reason = "a cast of a float saturates")]
fn um_to_nm(um: f64) -> i32 {
    (um * f64::from(NANOMETRES_PER_MICROMETRE)).round() as i32
}

/// Reads the INI file with what it includes.
fn read_ini(path: &Path) -> Result<IniSettings> {
    let lines = IniFile::read(path).map_err(|error| UserError(error.to_string()))?;
    Ok(IniSettings::parse(&lines.to_text()).map_err(|error| {
        let place = lines.line_location(error.place.0, error.place.1);
        UserError(format!("{place}: {}", error.rule))
    })?)
}

#[cfg(test)]
mod tests {
    use super::*;

    const FILE: &str = "[machine]\nname = \"m\"\nkind = \"3-axis\"\n[spindle]\nsource = \"warmup\"\n[spindle.warmup]\n\
        lag_s = 60.0\nwarm_s = 5400.0\nmax_um = 80.0\nexponent = 4.0\n[limits]\nlearned = { growth_percent = 5 }\n";

    #[test]
    fn a_learned_file_says_its_change_and_one_that_cannot_be_read_nothing() {
        let machine = MachineFile::parse(FILE, Path::new("m.toml")).expect("right");
        let of = |text: Result<String, String>| {
            evaluate_learned_file(&machine, Path::new("l.toml"), &text)
        };
        let read = of(Ok(FILE.replace("80.0", "81.6")));
        assert_eq!(read.amounts, Some([2_000, 0, 0, 0, 0]));
        assert!(read.notices[0].ends_with("growth of the spindle +2.000 %"), "{:?}", read.notices);
        let same = of(Ok(FILE.into()));
        assert_eq!((same.amounts, same.notices.len()), (Some([0; 5]), 1));
        for bad in [Err("it is not there".into()), Ok(FILE.replace("80.0", "much"))] {
            let bad = of(bad);
            assert_eq!((bad.amounts, bad.notices.len()), (None, 1));
            assert!(
                bad.notices[0].starts_with("nothing new was learned: l.toml"),
                "{:?}",
                bad.notices
            );
        }
    }
}
