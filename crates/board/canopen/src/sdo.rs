//! The SDO server (CiA 301): a CANopen master reads and writes the object dictionary with it.
//!
//! | transfer | here |
//! |---|---|
//! | expedited, up to 4 bytes in one frame | every number |
//! | segmented, 7 bytes a frame | texts and domains; a number too, if the master likes |
//! | block, [`BLOCK`] segments without an answer between them | a domain that is written |
//! | block upload, block download of anything else | refused with [`Abort::Command`]; masters fall back to segments |
//!
//! One transfer at a time: a new one takes the place of an old one, as CiA 301 has it. A master that
//! is silent for [`TIMEOUT_MS`] in the middle of one is sent an abort. The server holds no bytes of a
//! domain: it hands them on as they come, so its own memory is a few words, and no frame costs more
//! than a few hundred instructions. Whatever bytes come, there is one answer or none.

use trueup_link::{frame::Frame, layout::SDO_ANSWER_ID};

use crate::dictionary::{self, Access, Entry, ObjectKind};

mod abort;
mod block;
pub mod client;
#[cfg(test)]
mod tests;

pub use abort::Abort;

/// A transfer whose master is silent for so long is given up.
pub const TIMEOUT_MS: u32 = 5_000;
/// Bytes of data in a segment.
const SEGMENT: usize = 7;
/// Segments of a block: [`Objects::is_ready`] is asked for room for them before each block. No command that starts a transfer
/// is a number up to this one, so a new master is answered where an old one has left a block unfinished.
pub const BLOCK: u8 = 31;

/// A value as it is read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ObjectValue<'v> {
    /// The bits of a number, as many of them as its type has.
    Number(u32),
    /// Bytes of a text or a domain.
    Bytes(&'v [u8]),
}

/// The values behind the dictionary.
pub trait Objects {
    /// Reads a value.
    ///
    /// # Errors
    /// Why it cannot be read now.
    fn read(&self, what: ObjectKind) -> Result<ObjectValue<'_>, Abort>;

    /// Writes a number.
    ///
    /// # Errors
    /// Why it is not taken.
    fn write(&mut self, what: ObjectKind, number: u32) -> Result<(), Abort>;

    /// A domain is about to come, of this many bytes if the master has said.
    ///
    /// # Errors
    /// Why it is not taken.
    fn open(&mut self, what: ObjectKind, size: Option<u32>) -> Result<(), Abort>;

    /// The next bytes of it.
    ///
    /// # Errors
    /// Why they are not taken.
    fn append(&mut self, what: ObjectKind, bytes: &[u8]) -> Result<(), Abort>;

    /// Returns whether a whole block of a domain can be taken now. If not, its master waits for the answer until it can.
    fn is_ready(&self, what: ObjectKind) -> bool;

    /// It has come whole, and is now looked at; [`Server::end`] will say what came of it.
    ///
    /// # Errors
    /// Why it is not taken.
    fn close(&mut self, what: ObjectKind) -> Result<(), Abort>;
}

/// The command of an abort.
const ABORT: u8 = 0x80;

/// Object of a transfer: index and sub-index.
type At = (u16, u8);

#[derive(Clone, Copy, Debug, Default)]
enum Phase {
    #[default]
    Idle,
    /// The next segment begins at this byte.
    Upload {
        at: At,
        what: ObjectKind,
        from: usize,
        toggle: bool,
    },
    Download {
        at: At,
        entry: &'static Entry,
        incoming: Incoming,
        toggle: bool,
    },
    /// A domain comes in blocks.
    Block {
        at: At,
        what: ObjectKind,
        block: block::Block,
    },
    /// All has come and is being looked at; the last segment is not answered yet, which is this answer.
    Waiting {
        at: At,
        answer: [u8; 8],
    },
}

/// Received part of a segmented download.
#[derive(Clone, Copy, Debug, Default)]
struct Incoming {
    announced: Option<u32>,
    length: usize,
    /// The bytes of a number.
    number: [u8; 4],
}

/// The server: the state of the one transfer that is under way.
#[derive(Clone, Copy, Debug, Default)]
pub struct Server {
    phase: Phase,
    silent_ms: u32,
}

