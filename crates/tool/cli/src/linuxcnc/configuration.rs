//! `trueup linuxcnc check`, `setup` and `status`: a user's configuration and what of ours is in it.

use std::path::{Path, PathBuf};

use anyhow::Result;
use clap::{Args, Subcommand};
use serde_json::{Value, json};
use trueup_client::port::PortAddress;
use trueup_linuxcnc::configuration::{
    OffsetEntryPoint,
    boardless_config::BoardlessConfig,
    check::{self, CheckReport},
    finding::{ConfigurationFinding, OffsetRequirements, Severity},
    hal_files::HalFiles,
    ini_file::{IniFile, expand_home},
    installed_setup::{self, BridgeSettings, InstalledSetup},
    joints,
    setup::{self, FileChange},
};
use trueup_linuxcnc::{
    joint_offsets::{JointSettings, MAX_JOINTS},
    status,
};
use trueup_machine::{Machine, check::Warning};

use super::{
    component::{self, ComponentArgs},
    hal_pins,
    keep::{self, KeepArgs},
};
use crate::{
    CommandOutcome, UserError, choice::described_choice_parser, input_files, output, report,
};

/// How often positions are sent over a serial line or CAN.
const POSITION_PERIOD_MS: u64 = 2;
const UM_PER_MM: f64 = 1e3;

/// Where offsets enter LinuxCNC.
pub const OFFSET_ENTRY_POINTS: [(OffsetEntryPoint, &str, &str); 2] = [
    (
        OffsetEntryPoint::Eoffset,
        "eoffset",
        "As external offsets of the axes: the planner gives them a share of speed and acceleration",
    ),
    (
        OffsetEntryPoint::Joint,
        "joint",
        "Between the joints and their drives, by moveoff: programs keep all of their speed",
    ),
];

/// The task on a configuration.
#[derive(Subcommand)]
pub enum Command {
    /// Checks a LinuxCNC configuration: what stands in the way of offsets, what they cost, how fast they are.
    ///
    /// Exit 3: something stands in the way. Exit 2: a file cannot be read.
    Check(CheckArgs),
    /// Puts offsets into a LinuxCNC configuration, or takes them out. Nothing is changed if the check finds an error.
    ///
    /// Written are two HAL files next to the INI file, and lines between marks in the INI file. A copy of each changed
    /// file is kept (FILE.trueup-backup). Exit 2: the check has found an error.
    Setup(SetupArgs),
    /// Builds and installs the realtime component of a bridge without a board, trueup_node.
    ///
    /// Needs Debian's linuxcnc-uspace-dev, and the library trueup_servo, which comes with trueup. Without --install the
    /// component is left in the folder of --out.
    Component(ComponentArgs),
    /// Keeps the heat of a machine without a board over a restart: copies it from the servo thread to a file.
    ///
    /// LinuxCNC starts it by the HAL file of setup; it ends by itself after LinuxCNC.
    Keep(KeepArgs),
    /// Says what setup has written, and, while LinuxCNC runs, what the offsets do.
    ///
    /// Exit 3: not set up, not up to date, or without live offsets.
    Status(StatusArgs),
}

/// The configuration to be checked.
#[derive(Args)]
pub struct CheckArgs {
    /// LinuxCNC's INI file.
    #[arg(value_name = "INI")]
    ini: PathBuf,
    /// Where offsets enter. Without this as it is set up, else at the joint.
    #[arg(long, value_parser = described_choice_parser(OFFSET_ENTRY_POINTS))]
    by: Option<OffsetEntryPoint>,
    /// The machine file that the bridge is loaded with: largest offset, slew limit, what it corrects.
    #[arg(long, value_name = "M.toml")]
    machine: Option<PathBuf>,
    /// The bridge runs in LinuxCNC's servo thread, without a board.
    #[arg(long)]
    no_board: bool,
}

/// The configuration to be set up.
#[derive(Args)]
pub struct SetupArgs {
    /// LinuxCNC's INI file.
    #[arg(value_name = "INI")]
    ini: PathBuf,
    /// Takes out what setup has written.
    #[arg(long, conflicts_with_all = ["by", "machine", "port", "no_board", "position_period_ms"])]
    remove: bool,
    /// Where offsets enter. Without this as it is set up, else at the joint.
    #[arg(long, value_parser = described_choice_parser(OFFSET_ENTRY_POINTS))]
    by: Option<OffsetEntryPoint>,
    /// The machine file that the bridge is loaded with.
    #[arg(long, value_name = "M.toml")]
    machine: Option<PathBuf>,
    /// The bridge runs in LinuxCNC's servo thread, without a board: the machine file is compiled to
    /// trueup_calibration.bin next to the INI file. Needs trueup linuxcnc component once on this computer.
    #[arg(long, conflicts_with_all = ["port", "position_period_ms"])]
    no_board: bool,
    /// Where the bridge is: tcp:HOST:PORT, a serial device, or can0. Needed the first time, or --no-board.
    #[arg(long, value_name = "PORT")]
    port: Option<String>,
    /// How often the position of a moving axis is sent.
    #[arg(long, value_name = "MS", value_parser = clap::value_parser!(u64).range(1..=100))]
    position_period_ms: Option<u64>,
}

