//! The run file: what was measured, one observation a row, in CSV.
//!
//! Numbers only, under one header row whose names carry the unit. A number that would be misread in
//! silence (a decimal comma, a repeated column, an infinite value, a row that is too short) is an
//! error with its line and column.
//!
//! The file is read line by line and its memory is that of its cells. A row is one line here, and
//! the lines are split by this module: the `csv` crate does not tell in which column of its line a
//! field begins, and its line numbers lag behind after CRLF and empty lines.

use std::{
    borrow::Cow,
    fmt::Display,
    fs::File,
    io::{BufRead, BufReader},
    path::{Path, PathBuf},
};

use crate::place::{BadInput, Place, did_you_mean, shortened};

/// A measured run.
#[derive(Clone, Debug)]
pub struct RunFile {
    path: PathBuf,
    columns: Vec<Column>,
    header_line: usize,
    /// The line of each row, from 1: empty lines are no rows.
    line_of_row: Vec<usize>,
}

/// One column of a run.
#[derive(Clone, Debug)]
pub struct Column {
    /// Its name in the header, without surrounding blanks.
    pub name: String,
    /// Its value in each row; NaN where it is missing.
    pub values: Vec<f64>,
    /// The character column at which each value stands in its line, from 1.
    starts: Vec<u32>,
}

impl RunFile {
    /// Reads the run file at `path`.
    ///
    /// # Errors
    /// The file cannot be read, or breaks a rule of [`Self::from_reader`].
    pub fn read(path: &Path) -> Result<Self, BadInput> {
        let file = File::open(path).map_err(|error| {
            BadInput::new(Place::start_of(path), format!("cannot be read: {error}"))
        })?;
        Self::from_reader(BufReader::new(file), path)
    }

    /// Reads a run from `source`; `path` names it in errors.
    ///
    /// Fields are separated by `,` or `;`, whichever is in the header more often. A byte order
    /// mark, CRLF, blanks around a field, `"` around it, and empty lines are accepted. An empty
    /// field and `nan` are missing values.
    ///
    /// # Errors
    /// No header or no row; a column without a name or with that of another; a row with more or
    /// fewer fields than the header; text, a decimal comma or an infinite value where a number
    /// belongs; `time_s` that runs back while `run` stays the same; `dir_*` other than 1 and −1;
    /// text that is not UTF-8; a source that cannot be read.
    pub fn from_reader(mut source: impl BufRead, path: &Path) -> Result<Self, BadInput> {
        let mut line = Line::default();
        loop {
            if !line.read(&mut source, path)? {
                let rule = "is empty: a run file needs a header row with the names of its columns";
                return Err(BadInput::new(Place::start_of(path), rule));
            }
            if !line.is_blank() {
                break;
            }
        }
        let separator = separator_of(&line.text);
        let mut run = Self {
            path: path.to_path_buf(),
            columns: Vec::new(),
            header_line: line.number,
            line_of_row: Vec::new(),
        };
        run.read_header(&line, separator)?;
        let mut order = TimeOrder::new(&run.columns);

        while line.read(&mut source, path)? {
            if !line.is_blank() {
                run.read_row(&line, separator)?;
                order.check(&run)?;
            }
        }
        if run.line_of_row.is_empty() {
            return Err(BadInput::new(
                run.header_place(),
                "there is a header row, but no row of values",
            ));
        }
        Ok(run)
    }

    /// The path under which the run was read.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The number of rows, at least 1.
    #[must_use]
    pub fn rows(&self) -> usize {
        self.line_of_row.len()
    }

    /// All columns, in the order of the file.
    #[must_use]
    pub fn columns(&self) -> &[Column] {
        &self.columns
    }

    /// The values of the column `name`, NaN where missing; `None` if there is no such column.
    #[must_use]
    pub fn column(&self, name: &str) -> Option<&[f64]> {
        self.columns.iter().find(|column| column.name == name).map(|column| &column.values[..])
    }

