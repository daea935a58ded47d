//! The column that a header means: its name split from its unit, and what it measures.

use trueup_machine::run_file::is_known_column;

use crate::{
    unit::{self, Dimension, Unit},
    vocabulary::{self, *},
};

/// The meaning of a column.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum ColumnMeaning {
    /// A column of the run file; `None` where the axis or the quantity is not stated.
    Known(TargetColumn),
    /// A position along an axis that is not named.
    Position,
    /// An actual position, from which the error is computed; the axis if it is named.
    Actual(Option<char>),
    /// An error or a growth, of what is not stated.
    Measured,
    /// A direction of approach along an axis that is not named.
    Direction,
    /// A date without a time: it belongs to the time of day.
    Date,
    /// A number of a row, a remark.
    Nothing,
    /// Another quantity, kept under this name.
    Other(String),
}

/// A column of the run file.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct TargetColumn {
    pub(crate) name: String,
    /// The dimension of its values; `None` for bare numbers.
    pub(crate) dimension: Option<Dimension>,
    /// The column's unit for one of the dimension's base unit.
    pub(crate) per_base: f64,
}

impl TargetColumn {
    /// Returns the target of this name: its ending says the unit.
    pub(crate) fn from_name(name: &str) -> Self {
        use Dimension::{Angle, Counts, Feed, Force, Length, Speed, Temperature, Time};
        let ends = |ending: &str| name.ends_with(ending);
        let (dimension, per_base) = match name {
            "sensor_counts" => (Some(Counts), 1.0),
            "feed_mm_per_min" => (Some(Feed), 1.0),
            "load_n" => (Some(Force), 1.0),
            "spindle_rpm" => (Some(Speed), 1.0),
            "time_s" | "gauge_time_s" => (Some(Time), 1.0),
            _ if ends("_um") => (Some(Length), 1e3),
            _ if ends("_mm") => (Some(Length), 1.0),
            _ if ends("_deg") => (Some(Angle), 1.0),
            _ if name.starts_with("temp_") && ends("_c") => (Some(Temperature), 1.0),
            _ => (None, 1.0),
        };
        Self { name: name.into(), dimension, per_base }
    }

    /// Returns the unit of the column, for people.
    pub(crate) fn unit(&self) -> &'static str {
        match (self.dimension, self.per_base) {
            (Some(Dimension::Length), 1e3) => "µm",
            (Some(dimension), _) => Unit::base_unit(dimension).name,
            (None, _) => "",
        }
    }
}

/// A header taken apart.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ParsedHeader {
    /// The name without the unit.
    pub(crate) name: String,
    /// The unit as written in the file; empty where there is none.
    pub(crate) unit: String,
}

/// Splits `Temperatur Spindel [°C]`, `Zeit / s`, `Weg in mm`, `temp_bed_f` into name and unit.
pub(crate) fn split_header(header: &str) -> ParsedHeader {
    let header = header.trim().trim_start_matches('#').trim();
    let of = |name: &str, unit: &str| ParsedHeader {
        name: name.trim().trim_end_matches(':').trim().to_string(),
        unit: unit.trim().to_string(),
    };
    // `RPM`, `°C`: only the unit is stated.
    if let Some(unit) = unit::parse(header)
        && matches!(unit.dimension, Dimension::Speed | Dimension::Temperature)
        && header.chars().count() > 1
    {
        return of(header, header);
    }
    for (open, close) in [('[', ']'), ('(', ')'), ('{', '}'), ('<', '>')] {
        if let (Some(start), Some(end)) = (header.rfind(open), header.rfind(close))
            && start < end
        {
            let inner = &header[start + open.len_utf8()..end];
            let rest = format!("{} {}", &header[..start], &header[end + close.len_utf8()..]);
            // `Temperatur (Spindel)` names a place; square brackets are for units.
            if unit::parse(inner).is_some()
                || (open == '[' && !inner.trim().is_empty())
                || is_clock_format(inner)
            {
                return of(&rest, inner);
            }
        }
    }
    for divider in [" in ", " / ", "/", ", ", ": "] {
        if let Some((name, unit)) = header.rsplit_once(divider)
            && unit::parse(unit).is_some()
            && !name.trim().is_empty()
            // `U/min` is one unit.
            && (divider != "/" || unit::parse(header.rsplit(' ').next().unwrap_or_default()).is_none())
        {
            return of(name, unit);
        }
    }
    if let Some((name, unit)) = header.rsplit_once(' ')
        && unit::parse(unit).is_some_and(|_| unit.chars().count() > 1)
    {
        return of(name, unit);
    }
    if let Some((name, unit)) = header.rsplit_once('_')
        && unit::parse(unit).is_some()
    {
        return of(name, unit);
    }
    of(header, "")
}

