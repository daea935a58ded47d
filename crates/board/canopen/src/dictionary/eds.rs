//! `trueup.eds`, printed from the table: the electronic data sheet (CiA 306) that CANopen tools
//! read.

use core::fmt;

use super::{AccessType, DataType, Entry, EntryContent, OBJECTS, Object, ObjectCode};

/// Prints the whole file.
///
/// # Errors
/// None but those of `out`.
pub(crate) fn write_eds(out: &mut impl fmt::Write) -> fmt::Result {
    out.write_str(EDS_PREAMBLE)?;
    let is_mandatory = |object: &Object| [0x1000, 0x1001, 0x1018].contains(&object.index);
    let is_manufacturers = |object: &Object| (0x2000..0x6000).contains(&object.index);
    write_object_list(out, "MandatoryObjects", is_mandatory)?;
    write_object_list(out, "OptionalObjects", |object| {
        !is_mandatory(object) && !is_manufacturers(object)
    })?;
    write_object_list(out, "ManufacturerObjects", is_manufacturers)?;
    OBJECTS.iter().try_for_each(|object| write_object(out, object))
}

const EDS_PREAMBLE: &str = concat!(
    "[FileInfo]\nFileName=trueup.eds\nFileVersion=1\nFileRevision=1\nEDSVersion=4.0\n",
    "Description=trueup bridge, printed from its object dictionary\n\n",
    "[DeviceInfo]\nVendorName=trueup\nVendorNumber=0\nProductName=trueup bridge\n",
    "ProductNumber=1\nRevisionNumber=65536\nOrderCode=trueup\n",
    "BaudRate_10=0\nBaudRate_20=0\nBaudRate_50=0\nBaudRate_125=0\nBaudRate_250=0\n",
    "BaudRate_500=0\nBaudRate_800=0\nBaudRate_1000=1\n",
    "SimpleBootUpMaster=0\nSimpleBootUpSlave=0\nGranularity=0\nDynamicChannelsSupported=0\n",
    "GroupMessaging=0\nNrOfRXPDO=0\nNrOfTXPDO=0\nLSS_Supported=0\n\n",
    "[DummyUsage]\nDummy0001=0\nDummy0002=0\nDummy0003=0\nDummy0004=0\nDummy0005=0\n",
    "Dummy0006=0\nDummy0007=0\n\n",
    "[Comments]\nLines=10\n",
    "Line1=Offsets, status and frames of the CNC are described by trueup.dbc: they are protected.\n",
    "Line2=A new calibration is used from the next start of the board.\n",
    "Line3=NMT start, stop and pre-operational have no effect: a machine relies on the offsets while\n",
    "Line4=it cuts; Control starts and stops them, which is protected. The heartbeat says\n",
    "Line5=what the bridge does: operational, or stopped while the offsets are not available.\n",
    "Line6=NMT reset node restarts the board if no offset is followed, else it has no effect.\n",
    "Line7=NMT reset communication sets 0x1015, 0x1016, 0x1017 back; the offsets go on.\n",
    "Line8=Whatever is written, and NMT reset node, needs Service in the Control that the bridge receives\n",
    "Line9=and that nothing is engaged: else 0x08000022. 0x2001:8 says who may: 2 is yes.\n",
    "Line10=A calibration may ask for the service switch as well: while it is open, 0x08000021 (0x2001:8: 3).\n\n",
);

fn write_object_list(
    out: &mut impl fmt::Write,
    name: &str,
    is_in: impl Fn(&Object) -> bool,
) -> fmt::Result {
    let objects = || OBJECTS.iter().filter(|object| is_in(object));
    write!(out, "[{name}]\nSupportedObjects={}\n", objects().count())?;
    for (number, object) in (1..).zip(objects()) {
        let number: u32 = number;
        writeln!(out, "{number}=0x{:04X}", object.index)?;
    }
    out.write_str("\n")
}

fn write_object(out: &mut impl fmt::Write, object: &Object) -> fmt::Result {
    let shape = match object.shape {
        ObjectCode::Var => 0x7,
        ObjectCode::Array => 0x8,
        ObjectCode::Record => 0x9,
    };
    write!(out, "[{:04X}]\nParameterName={}\nObjectType=0x{shape:X}\n", object.index, object.name)?;
    if object.shape == ObjectCode::Var {
        return object.entries.iter().try_for_each(|entry| write_entry(out, entry));
    }
    write!(out, "SubNumber={}\n\n", object.entries.len())?;
    object.entries.iter().try_for_each(|entry| {
        let (index, subindex) = (object.index, entry.subindex);
        let name = entry.name;
        write!(out, "[{index:04X}sub{subindex:X}]\nParameterName={name}\nObjectType=0x7\n")?;
        write_entry(out, entry)
    })
}

fn write_entry(out: &mut impl fmt::Write, entry: &Entry) -> fmt::Result {
    let kind = match entry.kind {
        DataType::I32 => 0x4,
        DataType::U8 => 0x5,
        DataType::U16 => 0x6,
        DataType::U32 => 0x7,
        DataType::Text => 0x9,
        DataType::Domain => 0xF,
    };
    let access = match entry.access {
        AccessType::Constant => "const",
        AccessType::Read => "ro",
        AccessType::ReadWrite => "rw",
        AccessType::Write => "wo",
    };
    write!(out, "DataType=0x{kind:04X}\nAccessType={access}\n")?;
    match (entry.what, entry.default) {
        (EntryContent::Fixed(number), _) | (_, Some(number)) => {
            writeln!(out, "DefaultValue=0x{number:X}")?
        }
        (EntryContent::Text(text), _) => writeln!(out, "DefaultValue={text}")?,
        _ => {}
    }
    out.write_str("PDOMapping=0\n\n")
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::{env, fs, path::Path, println, string::String};

    /// With `TRUEUP_WRITE_EDS=1` it writes the file instead.
    #[test]
    fn the_eds_file_is_what_the_table_prints() {
        let mut text = String::new();
        write_eds(&mut text).expect("a string takes everything");
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("trueup.eds");
        if env::var_os("TRUEUP_WRITE_EDS").is_some() {
            fs::write(&path, &text).expect("the crate's folder");
        }
        let entries: usize = OBJECTS.iter().map(|object| object.entries.len()).sum();
        println!("{} objects, {entries} entries, {} bytes", OBJECTS.len(), text.len());
        let file = fs::read_to_string(&path).expect("the file");
        assert!(
            file == text,
            "write it again: TRUEUP_WRITE_EDS=1 cargo test -p trueup-canopen eds"
        );
    }
}