    /// The values of the column `name`, NaN where missing.
    ///
    /// # Errors
    /// There is no such column: the rule lists those that are there.
    pub fn require(&self, name: &str) -> Result<&[f64], BadInput> {
        self.column(name).ok_or_else(|| {
            let names = || self.columns.iter().map(|column| column.name.as_str());
            let there = names().collect::<Vec<_>>().join(", ");
            let suggestion = did_you_mean(name, names());
            let rule = format!("column {name} is missing; there are {there}{suggestion}");
            BadInput::new(self.header_place(), rule)
        })
    }

    /// Where the value of `column` in `row` (from 0) stands; the start of the row's line if there
    /// is no such column, of the file if there is no such row.
    #[must_use]
    pub fn place(&self, row: usize, column: &str) -> Place {
        let Some(&line) = self.line_of_row.get(row) else { return Place::start_of(&self.path) };
        let column = self
            .columns
            .iter()
            .find(|there| there.name == column)
            .and_then(|there| there.starts.get(row))
            .map_or(1, |&start| start as usize);
        Place { file: self.path.clone(), line, column }
    }

    /// The value of `column` in `row` (from 0) breaks a rule; `rule` goes on after the column's
    /// name: "40000 is outside 0…32768".
    #[must_use]
    pub fn bad(&self, row: usize, column: &str, rule: impl Display) -> BadInput {
        BadInput::new(self.place(row, column), format!("{column} {rule}"))
    }

    /// Where the header row begins: for what is wrong with the columns as a whole.
    pub(crate) fn header_place(&self) -> Place {
        Place { file: self.path.clone(), line: self.header_line, column: 1 }
    }

    fn read_header(&mut self, line: &Line, separator: char) -> Result<(), BadInput> {
        for field in Fields::of(&line.text, separator) {
            let field = field.map_err(|fault| line.bad_quote(&self.path, fault))?;
            let name = field.text.trim();
            let bad = |rule: String| BadInput::new(line.place(&self.path, field.column), rule);
            if name.is_empty() {
                return Err(bad(format!("column {} has no name", self.columns.len() + 1)));
            }
            if name.parse::<f64>().is_ok() {
                return Err(bad(format!(
                    "the first row must name the columns, but {} is a number",
                    shortened(name)
                )));
            }
            if name.contains('\t') {
                return Err(bad("columns must be separated by , or ; and not by tabs".into()));
            }
            if let Some(first) = self.columns.iter().position(|column| column.name == name) {
                let first = first + 1;
                return Err(bad(format!("column {name} is repeated: it is also column {first}")));
            }
            self.columns.push(Column {
                name: name.to_string(),
                values: Vec::new(),
                starts: Vec::new(),
            });
        }
        Ok(())
    }

    fn read_row(&mut self, line: &Line, separator: char) -> Result<(), BadInput> {
        let wanted = self.columns.len();
        let mut there = 0;
        for field in Fields::of(&line.text, separator) {
            let field = field.map_err(|fault| line.bad_quote(&self.path, fault))?;
            let place = || line.place(&self.path, field.column);
            let Some(column) = self.columns.get_mut(there) else {
                let fields = Fields::of(&line.text, separator).count();
                let hint =
                    if separator == ',' { " (decimals are written with a point)" } else { "" };
                let rule = format!("the row has {fields} fields, the header {wanted}{hint}");
                return Err(BadInput::new(place(), rule));
            };
            let value = read_number(&field.text)
                .and_then(|value| check_direction(&column.name, value))
                .map_err(|rule| BadInput::new(place(), format!("{} {rule}", column.name)))?;
            column.values.push(value);
            column.starts.push(u32::try_from(field.column).unwrap_or(u32::MAX));
            there += 1;
        }
        if there < wanted {
            let missing = &self.columns[there].name;
            let rule = format!("the row has {there} fields, the header {wanted}: no {missing}");
            let end = line.text.chars().count() + 1;
            return Err(BadInput::new(line.place(&self.path, end), rule));
        }
        self.line_of_row.push(line.number);
        Ok(())
    }
}

