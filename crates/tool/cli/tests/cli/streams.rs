//! Streams that cannot be written: a full disk, a descriptor that is closed, a reader that has left or has stopped.
//! No command dies of its diagnostics, and its exit status stays that of its verdict.
#![cfg(target_os = "linux")]

use std::{
    fs::OpenOptions,
    io::{PipeReader, Read as _, Write as _, pipe},
    net::{TcpListener, TcpStream},
    process::{Child, Command, Stdio},
    thread,
    time::{Duration, Instant},
};

use crate::{
    desk::Desk,
    pretended::{PretendedFault, bridge_with},
};

const MACHINE: &str = "[machine]\nname = \"m\"\nkind = \"3-axis\"\n[inputs]\n\
                       temp_a_c = { channel = 0, kind = \"pt100\" }\n[spindle]\nsource = \"temperature\"\n\
                       [spindle.temperature]\nsensor = \"temp_a_c\"\nreference_c = 20.0\nk_um_per_c = 2.0\n";
const SCENARIO: &str = include_str!("../../../../../data/scenario-axis.toml");
const GANTRY: &str = include_str!("../../../../../data/gantry.toml");

/// Returns a spindle that grows by 2.6 µm/K and by this more.
fn run(more_um: f64) -> String {
    let mut text = "time_s,temp_a_c,measured_elongation_um\n".to_string();
    for n in 0..30 {
        let celsius = 25.0 + 10.0 * f64::from(n % 7) / 6.0;
        let um = more_um + 2.6 * (celsius - 20.0) + [0.6, -0.6, 0.2, -0.2][n as usize % 4];
        text += &format!("{},{celsius:.3},{um:.3}\n", 1800 * n);
    }
    text
}

/// A line of each command. `PORT` is a bridge, and `NONE` a port where nothing listens.
const LINES: [&str; 43] = [
    "--help",
    "no-such-command",
    "accept --off run.csv --on small.csv --out o-accept",
    "doctor --port NONE",
    "bridge info --port NONE",
    "bridge info --port PORT",
    "bridge load cal.bin --yes --port PORT",
    "bridge load cal.bin --port PORT",
    "bridge monitor --port PORT --count 1",
    "bridge restore no.json --yes --port PORT",
    "bridge save o.json --port PORT",
    "check m.toml run.csv",
    "check odd.toml",
    "commission --machine m.toml --rpm 1000 --port NONE --for siemens --out o-commission",
    "compare run.csv small.csv --out o-compare",
    "compile m.toml -o o.bin",
    "compile bad.toml -o o.bin",
    "completions bash",
    "diagnose --machine m.toml --run run.csv --out o-diagnose",
    "examples o-examples",
    "export gantry.toml --format siemens-840d -o o-export",
    "firmware o-firmware",
    "fit elongation --run run.csv --machine m.toml -o o.toml",
    "gateway modbus --port PORT --listen 127.0.0.1:0 --once",
    "gateway s7 --port nowhere --plc 127.0.0.1:1 --db 1 --once",
    "import run.csv -o o-import.csv",
    "fleet status --dir o-fleet",
    "learn --machine m.toml --run run.csv -o o-learned.toml --limit-percent 5",
    "linuxcnc --port NONE --ini missing.ini",
    "man o-man",
    "new -o o-new.toml --name n --kind 3-axis --yes",
    "predict --machine m.toml --run run.csv -o -",
    "predict --machine m.toml --run bad.csv -o o.csv",
    "program warmup --machine m.toml --rpm 1000 --for siemens --out o-program",
    "program circle --machine gantry.toml --for linuxcnc --out o-program",
    "schema",
    "serve --port PORT --name n --spool o-spool --mtconnect 127.0.0.1:0 --once",
    "show cal.bin",
    "sign --new o-key.pem",
    "simulate --scenario s.toml --seed 1 -o -",
    "trend . --out o-trend",
    "trust --machine m.toml --calibrated run.csv --run small.csv",
    "virtual --machine bad.toml --run run.csv",
];

/// The state of a stream.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Stream {
    Whole,
    /// `/dev/full`: no space left on the device.
    Full,
    /// `| head`: its reader has left.
    Left,
}

