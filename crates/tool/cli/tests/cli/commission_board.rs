//! `commission` on the real firmware in QEMU (`trueup virtual`), by a user who types in a terminal, in three
//! sittings. The machine is played here: the sensor shows 0.7 of what the spindle grows, and the gauge what
//! is left of it by the offsets that the board gives.
#![cfg(target_os = "linux")]

use std::{
    io::{BufRead as _, BufReader, Write as _},
    net::{TcpListener, TcpStream},
    process::{Child, Command, Stdio},
    sync::{Arc, Mutex},
    thread,
    time::{Duration, Instant},
};

use serde_json::{Value, json};
use trueup_emulator::firmware_images;
use trueup_machine::RunFile;

use crate::desk::Desk;
use crate::pretended::PAPER;
use crate::terminal::Terminal;

/// Of the paper's sensor.
const ZERO_COUNTS: f64 = 5_048.0;
const UM_PER_COUNT: f64 = 500.0 / 32_768.0;
/// The share of the growth that it shows.
const GAIN: f64 = 0.7;
const STEP_MS: u32 = 20;

/// The state of the machine, and the board's offset.
#[derive(Default)]
struct Now {
    growth_um: f64,
    offset_z_um: f64,
    lived_ms: u32,
    /// Its time passes as fast as it can: no program talks to the board.
    is_free: bool,
    is_over: bool,
}

impl Now {
    fn counts(&self) -> f64 {
        ZERO_COUNTS + GAIN * self.growth_um / UM_PER_COUNT
    }
}

/// The machine, and the virtual bridge that it plays for.
struct Shop {
    now: Arc<Mutex<Now>>,
    bridge: Child,
    port: String,
}

impl Shop {
    fn open(desk: &Desk) -> Self {
        let image =
            firmware_images::build_virtual_board_image().expect("it builds").display().to_string();
        let plant = TcpListener::bind("127.0.0.1:0").expect("a free port");
        let at = plant.local_addr().expect("bound above");
        let line =
            format!("virtual --machine m.toml --cnc tcp:127.0.0.1:0 --plant tcp:{at} --image");
        let mut bridge = Command::new(env!("CARGO_BIN_EXE_trueup"))
            .args(line.split(' '))
            .arg(image)
            .current_dir(desk.path("."))
            .stdin(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("the tool was built for this test");
        let (line, _) = plant.accept().expect("it connects to its plant");
        let mut stderr_lines = BufReader::new(bridge.stderr.take().expect("piped")).lines();
        let port = stderr_lines
            .by_ref()
            .map_while(Result::ok)
            .find_map(|line| Some(line.split_once("line is at ")?.1.replace(" (SLCAN)", "")))
            .expect("it says where it listens");
        // Its pipe must not fill.
        thread::spawn(move || stderr_lines.count());
        let now = Arc::<Mutex<Now>>::default();
        let played = now.clone();
        thread::spawn(move || play(&line, &played));
        Self { now, bridge, port }
    }

    fn now(&self) -> std::sync::MutexGuard<'_, Now> {
        self.now.lock().expect("no holder panics")
    }

    /// Types it where the bridge was started: the hand at the CNC.
    fn at_the_cnc(&mut self, word: &str) {
        let typed = self.bridge.stdin.as_mut().expect("piped");
        writeln!(typed, "{word}").expect("the bridge runs");
    }

    /// Returns what a gauge at the tip shows, positive out of the spindle: the offset lifts the tool.
    fn gauge_um(&self) -> f64 {
        let now = self.now();
        now.growth_um - now.offset_z_um
    }

    /// Lets this much of the board's time pass.
    fn live(&self, ms: u32) {
        let end = self.now().lived_ms + ms;
        while self.now().lived_ms < end {
            thread::sleep(Duration::from_millis(1));
        }
    }

    /// Runs the machine through the run file that the program came with, and fills it in. A reading a minute
    /// becomes three tenths of a second, in which the board follows at 20 µm/s.
    fn measure(&self, desk: &Desk, which: &str) {
        let template = desk.text(&format!("all/program/warmup-{which}.csv"));
        let mut rows = template.lines().filter(|line| !line.starts_with('#'));
        let head: Vec<&str> = rows.next().expect("a header").split(',').collect();
        let time = head.iter().position(|name| *name == "time_s").expect("its times");
        let mut text = head.join(",") + "\n";
        self.now().is_free = true;
        for (number, row) in rows.enumerate() {
            let mut cells: Vec<String> = row.split(',').map(str::to_owned).collect();
            let time_s: f64 = cells[time].parse().expect("a time");
            self.now().growth_um = 42.0 * (1.0 - (-time_s / 1_200.0).exp());
            self.live(300);
            let noise_um = [0.03, -0.05, 0.01, 0.06, -0.04, -0.01, 0.02, -0.02][number % 8];
            for (name, cell) in head.iter().zip(&mut cells) {
                match *name {
                    "measured_elongation_um" => {
                        *cell = format!("{:.2}", self.gauge_um() + noise_um)
                    }
                    "sensor_counts" => *cell = format!("{:.0}", self.now().counts()),
                    _ => {}
                }
            }
            text += &(cells.join(",") + "\n");
        }
        // It grows cold again.
        self.now().growth_um = 0.0;
        self.live(3_000);
        self.now().is_free = false;
        desk.write(&format!("measured {which}.csv"), text);
    }
}

