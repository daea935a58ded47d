//! The SDO server (CiA 301): a CANopen master reads and writes the object dictionary with it.
//!
//! | transfer | here |
//! |---|---|
//! | expedited, up to 4 bytes in one frame | every number |
//! | segmented, 7 bytes a frame | texts and domains; a number too, if the master likes |
//! | block, [`SEGMENTS_PER_BLOCK`] segments without an answer between them | a domain that is written |
//! | block upload, block download of anything else | refused with [`AbortCode::Command`]; masters fall back to segments |
//!
//! One transfer at a time: a new one takes the place of an old one, as CiA 301 has it. A master that
//! is silent for `SDO_TIMEOUT_MS` in the middle of one is sent an abort. The server holds no bytes of a
//! domain: it hands them on as they come, so its own memory is a few words, and no frame costs more
//! than a few hundred instructions. Whatever bytes come, there is one answer or none.

use trueup_link::{frame::Frame, layout::SDO_RESPONSE_ID};

use crate::dictionary::{self, AccessType, Entry, EntryContent, ObjectAddress};

mod abort_code;
mod block_download;
pub mod client;
#[cfg(test)]
mod tests;

pub use abort_code::AbortCode;

/// A transfer is aborted after this silence of its master.
pub(crate) const SDO_TIMEOUT_MS: u32 = 5_000;
/// Bytes of data in a segment.
const SEGMENT_BYTES: usize = 7;
/// Segments of a block: [`ObjectAccess::has_room_for_block`] is asked for room for them before each block. No command that starts a transfer
/// is a number up to this one, so a new master is answered where an old one has left a block unfinished.
pub const SEGMENTS_PER_BLOCK: u8 = 31;

/// A value that is read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ObjectValue<'v> {
    /// The bits of a number, as many of them as its type has.
    Number(u32),
    /// Bytes of a text or a domain.
    Bytes(&'v [u8]),
}

/// The values behind the dictionary.
pub trait ObjectAccess {
    /// Reads a value.
    ///
    /// # Errors
    /// Why it cannot be read now.
    fn read(&self, what: EntryContent) -> Result<ObjectValue<'_>, AbortCode>;

    /// Writes a number.
    ///
    /// # Errors
    /// Why it is not taken.
    fn write(&mut self, what: EntryContent, number: u32) -> Result<(), AbortCode>;

    /// A domain is about to come, of this many bytes if the master has stated it.
    ///
    /// # Errors
    /// Why it is not taken.
    fn open(&mut self, what: EntryContent, size: Option<u32>) -> Result<(), AbortCode>;

    /// The next bytes of it.
    ///
    /// # Errors
    /// Why they are not taken.
    fn append(&mut self, what: EntryContent, bytes: &[u8]) -> Result<(), AbortCode>;

    /// Returns whether a whole block of a domain can be taken now. If not, its master waits for the answer until it can.
    fn has_room_for_block(&self, what: EntryContent) -> bool;

    /// It has come whole, and is now looked at; [`SdoServer::finish_download`] will say what came of it.
    ///
    /// # Errors
    /// Why it is not taken.
    fn close(&mut self, what: EntryContent) -> Result<(), AbortCode>;
}

/// The command of an abort.
const ABORT_COMMAND: u8 = 0x80;

#[derive(Clone, Copy, Debug, Default)]
enum TransferState {
    #[default]
    Idle,
    /// The next segment begins at this byte.
    Upload {
        at: ObjectAddress,
        what: EntryContent,
        from: usize,
        toggle: bool,
    },
    Download {
        at: ObjectAddress,
        entry: &'static Entry,
        incoming: DownloadBuffer,
        toggle: bool,
    },
    /// A domain comes in blocks.
    Block {
        at: ObjectAddress,
        what: EntryContent,
        block: block_download::BlockDownloadState,
    },
    /// All has come and is being looked at; the last segment is not answered yet, which is this answer.
    Waiting {
        at: ObjectAddress,
        answer: [u8; 8],
    },
}

/// Received part of a segmented download.
#[derive(Clone, Copy, Debug, Default)]
struct DownloadBuffer {
    announced: Option<u32>,
    length: usize,
    /// The bytes of a number.
    number: [u8; 4],
}

/// The server: the state of the one transfer that is under way.
#[derive(Clone, Copy, Debug, Default)]
pub struct SdoServer {
    phase: TransferState,
    silent_ms: u32,
}

