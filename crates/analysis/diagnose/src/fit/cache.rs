//! Columns that were worked out before. Columns that are only added do not depend on the model, and the rest of a model
//! often stays while these change.

use std::{
    collections::{HashMap, VecDeque},
    hash::{Hash, Hasher},
    sync::Arc,
};

use super::growth::Grown;
use crate::{
    kind::{Kind, Part},
    model::Model,
};

/// Columns side by side, in groups.
pub(crate) type Columns = Arc<Vec<Vec<f64>>>;

/// The parts that columns are of: equal if all values are, to the bit.
#[derive(Clone, Debug)]
pub(super) struct Key {
    parts: Vec<Part>,
    /// The constant of a whole model, in bits.
    constant: Option<u64>,
}

impl Key {
    /// Of one part, by its nonlinear values.
    pub(super) fn of(kind: &Kind, nonlinear: &[f64]) -> Self {
        let parts = vec![Part { kind: kind.clone(), values: nonlinear.to_vec() }];
        Self { parts, constant: None }
    }

    /// Of several parts together.
    pub(super) fn of_all(parts: &[&Part]) -> Self {
        Self { parts: parts.iter().copied().cloned().collect(), constant: None }
    }

    /// Of a model.
    pub(super) fn of_model(model: &Model) -> Self {
        Self { parts: model.parts.clone(), constant: model.constant_um.map(f64::to_bits) }
    }
}

impl PartialEq for Key {
    fn eq(&self, other: &Self) -> bool {
        fn bits(part: &Part) -> impl Iterator<Item = u64> {
            part.values.iter().map(|value| value.to_bits())
        }
        let is_equal = |(a, b): (&Part, &Part)| bits(a).eq(bits(b)) && a.kind == b.kind;
        let (own, others) = (&self.parts, &other.parts);
        self.constant == other.constant
            && own.len() == others.len()
            && own.iter().zip(others).all(is_equal)
    }
}

// No kind holds a NaN.
impl Eq for Key {}

impl Hash for Key {
    /// Kinds that differ only in what is fixed about them meet, and are distinguished by `eq`.
    fn hash<H: Hasher>(&self, state: &mut H) {
        self.constant.hash(state);
        for part in &self.parts {
            part.kind.name().hash(state);
            part.kind.column().hash(state);
            part.values.iter().for_each(|value| value.to_bits().hash(state));
        }
    }
}

/// Cache of the columns that were worked out before.
#[derive(Debug, Default)]
pub(super) struct Cache {
    /// Of the settings that every scan tries.
    kept: HashMap<Key, Columns>,
    /// Numbers in them.
    numbers: usize,
    /// Of values on the way of a fit.
    recent: HashMap<Arc<Key>, Columns>,
    /// Their order, the newest last.
    order: VecDeque<Arc<Key>>,
    recent_numbers: usize,
    pub grown: Grown,
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
        self.kept.get(key).or_else(|| self.recent.get(key)).cloned()
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
        let key = Arc::new(key);
        // Two at once may have made the same.
        if self.recent.insert(key.clone(), columns).is_some() {
            return;
        }
        self.recent_numbers += size;
        self.order.push_back(key);
        while self.recent_numbers > Self::RECENT_LIMIT {
            let oldest = self.order.pop_front().and_then(|key| self.recent.remove(&key));
            let Some(oldest) = oldest else { break };
            self.recent_numbers -= oldest.iter().map(Vec::len).sum::<usize>();
        }
    }
}
