//! Questions to the operator, and the offsets that are barred until they are answered.

use trueup_canopen::emergency::Fault;

use trueup_store::writes::WriteKind;

use super::{Interface, Node};

/// The questions that bar every offset, in the order in which `Confirm` answers them.
const QUESTIONS: [Fault; 4] = [
    Fault::ForeignMachine,
    Fault::CalibrationChanged,
    Fault::OlderCalibration,
    Fault::ReferenceOffered,
];

impl Node<'_> {
    /// Asks the operator something. Until `Confirm` has answered it nothing is available; only
    /// [`Fault::HeatUnknown`] leaves what does not rest on the heat.
    pub fn require_confirmation(&mut self, question: Fault) {
        self.questions = self.questions.with_if(true, question);
        self.inhibit();
    }

    /// The running constants are those of the example: nothing is ever available.
    pub fn inhibit_example(&mut self) {
        self.set_fault(Fault::ExampleConstants);
        self.inhibit();
    }

    /// Returns whether the running constants are those of the example.
    pub(super) fn is_example(&self) -> bool {
        self.board_faults.has(Fault::ExampleConstants)
    }

    /// The board has found itself damaged: nothing is available until it starts anew and is not.
    pub fn bar_damaged(&mut self) {
        self.set_fault(Fault::SelfTest);
        self.inhibit();
    }

    /// Returns the question that was answered last, once.
    pub fn take_confirmed(&mut self) -> Option<Fault> {
        self.confirmed.take()
    }

    /// Bars the offsets until the engage sequence is complete, the questions are answered, the constants are
    /// not the example's, and the board is not damaged.
    pub(super) fn inhibit(&mut self) {
        let inhibited = !self.master.is_started()
            || QUESTIONS.into_iter().any(|question| self.questions.has(question))
            || self.board_faults.has(Fault::ExampleConstants)
            || self.board_faults.has(Fault::SelfTest);
        self.state.inhibit(inhibited);
    }

    /// The first question that is open is answered.
    pub(super) fn confirm(&mut self, line: Interface) {
        let open = QUESTIONS.into_iter().chain([Fault::HeatUnknown]);
        let first = open.into_iter().find(|question| self.questions.has(*question));
        if let Some(question) = first {
            self.questions = self.questions.without(question);
            match (question, &self.bridge) {
                (Fault::HeatUnknown, Some(bridge)) => bridge.confirm_cold(&mut self.state),
                (Fault::ReferenceOffered, _) => self.take_offer(),
                (Fault::CalibrationChanged, _) => self.store_standing(),
                _ => {}
            }
            self.confirmed = Some(question);
            self.log(WriteKind::Confirmed, u32::from(question as u8), Some(line));
            if question == Fault::ForeignMachine {
                self.name(Some(line));
            }
        }
    }
}
