//! Shared memory that a start of LinuxCNC leaves behind when it loses its own race.
//!
//! `rtapi_app` runs as root and creates each segment as root before it gives the segment to the user
//! (`uspace_common.h` calls this racy, with "a low probability of linuxcnc to fail to start"). A
//! program of the user that asks in between is denied, and an `rtapi_app` that ends in between
//! leaves a segment that denies every later start. A program that is killed leaves its pins, which the next one reads as
//! those of a machine that runs.

use std::{fs, process::Command};

use anyhow::Result;

use crate::process;

/// The kernel's table of segments.
const SHARED_MEMORY_TABLE: &str = "/proc/sysvipc/shm";

/// Keys of HAL's pins and of the mutex of RTAPI (`hal_priv.h`, `uspace_common.h`).
const HAL_KEYS: [u32; 2] = [0x4841_4c32, 0x4848_4c34];

/// Removes what a killed LinuxCNC left of HAL; nothing while one runs.
///
/// # Errors
/// The table cannot be read, or `ipcrm` is missing or refuses.
pub(crate) fn remove_hal_segments() -> Result<()> {
    remove_unattached_segments(&HAL_KEYS)
}

/// Returns the keys of the segments that LinuxCNC was denied.
pub(crate) fn parse_denied_keys(text: &str) -> Vec<u32> {
    let key = |line: &str| {
        let (_, rest) = line.split_once("rtapi_shmem_new failed due to shmget(key=0x")?;
        let (key, reason) = rest.split_once(')')?;
        reason.contains("Permission denied").then(|| u32::from_str_radix(key, 16).ok()).flatten()
    };
    text.lines().filter_map(key).collect()
}

/// Removes the segments of these keys that no process uses.
///
/// # Errors
/// The table cannot be read, or `ipcrm` is missing or refuses.
pub(crate) fn remove_unattached_segments(keys: &[u32]) -> Result<()> {
    for id in find_unattached_segments(&fs::read_to_string(SHARED_MEMORY_TABLE)?, keys) {
        process::capture_stdout(Command::new("ipcrm").args(["--shmem-id", &id.to_string()]))?;
    }
    Ok(())
}

/// Returns the segments of these keys in the kernel's table that no process is attached to.
fn find_unattached_segments(table: &str, keys: &[u32]) -> Vec<u32> {
    let of_line = |line: &str| {
        let fields: Vec<&str> = line.split_whitespace().collect();
        // key shmid perms size cpid lpid nattch uid ...; the key is signed.
        let key = u32::from_ne_bytes(fields.first()?.parse::<i32>().ok()?.to_ne_bytes());
        let attached: u32 = fields.get(6)?.parse().ok()?;
        (keys.contains(&key) && attached == 0).then(|| fields.get(1)?.parse().ok()).flatten()
    };
    table.lines().filter_map(of_line).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_unused_segments_of_the_denied_keys_are_removed() {
        let table = "       key      shmid perms                  size  cpid  lpid nattch   uid\n\
            1212697652          3   600                    16   101   101      0     0\n\
            1212697652          4   600                    16   101   101      2     0\n\
           -1876424120          5   600                 30000   101   101      0 65534\n\
                     7          6   600                    16   101   101      0     0\n";
        assert_eq!(find_unattached_segments(table, &[0x4848_4c34, 0x9028_0a48]), [3, 5]);
        assert_eq!(find_unattached_segments(table, &[0x4848_4c34]), [3]);
    }

    #[test]
    fn the_race_is_distinguished_from_other_failures() {
        let message = "rtapi_shmem_new failed due to shmget(key=0x48484c34): Permission denied\n\
                    rtapi_shmem_new failed due to shmget(key=0x00000064): Invalid argument\n\
                    open(trueup.hal): Permission denied";
        assert_eq!(parse_denied_keys(message), [0x4848_4c34]);
    }
}
