//! Units as people write them, and what they are in the run file's.

/// The dimension of a unit.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Dimension {
    /// In s.
    Time,
    /// In mm.
    Length,
    /// In °C.
    Temperature,
    /// In V.
    Voltage,
    /// In °.
    Angle,
    /// In r/min.
    Speed,
    /// In N.
    Force,
    /// In mm/min.
    Feed,
    /// In counts.
    Counts,
}

impl Dimension {
    /// Returns the ending of a column's name for values in the base unit.
    pub(crate) fn column_suffix(self) -> &'static str {
        match self {
            Self::Time => "s",
            Self::Length => "mm",
            Self::Temperature => "c",
            Self::Voltage => "v",
            Self::Angle => "deg",
            Self::Speed => "rpm",
            Self::Force => "n",
            Self::Feed => "mm_per_min",
            Self::Counts => "counts",
        }
    }

    /// Returns the units that are offered for a value without one.
    pub(crate) fn suggested_units(self) -> &'static [&'static str] {
        match self {
            Self::Time => &["s", "ms", "min", "h", "d"],
            Self::Length => &["mm", "µm", "inch", "mil", "µin", "m", "1/100mm"],
            Self::Temperature => &["°C", "°F", "K", "1/10°C"],
            Self::Voltage => &["V", "mV"],
            Self::Angle => &["deg", "rad"],
            Self::Speed => &["r/min", "Hz", "1000r/min"],
            Self::Force => &["N", "kN", "lbf"],
            Self::Feed => &["mm/min", "m/min", "inch/min"],
            Self::Counts => &["counts", "V", "mV"],
        }
    }
}

/// A unit: a value in it is `factor · value + offset` in the base unit of its dimension.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Unit {
    /// The name that is shown.
    pub(crate) name: &'static str,
    pub(crate) dimension: Dimension,
    pub(crate) factor: f64,
    pub(crate) offset: f64,
}

