//! A job of a fleet: from the files of a command line to what is stored, and from there to the files of a diagnosis.

use std::{
    fs,
    path::{Path, PathBuf},
};

use anyhow::Result;
use clap::ValueEnum as _;
use trueup_compare::dated;
use trueup_diagnose::{Named, NamedFit, Options, diagnose_for, fit_named};
use trueup_fleet::{
    constants::{self, Identity},
    job::{Content, Job, JobFile, Request, Submission},
    record::Record,
    result::Stored,
    store::{Store, checksum},
    structure::{Answered, Asked},
    worker::{self, Failure, Files, Loaded},
};
use trueup_machine::{BadInput, Machine, MachineFile, RunFile, file};

use crate::{
    diagnose::{Input, Quantity, RESIDUALS, made, with_instrument},
    files, origin, report,
};

/// The answer of a diagnosis, among its files.
pub const DIAGNOSIS: &str = "diagnosis.json";

/// Reads the files of a command line, as `trueup diagnose` does, into a job.
pub fn submission(
    input: &Input,
    name: Option<&str>,
    date: Option<dated::Day>,
) -> Result<Submission> {
    let source = MachineFile::read_text(&input.machine)?;
    let machine = with_instrument(files::parsed(&source, &input.machine)?, input.instrument_um);
    let content = |path: &Path, bytes: Vec<u8>| Content { path: path.display().to_string(), bytes };
    files::runs_of_known_names(&input.paths(), &machine)?;
    let all = |paths: &[PathBuf]| -> Result<Vec<Content>> {
        paths.iter().map(|path| Ok(content(path, fs::read(path)?))).collect()
    };
    let serial = machine.serial.clone().filter(|serial| !serial.is_empty());
    let machine_name = match (name, serial) {
        (Some(name), _) => name.to_string(),
        (None, Some(serial)) => serial,
        (None, None) => {
            report::warn(format_args!(
                "{} has no serial under [machine]: the job is of the machine \"{}\"; give --name SERIAL where several \
                 machines have this name",
                input.machine.display(),
                machine.name
            ));
            machine.name.clone()
        }
    };
    let named = input.runs.first().and_then(|path| path.file_name());
    let named = named.and_then(|name| dated::day_of(&name.to_string_lossy()));
    Ok(Submission {
        machine: machine_name,
        date: date.or(named).map(dated::text_of),
        runs: all(&input.runs)?,
        off: all(&input.off)?,
        holdout: all(&input.holdout)?,
        machine_file: content(&input.machine, source.into_bytes()),
        request: Request {
            quantity: input.quantity.map(|it| it.of_machine().name().to_string()),
            matters_um: input.matters_um,
            instrument_um: input.instrument_um,
            applied_once: input.applied_once,
            accept: files::accepted(),
        },
    })
}

/// Makes the diagnosis of a job, as `trueup diagnose` makes it of the files that were submitted.
pub fn diagnose(loaded: &Loaded, out: &Path) -> Result<Files, Failure> {
    answer(loaded, out).map_err(|error| {
        Failure::Job(match error.downcast::<BadInput>() {
            Ok(error) => format!("{}: {}", error.place, error.rule),
            Err(error) => format!("{error:#}"),
        })
    })
}

/// The files of a job, read.
struct Opened {
    source: String,
    machine: Machine,
    runs: Vec<RunFile>,
    holdout: Vec<RunFile>,
    options: Options,
}

fn open(loaded: &Loaded) -> Result<Opened> {
    let job = &loaded.job;
    let request = &job.request;
    files::accept_for_job(&request.accept);
    let path = Path::new(&job.machine_file.path);
    let source = String::from_utf8(loaded.machine_file.clone())?;
    let machine = with_instrument(files::parsed(&source, path)?, request.instrument_um);
    let read = |(file, bytes): (&JobFile, &Vec<u8>)| {
        RunFile::from_reader(bytes.as_slice(), Path::new(&file.path))
    };
    let read = stored(loaded).map(read).collect::<Result<Vec<_>, _>>()?;
    let mut runs = files::of_known_names(read, &machine)?;
    let holdout = runs.split_off(job.runs.len() + job.off.len());
    let options = Options {
        quantity: request.quantity.as_deref().and_then(quantity),
        matters_um: request.matters_um,
        is_applied_once: request.applied_once,
    };
    Ok(Opened { source, machine, runs, holdout, options })
}

/// The runs of a job, in the order of `Input::paths`.
fn stored(loaded: &Loaded) -> impl Iterator<Item = (&JobFile, &Vec<u8>)> {
    let job = &loaded.job;
    let all = [(&job.runs, &loaded.runs), (&job.off, &loaded.off), (&job.holdout, &loaded.holdout)];
    all.into_iter().flat_map(|(files, bytes)| files.iter().zip(bytes))
}

