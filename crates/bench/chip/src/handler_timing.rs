//! How long each exception's handler takes: of its own, and from its beginning to its end with whatever interrupts it.

use std::collections::BTreeMap;

/// The longest turns of a handler, in ticks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MaxHandlerTimes {
    /// Of its own.
    pub own: u64,
    /// From beginning to end.
    pub whole: u64,
}

struct HandlerActivation {
    exception: u16,
    entry: u32,
    began: u64,
    own: u64,
}

/// The turns of a run.
#[derive(Default)]
pub struct HandlerTimer {
    open: Vec<HandlerActivation>,
    /// The longest by the number of the exception.
    pub longest: BTreeMap<u16, MaxHandlerTimes>,
}

impl HandlerTimer {
    /// An instruction at `pc` has been executed for `ticks`, up to `now`, in this exception (0: in none). `is_active` says which
    /// have begun and not ended.
    pub fn record_step(
        &mut self,
        exception: u16,
        pc: u32,
        ticks: u64,
        now: u64,
        is_active: impl Fn(u16) -> bool,
    ) {
        let is_again = |turn: &HandlerActivation| {
            turn.exception == exception && turn.entry == pc && turn.own > 0
        };
        let is_other = self.open.last().is_some_and(|top| top.exception != exception);
        if is_other || self.open.last().is_some_and(is_again) {
            while let Some(top) = self.open.last() {
                if is_active(top.exception) && !is_again(top) {
                    break;
                }
                let HandlerActivation { exception, began, own, .. } =
                    self.open.pop().expect("it is there");
                let longest = self.longest.entry(exception).or_default();
                longest.own = longest.own.max(own);
                longest.whole = longest.whole.max(now - ticks - began);
            }
        }
        if exception == 0 {
            return;
        }
        if self.open.last().is_none_or(|top| top.exception != exception) {
            self.open.push(HandlerActivation { exception, entry: pc, began: now - ticks, own: 0 });
        }
        if let Some(top) = self.open.last_mut() {
            top.own += ticks;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_interrupted_turn_counts_its_own_ticks_and_all_of_them() {
        let mut turns = HandlerTimer::default();
        turns.record_step(20, 100, 3, 3, |_| true);
        turns.record_step(30, 200, 5, 8, |_| true);
        turns.record_step(20, 102, 2, 10, |exception| exception == 20);
        // It comes again at once.
        turns.record_step(20, 100, 1, 11, |_| true);
        turns.record_step(0, 0, 9, 20, |_| false);
        assert_eq!(turns.longest[&30], MaxHandlerTimes { own: 5, whole: 5 });
        assert_eq!(turns.longest[&20], MaxHandlerTimes { own: 5, whole: 10 });
        assert!(turns.open.is_empty());
    }
}
