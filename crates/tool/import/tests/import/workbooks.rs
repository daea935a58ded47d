//! Workbooks, which the tests make themselves: a zip archive of XML.

use std::path::Path;

use trueup_import::{ImportError, import};

use crate::{QuestionTopic, answers, column, read_as, values};

/// Returns a zip archive of these parts, not compressed.
fn zip(parts: &[(&str, &str)]) -> Vec<u8> {
    let (mut body, mut directory) = (Vec::new(), Vec::new());
    let crc = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC);
    for (name, text) in parts {
        let offset = u32::try_from(body.len()).expect("small");
        let size = u32::try_from(text.len()).expect("small");
        let mut common = Vec::new();
        // Version, flags, method, time, date.
        for value in [20_u16, 0, 0, 0, 33] {
            common.extend(value.to_le_bytes());
        }
        for value in [crc.checksum(text.as_bytes()), size, size] {
            common.extend(value.to_le_bytes());
        }
        common.extend(u16::try_from(name.len()).expect("short").to_le_bytes());
        common.extend(0_u16.to_le_bytes());
        body.extend(b"PK\x03\x04");
        body.extend(&common);
        body.extend(name.as_bytes());
        body.extend(text.as_bytes());
        directory.extend(b"PK\x01\x02\x14\0");
        directory.extend(&common);
        directory.extend([0; 10]);
        directory.extend(offset.to_le_bytes());
        directory.extend(name.as_bytes());
    }
    let start = u32::try_from(body.len()).expect("small");
    let length = u32::try_from(directory.len()).expect("small");
    let count = u16::try_from(parts.len()).expect("few");
    body.extend(&directory);
    body.extend(b"PK\x05\x06\0\0\0\0");
    body.extend(count.to_le_bytes());
    body.extend(count.to_le_bytes());
    body.extend(length.to_le_bytes());
    body.extend(start.to_le_bytes());
    body.extend([0, 0]);
    body
}

const XML: &str = "<?xml version=\"1.0\" encoding=\"UTF-8\"?>";

/// Returns a sheet of rows of cells as Excel writes them: `t:` a text, `d:` a date and time, else a number.
fn sheet(rows: &[&[&str]]) -> String {
    let mut xml = format!(
        "{XML}<worksheet xmlns=\"http://schemas.openxmlformats.org/spreadsheetml/2006/main\"><sheetData>"
    );
    for (row, cells) in rows.iter().enumerate() {
        xml += &format!("<row r=\"{}\">", row + 1);
        for (column, cell) in cells.iter().enumerate() {
            let place =
                format!("{}{}", char::from(b'A' + u8::try_from(column).expect("few")), row + 1);
            xml += &match cell.split_once(':') {
                _ if cell.is_empty() => String::new(),
                Some(("t", text)) => {
                    format!("<c r=\"{place}\" t=\"inlineStr\"><is><t>{text}</t></is></c>")
                }
                Some(("d", days)) => format!("<c r=\"{place}\" s=\"1\"><v>{days}</v></c>"),
                _ => format!("<c r=\"{place}\"><v>{cell}</v></c>"),
            };
        }
        xml += "</row>";
    }
    xml + "</sheetData></worksheet>"
}

fn xlsx(sheets: &[(&str, String)]) -> Vec<u8> {
    let main = "http://schemas.openxmlformats.org";
    let (mut list, mut relations, mut types) = (String::new(), String::new(), String::new());
    for (at, (name, _)) in sheets.iter().enumerate() {
        let id = at + 1;
        list += &format!("<sheet name=\"{name}\" sheetId=\"{id}\" r:id=\"rId{id}\"/>");
        relations += &format!(
            "<Relationship Id=\"rId{id}\" Type=\"{main}/officeDocument/2006/relationships/worksheet\" \
             Target=\"worksheets/sheet{id}.xml\"/>"
        );
        types += &format!(
            "<Override PartName=\"/xl/worksheets/sheet{id}.xml\" \
             ContentType=\"application/vnd.openxmlformats-officedocument.spreadsheetml.worksheet+xml\"/>"
        );
    }
    let package = format!("{main}/package/2006");
    let content = format!(
        "{XML}<Types xmlns=\"{package}/content-types\"><Default Extension=\"rels\" \
         ContentType=\"application/vnd.openxmlformats-package.relationships+xml\"/><Override \
         PartName=\"/xl/workbook.xml\" ContentType=\
         \"application/vnd.openxmlformats-officedocument.spreadsheetml.sheet.main+xml\"/>{types}</Types>"
    );
    let root = format!(
        "{XML}<Relationships xmlns=\"{package}/relationships\"><Relationship Id=\"rId1\" \
         Type=\"{main}/officeDocument/2006/relationships/officeDocument\" Target=\"xl/workbook.xml\"/></Relationships>"
    );
    let book = format!(
        "{XML}<workbook xmlns=\"{main}/spreadsheetml/2006/main\" \
         xmlns:r=\"{main}/officeDocument/2006/relationships\"><sheets>{list}</sheets></workbook>"
    );
    let styles = format!(
        "<Relationship Id=\"rId99\" Type=\"{main}/officeDocument/2006/relationships/styles\" Target=\"styles.xml\"/>"
    );
    let relations = format!(
        "{XML}<Relationships xmlns=\"{package}/relationships\">{relations}{styles}</Relationships>"
    );
    let styles = format!(
        "{XML}<styleSheet xmlns=\"{main}/spreadsheetml/2006/main\"><cellXfs count=\"2\"><xf numFmtId=\"0\"/><xf \
         numFmtId=\"22\"/></cellXfs></styleSheet>"
    );
    let names: Vec<String> =
        (1..=sheets.len()).map(|id| format!("xl/worksheets/sheet{id}.xml")).collect();
    let mut parts: Vec<(&str, &str)> = vec![
        ("[Content_Types].xml", &content),
        ("_rels/.rels", &root),
        ("xl/workbook.xml", &book),
        ("xl/_rels/workbook.xml.rels", &relations),
        ("xl/styles.xml", &styles),
    ];
    parts.extend(names.iter().map(String::as_str).zip(sheets.iter().map(|(_, xml)| xml.as_str())));
    zip(&parts)
}