impl Drop for Shop {
    fn drop(&mut self) {
        // Without its plant the bridge ends, and its emulator with it.
        if let Ok(mut now) = self.now.lock() {
            now.is_over = true;
        }
        let end = Instant::now() + Duration::from_secs(10);
        while matches!(self.bridge.try_wait(), Ok(None)) && Instant::now() < end {
            thread::sleep(Duration::from_millis(20));
        }
        self.bridge.kill().ok();
        self.bridge.wait().ok();
    }
}

/// The plant's side of its line: a step of JSON there, the offsets back.
fn play(mut line: &TcpStream, now: &Mutex<Now>) {
    line.set_nodelay(true).expect("a plain socket");
    let mut answers = BufReader::new(line.try_clone().expect("a plain socket")).lines();
    let mut due = Instant::now();
    loop {
        let step = {
            let mut now = now.lock().expect("no holder panics");
            if now.is_over {
                return;
            }
            now.lived_ms += STEP_MS;
            json!({
                "t_s": f64::from(now.lived_ms) / 1_000.0,
                "sensor_v": now.counts() * 10.0 / 32_768.0,
                "spindle_rpm": 24_000,
            })
        };
        let Ok(()) = writeln!(line, "{step}") else { return };
        let Some(Ok(answer)) = answers.next() else { return };
        let answer: Value = serde_json::from_str(&answer).expect("JSON");
        let is_free = {
            let mut now = now.lock().expect("no holder panics");
            // Not available is none.
            now.offset_z_um = answer["offset_um"][2].as_f64().unwrap_or(0.0);
            now.is_free
        };
        due = match is_free {
            true => Instant::now(),
            false => Instant::now().max(due + Duration::from_millis(STEP_MS.into())),
        };
        thread::sleep(due.saturating_duration_since(Instant::now()));
    }
}

#[test]
#[ignore = "long: the firmware in QEMU, three sittings of a commissioning"]
fn the_real_firmware_is_commissioned_in_three_sittings() {
    let desk = Desk::new(&[("m.toml", PAPER)]);
    let mut shop = Shop::open(&desk);
    let line = format!(
        "commission --machine m.toml --port {} --for linuxcnc --rpm 24000 --heat-s 3600 --out all",
        shop.port
    );
    shop.at_the_cnc("disengage");
    let sit = || Terminal::start(&desk, &line, (200, 50), true);

    // First sitting: the sign, typed as the gauge has it; then home, by Ctrl-C.
    let mut terminal = sit();
    terminal.shows(&["then engage at the CNC"]);
    shop.live(500);
    let before_um = shop.gauge_um();
    shop.at_the_cnc("engage");
    terminal.shows(&["how far has the housing moved, in µm"]);
    // The plant gets an offset a step after the bridge has sent it; on a loaded machine the terminal is faster.
    shop.live(500);
    let moved_um = shop.gauge_um() - before_um;
    terminal.press(&format!("{moved_um:.1}\r"));
    terminal.shows(&["the sign is right", "disengage at the CNC"]);
    shop.at_the_cnc("disengage");
    terminal.shows(&["run warmup from cold, without compensation; the filled-in run file:"]);
    terminal.press("\u{3}");
    assert!(!terminal.ended().success(), "it was interrupted");

    // Second sitting: it goes on with the measurement, fits, loads; no run is there yet.
    shop.measure(&desk, "off");
    let mut terminal = sit();
    terminal.shows(&["round 1: measure without compensation", "the filled-in run file:"]);
    assert!(!terminal.text().contains("sign test"), "{}", terminal.text());
    terminal.press("measured off.csv\r");
    terminal.shows(&["engage, run warmup again; the filled-in run file:"]);
    terminal.press("\r");
    assert_eq!(terminal.ended().code(), Some(3), "{}", terminal.text());

    // Third sitting: with compensation, and accepted.
    shop.at_the_cnc("engage");
    shop.live(1_000);
    shop.measure(&desk, "on");
    let mut terminal = sit();
    terminal.shows(&["round 1: measure with compensation", "the filled-in run file:"]);
    terminal.press("measured on.csv\r");
    terminal.shows(&["passed", "accepted; all of it is in all"]);
    assert_eq!(terminal.ended().code(), Some(0), "{}", terminal.text());

    // What the board runs on is what was fitted, and the gauge got the true value.
    shop.at_the_cnc("disengage");
    shop.live(1_000);
    let (out, _) = desk.run_expecting(
        &format!("bridge info --machine all/machine-1.toml --port {}", shop.port),
        0,
    );
    assert!(out.ends_with("all/machine-1.toml: the bridge runs on it\n"), "{out}");
    let rms_um = |run: &str| {
        let run = RunFile::read(&desk.path(run)).expect("a run file");
        let um = run.column("measured_elongation_um").expect("filled in");
        (um.iter().map(|um| um * um).sum::<f64>() / um.len() as f64).sqrt()
    };
    let [off_um, on_um] = ["all/off-1.csv", "all/on-1.csv"].map(rms_um);
    println!("the tip moved by {moved_um:.1} µm; {off_um:.2} µm RMS without, {on_um:.2} with");
    assert!((moved_um + 10.0).abs() < 0.2, "{moved_um}");
    assert!(off_um > 20.0 && on_um < 0.5, "{off_um} {on_um}");
    let log = desk.text("all/log.txt");
    for phrase in [
        "trueup bridge load all/sign.bin --yes",
        "trueup fit elongation --run all/off-1.csv",
        "trueup bridge load all/machine-1.bin --yes",
        "trueup accept --off all/off-1.csv --on all/on-1.csv",
    ] {
        assert_eq!(log.matches(phrase).count(), 1, "{phrase}: {log}");
    }
}
