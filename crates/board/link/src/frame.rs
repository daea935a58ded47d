//! One CAN 2.0 data frame with a standard identifier, whatever carries it: CAN, a serial line, or
//! the emulator's pipe.

/// A CAN 2.0 data frame: an 11-bit identifier and up to 8 bytes.
///
/// The fields are private so that a `Frame` is always valid; bytes beyond the payload are 0, so
/// that equal frames compare equal.
///
/// ```
/// use trueup_link::frame::Frame;
/// let heartbeat = Frame::new(0x701, &[5])?;
/// assert_eq!((heartbeat.id(), heartbeat.payload()), (0x701, &[5][..]));
/// # Ok::<(), trueup_link::frame::FrameError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Frame {
    id: u16,
    len: u8,
    data: [u8; Self::MAX_LEN],
}

impl Frame {
    /// The largest standard identifier.
    pub const MAX_ID: u16 = 0x7FF;
    /// The most bytes that a frame carries.
    pub const MAX_LEN: usize = 8;

    /// Returns a frame with the identifier `id`, 0…0x7FF, and 0…8 bytes of payload.
    ///
    /// # Errors
    /// [`FrameError`] with the identifier or the length that is too large.
    pub fn new(id: u16, payload: &[u8]) -> Result<Self, FrameError> {
        if id > Self::MAX_ID {
            return Err(FrameError::Identifier(id));
        }
        let too_long = FrameError::Length(payload.len());
        let len = u8::try_from(payload.len()).map_err(|_| too_long)?;
        let mut data = [0; Self::MAX_LEN];
        let place = data.get_mut(..payload.len()).ok_or(too_long)?;
        for (place, byte) in place.iter_mut().zip(payload) {
            *place = *byte;
        }
        Ok(Self { id, len, data })
    }

    /// Returns a frame of 8 bytes with an identifier of [`crate::layout`], 0…0x7FF. A larger one stops a
    /// build that has debug assertions.
    #[must_use]
    pub const fn from_data(id: u16, data: [u8; Self::MAX_LEN]) -> Self {
        debug_assert!(id <= Self::MAX_ID);
        Self { id, len: 8, data }
    }

    /// As `full`, for a frame of a single byte.
    pub(crate) const fn from_byte(id: u16, byte: u8) -> Self {
        debug_assert!(id <= Self::MAX_ID);
        Self { id, len: 1, data: [byte, 0, 0, 0, 0, 0, 0, 0] }
    }

    /// Returns the identifier, 0…0x7FF.
    #[must_use]
    pub const fn id(&self) -> u16 {
        self.id
    }

    /// Returns the number of bytes in the payload, 0…8.
    #[must_use]
    pub const fn len(&self) -> u8 {
        self.len
    }

    /// Returns whether the payload has no byte.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Returns the payload, padded with zeros to 8 bytes.
    #[must_use]
    pub const fn data(&self) -> &[u8; Self::MAX_LEN] {
        &self.data
    }

    /// Returns the payload, 0…8 bytes.
    #[must_use]
    pub fn payload(&self) -> &[u8] {
        self.data.get(..usize::from(self.len)).unwrap_or(&self.data)
    }
}

/// Why there is no such frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FrameError {
    /// The identifier is above 0x7FF.
    #[error("identifier 0x{0:X} is above 0x{max:X}", max = Frame::MAX_ID)]
    Identifier(u16),
    /// The payload has more than 8 bytes.
    #[error("{0} bytes are more than the {max} of a frame", max = Frame::MAX_LEN)]
    Length(usize),
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::ToString;

    #[test]
    fn a_frame_holds_its_payload_at_every_length() {
        let bytes = [1, 2, 3, 4, 5, 6, 7, 8];
        for len in 0..=8 {
            let frame = Frame::new(Frame::MAX_ID, &bytes[..len]).unwrap();
            assert_eq!(frame.payload(), &bytes[..len]);
            assert_eq!(usize::from(frame.len()), len);
            assert_eq!(frame.is_empty(), len == 0);
            assert!(frame.data()[len..].iter().all(|&byte| byte == 0));
        }
    }

    #[test]
    fn a_long_payload_or_identifier_is_refused_with_its_value() {
        assert_eq!(Frame::new(0x800, &[]), Err(FrameError::Identifier(0x800)));
        assert_eq!(Frame::new(0, &[0; 9]), Err(FrameError::Length(9)));
        assert_eq!(Frame::new(0, &[0; 300]), Err(FrameError::Length(300)));
    }

    #[test]
    fn why_there_is_no_such_frame_is_reported_with_its_limit() {
        let error_text = |id, bytes: &[u8]| Frame::new(id, bytes).unwrap_err().to_string();
        assert_eq!(error_text(0x800, &[]), "identifier 0x800 is above 0x7FF");
        assert_eq!(error_text(0, &[0; 9]), "9 bytes are more than the 8 of a frame");
    }
}
