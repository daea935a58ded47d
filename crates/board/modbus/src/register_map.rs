//! Every register: where it stands, how wide it is, what it says.
//!
//! A block starts at address 0 of its kind; a name's second register is the lower half (the high word
//! comes first, as an S7 keeps a `DINT`). In a data block of an S7 a register is two bytes, so its
//! address is twice the number here, from where the block begins.

/// Registers and number format of a name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RegisterFormat {
    /// One register, 0…65 535.
    Unsigned,
    /// One register, −32 768…32 767.
    Signed,
    /// Two registers, the high one first, −2³¹…2³¹ − 1.
    Long,
    /// Two registers, the high one first, bits or 0…2³² − 1.
    LongUnsigned,
}

impl RegisterFormat {
    /// Returns how many registers.
    #[must_use]
    pub(crate) const fn register_count(self) -> usize {
        match self {
            Self::Unsigned | Self::Signed => 1,
            Self::Long | Self::LongUnsigned => 2,
        }
    }

    /// As IEC 61131-3 calls it.
    #[cfg(test)]
    #[must_use]
    pub(crate) const fn iec_type_name(self) -> &'static str {
        match self {
            Self::Unsigned => "WORD",
            Self::Signed => "INT",
            Self::Long => "DINT",
            Self::LongUnsigned => "DWORD",
        }
    }
}

/// One name of a block.
#[derive(Clone, Copy, Debug)]
pub struct Register {
    /// Its address: of its first register, from 0.
    pub address: usize,
    /// Its registers and number format.
    pub form: RegisterFormat,
    /// Its name.
    pub name: &'static str,
    /// Its unit for one step of the number; empty: none.
    pub unit: &'static str,
    /// Its description.
    pub text: &'static str,
}

/// The number in [`LAYOUT`]: another means another table.
pub(crate) const LAYOUT_VERSION: u16 = 1;
/// The data ID of the input block, which its CRC covers: the CAN identifier of `OffsetXY`.
pub(crate) const INPUT_DATA_ID: u16 = trueup_link::layout::OFFSET_XY_ID;
/// The data ID of the holding block: the CAN identifier of `Control`.
pub(crate) const HOLDING_DATA_ID: u16 = trueup_link::layout::CONTROL_ID;
/// The data ID of the holding block with tool and conditions: the CAN identifier of `Conditions`.
pub(crate) const CONDITIONS_DATA_ID: u16 = trueup_link::layout::CONDITIONS_ID;
/// The offset and the elongation that mean "not available".
pub const NOT_AVAILABLE: i32 = i32::MIN;
/// The temperature that means "not available".
pub(crate) const TEMPERATURE_NOT_AVAILABLE: i16 = i16::MIN;

/// Where the two registers stand that a master's order of words is tried with, next to both blocks.
pub(crate) const WORD_ORDER_ADDRESS: usize = 100;
/// Their content: 16 909 060 (0x01020304) where the high word comes first.
pub(crate) const WORD_ORDER_PATTERN: [u16; 2] = [0x0102, 0x0304];

