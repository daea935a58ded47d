//! `bridge monitor` as a live screen, in a pseudo terminal of three sizes, against a bridge in this process.
#![cfg(target_os = "linux")]

use std::{io::Write as _, net::TcpListener, thread, time::Duration};

use crate::desk::Desk;
use crate::pretended::{PAPER, PretendedFault, bridge_many};
use crate::terminal::Terminal;
use trueup_machine::RunFile;

#[test]
fn at_three_sizes_it_shows_the_growth_and_q_ends_it() {
    let desk = Desk::new(&[("m.toml", PAPER)]);
    for size in [(80, 24), (120, 40), (60, 15)] {
        let (port, _) = bridge_many(PretendedFault::None, true);
        let line = format!("bridge monitor --port {port} --machine m.toml");
        let mut terminal = Terminal::start(&desk, &line, size, true);
        // 100.3 codes above the paper's zero.
        let text = terminal.shows(&[
            "paper, calibration ",
            " of m.toml",
            "LIVE  every input is fresh",
            "+12.32 µm",
            "1.7869 V",
            "727.50 codes",
            "given to the CNC      +0.00      +0.00     +12.32",
            "noise 0.",
            "No faults",
            "q quit",
        ]);
        assert!(text.lines().count() <= size.1.into(), "{text}");
        let bytes = terminal.bytes.lock().expect("no holder panics").clone();
        let codes = String::from_utf8_lossy(&bytes).into_owned();
        for colour in ["\u{1b}[3", "\u{1b}[9", "\u{1b}[38"] {
            let is_colour = codes.split(colour).skip(1).any(|part| {
                part.starts_with(|digit: char| ('0'..='7').contains(&digit))
                    && part[1..].starts_with('m')
            });
            assert!(!is_colour, "NO_COLOR is set");
        }
        terminal.press("q");
        assert_eq!(terminal.ended().code(), Some(0), "{}", terminal.text());
        // What was there before comes back.
        assert!(!terminal.screen.lock().expect("ours").screen().alternate_screen());
    }
}

/// Returns true if the screen was ended by hand: 3 where a busy computer has played frames of the bridge too late. That a sound
/// line ends with 0 is seen above, and in the tests of the plain monitor.
fn is_ended(code: Option<i32>) -> bool {
    matches!(code, Some(0 | 3))
}

#[test]
fn without_a_machine_file_it_reads_the_boards_own_calibration() {
    let desk = Desk::new(&[]);
    let (port, received) = bridge_many(PretendedFault::None, true);
    let mut terminal =
        Terminal::start(&desk, &format!("bridge monitor --port {port}"), (80, 24), false);
    terminal.shows(&["paper, calibration ", "727.50 codes", "spindle growth"]);
    terminal.press("\u{3}");
    assert!(is_ended(terminal.ended().code()), "Ctrl-C");
    assert!(received.lock().expect("no holder panics").frames > 0, "it has asked");
}

#[test]
fn the_screen_is_written_as_a_picture_without_a_terminal() {
    let desk = Desk::new(&[("m.toml", PAPER)]);
    let (port, _) = bridge_many(PretendedFault::None, true);
    let line = format!("bridge monitor --port {port} --machine m.toml --picture s.svg --count 3");
    assert!(is_ended(desk.trueup(&line).status.code()));
    let picture = desk.text("s.svg");
    for text in [
        "<svg xmlns",
        "LIVE",
        "every input is fresh",
        "+12.32 µm",
        "growth, µm, the last",
        "</svg>",
    ] {
        assert!(picture.contains(text), "{text}: {picture}");
    }
}

#[test]
fn r_records_and_g_writes_readings_typed_and_live() {
    let desk = Desk::new(&[("m.toml", PAPER)]);
    let (port, _) = bridge_many(PretendedFault::None, true);
    let gauge = TcpListener::bind("127.0.0.1:0").expect("a free port");
    let at = gauge.local_addr().expect("bound above");
    let line = format!(
        "bridge monitor --port {port} --machine m.toml --indicator tcp:{at} --indicator-unit mm"
    );
    let mut terminal = Terminal::start(&desk, &line, (80, 24), true);
    let (mut gauge, _) = gauge.accept().expect("the tool listens to its gauge");
    terminal.shows(&["+12.32 µm"]);
    terminal.press("g");
    terminal.shows(&["press r first"]);
    terminal.press("r");
    terminal.shows(&["REC  bridge-", " rows", "end recording"]);
    terminal.press("g-3.5\r");
    terminal.shows(&["-3.50 µm written down"]);
    thread::sleep(Duration::from_millis(300));
    gauge.write_all(b"01A+0.0125\r").expect("it is connected");
    terminal.shows(&["gauge elongation +12.50 µm"]);
    terminal.press("g");
    terminal.shows(&["+12.50 µm written down", "2 readings"]);
    thread::sleep(Duration::from_millis(300));
    // A slip, and taken out again.
    terminal.press("u");
    terminal.shows(&["+12.50 µm taken out again", "1 reading"]);
    gauge.write_all(b"01A+0.0125\r").expect("it is connected");
    thread::sleep(Duration::from_millis(100));
    terminal.press("g");
    terminal.shows(&["2 readings"]);
    thread::sleep(Duration::from_millis(300));
    terminal.press("r");
    terminal.shows(&[" rows in "]);
    terminal.press("q");
    assert!(is_ended(terminal.ended().code()));

    let files = desk.files(".");
    let folder = files.iter().find(|file| file.starts_with("bridge-")).expect("a recording");
    let run = RunFile::read(&desk.path(folder).join("bridge.csv")).expect("a run file");
    let marked = run.column("measured_elongation_um").expect("the gauge's column").iter();
    assert_eq!(marked.filter(|um| !um.is_nan()).collect::<Vec<_>>(), [&-3.5, &12.5]);
    assert!(run.column("sensor_counts").is_some());
}

#[test]
fn a_fault_is_reported_with_its_remedy_and_a_line_that_breaks_is_tried_again() {
    let desk = Desk::new(&[]);
    // It closes the line 1.3 s after it was opened.
    let (port, _) = crate::pretended::bridge(PretendedFault::Leaves);
    let mut terminal =
        Terminal::start(&desk, &format!("bridge monitor --port {port}"), (80, 24), true);
    terminal.shows(&["GROWTH".to_lowercase().as_str(), "LIVE"]);
    terminal.shows(&["NO OFFSETS COME", "line down, trying again"]);
    terminal.press("q");
    terminal.ended();

    let (port, _) = bridge_many(PretendedFault::None, false);
    let mut terminal =
        Terminal::start(&desk, &format!("bridge monitor --port {port}"), (60, 15), true);
    terminal.shows(&["restarted: engage anew"]);
    terminal.press("q");
    assert!(is_ended(terminal.ended().code()));
}