/// The configuration to be looked at.
#[derive(Args)]
pub struct StatusArgs {
    /// LinuxCNC's INI file.
    #[arg(value_name = "INI")]
    ini: PathBuf,
}

/// A configuration with what of ours is in it.
struct Configuration {
    ini: IniFile,
    hal: HalFiles,
    installed: Option<InstalledSetup>,
}

impl Configuration {
    fn read(path: &Path) -> Result<Self> {
        let ini = IniFile::read(path)?;
        let hal = HalFiles::read(&ini)?;
        let installed = InstalledSetup::from_ini(&ini);
        Ok(Self { ini, hal, installed })
    }

    /// Where offsets enter, if the user does not say.
    fn resolve_offset_entry_point(&self, by: Option<OffsetEntryPoint>) -> OffsetEntryPoint {
        let here = self.installed.as_ref().map(|installed| installed.entry);
        let by_hand =
            || installed_setup::find_manual_setup(&self.ini, &self.hal).map(|setup| setup.1);
        by.or(here).or_else(by_hand).unwrap_or(OffsetEntryPoint::Joint)
    }

    /// Returns what is required of the offsets: without a board if the user says so, or if it is set up so.
    fn resolve_offset_requirements(
        &self,
        by: Option<OffsetEntryPoint>,
        no_board: bool,
        machine: Option<&(String, Machine)>,
    ) -> Result<OffsetRequirements> {
        let is_here =
            self.installed.as_ref().is_some_and(|installed| installed.bridge.port.is_none());
        derive_offset_requirements(
            self.resolve_offset_entry_point(by),
            no_board || is_here,
            machine,
        )
    }

    /// Returns the machine file as the INI file names it, else as the user does.
    fn read_machine(&self, given: Option<&Path>) -> Result<Option<(String, Machine)>> {
        let here =
            || self.installed.as_ref().and_then(|installed| installed.bridge.machine.clone());
        let (name, path) = match (given, here()) {
            (Some(path), _) => {
                (relative_or_absolute_path(path, self.ini.folder()), path.to_path_buf())
            }
            (None, Some(name)) => {
                let path = self.ini.folder().join(expand_home(&name));
                (name, path)
            }
            (None, None) => return Ok(None),
        };
        Ok(Some((name, input_files::read_machine(&path)?)))
    }
}

/// Returns what is required of the offsets. Without a board the machine file is compiled here.
fn derive_offset_requirements(
    entry: OffsetEntryPoint,
    no_board: bool,
    machine: Option<&(String, Machine)>,
) -> Result<OffsetRequirements> {
    let machine = machine.map(|machine| &machine.1);
    let of_file = OffsetRequirements::from_machine(entry, machine);
    if !no_board {
        return Ok(of_file);
    }
    let Some(machine) = machine else {
        return Err(UserError("--no-board needs the machine file: --machine M.toml".into()).into());
    };
    Ok(OffsetRequirements { no_board: Some(BoardlessConfig::from_machine(machine)?), ..of_file })
}

/// LinuxCNC runs in the folder of the INI file: a file in it goes by its name, any other by its whole path.
fn relative_or_absolute_path(path: &Path, folder: &Path) -> String {
    let whole = |path: &Path| std::fs::canonicalize(path).unwrap_or_else(|_| path.to_path_buf());
    let (path, folder) = (whole(path), whole(folder));
    path.strip_prefix(&folder).unwrap_or(&path).to_string_lossy().into_owned()
}

/// Returns how the joints of LinuxCNC's configuration are moved.
pub fn read_joint_settings(
    ini: Option<&Path>,
    slew_um_per_s: f64,
) -> Result<[Option<JointSettings>; MAX_JOINTS]> {
    let no_ini = || UserError("--by joint needs LinuxCNC's INI file: --ini FILE".into());
    let ini = IniFile::read(ini.ok_or_else(no_ini)?)?;
    let mm_per_unit = super::read_ini(ini.path())?.mm_per_unit;
    Ok(joints::build_joint_settings(&ini, mm_per_unit, slew_um_per_s / UM_PER_MM)?)
}