macro_rules! block {
    ($(#[$doc:meta])* $all:ident, $len:ident: $($const:ident $address:literal $form:ident $name:literal $unit:literal $text:literal;)*) => {
        $(#[doc = concat!("Address of `", $name, "`: ", $text)] pub const $const: usize = $address;)*
        $(#[$doc])*
        pub const $all: &[Register] = &[
            $(Register { address: $address, form: RegisterFormat::$form, name: $name, unit: $unit, text: $text },)*
        ];
        /// Registers up to the end of that block, its CRC included.
        pub const $len: usize = block_len($all);
    };
}

const fn block_len(block: &[Register]) -> usize {
    let last = &block[block.len().saturating_sub(1)];
    last.address.saturating_add(last.form.register_count())
}

block! {
    /// Input registers: what the bridge says (function 4).
    INPUT, INPUT_LEN:
    LAYOUT 0 Unsigned "Layout" "" "1. Another number means another table: use nothing.";
    COUNTER 1 Unsigned "Counter" "" "One more with each new content, 65535 is followed by 0. While it stands still, nothing new came: the gateway or its line is dead. While the bridge is silent it goes on, with Quality 6.";
    OFFSET_X 2 Long "OffsetX" "0.01 µm" "What the control adds to its command on X. -2147483648: not available.";
    OFFSET_Y 4 Long "OffsetY" "0.01 µm" "The same on Y.";
    OFFSET_Z 6 Long "OffsetZ" "0.01 µm" "The same on Z.";
    QUALITY 8 Unsigned "Quality" "" "0 off, 1 live, 2 temperature model, 3 warm-up model, 4 hold, 5 ramping out, 6 fault: no offset.";
    FLAGS 9 Unsigned "Flags" "" "Bit 0 clamped, 1 slewing, 2 sensor fault, 3 samples missing, 4 CNC lost, 5 speed unknown, 6 outside a table, 7 board degraded.";
    AGE 10 Unsigned "Age" "ms" "Since the newest sample that the offsets rest on, the way up to here included. The bridge says no more than 255.";
    LAST_REFUSED 11 Unsigned "LastRefused" "" "Why a holding block was last refused: 0 none was, 1 a value without meaning, 2 its CRC, 3 its counter stood still, 4 its counter jumped; of `trueup gateway` also 5 it came after a silence and may be old, 6 Engage, but the bridge runs on another calibration than the pinned one.";
    REFUSED 12 Unsigned "Refused" "" "Holding blocks that were refused; stops at 65535.";
    STATE 13 LongUnsigned "State" "" "State bits of the bridge as in Status item 8; 0: all is well.";
    CALIBRATION 15 LongUnsigned "Calibration" "" "CRC of the calibration that the bridge runs on; 0: none, or not yet known.";
    ELONGATION 17 Long "Elongation" "0.001 µm" "Elongation of the spindle by its sensor. -2147483648: not available.";
    TEMPERATURE_0 19 Signed "Temperature0" "0.01 °C" "Temperature of channel 0 of the machine file. -32768: not available.";
    TEMPERATURE_1 20 Signed "Temperature1" "0.01 °C" "Channel 1.";
    TEMPERATURE_2 21 Signed "Temperature2" "0.01 °C" "Channel 2.";
    TEMPERATURE_3 22 Signed "Temperature3" "0.01 °C" "Channel 3.";
    TEMPERATURE_4 23 Signed "Temperature4" "0.01 °C" "Channel 4.";
    TEMPERATURE_5 24 Signed "Temperature5" "0.01 °C" "Channel 5.";
    TEMPERATURE_6 25 Signed "Temperature6" "0.01 °C" "Channel 6.";
    TEMPERATURE_7 26 Signed "Temperature7" "0.01 °C" "Channel 7.";
    INPUT_CRC 27 Unsigned "Crc" "" "CRC over the registers before it and the data ID 0x0181.";
}

block! {
    /// Holding registers: what the control says (function 16, the whole block in one request; function 3
    /// reads back what was last taken).
    HOLDING, HOLDING_LEN:
    CNC_COUNTER 0 Unsigned "Counter" "" "One more with each block, 65535 is followed by 0. Steps of 1 to 15 are taken.";
    CONTROL 1 Unsigned "Control" "" "Bit 0 Engage, 1 Referenced, 2 Zero, 3 Service, 4 Confirm. The control's sign of life: without a new block for the link timeout the bridge holds, then ramps out.";
    PRESENT 2 Unsigned "Present" "" "Which of the values below are meant: bit 0 X, 1 Y, 2 Z, 3 both angles, 4 speed and load, 5 tool and conditions (in a block of 20 registers). The others are not sent to the bridge, which then knows that it does not know.";
    DIRECTIONS 3 Unsigned "Directions" "" "Which way each axis came: bits 0 and 1 X, 2 and 3 Y, 4 and 5 Z; 0 standing, 1 positive, 3 negative.";
    POSITION_X 4 Long "PositionX" "0.00001 mm" "Commanded machine position of X without the external offset.";
    POSITION_Y 6 Long "PositionY" "0.00001 mm" "The same of Y.";
    POSITION_Z 8 Long "PositionZ" "0.00001 mm" "The same of Z.";
    ANGLE_1 10 Long "Angle1" "0.0005°" "Commanded angle of the first of the machine file's head_axes.";
    ANGLE_2 12 Long "Angle2" "0.0005°" "Commanded angle of the second.";
    SPEED 14 Unsigned "Speed" "r/min" "Spindle speed, whichever way it turns.";
    LOAD 15 Signed "Load" "N" "Axial cutting force; pushing the tool back is positive.";
    HOLDING_CRC 16 Unsigned "Crc" "" "CRC over the registers before it and the data ID 0x0302.";
}

block! {
    /// Holding registers behind these, for a control that says tool and conditions: all 20 are written in one request.
    CONDITIONS, WHOLE_HOLDING_LEN:
    TOOL 17 Unsigned "Tool" "" "Number of the tool in the spindle; 0: none.";
    CONDITION_BITS 18 Unsigned "Conditions" "" "Bit n: whether the condition with `bit = n` in the machine file holds.";
    CONDITIONS_CRC 19 Unsigned "ConditionsCrc" "" "CRC over all registers before it and the data ID 0x0402.";
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::{format, fs, string::String, vec::Vec};

    #[test]
    fn a_block_has_neither_holes_nor_overlaps() {
        for (block, first) in [(INPUT, 0), (HOLDING, 0), (CONDITIONS, HOLDING_LEN)] {
            let mut next = first;
            for register in block {
                assert_eq!(register.address, next, "{}", register.name);
                next += register.form.register_count();
            }
            assert!(next <= 123, "one request reads or writes it");
        }
    }

    fn markdown(block: &[Register], function: &str) -> String {
        let mut text = format!(
            "| address | byte in an S7 | name | type | unit | {function} |\n|---|---|---|---|---|---|\n"
        );
        for Register { address, form, name, unit, text: what } in block {
            let last = address + form.register_count() - 1;
            let place =
                if last == *address { format!("{address}") } else { format!("{address}–{last}") };
            text += &format!(
                "| {place} | {} | `{name}` | {} | {unit} | {what} |\n",
                2 * address,
                form.iec_type_name()
            );
        }
        text
    }

    fn awl(block: &[Register], prefix: &str) -> String {
        let line = |register: &Register| {
            let Register { address, form, name, unit, .. } = register;
            let unit = unit.replace('µ', "u").replace('°', "deg ");
            let field = format!("  {prefix}{name} : {};", form.iec_type_name());
            let place = format!("{field:<30}// +{}  {unit}", 2 * address);
            format!("{}\n", place.trim_end())
        };
        block.iter().map(line).collect()
    }

    /// The data block of an S7 is this one; `TRUEUP_WRITE_DOCS=1` writes it.
    #[test]
    fn the_data_block_of_the_s7_has_these_fields() {
        const FILE: &str = concat!(
            env!("CARGO_MANIFEST_DIR"),
            "/../../../integrations/siemens-840d/trueup_db.awl"
        );
        let requested = format!(
            "// trueup: what the gateway writes (byte 0 to 55, in mode slope to 63), and what it reads (byte 64 to 103). Made from the table\n\
             // of registers in crates/board/modbus; what each means: docs/modbus.md. Not optimized, not write-protected.\n\
             DATA_BLOCK DB 900\nTITLE = trueup\nVERSION : 1.0\nSTRUCT\n{}  SlopeX : INT;               // +56  0.1 um/m, mode slope\n\
             \x20 SlopeY : INT;               // +58  0.1 um/m\n\
             \x20 SlopeZ : INT;               // +60  0.1 um/m\n\
             \x20 SlopeCrc : WORD;            // +62  over byte 0 to 61 and the data ID 16#381\n\
             // from byte 64; a block without tool and conditions ends at CncCrc\n{}{}END_STRUCT;\nBEGIN\nEND_DATA_BLOCK\n",
            awl(INPUT, ""),
            awl(HOLDING, "Cnc"),
            awl(CONDITIONS, "Cnc")
        );
        if std::env::var_os("TRUEUP_WRITE_DOCS").is_some() {
            fs::write(FILE, &requested).expect("the file can be written");
        } else {
            let file = fs::read_to_string(FILE).expect("trueup_db.awl");
            assert!(file == requested, "TRUEUP_WRITE_DOCS=1 cargo test -p trueup-modbus writes it");
        }
    }

    /// The program of an S7 copies each register from or to its place, in their order.
    #[test]
    fn the_program_of_the_s7_copies_every_register() {
        const FILE: &str = concat!(
            env!("CARGO_MANIFEST_DIR"),
            "/../../../integrations/siemens-840d/trueup_fb.awl"
        );
        let file = fs::read_to_string(FILE).expect("trueup_fb.awl");
        let copies = |word: &str| -> Vec<String> {
            let lines = file.lines().filter_map(|line| line.split_once(word));
            lines.map(|(_, at)| at.split(';').next().unwrap_or_default().into()).collect()
        };
        let places = |blocks: &[&[Register]], first: usize| -> Vec<String> {
            let place = |register: &Register| {
                let width = if register.form.register_count() == 1 { 'W' } else { 'D' };
                format!("{width} {}", first + 2 * register.address)
            };
            blocks.iter().copied().flatten().map(place).collect()
        };
        let mut read = places(&[INPUT], 0);
        read.extend([56, 58, 60, 62].map(|byte| format!("W {byte}")));
        assert_eq!(copies("L     DB900.DB"), read);
        assert_eq!(copies("T     DB900.DB"), places(&[HOLDING, CONDITIONS], 64));
        let crcs: Vec<String> = copies("LEN := ");
        let crc =
            |last: usize, id: u16| format!("{}, ID := W#16#{id:X}, RET_VAL := #CRC)", 2 * last);
        let input = crc(INPUT_CRC, INPUT_DATA_ID);
        let holding = [crc(HOLDING_CRC, HOLDING_DATA_ID), crc(CONDITIONS_CRC, CONDITIONS_DATA_ID)];
        assert_eq!([&crcs[0], &crcs[2], &crcs[3]], [&input, &holding[0], &holding[1]]);
    }

    /// The tables of the documentation are these; `TRUEUP_WRITE_DOCS=1` writes them.
    #[test]
    fn the_documentation_has_these_tables() {
        const PAGE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../docs/modbus.md");
        let page = fs::read_to_string(PAGE).expect("docs/modbus.md");
        let mut requested = page.clone();
        for (mark, table) in [
            ("input registers", markdown(INPUT, "what the bridge says (function 4)")),
            ("holding registers", markdown(HOLDING, "what the control says (functions 16 and 3)")),
            ("conditions", markdown(CONDITIONS, "tool and conditions (functions 16 and 3)")),
        ] {
            let (begin, end) = (format!("<!-- {mark} -->\n"), format!("<!-- end of {mark} -->"));
            let (before, rest) = requested.split_once(&begin).expect("the mark of its begin");
            let (_, after) = rest.split_once(&end).expect("the mark of its end");
            requested = format!("{before}{begin}{table}{end}{after}");
        }
        if std::env::var_os("TRUEUP_WRITE_DOCS").is_some() {
            fs::write(PAGE, &requested).expect("the page can be written");
        } else {
            assert!(page == requested, "TRUEUP_WRITE_DOCS=1 cargo test -p trueup-modbus writes it");
        }
    }
}
