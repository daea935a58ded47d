//! Cache of results for whole models. A search comes back to the same ones again and again: a term is looked at in its
//! place, then the next one, then all of them once more.

use std::{
    any::Any,
    collections::{HashMap, VecDeque},
    sync::{Arc, Mutex, PoisonError},
};

use super::column_cache::CacheKey;
use crate::model::Model;

/// The name of a result, and its model.
type MemoKey = (String, CacheKey);
type MemoValue = Arc<dyn Any + Send + Sync>;

/// The results, of any type.
#[derive(Debug, Default)]
pub(super) struct MemoTable(Mutex<MemoStore>);

#[derive(Debug, Default)]
struct MemoStore {
    known: HashMap<Arc<MemoKey>, MemoValue>,
    /// The newest last.
    order: VecDeque<Arc<MemoKey>>,
}

impl MemoTable {
    /// Nothing is known any more.
    pub(super) fn clear(&self) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = MemoStore::default();
    }

    /// Returns what may have been found before for `model`, else made now: the same whenever `what` is the same. At
    /// most so `many` are kept.
    pub(super) fn memoise<T: Any + Send + Sync>(
        &self,
        what: &str,
        model: &Model,
        many: usize,
        make: impl FnOnce() -> T,
    ) -> Arc<T> {
        let shelf = || self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let asked = (what.to_string(), CacheKey::from_model(model));
        let known = shelf().known.get(&asked).cloned();
        if let Some(known) = known.and_then(|known| known.downcast().ok()) {
            return known;
        }
        let made = Arc::new(make());
        let asked = Arc::new(asked);
        let mut shelf = shelf();
        // Two at once may have made the same.
        if shelf.known.insert(asked.clone(), made.clone()).is_none() {
            shelf.order.push_back(asked);
        }
        while shelf.order.len() > many {
            let oldest = shelf.order.pop_front();
            oldest.and_then(|oldest| shelf.known.remove(&oldest));
        }
        made
    }
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use super::*;
    use crate::term_kind::{ModelPart, TermKind};

    #[test]
    fn what_was_found_is_not_looked_for_again_but_for_another_question_or_model() {
        let (memo, made) = (MemoTable::default(), Cell::new(0));
        let model = |column: &str, value: f64, constant_um: Option<f64>| {
            let kind = TermKind::heat_of(column, true);
            Model { parts: vec![ModelPart { kind, values: vec![value, 1.0] }], constant_um }
        };
        let models = [
            model("temp_a_c", 1.0, None),
            model("temp_a_c", 2.0, None),
            model("temp_a_c", 1.0, Some(0.0)),
            model("temp_a_c", 1.0, Some(1.0)),
            model("temp_b_c", 1.0, None),
        ];
        let ask = |what: &str, model: &Model, many| {
            let count = || {
                made.set(made.get() + 1);
                made.get()
            };
            *memo.memoise(what, model, many, count)
        };
        for _ in 0..2 {
            let mut number = 0;
            for model in &models {
                for what in ["fit", "scan"] {
                    number += 1;
                    assert_eq!(ask(what, model, 10), number);
                }
            }
        }
        // The oldest makes room.
        assert_eq!(ask("bic", &models[0], 10), 11);
        assert_eq!(ask("scan", &models[0], 10), 2);
        assert_eq!(ask("fit", &models[0], 10), 12);
    }
}
