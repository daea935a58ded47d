//! Workers on one folder: every job has one result, whatever happens to the threads; what is damaged is reported.

use std::{
    fs,
    sync::atomic::{AtomicUsize, Ordering},
    time::Duration,
};

use trueup_fleet::{
    job::{DiagnosisRequest, JobSubmission, SubmittedFile},
    job_result,
    store::FleetStore,
    worker::{DiagnoseFn, DiagnosisError, JobCounts, WorkerOptions, read_status, run_workers},
};

const OPTIONS: WorkerOptions =
    WorkerOptions { threads: 2, lease: Duration::from_secs(30), until_empty: true };

fn content(text: &str) -> SubmittedFile {
    SubmittedFile { path: "file".into(), bytes: text.into() }
}

fn submission(run: &str) -> JobSubmission {
    JobSubmission {
        machine: "m".into(),
        date: None,
        machine_file: content("[machine]"),
        runs: vec![content(run)],
        off: Vec::new(),
        holdout: Vec::new(),
        request: DiagnosisRequest::default(),
    }
}

fn store_with(jobs: usize) -> (tempfile::TempDir, FleetStore) {
    let folder = tempfile::tempdir().expect("a folder");
    let store = FleetStore::create(folder.path()).expect("it is made");
    for job in 0..jobs {
        submission(&job.to_string()).submit(&store).expect("it is written");
    }
    (folder, store)
}

/// The result of a job is its run, twice.
fn twice() -> &'static DiagnoseFn<'static> {
    &|loaded, _| Ok(vec![("twice.txt", loaded.runs[0].repeat(2))])
}

#[test]
fn each_job_is_done_once_by_the_threads_together() {
    let (_folder, store) = store_with(40);
    let done = AtomicUsize::new(0);
    let tally = run_workers(&store, OPTIONS, &|loaded, out| {
        done.fetch_add(1, Ordering::Relaxed);
        twice()(loaded, out)
    });
    assert_eq!(tally.expect("it is written"), JobCounts { done: 40, failed: 0 });
    assert_eq!(done.into_inner(), 40);
    let results = job_result::read_all_results(&store).expect("it is read");
    assert_eq!((results.whole.len(), results.damaged.len()), (40, 0));
    let status = read_status(&store).expect("it is read");
    assert_eq!((status.done.len(), status.waiting.len(), status.running.len()), (40, 0, 0));
    let again = run_workers(&store, OPTIONS, twice()).expect("it is read");
    assert_eq!(again, JobCounts::default(), "nothing is done again");
}

#[test]
fn a_job_that_fails_or_panics_has_a_reason_and_the_others_are_done() {
    let (_folder, store) = store_with(6);
    let tally = run_workers(&store, OPTIONS, &|loaded, out| match loaded.runs[0].as_slice() {
        b"1" => Err(DiagnosisError::Job("there is nothing in it".into())),
        b"2" => panic!("on purpose"),
        _ => twice()(loaded, out),
    });
    assert_eq!(tally.expect("it is written"), JobCounts { done: 4, failed: 2 });
    let failed = read_status(&store).expect("it is read").failed;
    let reasons: Vec<&str> = failed.iter().filter_map(|status| status.reason.as_deref()).collect();
    assert!(reasons.contains(&"there is nothing in it"), "{reasons:?}");
    assert!(reasons.iter().any(|reason| reason.contains("the program has failed")), "{reasons:?}");
    // Submitted again, it is tried again.
    assert!(!submission("1").submit(&store).expect("it is there").is_new);
    let tally = run_workers(&store, OPTIONS, twice()).expect("it is written");
    assert_eq!(tally, JobCounts { done: 1, failed: 0 });
}

#[test]
fn a_worker_that_cannot_go_on_gives_its_job_back_at_once() {
    let (_folder, store) = store_with(1);
    let one = WorkerOptions { threads: 1, ..OPTIONS };
    run_workers(&store, one, &|_, _| Err(DiagnosisError::Worker("no memory".into())))
        .expect_err("it ends");
    assert_eq!(read_status(&store).expect("it is read").waiting.len(), 1);
    let tally = run_workers(&store, one, twice()).expect("another one does it");
    assert_eq!(tally, JobCounts { done: 1, failed: 0 });
}

#[test]
fn a_lease_whose_owner_is_gone_ends_and_the_job_is_done() {
    let (folder, store) = store_with(1);
    let id = store.list_job_ids().expect("it is read").remove(0);
    // As a worker leaves it that was killed.
    fs::write(folder.path().join("leases").join(format!("{id}.1")), "gone 7").expect("a file");
    fs::create_dir(folder.path().join("tmp").join(format!("result-{id}-x"))).expect("a folder");
    let short = WorkerOptions { lease: Duration::from_millis(200), ..OPTIONS };
    assert_eq!(run_workers(&store, short, twice()).expect("it is done").done, 1);
    for left in ["leases", "tmp"] {
        let left = fs::read_dir(folder.path().join(left)).expect("it is read").count();
        assert_eq!(left, 0, "nothing is left");
    }
}

#[test]
fn a_slow_worker_keeps_its_job_and_two_results_are_one() {
    let (_folder, store) = store_with(1);
    let short = WorkerOptions { threads: 2, lease: Duration::from_millis(600), until_empty: true };
    let tries = AtomicUsize::new(0);
    let tally = run_workers(&store, short, &|loaded, out| {
        tries.fetch_add(1, Ordering::Relaxed);
        std::thread::sleep(Duration::from_millis(1500));
        twice()(loaded, out)
    });
    assert_eq!(tally.expect("it is done").done, 1);
    assert_eq!(tries.into_inner(), 1, "its lease is renewed");
}

#[test]
fn a_damaged_result_and_a_damaged_run_are_reported() {
    let (folder, store) = store_with(2);
    let ids = store.list_job_ids().expect("it is read");
    fs::write(store.job_folder(&ids[0]).join("run-1.csv"), "9").expect("it is written");
    let tally = run_workers(&store, OPTIONS, twice()).expect("it is written");
    assert_eq!(tally, JobCounts { done: 1, failed: 1 });
    let reason =
        read_status(&store).expect("it is read").failed[0].reason.clone().unwrap_or_default();
    assert!(reason.contains("checksum"), "{reason}");
    let file = folder.path().join("results").join(&ids[1]).join("out").join("twice.txt");
    fs::write(file, "99").expect("it is written");
    let results = job_result::read_all_results(&store).expect("it is read");
    assert_eq!((results.whole.len(), results.damaged.len()), (0, 1));
    assert!(results.damaged[0].contains("twice.txt"), "{:?}", results.damaged);
}