/// `hh:mm`, `h:mm:ss`, `mm:ss`.
pub(crate) fn is_clock_format(text: &str) -> bool {
    text.contains(':') && text.chars().all(|c| "hHmMsS:.".contains(c))
}

/// Returns a name for a column: small letters, digits and `_`.
pub(crate) fn slugify(text: &str) -> String {
    let mut out = String::new();
    for c in text.to_lowercase().chars() {
        let plain = match c {
            'ä' | 'æ' => "ae",
            'ö' | 'œ' | 'ø' => "oe",
            'ü' => "ue",
            'ß' => "ss",
            'à' | 'á' | 'â' | 'ã' | 'å' => "a",
            'è' | 'é' | 'ê' | 'ë' => "e",
            'ì' | 'í' | 'î' | 'ï' => "i",
            'ò' | 'ó' | 'ô' | 'õ' => "o",
            'ù' | 'ú' | 'û' => "u",
            'ç' => "c",
            'ñ' => "n",
            'µ' | 'μ' => "u",
            // `Δz`
            'δ' | '∆' => "d",
            '°' | '.' => "",
            c if c.is_alphanumeric() => {
                out.push(c);
                continue;
            }
            _ => "_",
        };
        if plain != "_" || !(out.is_empty() || out.ends_with('_')) {
            out.push_str(plain);
        }
    }
    out.trim_end_matches('_').to_string()
}

/// Returns the axis that one of the words names: `x`, `dx`, `xpos`, `achse x`.
fn find_axis_in_words(words: &[String]) -> Option<char> {
    let of = |word: &str| match word {
        "x" | "dx" | "xachse" | "xaxis" | "xpos" | "posx" | "xposition" | "xist" | "xsoll"
        | "xactual" | "xtarget" => Some('x'),
        "y" | "dy" | "yachse" | "yaxis" | "ypos" | "posy" | "yposition" | "yist" | "ysoll"
        | "yactual" | "ytarget" => Some('y'),
        "z" | "dz" | "zachse" | "zaxis" | "zpos" | "posz" | "zposition" | "zist" | "zsoll"
        | "zactual" | "ztarget" => Some('z'),
        _ => None,
    };
    words.iter().find_map(|word| of(word))
}

/// Returns whether no word says more than an axis and its position.
fn is_only_axis(words: &[String]) -> bool {
    words.iter().all(|word| {
        let is_axis = find_axis_in_words(std::slice::from_ref(word)).is_some();
        is_axis
            || vocabulary::contains_word(STOP_WORDS, word)
            || vocabulary::contains_word(COMMANDED_POSITION_KEYWORDS, word)
    })
}

/// Returns where a thermometer is, by the words of its column: `temp_Lager_vorn_C` is `lager_vorn`; without any: `1`.
fn thermometer_location(words: &[String]) -> String {
    let is_place = |word: &&str| {
        !vocabulary::contains_word(TEMPERATURE_KEYWORDS, word) && !["t", "c"].contains(word)
    };
    let place: Vec<&str> = words.iter().map(String::as_str).filter(is_place).collect();
    if place.is_empty() { "1".into() } else { place.join("_") }
}

/// Returns a name with the suffix of its unit.
fn with_unit_suffix(name: &str, dimension: Option<Dimension>) -> String {
    dimension
        .map_or_else(|| name.into(), |dimension| format!("{name}_{}", dimension.column_suffix()))
}

/// Returns whether a word belongs to a number of rows.
fn is_row_number_word(word: &str) -> bool {
    [ROW_KEYWORDS, NUMBER_KEYWORDS, STOP_WORDS]
        .iter()
        .any(|list| vocabulary::contains_word(list, word))
}

fn is_spindle_word(word: &str) -> bool {
    ["spindel", "spindle"].contains(&word)
}

/// The first words of columns that other commands write.
const OUTPUT_COLUMN_PREFIXES: [&str; 6] =
    ["predicted", "bridge", "residual", "check", "offset", "gauge"];

