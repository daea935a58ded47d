//! Text from outside that would steer a terminal or turn a line, bridges that never end their answer, state files that are
//! damaged, and sets of files of which one cannot be written.

use std::{
    fs,
    io::{Read, Write},
    net::TcpListener,
    thread,
    time::{Duration, Instant},
};

use crate::desk::Desk;

const MACHINE: &str = "[machine]\nname = \"mill\\u001b[31m\\u202eX µ 測定\"\nkind = \"3-axis\"\n[inputs]\n\
                       temp_a_c = { channel = 0, kind = \"pt100\" }\n[spindle]\nsource = \"temperature\"\n\
                       [spindle.temperature]\nsensor = \"temp_a_c\"\nreference_c = 20.0\nk_um_per_c = 2.0\n";
/// A column of a stranger: colours, C1, bidirectional marks; and letters that stay.
const COLUMN: &str = "\u{1b}[31mtemp_\u{9b}2J\u{202e}b\u{200f}\u{2066}_µ測_c\u{7f}";

fn run() -> String {
    let mut text = format!("time_s,temp_a_c,{COLUMN},measured_elongation_um\n");
    for n in 0..240 {
        let celsius = 25.0 + 10.0 * f64::from(n % 7) / 6.0;
        let other = 22.0 + f64::from(n % 11);
        let um = 2.0 * (celsius - 20.0) + 1.7 * (other - 20.0) + [0.2, -0.2, 0.1][n as usize % 3];
        text += &format!("{},{celsius:.3},{other},{um:.3}\n", 60 * n);
    }
    text
}

/// Returns what may not be shown as it is: all controls but line breaks and tabs, and what turns a line.
fn unsafe_in(text: &str) -> Option<char> {
    let turns = |c| matches!(c, '\u{61c}' | '\u{200e}' | '\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}');
    text.chars().find(|c| (c.is_control() && !['\n', '\t'].contains(c)) || turns(*c))
}

#[test]
fn what_a_file_brings_is_shown_escaped_everywhere() {
    let desk = Desk::new(&[("m.toml", MACHINE), ("run.csv", &run())]);
    let bad = "a\u{1b}]0;x\u{7}\u{202e}.csv";
    desk.write(bad, "temp_a_c,measured_elongation_um\n20,x\n");
    let mut shown = 0;
    for line in [
        "check m.toml run.csv".to_string(),
        format!("check {bad}"),
        format!("predict --machine m.toml --run {bad} -o p.csv"),
        format!("fit elongation --machine m.toml --run gone{bad} -o f.toml"),
        "predict --machine m.toml --run run.csv -o -".into(),
        "predict --machine m.toml --run run.csv -o p.csv".into(),
        "diagnose --machine m.toml --run run.csv --out d".into(),
        "--json check m.toml run.csv".into(),
        "trend . --out t".into(),
        "compile m.toml -o cal.bin".into(),
        "show cal.bin".into(),
        format!("no-such-{bad}"),
    ] {
        let output = desk.trueup(&line);
        let text = String::from_utf8([output.stdout, output.stderr].concat()).expect("UTF-8");
        assert_eq!(unsafe_in(&text), None, "{line}: {}", text.escape_debug());
        shown += usize::from(
            text.contains("u{1b}") || text.contains("u001b") || text.contains("u{202e}"),
        );
    }
    assert!(shown > 5, "it is written out: {shown}");
    for file in ["p.csv", "d/report.html", "d/diagnosis.json", "d/residuals.csv"] {
        let text = desk.text(file);
        assert_eq!(unsafe_in(&text), None, "{file}");
    }
    assert!(desk.text("p.csv").contains("µ測"), "letters stay");
    // Of a value of TOML the comment alone is ours.
    for line in desk.text("d/extended.toml").lines() {
        let comment = line.split('#').nth(1).unwrap_or_default();
        assert_eq!(unsafe_in(comment), None, "{line}");
    }
}

/// Returns a device at a port that opens its channel, and answers each request of an object by `answer`.
fn device(mut answer: impl FnMut([u8; 8]) -> Option<[u8; 8]> + Send + 'static) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
    let port = format!("tcp:{}", listener.local_addr().expect("bound"));
    thread::spawn(move || {
        let (mut stream, _) = listener.accept().expect("the tool");
        let mut line = String::new();
        let mut byte = [0];
        while let Ok(1) = stream.read(&mut byte) {
            if byte[0] != b'\r' {
                line.push(byte[0].into());
                continue;
            }
            let reported = std::mem::take(&mut line);
            let data = reported.strip_prefix("t6018").and_then(|hex| {
                let bytes = (0..8).map(|n| u8::from_str_radix(hex.get(2 * n..2 * n + 2)?, 16).ok());
                bytes.collect::<Option<Vec<u8>>>()?.try_into().ok()
            });
            let back = match data {
                None if reported.starts_with('t') => "z\r".into(),
                None => "\r".to_string(),
                Some(data) => answer(data).map_or("z\r".into(), |data: [u8; 8]| {
                    let hex: String = data.iter().map(|byte| format!("{byte:02X}")).collect();
                    format!("z\rt5818{hex}\r")
                }),
            };
            if stream.write_all(back.as_bytes()).is_err() {
                return;
            }
        }
    });
    port
}

