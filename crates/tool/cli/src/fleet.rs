//! `trueup fleet`: jobs in a folder or on a NATS server, workers, and what the results say of a series; records of bridges
//! on that server.

mod job;
mod location;
mod records;
mod server;

use std::{io, path::PathBuf, time::Duration};

use anyhow::{Context as _, Result};
use clap::{Args, Subcommand};
use trueup_compare::dated_constants;
use trueup_fleet::{
    html_report, job_result, series,
    store::FleetStore,
    structure,
    worker::{self, JobCounts, JobStatus, WorkerOptions},
};

use self::location::{FleetBackend, FleetLocationArgs};
use crate::{
    CommandOutcome, UserError,
    diagnose::{self, parse_positive},
    output::{self, FileTransaction},
    provenance, report,
    trend::parse_day,
};

#[derive(Subcommand)]
pub enum Command {
    Submit(SubmitArgs),
    Worker(WorkerArgs),
    Status(StatusArgs),
    Diagnose(DiagnoseArgs),
    Server(server::ServerArgs),
    Records(records::RecordsArgs),
}

/// Puts a diagnosis of one machine into the folder, or on the server, for a worker.
///
/// The files are copied. The same content of the same machine is one job, however often it is submitted; a job that
/// failed is tried again.
#[derive(Args)]
pub struct SubmitArgs {
    #[command(flatten)]
    place: FleetLocationArgs,
    /// The machine. Default: the serial number in the machine file, else its name.
    #[arg(long, value_name = "SERIAL")]
    name: Option<String>,
    /// The day of the record, 2026-11-22. Default: the date in the name of the first run file.
    #[arg(long, value_name = "DATE", value_parser = parse_day)]
    date: Option<dated_constants::EpochDay>,
    #[command(flatten)]
    input: diagnose::DiagnosisInput,
}

/// Does the jobs, as many at once as it has threads.
///
/// Any number of workers may share the folder or the server. One that is killed loses nothing: its lease ends, and
/// another worker takes the job. Exit 3 with --until-empty: a job has failed.
#[derive(Args)]
pub struct WorkerArgs {
    #[command(flatten)]
    place: FleetLocationArgs,
    /// Jobs at once, each on one core.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..=256))]
    threads: u16,
    /// End once every job has a result or has failed. Default: wait for more jobs.
    #[arg(long)]
    until_empty: bool,
    /// How long a worker may be silent before another one takes its job, in s. On a server it is one for all workers: it
    /// is set while none of them has a job.
    #[arg(long, value_name = "S", default_value_t = 10.0, value_parser = parse_positive)]
    lease_s: f64,
}

/// Shows which jobs wait, run, are done and have failed.
#[derive(Args)]
pub struct StatusArgs {
    #[command(flatten)]
    place: FleetLocationArgs,
}

/// Shows what the results say of the series: common constants, odd and drifting machines, the next measurement.
///
/// Files on a server are copied to OUT/copy first, the result of each job among them. Exit 3: a machine is unlike the
/// others, or drifts.
#[derive(Args)]
pub struct DiagnoseArgs {
    #[command(flatten)]
    place: FleetLocationArgs,
    /// The folder for fleet.json and report.html.
    #[arg(long, value_name = "OUT")]
    out: PathBuf,
}

pub fn run(command: &Command, as_json: bool) -> Result<CommandOutcome> {
    match command {
        Command::Submit(args) => submit_job(args, as_json),
        Command::Worker(args) => run_worker(args, as_json),
        Command::Status(args) => print_status(args, as_json),
        Command::Diagnose(args) => diagnose(args, as_json),
        Command::Server(args) => server::run(args, as_json),
        Command::Records(args) => records::run(args),
    }
}

fn submit_job(args: &SubmitArgs, as_json: bool) -> Result<CommandOutcome> {
    let submission = job::read_submission(&args.input, args.name.as_deref(), args.date)?;
    let submitted = match args.place.create_backend()? {
        FleetBackend::Folder(store) => submission.submit(&store),
        FleetBackend::Server(remote) => remote.submit(&submission),
    };
    let submitted = submitted.context("the job cannot be submitted")?;
    if let Some(date) = &submitted.other_date {
        report::print_warning(format_args!(
            "job {} was submitted before with another date ({date}), which stays",
            submitted.id
        ));
    }
    let machine = &submission.machine;
    if as_json {
        output::print(serde_json::json!({
            "id": submitted.id, "machine": machine, "new": submitted.is_new, "date": submission.date,
        }))?;
    } else {
        let state = if submitted.is_new { "waits for a worker" } else { "was there already" };
        output::print(format_args!("job {} of {machine} {state}", submitted.id))?;
        output::print(format_args!(
            "then: trueup fleet worker {} --until-empty",
            args.place.command_options()
        ))?;
    }
    Ok(CommandOutcome::Done)
}

fn run_worker(args: &WorkerArgs, as_json: bool) -> Result<CommandOutcome> {
    let opened = args.place.open_backend()?;
    let options = WorkerOptions {
        threads: usize::from(args.threads),
        lease: Duration::from_secs_f64(args.lease_s),
        until_empty: args.until_empty,
    };
    // What is doubtful in the files was reported when they were submitted.
    let worked = report::with_warnings_enabled(false, || match &opened {
        FleetBackend::Folder(store) => worker::run_workers(store, options, &job::diagnose),
        FleetBackend::Server(remote) => {
            remote.run_workers(options, &job::diagnose, &|text| report::print_warning(text))
        }
    });
    let JobCounts { done, failed } = worked.with_context(|| args.place.to_string())?;
    let status = opened.status()?;
    if as_json {
        output::print(serde_json::json!({"done": done, "failed": failed}))?;
    } else {
        output::print(format_args!("{done} done, {failed} failed by this worker"))?;
        print_failed_jobs(&status.failed)?;
    }
    Ok(if status.failed.is_empty() { CommandOutcome::Done } else { CommandOutcome::NotMet })
}