/// Returns where offsets at the joints lead beyond their limits, a sentence each.
pub fn find_joint_limit_violations(
    ini: Option<&Path>,
    machine: Option<&Machine>,
) -> Result<Vec<String>> {
    let Some(ini) = ini else { return Ok(Vec::new()) };
    let demand = OffsetRequirements::from_machine(OffsetEntryPoint::Joint, machine);
    let found = check::check_joint_limits(&IniFile::read(ini)?, &demand)?;
    Ok(found
        .iter()
        .map(|finding| format!("{}: {}; {}", finding.place, finding.what, finding.help))
        .collect())
}

/// Executes what the user requests.
pub fn run(command: &Command, as_json: bool) -> Result<CommandOutcome> {
    match command {
        Command::Check(args) => run_check(args, as_json),
        Command::Setup(args) if args.remove => run_setup_removal(args, as_json),
        Command::Setup(args) => run_setup(args, as_json),
        Command::Component(args) => component::run(args, as_json),
        Command::Keep(args) => keep::run(args),
        Command::Status(args) => run_status(args, as_json),
    }
}

fn run_check(args: &CheckArgs, as_json: bool) -> Result<CommandOutcome> {
    let configuration = Configuration::read(&args.ini)?;
    let machine = configuration.read_machine(args.machine.as_deref())?;
    let demand =
        configuration.resolve_offset_requirements(args.by, args.no_board, machine.as_ref())?;
    let found = check::check(&configuration.ini, &configuration.hal, &demand);
    print_report(&found, &demand, as_json)?;
    Ok(if found.is_usable() { CommandOutcome::Done } else { CommandOutcome::NotMet })
}

/// Facts on standard output, findings as errors and warnings.
fn print_report(found: &CheckReport, demand: &OffsetRequirements, as_json: bool) -> Result<()> {
    if as_json {
        let object = |finding: &ConfigurationFinding| {
            let severity = match finding.severity {
                Severity::Error => "error",
                Severity::Warning => "warning",
            };
            report::message_json(severity, &finding.what, Some(&finding.place), Some(&finding.help))
        };
        let findings: Vec<Value> = found.findings.iter().map(object).collect();
        return output::print(json!({
            "by": demand.entry.name(), "usable": found.is_usable(), "facts": found.facts, "findings": findings,
            "by_hand": found.by_hand,
        }));
    }
    for fact in &found.facts {
        output::print(fact)?;
    }
    print_findings(found);
    found.by_hand.iter().try_for_each(output::print)?;
    let errors =
        found.findings.iter().filter(|finding| finding.severity == Severity::Error).count();
    output::print(match (errors, found.findings.len()) {
        (0, 0) => "nothing stands in the way".to_string(),
        (0, warnings) => format!("nothing stands in the way; {warnings} to know"),
        (errors, all) => format!("{errors} in the way; {} to know", all - errors),
    })
}

fn print_findings(found: &CheckReport) {
    for ConfigurationFinding { severity, place, what, help } in &found.findings {
        let (place, what, help) = (place.clone(), what.clone(), help.clone());
        match severity {
            Severity::Warning => report::print_located_warning(&Warning { place, what, help }),
            Severity::Error => {
                let error = trueup_machine::InputFileError::new(place, what);
                report::print_input_file_error(if help.is_empty() {
                    error
                } else {
                    error.with_help(help)
                });
            }
        }
    }
}

