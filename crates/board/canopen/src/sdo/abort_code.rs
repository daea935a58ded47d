//! Why a transfer is refused: the abort codes of CiA 301 that this server uses.

/// An abort code, as it goes over the wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum AbortCode {
    /// The toggle bit of a segment is not the expected one.
    Toggle = 0x0503_0000,
    /// The client has been silent in the middle of a transfer.
    Timeout = 0x0504_0000,
    /// An unsupported command: a block upload, or a segment without a transfer.
    Command = 0x0504_0001,
    /// The CRC of a block transfer is not that of its bytes.
    Crc = 0x0504_0004,
    /// An object that can only be written is read.
    WriteOnly = 0x0601_0001,
    /// An object that can only be read is written.
    ReadOnly = 0x0601_0002,
    /// There is no object with this index.
    NoObject = 0x0602_0000,
    /// The length is not that of the object, or not the announced one.
    Length = 0x0607_0010,
    /// More bytes than the object holds.
    TooLong = 0x0607_0012,
    /// Fewer bytes than the object needs.
    TooShort = 0x0607_0013,
    /// The object has no such sub-index.
    NoSubindex = 0x0609_0011,
    /// A value out of its range; for a calibration: one that is damaged or makes no sense.
    Value = 0x0609_0030,
    /// The board has nowhere to keep it, or its store does not take it.
    CannotStore = 0x0800_0020,
    /// The calibration allows a write only with the service switch closed.
    LocalControl = 0x0800_0021,
    /// Not now: offsets are being followed.
    DeviceState = 0x0800_0022,
    /// There is nothing to read yet.
    NoData = 0x0800_0024,
}

impl AbortCode {
    /// All of them.
    pub const ALL: [Self; 16] = [
        Self::Toggle,
        Self::Timeout,
        Self::Command,
        Self::Crc,
        Self::WriteOnly,
        Self::ReadOnly,
        Self::NoObject,
        Self::Length,
        Self::TooLong,
        Self::TooShort,
        Self::NoSubindex,
        Self::Value,
        Self::CannotStore,
        Self::LocalControl,
        Self::DeviceState,
        Self::NoData,
    ];

    /// Returns what it means, in words.
    #[must_use]
    pub const fn description(self) -> &'static str {
        match self {
            Self::Toggle => "a segment was lost or came twice",
            Self::Timeout => "the transfer took too long",
            Self::Command => "no such command",
            Self::Crc => "bytes were damaged on the way",
            Self::WriteOnly => "it can only be written",
            Self::ReadOnly => "it can only be read",
            Self::NoObject => "there is no such object",
            Self::Length => "the length is wrong",
            Self::TooLong => "too long",
            Self::TooShort => "too short",
            Self::NoSubindex => "there is no such sub-index",
            Self::Value => "a value out of its range, or a damaged calibration",
            Self::CannotStore => "the board cannot store it",
            Self::LocalControl => {
                "close the service switch: this calibration allows no write without it"
            }
            Self::DeviceState => "not now: offsets are being followed",
            Self::NoData => "there is nothing to read",
        }
    }

    /// Returns the number on the wire.
    #[must_use]
    pub const fn code(self) -> u32 {
        self as u32
    }
}