impl Server {
    /// Answers a request. Gives nothing where CiA 301 has no answer: an abort of the master, a
    /// frame that has not 8 bytes, a segment whose acceptance takes a while.
    pub fn receive(&mut self, request: &Frame, objects: &mut impl Objects) -> Option<Frame> {
        if usize::from(request.len()) != Frame::MAX_LEN {
            return None;
        }
        let &[command, low, high, subindex, ref data @ ..] = request.data();
        let at = (u16::from_le_bytes([low, high]), subindex);
        self.silent_ms = 0;
        if let Phase::Block { at, what, block } = self.phase
            && block.may_be(command)
        {
            return match self.receive_block(at, what, block, request.data(), objects) {
                Ok(answer) => answer.map(|data| Frame::full(SDO_ANSWER_ID, data)),
                Err(abort) => Some(self.abort(at, abort)),
            };
        }
        let (at, answer) = match command >> 5 {
            0 => {
                let &[_, ref segment @ ..] = request.data();
                (self.at(), self.download_segment(command, segment, objects))
            }
            1 => (at, self.start_download(at, command, *data, objects).map(Some)),
            2 => (at, self.start_upload(at, objects).map(Some)),
            3 => (self.at(), self.upload_segment(command, objects).map(Some)),
            4 => {
                self.phase = Phase::Idle;
                return None;
            }
            6 if command & 1 == 0 => (at, self.start_block(at, command, *data, objects)),
            5 => (at, Err(Abort::Command)),
            _ => (self.at(), Err(Abort::Command)),
        };
        match answer {
            Ok(answer) => answer.map(|data| Frame::full(SDO_ANSWER_ID, data)),
            Err(abort) => Some(self.abort(at, abort)),
        }
    }

    /// Ends the transfer of a domain that had come whole, with this outcome, see [`Objects::close`].
    pub fn end(&mut self, outcome: Result<(), Abort>) -> Option<Frame> {
        let Phase::Waiting { at, answer } = self.phase else { return None };
        Some(match outcome {
            Ok(()) => {
                self.phase = Phase::Idle;
                Frame::full(SDO_ANSWER_ID, answer)
            }
            Err(abort) => self.abort(at, abort),
        })
    }

    /// Time passes. Gives the abort of a transfer whose master is silent.
    pub fn tick(&mut self, elapsed_ms: u32) -> Option<Frame> {
        self.silent_ms = self.silent_ms.saturating_add(elapsed_ms);
        let is_open = matches!(
            self.phase,
            Phase::Upload { .. } | Phase::Download { .. } | Phase::Block { .. }
        );
        (is_open && self.silent_ms > TIMEOUT_MS).then(|| self.abort(self.at(), Abort::Timeout))
    }

    /// Returns the answer to a block that had to wait for room.
    pub fn proceed(&mut self, objects: &impl Objects) -> Option<Frame> {
        self.answer_block(objects).map(|data| Frame::full(SDO_ANSWER_ID, data))
    }

    /// Returns what the present transfer is of.
    fn at(&self) -> At {
        match self.phase {
            Phase::Idle => (0, 0),
            Phase::Upload { at, .. }
            | Phase::Download { at, .. }
            | Phase::Block { at, .. }
            | Phase::Waiting { at, .. } => at,
        }
    }

    fn abort(&mut self, at: At, abort: Abort) -> Frame {
        self.phase = Phase::Idle;
        Frame::full(SDO_ANSWER_ID, initiated(ABORT, at, abort.code()))
    }

    fn start_upload(&mut self, at: At, objects: &impl Objects) -> Result<[u8; 8], Abort> {
        self.phase = Phase::Idle;
        let entry = find(at)?;
        if entry.access == Access::Write {
            return Err(Abort::WriteOnly);
        }
        Ok(match objects.read(entry.what)? {
            ObjectValue::Number(number) => {
                let unused = 4_u8.saturating_sub(entry.kind.size().map_or(4, size_byte));
                initiated(0x43 | unused << 2, at, number)
            }
            ObjectValue::Bytes(bytes) => {
                self.phase = Phase::Upload { at, what: entry.what, from: 0, toggle: false };
                initiated(0x41, at, u32::try_from(bytes.len()).unwrap_or(u32::MAX))
            }
        })
    }

    fn upload_segment(&mut self, command: u8, objects: &impl Objects) -> Result<[u8; 8], Abort> {
        let Phase::Upload { at, what, from, toggle } = self.phase else {
            return Err(Abort::Command);
        };
        if is_toggled(command) != toggle {
            return Err(Abort::Toggle);
        }
        let ObjectValue::Bytes(bytes) = objects.read(what)? else { return Err(Abort::NoData) };
        let rest = bytes.get(from..).ok_or(Abort::NoData)?;
        let part = rest.get(..SEGMENT).unwrap_or(rest);
        let is_last = part.len() == rest.len();
        let unused = size_byte(SEGMENT).saturating_sub(size_byte(part.len()));
        let mut answer = [0; 8];
        let [head, data @ ..] = &mut answer;
        *head = u8::from(toggle) << 4 | unused << 1 | u8::from(is_last);
        data.iter_mut().zip(part).for_each(|(place, byte)| *place = *byte);
        self.phase = if is_last {
            Phase::Idle
        } else {
            Phase::Upload { at, what, from: from.saturating_add(SEGMENT), toggle: !toggle }
        };
        Ok(answer)
    }

