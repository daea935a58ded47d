//! Columns that were worked out before. Columns that are only added do not depend on the model, and the rest of a model
//! often stays while these change.

use std::{
    collections::{HashMap, VecDeque},
    hash::{Hash, Hasher},
    sync::Arc,
};

use super::growth_cache::GrowthCache;
use crate::{
    model::Model,
    term_kind::{ModelPart, TermKind},
};

/// Columns side by side, in groups.
pub(crate) type GroupColumns = Arc<Vec<Vec<f64>>>;

/// The parts that columns are of: equal if all values are, to the bit.
#[derive(Clone, Debug)]
pub(super) struct CacheKey {
    parts: Vec<ModelPart>,
    /// The constant of a whole model, in bits.
    constant: Option<u64>,
}

impl CacheKey {
    /// Of one part, by its nonlinear values.
    pub(super) fn from_part(kind: &TermKind, nonlinear: &[f64]) -> Self {
        let parts = vec![ModelPart { kind: kind.clone(), values: nonlinear.to_vec() }];
        Self { parts, constant: None }
    }

    /// Of several parts together.
    pub(super) fn from_parts(parts: &[&ModelPart]) -> Self {
        Self { parts: parts.iter().copied().cloned().collect(), constant: None }
    }

    /// Of a model.
    pub(super) fn from_model(model: &Model) -> Self {
        Self { parts: model.parts.clone(), constant: model.constant_um.map(f64::to_bits) }
    }
}

impl PartialEq for CacheKey {
    fn eq(&self, other: &Self) -> bool {
        fn value_bits(part: &ModelPart) -> impl Iterator<Item = u64> {
            part.values.iter().map(|value| value.to_bits())
        }
        let is_equal =
            |(a, b): (&ModelPart, &ModelPart)| value_bits(a).eq(value_bits(b)) && a.kind == b.kind;
        let (own, others) = (&self.parts, &other.parts);
        self.constant == other.constant
            && own.len() == others.len()
            && own.iter().zip(others).all(is_equal)
    }
}

// No kind holds a NaN.
impl Eq for CacheKey {}

impl Hash for CacheKey {
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
pub(super) struct ColumnCache {
    /// Of the settings that every scan tries.
    kept: HashMap<CacheKey, GroupColumns>,
    /// Numbers in them.
    numbers: usize,
    /// Of values on the way of a fit.
    recent: HashMap<Arc<CacheKey>, GroupColumns>,
    /// Their order, the newest last.
    order: VecDeque<Arc<CacheKey>>,
    recent_numbers: usize,
    pub grown: GrowthCache,
    /// A model that is late, and what it would predict of each row if it were not.
    pub unshifted: Option<(Model, Arc<Vec<f64>>)>,
}

impl ColumnCache {
    /// Numbers that are kept at most, 8 bytes each: 80 MB and 16 MB.
    const MAX_CACHED_VALUES: usize = 10_000_000;
    const MAX_RECENT_VALUES: usize = 2_000_000;
    /// The longest column: of all rows of a long record a few would fill the room, and only the last fit asks for them.
    const MAX_CACHED_ROWS: usize = 100_000;

    pub(super) fn get(&self, key: &CacheKey) -> Option<GroupColumns> {
        self.kept.get(key).or_else(|| self.recent.get(key)).cloned()
    }

    /// `keep`: they will be requested again and again.
    pub(super) fn insert(&mut self, key: CacheKey, columns: GroupColumns, keep: bool) {
        if columns.iter().any(|column| column.len() > Self::MAX_CACHED_ROWS) {
            return;
        }
        let size = columns.iter().map(Vec::len).sum::<usize>();
        if keep && self.numbers + size < Self::MAX_CACHED_VALUES {
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
        while self.recent_numbers > Self::MAX_RECENT_VALUES {
            let oldest = self.order.pop_front().and_then(|key| self.recent.remove(&key));
            let Some(oldest) = oldest else { break };
            self.recent_numbers -= oldest.iter().map(Vec::len).sum::<usize>();
        }
    }
}
