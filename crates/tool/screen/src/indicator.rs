//! A gauge that sends its readings over a serial line: a Mitutoyo Digimatic adapter
//! (`01A+00012.345`), or one value a line, with or without its unit.

use std::{
    io::{self, BufReader, Read},
    net::TcpStream,
    sync::mpsc::{self, Receiver, Sender},
    thread,
    time::Duration,
};

/// Before a line that broke is opened again.
const RECONNECT_DELAY: Duration = Duration::from_secs(1);
/// A line of this many characters or more is not a reading.
const READING_LENGTH_LIMIT: usize = 80;

/// The unit in which a gauge counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum IndicatorUnit {
    /// mm.
    Millimetre,
    /// µm.
    Micrometre,
    /// 25.4 mm.
    Inch,
}

impl IndicatorUnit {
    /// µm in one of it.
    #[must_use]
    pub(crate) const fn micrometres_per_unit(self) -> f64 {
        match self {
            Self::Millimetre => 1_000.0,
            Self::Micrometre => 1.0,
            Self::Inch => 25_400.0,
        }
    }

    /// Returns the unit that is written so.
    #[must_use]
    pub fn parse(text: &str) -> Option<Self> {
        match text.to_ascii_lowercase().as_str() {
            "mm" => Some(Self::Millimetre),
            "um" | "µm" | "μm" => Some(Self::Micrometre),
            "in" | "inch" | "\"" => Some(Self::Inch),
            _ => None,
        }
    }
}

/// Where a gauge is, and what its numbers mean.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct IndicatorConfig {
    /// A serial device, or `tcp:HOST:PORT`.
    pub port: String,
    /// Of the serial device.
    pub baud: u32,
    /// Of a value that has none of its own.
    pub unit: IndicatorUnit,
}

/// A reading in µm, or why there is none.
pub type IndicatorResult = Result<f64, String>;

impl IndicatorConfig {
    /// Listens until the receiver is dropped.
    #[must_use]
    pub fn listen(self) -> Receiver<IndicatorResult> {
        let (sender, received) = mpsc::channel();
        thread::spawn(move || {
            loop {
                let why = match self.open_port() {
                    Ok(line) => match self.forward_readings(line, &sender) {
                        Some(why) => why,
                        None => return,
                    },
                    Err(error) => error.to_string(),
                };
                if sender.send(Err(format!("indicator {}: {why}", self.port))).is_err() {
                    return;
                }
                thread::sleep(RECONNECT_DELAY);
            }
        });
        received
    }

    fn open_port(&self) -> io::Result<Box<dyn Read + Send>> {
        Ok(match self.port.strip_prefix("tcp:") {
            Some(address) => Box::new(TcpStream::connect(address)?),
            // A day: who reads a gauge by hand may take his time.
            None => serialport::new(&self.port, self.baud)
                .timeout(Duration::from_secs(86_400))
                .open()
                .map(Box::new)?,
        })
    }

    /// Reads until the line ends, and says why; `None`: the receiver is gone.
    fn forward_readings(
        &self,
        line: Box<dyn Read + Send>,
        sender: &Sender<IndicatorResult>,
    ) -> Option<String> {
        let mut reader = BufReader::new(line);
        let mut bytes = Vec::new();
        loop {
            bytes.clear();
            match read_until_line_end(&mut reader, &mut bytes) {
                Ok(0) => return Some("it has closed the line".into()),
                Ok(_) => {
                    let text = String::from_utf8_lossy(&bytes);
                    if let Some(received) = parse_reading(&text, self.unit)
                        && sender.send(received).is_err()
                    {
                        return None;
                    }
                }
                Err(error) => return Some(error.to_string()),
            }
        }
    }
}

/// A reading has a few digits.
const MAX_LINE_BYTES: usize = 4_096;

