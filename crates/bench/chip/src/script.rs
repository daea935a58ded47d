//! The world outside by a script (`--script FILE`): a line is `MS KEY VALUE…`. The board's output
//! goes to `--log FILE`, and nothing of what is inside it.

use crate::simulation_time::ms_to_ticks;
use std::collections::VecDeque;

/// Start value of random numbers.
pub(crate) const RANDOM_SEED: u64 = 0x9e37_79b9_7f4a_7c15;

/// A script, and the state of the world that it sets.
#[derive(Clone, Debug, Default)]
pub struct StimulusScript {
    pub(crate) lines: VecDeque<(u64, Vec<String>)>,
    /// `Control` byte 3: 1 Engage, 2 Referenced, 4 Zero, 8 Service, 16 Confirm; and how often it comes, in ms; 0: not.
    pub(crate) flags: u8,
    pub(crate) period: u64,
    pub(crate) damage: String,
    pub(crate) counter: u8,
    /// The second master's: flags, period, phase.
    pub(crate) flags2: u8,
    pub(crate) period2: u64,
    pub(crate) counter2: u8,
    pub(crate) rpm: u16,
    pub(crate) spindle: bool,
    pub(crate) positions: u64,
    pub(crate) x: f64,
    pub(crate) feed: f64,
    pub(crate) jump: bool,
    pub(crate) code: f64,
    pub(crate) slope: f64,
    pub(crate) since: u64,
    pub(crate) noise: f64,
    pub(crate) chatter: Option<f64>,
    pub(crate) pattern: Vec<u32>,
    pub(crate) turn: usize,
    pub(crate) spike: f64,
    /// The supply goes while the flash word of this number, from here on, is being written; 0: not.
    pub cut_in: u64,
    pub(crate) flood: (String, u64),
    pub(crate) serial: Vec<u8>,
    pub(crate) serial_rate: usize,
    pub(crate) rng: u64,
}

/// Returns a line: when, and its words.
fn parse_line(line: &str) -> (u64, Vec<String>) {
    let mut words = line.split_whitespace();
    let at: f64 =
        words.next().and_then(|t| t.parse().ok()).unwrap_or_else(|| panic!("script: {line}"));
    ((at * ms_to_ticks(1) as f64) as u64, words.map(str::to_owned).collect())
}

impl StimulusScript {
    /// Reads the lines of a script.
    ///
    /// # Panics
    /// A line does not begin with a time.
    pub fn from_text(text: &str) -> StimulusScript {
        let mut lines: Vec<(u64, Vec<String>)> = text
            .lines()
            .filter(|l| !l.trim().is_empty() && !l.starts_with('#'))
            .map(parse_line)
            .collect();
        lines.sort_by_key(|l| l.0);
        StimulusScript {
            lines: lines.into(),
            flags: 2,
            period: 20,
            rpm: 3000,
            spindle: true,
            positions: 100,
            x: 100.0,
            code: 800.0,
            noise: 1.0,
            rng: RANDOM_SEED,
            ..StimulusScript::default()
        }
    }
    /// One more line, not before those that are there.
    ///
    /// # Panics
    /// It does not begin with a time.
    pub fn add_line(&mut self, line: &str) {
        self.lines.push_back(parse_line(line));
    }
    /// Returns 53 bits that look like chance.
    pub fn next_random_bits(&mut self) -> u64 {
        self.rng ^= self.rng << 13;
        self.rng ^= self.rng >> 7;
        self.rng ^= self.rng << 17;
        self.rng >> 11
    }
    pub(crate) fn next_random_fraction(&mut self) -> f64 {
        self.next_random_bits() as f64 / (1u64 << 53) as f64
    }
    /// Returns the sensor's code; `scale`: what one code has become, with a supply that is not as it should be.
    pub fn sample_sensor(&mut self, now: u64, scale: f64) -> u32 {
        if !self.pattern.is_empty() {
            self.turn += 1;
            return self.pattern[self.turn % self.pattern.len()];
        }
        if let Some(n) = self.chatter {
            return (self.next_random_fraction() * (n + 1.0)) as u32;
        }
        let mean = self.code
            + self.slope * now.saturating_sub(self.since) as f64 / ms_to_ticks(1000) as f64;
        if self.spike > 0.0 && self.next_random_bits().is_multiple_of(200) {
            return if self.next_random_bits() & 1 == 0 { 4095 } else { 0 };
        }
        let r = (self.next_random_fraction() + self.next_random_fraction() - 1.0) * self.noise;
        (scale * mean + r + 0.5).clamp(0.0, 4095.0) as u32
    }
}
