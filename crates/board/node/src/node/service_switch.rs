//! The service switch at the board: a calibration may require that nothing is written unless it is closed.
//!
//! It holds for everything that a master writes by SDO (a calibration, a reference, settings, the time) and for NMT reset
//! node. `Zero`, `Confirm` and what was learned come in `Control`, which is the CNC's own, and need no switch.

use trueup_canopen::{dictionary::WriteAuthority, sdo::AbortCode};

use super::Node;

/// This many equal readings, one in 10 ms, are a position of the switch: contacts bounce for less than 20 ms.
const DEBOUNCE_SAMPLES: u8 = 5;

/// The switch, debounced; open until it has been closed for its time.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct SwitchDebouncer {
    is_closed: bool,
    /// Readings in a row that differ from it.
    differs: u8,
}

impl SwitchDebouncer {
    /// Takes a reading.
    fn update(&mut self, is_closed: bool) {
        self.differs = if is_closed == self.is_closed { 0 } else { self.differs.saturating_add(1) };
        if self.differs >= DEBOUNCE_SAMPLES {
            *self = Self { is_closed, differs: 0 };
        }
    }
}

impl Node<'_> {
    /// Takes a reading of the service switch, one every 10 ms.
    pub fn update_service_switch(&mut self, is_closed: bool) {
        self.switch.update(is_closed);
    }

    /// Returns whether the running calibration requires the switch, and it is open.
    fn is_locked_by_service_switch(&self) -> bool {
        let questions =
            |bridge: &trueup_core::bridge::Bridge<'_>| bridge.calibration().guards.service_switch;
        self.bridge.as_ref().is_some_and(questions) && !self.switch.is_closed
    }

    /// Returns who may write, as the dictionary has it.
    pub(super) fn write_authority(&self) -> WriteAuthority {
        if self.is_locked_by_service_switch() {
            WriteAuthority::SwitchOpen
        } else {
            self.master.write_authority()
        }
    }

    /// Checks that the operator allows that a master changes the board, and that no offset is followed.
    ///
    /// # Errors
    /// Why it must not be changed now.
    pub(super) fn check_change_allowed(&self) -> Result<(), AbortCode> {
        match self.write_authority() {
            WriteAuthority::SwitchOpen => Err(AbortCode::LocalControl),
            WriteAuthority::Service if self.is_offset_inactive() => Ok(()),
            _ => Err(AbortCode::DeviceState),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::node::{Interface, sensor_only_calibration};
    use trueup_canopen::{
        dictionary::{CLEAR_REFERENCE_SIGNATURE, EntryContent, RESTORE_REFERENCE_SIGNATURE},
        sdo::{ObjectAccess as _, ObjectValue},
    };
    use trueup_core::cnc::Control;
    use trueup_link::{frame::Frame, frames, layout::NMT_ID};
    use trueup_store::calibration_load::LoadSlot;

    /// Returns a node at rest whose CNC says `Service`.
    fn node_in_service<'a>(requires_confirmation: bool) -> Node<'a> {
        let mut calibration = sensor_only_calibration();
        calibration.guards.service_switch = requires_confirmation;
        let mut node = Node::new(calibration.into());
        let service = Control { service: true, ..Control::REFERENCED };
        for counter in 0..4 {
            node.receive(Interface::Can, &frames::encode_control(service, counter))
                .expect("in order");
        }
        node
    }

    fn turn(node: &mut Node<'_>, is_closed: bool) {
        (0..DEBOUNCE_SAMPLES).for_each(|_| node.update_service_switch(is_closed));
    }

    #[test]
    fn a_calibration_that_asks_for_the_switch_is_written_to_with_it_closed_and_only_then() {
        let writes = [
            (EntryContent::Utc, 1_800_000_000),
            (EntryContent::ReferenceElongation, 5),
            (EntryContent::Forget, CLEAR_REFERENCE_SIGNATURE),
            (EntryContent::ProducerHeartbeat, 500),
            (EntryContent::ErrorCount, 0),
        ];
        for (what, number) in writes {
            let mut node = node_in_service(true);
            assert_eq!(node.write(what, number), Err(AbortCode::LocalControl), "{what:?}");
            assert_eq!(node.open(EntryContent::New, Some(4)), Err(AbortCode::LocalControl));
            assert_eq!(node.close(EntryContent::New), Err(AbortCode::LocalControl));
            let authority = node.read(EntryContent::Authority);
            assert_eq!(authority, Ok(ObjectValue::Number(WriteAuthority::SwitchOpen as u32)));
            turn(&mut node, true);
            assert_eq!(node.write(what, number), Ok(()), "{what:?}");
            turn(&mut node, false);
            assert_eq!(node.write(what, number), Err(AbortCode::LocalControl), "{what:?}");
            assert_eq!(node_in_service(false).write(what, number), Ok(()), "{what:?}");
        }
    }

    #[test]
    fn a_calibration_is_downloaded_and_a_reference_restored_with_the_switch_closed_and_only_then() {
        let mut buffer = [0; 8];
        let mut node = node_in_service(true);
        node.slot = LoadSlot::new(&mut buffer);
        let send = |node: &mut Node<'_>| {
            node.open(EntryContent::New, Some(4))?;
            node.append(EntryContent::New, &[1, 2, 3, 4])
        };
        let restore = |node: &mut Node<'_>| -> Result<(), AbortCode> {
            node.write(EntryContent::ReferenceElongation, 5)?;
            (0..3).try_for_each(|axis| node.write(EntryContent::Reference(axis), 0))?;
            node.write(EntryContent::Forget, RESTORE_REFERENCE_SIGNATURE)
        };
        // A download that begins while it is closed is not taken once it is open.
        turn(&mut node, true);
        assert_eq!(send(&mut node), Ok(()));
        turn(&mut node, false);
        assert_eq!(
            (node.close(EntryContent::New), node.take_received_calibration().is_some()),
            (Err(AbortCode::LocalControl), false)
        );

        let reset = Frame::new(NMT_ID, &[0x81, 1]).expect("short");
        for is_closed in [false, true, false] {
            turn(&mut node, is_closed);
            let expected = if is_closed { Ok(()) } else { Err(AbortCode::LocalControl) };
            assert_eq!(restore(&mut node), expected);
            assert_eq!(send(&mut node).and_then(|()| node.close(EntryContent::New)), expected);
            assert_eq!(node.take_received_calibration().is_some(), is_closed);
            node.receive(Interface::Can, &reset).expect("no request");
            assert_eq!(node.take_restart_request(), is_closed);
        }
    }

    #[test]
    fn a_contact_that_bounces_is_no_switch_that_is_closed() {
        let mut node = node_in_service(true);
        for n in 0..100 {
            node.update_service_switch(n % 5 != 0);
            assert_eq!(node.write_authority(), WriteAuthority::SwitchOpen);
        }
    }
}