type UnitDefinition = (&'static str, Dimension, f64, f64, &'static [&'static str]);

const UNIT_DEFINITIONS: &[UnitDefinition] = {
    use Dimension::{Angle, Counts, Feed, Force, Length, Speed, Temperature, Time, Voltage};
    &[
        (
            "s",
            Time,
            1.0,
            0.0,
            &[
                "s", "sec", "secs", "second", "seconds", "sek", "sekunde", "sekunden", "secondes",
                "segundos", "secondi",
            ],
        ),
        ("ms", Time, 1e-3, 0.0, &["ms", "msec", "millisekunden", "milliseconds", "millis"]),
        ("µs", Time, 1e-6, 0.0, &["µs", "us", "usec", "microseconds"]),
        ("ns", Time, 1e-9, 0.0, &["ns", "nanoseconds"]),
        (
            "min",
            Time,
            60.0,
            0.0,
            &["min", "mins", "minute", "minutes", "minuten", "minutos", "minuti"],
        ),
        (
            "h",
            Time,
            3600.0,
            0.0,
            &[
                "h", "hr", "hrs", "hour", "hours", "std", "stunde", "stunden", "heures", "horas",
                "ore",
            ],
        ),
        ("d", Time, 86_400.0, 0.0, &["d", "day", "days", "tag", "tage", "jours", "dias", "giorni"]),
        ("mm", Length, 1.0, 0.0, &["mm", "millimeter", "millimetre", "millimeters", "millimetres"]),
        (
            "µm",
            Length,
            1e-3,
            0.0,
            &[
                "µm",
                "um",
                "µ",
                "micron",
                "microns",
                "mikrometer",
                "micrometre",
                "micrometer",
                "micrometers",
                "mikron",
                "my",
                "0.001mm",
                "0,001mm",
                "1/1000mm",
                "tausendstel",
                "tausendstelmm",
            ],
        ),
        ("nm", Length, 1e-6, 0.0, &["nm"]),
        ("cm", Length, 10.0, 0.0, &["cm"]),
        ("m", Length, 1000.0, 0.0, &["m", "meter", "metre", "meters", "metres"]),
        ("1/10mm", Length, 0.1, 0.0, &["1/10mm", "0.1mm", "0,1mm", "zehntelmm"]),
        (
            "1/100mm",
            Length,
            0.01,
            0.0,
            &["1/100mm", "0.01mm", "0,01mm", "hundertstel", "hundertstelmm", "hundredthsmm"],
        ),
        (
            "inch",
            Length,
            25.4,
            0.0,
            &[
                "in", "inch", "inches", "zoll", "\"", "″", "''", "pouce", "pouces", "pulgada",
                "pulgadas", "pollici",
            ],
        ),
        (
            "mil",
            Length,
            0.0254,
            0.0,
            &[
                "mil",
                "mils",
                "thou",
                "0.001in",
                "0.001\"",
                ".001\"",
                ".001in",
                "1/1000in",
                "1/1000inch",
                "milliinch",
            ],
        ),
        (
            "1/10000in",
            Length,
            0.00254,
            0.0,
            &[
                "1/10000in",
                "0.0001in",
                "0.0001\"",
                ".0001\"",
                ".0001in",
                "1/10000inch",
                "tenthsofathou",
            ],
        ),
        (
            "µin",
            Length,
            2.54e-5,
            0.0,
            &["µin", "uin", "microinch", "microinches", "µinch", "uinch", "µ\""],
        ),
        (
            "°C",
            Temperature,
            1.0,
            0.0,
            &["°c", "c", "degc", "celsius", "gradc", "gradcelsius", "ºc", "℃"],
        ),
        (
            "°F",
            Temperature,
            1.0 / 1.8,
            -32.0 / 1.8,
            &["°f", "f", "degf", "fahrenheit", "gradfahrenheit", "ºf", "℉"],
        ),
        ("K", Temperature, 1.0, -273.15, &["k", "kelvin", "°k", "degk"]),
        (
            "1/10°C",
            Temperature,
            0.1,
            0.0,
            &[
                "1/10°c",
                "0.1°c",
                "0,1°c",
                "°c/10",
                "°c*10",
                "°cx10",
                "10*°c",
                "1/10c",
                "0.1c",
                "0,1c",
                "c/10",
                "zehntelgrad",
                "zehntel°c",
                "zehntelgradcelsius",
                "tenthsofadegree",
                "tenthsof°c",
                "tenths°c",
                "tenthsc",
                "1/10grad",
                "d°c",
                "0.1degc",
                "1/10k",
            ],
        ),
        ("V", Voltage, 1.0, 0.0, &["v", "volt", "volts"]),
        ("mV", Voltage, 1e-3, 0.0, &["mv", "millivolt", "millivolts"]),
        ("deg", Angle, 1.0, 0.0, &["deg", "°", "degree", "degrees", "grad"]),
        ("rad", Angle, 180.0 / std::f64::consts::PI, 0.0, &["rad"]),
        (
            "r/min",
            Speed,
            1.0,
            0.0,
            &[
                "r/min", "rpm", "1/min", "u/min", "min-1", "min^-1", "umin", "tr/min", "giri/min",
                "rev/min", "upm", "/min",
            ],
        ),
        ("1000r/min", Speed, 1000.0, 0.0, &["1000r/min", "krpm", "1000/min", "1000rpm"]),
        ("Hz", Speed, 60.0, 0.0, &["hz", "1/s", "r/s", "s-1", "rps"]),
        ("N", Force, 1.0, 0.0, &["n", "newton"]),
        ("kN", Force, 1e3, 0.0, &["kn"]),
        ("lbf", Force, 4.448_221_615_260_5, 0.0, &["lbf"]),
        ("kgf", Force, 9.806_65, 0.0, &["kgf", "kp"]),
        ("mm/min", Feed, 1.0, 0.0, &["mm/min", "mm/minute"]),
        ("m/min", Feed, 1e3, 0.0, &["m/min"]),
        ("mm/s", Feed, 60.0, 0.0, &["mm/s"]),
        ("inch/min", Feed, 25.4, 0.0, &["in/min", "ipm", "inch/min", "inches/min"]),
        (
            "counts",
            Counts,
            1.0,
            0.0,
            &["counts", "count", "cts", "digits", "digit", "inkremente", "inkr", "lsb"],
        ),
    ]
};

/// Returns the text of a unit for comparison: small letters, no blanks, one micro sign, no brackets.
fn normalise(text: &str) -> String {
    let text = text.trim().trim_matches(['[', ']', '(', ')', '{', '}', '<', '>']);
    let mut out = String::new();
    for c in text.to_lowercase().chars() {
        match c {
            'μ' => out.push('µ'),
            'º' | '˚' => out.push('°'),
            '⁻' | '−' => out.push('-'),
            '¹' => out.push('1'),
            '·' | '.' if out.is_empty() => out.push('.'),
            c if c.is_whitespace() => {}
            c => out.push(c),
        }
    }
    out
}

/// Returns the unit that `text` names.
pub(crate) fn parse(text: &str) -> Option<Unit> {
    let requested = normalise(text);
    // `MV` and `Mm` are others; no instrument here has them.
    let found = UNIT_DEFINITIONS.iter().find(|(.., names)| names.contains(&requested.as_str()));
    found.map(|&(name, dimension, factor, offset, _)| Unit { name, dimension, factor, offset })
}

impl Unit {
    /// Returns the base unit of a dimension.
    pub(crate) fn base_unit(dimension: Dimension) -> Self {
        let found = UNIT_DEFINITIONS.iter().find(|(_, of, factor, offset, _)| {
            *of == dimension && *factor == 1.0 && *offset == 0.0
        });
        let name = found.map_or("", |(name, ..)| name);
        Self { name, dimension, factor: 1.0, offset: 0.0 }
    }

    /// Returns true if values stay as they are, `per_base` being the factor of the target to the base unit.
    pub(crate) fn is_identity(&self, per_base: f64) -> bool {
        (self.factor * per_base - 1.0).abs() < 1e-12 && self.offset == 0.0
    }

    /// Returns the value in the target unit, to twelve significant digits: what a factor adds in binary is no reading.
    pub(crate) fn convert(&self, value: f64, per_base: f64) -> f64 {
        if self.is_identity(per_base) {
            return value;
        }
        round_to_significant_digits((value * self.factor + self.offset) * per_base)
    }
}

/// Returns the value to twelve significant digits.
pub(crate) fn round_to_significant_digits(value: f64) -> f64 {
    // The difference of two large numbers has noise far below what was read.
    let text = format!("{value:.11e}");
    let value = text.parse().unwrap_or(value);
    if value == 0.0 { 0.0 } else { value }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_unit_is_known_in_its_writings_and_converts() {
        for (text, value, base) in [
            ("mm", 1.5, 1.5),
            ("[µm]", 1500.0, 1.5),
            ("μm", 12.0, 0.012),
            ("inch", 1.0, 25.4),
            ("\"", 0.1, 2.54),
            ("µin", 100.0, 0.00254),
            ("thou", 1.0, 0.0254),
            ("1/100 mm", 3.0, 0.03),
            ("°F", 68.0, 20.0),
            ("(K)", 293.15, 20.0),
            ("1/10 °C", 203.0, 20.3),
            ("mV", 1540.0, 1.54),
            ("ms", 250.0, 0.25),
            ("min", 1.5, 90.0),
            ("U/min", 8000.0, 8000.0),
            ("min⁻¹", 8000.0, 8000.0),
            ("Hz", 100.0, 6000.0),
        ] {
            let unit = parse(text).unwrap_or_else(|| panic!("{text}"));
            assert_eq!(unit.convert(value, 1.0), base, "{text}");
        }
        assert_eq!(parse("bar"), None);
        assert_eq!(parse(""), None);
    }

    #[test]
    fn no_writing_names_two_units_and_each_offer_is_a_unit() {
        for (at, (name, .., names)) in UNIT_DEFINITIONS.iter().enumerate() {
            assert_eq!(parse(name).map(|unit| unit.name), Some(*name));
            for name in *names {
                let twice =
                    UNIT_DEFINITIONS[at + 1..].iter().any(|(.., others)| others.contains(name));
                assert!(!twice, "{name}");
                for offer in UNIT_DEFINITIONS[at].1.suggested_units() {
                    assert!(parse(offer).is_some(), "{offer}");
                }
            }
        }
    }
}