fn answer(loaded: &Loaded, out: &Path) -> Result<Files> {
    let Opened { source, machine, runs, holdout, options } = open(loaded)?;
    let machine_file = &loaded.job.machine_file.path;
    let diagnosis = diagnose_for(&machine, &runs, &holdout, options, &mut |_, _| {})?;
    let mut inputs = vec![(machine_file.as_str(), loaded.machine_file.as_slice())];
    inputs.extend(stored(loaded).map(|(file, bytes)| (file.path.as_str(), bytes.as_slice())));
    let origin = origin::of_read(&inputs);
    let texts = made(&diagnosis, (&source, Path::new(machine_file)), &origin, out)?;
    let mut files: Files =
        texts.into_iter().map(|(name, text)| (name, text.into_bytes())).collect();
    let mut residuals = Vec::new();
    diagnosis.write_residuals(&mut residuals)?;
    files.push((RESIDUALS, residuals));
    Ok(files)
}

/// Returns the constants of the causes that a series asks of a record.
pub fn fitted(store: &Store, id: &str, quantity: &str, asked: &Asked) -> Result<Answered, String> {
    let loaded = worker::loaded(store, id).map_err(|damage| damage.to_string())?;
    let Opened { machine, runs, options, .. } = open(&loaded).map_err(|why| format!("{why:#}"))?;
    let [together, alone] = [&asked.together, &asked.alone]
        .map(|list| list.iter().map(named).collect::<Vec<Named<'_>>>());
    let fits =
        fit_named(&machine, &runs, options, &together, &alone).map_err(|error| error.rule)?;
    let found = |named: &Named<'_>, fit: Option<NamedFit>| {
        let NamedFit { parameters, rms_before_um, rms_after_um } = fit?;
        let mut finding = serde_json::json!({
            "cause": named.cause, "claimed": false, "parameters": parameters,
            "gain": { "rms_before_um": rms_before_um, "rms_after_um": rms_after_um },
        });
        for (key, value) in [("column", named.column), ("form", named.form)] {
            if let Some(value) = value {
                finding[key] = value.into();
            }
        }
        let diagnosis = serde_json::json!({"quantity": quantity, "findings": [finding]});
        constants::found(&diagnosis).pop()
    };
    let all = |named: &[Named<'_>], fits: Vec<Option<NamedFit>>| {
        named.iter().zip(fits).map(|(named, fit)| found(named, fit)).collect()
    };
    Ok(Answered { together: all(&together, fits.together), alone: all(&alone, fits.alone) })
}

fn named(it: &Identity) -> Named<'_> {
    Named { cause: &it.cause, column: it.column.as_deref(), form: it.form.as_deref() }
}

/// Returns the quantity of this name.
fn quantity(name: &str) -> Option<file::Quantity> {
    Quantity::value_variants().iter().map(|it| it.of_machine()).find(|it| it.name() == name)
}

/// Returns what a result says of its machine.
pub fn record(store: &Store, stored: &Stored) -> Result<Record, String> {
    let done = &stored.done;
    let bytes = stored.files.get(DIAGNOSIS).ok_or("has no diagnosis.json")?;
    let diagnosis: serde_json::Value =
        serde_json::from_slice(bytes).map_err(|error| format!("{DIAGNOSIS}: {error}"))?;
    let quantity = diagnosis["quantity"].as_str().unwrap_or_default();
    let job = Job::read(store, &done.id).map_err(|damage| damage.to_string())?;
    let folder = store.job(&done.id);
    let source = job.bytes(&folder, &job.machine_file).map_err(|damage| damage.to_string())?;
    let source = String::from_utf8_lossy(&source);
    let machine = MachineFile::parse(&source, Path::new(&job.machine_file.path))
        .map_err(|error| error.rule)?;
    Ok(Record {
        machine: done.machine.clone(),
        day: done.date.as_deref().and_then(dated::day_of),
        verdict: diagnosis["verdict"].as_str().unwrap_or_default().into(),
        belief: belief(machine, quantity),
        quantity: quantity.into(),
        found: constants::found(&diagnosis),
        fitted: Vec::new(),
    })
}

/// Returns what a machine file believes of a quantity, whatever machine it is of, however it is connected, and wherever its
/// keys stand.
fn belief(machine: Machine, quantity: &str) -> String {
    let text = if quantity == file::Quantity::Elongation.name() {
        format!("{:?} {:?}", machine.spindle, machine.terms)
    } else {
        let plain = Machine {
            name: String::new(),
            serial: None,
            board: None,
            inputs: None,
            limits: Default::default(),
            places: Default::default(),
            ..machine
        };
        format!("{plain:?}")
    };
    checksum(text.as_bytes())
}
