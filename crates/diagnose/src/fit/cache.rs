//! Columns that were worked out before. What is only added does not depend on the model, and the rest
//! of a model often stays while what is added changes.

use std::{
    collections::{HashMap, VecDeque},
    hash::{Hash, Hasher},
    sync::Arc,
};

use crate::{
    kind::{Kind, Part},
    model::Model,
};

/// Columns side by side, in groups.
pub(crate) type Columns = Arc<Vec<Vec<f64>>>;

/// The parts that columns are of: equal if all values are, to the bit.
#[derive(Clone, Debug)]
pub(super) struct Key(Vec<Part>);

impl Key {
    /// Of one part, by its nonlinear values.
    pub(super) fn of(kind: &Kind, nonlinear: &[f64]) -> Self {
        Self(vec![Part { kind: kind.clone(), values: nonlinear.to_vec() }])
    }

    /// Of several parts together.
    pub(super) fn of_all(parts: &[&Part]) -> Self {
        Self(parts.iter().copied().cloned().collect())
    }
}

impl PartialEq for Key {
    fn eq(&self, other: &Self) -> bool {
        fn bits(part: &Part) -> impl Iterator<Item = u64> {
            part.values.iter().map(|value| value.to_bits())
        }
        let is_equal = |(a, b): (&Part, &Part)| bits(a).eq(bits(b)) && a.kind == b.kind;
        self.0.len() == other.0.len() && self.0.iter().zip(&other.0).all(is_equal)
    }
}

// No kind holds a NaN.
impl Eq for Key {}

impl Hash for Key {
    /// Kinds that differ only in what is fixed about them meet, and are told apart by `eq`.
    fn hash<H: Hasher>(&self, state: &mut H) {
        for part in &self.0 {
            part.kind.name().hash(state);
            part.kind.column().hash(state);
            part.values.iter().for_each(|value| value.to_bits().hash(state));
        }
    }
}

/// What was worked out before.
#[derive(Debug, Default)]
pub(super) struct Cache {
    /// Of the settings that every scan tries.
    kept: HashMap<Key, Columns>,
    /// Numbers in them.
    numbers: usize,
    /// Of values on the way of a fit, the newest last.
    recent: VecDeque<(Key, Columns)>,
    recent_numbers: usize,
    /// A model that is late, and what it would predict of each row if it were not.
    pub unshifted: Option<(Model, Arc<Vec<f64>>)>,
}

impl Cache {
    /// Numbers that are kept at most, 8 bytes each: 80 MB and 16 MB.
    const LIMIT: usize = 10_000_000;
    const RECENT_LIMIT: usize = 2_000_000;
    /// The longest column: of all rows of a long record a few would fill the room, and only the last fit asks for them.
    const LONGEST: usize = 100_000;

    pub(super) fn get(&self, key: &Key) -> Option<Columns> {
        let recent = || self.recent.iter().rev().find(|(there, _)| there == key).map(|(_, it)| it);
        self.kept.get(key).or_else(recent).cloned()
    }

    /// `keep`: they will be asked for again and again.
    pub(super) fn put(&mut self, key: Key, columns: Columns, keep: bool) {
        if columns.iter().any(|column| column.len() > Self::LONGEST) {
            return;
        }
        let size = columns.iter().map(Vec::len).sum::<usize>();
        if keep && self.numbers + size < Self::LIMIT {
            self.numbers += size;
            self.kept.insert(key, columns);
            return;
        }
        self.recent_numbers += size;
        self.recent.push_back((key, columns));
        while self.recent_numbers > Self::RECENT_LIMIT {
            let Some((_, oldest)) = self.recent.pop_front() else { break };
            self.recent_numbers -= oldest.iter().map(Vec::len).sum::<usize>();
        }
    }
}
