//! A case of the list: a fault, and what must become of it within what time.

use trueup_canopen::{dictionary::TASK_NAMES, emergency::Fault};
use trueup_core::cnc::{OffsetFlags, OffsetQuality};
use trueup_link::status::{ResetReason, StateBits};

/// A fault, when it comes in its run, and what must be seen of it after that.
#[derive(Clone, Copy)]
pub struct Case {
    /// Description of the fault.
    pub fault: &'static str,
    /// When it comes, in ms of its run.
    pub at: u32,
    /// Within how many ms all of it is seen.
    pub within: u32,
    pub quality: Option<OffsetQuality>,
    pub flag: Option<(OffsetFlags, &'static str)>,
    pub state: Option<StateBits>,
    pub emergency: Option<Fault>,
    /// The emergency came before anybody listened: the history, object 0x1003, has it.
    pub is_history: bool,
    /// The board starts anew, and says why.
    pub restart: Option<ResetReason>,
    /// The task that it names after that.
    pub task: Option<&'static str>,
}

impl Case {
    /// Returns a fault that changes nothing, unless more is stated.
    pub const fn new(fault: &'static str, at: u32, within: u32) -> Self {
        let (quality, flag, state, emergency) = (None, None, None, None);
        let (is_history, restart, task) = (false, None, None);
        Self { fault, at, within, quality, flag, state, emergency, is_history, restart, task }
    }

    pub const fn quality(self, quality: OffsetQuality) -> Self {
        Self { quality: Some(quality), ..self }
    }

    pub const fn flag(self, flag: OffsetFlags, name: &'static str) -> Self {
        Self { flag: Some((flag, name)), ..self }
    }

    pub const fn state(self, state: StateBits) -> Self {
        Self { state: Some(state), ..self }
    }

    pub const fn emergency(self, fault: Fault) -> Self {
        Self { emergency: Some(fault), ..self }
    }

    /// Expects an emergency that a client reads later in the history, because there is no CAN.
    pub const fn history(self, fault: Fault) -> Self {
        Self { emergency: Some(fault), is_history: true, ..self }
    }

    /// The board is "not available" meanwhile.
    pub const fn restart(self, reason: ResetReason) -> Self {
        Self { restart: Some(reason), quality: Some(OffsetQuality::Fault), ..self }
    }

    pub const fn task(self, task: &'static str) -> Self {
        Self { task: Some(task), ..self }
    }

    /// Returns what of it was not seen.
    pub fn missing(&self, seen: &Seen) -> Vec<String> {
        let from = f64::from(self.at);
        let by = from + f64::from(self.within);
        let mut missing = Vec::new();
        // A message before the reset is not the answer to it.
        let from = match self.restart {
            None => from,
            Some(_) => match seen.resets.iter().find(|time| (from..=by).contains(*time)) {
                Some(reset) => *reset,
                None => return vec!["no reset".into()],
            },
        };
        let within = |time: &f64| (from..=by).contains(time);
        let mut expected = |is_seen: bool, what: String| {
            if !is_seen {
                missing.push(what);
            }
        };
        let offsets = || seen.offsets.iter().filter(|(time, _)| within(time));
        if let Some(quality) = self.quality {
            expected(
                offsets().any(|(_, (shown, _))| *shown == quality as u8),
                format!("quality {quality:?}"),
            );
        } else {
            // The offsets go on, and are as good as before.
            let before =
                seen.offsets.iter().rfind(|(time, _)| *time < from).map(|(_, offset)| offset.0);
            let same =
                offsets().count() > 0 && offsets().all(|(_, offset)| Some(offset.0) == before);
            expected(same, format!("quality as before, {before:?}"));
        }
        if let Some((flag, name)) = self.flag {
            expected(offsets().any(|(_, (_, flags))| flags.contains(flag)), format!("flag {name}"));
        }
        if let Some(fault) = self.emergency {
            // As CiA 301 packs it: the code, and the manufacturer's half above it.
            let entry = u32::from(fault.code()) | (fault as u32) << 16;
            let is_retained = seen.objects.iter().any(|(time, ((index, _), value))| {
                within(time) && *index == HISTORY && *value == entry
            });
            let is_reported = seen
                .emergencies
                .iter()
                .any(|(time, emergency)| within(time) && *emergency == fault as u8);
            expected(
                if self.is_history { is_retained } else { is_reported },
                format!("emergency {fault:?}"),
            );
        }
        let mut object =
            |index: u16, subindex: u8, is_right: &dyn Fn(u32) -> bool, what: String| {
                let mut answers = seen.objects.iter().filter(|(time, _)| within(time));
                let is_seen =
                    answers.any(|(_, (at, value))| *at == (index, subindex) && is_right(*value));
                expected(is_seen, what);
            };
        if let Some(state) = self.state {
            let is_set = |value| StateBits(value).contains(state);
            object(0x2001, 6, &is_set, format!("state bits {:#x}", state.0));
        }
        if let Some(reason) = self.restart {
            object(
                0x2001,
                7,
                &|number| number == reason as u32,
                format!("reason {}", reason.as_str()),
            );
        }
        if let Some(task) = self.task {
            let number = TASK_NAMES.iter().position(|name| *name == task).expect("a task") + 1;
            object(0x2002, 7, &|kind| kind as usize == number, format!("task {task}"));
        }
        missing
    }

