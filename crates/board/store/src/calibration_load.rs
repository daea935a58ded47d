//! A calibration on its way to the board: where its bytes are gathered, and what came of it.
//!
//! A master writes it to object 0x2100:02. The bytes go into a buffer of the board, which is taken
//! only while no offset is followed. Once all have come, the board's supervisor takes the buffer
//! ([`LoadSlot::take_load`]), looks whether a bridge could run on it, stores it, and gives
//! it back; only then is the last segment answered. So an answer without an abort means: it is
//! whole, it makes sense, and it is stored for the next start. None of that holds up a tick.

use crate::calibration::{self, BlobError};

/// The bytes of a calibration that has come whole.
#[derive(Debug)]
pub struct LoadBuffer<'a> {
    buffer: &'a mut [u8],
    length: usize,
}

impl LoadBuffer<'_> {
    /// Returns the blob, if a bridge can run on it.
    ///
    /// # Errors
    /// As [`calibration::decode`].
    pub fn validate_blob(&mut self) -> Result<&[u8], BlobError> {
        calibration::decode(self.bytes())?;
        // What follows the blob is dropped.
        self.length = calibration::validate_blob(self.bytes())?.len();
        Ok(self.bytes())
    }

    fn bytes(&self) -> &[u8] {
        self.buffer.get(..self.length).unwrap_or_default()
    }
}

/// The result of a calibration whose bytes are complete.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LoadOutcome {
    /// It is stored.
    Stored,
    /// No bridge can run on it.
    Rejected,
    /// The board's store does not take it.
    NotStored,
}

/// Why a calibration is not loaded.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum LoadError {
    /// More bytes than the buffer takes.
    #[error("the calibration is longer than the board takes")]
    TooLong,
    /// Another one is being looked at, or none was begun.
    #[error("no calibration is expected now")]
    Busy,
    /// No bridge can run on it.
    #[error("the calibration is damaged or makes no sense")]
    Rejected,
    /// The board has nowhere to store it, or its store does not take it.
    #[error("the board cannot store the calibration")]
    NotStored,
}

