//! Decisions of the supervisor every 10 ms, and its report once a second.

use trueup_canopen::emergency::Fault;
use trueup_core::cnc::OffsetQuality;
use trueup_link::slcan::Port;
use trueup_node::node::{Node, ZeroOutcome};
use trueup_store::{
    calibration_load::{LoadBuffer, LoadOutcome},
    rate_limit::{RateLimiter, StorePermit},
    reference::ReferenceStore,
    retained_state,
};

use crate::{
    board::{BackupDomain, BrownOutLevel, Flash, StatusLed, Store, Watchdog, reference_store},
    liveness::{LivenessMonitor, TaskGuard},
};

/// Milliseconds between two turns.
pub const SUPERVISOR_PERIOD_MS: u32 = 10;
const LOG_PERIOD_MS: u32 = 1_000;

/// State of the supervisor.
pub struct Supervisor {
    watchdog: Watchdog,
    brown_out: BrownOutLevel,
    lamp: StatusLed,
    references: ReferenceStore<Flash>,
    /// Where a loaded calibration is kept.
    store: Option<Store>,
    /// State that outlasts a reset.
    retained: &'static mut retained_state::RetainedCopies,
    /// And a power cut.
    backup: BackupDomain,
    roll: LivenessMonitor,
    /// A task does: from then on the watchdog is not fed.
    hangs: bool,
    blocks: u32,
    silent: bool,
    until_log_ms: u32,
    store_pace: RateLimiter,
    #[cfg(feature = "slots")]
    own_slot: crate::board::OwnSlot,
}

impl Supervisor {
    pub fn new(
        watchdog: Watchdog,
        brown_out: BrownOutLevel,
        lamp: StatusLed,
        references: ReferenceStore<Flash>,
        store: Option<Store>,
        retained: &'static mut retained_state::RetainedCopies,
        backup: BackupDomain,
    ) -> Self {
        Self {
            watchdog,
            brown_out,
            lamp,
            references,
            store,
            retained,
            backup,
            roll: LivenessMonitor::default(),
            hangs: false,
            blocks: 0,
            silent: false,
            until_log_ms: 0,
            store_pace: RateLimiter::default(),
            #[cfg(feature = "slots")]
            own_slot: crate::board::OwnSlot::locate(),
        }
    }

    /// Keeps what is to outlast a reset, and a power cut. Once a second is often enough: no heat changes faster.
    pub fn save_retained_state(&mut self, kept: &retained_state::RetainedState) {
        retained_state::save_state(self.retained, kept, self.backup.now_s());
        self.backup.store(self.retained);
    }

    /// Looks at a calibration that has come whole, and stores it for the next start.
    pub fn store_calibration(&mut self, load: &mut LoadBuffer<'_>) -> LoadOutcome {
        let blob = match load.validate_blob() {
            Ok(blob) => blob,
            Err(error) => {
                defmt::error!("calibration refused: {}", error);
                return LoadOutcome::Rejected;
            }
        };
        let Self { store, watchdog, .. } = self;
        if !store.as_mut().is_some_and(|store| store.store(blob, || watchdog.feed())) {
            defmt::error!("the calibration is NOT stored");
            return LoadOutcome::NotStored;
        }
        defmt::info!("calibration of {=usize} bytes stored: used from the next start", blob.len());
        LoadOutcome::Stored
    }

    /// Stores what the operator has answered; `false`: it is not stored, and is required again at the
    /// next start.
    pub fn store_confirmation(&mut self, question: Fault, blob: &[u8]) -> bool {
        defmt::info!("confirmed: fault {=u8}", question as u8);
        // It is the newest again.
        question != Fault::OlderCalibration || self.store_running_calibration(blob)
    }

    /// Returns whether no block came since the last turn; a change is logged.
    pub fn are_samples_missing(&mut self, blocks: u32) -> bool {
        let missing = blocks == self.blocks;
        match (missing, self.silent) {
            (true, false) => {
                defmt::error!("no samples: the converter is restarted until they come");
            }
            (false, true) => defmt::warn!("samples come again"),
            _ => {}
        }
        self.silent = missing;
        self.blocks = blocks;
        missing
    }

    /// Lets a turn's time pass for [`Self::store_permit`].
    pub fn advance_store_rate_limiter(&mut self) {
        self.store_pace.advance_time(SUPERVISOR_PERIOD_MS);
    }

    /// Returns the permission where the store takes a record now: one in [`trueup_store::rate_limit::MIN_STORE_INTERVAL_MS`].
    pub fn store_permit(&self) -> Option<StorePermit> {
        self.store_pace.store_permit()
    }

    /// Logs the outcome of a `Zero` that has changed nothing.
    pub fn log_zero_outcome(zero: Option<ZeroOutcome>) {
        if zero == Some(ZeroOutcome::Unchanged) {
            defmt::warn!(
                "zero: the reference stays, an input is missing, the error is too large or the same"
            );
        }
    }

