//! A job of a fleet: from the files of a command line to what is stored, and from there to the files of a diagnosis.

use std::{
    fs,
    path::{Path, PathBuf},
};

use anyhow::Result;
use trueup_compare::dated_constants;
use trueup_diagnose::{
    DiagnosisOptions, NamedCause, NamedCauseFit, diagnose_with_options, fit_named_causes,
};
use trueup_fleet::{
    findings::{self, CauseIdentity},
    job::{DiagnosisRequest, Job, JobFile, JobSubmission, SubmittedFile},
    job_result::StoredResult,
    record::MachineRecord,
    store::{FleetStore, compute_checksum},
    structure::{FitRequest, FittedConstants},
    worker::{self, DiagnosisError, DiagnosisFiles, LoadedJob},
};
use trueup_machine::{InputFileError, Machine, MachineFile, RunFile, machine_file};

use crate::{
    diagnose::{
        DiagnosisInput, RESIDUALS_FILE, render_diagnosis_files, with_instrument_uncertainty_um,
    },
    input_files, provenance, report,
};

/// The answer of a diagnosis, among its files.
pub const DIAGNOSIS_FILE: &str = "diagnosis.json";

/// Reads the files of a command line, as `trueup diagnose` does, into a job.
pub fn read_submission(
    input: &DiagnosisInput,
    name: Option<&str>,
    date: Option<dated_constants::EpochDay>,
) -> Result<JobSubmission> {
    let source = MachineFile::read_text(&input.machine)?;
    let machine = with_instrument_uncertainty_um(
        input_files::parse_machine(&source, &input.machine)?,
        input.instrument_um,
    );
    let content =
        |path: &Path, bytes: Vec<u8>| SubmittedFile { path: path.display().to_string(), bytes };
    input_files::read_runs_lenient(&input.run_paths(), &machine)?;
    let all = |paths: &[PathBuf]| -> Result<Vec<SubmittedFile>> {
        paths.iter().map(|path| Ok(content(path, fs::read(path)?))).collect()
    };
    let serial = machine.serial.clone().filter(|serial| !serial.is_empty());
    let machine_name = match (name, serial) {
        (Some(name), _) => name.to_string(),
        (None, Some(serial)) => serial,
        (None, None) => {
            report::print_warning(format_args!(
                "{} has no serial under [machine]: the job is of the machine \"{}\"; give --name SERIAL where several \
                 machines have this name",
                input.machine.display(),
                machine.name
            ));
            machine.name.clone()
        }
    };
    let named = input.runs.first().and_then(|path| path.file_name());
    let named =
        named.and_then(|name| dated_constants::find_date_in_file_name(&name.to_string_lossy()));
    Ok(JobSubmission {
        machine: machine_name,
        date: date.or(named).map(dated_constants::format_day),
        runs: all(&input.runs)?,
        off: all(&input.off)?,
        holdout: all(&input.holdout)?,
        machine_file: content(&input.machine, source.into_bytes()),
        request: DiagnosisRequest {
            quantity: input.quantity.map(|quantity| quantity.name().to_string()),
            matters_um: input.matters_um,
            instrument_um: input.instrument_um,
            applied_once: input.applied_once,
            accept: input_files::accepted_keys(),
        },
    })
}

/// Makes the diagnosis of a job, as `trueup diagnose` makes it of the files that were submitted.
pub fn diagnose(loaded: &LoadedJob, out: &Path) -> Result<DiagnosisFiles, DiagnosisError> {
    run_diagnosis(loaded, out).map_err(|error| {
        DiagnosisError::Job(match error.downcast::<InputFileError>() {
            Ok(error) => format!("{}: {}", error.place, error.rule),
            Err(error) => format!("{error:#}"),
        })
    })
}

/// The files of a job, read.
struct ParsedJobFiles {
    source: String,
    machine: Machine,
    runs: Vec<RunFile>,
    holdout: Vec<RunFile>,
    options: DiagnosisOptions,
}

fn parse_job_files(loaded: &LoadedJob) -> Result<ParsedJobFiles> {
    let job = &loaded.job;
    let request = &job.request;
    input_files::set_job_accepted_keys(&request.accept);
    let path = Path::new(&job.machine_file.path);
    let source = String::from_utf8(loaded.machine_file.clone())?;
    let machine = with_instrument_uncertainty_um(
        input_files::parse_machine(&source, path)?,
        request.instrument_um,
    );
    let read = |(file, bytes): (&JobFile, &Vec<u8>)| {
        RunFile::from_reader(bytes.as_slice(), Path::new(&file.path))
    };
    let read = stored_runs(loaded).map(read).collect::<Result<Vec<_>, _>>()?;
    let mut runs = input_files::prepare_runs_lenient(read, &machine)?;
    let holdout = runs.split_off(job.runs.len() + job.off.len());
    let options = DiagnosisOptions {
        quantity: request.quantity.as_deref().and_then(parse_quantity),
        matters_um: request.matters_um,
        is_applied_once: request.applied_once,
    };
    Ok(ParsedJobFiles { source, machine, runs, holdout, options })
}

