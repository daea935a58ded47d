//! Sections whose keys are the fields of a struct, each declared once.
//!
//! [`table!`] makes the struct, the keys' descriptions ([`Key`]), the reader and the writer of one declaration. The
//! schema, the reference, every message's help and "did you mean" are made of the descriptions.

use std::path::Path;

use super::{
    key::{Key, Requirement, ValueType},
    reader::{Section, TomlDocument},
    section::{NewSection, Value},
};
use crate::location::InputFileError;

/// Declares a struct whose fields are the keys of a section:
///
/// ```text
/// table! {
///     /// The struct.
///     pub struct Backlash {
///         /// What the file's readers need not know.
///         width_um: f64 = key(Number, "µm", "error after a move in the negative direction").required();
///     }
///     checked by rules
/// }
/// ```
///
/// A key has the name of its field. One that several tables have is declared as a constant, which stands in the place of
/// `key(…)`. `rules`, where it is there, holds the keys that were read against each other.
macro_rules! table {
    (
        $(#[$attribute:meta])*
        $visibility:vis struct $Name:ident {
            $($(#[$doc:meta])* $field:ident: $Type:ty =
                $key:ident $(($form:expr, $unit:literal, $meaning:literal))?
                $(.$property:ident($($argument:expr),*))*;)*
        }
        $(checked by $rules:path)?
    ) => {
        $(#[$attribute])*
        $visibility struct $Name {
            $(
                $(#[$doc])*
                $(
                    #[doc = ""]
                    #[doc = concat!("`", stringify!($field), "`: ", $meaning, ".")]
                )?
                $visibility $field: $Type,
            )*
        }

        impl $crate::keys::table::Table for $Name {
            const KEYS: &'static [$crate::keys::key::Key] = {
                #[allow(unused_imports, reason = "a table whose keys all stand elsewhere, as those of causes, names no form and no range")]
                use $crate::keys::{key::{ValueType::*, key}, plausible_range::*};
                &[$($key $((stringify!($field), $form, $unit, $meaning))?
                    $(.$property($($argument),*))*),*]
            };

            const NAMES: &'static [&'static str] = &[$(stringify!($field)),*];

            fn read(
                section: &$crate::keys::reader::Section<'_>,
            ) -> Result<Self, $crate::location::InputFileError> {
                let mut keys = Self::KEYS.iter();
                let mut next = || keys.next().expect("one for each field");
                let table = Self { $($field: $crate::keys::table::read_or_default(section, next())?),* };
                $(let table = $rules(section, table)?;)?
                Ok(table)
            }

            fn write(
                &self,
                section: $crate::keys::section::NewSection,
            ) -> $crate::keys::section::NewSection {
                let mut keys = Self::KEYS.iter();
                let mut next = || keys.next().expect("one for each field");
                $(let section = $crate::keys::table::add_key(section, next(), &self.$field);)*
                section
            }
        }
    };
}

/// Declares an enum whose values have names in the file.
macro_rules! choice {
    (
        $(#[$attribute:meta])*
        $visibility:vis enum $Name:ident {
            $($(#[$doc:meta])* $Choice:ident = $name:literal,)*
        }
    ) => {
        $(#[$attribute])*
        $visibility enum $Name {
            $($(#[$doc])* $Choice,)*
        }

        impl $Name {
            /// The names of all of them.
            pub(crate) const NAMES: &'static [&'static str] = &[$($name),*];

            /// All of them.
            pub const ALL: [Self; Self::NAMES.len()] = [$(Self::$Choice),*];

            /// Returns its name in files.
            #[must_use]
            pub const fn name(self) -> &'static str {
                Self::NAMES[self as usize]
            }
        }

        impl $crate::keys::table::KeyValue for $Name {
            fn read_value(
                section: &$crate::keys::reader::Section<'_>,
                key: &$crate::keys::key::Key,
            ) -> Result<Option<Self>, $crate::location::InputFileError> {
                section.choice(key.name, &Self::ALL.map(|choice| (choice.name(), choice)))
            }

            fn to_value(
                &self,
                _: &$crate::keys::key::Key,
            ) -> Option<$crate::keys::section::Value> {
                Some($crate::keys::section::Value::Text(self.name().into()))
            }
        }
    };
}

pub(crate) use {choice, table};

/// A section whose keys are the fields of a struct.
pub(crate) trait Table: Sized {
    /// Its keys, in the order of the reference.
    const KEYS: &'static [Key];

    /// Their names.
    const NAMES: &'static [&'static str];

    /// Returns what stands in `section`.
    fn read(section: &Section<'_>) -> Result<Self, InputFileError>;

    /// Returns `section` with the keys after those that it has.
    fn write(&self, section: NewSection) -> NewSection;
}

/// A value of a key.
pub(crate) trait KeyValue: Sized {
    /// Returns what stands at `key`, if it is there.
    fn read_value(section: &Section<'_>, key: &Key) -> Result<Option<Self>, InputFileError>;

    /// Returns it as it is written; `None` where it is not, or in a section of its own.
    fn to_value(&self, key: &Key) -> Option<Value>;

    /// Returns the value of an optional key that is not there.
    fn default_value(_: &Key) -> Option<Self> {
        None
    }
}

/// Returns the value of `key`: what stands there, or what holds without it.
pub(crate) fn read_or_default<T: KeyValue>(
    section: &Section<'_>,
    key: &Key,
) -> Result<T, InputFileError> {
    let there = T::read_value(section, key)?;
    section.required(key.name, there.or_else(|| resolve_default(key)))
}

/// Returns what holds without `key`; `None` where it must be there.
fn resolve_default<T: KeyValue>(key: &Key) -> Option<T> {
    match key.need {
        Requirement::Required => None,
        Requirement::Optional => T::default_value(key),
        Requirement::Default(default) => {
            let text = format!("{} = {default}", key.name);
            let document = TomlDocument::parse(&text, Path::new("")).ok()?;
            T::read_value(&document.root(), key).ok().flatten()
        }
    }
}

/// Returns a table of which no key is there; `None` where one must be.
pub(crate) fn default_table<T: Table>() -> Option<T> {
    let document = TomlDocument::parse("", Path::new("")).ok()?;
    T::read(&document.root()).ok()
}

/// Returns `section` with this key.
pub(crate) fn add_key<T: KeyValue>(section: NewSection, key: &Key, value: &T) -> NewSection {
    let written = value.to_value(key);
    let is_omitted = key.is_quiet
        && resolve_default::<T>(key).is_some_and(|default| default.to_value(key) == written);
    match written {
        Some(value) if !is_omitted => section.with_value(key.name, value),
        _ => section,
    }
}

/// Returns the keys of a table that are written.
pub(crate) fn entries<T: Table>(table: &T) -> Vec<(&'static str, Value)> {
    let section = table.write(NewSection::new(""));
    let entry = |key: &'static Key| Some((key.name, section.value(key.name)?.clone()));
    T::KEYS.iter().filter_map(entry).collect()
}

/// Returns a table as it is written on one line.
pub(crate) fn to_inline_table(table: &impl Table) -> Value {
    build_inline_table(entries(table))
}

/// Returns keys as they are written on one line.
pub(crate) fn build_inline_table(entries: Vec<(&str, Value)>) -> Value {
    let entry = |(name, value): (&str, Value)| (name.to_string(), value);
    Value::Inline(entries.into_iter().map(entry).collect())
}

impl<T: Table> KeyValue for T {
    fn read_value(section: &Section<'_>, key: &Key) -> Result<Option<Self>, InputFileError> {
        section.section(key.name)?.map(|inner| T::read(&inner)).transpose()
    }

    fn to_value(&self, key: &Key) -> Option<Value> {
        key.is_inline.then(|| to_inline_table(self))
    }

    fn default_value(_: &Key) -> Option<Self> {
        default_table()
    }
}

impl<T: KeyValue> KeyValue for Option<T> {
    fn read_value(section: &Section<'_>, key: &Key) -> Result<Option<Self>, InputFileError> {
        Ok(T::read_value(section, key)?.map(Some))
    }

    fn to_value(&self, key: &Key) -> Option<Value> {
        self.as_ref()?.to_value(key)
    }

    fn default_value(_: &Key) -> Option<Self> {
        Some(None)
    }
}

impl KeyValue for f64 {
    fn read_value(section: &Section<'_>, key: &Key) -> Result<Option<Self>, InputFileError> {
        match key.form {
            ValueType::Positive => section.positive_number(key.name),
            ValueType::NotNegative => section.non_negative_number(key.name),
            _ => section.number(key.name),
        }
    }

    fn to_value(&self, _: &Key) -> Option<Value> {
        Some(Value::Number(*self))
    }

    fn default_value(_: &Key) -> Option<Self> {
        Some(0.0)
    }
}

impl KeyValue for u32 {
    fn read_value(section: &Section<'_>, key: &Key) -> Result<Option<Self>, InputFileError> {
        let ValueType::Whole(least, most) = key.form else { return Ok(None) };
        section.integer(key.name, least, most)
    }

    fn to_value(&self, _: &Key) -> Option<Value> {
        Some(Value::Whole(*self))
    }
}

impl KeyValue for u8 {
    fn read_value(section: &Section<'_>, key: &Key) -> Result<Option<Self>, InputFileError> {
        let whole = u32::read_value(section, key)?;
        Ok(whole
            .map(|integer| u8::try_from(integer).expect("the key's range is within that of u8")))
    }

    fn to_value(&self, _: &Key) -> Option<Value> {
        Some(Value::Whole((*self).into()))
    }
}

impl KeyValue for u16 {
    fn read_value(section: &Section<'_>, key: &Key) -> Result<Option<Self>, InputFileError> {
        let whole = u32::read_value(section, key)?;
        Ok(whole
            .map(|integer| u16::try_from(integer).expect("the key's range is within that of u16")))
    }

    fn to_value(&self, _: &Key) -> Option<Value> {
        Some(Value::Whole((*self).into()))
    }
}

impl KeyValue for bool {
    fn read_value(section: &Section<'_>, key: &Key) -> Result<Option<Self>, InputFileError> {
        match key.form {
            ValueType::Whole(..) => Ok(u32::read_value(section, key)?.map(|whole| whole != 0)),
            _ => section.boolean(key.name),
        }
    }

    fn to_value(&self, key: &Key) -> Option<Value> {
        Some(match key.form {
            ValueType::Whole(..) => Value::Whole((*self).into()),
            _ => Value::Boolean(*self),
        })
    }
}

impl KeyValue for String {
    fn read_value(section: &Section<'_>, key: &Key) -> Result<Option<Self>, InputFileError> {
        let text = match key.form {
            ValueType::Column => section.temperature_column(key.name)?,
            _ => section.text(key.name)?,
        };
        Ok(text.map(str::to_string))
    }

    fn to_value(&self, _: &Key) -> Option<Value> {
        Some(Value::Text(self.clone()))
    }
}

impl KeyValue for Vec<String> {
    fn read_value(section: &Section<'_>, key: &Key) -> Result<Option<Self>, InputFileError> {
        let texts = section.strings(key.name)?;
        Ok(texts.map(|texts| texts.into_iter().map(str::to_string).collect()))
    }

    fn to_value(&self, _: &Key) -> Option<Value> {
        Some(Value::Texts(self.clone()))
    }
}

impl KeyValue for Vec<f64> {
    fn read_value(section: &Section<'_>, key: &Key) -> Result<Option<Self>, InputFileError> {
        section.numbers(key.name)
    }

    fn to_value(&self, _: &Key) -> Option<Value> {
        Some(Value::Numbers(self.clone()))
    }
}

/// Three numbers: an array, or a table with three keys.
impl KeyValue for [f64; 3] {
    fn read_value(section: &Section<'_>, key: &Key) -> Result<Option<Self>, InputFileError> {
        let ValueType::Table([x, y, z]) = key.form else { return section.vector(key.name) };
        let Some(inner) = section.section(key.name)? else { return Ok(None) };
        Ok(Some([
            read_or_default(&inner, x)?,
            read_or_default(&inner, y)?,
            read_or_default(&inner, z)?,
        ]))
    }

    fn to_value(&self, key: &Key) -> Option<Value> {
        Some(match key.form {
            ValueType::Table(keys) => {
                let entry = |(key, value): (&Key, &f64)| (key.name.into(), Value::Number(*value));
                Value::Inline(keys.iter().zip(self).map(entry).collect())
            }
            _ => Value::Numbers(self.to_vec()),
        })
    }

    fn default_value(key: &Key) -> Option<Self> {
        let ValueType::Table([x, y, z]) = key.form else { return None };
        Some([resolve_default(x)?, resolve_default(y)?, resolve_default(z)?])
    }
}
