//! Machines with physical faults are named for what they are. The whole is `scorecard physical`; here
//! is what it rests on.

#[path = "score/physical.rs"]
mod truth;

use trueup_machine::effect::Cause;
use trueup_twin::physical::Fault;

const DOCUMENT: &str = include_str!("../../../docs/physical-faults.md");

#[test]
fn every_fault_has_one_cause_or_two_and_the_document_says_the_same() {
    let is_cause = |name: &&str| Cause::ALL.iter().any(|cause| cause.name() == *name);
    for &fault in Fault::ALL {
        let causes = truth::causes(fault);
        assert!((1..=2).contains(&causes.len()), "{}", fault.name());
        assert!(causes.iter().all(is_cause), "{causes:?}");
        let row = format!("| `{}` | `{}` |", fault.name(), causes.join("`, `"));
        assert!(DOCUMENT.contains(&row), "docs/physical-faults.md lacks: {row}");
    }
}
