//! The first day as the book has it (`first-day.md`): three terminals, from a bare `trueup new` to a corrected virtual
//! mill and a corrected virtual lathe, on the real firmware in QEMU. Nothing is typed that does not stand in a page of
//! the book, or was printed by a command before.
#![cfg(target_os = "linux")]

use std::{
    fs,
    net::TcpListener,
    os::unix::fs::PermissionsExt as _,
    path::Path,
    thread,
    time::{Duration, Instant},
};

use trueup_emulator::firmware_images;
use trueup_machine::RunFile;

use crate::{
    desk::Desk,
    terminal::{PROMPT, Terminal},
};

/// The ports of the page.
const PORTS: [u16; 2] = [3333, 3334];
const DOWN: &str = "\u{1b}[B";
const PAGE: &str = include_str!("../../../../../docs/book/src/first-day.md");
/// The last questions of `trueup new` and their answers, the same for both machines.
const LAST_ANSWERS: [(&str, &str); 6] = [
    ("displacement sensor at the spindle? y or n [y]", "\r"),
    ("the end of its range, in V [10]", "\r"),
    ("for one volt", "50\r"),
    ("when the machine is cold, in V [5]", "1.54\r"),
    ("A PT100", "\r"),
    ("> LinuxCNC", "\r"),
];
/// As many readings of the gauge as the page says, and the time between two of them.
const READINGS: usize = 12;
const BETWEEN: Duration = Duration::from_secs(2);

/// Returns every page of the book as one text.
fn book() -> String {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../docs/book/src");
    let pages =
        fs::read_dir(folder).expect("the book").map(|entry| entry.expect("readable").path());
    let pages = pages.filter(|path| path.extension().is_some_and(|extension| extension == "md"));
    pages.map(|path| fs::read_to_string(path).expect("text")).collect()
}

/// Returns whether a page has `line` as a line of a block, or between backticks.
fn is_in_book(book: &str, line: &str) -> bool {
    book.lines().any(|other| other.trim() == line) || book.contains(&format!("`{line}`"))
}

/// Three terminals in one folder: where commands are typed, where the bridge runs, where the gauge is recorded.
struct Shop {
    book: String,
    desk: Desk,
    work: Terminal,
    bridge: Terminal,
    gauge: Terminal,
    typed: Vec<String>,
}

impl Shop {
    fn open() -> Self {
        let desk = Desk::new(&[]);
        // An installed tool carries the firmware; the one of the tests is given it.
        let image = firmware_images::build_virtual_board_image().expect("it builds");
        fs::create_dir(desk.path(".bin")).expect("a new folder");
        let (tool, image) = (env!("CARGO_BIN_EXE_trueup"), image.display());
        desk.write(
            ".bin/trueup",
            format!(
                "#!/bin/sh\n[ \"$1\" = virtual ] && exec {tool} \"$@\" --image {image}\nexec {tool} \"$@\"\n"
            ),
        );
        let executable = fs::Permissions::from_mode(0o755);
        fs::set_permissions(desk.path(".bin/trueup"), executable).expect("it is ours");
        let [work, bridge, gauge] = [(160, 60), (160, 60), (100, 30)].map(|size| {
            let terminal = Terminal::shell(&desk, size);
            terminal.shows(&[PROMPT]);
            terminal
        });
        Self { book: book(), desk, work, bridge, gauge, typed: Vec::new() }
    }

    /// Types a line at a terminal, which must stand in the book or have been printed.
    fn type_at(&mut self, which: fn(&mut Self) -> &mut Terminal, line: &str) {
        let printed: String = [&self.work, &self.bridge, &self.gauge]
            .iter()
            .map(|terminal| terminal.printed())
            .collect();
        assert!(
            is_in_book(&self.book, line) || printed.lines().any(|other| other.contains(line)),
            "`{line}` stands in no page and was not printed"
        );
        which(self).press(&format!("{line}\r"));
        self.typed.push(line.to_string());
    }

    /// Types a command and waits until it has ended well.
    fn run(&mut self, line: &str) {
        self.work.clear();
        self.type_at(|shop| &mut shop.work, line);
        let text = self.work.shows(&[PROMPT]);
        assert!(text.contains(&format!("0{PROMPT}")), "{line}: {text}");
    }

