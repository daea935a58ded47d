//! The tool in a pseudo terminal: what it draws is read as a terminal would show it.

use std::{
    fs::File,
    io::{Read as _, Write as _},
    process::{Child, Command, ExitStatus},
    sync::{Arc, Mutex},
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use rustix::{
    pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt},
    termios::{Winsize, tcsetwinsize},
};

use crate::desk::Desk;

/// The prompt of a shell of these tests, printed after the exit code of the last command.
pub const PROMPT: &str = " shop> ";

/// Returns the search path of a shell: before all others a folder in which a test may put programs.
fn path(desk: &Desk) -> String {
    format!("{}:{}", desk.path(".bin").display(), std::env::var("PATH").unwrap_or_default())
}

/// The tool in a terminal.
pub struct Terminal {
    child: Child,
    keys: File,
    pub screen: Arc<Mutex<vt100::Parser>>,
    pub bytes: Arc<Mutex<Vec<u8>>>,
    reader: JoinHandle<()>,
}

impl Terminal {
    /// Starts the tool with the words of `line`.
    pub fn start(desk: &Desk, line: &str, size: (u16, u16), no_colour: bool) -> Self {
        let words = [env!("CARGO_BIN_EXE_trueup")].into_iter().chain(line.split(' '));
        Self::open(desk, &words.collect::<Vec<_>>(), size, no_colour)
    }

    /// Starts a shell in which lines are typed as a user types them; its prompt is [`PROMPT`] after the exit code.
    pub fn shell(desk: &Desk, size: (u16, u16)) -> Self {
        Self::open(desk, &["sh", "-i"], size, true)
    }

    fn open(desk: &Desk, program: &[&str], (columns, rows): (u16, u16), no_colour: bool) -> Self {
        let ours = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY).expect("a pseudo terminal");
        grantpt(&ours).and_then(|()| unlockpt(&ours)).expect("it is ours");
        let name = ptsname(&ours, Vec::new()).expect("it has a name");
        let name = name.to_str().expect("plain");
        let theirs = File::options().read(true).write(true).open(name).expect("unlocked");
        let size = Winsize { ws_row: rows, ws_col: columns, ws_xpixel: 0, ws_ypixel: 0 };
        tcsetwinsize(&theirs, size).expect("a terminal");
        let mut command = Command::new("env");
        command
            // The parent process may have had Ctrl-C ignored, which is inherited.
            .arg("--default-signal=INT")
            // The terminal is its own, whatever terminal the tests run in.
            .args(["setsid", "--ctty"])
            .args(program)
            .current_dir(desk.path("."))
            .env("PATH", path(desk))
            .env("PS1", format!("$?{PROMPT}"))
            // What a load replaces is kept there.
            .env("XDG_STATE_HOME", desk.path(".state"))
            .env_remove("ENV")
            .env("TERM", "xterm-256color")
            .env_remove("NO_COLOR")
            .stdin(theirs.try_clone().expect("a file"))
            .stdout(theirs.try_clone().expect("a file"))
            .stderr(theirs);
        if no_colour {
            command.env("NO_COLOR", "1");
        }
        let child = command.spawn().expect("coreutils has env, util-linux setsid");
        // The command holds the other end, and would keep it open.
        drop(command);
        let screen = Arc::new(Mutex::new(vt100::Parser::new(rows, columns, 0)));
        let bytes = Arc::new(Mutex::new(Vec::new()));
        let keys = File::from(ours);
        let mut end = keys.try_clone().expect("a file");
        let (drawn, all) = (screen.clone(), bytes.clone());
        let reader = thread::spawn(move || {
            let mut buffer = [0; 4096];
            // At the end of the other side a read fails.
            while let Ok(length @ 1..) = end.read(&mut buffer) {
                drawn.lock().expect("no holder panics").process(&buffer[..length]);
                all.lock().expect("no holder panics").extend_from_slice(&buffer[..length]);
            }
        });
        Self { child, keys, screen, bytes, reader }
    }

    pub fn text(&self) -> String {
        self.screen.lock().expect("no holder panics").screen().contents()
    }

    /// Returns all that was printed so far, without the codes that move the cursor.
    pub fn printed(&self) -> String {
        let bytes = self.bytes.lock().expect("no holder panics");
        let text = String::from_utf8_lossy(&bytes).into_owned();
        let mut parts = text.split('\u{1b}');
        let first = parts.next().unwrap_or_default().to_owned();
        let is_end = |c: char| c.is_ascii_alphabetic();
        parts.fold(first, |all, part| all + part.split_once(is_end).map_or("", |(_, rest)| rest))
    }

    /// Forgets what the screen shows.
    pub fn clear(&self) {
        self.screen.lock().expect("no holder panics").process(b"\x1b[2J\x1b[H");
    }

    /// Until the screen shows all of these.
    pub fn shows(&self, phrases: &[&str]) -> String {
        let start = Instant::now();
        loop {
            let text = self.text();
            match phrases.iter().find(|phrase| !text.contains(**phrase)) {
                None => return text,
                Some(phrase) if start.elapsed() > Duration::from_secs(20) => {
                    panic!("\"{phrase}\" does not come:\n{text}")
                }
                Some(_) => thread::sleep(Duration::from_millis(50)),
            }
        }
    }

    pub fn press(&mut self, keys: &str) {
        self.keys.write_all(keys.as_bytes()).expect("the terminal is open");
    }

    /// Returns how it ended, once all that it had drawn is on the screen.
    pub fn ended(&mut self) -> ExitStatus {
        let start = Instant::now();
        loop {
            let status = self.child.try_wait().expect("it is ours");
            if let Some(status) = status.filter(|_| self.reader.is_finished()) {
                return status;
            }
            assert!(start.elapsed() < Duration::from_secs(10), "it does not end:\n{}", self.text());
            thread::sleep(Duration::from_millis(20));
        }
    }
}

impl Drop for Terminal {
    fn drop(&mut self) {
        self.child.kill().ok();
        self.child.wait().ok();
    }
}
