//! The CAN bus: bxCAN 1, 1 Mbit/s, on PB8 and PB9 (section 32).
//!
//! Straight on the registers, for two reasons. The driver `bxcan` queues frames: a free mailbox is
//! taken for each, and an older frame of the same identifier goes out first. A CNC wants the
//! newest value and no other, so here each cyclic identifier has a mailbox of its own, and a new
//! frame takes the place of one that still waits there. And `bxcan` waits without a limit for the
//! controller to answer; here a controller that does not answer is dead, and everything is inert.
//!
//! Frames of the CNC are spread over both FIFOs of three: a cycle of the six fast ones, back to back,
//! fits whole, so the tasks have time until the next cycle. `Conditions` comes twenty times a second; if one is
//! lost to a full FIFO, the next is there long before its timeout.
//!
//! The controller waits for a quiet bus by itself before it takes part, and comes back by itself
//! from bus-off (ABOM).

use stm32f4xx_hal::{
    gpio::{PB8, PB9, Pull},
    pac::{CAN1, can1},
    rcc::{Enable, Rcc, Reset},
};
use trueup_link::{
    frame::Frame,
    layout::{
        CONDITIONS_ID, CONTROL_ID, NMT_ID, OFFSET_XY_ID, OFFSET_Z_ID, POSITION_X_ID, POSITION_Y_ID,
        POSITION_Z_ID, ROTARY_ID, SDO_REQUEST_ID, SPINDLE_ID,
    },
};

use super::{super::CanErrorState, clocks::ClockSource, poll_until};

/// 1 Mbit/s at 42 MHz: prescaler 3; 1 + 11 + 2 quanta, sampled at 86 %; jump width 1.
const CAN_BIT_TIMING: u32 = 0x001a_0002;
/// Frames of the CNC and of a CANopen master, by FIFO. The filter drops everything else but heartbeats.
const ACCEPTED_IDS: [[u16; 4]; 2] = [
    [POSITION_X_ID, POSITION_Y_ID, CONTROL_ID, SDO_REQUEST_ID],
    [POSITION_Z_ID, ROTARY_ID, SPINDLE_ID, NMT_ID],
];
/// The bank of the heartbeats, whose node a master chooses: 0x700…0x77F.
const HEARTBEAT_FILTER_BANK: u8 = 2;
/// `Conditions` in the other half of that bank: all bits of the identifier count.
const CONDITIONS_FILTER: u32 = ((0x7FF << 5 | 0x18) << 16) | (CONDITIONS_ID as u32) << 5;
/// As a bank of 16 bits has it: the identifier to compare with below, the bits that count above,
/// among them "extended" and "remote".
const HEARTBEAT_FILTER: u32 = ((0x780 << 5 | 0x18) << 16) | 0x700 << 5;
/// The controller answers within microseconds; this is about 10 ms.
const MAX_RESPONSE_POLLS: u32 = 100_000;
/// How often a frame in the third mailbox is waited for: 20 ms of the bus's worst hours.
const MAX_MAILBOX_WAITS: u32 = 20;
/// A frame that waits is withdrawn within a few clocks of the controller; this is 3 µs.
const MAX_ABORT_POLLS: u32 = 32;

/// Starts the controller, if its clock is exact enough for a bus; and whether it answers.
#[allow(unsafe_code, reason = "registers of the CAN controller")]
pub fn start(
    can: CAN1,
    tx: PB9,
    rx: PB8,
    source: ClockSource,
    rcc: &mut Rcc,
) -> ([CanRx; 2], CanTx, bool) {
    CAN1::enable(rcc);
    CAN1::reset(rcc);
    let answers = enter_initialisation(&can);
    if !answers {
        defmt::error!("dead: CAN");
    }
    let on_the_bus = answers && matches!(source, ClockSource::Crystal { .. });
    if on_the_bus {
        // Only now does the controller get its pins: one with a wrong clock must not reach the
        // bus. Pulled up, so that a missing transceiver looks like a quiet bus.
        let _ = tx.into_alternate::<9>();
        let _ = rx.into_alternate::<9>().internal_resistor(Pull::Up);
        configure_filters(&can, &ACCEPTED_IDS);
        join_bus(&can);
        defmt::info!("CAN: 1 Mbit/s");
    }
    // SAFETY: `CanTx` uses the transmit registers alone, each `CanRx` those of its FIFO alone.
    let (second, transmitter) = unsafe { (CAN1::steal(), CAN1::steal()) };
    let can_in = [CanRx { can, fifo: 0, overruns: 0 }, CanRx { can: second, fifo: 1, overruns: 0 }];
    let worst = CanErrorState::default();
    (can_in, CanTx { can: transmitter, on_the_bus, late: 0, waited: 0, worst }, answers)
}

