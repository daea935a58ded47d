//! The ports of this computer behind which a bridge may be.

use std::{fs, path::Path};

/// The type of a CAN interface in `/sys/class/net/*/type` (ARPHRD_CAN of Linux).
const ARPHRD_CAN: &str = "280";

/// Where Linux lists its serial devices.
const TTY_CLASS_PATH: &str = "/sys/class/tty";

/// A port that is here.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PortInfo {
    /// As `--port` takes it.
    pub name: String,
    /// The system's description of it; empty: none.
    pub what: String,
    /// Why it cannot be opened; `None`: it can.
    pub obstacle: Option<String>,
}

/// Returns the serial devices and CAN interfaces of this computer. None is opened for longer than a moment.
#[must_use]
pub fn list_ports() -> Vec<PortInfo> {
    // Without `/sys`, as in a container or a bare root, the crate would panic.
    let can_look = !cfg!(target_os = "linux") || Path::new(TTY_CLASS_PATH).is_dir();
    let found = can_look.then(|| serialport::available_ports().unwrap_or_default());
    let serial = found.unwrap_or_default().into_iter().map(|port| {
        let what = match port.port_type {
            serialport::SerialPortType::UsbPort(usb) => {
                let names = [usb.manufacturer, usb.product].into_iter().flatten();
                format!("USB {}", names.collect::<Vec<_>>().join(" ")).trim_end().to_string()
            }
            _ => String::new(),
        };
        let obstacle = find_access_obstacle(Path::new(&port.port_name));
        PortInfo { name: port.port_name, what, obstacle }
    });
    let mut ports: Vec<PortInfo> = serial.collect();
    ports.extend(list_can_interfaces(Path::new("/sys/class/net")));
    ports.sort_by(|a, b| a.name.cmp(&b.name));
    ports
}

/// Why a device cannot be opened by this user.
fn find_access_obstacle(device: &Path) -> Option<String> {
    let error = fs::OpenOptions::new().read(true).write(true).open(device).err()?;
    Some(match error.kind() {
        std::io::ErrorKind::PermissionDenied => {
            "permission denied: sudo adduser $USER dialout, and log in anew".into()
        }
        _ => error.to_string(),
    })
}

/// Returns the CAN interfaces in a folder like `/sys/class/net`.
fn list_can_interfaces(folder: &Path) -> Vec<PortInfo> {
    let Ok(entries) = fs::read_dir(folder) else { return Vec::new() };
    let read = |path: &Path, name: &str| fs::read_to_string(path.join(name)).unwrap_or_default();
    let interfaces = entries.flatten().filter_map(|entry| {
        let path = entry.path();
        (read(&path, "type").trim() == ARPHRD_CAN).then(|| {
            let is_up = read(&path, "operstate").trim() != "down";
            let name = entry.file_name().to_string_lossy().into_owned();
            let up = format!("it is down: sudo ip link set {name} up type can bitrate 1000000");
            PortInfo { name, what: "CAN".into(), obstacle: (!is_up).then_some(up) }
        })
    });
    interfaces.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn can_interfaces_are_those_of_their_type_and_one_that_is_down_says_how_to_put_it_up() {
        let folder = tempfile::tempdir().expect("a folder");
        for (name, kind, state) in
            [("can0", "280", "up"), ("can1", "280", "down"), ("eth0", "1", "up")]
        {
            let path = folder.path().join(name);
            fs::create_dir(&path).expect("made");
            fs::write(path.join("type"), format!("{kind}\n")).expect("written");
            fs::write(path.join("operstate"), format!("{state}\n")).expect("written");
        }
        let mut found = list_can_interfaces(folder.path());
        found.sort_by(|a, b| a.name.cmp(&b.name));
        let names: Vec<&str> = found.iter().map(|port| port.name.as_str()).collect();
        assert_eq!(names, ["can0", "can1"]);
        assert_eq!(found[0].obstacle, None);
        assert!(
            found[1]
                .obstacle
                .as_ref()
                .is_some_and(|obstacle| obstacle.contains("ip link set can1 up"))
        );
    }

    #[test]
    fn a_device_that_may_not_be_opened_has_an_obstacle() {
        assert!(find_access_obstacle(Path::new("/no/such/device")).is_some());
        let file = tempfile::NamedTempFile::new().expect("a file");
        assert_eq!(find_access_obstacle(file.path()), None);
    }
}
