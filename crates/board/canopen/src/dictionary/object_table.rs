//! The table itself.

use trueup_link::layout::{
    EMERGENCY_ID, EMERGENCY_INHIBIT_TIME_MS, HEARTBEAT_PERIOD_MS, SDO_REQUEST_ID, SDO_RESPONSE_ID,
};

use super::{
    AccessType, CrashDetail, DataType, ELONGATION_SUBINDEX, Entry, EntryContent, Object,
    ReceiverCounter,
    constructors::{
        array_object, celsius_unit_entry, constant_entry, crash_detail_entry, decimal_digits_entry,
        domain_entry, error_entry, highest_subindex_entry, micrometres_unit_entry,
        process_value_entry, read_only_entry, read_write_entry, receiver_counter_entry,
        record_object, reset_count_entry, status_entry, text_entry, var_object,
    },
};

/// One line for each analogue input, whose name and content follow from its number.
macro_rules! inputs {
    ($temperature:expr, $elongation:expr) => {
        &[
            highest_subindex_entry(ELONGATION_SUBINDEX),
            $temperature(1, "Temperature channel 0"),
            $temperature(2, "Temperature channel 1"),
            $temperature(3, "Temperature channel 2"),
            $temperature(4, "Temperature channel 3"),
            $temperature(5, "Temperature channel 4"),
            $temperature(6, "Temperature channel 5"),
            $temperature(7, "Temperature channel 6"),
            $temperature(8, "Temperature channel 7"),
            $elongation(ELONGATION_SUBINDEX, "Elongation"),
        ]
    };
}