    /// Types a word at the terminal of the bridge, and returns what was answered.
    fn at_the_bridge(&mut self, word: &str, answer: &str) -> String {
        self.bridge.clear();
        self.type_at(|shop| &mut shop.bridge, word);
        self.bridge.shows(&[answer])
    }

    /// Returns how far the housing or turret has moved, as the virtual gauge there shows it.
    fn moved_um(&mut self) -> f64 {
        let text = self.at_the_bridge("gauge", "(+ the way the tool points)");
        let shown = text.split(" one at the ").nth(1).and_then(|part| part.split(' ').nth(1));
        shown.and_then(|text| text.parse().ok()).unwrap_or_else(|| panic!("no reading: {text}"))
    }

    /// Records a run from cold with as many readings as the page says.
    fn record(&mut self, line: &str) {
        self.at_the_bridge("again", "the run begins again");
        self.gauge.clear();
        self.type_at(|shop| &mut shop.gauge, line);
        self.gauge.shows(&["REC", "gauge elongation"]);
        for number in 1..=READINGS {
            self.gauge.press("g");
            let readings =
                if number == 1 { "1 reading".into() } else { format!("{number} readings") };
            self.gauge.shows(&[&readings]);
            thread::sleep(BETWEEN);
        }
        self.gauge.press("q");
        self.gauge.shows(&[PROMPT]);
    }

    /// Checks that no command was left out that the page has for this machine.
    fn check_page(&self, name: &str) {
        let other = if name == "mill" { "lathe" } else { "mill" };
        let is_for_it = |line: &&str| line.starts_with("trueup ") && !line.contains(other);
        for line in PAGE.lines().filter(is_for_it) {
            assert!(self.typed.iter().any(|typed| typed == line), "`{line}` was not typed");
        }
    }

    fn rms_um(&self, run: &str) -> f64 {
        let run = RunFile::read(&self.desk.path(run)).expect("a run file");
        let um = run.column("measured_elongation_um").expect("the gauge's column");
        let um: Vec<f64> = um.iter().copied().filter(|um| !um.is_nan()).collect();
        assert_eq!(um.len(), READINGS);
        (um.iter().map(|um| um * um).sum::<f64>() / um.len() as f64).sqrt()
    }
}

/// Waits for the ports of the page: the same test of another working copy may have them.
fn wait_for_ports() {
    let start = Instant::now();
    while PORTS.iter().any(|port| TcpListener::bind(("127.0.0.1", *port)).is_err()) {
        assert!(start.elapsed() < Duration::from_secs(600), "the ports {PORTS:?} are in use");
        thread::sleep(Duration::from_millis(500));
    }
}