/// Returns what the column `name` means, its values being in `unit` where that is known.
pub(crate) fn classify_column(header: &str, name: &str, unit: Option<Unit>) -> ColumnMeaning {
    let known = |name: &str| ColumnMeaning::Known(TargetColumn::from_name(name));
    if is_known_column(header) {
        return known(header);
    }
    let slugged = slugify(name);
    let words: Vec<String> = slugged.split('_').map(String::from).collect();
    let has = |list: &str| words.iter().any(|word| vocabulary::contains_word(list, word));
    let dimension = unit.map(|unit| unit.dimension);
    let is_length = matches!(dimension, None | Some(Dimension::Length));
    let is_identifier = header.contains('_') && slugify(header) == header;
    // What other commands write, and names of the user's own, stay as they are.
    let is_own = is_identifier && OUTPUT_COLUMN_PREFIXES.contains(&words[0].as_str());
    let own_name =
        || if is_identifier { header.into() } else { with_unit_suffix(&slugged, dimension) };
    let other = || ColumnMeaning::Other(own_name());
    if is_own || (is_identifier && dimension.is_none()) {
        return match (find_axis_in_words(&words), words[0].as_str()) {
            // A misspelt or shortened name of the run file.
            (Some(axis), "dir" | "direction") => known(&format!("dir_{axis}")),
            _ => other(),
        };
    }
    let axis = find_axis_in_words(&words);
    let is_temperature = has(TEMPERATURE_KEYWORDS) || (dimension.is_some() && !is_identifier);
    if matches!(dimension, None | Some(Dimension::Temperature)) && is_temperature {
        return known(&format!("temp_{}_c", thermometer_location(&words)));
    }
    if matches!(dimension, None | Some(Dimension::Time)) && has(TIME_KEYWORDS) {
        return known("time_s");
    }
    if has(DIRECTION_KEYWORDS) && dimension.is_none() {
        return axis.map_or(ColumnMeaning::Direction, |axis| known(&format!("dir_{axis}")));
    }
    if dimension.is_none() && has(DATE_KEYWORDS) {
        return ColumnMeaning::Date;
    }
    let speed_words = words
        .iter()
        .any(|word| !is_spindle_word(word) && vocabulary::contains_word(SPEED_KEYWORDS, word));
    let is_in_speed_units = dimension == Some(Dimension::Speed) && has(SPEED_KEYWORDS);
    if is_in_speed_units || (dimension.is_none() && speed_words) {
        return known("spindle_rpm");
    }
    if matches!(dimension, None | Some(Dimension::Feed)) && has(FEED_KEYWORDS) {
        return known("feed_mm_per_min");
    }
    if matches!(dimension, None | Some(Dimension::Force)) && has(LOAD_KEYWORDS) {
        return known("load_n");
    }
    let may_be_sensor = match dimension {
        Some(Dimension::Counts | Dimension::Voltage) => true,
        // The user must give its unit.
        None => !is_identifier,
        _ => false,
    };
    if may_be_sensor && has(SENSOR_KEYWORDS) {
        return known("sensor_counts");
    }
    if is_length && has(ELONGATION_KEYWORDS) {
        return known("measured_elongation_um");
    }
    let is_error = words.iter().any(|word| ["dx", "dy", "dz"].contains(&word.as_str()));
    let is_reading = has(MEASURED_VALUE_KEYWORDS) || has(SENSOR_KEYWORDS) || is_error;
    if is_length && is_reading && !has(COMMANDED_POSITION_KEYWORDS) {
        return match axis {
            // `Fehler X`: the axis is stated; `Messuhr X` too.
            Some(axis) => known(&format!("measured_d{axis}_um")),
            None => ColumnMeaning::Measured,
        };
    }
    let ends_with_actual = words.iter().any(|word| word.ends_with("ist") && axis.is_some());
    if is_length && has(ACTUAL_POSITION_KEYWORDS) || ends_with_actual {
        return ColumnMeaning::Actual(axis);
    }
    if is_length && axis.is_some() && is_only_axis(&words) {
        return known(&format!("{}_mm", axis.unwrap_or('x')));
    }
    // `Pos-Nr.` counts positions, and `Lauf-Nr.` is the number of a run.
    if dimension.is_none() && has(COMMANDED_POSITION_KEYWORDS) && has(NUMBER_KEYWORDS) {
        return ColumnMeaning::Nothing;
    }
    if is_length && has(COMMANDED_POSITION_KEYWORDS) {
        return axis.map_or(ColumnMeaning::Position, |axis| known(&format!("{axis}_mm")));
    }
    if dimension == Some(Dimension::Angle) {
        let rotary = words.iter().find(|word| ["a", "b", "c"].contains(&word.as_str()));
        return rotary.map_or_else(other, |axis| known(&format!("{axis}_deg")));
    }
    if dimension.is_none() && has(RUN_KEYWORDS) {
        return known("run");
    }
    // `Punkt Nr.` counts rows, `Werkzeug Nr.` is a quantity.
    let is_row_number = has(NUMBER_KEYWORDS) && words.iter().all(|word| is_row_number_word(word));
    if dimension.is_none() && (has(IGNORED_KEYWORDS) || is_row_number || slugged.is_empty()) {
        return ColumnMeaning::Nothing;
    }
    other()
}