/// Reads a line, which CR or LF ends. Returns how many bytes were taken.
fn read_until_line_end(reader: &mut impl io::BufRead, line: &mut Vec<u8>) -> io::Result<usize> {
    let mut taken = 0;
    loop {
        let buffer = reader.fill_buf()?;
        if buffer.is_empty() {
            return Ok(taken);
        }
        if line.len() > MAX_LINE_BYTES {
            return Err(io::Error::other(
                "it sends no end of a line; is this the gauge, at this speed?",
            ));
        }
        let end = buffer.iter().position(|byte| matches!(byte, b'\r' | b'\n'));
        let length = end.map_or(buffer.len(), |end| end + 1);
        let room = READING_LENGTH_LIMIT.saturating_sub(line.len()).min(end.unwrap_or(length));
        line.extend_from_slice(&buffer[..room]);
        reader.consume(length);
        taken += length;
        if end.is_some() {
            return Ok(taken);
        }
    }
}

/// Returns what a line says, in µm; `None`: it is empty.
#[must_use]
pub(crate) fn parse_reading(line: &str, unit: IndicatorUnit) -> Option<IndicatorResult> {
    if line.len() >= READING_LENGTH_LIMIT {
        return Some(Err(format!(
            "a line of {READING_LENGTH_LIMIT} characters and more is not a reading"
        )));
    }
    let line = line.trim();
    if line.is_empty() {
        return None;
    }
    let refused = |why: &str| Some(Err(format!("\"{line}\": {why}")));
    // Digimatic: two digits of the channel, and A before the value.
    let value = match line.split_once('A') {
        Some((channel, value))
            if channel.len() == 2 && channel.bytes().all(|byte| byte.is_ascii_digit()) =>
        {
            value
        }
        _ => line,
    };
    if value.contains(',') {
        return refused("a decimal point, not a comma");
    }
    let end = value.find(|character: char| !matches!(character, '0'..='9' | '+' | '-' | '.' | ' '));
    let (number, name) = value.split_at(end.unwrap_or(value.len()));
    let unit = match name.trim() {
        "" => unit,
        name => match IndicatorUnit::parse(name) {
            Some(unit) => unit,
            None => return refused("not a reading"),
        },
    };
    let number: String = number.chars().filter(|character| *character != ' ').collect();
    match number.parse::<f64>() {
        Ok(number) => Some(Ok(number * unit.micrometres_per_unit())),
        Err(_) => refused("not a reading"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::{io::Write as _, net::TcpListener};

    #[test]
    fn digimatic_and_plain_values_are_read_in_their_unit() {
        for (line, unit, um) in [
            ("01A+00012.345", IndicatorUnit::Millimetre, 12_345.0),
            ("02A-00000.0005", IndicatorUnit::Inch, -12.7),
            ("0.012", IndicatorUnit::Millimetre, 12.0),
            ("+ 3.5", IndicatorUnit::Micrometre, 3.5),
            ("-0.004 mm", IndicatorUnit::Inch, -4.0),
            ("12.5 µm", IndicatorUnit::Millimetre, 12.5),
        ] {
            let received = parse_reading(line, unit).expect(line).expect(line);
            assert!((received - um).abs() < 1e-9, "{line}: {received}");
        }
        assert_eq!(parse_reading(" \r", IndicatorUnit::Millimetre), None);
    }

    #[test]
    fn what_is_no_reading_is_refused_and_reported() {
        for line in ["0,012", "err", "1.2.3", "A12", "01A", "12 bar", "--1", "911A"] {
            let received = parse_reading(line, IndicatorUnit::Millimetre).expect(line);
            assert!(received.as_ref().is_err_and(|why| why.contains(line)), "{line}: {received:?}");
        }
    }

    #[test]
    fn it_listens_line_by_line_and_says_when_the_line_is_gone() {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
        let port = format!("tcp:{}", listener.local_addr().expect("bound"));
        let received =
            IndicatorConfig { port, baud: 9_600, unit: IndicatorUnit::Millimetre }.listen();
        let (mut gauge, _) = listener.accept().expect("it connects");
        gauge.write_all(b"0.001\r\n01A+0.0025\r").expect("open");
        gauge.write_all(&[b'9'; 500]).expect("open");
        gauge.write_all(b"\n").expect("open");
        drop((gauge, listener));
        let next = || received.recv_timeout(Duration::from_secs(5)).expect("something");
        assert_eq!((next(), next()), (Ok(1.0), Ok(2.5)));
        assert!(next().is_err_and(|why| why.contains("80 characters")));
        assert!(next().is_err_and(|why| why.contains("closed the line")));
    }
}
