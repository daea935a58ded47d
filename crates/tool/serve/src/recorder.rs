//! Records a row of each bridge once a second, and each event. It counts as recorded when it is on the disk.
//!
//! If the disk is full, rows and events wait in memory and are tried again; those that find no place there are counted
//! as lost.

use std::{
    collections::VecDeque,
    sync::atomic::Ordering,
    time::{Duration, Instant},
};

use crate::{
    clock::ClockStepDetector,
    shared_state::SharedState,
    snapshot::{BridgeEvent, BridgeSnapshot, detect_events},
    sparkplug::{build_event_record, build_snapshot_record, device_id},
    spool::NewRecord,
};

/// Rows and events that wait for a disk that is full, for each bridge.
const MAX_PENDING_ENTRIES_PER_BRIDGE: usize = 600;
/// After a disk took nothing it is tried again.
const WRITE_RETRY_INTERVAL: Duration = Duration::from_secs(1);

/// Makes rows and events of what is known of the bridges.
pub struct Recorder {
    node: String,
    /// From one row to the next.
    row: Duration,
    /// Without a broker nothing is recorded.
    is_recording: bool,
    before: Vec<BridgeSnapshot>,
    pending: VecDeque<NewRecord>,
    row_due: Instant,
    write_due: Instant,
    watch: ClockStepDetector,
    is_failing: bool,
}

impl Recorder {
    /// Returns a recorder of an edge node.
    #[must_use]
    pub fn new(node: &str, row: Duration, is_recording: bool, now: Instant, now_ms: u64) -> Self {
        Self {
            node: node.into(),
            row,
            is_recording,
            before: Vec::new(),
            pending: VecDeque::new(),
            row_due: now,
            write_due: now,
            watch: ClockStepDetector::new(now, now_ms),
            is_failing: false,
        }
    }

    /// Takes what is known now, and returns what has happened, by bridge; it is on the disk then, if the disk takes it.
    pub fn record_snapshots(
        &mut self,
        shared: &SharedState,
        bridges: &[BridgeSnapshot],
        (now, now_ms): (Instant, u64),
        report: &dyn Fn(&str),
    ) -> Vec<(usize, BridgeEvent)> {
        self.before.resize_with(bridges.len(), BridgeSnapshot::default);
        let mut happened = Vec::new();
        for (place, (before, bridge)) in self.before.iter().zip(bridges).enumerate() {
            happened.extend(detect_events(before, bridge).into_iter().map(|event| (place, event)));
        }
        if let Some(step_ms) = self.watch.detect_step_ms(now, now_ms) {
            report(&format!("warning: the clock of this computer was set by {step_ms} ms"));
            happened.push((0, BridgeEvent::new("clock-set", format!("{step_ms} ms"))));
        }
        for found in shared.lock_spool().take_reports() {
            shared.counts().lost.fetch_add(found.lost_record_count(), Ordering::Relaxed);
            report(&format!("warning: {found}"));
            happened.push((0, BridgeEvent::new(found.event_code(), found.to_string())));
        }
        let device = |place: usize| bridges.get(place)?.identity.serial.map(device_id);
        if self.is_recording {
            for (place, it) in &happened {
                let device = device(*place);
                self.pending.push_back(build_event_record(
                    &self.node,
                    device.as_deref(),
                    it.clone(),
                    now_ms,
                ));
            }
            if now >= self.row_due {
                self.row_due = (self.row_due + self.row).max(now);
                for (place, bridge) in bridges.iter().enumerate().filter(|(_, bridge)| bridge.is_up)
                {
                    let device = device(place);
                    self.pending.push_back(build_snapshot_record(
                        &self.node,
                        device.as_deref(),
                        bridge,
                        now_ms,
                    ));
                }
            }
        }
        self.before = bridges.to_vec();
        self.write_pending_entries(shared, now, report);
        happened
    }

    fn write_pending_entries(&mut self, shared: &SharedState, now: Instant, report: &dyn Fn(&str)) {
        if self.pending.is_empty() || now < self.write_due {
            return;
        }
        let written = shared.lock_spool().append(self.pending.make_contiguous());
        match written {
            Ok(()) => {
                let count = self.pending.len() as u64;
                shared.counts().recorded.fetch_add(count, Ordering::Relaxed);
                self.pending.clear();
                if std::mem::take(&mut self.is_failing) {
                    report("the spool is written again");
                }
            }
            Err(error) => {
                self.write_due = now + WRITE_RETRY_INTERVAL;
                if !std::mem::replace(&mut self.is_failing, true) {
                    report(&format!(
                        "warning: the spool cannot be written: {error}; the state goes on, and what \
                         is to be recorded waits in memory; make room on the disk"
                    ));
                }
            }
        }
        let max = MAX_PENDING_ENTRIES_PER_BRIDGE * self.before.len().max(1);
        let over = self.pending.len().saturating_sub(max);
        self.pending.drain(..over);
        shared.counts().not_recorded.fetch_add(over as u64, Ordering::Relaxed);
    }
}
