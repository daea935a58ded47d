//! The converter's supply, watched: what it does to readings, and when it is reported.

use super::Node;
use trueup_canopen::emergency::Fault;
use trueup_core::{supply_monitor::InternalReferenceLevel, units::AdcCode};

impl Node<'_> {
    /// Takes a code of the converter's internal reference, one in 10 ms: readings count as if the supply were
    /// what it was, up to 3 %; beyond, what is measured by it is not believed.
    pub fn receive_supply_code(&mut self, code: AdcCode) {
        self.supply.receive(code);
        let is_off = self.supply.is_out_of_tolerance();
        self.set_or_clear_fault(is_off, Fault::SupplyOff);
        self.state.set_supply_scale((!is_off).then(|| self.supply.scale()));
    }

    /// Returns the level of the supply that readings, and with them the reference, count from; 0: not known yet.
    #[must_use]
    pub fn supply_baseline_level(&self) -> InternalReferenceLevel {
        self.supply.baseline_level()
    }

    /// Takes up a level that was stored with the reference.
    pub fn set_supply_baseline_level(&mut self, basis: InternalReferenceLevel) {
        self.supply.set_baseline_level(basis);
    }
}