impl SdoServer {
    /// Answers a request. Gives nothing where CiA 301 has no answer: an abort of the master, a
    /// frame that has not 8 bytes, a segment whose acceptance takes a while.
    pub fn receive(&mut self, request: &Frame, objects: &mut impl ObjectAccess) -> Option<Frame> {
        if usize::from(request.len()) != Frame::MAX_LEN {
            return None;
        }
        let &[command, low, high, subindex, ref data @ ..] = request.data();
        let at = (u16::from_le_bytes([low, high]), subindex);
        self.silent_ms = 0;
        if let TransferState::Block { at, what, block } = self.phase
            && block.is_part_of_transfer(command)
        {
            return match self.receive_block_segment(at, what, block, request.data(), objects) {
                Ok(answer) => answer.map(|data| Frame::from_data(SDO_RESPONSE_ID, data)),
                Err(abort) => Some(self.abort(at, abort)),
            };
        }
        let (at, answer) = match command >> 5 {
            0 => {
                let &[_, ref segment @ ..] = request.data();
                (self.transfer_address(), self.download_segment(command, segment, objects))
            }
            1 => (at, self.start_download(at, command, *data, objects).map(Some)),
            2 => (at, self.start_upload(at, objects).map(Some)),
            3 => (self.transfer_address(), self.upload_segment(command, objects).map(Some)),
            4 => {
                self.phase = TransferState::Idle;
                return None;
            }
            6 if command & 1 == 0 => (at, self.start_block_download(at, command, *data, objects)),
            5 => (at, Err(AbortCode::Command)),
            _ => (self.transfer_address(), Err(AbortCode::Command)),
        };
        match answer {
            Ok(answer) => answer.map(|data| Frame::from_data(SDO_RESPONSE_ID, data)),
            Err(abort) => Some(self.abort(at, abort)),
        }
    }

    /// Ends the transfer of a domain that had come whole, with this outcome, see [`ObjectAccess::close`].
    pub fn finish_download(&mut self, outcome: Result<(), AbortCode>) -> Option<Frame> {
        let TransferState::Waiting { at, answer } = self.phase else { return None };
        Some(match outcome {
            Ok(()) => {
                self.phase = TransferState::Idle;
                Frame::from_data(SDO_RESPONSE_ID, answer)
            }
            Err(abort) => self.abort(at, abort),
        })
    }

    /// Time passes. Gives the abort of a transfer whose master is silent.
    pub fn tick(&mut self, elapsed_ms: u32) -> Option<Frame> {
        self.silent_ms = self.silent_ms.saturating_add(elapsed_ms);
        let is_open = matches!(
            self.phase,
            TransferState::Upload { .. }
                | TransferState::Download { .. }
                | TransferState::Block { .. }
        );
        (is_open && self.silent_ms > SDO_TIMEOUT_MS)
            .then(|| self.abort(self.transfer_address(), AbortCode::Timeout))
    }

    /// Returns the answer to a block that had to wait for room.
    pub fn resume_block(&mut self, objects: &impl ObjectAccess) -> Option<Frame> {
        self.acknowledge_block(objects).map(|data| Frame::from_data(SDO_RESPONSE_ID, data))
    }

    /// Returns what the present transfer is of.
    fn transfer_address(&self) -> ObjectAddress {
        match self.phase {
            TransferState::Idle => (0, 0),
            TransferState::Upload { at, .. }
            | TransferState::Download { at, .. }
            | TransferState::Block { at, .. }
            | TransferState::Waiting { at, .. } => at,
        }
    }

    fn abort(&mut self, at: ObjectAddress, abort: AbortCode) -> Frame {
        self.phase = TransferState::Idle;
        Frame::from_data(SDO_RESPONSE_ID, encode_message(ABORT_COMMAND, at, abort.code()))
    }

    fn start_upload(
        &mut self,
        at: ObjectAddress,
        objects: &impl ObjectAccess,
    ) -> Result<[u8; 8], AbortCode> {
        self.phase = TransferState::Idle;
        let entry = find_entry(at)?;
        if entry.access == AccessType::Write {
            return Err(AbortCode::WriteOnly);
        }
        Ok(match objects.read(entry.what)? {
            ObjectValue::Number(number) => {
                let unused = 4_u8.saturating_sub(entry.kind.size().map_or(4, saturate_to_u8));
                encode_message(0x43 | unused << 2, at, number)
            }
            ObjectValue::Bytes(bytes) => {
                self.phase = TransferState::Upload { at, what: entry.what, from: 0, toggle: false };
                encode_message(0x41, at, u32::try_from(bytes.len()).unwrap_or(u32::MAX))
            }
        })
    }

    fn upload_segment(
        &mut self,
        command: u8,
        objects: &impl ObjectAccess,
    ) -> Result<[u8; 8], AbortCode> {
        let TransferState::Upload { at, what, from, toggle } = self.phase else {
            return Err(AbortCode::Command);
        };
        if is_toggle_bit_set(command) != toggle {
            return Err(AbortCode::Toggle);
        }
        let ObjectValue::Bytes(bytes) = objects.read(what)? else { return Err(AbortCode::NoData) };
        let rest = bytes.get(from..).ok_or(AbortCode::NoData)?;
        let part = rest.get(..SEGMENT_BYTES).unwrap_or(rest);
        let is_last = part.len() == rest.len();
        let unused = saturate_to_u8(SEGMENT_BYTES).saturating_sub(saturate_to_u8(part.len()));
        let mut answer = [0; 8];
        let [head, data @ ..] = &mut answer;
        *head = u8::from(toggle) << 4 | unused << 1 | u8::from(is_last);
        data.iter_mut().zip(part).for_each(|(place, byte)| *place = *byte);
        self.phase = if is_last {
            TransferState::Idle
        } else {
            TransferState::Upload {
                at,
                what,
                from: from.saturating_add(SEGMENT_BYTES),
                toggle: !toggle,
            }
        };
        Ok(answer)
    }