/// The runs of a job, in the order of `Input::run_paths`.
fn stored_runs(loaded: &LoadedJob) -> impl Iterator<Item = (&JobFile, &Vec<u8>)> {
    let job = &loaded.job;
    let all = [(&job.runs, &loaded.runs), (&job.off, &loaded.off), (&job.holdout, &loaded.holdout)];
    all.into_iter().flat_map(|(files, bytes)| files.iter().zip(bytes))
}

fn run_diagnosis(loaded: &LoadedJob, out: &Path) -> Result<DiagnosisFiles> {
    let ParsedJobFiles { source, machine, runs, holdout, options } = parse_job_files(loaded)?;
    let machine_file = &loaded.job.machine_file.path;
    let diagnosis = diagnose_with_options(&machine, &runs, &holdout, options, &mut |_, _| {})?;
    let mut inputs = vec![(machine_file.as_str(), loaded.machine_file.as_slice())];
    inputs.extend(stored_runs(loaded).map(|(file, bytes)| (file.path.as_str(), bytes.as_slice())));
    let origin = provenance::provenance_from_contents(&inputs);
    let texts =
        render_diagnosis_files(&diagnosis, (&source, Path::new(machine_file)), &origin, out)?;
    let mut files: DiagnosisFiles =
        texts.into_iter().map(|(name, text)| (name, text.into_bytes())).collect();
    let mut residuals = Vec::new();
    diagnosis.write_residuals(&mut residuals)?;
    files.push((RESIDUALS_FILE, residuals));
    Ok(files)
}

/// Returns the constants of the causes that a series requires of a record.
pub fn fit_constants(
    store: &FleetStore,
    id: &str,
    quantity: &str,
    requested: &FitRequest,
) -> Result<FittedConstants, String> {
    let loaded = worker::load_job(store, id).map_err(|damage| damage.to_string())?;
    let ParsedJobFiles { machine, runs, options, .. } =
        parse_job_files(&loaded).map_err(|why| format!("{why:#}"))?;
    let [together, alone] = [&requested.together, &requested.alone]
        .map(|list| list.iter().map(to_named_cause).collect::<Vec<NamedCause<'_>>>());
    let fits = fit_named_causes(&machine, &runs, options, &together, &alone)
        .map_err(|error| error.rule)?;
    let found = |named: &NamedCause<'_>, fit: Option<NamedCauseFit>| {
        let NamedCauseFit { parameters, rms_before_um, rms_after_um } = fit?;
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
        findings::parse_findings(&diagnosis).pop()
    };
    let all = |named: &[NamedCause<'_>], fits: Vec<Option<NamedCauseFit>>| {
        named.iter().zip(fits).map(|(named, fit)| found(named, fit)).collect()
    };
    Ok(FittedConstants { together: all(&together, fits.together), alone: all(&alone, fits.alone) })
}

fn to_named_cause(it: &CauseIdentity) -> NamedCause<'_> {
    NamedCause { cause: &it.cause, column: it.column.as_deref(), form: it.form.as_deref() }
}

/// Returns the quantity of this name.
fn parse_quantity(name: &str) -> Option<machine_file::Quantity> {
    machine_file::Quantity::ALL.into_iter().find(|quantity| quantity.name() == name)
}

/// Returns what a result says of its machine.
pub fn build_machine_record(
    store: &FleetStore,
    stored: &StoredResult,
) -> Result<MachineRecord, String> {
    let done = &stored.done;
    let bytes = stored.files.get(DIAGNOSIS_FILE).ok_or("has no diagnosis.json")?;
    let diagnosis: serde_json::Value =
        serde_json::from_slice(bytes).map_err(|error| format!("{DIAGNOSIS_FILE}: {error}"))?;
    let quantity = diagnosis["quantity"].as_str().unwrap_or_default();
    let job = Job::read(store, &done.id).map_err(|damage| damage.to_string())?;
    let folder = store.job_folder(&done.id);
    let source = job.read_file(&folder, &job.machine_file).map_err(|damage| damage.to_string())?;
    let source = String::from_utf8_lossy(&source);
    let machine = MachineFile::parse(&source, Path::new(&job.machine_file.path))
        .map_err(|error| error.rule)?;
    Ok(MachineRecord {
        machine: done.machine.clone(),
        day: done.date.as_deref().and_then(dated_constants::find_date_in_file_name),
        verdict: diagnosis["verdict"].as_str().unwrap_or_default().into(),
        belief: model_fingerprint(machine, quantity),
        quantity: quantity.into(),
        found: findings::parse_findings(&diagnosis),
        fitted: Vec::new(),
    })
}

/// Returns what a machine file believes of a quantity, whatever machine it is of, however it is connected, and wherever its
/// keys stand.
fn model_fingerprint(machine: Machine, quantity: &str) -> String {
    let text = if quantity == machine_file::Quantity::Elongation.name() {
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
    compute_checksum(text.as_bytes())
}
