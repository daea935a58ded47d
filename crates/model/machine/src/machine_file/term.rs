//! `[[term]]`: what a diagnosis has added to the model, one cause a table.
//!
//! A term changes the prediction p of one quantity. Its keys, and what they do, are on the
//! page of its [cause](crate::effect). Terms act in the order of their stages ([`sorted_by_stage`]).
//!
//! `constant_um` is added by any of them: the reference of a measurement is arbitrary. It is among
//! what is added, whatever the term is.

use crate::{
    effect::{Cause, Effect, Quantity, RangeLimited, TermContext},
    keys::{reader::Section, section::NewSection},
    location::{InputFileError, format_suggestion, truncate_text},
    sections::{AxisModel, Spindle},
};

/// One `[[term]]`.
#[derive(Clone, Debug, PartialEq)]
pub struct Term {
    /// The quantity that it changes.
    pub quantity: Quantity,
    /// Added as well, in µm: the reference of the measurement is arbitrary.
    pub constant_um: f64,
    /// How it changes it.
    pub effect: Effect,
}

/// Returns the terms in the order in which they act, each with its number in the file, from 0: by their
/// [stages](crate::effect::PredictionStage), of one stage as they stand in the file.
#[must_use]
pub(crate) fn sorted_by_stage(terms: &[Term]) -> Vec<(usize, &Term)> {
    let mut ordered: Vec<(usize, &Term)> = terms.iter().enumerate().collect();
    ordered.sort_by_key(|(_, term)| term.effect.stage());
    ordered
}

/// Keys that every term may have.
const COMMON_TERM_KEYS: [&str; 6] =
    ["cause", "quantity", "constant_um", "where_column", "where_above", "where_below"];

pub(super) fn read(section: &Section<'_>) -> Result<Term, InputFileError> {
    let name = section.required("cause", section.text("cause")?)?;
    let cause = Cause::from_name(name).ok_or_else(|| {
        let near = format_suggestion(name, Cause::ALL.iter().map(|cause| cause.name()));
        section.key_error("cause", format!("\"{}\" is not known{near}", truncate_text(name)))
    })?;
    section.reject_unknown_keys(&[&COMMON_TERM_KEYS[..], cause.keys(section)].concat())?;
    let quantities = Quantity::ALL.map(|quantity| (quantity.name(), quantity));
    let quantity = section.required("quantity", section.choice("quantity", &quantities)?)?;
    let constant_um = section.number("constant_um")?.unwrap_or(0.0);
    let effect = RangeLimited::read(section, cause.read(section)?)?;
    Ok(Term { quantity, constant_um, effect })
}

/// Whether the term belongs to the machine with this spindle and these axes: a lag needs a
/// temperature that the quantity depends on, a sensor's error a sensor.
pub(super) fn check(
    section: &Section<'_>,
    term: &Term,
    spindle: &Spindle,
    axes: &[AxisModel; 3],
) -> Result<(), InputFileError> {
    let axis = term.quantity.axis().map(|axis| &axes[axis.index()]);
    let host = TermContext {
        quantity: term.quantity,
        spindle,
        thermal: axis.and_then(|axis| axis.thermal.as_ref()),
    };
    match term.effect.rejection_reason(&host) {
        Some(rule) => Err(section.key_error("cause", rule)),
        None => Ok(()),
    }
}

impl Term {
    /// Returns the term as a table to be written; it reads back to the same numbers.
    ///
    /// ```
    /// use trueup_machine::effect::{Effect, Quantity, SensorGain};
    /// use trueup_machine::machine_file::{Term, writer::MachineFileEdit};
    /// let term = Term {
    ///     quantity: Quantity::Elongation,
    ///     constant_um: 0.0,
    ///     effect: Effect::SensorGain(SensorGain { gain: 1.2975 }),
    /// };
    /// let edit = MachineFileEdit { appended: vec![term.to_section()], ..MachineFileEdit::default() };
    /// let text = "[[term]]\ncause = \"sensor-gain\"\nquantity = \"elongation\"\ngain = 1.2975\n";
    /// assert_eq!(edit.to_toml(), text);
    /// ```
    #[must_use]
    pub fn to_section(&self) -> NewSection {
        let section = NewSection::new("term")
            .with_text("cause", self.effect.name())
            .with_text("quantity", self.quantity.name());
        let entries = self.effect.entries().into_iter();
        let section = entries.fold(section, |section, (key, value)| section.with_value(key, value));
        match self.constant_um {
            0.0 => section,
            constant_um => section.with_number("constant_um", constant_um),
        }
    }
}
