//! Identifiers of the frames on the CAN bus, as `trueup.dbc` names the frames.

/// Identifier of `Emergency`, from the board.
pub(crate) const EMERGENCY_ID: u32 = 0x081;
/// Identifier of `OffsetXY`, from the board.
pub(crate) const OFFSET_XY_ID: u32 = 0x181;
/// Identifier of `OffsetZ`, from the board.
pub(crate) const OFFSET_Z_ID: u32 = 0x281;
/// Identifier of `Status`, from the board.
pub(crate) const STATUS_ID: u32 = 0x381;
/// Identifier of an answer to an SDO (CiA 301), from the board.
pub(crate) const SDO_RESPONSE_ID: u32 = 0x581;
/// Identifier of a request of an SDO (CiA 301), to the board.
pub(crate) const SDO_REQUEST_ID: u32 = 0x601;
/// Identifier of `Heartbeat`, from the board.
pub(crate) const HEARTBEAT_ID: u32 = 0x701;

/// Identifier of `PositionX`, from the CNC.
pub(crate) const POSITION_X_ID: u32 = 0x201;
/// Identifier of `PositionY`, from the CNC.
pub(crate) const POSITION_Y_ID: u32 = 0x301;
/// Identifier of `PositionZ`, from the CNC.
pub(crate) const POSITION_Z_ID: u32 = 0x401;
/// Identifier of `Rotary`, from the CNC.
pub(crate) const ROTARY_ID: u32 = 0x501;
/// Identifier of `Spindle`, from the CNC.
pub(crate) const SPINDLE_ID: u32 = 0x202;
/// Identifier of `Control`, from the CNC.
pub(crate) const CONTROL_ID: u32 = 0x302;

/// The positions of the axes, in the order X, Y, Z.
pub(crate) const POSITION_IDS: [u32; 3] = [POSITION_X_ID, POSITION_Y_ID, POSITION_Z_ID];
/// Identifier of frames of strangers; the next one replaces an identifier of the link that was drawn by chance.
pub(crate) const FOREIGN_FRAME_ID: u32 = 0x7f0;