/// Out of sleep, into the initialisation mode, in which the controller is silent.
fn enter_initialisation(can: &CAN1) -> bool {
    can.mcr().modify(|_, w| w.sleep().clear_bit().inrq().set_bit());
    poll_until(MAX_RESPONSE_POLLS, || can.msr().read().inak().bit_is_set())
}

/// Lets standard data frames with these identifiers into the FIFO of their bank: a bank is a list of
/// four 16-bit entries, of which the upper 11 bits are the identifier and the rest says "standard,
/// data" (section 32.7.4).
#[allow(unsafe_code, reason = "registers of the CAN controller")]
fn configure_filters(can: &CAN1, ids: &[[u16; 4]; 2]) {
    can.fmr().modify(|_, w| w.finit().set_bit());
    for (number, ids) in (0..).zip(ids) {
        let [first, second, third, fourth] = ids.map(|id| u32::from(id) << 5);
        let bank = can.fb(usize::from(number));
        // SAFETY: any value is a valid list.
        bank.fr1().write(|w| unsafe { w.bits(second << 16 | first) });
        // SAFETY: as above.
        bank.fr2().write(|w| unsafe { w.bits(fourth << 16 | third) });
        can.fm1r().modify(|_, w| w.fbm(number).set_bit());
        can.ffa1r().modify(|_, w| w.ffa(number).bit(number == 1));
        can.fa1r().modify(|_, w| w.fact(number).set_bit());
    }
    let bank = can.fb(HEARTBEAT_FILTER_BANK.into());
    // SAFETY: any value is a valid mask.
    bank.fr1().write(|w| unsafe { w.bits(HEARTBEAT_FILTER) });
    // SAFETY: as above.
    bank.fr2().write(|w| unsafe { w.bits(CONDITIONS_FILTER) });
    can.ffa1r().modify(|_, w| w.ffa(HEARTBEAT_FILTER_BANK).set_bit());
    can.fa1r().modify(|_, w| w.fact(HEARTBEAT_FILTER_BANK).set_bit());
    can.fmr().modify(|_, w| w.finit().clear_bit());
}

/// Leaves the initialisation mode; the controller itself waits for 11 recessive bits.
#[allow(unsafe_code, reason = "registers of the CAN controller")]
fn join_bus(can: &CAN1) {
    // SAFETY: a valid bit timing, in initialisation mode.
    can.btr().write(|w| unsafe { w.bits(CAN_BIT_TIMING) });
    can.ier().modify(|_, w| w.fmpie0().enabled().fmpie1().enabled());
    can.mcr().modify(|_, w| w.abom().set_bit().inrq().clear_bit());
}

/// Frames from the bus, by one of the two FIFOs.
pub struct CanRx {
    can: CAN1,
    fifo: usize,
    overruns: u32,
}

impl CanRx {
    /// Returns the oldest frame that waits. The interrupt comes again while another one does.
    pub fn receive(&mut self) -> Option<Frame> {
        let fifo = self.can.rfr(self.fifo).read();
        if fifo.fovr().bit_is_set() {
            self.count_overrun();
        }
        // While the last frame is being released, the FIFO still shows it.
        if fifo.fmp().bits() == 0 || fifo.rfom().bit_is_set() {
            return None;
        }
        let frame = read_mailbox(self.can.rx(self.fifo));
        self.can.rfr(self.fifo).write(|w| w.rfom().set_bit());
        frame
    }

    fn count_overrun(&mut self) {
        self.can.rfr(self.fifo).write(|w| w.fovr().clear());
        self.overruns = self.overruns.saturating_add(1);
        // A flooded bus must not flood the log as well.
        if self.overruns.is_power_of_two() {
            defmt::warn!("CAN: FIFO {} overrun, number {}", self.fifo, self.overruns);
        }
    }
}

/// Returns the frame in a receive mailbox; the filter lets only standard data frames in.
fn read_mailbox(mailbox: &can1::RX) -> Option<Frame> {
    let identifier = mailbox.rir().read();
    if identifier.ide().bit_is_set() || identifier.rtr().bit_is_set() {
        return None;
    }
    let mut data = [0; Frame::MAX_LEN];
    data[..4].copy_from_slice(&mailbox.rdlr().read().bits().to_le_bytes());
    data[4..].copy_from_slice(&mailbox.rdhr().read().bits().to_le_bytes());
    // A length code above 8 means 8 (ISO 11898-1).
    let len = usize::from(mailbox.rdtr().read().dlc().bits()).min(Frame::MAX_LEN);
    Frame::new(identifier.stid().bits(), &data[..len]).ok()
}

