//! Questions to the operator, and the offsets that are inhibited until they are answered.

use trueup_canopen::emergency::Fault;

use trueup_store::write_log::WriteKind;

use super::{Interface, Node};

/// The questions that bar every offset, in the order in which `Confirm` answers them.
const CONFIRMABLE_FAULTS: [Fault; 4] = [
    Fault::ForeignMachine,
    Fault::CalibrationChanged,
    Fault::OlderCalibration,
    Fault::ReferenceOffered,
];

impl Node<'_> {
    /// Requires the operator's confirmation. Until `Confirm` has answered it nothing is available; only
    /// [`Fault::HeatUnknown`] leaves what does not rest on the heat.
    pub fn require_confirmation(&mut self, question: Fault) {
        self.questions = self.questions.with_fault_if(true, question);
        self.update_inhibition();
    }

    /// Returns whether the running constants are those of the example.
    pub(super) fn has_example_constants(&self) -> bool {
        self.board_faults.contains(Fault::ExampleConstants)
    }

    /// The board has found itself damaged: nothing is available until it starts anew and is not.
    pub fn set_self_test_failed(&mut self) {
        self.set_fault(Fault::SelfTest);
        self.update_inhibition();
    }

    /// Returns the question that was answered last, once.
    pub fn take_confirmed_fault(&mut self) -> Option<Fault> {
        self.confirmed.take()
    }

    /// Bars the offsets until the engage sequence is complete, the questions are answered, the constants are
    /// not the example's, and the board is not damaged.
    pub(super) fn update_inhibition(&mut self) {
        let inhibited = !self.master.is_engage_sequence_complete()
            || CONFIRMABLE_FAULTS.into_iter().any(|question| self.questions.contains(question))
            || self.board_faults.contains(Fault::ExampleConstants)
            || self.board_faults.contains(Fault::SelfTest);
        self.state.set_inhibited(inhibited);
    }

    /// The first question that is open is answered.
    pub(super) fn confirm(&mut self, line: Interface) {
        let open = CONFIRMABLE_FAULTS.into_iter().chain([Fault::HeatUnknown]);
        let first = open.into_iter().find(|question| self.questions.contains(*question));
        if let Some(question) = first {
            self.questions = self.questions.without_fault(question);
            match (question, &self.bridge) {
                (Fault::HeatUnknown, Some(bridge)) => bridge.confirm_cold(&mut self.state),
                (Fault::ReferenceOffered, _) => self.accept_reference_offer(),
                (Fault::CalibrationChanged, _) => self.schedule_reference_status_store(),
                _ => {}
            }
            self.confirmed = Some(question);
            self.log_write(WriteKind::Confirmed, u32::from(question as u8), Some(line));
            if question == Fault::ForeignMachine {
                self.adopt_machine_identity(Some(line));
            }
        }
    }
}
