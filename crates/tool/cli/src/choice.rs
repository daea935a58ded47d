//! Options whose values are those of a library's type.

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};

/// Returns a parser that takes each value of `all` by its name.
pub fn by_name<T: Copy + Send + Sync + 'static, const N: usize>(
    all: [T; N],
    name: fn(T) -> &'static str,
) -> impl TypedValueParser<Value = T> {
    named(all.map(|value| (value, name(value))))
}

/// Returns a parser that takes each value by the name next to it.
pub fn named<T: Copy + Send + Sync + 'static, const N: usize>(
    all: [(T, &'static str); N],
) -> impl TypedValueParser<Value = T> {
    choice_parser(all.map(|(value, name)| (value, PossibleValue::new(name))))
}

/// Returns a parser that takes each value by its name; the third is what the help says of it.
pub fn described_choice_parser<T: Copy + Send + Sync + 'static, const N: usize>(
    all: [(T, &'static str, &'static str); N],
) -> impl TypedValueParser<Value = T> {
    choice_parser(all.map(|(value, name, help)| (value, PossibleValue::new(name).help(help))))
}

fn choice_parser<T: Copy + Send + Sync + 'static, const N: usize>(
    all: [(T, PossibleValue); N],
) -> impl TypedValueParser<Value = T> {
    PossibleValuesParser::new(all.clone().map(|(_, name)| name)).map(move |given| {
        let named = all.iter().find(|(_, name)| name.get_name() == given);
        named.expect("the parser refuses every other name").0
    })
}