/// Frames to the bus.
pub struct CanTx {
    can: CAN1,
    on_the_bus: bool,
    late: u32,
    /// Turns for which the third mailbox was found full.
    waited: u32,
    /// The worst since the last call.
    worst: CanErrorState,
}

impl CanTx {
    /// Returns whether a frame other than offsets still waits: another one would take its place, and an
    /// answer to an SDO request comes only once. A bus on which nothing gets out is not waited for,
    /// because the serial line has the same frames; called once a millisecond.
    pub fn is_busy(&mut self) -> bool {
        if !self.on_the_bus || self.is_mailbox_empty(SHARED_MAILBOX) {
            self.waited = 0;
            return false;
        }
        self.waited = self.waited.saturating_add(1);
        self.waited <= MAX_MAILBOX_WAITS
    }

    /// Hands over a frame, in the place of an older one with its identifier that still waits.
    ///
    /// A frame that is on the wire at this moment is not cut off, but will not be repeated if it
    /// fails; the new one is dropped then, and the next cycle brings a newer one.
    pub fn send(&mut self, frame: &Frame) {
        if !self.on_the_bus {
            return;
        }
        self.update_worst_error_state();
        let mailbox = select_mailbox(frame.id());
        if !self.is_mailbox_empty(mailbox) && !self.abort_mailbox(mailbox) {
            self.count_late_frame(frame.id());
            return;
        }
        write_mailbox(self.can.tx(usize::from(mailbox)), frame);
    }

    /// Returns how the controller has been on its bus since the last call, at its worst: bus-off lasts for
    /// 1.4 ms only, and comes again. A controller that was never meant to join is well.
    pub fn take_worst_error_state(&mut self) -> CanErrorState {
        if self.on_the_bus {
            self.update_worst_error_state();
        }
        core::mem::take(&mut self.worst)
    }

    /// Section 32.9.2, ESR. A controller that was commanded to join and has not left its initialisation sees no
    /// quiet bus: a dominant one, by a short or a dead transceiver.
    fn update_worst_error_state(&mut self) {
        let errors = self.can.esr().read();
        let outside = self.can.msr().read().inak().bit_is_set();
        self.worst.warning |= errors.ewgf().bit_is_set();
        self.worst.passive |= errors.epvf().bit_is_set();
        self.worst.off |= errors.boff().bit_is_set() || outside;
    }

    fn is_mailbox_empty(&self, mailbox: u8) -> bool {
        self.can.tsr().read().tme(mailbox).bit_is_set()
    }

    fn abort_mailbox(&mut self, mailbox: u8) -> bool {
        self.can.tsr().write(|w| match mailbox {
            0 => w.abrq0().set_bit(),
            1 => w.abrq1().set_bit(),
            _ => w.abrq2().set_bit(),
        });
        poll_until(MAX_ABORT_POLLS, || self.is_mailbox_empty(mailbox))
    }

    fn count_late_frame(&mut self, id: u16) {
        self.late = self.late.saturating_add(1);
        // A bus without another node must not fill the log.
        if self.late.is_power_of_two() {
            defmt::warn!("CAN: {:#x} still on the wire, dropped frame number {}", id, self.late);
        }
    }
}

/// Of whatever is no offset.
const SHARED_MAILBOX: u8 = 2;

/// `OffsetXY` and `OffsetZ` have a mailbox each, the heartbeat shares the third with whatever else
/// is sent seldom. Of two that wait, the lower identifier goes first.
fn select_mailbox(id: u16) -> u8 {
    match id {
        OFFSET_XY_ID => 0,
        OFFSET_Z_ID => 1,
        _ => SHARED_MAILBOX,
    }
}

#[allow(unsafe_code, reason = "registers of the CAN controller")]
fn write_mailbox(mailbox: &can1::TX, frame: &Frame) {
    let [a, b, c, d, e, f, g, h] = *frame.data();
    // SAFETY: a `Frame` has a length of 0…8 and an identifier of 11 bits. The mailbox is empty.
    mailbox.tdtr().write(|w| unsafe { w.dlc().bits(frame.len()) });
    // SAFETY: as above.
    mailbox.tdlr().write(|w| unsafe { w.bits(u32::from_le_bytes([a, b, c, d])) });
    // SAFETY: as above.
    mailbox.tdhr().write(|w| unsafe { w.bits(u32::from_le_bytes([e, f, g, h])) });
    // Last, because TXRQ hands the mailbox over.
    // SAFETY: as above.
    mailbox.tir().write(|w| unsafe { w.stid().bits(frame.id()) }.txrq().set_bit());
}