#[test]
fn an_object_that_never_ends_ends_the_command_and_not_its_memory() {
    let mut toggle = 0;
    let port = device(move |request| match request[0] {
        0x40 => {
            toggle = 0;
            Some([0x40, request[1], request[2], request[3], 0, 0, 0, 0])
        }
        0x60 | 0x70 => {
            let head = toggle;
            toggle ^= 0x10;
            Some([head, 0x1B, b'[', b'3', b'1', b'm', b'x', b'y'])
        }
        _ => None,
    });
    let desk = Desk::new(&[]);
    let begun = Instant::now();
    let output = desk.trueup(&format!("bridge save b.json --port {port}"));
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert!(text.contains("does not end within"), "{text}");
    assert!(begun.elapsed() < Duration::from_secs(20), "{:?}", begun.elapsed());
    assert!(!desk.path("b.json").exists());
    assert_eq!(unsafe_in(&text), None, "{text:?}");
}

#[test]
fn a_state_of_learn_that_is_damaged_foreign_or_huge_is_refused_with_its_place_and_kept() {
    let run: String = run()
        .lines()
        .map(|line| {
            let cells: Vec<&str> = line.split(',').collect();
            format!("{},{},{}\n", cells[0], cells[1], cells[3])
        })
        .collect();
    let machine = MACHINE.replace("\\u001b[31m\\u202e", "");
    let desk =
        Desk::new(&[("m.toml", &machine), ("1.csv", &run), ("2.csv", &run.replace(",2", ",3"))]);
    desk.run_expecting("learn --machine m.toml --run 1.csv -o l.toml", 0);
    let state = desk.text("l.learn.json");
    let learned = desk.text("l.toml");
    for (what, damaged) in [
        ("half", state[..state.len() / 2].to_string()),
        ("foreign", "{\"a\": 1}".into()),
        ("another version", state.replacen("\"schema\":", "\"schema\":9", 1)),
        ("not a number", state.replacen("\"evidence\":", "\"evidence\":NaN,\"e\":", 1)),
        ("beyond any number", state.replacen("\"evidence\":", "\"evidence\":1e999,\"e\":", 1)),
        ("parts that do not fit", state.replacen("\"applied\":[", "\"applied\":[0.0,", 1)),
        ("no filters", state.replacen("\"filters\":[", "\"filters\":[],\"f\":[", 1)),
    ] {
        assert_ne!(damaged, state, "{what}");
        desk.write("l.learn.json", &damaged);
        let (_, err) = desk.run_expecting("learn --machine m.toml --run 2.csv -o l.toml", 2);
        assert!(err.contains("l.learn.json"), "{what}: {err}");
        assert_eq!(desk.text("l.learn.json"), damaged, "{what}");
        assert_eq!(desk.text("l.toml"), learned, "{what}");
    }
    // A hole of 300 MiB takes no room on a disk.
    let file = fs::File::create(desk.path("l.learn.json")).expect("writable");
    file.set_len(300 << 20).expect("a hole");
    let (_, err) = desk.run_expecting("learn --machine m.toml --run 2.csv -o l.toml", 2);
    assert!(err.contains("l.learn.json") && err.contains("256 MiB"), "{err}");
}

#[test]
fn a_set_of_files_is_replaced_whole_or_not_at_all() {
    let desk = Desk::new(&[("m.toml", MACHINE), ("run.csv", &run())]);
    desk.run_expecting("diagnose --machine m.toml --run run.csv --out d", 0);
    let names = ["diagnosis.json", "report.html", "extended.toml"];
    let before = names.map(|name| desk.text(&format!("d/{name}")));
    // The last file of the set has no place: it is a folder.
    fs::remove_file(desk.path("d/residuals.csv")).expect("there");
    fs::create_dir(desk.path("d/residuals.csv")).expect("a folder");
    desk.write("run.csv", run().replace(",2", ",4"));
    desk.run_expecting("diagnose --machine m.toml --run run.csv --out d", 2);
    for (name, before) in names.iter().zip(&before) {
        assert_eq!(&desk.text(&format!("d/{name}")), before, "{name}");
    }
    assert_eq!(desk.files("d").len(), 4, "no file of ours is left over: {:?}", desk.files("d"));
}