fn stdio(stream: Stream, whole: impl FnOnce() -> Stdio) -> Stdio {
    match stream {
        Stream::Whole => whole(),
        Stream::Full => OpenOptions::new().write(true).open("/dev/full").expect("Linux").into(),
        Stream::Left => pipe().expect("a pipe").1.into(),
    }
}

/// Returns what has come of a line: its exit code, and what could be read.
fn ended(desk: &Desk, line: &str, out: Stream, err: Stream) -> (Option<i32>, String) {
    for file in desk.files(".").iter().filter(|file| file.starts_with("o-") || *file == "o.csv") {
        let path = desk.path(file);
        _ = if path.is_dir() { std::fs::remove_dir_all(path) } else { std::fs::remove_file(path) };
    }
    let mut line = line.replace("NONE", "tcp:127.0.0.1:1");
    if line.contains("PORT") {
        line = line.replace("PORT", &bridge_with(PretendedFault::None, false).0);
    }
    let child = command(desk, &line)
        .stdout(stdio(out, Stdio::piped))
        .stderr(stdio(err, Stdio::piped))
        .spawn();
    let output = child.and_then(Child::wait_with_output).expect("the tool was built for this test");
    let text = [output.stdout, output.stderr].concat();
    (output.status.code(), String::from_utf8_lossy(&text).into_owned())
}

fn command(desk: &Desk, line: &str) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_trueup"));
    command.args(line.split(' ')).current_dir(desk.path(".")).stdin(Stdio::null());
    command
}

fn desk() -> Desk {
    let desk = Desk::new(&[
        ("m.toml", MACHINE),
        ("odd.toml", &MACHINE.replace("2.0", "900.0")),
        ("bad.toml", "[machine]\nname = 7\n"),
        ("gantry.toml", GANTRY),
        ("s.toml", SCENARIO),
        ("run.csv", &run(0.0)),
        ("small.csv", &run(9.0)),
        ("bad.csv", "temp_a_c,measured_elongation_um\n20,x\n"),
    ]);
    desk.run_expecting("compile m.toml -o cal.bin", 0);
    desk
}

#[test]
fn no_command_dies_of_a_stream_that_cannot_be_written_and_its_verdict_stands() {
    use Stream::{Full, Left, Whole};
    let desk = desk();
    let mut verdicts = [0; 4];
    for line in LINES {
        let (code, text) = ended(&desk, line, Whole, Whole);
        let code = code.filter(|code| (0..4).contains(code));
        let code = code.unwrap_or_else(|| panic!("{line}: {text}"));
        verdicts[usize::try_from(code).expect("0 to 3")] += 1;
        for (out, err) in [(Whole, Full), (Whole, Left), (Left, Whole), (Left, Full)] {
            let (now, text) = ended(&desk, line, out, err);
            assert_eq!(now, Some(code), "{line}, {out:?} {err:?}: {text}");
            assert!(!text.contains("panicked"), "{line}, {out:?} {err:?}: {text}");
        }
        // A result that is lost is an error, or is the exit status that counts.
        let (now, text) = ended(&desk, line, Full, Whole);
        assert!(now == Some(code) || now == Some(1), "{line}: {now:?} {text}");
        assert!(
            now == Some(code) || text.contains("standard output cannot be written"),
            "{line}: {text}"
        );
        let (now, _) = ended(&desk, line, Full, Full);
        assert!(now == Some(code) || now == Some(1), "{line}: {now:?}");
    }
    assert!(verdicts.iter().all(|count| *count > 0), "of each exit code one: {verdicts:?}");

    let help = ended(&desk, "--help", Whole, Whole).1;
    let commands = help.lines().skip_while(|line| *line != "Measure:");
    let commands = commands.take_while(|line| *line != "Options of every command:");
    let commands = commands.filter_map(|line| line.strip_prefix("  "));
    let names: Vec<_> = commands.filter_map(|line| line.split_whitespace().next()).collect();
    assert!(names.len() > 20, "{help}");
    for name in names.iter().filter(|name| **name != "help") {
        assert!(LINES.iter().any(|line| line.split(' ').next() == Some(name)), "{name}");
    }
}