/// The value of a field, NaN if it is missing; else the rule it breaks.
fn read_number(field: &str) -> Result<f64, String> {
    let text = field.trim();
    if text.is_empty() {
        return Ok(f64::NAN);
    }
    match text.parse::<f64>() {
        Ok(value) if value.is_infinite() => Err(format!("{} is infinite", shortened(text))),
        Ok(value) => Ok(value),
        Err(_) if has_decimal_comma(text) => Err(format!(
            "{} has a decimal comma: decimals are written with a point",
            shortened(text)
        )),
        Err(_) => Err(format!("\"{}\" is not a number", shortened(text))),
    }
}

/// Whether `text` is a number but for its commas.
fn has_decimal_comma(text: &str) -> bool {
    let of_a_number = |c: char| c.is_ascii_digit() || "+-.,eE".contains(c);
    text.contains(',')
        && text.contains(|c: char| c.is_ascii_digit())
        && text.chars().all(of_a_number)
}

/// `dir_x`, `dir_y`, `dir_z` are the direction of approach: 1 or −1.
fn check_direction(column: &str, value: f64) -> Result<f64, String> {
    let is_direction = matches!(column, "dir_x" | "dir_y" | "dir_z");
    if is_direction && !value.is_nan() && value.abs() != 1.0 {
        return Err(format!("must be 1 or -1, not {value}"));
    }
    Ok(value)
}

/// Rows are in time order within a `run`.
struct TimeOrder {
    time_column: Option<usize>,
    run_column: Option<usize>,
    /// `time_s` and `run` of the newest row that has a time.
    newest: Option<(f64, Option<f64>)>,
}

impl TimeOrder {
    fn new(columns: &[Column]) -> Self {
        let find = |name| columns.iter().position(|column| column.name == name);
        Self { time_column: find("time_s"), run_column: find("run"), newest: None }
    }

    /// Looks at the newest row of `run`.
    fn check(&mut self, run: &RunFile) -> Result<(), BadInput> {
        let newest_value = |column: usize| run.columns[column].values.last().copied();
        let Some(time) = self.time_column.and_then(newest_value).filter(|time| !time.is_nan())
        else {
            return Ok(());
        };
        // Two missing run numbers are the same run; as NaN they would not be equal.
        let number = self.run_column.and_then(newest_value).filter(|number| !number.is_nan());
        if let Some((time_before, number_before)) = self.newest
            && number == number_before
            && time < time_before
        {
            let rule = format!(
                "runs back from {time_before} to {time} within a run: rows are in time order"
            );
            return Err(run.bad(run.rows() - 1, "time_s", rule));
        }
        self.newest = Some((time, number));
        Ok(())
    }
}

/// The line that is being read.
#[derive(Default)]
struct Line {
    bytes: Vec<u8>,
    /// Without byte order mark and line end.
    text: String,
    /// From 1.
    number: usize,
}

impl Line {
    /// The next line of `source`; false at its end.
    fn read(&mut self, source: &mut impl BufRead, path: &Path) -> Result<bool, BadInput> {
        self.bytes.clear();
        self.number += 1;
        let read = source.read_until(b'\n', &mut self.bytes).map_err(|error| {
            BadInput::new(self.place(path, 1), format!("cannot be read: {error}"))
        })?;
        let mut bytes = self.bytes.strip_suffix(b"\n").unwrap_or(&self.bytes);
        bytes = bytes.strip_suffix(b"\r").unwrap_or(bytes);
        if self.number == 1 {
            bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
        }
        let text = str::from_utf8(bytes).map_err(|error| {
            let column = String::from_utf8_lossy(&bytes[..error.valid_up_to()]).chars().count() + 1;
            BadInput::new(self.place(path, column), "is not UTF-8 text")
        })?;
        if let Some(at) = text.find('\r') {
            let column = text[..at].chars().count() + 1;
            let rule = "a carriage return alone does not end a line: use LF or CRLF";
            return Err(BadInput::new(self.place(path, column), rule));
        }
        self.text.clear();
        self.text.push_str(text);
        Ok(read > 0)
    }

    fn is_blank(&self) -> bool {
        self.text.trim().is_empty()
    }

