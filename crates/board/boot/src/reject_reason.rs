//! Why a new firmware is refused, as a number that goes over the wire (object 0x2120:05).

use core::fmt;

use crate::{image_check::ImageDefect, image_header::HeaderError, update::UpdateError};

/// The reason. Numbers of a later version may be larger.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum FirmwareRejectReason {
    /// 512 bytes that are no header.
    NoHeader = 1,
    /// A header of a later format.
    Format = 2,
    /// It is linked for the slot that runs.
    OtherSlot = 3,
    /// Its length is none that an image has, or not the announced one.
    Length = 4,
    /// Its version is below the oldest that may start.
    BelowFloor = 5,
    /// It requires a floor above its own version.
    OwnFloor = 6,
    /// CRC or digest do not hold.
    Damaged = 7,
    /// Its signature does not hold for the board's key.
    Signature = 8,
    /// It is not newer than the one that runs.
    NotNewer = 9,
    /// The one that runs is not confirmed.
    Unconfirmed = 10,
    /// The flash does not take it.
    Flash = 11,
    /// The state of the slots was not stored.
    NotStored = 12,
    /// The board has no firmware slots.
    NoSlots = 13,
}

impl FirmwareRejectReason {
    /// All of them.
    pub const ALL: [Self; 13] = [
        Self::NoHeader,
        Self::Format,
        Self::OtherSlot,
        Self::Length,
        Self::BelowFloor,
        Self::OwnFloor,
        Self::Damaged,
        Self::Signature,
        Self::NotNewer,
        Self::Unconfirmed,
        Self::Flash,
        Self::NotStored,
        Self::NoSlots,
    ];

    /// Returns the number.
    #[must_use]
    pub const fn number(self) -> u8 {
        self as u8
    }

    /// Returns the reason of a number; `None`: 0, or one of a later version.
    #[must_use]
    pub fn from_number(number: u8) -> Option<Self> {
        Self::ALL.into_iter().find(|candidate| candidate.number() == number)
    }
}

impl From<UpdateError> for FirmwareRejectReason {
    fn from(error: UpdateError) -> Self {
        match error {
            UpdateError::Defect(defect) => match defect {
                ImageDefect::Header(HeaderError::Blank | HeaderError::NoHeader) => Self::NoHeader,
                ImageDefect::Header(HeaderError::Format) => Self::Format,
                ImageDefect::Unreadable => Self::Flash,
                ImageDefect::OtherSlot => Self::OtherSlot,
                ImageDefect::Length => Self::Length,
                ImageDefect::BelowFloor { .. } => Self::BelowFloor,
                ImageDefect::OwnFloor => Self::OwnFloor,
                ImageDefect::Crc | ImageDefect::Digest => Self::Damaged,
                ImageDefect::Signature => Self::Signature,
            },
            UpdateError::NotNewer { .. } => Self::NotNewer,
            UpdateError::Unconfirmed => Self::Unconfirmed,
            UpdateError::Length => Self::Length,
            UpdateError::Flash => Self::Flash,
            UpdateError::NotStored => Self::NotStored,
        }
    }
}

impl fmt::Display for FirmwareRejectReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::NoHeader => "the file is no firmware of trueup, or its header is damaged",
            Self::Format => "the file has a header of a later format: update in two steps",
            Self::OtherSlot => "the file is linked for the slot that runs",
            Self::Length => "the file does not have the length that its header says",
            Self::BelowFloor => "the file is older than the oldest version that may start",
            Self::OwnFloor => "the file asks for a floor above its own version",
            Self::Damaged => "the file is damaged: its CRC or its SHA-256 does not hold",
            Self::Signature => "the file is not signed with this board's key",
            Self::NotNewer => {
                "the file is not newer than the firmware that runs: it would never start"
            }
            Self::Unconfirmed => {
                "the firmware that runs is on trial: engage, let it run for a minute, then update"
            }
            Self::Flash => "the flash does not take the file",
            Self::NotStored => "the state of the slots was not stored",
            Self::NoSlots => {
                "this firmware has no slots: write the new one with a probe or the ROM loader"
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image_header::FirmwareVersion;

    #[test]
    fn each_number_is_there_once_and_leads_back() {
        for (at, refusal) in FirmwareRejectReason::ALL.into_iter().enumerate() {
            assert_eq!(usize::from(refusal.number()), at + 1);
            assert_eq!(FirmwareRejectReason::from_number(refusal.number()), Some(refusal));
        }
        assert_eq!(
            [FirmwareRejectReason::from_number(0), FirmwareRejectReason::from_number(14)],
            [None; 2]
        );
    }

    #[test]
    fn an_error_has_its_number() {
        let not_newer = UpdateError::NotNewer { running: FirmwareVersion::new(1, 2, 3, 0) };
        assert_eq!(FirmwareRejectReason::from(not_newer), FirmwareRejectReason::NotNewer);
        assert_eq!(
            FirmwareRejectReason::from(UpdateError::Defect(ImageDefect::Crc)),
            FirmwareRejectReason::Damaged
        );
    }
}