/// Goes the way of the page with the machine `name`, whose questions are answered by `answers`.
fn correct(name: &str, answers: &[(&str, &str)]) -> String {
    wait_for_ports();
    let mut shop = Shop::open();
    let rpm = if name == "mill" { "12000" } else { "6000" };
    let of = |line: &str| line.replace("mill", name).replace("RPM", rpm);

    // The machine file.
    shop.type_at(|shop| &mut shop.work, "trueup new");
    for (requested, answer) in answers.iter().chain(&LAST_ANSWERS) {
        shop.work.shows(&[requested]);
        shop.work.press(answer);
        let text = answer.strip_suffix('\r').unwrap_or_default();
        assert!(
            text.is_empty() || PAGE.contains(&format!("`{text}`")),
            "`{text}`: not in the page"
        );
    }
    shop.work.shows(&[&of("mill.toml: written"), &format!("0{PROMPT}")]);
    shop.run(&of("trueup check mill.toml"));

    // The virtual machine.
    shop.run("trueup examples try");
    shop.run(&of("trueup simulate --scenario try/scenario-mill.toml --seed 1 -o mill-day.csv"));
    let line = of(
        "trueup virtual --machine mill.toml --run mill-day.csv --gauge tcp:127.0.0.1:3334 --speed 20",
    );
    shop.type_at(|shop| &mut shop.bridge, &line);
    shop.bridge.shows(&["the CNC's line is at tcp:127.0.0.1:3333", "the bridge is up"]);
    shop.at_the_bridge("disengage", "the CNC has disengaged");
    shop.run(&of("trueup bridge info --machine mill.toml --port tcp:127.0.0.1:3333"));

    // The sign.
    shop.work.clear();
    let line = of(
        "trueup commission --machine mill.toml --port tcp:127.0.0.1:3333 --for linuxcnc --rpm RPM --out mill-work",
    );
    shop.type_at(|shop| &mut shop.work, &line);
    shop.work.shows(&["then engage at the CNC"]);
    let before_um = shop.moved_um();
    shop.at_the_bridge("engage", "the CNC engages");
    shop.work.shows(&["moved, in µm"]);
    // As the page says.
    thread::sleep(Duration::from_secs(2));
    let moved_um = shop.moved_um() - before_um;
    shop.work.press(&format!("{moved_um:.1}\r"));
    shop.work.shows(&["the sign is right", "disengage at the CNC"]);
    shop.at_the_bridge("disengage", "the CNC has disengaged");

    // Without compensation.
    shop.work.shows(&["without compensation; the filled-in run file"]);
    shop.record(&of("trueup bridge monitor --machine mill.toml --port tcp:127.0.0.1:3333 --record mill-off --indicator tcp:127.0.0.1:3334 --indicator-unit um"));
    shop.work.clear();
    shop.type_at(|shop| &mut shop.work, &of("mill-off/bridge.csv"));

    // With the fitted constants.
    shop.work.shows(&["engage, run warmup again; the filled-in run file"]);
    shop.at_the_bridge("engage", "the CNC engages");
    shop.record(&of("trueup bridge monitor --machine mill-work/machine-1.toml --port tcp:127.0.0.1:3333 --record mill-on --indicator tcp:127.0.0.1:3334 --indicator-unit um"));
    shop.type_at(|shop| &mut shop.work, &of("mill-on/bridge.csv"));
    shop.work.shows(&["passed", &of("accepted; all of it is in mill-work"), &format!("0{PROMPT}")]);

    let [off_um, on_um] =
        ["mill-off", "mill-on"].map(|folder| shop.rms_um(&of(&format!("{folder}/bridge.csv"))));
    assert!((moved_um + 10.0).abs() < 0.2 && off_um > 3.0 && on_um < 0.1 * off_um);
    for file in ["mill-work/accept-1/report.html", "mill-work/log.txt"] {
        assert!(!shop.desk.text(&of(file)).is_empty(), "{file}");
    }
    shop.check_page(name);

    // Ctrl-C ends the bridge.
    shop.bridge.clear();
    shop.bridge.press("\u{3}");
    shop.bridge.shows(&[PROMPT]);
    format!("{name}: moved by {moved_um:.1} µm; {off_um:.2} µm RMS without, {on_um:.2} with")
}

#[test]
#[ignore = "long: the firmware in QEMU, the first day at a desk with a mill"]
fn the_first_day_ends_with_a_corrected_mill() {
    let figures = correct(
        "mill",
        &[
            ("Name of the machine [machine]", "mill\r"),
            ("> a mill with X, Y and Z only", "\r"),
            ("Travel of X in mm", "0:600\r"),
            ("Travel of Y in mm", "0:400\r"),
            ("Travel of Z in mm", "-300:0\r"),
            ("Where are positions measured?", "\r"),
            ("Rapid traverse in mm/min", "15000\r"),
        ],
    );
    println!("{figures}");
}

#[test]
#[ignore = "long: the firmware in QEMU, the first day at a desk with a lathe"]
fn the_first_day_ends_with_a_corrected_lathe() {
    let figures = correct(
        "lathe",
        &[
            ("Name of the machine [machine]", "lathe\r"),
            ("> a mill with X, Y and Z only", DOWN),
            ("> two rotary axes carry the spindle", DOWN),
            ("> one rotary axis carries the spindle", DOWN),
            ("> two rotary axes carry the workpiece", DOWN),
            ("> a lathe", "\r"),
            ("Travel of X (radius) in mm", "0:150\r"),
            ("Travel of Z in mm", "-400:0\r"),
            ("Where are positions measured?", "\r"),
            ("Rapid traverse in mm/min", "10000\r"),
        ],
    );
    println!("{figures}");
}