/// Returns direction and repeat of a column of a wide table: `hin 1`, `Lauf 2 ↓`, `Rev 3`; `None` for all others.
pub(crate) fn parse_pass_column(name: &str) -> Option<(Option<f64>, Option<u32>)> {
    let (mut way, mut run) = (None, None);
    let (mut is_named, mut has_axis, mut is_measured) = (false, false, false);
    for word in split_pass_words(name) {
        let letters: String = word.chars().take_while(|c| !c.is_ascii_digit()).collect();
        let digits = &word[letters.len()..];
        if !digits.is_empty() {
            run = Some(digits.parse().ok()?);
            if letters.is_empty() {
                is_named = true;
                continue;
            }
        }
        let plain = slugify(&letters);
        if let Some(found) = vocabulary::parse_direction(&letters) {
            way = Some(found);
            is_named = true;
        } else if vocabulary::contains_word(RUN_KEYWORDS, &plain) {
            is_named = true;
        } else if vocabulary::contains_word(MEASURED_VALUE_KEYWORDS, &plain) {
            is_measured = true;
        } else if ["x", "y", "z"].contains(&plain.as_str()) {
            has_axis = true;
        } else {
            return None;
        }
    }
    // `X 1` is a position.
    let is_pass = is_named && (!has_axis || way.is_some() || is_measured);
    (is_pass && (way.is_some() || run.is_some())).then_some((way, run))
}

/// Returns the words of a header: `Run 2 -` ends with a direction, `Run-2` has a hyphen and `Run - 2` a dash.
fn split_pass_words(name: &str) -> Vec<String> {
    let name = pad_arrows(&name.replace('\u{2212}', "-"));
    let parts = name.split([' ', '_', '.', ',', '#']);
    let written: Vec<&str> = parts.filter(|word| !word.is_empty()).collect();
    let mut all = Vec::new();
    for (at, word) in written.iter().enumerate() {
        let number = word.trim_end_matches(['+', '-']);
        let sign = &word[number.len()..];
        let is_last = at + 1 == written.len();
        if is_last && sign.len() == 1 && number.chars().all(|c| c.is_ascii_digit()) {
            all.extend([number, sign].map(String::from));
        } else {
            all.extend(word.split('-').map(String::from));
        }
    }
    all.retain(|word| !word.is_empty());
    all
}