    /// Its line in the page.
    pub fn line(&self, how: &str) -> String {
        let quality = self
            .quality
            .map_or("as before".into(), |quality| format!("{} {quality:?}", quality as u8));
        let flag = self.flag.map_or("", |(_, name)| name);
        let state = self.state.map_or(String::new(), |state| {
            let words = StateBits::NAMES.into_iter().filter(|(bit, _)| state.contains(*bit));
            words.map(|(_, word)| format!("`{word}`")).collect::<Vec<_>>().join(", ")
        });
        let emergency = self
            .emergency
            .map_or(String::new(), |emergency| format!("{:04X} {emergency:?}", emergency.code()));
        let emergency = if self.is_history { emergency + ", in 0x1003" } else { emergency };
        let restart = self.restart.map_or(String::new(), |restart| match self.task {
            Some(task) => format!("`{}`, in task `{task}`", restart.as_str()),
            None => format!("`{}`", restart.as_str()),
        });
        let Self { fault, within, .. } = self;
        format!(
            "| {fault} | {how} | {quality} | {flag} | {state} | {emergency} | {within} | {restart} |\n"
        )
    }
}

/// CiA 301: the pre-defined error field, the newest emergency first.
pub const HISTORY: u16 = 0x1003;

/// Index and sub-index of an object.
type At = (u16, u8);

/// Events of a run: each with its time in ms.
#[derive(Default)]
pub struct Seen {
    /// Quality and flags.
    pub offsets: Vec<(f64, (u8, OffsetFlags))>,
    /// The numbers of faults that came.
    pub emergencies: Vec<(f64, u8)>,
    /// Objects that were read, and their values.
    pub objects: Vec<(f64, (At, u32))>,
    pub resets: Vec<f64>,
    /// Bytes of the stack that were never used, as `Status` has them.
    pub free_stack: Vec<u16>,
}

impl Seen {
    /// Of the model's events: `TIME can ID HEX`, `TIME serial tIIILHEX`, `TIME reset WHY`.
    pub fn of(events: &[String]) -> Self {
        let mut seen = Self::default();
        for event in events {
            let mut words = event.split(' ');
            let time: f64 = words.next().and_then(|word| word.parse().ok()).expect("a time");
            let (id, hex) = match (words.next(), words.next(), words.next()) {
                (Some("reset"), ..) => {
                    seen.resets.push(time);
                    continue;
                }
                (Some("can"), Some(id), Some(hex)) => (id, hex),
                (Some("serial"), Some(line), _) if line.len() > 5 && line.starts_with('t') => {
                    (&line[1..4], &line[5..])
                }
                _ => continue,
            };
            let Ok(id) = u16::from_str_radix(id, 16) else { continue };
            let digits = |at: usize| hex.get(2 * at..2 * at + 2);
            let mut data = [0; 8];
            for (at, byte) in data.iter_mut().enumerate() {
                *byte =
                    digits(at).and_then(|digits| u8::from_str_radix(digits, 16).ok()).unwrap_or(0);
            }
            seen.take(time, id, data);
        }
        seen
    }

    fn take(&mut self, time: f64, id: u16, data: [u8; 8]) {
        match id {
            0x281 => self.offsets.push((time, (data[5] >> 4, OffsetFlags(data[6])))),
            0x081 if data[..2] != [0, 0] => self.emergencies.push((time, data[3])),
            0x381 if data[3] & 0x0F == 9 => {
                self.free_stack.push(u16::from_le_bytes([data[6], data[7]]));
            }
            // An answer of up to four bytes.
            0x581 if data[0] & 0xE3 == 0x43 => {
                let at = (u16::from_le_bytes([data[1], data[2]]), data[3]);
                let value = u32::from_le_bytes(*data.last_chunk().expect("eight bytes"));
                self.objects.push((time, (at, value)));
            }
            _ => {}
        }
    }
}
