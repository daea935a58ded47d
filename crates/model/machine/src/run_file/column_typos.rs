//! Names of columns that are not known and look like one that is: another unit, another writing, a slip of the
//! keyboard.
//!
//! Such a column would be kept as a possible explanation, and the user would wait in vain for it to be
//! used. So it is reported, with the name that was probably meant.

use super::clock::is_logger_time_column;
use crate::known_columns::KNOWN_COLUMNS;

/// Known columns without their unit, with it, and whether the name alone, without any unit, is reported.
const KNOWN_COLUMN_STEMS: [(&str, &str, bool); 20] = [
    ("time", "s", true),
    ("gauge_time", "s", true),
    ("x", "mm", true),
    ("y", "mm", true),
    ("z", "mm", true),
    ("a", "deg", false),
    ("b", "deg", false),
    ("c", "deg", false),
    ("measured_elongation", "um", true),
    ("measured_dx", "um", true),
    ("measured_dy", "um", true),
    ("measured_dz", "um", true),
    ("measured_dr", "um", true),
    ("offset_x", "um", true),
    ("offset_y", "um", true),
    ("offset_z", "um", true),
    ("spindle", "rpm", false),
    ("load", "n", false),
    ("feed", "mm_per_min", false),
    ("sensor", "counts", false),
];

/// Alternatives to each of these units: the same quantity in another unit, or another way to write it.
const UNIT_ALTERNATIVES: [(&str, &[&str]); 8] = [
    ("s", &["sec", "seconds", "ms", "us", "ns", "min", "minutes", "h", "hours"]),
    ("mm", &["nm", "um", "micron", "microns", "cm", "m", "in", "inch"]),
    ("um", &["nm", "micron", "microns", "mm", "cm", "m", "in", "inch", "mil", "mils"]),
    ("deg", &["rad", "mrad", "degree", "degrees"]),
    ("rpm", &["hz", "krpm", "rps", "r_min", "1_min", "speed", "speed_rpm"]),
    ("n", &["kn", "lbf", "kgf"]),
    ("counts", &["count", "v", "mv", "volts"]),
    ("c", &["degc", "celsius", "f", "degf", "fahrenheit", "k", "kelvin"]),
];

/// Returns the known column that `name` probably stands for; `None` for a known one and for all others.
pub(super) fn suggest_column(name: &str) -> Option<String> {
    let plain = normalise_name(name);
    let found = match_known_column(&plain)
        .or_else(|| match_direction_column(&plain))
        .or_else(|| match_temperature_column(&plain));
    let found = found.or_else(|| correct_spelling(&plain));
    // A clock that was not read as one.
    let found = found.or_else(|| is_logger_time_column(&plain).then(|| "time_s".into()))?;
    (found != name).then_some(found)
}

/// `direction_x`, `dirx`, `dir_X`.
fn match_direction_column(plain: &str) -> Option<String> {
    let rest = ["direction", "dir"].iter().find_map(|word| plain.strip_prefix(word))?;
    let axis = rest.trim_start_matches('_');
    ["x", "y", "z"].contains(&axis).then(|| format!("dir_{axis}"))
}

/// Returns a known name with one of its words misspelt. A word with a digit, or a short one, is a name of its own:
/// `measured_du_um` is of an axis U.
fn correct_spelling(plain: &str) -> Option<String> {
    let known = KNOWN_COLUMNS.iter().map(|known| known.name).filter(|name| !name.contains('<'));
    let near = known.filter(|name| plain != *name && is_typo_of(plain, name));
    near.map(String::from).next()
}

fn is_typo_of(plain: &str, known: &str) -> bool {
    // Only the parting of the words is left out.
    if known.len() < MIN_TYPO_LENGTH || plain.replace('_', "") == known.replace('_', "") {
        return known.len() >= MIN_TYPO_LENGTH;
    }
    let (ours, theirs): (Vec<&str>, Vec<&str>) =
        (plain.split('_').collect(), known.split('_').collect());
    if ours.len() != theirs.len() {
        return false;
    }
    let mut different = ours.iter().zip(&theirs).filter(|(ours, theirs)| ours != theirs);
    let (Some((word, right)), None) = (different.next(), different.next()) else { return false };
    let is_swap = word.len() == right.len()
        && strsim::osa_distance(word, right) == 1
        && strsim::levenshtein(word, right) == 2;
    let most = match right.len() {
        0..=2 => return false,
        3 => return is_swap,
        4..=5 => 1,
        _ => 2,
    };
    let has_digit = word.contains(|c: char| c.is_ascii_digit());
    // A plural is no slip, but a set of another kind.
    let is_plural = word.strip_suffix('s') == Some(*right);
    !has_digit && !is_plural && strsim::osa_distance(word, right) <= most
}

