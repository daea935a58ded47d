//! The converter's supply, watched: what it does to readings, and when it is reported.

use super::Node;
use trueup_canopen::emergency::Fault;
use trueup_core::{supply::Level, units::Code};

impl Node<'_> {
    /// Takes a code of the converter's internal reference, one in 10 ms: readings count as if the supply were
    /// what it was, up to 3 %; beyond, what is measured by it is not believed.
    pub fn receive_supply(&mut self, code: Code) {
        self.supply.receive(code);
        let is_off = self.supply.is_off();
        self.set_fault_if(is_off, Fault::SupplyOff);
        self.state.set_supply((!is_off).then(|| self.supply.scale()));
    }

    /// Returns the level of the supply that readings, and with them the reference, count from; 0: not known yet.
    #[must_use]
    pub fn supply_basis(&self) -> Level {
        self.supply.basis()
    }

    /// Takes up a level that was stored with the reference.
    pub fn set_supply_basis(&mut self, basis: Level) {
        self.supply.set_basis(basis);
    }
}
