//! The component's pins in a LinuxCNC that runs, by `halcmd`.

use std::{collections::BTreeMap, fs, process::Command};

use anyhow::Result;
use trueup_linuxcnc::status;

use crate::UserError;

/// Returns the component's pins; `None` if LinuxCNC does not run. `halcmd` alone would start a HAL of its own.
pub fn read_pins() -> Result<Option<BTreeMap<String, String>>> {
    if !is_running() {
        return Ok(None);
    }
    let shown = Command::new("halcmd").args(["-s", "show", "pin", "trueup.0."]).output();
    let shown = shown.map_err(|error| UserError(format!("halcmd cannot be started: {error}")))?;
    Ok(Some(status::parse(&String::from_utf8_lossy(&shown.stdout))))
}

fn is_running() -> bool {
    let names = fs::read_dir("/proc").into_iter().flatten().flatten();
    names.map(|entry| entry.path().join("comm")).any(|path| {
        fs::read_to_string(path)
            .is_ok_and(|name| name.trim() == "rtapi_app" || name.starts_with("rtapi:"))
    })
}