/// Names of fewer characters are near to too many others: `timer_s` is no slip of `time_s`.
const MIN_TYPO_LENGTH: usize = 9;

/// `X (mm)` as `x_mm`, `Temp bed [°C]` as `temp_bed_c`.
fn normalise_name(name: &str) -> String {
    let mut plain = String::new();
    for c in name.to_lowercase().chars() {
        match c {
            'µ' | 'μ' => plain.push('u'),
            '°' => {}
            c if c.is_alphanumeric() => plain.push(c),
            _ if plain.is_empty() || plain.ends_with('_') => {}
            _ => plain.push('_'),
        }
    }
    plain.trim_end_matches('_').to_string()
}

/// Returns whether `unit` is `right` or may be meant by it.
fn is_unit_variant(unit: &str, right: &str) -> bool {
    let others = UNIT_ALTERNATIVES.iter().find(|(known, _)| *known == right);
    unit == right || others.is_some_and(|(_, others)| others.contains(&unit))
}

fn match_known_column(plain: &str) -> Option<String> {
    // An error that does not say that it was measured.
    let long = match plain.split('_').next() {
        Some("dx" | "dy" | "dz") => format!("measured_{plain}"),
        _ => plain.to_string(),
    };
    KNOWN_COLUMN_STEMS.iter().find_map(|&(stem, right, reported_alone)| {
        let is_meant = match long.strip_prefix(stem)?.strip_prefix('_') {
            Some(unit) => is_unit_variant(unit, right),
            None => reported_alone && long == stem,
        };
        is_meant.then(|| format!("{stem}_{right}"))
    })
}

/// `temp_bed`, `temp_bed_f`, `bed_temp_c`: what has a name next to the word and the unit.
fn match_temperature_column(plain: &str) -> Option<String> {
    let mut parts: Vec<&str> = plain.split('_').collect();
    let word = parts.iter().position(|part| ["temp", "temperature"].contains(part))?;
    parts.remove(word);
    if parts.len() > 1 && parts.last().is_some_and(|unit| is_unit_variant(unit, "c")) {
        parts.pop();
    } else if word > 0 {
        // `room_temp_sensor` is whatever it likes.
        return None;
    }
    (!parts.is_empty()).then(|| format!("temp_{}_c", parts.join("_")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn another_unit_or_writing_is_reported() {
        for (name, known) in [
            ("measured_dz_mm", "measured_dz_um"),
            ("measured_dz", "measured_dz_um"),
            ("Measured dz (µm)", "measured_dz_um"),
            ("dz_um", "measured_dz_um"),
            ("X (mm)", "x_mm"),
            ("X_mm", "x_mm"),
            ("x", "x_mm"),
            ("y [inch]", "y_mm"),
            ("temp_bed_f", "temp_bed_c"),
            ("temp_bed", "temp_bed_c"),
            ("bed_temp_c", "temp_bed_c"),
            ("Temperature bed (°C)", "temp_bed_c"),
            ("time_min", "time_s"),
            ("time", "time_s"),
            ("Time (s)", "time_s"),
            ("spindle_speed", "spindle_rpm"),
            ("load_kN", "load_n"),
            ("offset_z_mm", "offset_z_um"),
            ("spindel_rpm", "spindle_rpm"),
            ("spindle_rmp", "spindle_rpm"),
            ("spindlerpm", "spindle_rpm"),
            ("snesor_counts", "sensor_counts"),
            ("sensor_cuonts", "sensor_counts"),
            ("measurd_dx_um", "measured_dx_um"),
            ("measured_elongaton_um", "measured_elongation_um"),
            ("mesaured_dz_um", "measured_dz_um"),
            ("feed_mm_per_mni", "feed_mm_per_min"),
            ("direction_x", "dir_x"),
            ("dirY", "dir_y"),
        ] {
            assert_eq!(suggest_column(name).as_deref(), Some(known), "{name}");
        }
    }

    #[test]
    fn what_is_known_and_what_is_quite_another_thing_is_not() {
        for name in [
            "time_s",
            "x_mm",
            "measured_dx_um",
            "temp_bed_c",
            "spindle_rpm",
            "load_n",
            "a_deg",
            "flow",
            "pressure_bar",
            "elongation_um",
            "a",
            "xylem",
            "dir_x",
            "run",
            "angle1_deg",
            "temp_bed_2_c",
            "predicted_dx_um",
            "template",
            "quality",
            "flags",
            "age_ms",
            "room_temp_sensor",
            "timer_s",
            "spindle2_rpm",
            "spindles_rpm",
            "pump_rpm",
            "measured_du_um",
            "measured_da_um",
            "offset_u_um",
            "sensor2_counts",
            "load_a",
            "feed_rate",
            "u_mm",
            "qualities",
            "dir_u",
            "director",
        ] {
            assert_eq!(suggest_column(name), None, "{name}");
        }
    }
}