/// The buffer and its state.
#[derive(Debug, Default)]
pub enum LoadSlot<'a> {
    /// The board has none.
    #[default]
    None,
    /// Nothing has come, or not all of it.
    Receiving(LoadBuffer<'a>),
    /// All has come, and the supervisor is to look at it.
    Complete(LoadBuffer<'a>),
    /// The supervisor has it.
    WithSupervisor,
    /// It is stored.
    Stored(LoadBuffer<'a>),
}

impl<'a> LoadSlot<'a> {
    /// Returns a buffer that nothing has come to.
    #[must_use]
    pub fn new(buffer: &'a mut [u8]) -> Self {
        Self::Receiving(LoadBuffer { buffer, length: 0 })
    }

    /// Begins anew, for `size` bytes if that is known.
    ///
    /// # Errors
    /// [`LoadError`]: there is no buffer, it is too small, or the supervisor has it.
    pub fn open(&mut self, size: Option<u32>) -> Result<(), LoadError> {
        *self = match core::mem::take(self) {
            Self::Receiving(load) | Self::Stored(load) => {
                Self::Receiving(LoadBuffer { length: 0, ..load })
            }
            none @ Self::None => none,
            busy @ (Self::Complete(_) | Self::WithSupervisor) => busy,
        };
        match self {
            Self::Receiving(load) => {
                let fits =
                    |size| usize::try_from(size).is_ok_and(|length| length <= load.buffer.len());
                size.is_none_or(fits).then_some(()).ok_or(LoadError::TooLong)
            }
            Self::None => Err(LoadError::NotStored),
            _ => Err(LoadError::Busy),
        }
    }

    /// Adds the next bytes.
    ///
    /// # Errors
    /// [`LoadError`]: more than the buffer takes, or none are expected.
    pub fn append(&mut self, bytes: &[u8]) -> Result<(), LoadError> {
        let Self::Receiving(load) = self else { return Err(LoadError::Busy) };
        let end = load.length.saturating_add(bytes.len());
        let places = load.buffer.get_mut(load.length..end).ok_or(LoadError::TooLong)?;
        places.iter_mut().zip(bytes).for_each(|(place, byte)| *place = *byte);
        load.length = end;
        Ok(())
    }

    /// All has come.
    ///
    /// # Errors
    /// [`LoadError::Busy`]: none was expected.
    pub fn close(&mut self) -> Result<(), LoadError> {
        match core::mem::take(self) {
            Self::Receiving(load) => {
                *self = Self::Complete(load);
                Ok(())
            }
            other => {
                *self = other;
                Err(LoadError::Busy)
            }
        }
    }

    /// Returns the bytes that have come and are not whole yet.
    #[must_use]
    pub fn received_bytes(&self) -> &[u8] {
        match self {
            Self::Receiving(load) => load.bytes(),
            _ => &[],
        }
    }

    /// Drops them, so that there is room again.
    pub fn clear(&mut self) {
        if let Self::Receiving(load) = self {
            load.length = 0;
        }
    }

    /// Returns what has come whole, once.
    pub fn take_load(&mut self) -> Option<LoadBuffer<'a>> {
        match core::mem::take(self) {
            Self::Complete(load) => {
                *self = Self::WithSupervisor;
                Some(load)
            }
            other => {
                *self = other;
                None
            }
        }
    }

    /// Gives it back, with what came of it.
    ///
    /// # Errors
    /// [`LoadError`] for any outcome but [`LoadOutcome::Stored`].
    pub fn finish_load(
        &mut self,
        load: LoadBuffer<'a>,
        outcome: LoadOutcome,
    ) -> Result<(), LoadError> {
        let (slot, result) = match outcome {
            LoadOutcome::Stored => (Self::Stored(load), Ok(())),
            LoadOutcome::Rejected => (Self::Receiving(load), Err(LoadError::Rejected)),
            LoadOutcome::NotStored => (Self::Receiving(load), Err(LoadError::NotStored)),
        };
        *self = slot;
        result
    }

    /// Returns what is stored for the next start.
    #[must_use]
    pub fn stored_blob(&self) -> Option<&[u8]> {
        match self {
            Self::Stored(load) => Some(load.bytes()),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::ToString;

    #[test]
    fn a_calibration_comes_in_pieces_is_looked_at_once_and_is_read_back_when_it_is_stored() {
        let mut buffer = [0; 10];
        let mut slot = LoadSlot::new(&mut buffer);
        assert_eq!(slot.open(Some(5)), Ok(()));
        assert_eq!((slot.append(b"abc"), slot.append(b"de")), (Ok(()), Ok(())));
        assert!(slot.take_load().is_none(), "it may not be all");
        assert_eq!(slot.close(), Ok(()));
        let load = slot.take_load().expect("all has come");
        assert_eq!(load.bytes(), b"abcde");
        assert_eq!((slot.take_load().is_none(), slot.stored_blob()), (true, None));
        assert_eq!(slot.finish_load(load, LoadOutcome::Stored), Ok(()));
        assert_eq!(slot.stored_blob(), Some(&b"abcde"[..]));
        // The next begins anew.
        assert_eq!((slot.open(None), slot.stored_blob()), (Ok(()), None));
        assert_eq!((slot.append(b"fg"), slot.close()), (Ok(()), Ok(())));
        assert_eq!(slot.take_load().expect("all has come").bytes(), b"fg");
    }

    #[test]
    fn none_is_taken_that_is_longer_than_the_buffer_and_the_buffer_may_be_filled() {
        let mut buffer = [0; 10];
        let mut slot = LoadSlot::new(&mut buffer);
        assert_eq!([9, 10, 11].map(|size| slot.open(Some(size)).is_ok()), [true, true, false]);
        assert_eq!(slot.open(Some(11)), Err(LoadError::TooLong));
        assert_eq!(slot.open(None), Ok(()));
        assert_eq!(slot.append(&[1; 6]), Ok(()));
        assert_eq!(slot.append(&[2; 5]), Err(LoadError::TooLong));
        assert_eq!((slot.append(&[2; 4]), slot.close()), (Ok(()), Ok(())));
        assert_eq!(slot.take_load().expect("all has come").bytes(), [1, 1, 1, 1, 1, 1, 2, 2, 2, 2]);
    }

    #[test]
    fn while_the_supervisor_has_it_nothing_else_is_taken_and_without_a_buffer_nothing_ever() {
        let mut buffer = [0; 10];
        let mut slot = LoadSlot::new(&mut buffer);
        slot.append(b"abc").unwrap();
        slot.close().unwrap();
        let is_busy = |slot: &mut LoadSlot<'_>| {
            let all = [slot.open(None), slot.append(b"x"), slot.close()];
            assert_eq!(all, [Err(LoadError::Busy); 3]);
        };
        is_busy(&mut slot);
        let load = slot.take_load().expect("all has come");
        is_busy(&mut slot);
        assert_eq!(load.bytes(), b"abc");
        let mut none = LoadSlot::default();
        assert_eq!(none.open(None), Err(LoadError::NotStored));
        assert_eq!([none.append(b"x"), none.close()], [Err(LoadError::Busy); 2]);
        assert!(none.take_load().is_none() && none.stored_blob().is_none());
    }

    #[test]
    fn what_is_not_stored_is_reported_and_the_next_may_come() {
        for (outcome, error) in [
            (LoadOutcome::Rejected, LoadError::Rejected),
            (LoadOutcome::NotStored, LoadError::NotStored),
        ] {
            let mut buffer = [0; 10];
            let mut slot = LoadSlot::new(&mut buffer);
            slot.close().unwrap();
            let load = slot.take_load().expect("all has come");
            assert_eq!(slot.finish_load(load, outcome), Err(error));
            assert_eq!(slot.stored_blob(), None);
            assert_eq!(slot.open(Some(10)), Ok(()));
        }
    }

    #[test]
    fn each_reason_has_words_of_its_own() {
        for (error, words) in [
            (LoadError::TooLong, "longer than the board takes"),
            (LoadError::Busy, "expected now"),
            (LoadError::Rejected, "damaged or makes no sense"),
            (LoadError::NotStored, "cannot store"),
        ] {
            assert!(error.to_string().contains(words), "{error}");
        }
    }
}