#[test]
fn a_closed_descriptor_is_as_good_as_none() {
    let desk = desk();
    let trueup = env!("CARGO_BIN_EXE_trueup");
    for (line, code) in [
        ("learn --machine m.toml --run run.csv -o o-l.toml --limit-percent 5", 3),
        ("predict --machine m.toml --run run.csv -o p.csv", 0),
        ("check bad.toml", 2),
    ] {
        for closed in [">&-", "2>&-", ">&- 2>&-", "<&- >&- 2>&-"] {
            for file in desk.files(".").iter().filter(|file| file.starts_with("o-")) {
                std::fs::remove_file(desk.path(file)).expect("a file of the run before");
            }
            let mut shell = Command::new("sh");
            shell.arg("-c").arg(format!("{trueup} {line} {closed}")).current_dir(desk.path("."));
            let status = shell.status().expect("a shell");
            assert_eq!(status.code(), Some(code), "{line} {closed}");
        }
    }
}

#[test]
fn a_result_that_is_the_product_is_missed_on_a_full_disk() {
    let desk = desk();
    for line in [
        "predict --machine m.toml --run run.csv -o -",
        "program circle --machine gantry.toml --for linuxcnc --out o-program",
        "schema",
        "show cal.bin",
        "completions bash",
    ] {
        let (code, text) = ended(&desk, line, Stream::Full, Stream::Whole);
        assert_eq!(code, Some(1), "{line}: {text}");
        assert!(
            text.contains("standard output cannot be written: No space left"),
            "{line}: {text}"
        );
    }
}

#[test]
fn a_monitor_whose_reader_leaves_ends_with_its_verdict() {
    let desk = desk();
    let (port, _) = bridge_with(PretendedFault::Noise, true);
    let (code, text) =
        ended(&desk, &format!("bridge monitor --port {port}"), Stream::Left, Stream::Whole);
    assert_eq!(code, Some(3), "{text}");
}

/// Returns a pipe that is full and is not read, and its reading end.
fn stalled() -> (PipeReader, Stdio) {
    let (reader, mut writer) = pipe().expect("a pipe");
    // The capacity of a pipe of Linux.
    writer.write_all(&[b'-'; 65_536]).expect("it has room");
    (reader, writer.into())
}

#[test]
fn a_gateway_whose_output_is_not_read_serves_its_plc_and_counts_what_it_drops() {
    let desk = desk();
    let (port, _) = bridge_with(PretendedFault::None, true);
    let listen =
        TcpListener::bind("127.0.0.1:0").and_then(|listener| listener.local_addr()).expect("free");
    let ((_out, out), (mut err, err_end)) = (stalled(), stalled());
    let line = format!("gateway modbus --port {port} --listen {listen}");
    let mut gateway = command(&desk, &line).stdout(out).stderr(err_end).spawn().expect("built");
    let begun = Instant::now();
    let mut plc = loop {
        match TcpStream::connect(listen) {
            Ok(plc) => break plc,
            Err(_) if begun.elapsed() < Duration::from_secs(10) => {
                thread::sleep(Duration::from_millis(20))
            }
            Err(error) => panic!("{error}"),
        }
    };
    plc.set_read_timeout(Some(Duration::from_secs(5))).expect("a plain socket");
    // More than one line a second goes to a pipe that takes none.
    for _ in 0..15 {
        plc.write_all(&[0, 1, 0, 0, 0, 6, 1, 4, 0, 0, 0, 2]).expect("it serves");
        let mut answer = [0; 13];
        plc.read_exact(&mut answer).expect("it answers");
        assert_eq!(answer[..8], [0, 1, 0, 0, 0, 7, 1, 4]);
        thread::sleep(Duration::from_millis(100));
    }
    let ended = Command::new("kill").arg(gateway.id().to_string()).status().expect("a shell");
    assert!(ended.success());
    let requested_at = Instant::now();
    let status = gateway.wait().expect("a child");
    assert!(requested_at.elapsed() < Duration::from_secs(3), "it waits for its streams");
    assert_eq!(status.code(), Some(0));
    let mut text = String::new();
    err.read_to_string(&mut text).expect("text");
    assert_eq!(text.len(), 65_536, "nothing has got through");
}