/// Every object, by rising index.
pub const OBJECTS: &[Object] = &[
    var_object(0x1000, "Device type", &[constant_entry(0, "Device type", DataType::U32, 404)]),
    var_object(
        0x1001,
        "Error register",
        &[read_only_entry(0, "Error register", DataType::U8, EntryContent::ErrorRegister)],
    ),
    array_object(
        0x1003,
        "Pre-defined error field",
        &[
            read_write_entry(0, "Number of errors", DataType::U8, EntryContent::ErrorCount, 0),
            error_entry(1, "Newest error"),
            error_entry(2, "Error 2"),
            error_entry(3, "Error 3"),
            error_entry(4, "Error 4"),
            error_entry(5, "Error 5"),
            error_entry(6, "Error 6"),
            error_entry(7, "Error 7"),
            error_entry(8, "Error 8"),
        ],
    ),
    var_object(
        0x1008,
        "Manufacturer device name",
        &[text_entry("Manufacturer device name", "trueup bridge")],
    ),
    var_object(
        0x1009,
        "Manufacturer hardware version",
        &[text_entry("Manufacturer hardware version", "STM32F405")],
    ),
    var_object(
        0x100A,
        "Manufacturer software version",
        &[text_entry("Manufacturer software version", env!("CARGO_PKG_VERSION"))],
    ),
    var_object(
        0x1014,
        "COB-ID EMCY",
        &[constant_entry(0, "COB-ID EMCY", DataType::U32, EMERGENCY_ID as u32)],
    ),
    var_object(
        0x1015,
        "Inhibit time EMCY",
        &[read_write_entry(
            0,
            "Inhibit time EMCY",
            DataType::U16,
            EntryContent::Inhibit,
            10 * EMERGENCY_INHIBIT_TIME_MS,
        )],
    ),
    array_object(
        0x1016,
        "Consumer heartbeat time",
        &[
            highest_subindex_entry(1),
            read_write_entry(
                1,
                "Consumer heartbeat time",
                DataType::U32,
                EntryContent::ConsumerHeartbeat,
                0,
            ),
        ],
    ),
    var_object(
        0x1017,
        "Producer heartbeat time",
        &[read_write_entry(
            0,
            "Producer heartbeat time",
            DataType::U16,
            EntryContent::ProducerHeartbeat,
            HEARTBEAT_PERIOD_MS,
        )],
    ),
    record_object(
        0x1018,
        "Identity object",
        &[
            highest_subindex_entry(4),
            // No number was assigned by CiA.
            constant_entry(1, "Vendor-ID", DataType::U32, 0),
            constant_entry(2, "Product code", DataType::U32, 1),
            constant_entry(3, "Revision number", DataType::U32, 0x0001_0000),
            read_only_entry(4, "Serial number", DataType::U32, EntryContent::SerialNumber),
        ],
    ),
    record_object(
        0x1200,
        "SDO server parameter",
        &[
            highest_subindex_entry(2),
            constant_entry(1, "COB-ID client to server", DataType::U32, SDO_REQUEST_ID as u32),
            constant_entry(2, "COB-ID server to client", DataType::U32, SDO_RESPONSE_ID as u32),
        ],
    ),
    array_object(
        0x2000,
        "Offset in nm",
        &[
            highest_subindex_entry(3),
            read_only_entry(1, "Offset X", DataType::I32, EntryContent::Offset(0)),
            read_only_entry(2, "Offset Y", DataType::I32, EntryContent::Offset(1)),
            read_only_entry(3, "Offset Z", DataType::I32, EntryContent::Offset(2)),
        ],
    ),
    record_object(
        0x2001,
        "State of the bridge",
        &[
            highest_subindex_entry(11),
            read_only_entry(1, "Quality", DataType::U8, EntryContent::Quality),
            read_only_entry(2, "Flags", DataType::U8, EntryContent::Flags),
            read_only_entry(3, "Age of the newest sample in ms", DataType::U8, EntryContent::Age),
            read_only_entry(4, "Faults 0 to 15", DataType::U16, EntryContent::Faults),
            read_only_entry(5, "Sample clock in ms", DataType::U32, EntryContent::Clock),
            read_only_entry(6, "State bits", DataType::U32, EntryContent::StateBits),
            read_only_entry(7, "Reason of the last reset", DataType::U8, EntryContent::ResetReason),
            read_only_entry(8, "Who may write", DataType::U8, EntryContent::Authority),
            read_only_entry(9, "Faults 0 to 31", DataType::U32, EntryContent::AllFaults),
            read_only_entry(10, "Faults from 32 on", DataType::U32, EntryContent::HighFaults),
            read_only_entry(
                11,
                "Commit of the source of the image",
                DataType::U32,
                EntryContent::Commit,
            ),
        ],
    ),
    record_object(
        0x2002,
        "Where the last start stopped",
        &[
            highest_subindex_entry(7),
            crash_detail_entry(1, "Program counter", DataType::U32, CrashDetail::ProgramCounter),
            crash_detail_entry(2, "Link register", DataType::U32, CrashDetail::LinkRegister),
            crash_detail_entry(3, "Fault status (CFSR)", DataType::U32, CrashDetail::FaultStatus),
            crash_detail_entry(4, "Address", DataType::U32, CrashDetail::Address),
            crash_detail_entry(5, "Line", DataType::U32, CrashDetail::Line),
            crash_detail_entry(6, "File", DataType::Text, CrashDetail::File),
            crash_detail_entry(7, "Task", DataType::U8, CrashDetail::Task),
        ],
    ),
    array_object(
        0x2003,
        "Starts since power-on",
        &[
            highest_subindex_entry(11),
            reset_count_entry(1, "For an unknown reason"),
            reset_count_entry(2, "By the supply"),
            reset_count_entry(3, "By the reset pin"),
            reset_count_entry(4, "By the watchdog"),
            reset_count_entry(5, "As a master asked"),
            reset_count_entry(6, "After a brown-out"),
            reset_count_entry(7, "After a panic"),
            reset_count_entry(8, "After a hard fault"),
            reset_count_entry(9, "After the crystal stopped"),
            reset_count_entry(10, "After a stack overflow"),
            reset_count_entry(11, "After a register had changed"),
        ],
    ),
    record_object(
        0x2010,
        "Reference taken by Zero",
        &[
            highest_subindex_entry(13),
            read_write_entry(
                1,
                "Elongation in nm",
                DataType::I32,
                EntryContent::ReferenceElongation,
                0,
            ),
            read_write_entry(2, "Error of X in nm", DataType::I32, EntryContent::Reference(0), 0),
            read_write_entry(3, "Error of Y in nm", DataType::I32, EntryContent::Reference(1), 0),
            read_write_entry(4, "Error of Z in nm", DataType::I32, EntryContent::Reference(2), 0),
            read_only_entry(5, "A reference is in force", DataType::U8, EntryContent::HasReference),
            Entry {
                subindex: 6,
                name: "Forget the reference (write zero as text), offer what was written (back)",
                kind: DataType::U32,
                access: AccessType::Write,
                what: EntryContent::Forget,
                default: None,
            },
            read_only_entry(
                7,
                "Offered: elongation in nm",
                DataType::I32,
                EntryContent::OfferedElongation,
            ),
            read_only_entry(
                8,
                "Offered: error of X in nm",
                DataType::I32,
                EntryContent::Offered(0),
            ),
            read_only_entry(
                9,
                "Offered: error of Y in nm",
                DataType::I32,
                EntryContent::Offered(1),
            ),
            read_only_entry(
                10,
                "Offered: error of Z in nm",
                DataType::I32,
                EntryContent::Offered(2),
            ),
            read_only_entry(
                11,
                "Taken at, in s since 1970 (UTC)",
                DataType::U32,
                EntryContent::ReferenceUtc,
            ),
            read_only_entry(
                12,
                "Taken by (kind and line of the write)",
                DataType::U16,
                EntryContent::ReferenceOrigin,
            ),
            read_only_entry(13, "Age in s", DataType::U32, EntryContent::ReferenceAge),
        ],
    ),
    array_object(
        0x2011,
        "Learned, as it is applied",
        &[
            highest_subindex_entry(5),
            read_only_entry(1, "Growth in 0.001 %", DataType::I32, EntryContent::Learned(0)),
            read_only_entry(2, "X in 0.001 %", DataType::I32, EntryContent::Learned(1)),
            read_only_entry(3, "Y in 0.001 %", DataType::I32, EntryContent::Learned(2)),
            read_only_entry(4, "Z in 0.001 %", DataType::I32, EntryContent::Learned(3)),
            read_only_entry(5, "Zero of the growth in nm", DataType::I32, EntryContent::Learned(4)),
        ],
    ),
    record_object(
        0x2012,
        "Tool and conditions",
        &[
            highest_subindex_entry(3),
            read_only_entry(1, "Tool", DataType::U16, EntryContent::Tool),
            read_only_entry(2, "Conditions", DataType::U16, EntryContent::Conditions),
            read_only_entry(
                3,
                "0 unknown, 1 from the CNC, 2 lost",
                DataType::U8,
                EntryContent::ConditionsOrigin,
            ),
        ],
    ),
    var_object(
        0x2020,
        "RMS noise in thousandths of a code",
        &[read_only_entry(
            0,
            "RMS noise in thousandths of a code",
            DataType::U32,
            EntryContent::Noise,
        )],
    ),
    array_object(
        0x2030,
        "Frames from the CNC",
        &[
            highest_subindex_entry(5),
            receiver_counter_entry(1, "Accepted", ReceiverCounter::Accepted),
            receiver_counter_entry(2, "Malformed", ReceiverCounter::Malformed),
            receiver_counter_entry(3, "Damaged", ReceiverCounter::Crc),
            receiver_counter_entry(4, "Out of sequence", ReceiverCounter::Sequence),
            receiver_counter_entry(5, "Lost", ReceiverCounter::Lost),
        ],
    ),
    record_object(
        0x2100,
        "Calibration",
        &[
            highest_subindex_entry(5),
            read_only_entry(1, "Running calibration", DataType::Domain, EntryContent::Running),
            Entry {
                subindex: 2,
                name: "New calibration (used from the next start)",
                kind: DataType::Domain,
                access: AccessType::ReadWrite,
                what: EntryContent::New,
                default: None,
            },
            read_only_entry(
                3,
                "CRC of the running calibration",
                DataType::U32,
                EntryContent::RunningCrc,
            ),
            read_only_entry(4, "CRC of the new calibration", DataType::U32, EntryContent::NewCrc),
            Entry {
                subindex: 5,
                name: "Drop the new calibration (write drop as text)",
                kind: DataType::U32,
                access: AccessType::Write,
                what: EntryContent::DropNew,
                default: None,
            },
        ],
    ),
    record_object(
        0x2101,
        "Machine of the running calibration",
        &[
            highest_subindex_entry(5),
            read_only_entry(1, "Name", DataType::Text, EntryContent::MachineName),
            read_only_entry(2, "Serial number", DataType::Text, EntryContent::MachineSerial),
            read_only_entry(
                3,
                "Board, low word of its chip's number",
                DataType::U32,
                EntryContent::MachineBoard(0),
            ),
            read_only_entry(4, "Board, middle word", DataType::U32, EntryContent::MachineBoard(1)),
            read_only_entry(5, "Board, high word", DataType::U32, EntryContent::MachineBoard(2)),
        ],
    ),
    record_object(
        0x2110,
        "Writes to the board",
        &[
            highest_subindex_entry(2),
            read_only_entry(
                1,
                "The last writes (24 bytes each)",
                DataType::Domain,
                EntryContent::WriteLog,
            ),
            read_write_entry(
                2,
                "Time of day in s since 1970 (UTC)",
                DataType::U32,
                EntryContent::Utc,
                0,
            ),
        ],
    ),
    record_object(
        0x2120,
        "New firmware",
        &[
            highest_subindex_entry(5),
            domain_entry(1, "Header (erases the other slot)", EntryContent::FirmwareHeader),
            domain_entry(2, "Image, from the bytes that have come on", EntryContent::FirmwareImage),
            read_only_entry(
                3,
                "Bytes that have come",
                DataType::U32,
                EntryContent::FirmwareReceived,
            ),
            read_only_entry(
                4,
                "Tag of the firmware under way",
                DataType::U32,
                EntryContent::FirmwareTag,
            ),
            read_only_entry(
                5,
                "Why the last one was refused",
                DataType::U8,
                EntryContent::FirmwareRefused,
            ),
        ],
    ),
    record_object(
        0x2121,
        "Firmware slots",
        &[
            highest_subindex_entry(7),
            read_only_entry(
                1,
                "Slot that runs (0 A, 1 B)",
                DataType::U8,
                EntryContent::RunningSlot,
            ),
            read_only_entry(2, "Version in A", DataType::U32, EntryContent::SlotVersion(0)),
            read_only_entry(3, "Version in B", DataType::U32, EntryContent::SlotVersion(1)),
            read_only_entry(
                4,
                "Status of A, and its starts",
                DataType::U16,
                EntryContent::SlotStatus(0),
            ),
            read_only_entry(
                5,
                "Status of B, and its starts",
                DataType::U16,
                EntryContent::SlotStatus(1),
            ),
            read_only_entry(
                6,
                "Oldest version that may start",
                DataType::U32,
                EntryContent::FirmwareFloor,
            ),
            read_only_entry(
                7,
                "Why the slot that runs was chosen",
                DataType::U32,
                EntryContent::SlotChoice,
            ),
        ],
    ),
    array_object(
        0x6131,
        "AI physical unit process value",
        inputs!(celsius_unit_entry, micrometres_unit_entry),
    ),
    array_object(
        0x6132,
        "AI decimal digits process value",
        inputs!(decimal_digits_entry, decimal_digits_entry),
    ),
    array_object(0x6150, "AI status", inputs!(status_entry, status_entry)),
    array_object(
        0x9130,
        "AI input process value",
        inputs!(process_value_entry, process_value_entry),
    ),
];