    fn start_download(
        &mut self,
        at: At,
        command: u8,
        data: [u8; 4],
        objects: &mut impl Objects,
    ) -> Result<[u8; 8], Abort> {
        let was_waiting = matches!(self.phase, Phase::Waiting { .. });
        self.phase = Phase::Idle;
        let entry = find(at)?;
        if !entry.access.can_write() {
            return Err(Abort::ReadOnly);
        }
        let (is_expedited, has_size) = (command & 2 != 0, command & 1 != 0);
        if is_expedited {
            // A domain of 4 bytes has no meaning.
            let size = entry.kind.size().ok_or(Abort::TooShort)?;
            let sent = 4_usize.saturating_sub(usize::from(command >> 2 & 3));
            if has_size && sent != size {
                return Err(Abort::Length);
            }
            objects.write(entry.what, number_of(data, size))?;
        } else {
            let announced = has_size.then_some(u32::from_le_bytes(data));
            match entry.kind.size() {
                // What is being looked at must not change.
                None if was_waiting => return Err(Abort::DeviceState),
                None => objects.open(entry.what, announced)?,
                Some(size) => {
                    if announced.is_some_and(|sent| usize::try_from(sent) != Ok(size)) {
                        return Err(Abort::Length);
                    }
                }
            }
            let incoming = Incoming { announced, ..Incoming::default() };
            self.phase = Phase::Download { at, entry, incoming, toggle: false };
        }
        Ok(initiated(0x60, at, 0))
    }

    fn download_segment(
        &mut self,
        command: u8,
        data: &[u8; SEGMENT],
        objects: &mut impl Objects,
    ) -> Result<Option<[u8; 8]>, Abort> {
        let Phase::Download { at, entry, mut incoming, toggle } = self.phase else {
            return Err(Abort::Command);
        };
        if is_toggled(command) != toggle {
            return Err(Abort::Toggle);
        }
        let size = SEGMENT.saturating_sub(usize::from(command >> 1 & 7));
        let part = data.get(..size).unwrap_or_default();
        let begin = incoming.length;
        incoming.length = begin.saturating_add(size);
        let length = u32::try_from(incoming.length).unwrap_or(u32::MAX);
        if incoming.announced.is_some_and(|announced| length > announced) {
            return Err(Abort::Length);
        }
        match entry.kind.size() {
            None => objects.append(entry.what, part)?,
            Some(most) if incoming.length > most => return Err(Abort::Length),
            Some(_) => {
                let places = incoming.number.iter_mut().skip(begin);
                places.zip(part).for_each(|(place, byte)| *place = *byte);
            }
        }
        self.phase = Phase::Download { at, entry, incoming, toggle: !toggle };
        if command & 1 == 0 {
            return Ok(Some(segment_taken(toggle)));
        }
        if incoming.announced.is_some_and(|announced| length != announced) {
            return Err(Abort::Length);
        }
        match entry.kind.size() {
            Some(size) if incoming.length != size => return Err(Abort::Length),
            Some(size) => objects.write(entry.what, number_of(incoming.number, size))?,
            None => {
                objects.close(entry.what)?;
                self.phase = Phase::Waiting { at, answer: segment_taken(toggle) };
                return Ok(None);
            }
        }
        self.phase = Phase::Idle;
        Ok(Some(segment_taken(toggle)))
    }
}

fn find((index, subindex): At) -> Result<&'static Entry, Abort> {
    let object = dictionary::object(index).ok_or(Abort::NoObject)?;
    object.entry(subindex).ok_or(Abort::NoSubindex)
}

/// Returns the first `size` bytes as a number.
fn number_of(bytes: [u8; 4], size: usize) -> u32 {
    let mut whole = [0; 4];
    whole.iter_mut().zip(bytes).take(size).for_each(|(place, byte)| *place = byte);
    u32::from_le_bytes(whole)
}

fn size_byte(size: usize) -> u8 {
    u8::try_from(size).unwrap_or(u8::MAX)
}

fn is_toggled(command: u8) -> bool {
    command & 1 << 4 != 0
}

/// Returns the answer to a start: command, object, number.
fn initiated(command: u8, (index, subindex): At, number: u32) -> [u8; 8] {
    let [low, high] = index.to_le_bytes();
    let [a, b, c, d] = number.to_le_bytes();
    [command, low, high, subindex, a, b, c, d]
}

fn segment_taken(toggle: bool) -> [u8; 8] {
    [0x20 | u8::from(toggle) << 4, 0, 0, 0, 0, 0, 0, 0]
}