fn run_setup(args: &SetupArgs, as_json: bool) -> Result<CommandOutcome> {
    let configuration = Configuration::read(&args.ini)?;
    let machine = configuration.read_machine(args.machine.as_deref())?;
    let demand = match args.port {
        // A board takes the place of none.
        Some(_) => derive_offset_requirements(
            configuration.resolve_offset_entry_point(args.by),
            false,
            machine.as_ref(),
        )?,
        None => {
            configuration.resolve_offset_requirements(args.by, args.no_board, machine.as_ref())?
        }
    };
    let before = configuration.installed.as_ref().map(|installed| &installed.bridge);
    let has_board = demand.no_board.is_none();
    let port = args.port.clone().or_else(|| before.and_then(|before| before.port.clone()));
    let port = port.filter(|_| has_board);
    if has_board && port.is_none() {
        return Err(UserError(
            "--port is missing: where is the bridge? A serial device, tcp:HOST:PORT, or can0; `trueup bridge list` \
             shows what is connected. Without a board: --no-board"
                .into(),
        )
        .into());
    }
    port.as_deref().map(PortAddress::parse).transpose()?;
    let period = args.position_period_ms.or(before.map(|before| before.position_period_ms));
    let bridge = BridgeSettings {
        port,
        machine: machine.map(|machine| machine.0),
        position_period_ms: period.unwrap_or(POSITION_PERIOD_MS),
    };
    let Configuration { ini, hal, .. } = &configuration;
    let (found, changes) = setup::prepare_setup(ini, hal, &demand, &bridge)?;
    if !found.is_usable() {
        print_findings(&found);
        found.by_hand.iter().try_for_each(output::print)?;
        return Err(UserError(format!(
            "{}: nothing was changed, because of the errors above",
            args.ini.display()
        ))
        .into());
    }
    if as_json {
        apply_file_changes(&changes)?;
        output::print(
            json!({"by": demand.entry.name(), "changed": changed_paths(&changes), "facts": found.facts}),
        )?;
        return Ok(CommandOutcome::Done);
    }
    // Before lines are added: a finding shows its line of the file.
    print_findings(&found);
    apply_file_changes(&changes)?;
    found.facts.iter().try_for_each(output::print)?;
    print_file_changes(&changes, "set up already; nothing was changed")?;
    output::print(format!("then: linuxcnc {}", args.ini.display()))?;
    Ok(CommandOutcome::Done)
}

fn run_setup_removal(args: &SetupArgs, as_json: bool) -> Result<CommandOutcome> {
    // HAL files may be gone meanwhile: they are not needed to take lines out.
    let changes = setup::prepare_removal(&IniFile::read(&args.ini)?)?;
    apply_file_changes(&changes)?;
    if as_json {
        output::print(json!({"changed": changed_paths(&changes)}))?;
    } else {
        print_file_changes(&changes, "nothing of setup is in it; nothing was changed")?;
    }
    Ok(CommandOutcome::Done)
}

fn changed_paths(changes: &[FileChange]) -> Vec<String> {
    changes.iter().map(|change| change.path.display().to_string()).collect()
}

fn print_file_changes(changes: &[FileChange], nothing: &str) -> Result<()> {
    for FileChange { path, content } in changes {
        let done = if content.is_some() { "written" } else { "removed" };
        output::print(format!("{done}: {}", path.display()))?;
    }
    if changes.is_empty() { output::print(nothing) } else { Ok(()) }
}

/// Writes all of them or none.
fn apply_file_changes(changes: &[FileChange]) -> Result<()> {
    let mut set = output::FileTransaction::new(&[]);
    for FileChange { path, content } in changes {
        match content {
            Some(content) => set.add(path, |out| out.write_all(content))?,
            None => set.remove(path)?,
        }
    }
    set.commit()
}

fn run_status(args: &StatusArgs, as_json: bool) -> Result<CommandOutcome> {
    let configuration = Configuration::read(&args.ini)?;
    let Configuration { ini, hal, installed } = &configuration;
    let mut lines = Vec::new();
    let mut is_well = true;
    match installed {
        Some(InstalledSetup { entry, bridge }) => {
            let machine = bridge.machine.as_deref().unwrap_or("no machine file");
            let at = bridge
                .port
                .as_ref()
                .map_or("without a board".into(), |port| format!("bridge at {port}"));
            lines.push(format!("set up by {}: {at}, {machine}", entry.name()));
            let machine = configuration.read_machine(None)?;
            let demand =
                derive_offset_requirements(*entry, bridge.port.is_none(), machine.as_ref())?;
            let (found, changes) = setup::prepare_setup(ini, hal, &demand, bridge)?;
            print_findings(&found);
            if !found.is_usable() || !changes.is_empty() {
                is_well = false;
                lines.push("the configuration has changed since: run setup again".into());
            }
        }
        None if installed_setup::find_manual_setup(ini, hal).is_some() => {
            lines.push("connected by hand".into())
        }
        None => {
            is_well = false;
            lines.push(format!(
                "not set up: trueup linuxcnc setup {} --port PORT",
                args.ini.display()
            ));
        }
    }
    let now = hal_pins::read_pins()?;
    match &now {
        None => lines.push("LinuxCNC does not run".into()),
        Some(pins) => {
            let (text, is_live) = status::describe_status(pins);
            lines.push(text);
            is_well &= is_live;
        }
    }
    if as_json {
        output::print(json!({"well": is_well, "lines": lines, "pins": now}))?;
    } else {
        lines.iter().try_for_each(output::print)?;
    }
    Ok(if is_well { CommandOutcome::Done } else { CommandOutcome::NotMet })
}