    /// Stores what holds for the calibration, where that has changed.
    pub fn store_reference_status(
        &mut self,
        node: &mut impl rtic::Mutex<T = &'static mut Node<'static>>,
        permit: StorePermit,
    ) {
        let (standing, supply) =
            node.lock(|node| (node.take_reference_status(), node.supply_baseline_level()));
        let Some(standing) = standing else { return };
        self.store_pace.record(permit);
        if !reference_store::store_reference_status(&mut self.references, standing, supply) {
            node.lock(|node| node.set_fault(Fault::Store));
        }
    }

    /// Stores the running calibration once more, so that what was loaded after it is not used; `false`: it was not
    /// stored.
    pub fn store_running_calibration(&mut self, blob: &[u8]) -> bool {
        let Self { store, watchdog, .. } = self;
        store.as_mut().is_some_and(|store| store.store(blob, || watchdog.feed()))
    }

    /// Stores the oldest write that waits: who has written what. Returns whether there was one.
    pub fn store_pending_write(
        &mut self,
        node: &mut impl rtic::Mutex<T = &'static mut Node<'static>>,
        permit: StorePermit,
    ) -> bool {
        let Some(write) = node.lock(|node| node.take_pending_write()) else { return false };
        self.store_pace.record(permit);
        let stored = reference_store::store_write_record(&mut self.references, &write);
        node.lock(|node| node.finish_write(&write, stored));
        true
    }

    /// On: live; fast: fault; slow: anything else.
    pub fn update_status_led(&mut self, now_ms: u32, quality: OffsetQuality) {
        self.lamp.set(match quality {
            OffsetQuality::Live => true,
            OffsetQuality::Fault => now_ms % 200 < 100,
            _ => now_ms % 1_000 < 500,
        });
    }

    /// Feeds it, unless a task hangs; then the next start finds the one that this turn has interrupted.
    pub fn feed_watchdog(&mut self, turn: &TaskGuard, quality: OffsetQuality) {
        if self.roll.check_for_hang(SUPERVISOR_PERIOD_MS) && !self.hangs {
            defmt::error!("a task hangs");
            self.hangs = true;
            turn.blame_preempted();
        }
        if !self.hangs {
            self.watchdog.feed();
            self.brown_out.raise_level_when_idle(
                !matches!(quality, OffsetQuality::Off | OffsetQuality::Fault),
                &mut self.watchdog,
            );
            #[cfg(feature = "slots")]
            self.own_slot.update_confirmation(quality, SUPERVISOR_PERIOD_MS);
        }
    }

    /// The board is about to be started anew because that was requested.
    #[cfg_attr(not(feature = "slots"), allow(clippy::unused_self, reason = "it has no slot"))]
    pub fn announce_restart(&mut self) {
        #[cfg(feature = "slots")]
        self.own_slot.announce_reset();
    }

    /// Returns the state of the firmware slots; `None`: the image runs from none.
    #[cfg(feature = "slots")]
    pub fn slot_states(&mut self) -> Option<trueup_node::node::firmware_update::SlotStates> {
        self.own_slot.state()
    }

    /// Does the next step of an update, if one is due.
    #[cfg(feature = "slots")]
    pub fn update_firmware(&mut self, node: &mut impl rtic::Mutex<T = &'static mut Node<'static>>) {
        use trueup_node::node::firmware_update::UpdateStep;

        let Self { own_slot, watchdog, .. } = self;
        let Some(step) = node.lock(|node| node.take_firmware_step(&mut own_slot.piece)) else {
            return;
        };
        // Outside the lock: it does not hold up a tick for longer than the flash does.
        let outcome = own_slot.perform_update_step(step, watchdog);
        // A write changes no version and no status.
        let slots = (step != UpdateStep::Write).then(|| own_slot.state()).flatten();
        node.lock(|node| {
            slots.into_iter().for_each(|slots| node.set_slot_states(slots));
            node.finish_firmware_step(step, outcome);
        });
    }

    /// Returns true once a second.
    pub fn advance_log_timer(&mut self) -> bool {
        self.until_log_ms = self.until_log_ms.saturating_sub(SUPERVISOR_PERIOD_MS);
        let due = self.until_log_ms == 0;
        if due {
            self.until_log_ms = LOG_PERIOD_MS;
        }
        due
    }
}

/// The live values, once a second, and what was refused since the start.
pub fn log_live_values(node: &mut Node<'_>, port: &Port) {
    let shown = node.take_display_values();
    let last = node.last_output();
    defmt::info!(
        "quality {=u8}, flags {=u8:#010b}, sensor {=f32} µm, noise {=f32} codes",
        last.quality as u8,
        last.flags.0,
        // NaN: none, or not fresh.
        shown.elongation_um.unwrap_or(f32::NAN),
        shown.noise_codes,
    );
    match shown.offset_um {
        Some([x, y, z]) => defmt::info!(
            "offset X {=f32}, Y {=f32}, Z {=f32} µm, {=f32} µm long",
            x,
            y,
            z,
            shown.length_um
        ),
        None => defmt::info!("offset not available"),
    }
    let (frames, lines) = (node.receiver().counters(), port.counters());
    let refused = [frames.crc_errors, frames.sequence_errors, lines.malformed, lines.dropped];
    if refused != [0; 4] {
        defmt::warn!("refused: CRC, sequence, lines; lines dropped: {}", refused);
    }
}