fn print_failed_jobs(failed: &[JobStatus]) -> Result<()> {
    failed.iter().try_for_each(|status| {
        let reason = status.reason.as_deref().unwrap_or("no reason is stored");
        output::print(format_args!("  failed {} {}: {reason}", status.id, status.machine))
    })
}

fn print_status(args: &StatusArgs, as_json: bool) -> Result<CommandOutcome> {
    let opened = args.place.open_backend()?;
    let status = opened.status()?;
    if as_json {
        output::print(serde_json::to_string_pretty(&status)?)?;
        return Ok(CommandOutcome::Done);
    }
    output::print(format_args!(
        "{} waiting, {} running, {} done, {} failed",
        status.waiting.len(),
        status.running.len(),
        status.done.len(),
        status.failed.len()
    ))?;
    for (state, entries) in [("waiting", &status.waiting), ("running", &status.running)] {
        for JobStatus { id, machine, taken, .. } in entries {
            let taken = taken.filter(|taken| *taken > 1);
            let taken = taken.map_or(String::new(), |count| format!(", taken {count} times"));
            output::print(format_args!("  {state} {id} {machine}{taken}"))?;
        }
    }
    for JobStatus { id, machine, .. } in &status.done {
        let report = match &opened {
            FleetBackend::Folder(store) => {
                format!(": {}", store.result_folder(id).join("out").join("report.html").display())
            }
            FleetBackend::Server(_) => String::new(),
        };
        output::print(format_args!("  done {id} {machine}{report}"))?;
    }
    print_failed_jobs(&status.failed)?;
    Ok(CommandOutcome::Done)
}

fn diagnose(args: &DiagnoseArgs, as_json: bool) -> Result<CommandOutcome> {
    let (store, mut notes) = match args.place.open_backend()? {
        FleetBackend::Folder(store) => (store, Vec::new()),
        FleetBackend::Server(remote) => {
            let store = FleetStore::create(&args.out.join("copy"))?;
            let damaged = remote.fetch_results(&store).map_err(|error| match error.kind() {
                io::ErrorKind::AlreadyExists => UserError(error.to_string()).into(),
                _ => anyhow::Error::from(error),
            })?;
            (store, damaged)
        }
    };
    let job_result::StoredResults { whole, damaged } = job_result::read_all_results(&store)?;
    notes.extend(damaged);
    let (mut records, mut ids) = (Vec::new(), Vec::new());
    for stored in &whole {
        match job::build_machine_record(&store, stored) {
            Ok(record) => {
                records.push(record);
                ids.push(stored.done.id.as_str());
            }
            Err(why) => notes.push(format!("results/{}: {why}", stored.done.id)),
        }
    }
    notes.iter().for_each(report::print_warning);
    if records.is_empty() {
        let rule = "has no result: trueup fleet worker makes them";
        return Err(UserError(format!("{}: {rule}", args.place)).into());
    }
    let requested = structure::select_causes_to_fit(&records);
    for ((id, record), requested) in ids.iter().zip(&mut records).zip(requested) {
        let Some(requested) = requested else { continue };
        match report::with_warnings_enabled(false, || {
            job::fit_constants(&store, id, &record.quantity, &requested)
        }) {
            Ok(answered) => record.replace_constants(answered),
            Err(why) => {
                report::print_warning(format_args!("results/{id}: {why}"));
                notes.push(format!("results/{id}: {why}"));
            }
        }
    }
    let series = series::evaluate_series(&records, notes);
    let json = serde_json::to_string_pretty(&series)?;
    let read: Vec<(&str, &[u8])> = whole
        .iter()
        .filter_map(|result| {
            Some((result.done.id.as_str(), result.files.get(job::DIAGNOSIS_FILE)?.as_slice()))
        })
        .collect();
    let html = html_report::render_html(
        &series,
        &args.place.to_string(),
        &provenance::provenance_from_contents(&read),
    );
    output::create_folder(&args.out)?;
    let mut set = FileTransaction::new(&[]);
    set.add_texts(&args.out, [("fleet.json", format!("{json}\n")), ("report.html", html)])?;
    set.commit()?;
    let conspicuous = html_report::anomaly_sentences(&series);
    if as_json {
        output::print(json)?;
    } else {
        let results = records.len();
        output::print(format_args!("{} machines, {results} results", series.machines.len()))?;
        for it in &conspicuous {
            output::print(it)?;
        }
        for it in series.constants.iter().filter(|constant| constant.machines > 1) {
            let [value, low, high] = trueup_page::format_with_interval(it.mean.value, it.mean.ci95);
            output::print(format_args!(
                "{}: {value} ({low} to {high}) on {} machines",
                it.name, it.machines
            ))?;
        }
        if let Some(next) = series.next.first() {
            output::print(format_args!("next: {}", next.sentence))?;
        }
        output::print(args.out.join("report.html").display())?;
    }
    Ok(if conspicuous.is_empty() { CommandOutcome::Done } else { CommandOutcome::NotMet })
}