    fn place(&self, path: &Path, column: usize) -> Place {
        Place { file: path.to_path_buf(), line: self.number, column }
    }

    fn bad_quote(&self, path: &Path, fault: BadQuote) -> BadInput {
        BadInput::new(self.place(path, fault.column), fault.rule)
    }
}

/// The separator of a file by its header: the more frequent of `,` and `;`.
fn separator_of(header: &str) -> char {
    let mut quoted = false;
    let (mut commas, mut semicolons) = (0, 0);
    for c in header.chars() {
        match c {
            '"' => quoted = !quoted,
            ',' if !quoted => commas += 1,
            ';' if !quoted => semicolons += 1,
            _ => {}
        }
    }
    if semicolons > commas { ';' } else { ',' }
}

/// One field of a line.
struct Field<'l> {
    /// Without quotes.
    text: Cow<'l, str>,
    /// Where its first character other than a blank stands, from 1.
    column: usize,
}

/// A quoted field that does not end as it must.
struct BadQuote {
    column: usize,
    rule: &'static str,
}

/// The fields of a line, in order; after an error there are no more.
struct Fields<'l> {
    /// What is not yet split; `None` after the last field.
    rest: Option<&'l str>,
    separator: char,
    /// The column at which `rest` begins, from 1.
    column: usize,
}

impl<'l> Fields<'l> {
    fn of(line: &'l str, separator: char) -> Self {
        Self { rest: Some(line), separator, column: 1 }
    }

    /// `length` bytes of `rest` are this field's; the separator after them, if any, is passed over.
    fn pass(&mut self, rest: &'l str, length: usize) -> &'l str {
        let (field, after) = rest.split_at(length);
        self.rest = after.strip_prefix(self.separator);
        self.column += field.chars().count() + 1;
        field
    }
}

impl<'l> Iterator for Fields<'l> {
    type Item = Result<Field<'l>, BadQuote>;

