//! Which program of this computer holds a bridge's line: a bridge serves one at a time, and the second one should know
//! whom to end. Linux alone says so (`/proc`), and of programs of other users only to root.

use std::{
    fs,
    net::ToSocketAddrs as _,
    path::{Path, PathBuf},
};

use trueup_output::escape::escape_line;

use crate::port::PortAddress;

/// The state of a connection in `/proc/net/tcp` that stands.
const TCP_ESTABLISHED: &str = "01";
/// The longest command line that is shown.
const MAX_COMMAND_LINE_CHARS: usize = 60;

/// Returns the other program that holds the line to `port`: its command line and its number; `None`: none is known.
#[must_use]
pub fn port_holder(port: &PortAddress) -> Option<String> {
    let targets: Vec<PathBuf> = match port {
        PortAddress::Serial(device) => vec![fs::canonicalize(device).ok()?],
        PortAddress::Tcp(address) => {
            let server = address
                .to_socket_addrs()
                .ok()?
                .find(|endpoint| endpoint.ip().is_loopback())?
                .port();
            let tables = ["/proc/net/tcp", "/proc/net/tcp6"];
            let tables = tables.iter().filter_map(|path| fs::read_to_string(path).ok());
            tables.flat_map(|table| find_client_sockets(&table, server)).collect()
        }
        #[cfg(all(feature = "socketcan", target_os = "linux"))]
        PortAddress::Can(_) => return None,
    };
    let mut processes: Vec<u32> = fs::read_dir("/proc")
        .ok()?
        .filter_map(|entry| entry.ok()?.file_name().to_str()?.parse().ok())
        .filter(|process| *process != std::process::id())
        .collect();
    processes.sort_unstable();
    processes.into_iter().find(|process| has_open_file(*process, &targets)).map(|process| {
        let command = fs::read(format!("/proc/{process}/cmdline")).unwrap_or_default();
        let command = String::from_utf8_lossy(&command).replace('\0', " ");
        // The folder of the program says nothing.
        let name = |path: &str| path.rsplit('/').next().unwrap_or_default().to_owned();
        let command = match command.split_once(' ') {
            Some((program, rest)) => format!("{} {rest}", name(program)),
            None => name(&command),
        };
        let command: String =
            escape_line(command.trim()).chars().take(MAX_COMMAND_LINE_CHARS).collect();
        format!("{command} (process {process})")
    })
}

/// Returns whether a process has one of these open.
fn has_open_file(process: u32, targets: &[PathBuf]) -> bool {
    let Ok(files) = fs::read_dir(format!("/proc/{process}/fd")) else { return false };
    files
        .flatten()
        .filter_map(|file| fs::read_link(file.path()).ok())
        .any(|target| targets.contains(&target))
}

/// Returns the sockets of the clients of a server, as the files of a process are called, in a table like
/// `/proc/net/tcp`.
fn find_client_sockets(table: &str, server: u16) -> Vec<PathBuf> {
    let port_of = |address: &str| u16::from_str_radix(address.rsplit_once(':')?.1, 16).ok();
    let sockets = table.lines().skip(1).filter_map(|line| {
        let mut fields = line.split_whitespace().skip(2);
        let (remote, state) = (fields.next()?, fields.next()?);
        let inode = fields.nth(5)?;
        (state == TCP_ESTABLISHED && port_of(remote)? == server)
            .then(|| Path::new(&format!("socket:[{inode}]")).to_path_buf())
    });
    sockets.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_client_is_found_by_the_port_of_its_server() {
        let table = "  sl  local_address rem_address   st tx_queue rx_queue tr tm->when retrnsmt   uid  timeout inode\n   \
            0: 0100007F:0D05 00000000:0000 0A 00000000:00000000 00:00000000 00000000     0        0 111 1 0\n   \
            1: 0100007F:B0F6 0100007F:0D05 01 00000000:00000000 00:00000000 00000000     0        0 222 1 0\n   \
            2: 0100007F:0D05 0100007F:B0F6 01 00000000:00000000 00:00000000 00000000     0        0 333 1 0\n   \
            3: 0100007F:B0F8 0100007F:0D05 06 00000000:00000000 00:00000000 00000000     0        0 0 1 0\n";
        assert_eq!(find_client_sockets(table, 3333), [Path::new("socket:[222]")]);
        assert!(find_client_sockets(table, 3334).is_empty());
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn another_program_on_the_line_is_named() {
        use std::{io::Read as _, net::TcpListener, process};
        let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
        let number = listener.local_addr().expect("bound").port();
        let port = PortAddress::Tcp(format!("localhost:{number}"));
        // This process itself is not another holder.
        let own = std::net::TcpStream::connect(("127.0.0.1", number)).expect("it listens");
        listener.accept().expect("connected");
        assert_eq!(port_holder(&port), None);
        drop(own);
        let script = format!("exec 3<>/dev/tcp/127.0.0.1/{number}; echo x >&3; read -u 3 line");
        let mut other = process::Command::new("bash").args(["-c", &script]).spawn().expect("bash");
        let (mut stream, _) = listener.accept().expect("it connects");
        stream.read_exact(&mut [0]).expect("it has written");
        let named = port_holder(&port).expect("it is found");
        drop(stream);
        other.wait().expect("it ends");
        assert!(named.starts_with("bash -c exec 3<>/dev/tcp"), "{named}");
        assert!(named.ends_with(&format!("(process {})", other.id())), "{named}");
    }
}