fn pad_arrows(name: &str) -> String {
    let mut out = String::new();
    for c in name.chars() {
        if "↑↓→←".contains(c) {
            out.extend([' ', c, ' ']);
        } else {
            out.push(c);
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn name(header: &str) -> String {
        let parts = split_header(header);
        match classify_column(header, &parts.name, unit::parse(&parts.unit)) {
            ColumnMeaning::Known(target) => target.name,
            other => format!("{other:?}"),
        }
    }

    #[test]
    fn headers_of_five_languages_are_understood() {
        for (header, column) in [
            ("Zeit [s]", "time_s"),
            ("Zeit / min", "time_s"),
            ("Uhrzeit", "time_s"),
            ("Time (ms)", "time_s"),
            ("Temperatur Spindel [°C]", "temp_spindel_c"),
            ("Temperature (bed) °F", "temp_bed_c"),
            ("T Öl in °C", "temp_oel_c"),
            ("Drehzahl [U/min]", "spindle_rpm"),
            ("RPM", "spindle_rpm"),
            ("°C", "temp_1_c"),
            ("n [1/min]", "spindle_rpm"),
            ("X [mm]", "x_mm"),
            ("Position X (inch)", "x_mm"),
            ("Achse Y [mm]", "y_mm"),
            ("Abweichung X [µm]", "measured_dx_um"),
            ("Error Z (µin)", "measured_dz_um"),
            ("dx [mm]", "measured_dx_um"),
            ("Δz [µm]", "measured_dz_um"),
            ("Spindellängung [µm]", "measured_elongation_um"),
            ("Messuhr [µm]", "Measured"),
            ("Position [mm]", "Position"),
            ("Soll [mm]", "Position"),
            ("Ist [mm]", "Actual(None)"),
            ("X Ist [mm]", "Actual(Some('x'))"),
            ("Richtung", "Direction"),
            ("dir_x", "dir_x"),
            ("Lauf", "run"),
            ("Datum", "Date"),
            ("Bemerkung", "Nothing"),
            ("Nr.", "Nothing"),
            ("Pos-Nr.", "Nothing"),
            ("Punkt Nr.", "Nothing"),
            ("Messpunkt Nr.", "Nothing"),
            ("lfd. Nr.", "Nothing"),
            ("Lauf-Nr.", "run"),
            ("Run No", "run"),
            ("Cycle number", "run"),
            ("Werkzeug Nr.", "Other(\"werkzeug_nr\")"),
            ("Tool No", "Other(\"tool_no\")"),
            ("Vorschub [mm/min]", "feed_mm_per_min"),
            ("Sensor [V]", "sensor_counts"),
            ("Sensor", "sensor_counts"),
            ("Wegsensor [µm]", "Measured"),
            ("time_ms", "time_s"),
            ("measured_dx_mm", "measured_dx_um"),
            ("temp_bed_f", "temp_bed_c"),
            ("flow", "Other(\"flow\")"),
            ("pump_rpm", "Other(\"pump_rpm\")"),
            ("age_ms", "Other(\"age_ms\")"),
            ("room_c", "Other(\"room_c\")"),
            ("Pumpe [U/min]", "Other(\"pumpe_rpm\")"),
            ("Spindel [U/min]", "spindle_rpm"),
            ("Druck [bar]", "Other(\"druck\")"),
            ("predicted_dx_um", "Other(\"predicted_dx_um\")"),
            ("C [deg]", "c_deg"),
        ] {
            assert_eq!(name(header), column, "{header}");
        }
    }

    #[test]
    fn directions_and_repeats_are_read_from_words() {
        assert_eq!(vocabulary::parse_direction("hin"), Some(1.0));
        assert_eq!(vocabulary::parse_direction("zurück"), Some(-1.0));
        assert_eq!(vocabulary::parse_direction("quer"), None);
        assert_eq!(parse_pass_column("hin 1"), Some((Some(1.0), Some(1))));
        assert_eq!(parse_pass_column("2↓"), Some((Some(-1.0), Some(2))));
        assert_eq!(parse_pass_column("Lauf 3 rück"), Some((Some(-1.0), Some(3))));
        assert_eq!(parse_pass_column("3"), Some((None, Some(3))));
        assert_eq!(parse_pass_column("Abw. ↑ 1"), Some((Some(1.0), Some(1))));
        assert_eq!(parse_pass_column("Rev2"), Some((Some(-1.0), Some(2))));
        for (name, way) in
            [("Run 2 +", 1.0), ("Run 2 -", -1.0), ("2-", -1.0), ("Run 2 \u{2212}", -1.0)]
        {
            assert_eq!(parse_pass_column(name), Some((Some(way), Some(2))), "{name}");
        }
        for name in ["Run-2", "Run - 2", "Lauf - 2", "Abw. - Lauf 2", "Lauf \u{2212} 2"] {
            assert_eq!(parse_pass_column(name), Some((None, Some(2))), "{name}");
        }
        for name in ["Run + 2", "+2", "+ 2"] {
            assert_eq!(parse_pass_column(name), Some((Some(1.0), Some(2))), "{name}");
        }
        assert_eq!(parse_pass_column("Temperatur 1"), None);
        assert_eq!(parse_pass_column("X"), None);
        assert_eq!(parse_pass_column("X 1"), None);
        assert_eq!(parse_pass_column("Abw. X Rückfahrt"), Some((Some(-1.0), None)));
    }
}