    fn next(&mut self) -> Option<Self::Item> {
        let rest = self.rest.take()?;
        let content = rest.trim_start_matches(' ');
        let blanks = rest.len() - content.len();
        let column = self.column + blanks;
        let Some(quoted) = content.strip_prefix('"') else {
            let length = rest.find(self.separator).unwrap_or(rest.len());
            // A field of blanks alone has no content to point at.
            let column = if blanks < length { column } else { self.column };
            let text = Cow::Borrowed(self.pass(rest, length).trim());
            return Some(Ok(Field { text, column }));
        };
        let Some(end) = end_of_quoted(quoted) else {
            return Some(Err(BadQuote { column, rule: "a quoted field must end on its own line" }));
        };
        let text = &quoted[..end];
        let after = blanks + 1 + end + 1;
        let length = rest[after..].find(self.separator).map_or(rest.len(), |at| after + at);
        if !rest[after..length].trim().is_empty() {
            let column = self.column + rest[..after].chars().count();
            let rule = "a quoted field must be followed by a separator or the end of the line";
            return Some(Err(BadQuote { column, rule }));
        }
        self.pass(rest, length);
        let text =
            if text.contains('"') { Cow::Owned(text.replace("\"\"", "\"")) } else { text.into() };
        Some(Ok(Field { text, column }))
    }
}

/// Where the quote stands that ends a field whose opening quote is already passed; a doubled quote
/// is a quote of the text.
fn end_of_quoted(text: &str) -> Option<usize> {
    let mut from = 0;
    loop {
        let at = from + text[from..].find('"')?;
        if !text[at + 1..].starts_with('"') {
            return Some(at);
        }
        from = at + 2;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> RunFile {
        RunFile::from_reader(text.as_bytes(), Path::new("r.csv"))
            .expect("the test's own text is right")
    }

    /// Values to compare: NaN is not equal to itself.
    fn some(values: &[f64]) -> Vec<Option<f64>> {
        values.iter().map(|value| (!value.is_nan()).then_some(*value)).collect()
    }

    #[test]
    fn columns_arrive_by_name_with_missing_values_as_nan() {
        let run = parse("time_s,temp_a_c,mystery\n0,21.5,-1e-3\n1,,nan\n2,NaN,+4.\n");
        assert_eq!(run.rows(), 3);
        assert_eq!(run.column("time_s").expect("named above"), [0.0, 1.0, 2.0]);
        assert_eq!(some(run.column("temp_a_c").expect("named above")), [Some(21.5), None, None]);
        let mystery = some(run.column("mystery").expect("unknown columns are kept"));
        assert_eq!(mystery, [Some(-0.001), None, Some(4.0)]);
        assert!(run.column("spindle_rpm").is_none());
        let names: Vec<&str> = run.columns().iter().map(|column| column.name.as_str()).collect();
        assert_eq!(names, ["time_s", "temp_a_c", "mystery"]);
    }

    #[test]
    fn every_accepted_form_gives_the_same_values() {
        let forms = [
            "a_um,b_um\n1,2.5\n3,\n",
            "a_um,b_um\n1,2.5\n3,",
            "a_um;b_um\n1;2.5\n3;\n",
            "a_um,b_um\r\n1,2.5\r\n3,\r\n",
            "\u{feff}a_um,b_um\n1,2.5\n3,\n",
            "\na_um,b_um\n\n1,2.5\n  \n3,\n\n",
            " a_um , b_um \n 1 , 2.5 \n3 , \n",
            "\"a_um\",\"b_um\"\n\"1\",\"2.5\"\n\"3\",\"\"\n",
            "a_um;b_um\n\"1\" ;  \"2.5\"\n3;nan\n",
        ];
        for form in forms {
            let run = parse(form);
            assert_eq!(run.column("a_um").expect("named above"), [1.0, 3.0], "{form:?}");
            let b = some(run.column("b_um").expect("named above"));
            assert_eq!(b, [Some(2.5), None], "{form:?}");
        }
    }

    #[test]
    fn a_name_may_contain_the_separator_and_quotes_if_it_is_quoted() {
        let run = parse("\"load; \"\"z\"\", n\";x_mm\n1;2\n");
        assert_eq!(run.column("load; \"z\", n").expect("named above"), [1.0]);
    }

    #[test]
    fn time_may_start_again_with_the_next_run() {
        let run = parse("run,time_s\n1,0\n1,5\n2,0\n2,\n2,0\n,0\n");
        assert_eq!(run.rows(), 6);
    }

    #[test]
    fn a_value_is_placed_by_line_and_character_for_rules_found_broken_later() {
        let run = parse("\u{feff}\"µ\";sensor_counts\r\n\r\n1.5;  40000\r\n\"2\"; \"7\"\r\n;\r\n");
        let at = |row, column| {
            let place = run.place(row, column);
            (place.line, place.column)
        };
        assert_eq!(at(0, "sensor_counts"), (3, 7));
        assert_eq!(at(0, "µ"), (3, 1));
        assert_eq!(at(1, "sensor_counts"), (4, 6));
        assert_eq!(at(2, "sensor_counts"), (5, 2));
        assert_eq!(at(1, "no such column"), (4, 1));
        assert_eq!(at(99, "µ"), (1, 1));
        let bad = run.bad(0, "sensor_counts", "40000 is outside 0…32768");
        assert_eq!(bad.to_string(), "r.csv:3:7: sensor_counts 40000 is outside 0…32768");
    }

    #[test]
    fn a_missing_column_is_reported_with_those_that_are_there() {
        let error = parse("time_s,sensor_count\n0,1\n").require("sensor_counts").expect_err("typo");
        assert_eq!(
            error.to_string(),
            "r.csv:1:1: column sensor_counts is missing; there are time_s, sensor_count; \
             did you mean sensor_count?"
        );
    }

    #[test]
    fn a_run_of_200_000_rows_is_read_whole() {
        let mut text = String::from("time_s,sensor_counts\n");
        for row in 0..200_000 {
            text.push_str(&format!("{row},{}\n", row % 32768));
        }
        let run = parse(&text);
        assert_eq!(run.rows(), 200_000);
        assert_eq!(run.place(199_999, "sensor_counts").line, 200_001);
    }
}