    fn start_download(
        &mut self,
        at: ObjectAddress,
        command: u8,
        data: [u8; 4],
        objects: &mut impl ObjectAccess,
    ) -> Result<[u8; 8], AbortCode> {
        let was_waiting = matches!(self.phase, TransferState::Waiting { .. });
        self.phase = TransferState::Idle;
        let entry = find_entry(at)?;
        if !entry.access.is_writable() {
            return Err(AbortCode::ReadOnly);
        }
        let (is_expedited, has_size) = (command & 2 != 0, command & 1 != 0);
        if is_expedited {
            // A domain of 4 bytes has no meaning.
            let size = entry.kind.size().ok_or(AbortCode::TooShort)?;
            let sent = 4_usize.saturating_sub(usize::from(command >> 2 & 3));
            if has_size && sent != size {
                return Err(AbortCode::Length);
            }
            objects.write(entry.what, number_from_bytes(data, size))?;
        } else {
            let announced = has_size.then_some(u32::from_le_bytes(data));
            match entry.kind.size() {
                // What is being looked at must not change.
                None if was_waiting => return Err(AbortCode::DeviceState),
                None => objects.open(entry.what, announced)?,
                Some(size) => {
                    if announced.is_some_and(|sent| usize::try_from(sent) != Ok(size)) {
                        return Err(AbortCode::Length);
                    }
                }
            }
            let incoming = DownloadBuffer { announced, ..DownloadBuffer::default() };
            self.phase = TransferState::Download { at, entry, incoming, toggle: false };
        }
        Ok(encode_message(0x60, at, 0))
    }

    fn download_segment(
        &mut self,
        command: u8,
        data: &[u8; SEGMENT_BYTES],
        objects: &mut impl ObjectAccess,
    ) -> Result<Option<[u8; 8]>, AbortCode> {
        let TransferState::Download { at, entry, mut incoming, toggle } = self.phase else {
            return Err(AbortCode::Command);
        };
        if is_toggle_bit_set(command) != toggle {
            return Err(AbortCode::Toggle);
        }
        let size = SEGMENT_BYTES.saturating_sub(usize::from(command >> 1 & 7));
        let part = data.get(..size).unwrap_or_default();
        let begin = incoming.length;
        incoming.length = begin.saturating_add(size);
        let length = u32::try_from(incoming.length).unwrap_or(u32::MAX);
        if incoming.announced.is_some_and(|announced| length > announced) {
            return Err(AbortCode::Length);
        }
        match entry.kind.size() {
            None => objects.append(entry.what, part)?,
            Some(most) if incoming.length > most => return Err(AbortCode::Length),
            Some(_) => {
                let places = incoming.number.iter_mut().skip(begin);
                places.zip(part).for_each(|(place, byte)| *place = *byte);
            }
        }
        self.phase = TransferState::Download { at, entry, incoming, toggle: !toggle };
        if command & 1 == 0 {
            return Ok(Some(encode_segment_response(toggle)));
        }
        if incoming.announced.is_some_and(|announced| length != announced) {
            return Err(AbortCode::Length);
        }
        match entry.kind.size() {
            Some(size) if incoming.length != size => return Err(AbortCode::Length),
            Some(size) => objects.write(entry.what, number_from_bytes(incoming.number, size))?,
            None => {
                objects.close(entry.what)?;
                self.phase = TransferState::Waiting { at, answer: encode_segment_response(toggle) };
                return Ok(None);
            }
        }
        self.phase = TransferState::Idle;
        Ok(Some(encode_segment_response(toggle)))
    }
}

fn find_entry((index, subindex): ObjectAddress) -> Result<&'static Entry, AbortCode> {
    let object = dictionary::find_object(index).ok_or(AbortCode::NoObject)?;
    object.entry(subindex).ok_or(AbortCode::NoSubindex)
}

/// Returns the first `size` bytes as a number.
fn number_from_bytes(bytes: [u8; 4], size: usize) -> u32 {
    let mut whole = [0; 4];
    whole.iter_mut().zip(bytes).take(size).for_each(|(place, byte)| *place = byte);
    u32::from_le_bytes(whole)
}

fn saturate_to_u8(size: usize) -> u8 {
    u8::try_from(size).unwrap_or(u8::MAX)
}

fn is_toggle_bit_set(command: u8) -> bool {
    command & 1 << 4 != 0
}

/// Returns the answer to a start: command, object, number.
fn encode_message(command: u8, (index, subindex): ObjectAddress, number: u32) -> [u8; 8] {
    let [low, high] = index.to_le_bytes();
    let [a, b, c, d] = number.to_le_bytes();
    [command, low, high, subindex, a, b, c, d]
}

fn encode_segment_response(toggle: bool) -> [u8; 8] {
    [0x20 | u8::from(toggle) << 4, 0, 0, 0, 0, 0, 0, 0]
}