fn table() -> String {
    sheet(&[
        &["t:Protokoll", ""],
        &["t:Zeit", "t:X [mm]", "t:Messuhr [µm]", "t:Spindel [°F]"],
        &["d:46115.34375", "0", "1.5", "68"],
        &["d:46115.345138888886", "100.25", "t:2,5", "69.8"],
        &["d:46115.346527777776", "200", "", "71.6"],
    ])
}

#[test]
fn a_sheet_of_excel_is_read_with_its_dates_and_without_its_settings() {
    let given = [(column("Messuhr"), "measured_dx_um")];
    let imported = read_as("r.xlsx", &xlsx(&[("Tabelle1", table())]), &given);
    assert_eq!(
        imported.run,
        "time_s,x_mm,measured_dx_um,temp_spindel_c\n0,0,1.5,20\n120,100.25,2.5,21\n240,200,,22\n"
    );
    // A time of day alone.
    let times =
        sheet(&[&["t:Uhrzeit", "t:flow"], &["d:0.34375", "1"], &["d:0.3444444444444444", "2"]]);
    assert_eq!(values(&read_as("r.xlsx", &xlsx(&[("a", times)]), &[]), "time_s"), [0.0, 60.0]);
}

#[test]
fn the_only_sheet_with_a_table_is_taken_and_of_two_one_is_asked_for() {
    let notes = sheet(&[&["t:Notes"], &["t:nothing here"]]);
    let given = [(column("Messuhr"), "measured_dx_um")];
    let imported = read_as("r.xlsx", &xlsx(&[("Notes", notes), ("Data", table())]), &given);
    assert_eq!(imported.rows, 3);
    let two = xlsx(&[("Monday", table()), ("Tuesday", table())]);
    let Err(ImportError::Open(questions)) = import(&two, Path::new("r.xlsx"), &answers(&given))
    else {
        panic!("two tables")
    };
    assert_eq!((&questions[0].topic, questions[0].choices.len()), (&QuestionTopic::Sheet, 2));
    assert_eq!(questions[0].flag(), "--sheet Monday (or Tuesday)");
    let given = [given[0].clone(), (QuestionTopic::Sheet, "tuesday")];
    assert_eq!(read_as("r.xlsx", &two, &given).rows, 3);
}

#[test]
fn a_sheet_of_libreoffice_is_read() {
    let cell = |kind: &str| format!("<table:table-cell {kind}");
    let text = |text: &str| {
        cell(&format!("office:value-type=\"string\"><text:p>{text}</text:p></table:table-cell>"))
    };
    let number =
        |value: &str| cell(&format!("office:value-type=\"float\" office:value=\"{value}\"/>"));
    let time =
        |value: &str| cell(&format!("office:value-type=\"time\" office:time-value=\"{value}\"/>"));
    let row = |cells: &[String]| format!("<table:table-row>{}</table:table-row>", cells.concat());
    let rows = [
        row(&[text("Uhrzeit"), text("X [inch]"), text("Fehler X [µin]")]),
        row(&[time("PT08H15M00S"), number("1"), number("100")]),
        row(&[time("PT08H16M00S"), number("2"), number("-50")]),
    ];
    let content = format!(
        "{XML}<office:document-content xmlns:office=\"urn:oasis:names:tc:opendocument:xmlns:office:1.0\" \
         xmlns:table=\"urn:oasis:names:tc:opendocument:xmlns:table:1.0\" \
         xmlns:text=\"urn:oasis:names:tc:opendocument:xmlns:text:1.0\"><office:body><office:spreadsheet>\
         <table:table table:name=\"a\">{}</table:table></office:spreadsheet></office:body></office:document-content>",
        rows.concat()
    );
    let manifest = format!(
        "{XML}<manifest:manifest xmlns:manifest=\"urn:oasis:names:tc:opendocument:xmlns:manifest:1.0\"/>"
    );
    let bytes = zip(&[
        ("mimetype", "application/vnd.oasis.opendocument.spreadsheet"),
        ("META-INF/manifest.xml", &manifest),
        ("content.xml", &content),
    ]);
    let imported = read_as("r.ods", &bytes, &[]);
    assert_eq!(imported.run, "time_s,x_mm,measured_dx_um\n0,25.4,2.54\n60,50.8,-1.27\n");
}

#[test]
fn what_is_no_workbook_is_refused() {
    for bytes in [
        zip(&[("a", "b")]),
        b"PK\x03\x04".to_vec(),
        b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1rest".to_vec(),
    ] {
        let refused = import(&bytes, Path::new("r.xlsx"), &answers(&[]));
        let Err(ImportError::Bad(error)) = refused else { panic!("{refused:?}") };
        assert!(error.rule.contains("no workbook that can be read"), "{error}");
    }
    // An archive that states more than a machine's memory.
    let mut bomb = xlsx(&[("a", table())]);
    let entry = bomb.windows(4).position(|window| window == b"PK\x01\x02").expect("a directory");
    bomb[entry + 24..entry + 28].copy_from_slice(&u32::MAX.to_le_bytes());
    let refused = import(&bomb, Path::new("r.xlsx"), &answers(&[]));
    assert!(
        matches!(refused, Err(ImportError::Bad(error)) if error.rule.contains("unpacks to more"))
    );
}
