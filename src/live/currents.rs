//! Coil currents as they come: datagrams, a serial line, or a table that another program writes.
//!
//! A sample is one line: JSON (`{"current_a":[0.1,0,-0.1],"seq":7,"host_ns":1700000000123456789}`, the last two
//! optional) or bare numbers (`0.1, 0, -0.1`), amperes. A sample without `host_ns` has the time of its arrival. The
//! table has a header with `host_ns` (nanoseconds since 1970) or `unix_s` and one column a coil, and is followed as it
//! grows. With `t_s` instead, as `catoptra excite` writes it, times count from the beginning of the run, and each row
//! is a sample when its time has come: for an amplifier that is started together with the run.
//!
//! A line that is no sample is counted and the first of them is named; nothing here can hold up or end a run.

use crate::sink::CurrentSample;
use crate::source::host::HostClock;
use crate::source::times::parse_seconds_ns;
use serde::Deserialize;
use std::fmt;
use std::fs::File;
use std::io::{self, BufRead, BufReader, ErrorKind, Read};
use std::net::UdpSocket;
use std::path::PathBuf;
use std::str::FromStr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::Builder;
use std::time::Duration;

/// Samples that may wait to be logged.
const MOST_WAITING: usize = 4096;
/// How often a silent source looks whether the run has ended.
const LOOK: Duration = Duration::from_millis(100);
/// Coils at most; more in a line is no sample.
const MOST_COILS: usize = 64;
/// Speed of a serial line when none is given.
const BAUD: u32 = 115_200;

/// Where currents come from: `udp:PORT`, `serial:DEVICE[@BAUD]`, `file:TABLE.csv`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum CurrentSource {
    /// Datagrams to this port.
    Udp(u16),
    /// Lines on a serial device, at so many baud.
    Serial(PathBuf, u32),
    /// A table that grows.
    File(PathBuf),
}

impl FromStr for CurrentSource {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = |what: &str| Err(format!("`{text}`: {what}; write udp:PORT, serial:DEVICE@BAUD or file:TABLE.csv"));
        match text.split_once(':') {
            Some(("udp", port)) => match port.parse() {
                Ok(port) => Ok(Self::Udp(port)),
                Err(_) => wrong("the port is a number from 0 to 65535"),
            },
            Some(("serial", device)) if !device.is_empty() => match device.split_once('@') {
                None => Ok(Self::Serial(device.into(), BAUD)),
                Some((device, baud)) => match baud.parse() {
                    Ok(baud) => Ok(Self::Serial(device.into(), baud)),
                    Err(_) => wrong("the speed of the line is a whole number, as 115200"),
                },
            },
            Some(("file", table)) if !table.is_empty() => Ok(Self::File(table.into())),
            _ => wrong("no source of currents"),
        }
    }
}

impl fmt::Display for CurrentSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Udp(port) => write!(f, "udp:{port}"),
            Self::Serial(device, baud) => write!(f, "serial:{}@{baud}", device.display()),
            Self::File(table) => write!(f, "file:{}", table.display()),
        }
    }
}

impl CurrentSource {
    /// Begins to listen; samples come out until `stop` is set.
    ///
    /// # Errors
    /// When the port is taken, or device or table cannot be opened.
    pub fn open(&self, clock: HostClock, stop: &Arc<AtomicBool>) -> io::Result<Receiver<CurrentSample>> {
        let (samples, line) = sync_channel(MOST_WAITING);
        let mut taker = Taker { name: self.to_string(), clock, samples, header: None, wrong: 0, full: 0 };
        let stop = Arc::clone(stop);
        let thread = Builder::new().name("currents in".to_owned());
        match self {
            Self::Udp(port) => {
                let socket = UdpSocket::bind(("0.0.0.0", *port))?;
                socket.set_read_timeout(Some(LOOK))?;
                thread.spawn(move || taker.datagrams(&socket, &stop))?;
            }
            Self::Serial(device, baud) => {
                let line = serial(device, *baud)?;
                thread.spawn(move || taker.lines(line, &stop))?;
            }
            Self::File(table) => {
                let mut reader = BufReader::new(File::open(table)?);
                let mut header = String::new();
                reader.read_line(&mut header)?;
                taker.header = Some(Header::of(&header).map_err(io::Error::other)?);
                thread.spawn(move || taker.lines(reader, &stop))?;
            }
        }
        Ok(line)
    }
}

/// A serial device at this speed, bytes as they come.
#[cfg(unix)]
fn serial(device: &std::path::Path, baud: u32) -> io::Result<File> {
    use rustix::termios::{OptionalActions, SpecialCodeIndex, tcgetattr, tcsetattr};
    let line = File::options().read(true).write(true).open(device)?;
    let mut settings = tcgetattr(&line)?;
    settings.make_raw();
    settings.set_speed(baud)?;
    // A read returns after a tenth of a second without a byte.
    settings.special_codes[SpecialCodeIndex::VMIN] = 0;
    settings.special_codes[SpecialCodeIndex::VTIME] = 1;
    tcsetattr(&line, OptionalActions::Now, &settings)?;
    Ok(line)
}

#[cfg(not(unix))]
fn serial(_: &std::path::Path, _: u32) -> io::Result<File> {
    Err(io::Error::other("serial lines are read on Linux and macOS only; send datagrams (udp:PORT) instead"))
}

/// What the times of a table are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Times {
    HostNs,
    UnixSeconds,
    /// Seconds since the run began.
    RunSeconds,
}

/// Which columns a table has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Header {
    time: usize,
    times: Times,
}

impl Header {
    fn of(line: &str) -> Result<Self, String> {
        let columns: Vec<&str> = line.trim().split(',').map(str::trim).collect();
        let at = |name: &str| columns.iter().position(|column| *column == name);
        let known = [("host_ns", Times::HostNs), ("unix_s", Times::UnixSeconds), ("t_s", Times::RunSeconds)];
        known.into_iter().find_map(|(name, times)| Some(Self { time: at(name)?, times })).ok_or_else(|| {
            format!(
                "the header `{}` has no column host_ns (nanoseconds since 1970), unix_s (seconds since 1970) or t_s (seconds since the run began)",
                line.trim()
            )
        })
    }
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Json {
    current_a: Vec<f64>,
    seq: Option<u64>,
    host_ns: Option<i64>,
}

/// Turns lines into samples.
struct Taker {
    name: String,
    clock: HostClock,
    samples: SyncSender<CurrentSample>,
    header: Option<Header>,
    wrong: u64,
    full: u64,
}

impl Taker {
    fn datagrams(&mut self, socket: &UdpSocket, stop: &AtomicBool) {
        let mut bytes = [0; 65_536];
        while !stop.load(Ordering::Relaxed) {
            match socket.recv(&mut bytes) {
                Ok(length) => self.take(bytes.get(..length).unwrap_or_default()),
                Err(e) if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted) => {}
                Err(error) => return tracing::error!("{}: {error}; no more currents are logged", self.name),
            }
        }
    }

    /// Reads lines; at the end of what there is it waits for more.
    fn lines(&mut self, mut from: impl Read, stop: &AtomicBool) {
        let (mut bytes, mut line) = ([0; 4096], Vec::new());
        while !stop.load(Ordering::Relaxed) {
            match from.read(&mut bytes) {
                Ok(0) => std::thread::sleep(LOOK),
                Ok(length) => {
                    for &byte in bytes.iter().take(length) {
                        match byte {
                            b'\n' | b'\r' => {
                                if !line.is_empty() && self.has_come(&line, stop) {
                                    self.take(&line);
                                }
                                line.clear();
                            }
                            // What is longer is no line of ours; what is kept of it will be refused.
                            _ if line.len() < bytes.len() => line.push(byte),
                            _ => {}
                        }
                    }
                }
                Err(e) if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => {}
                Err(error) => return tracing::error!("{}: {error}; no more currents are logged", self.name),
            }
        }
    }

    /// Waits for the time of a row of a table that is counted from the beginning of the run; `false` when the run ends
    /// before.
    fn has_come(&self, bytes: &[u8], stop: &AtomicBool) -> bool {
        let Some(Header { times: Times::RunSeconds, .. }) = self.header else { return true };
        let Some(sample) = self.sample(bytes, 0) else { return true };
        while !stop.load(Ordering::Relaxed) {
            let left_ns = u64::try_from(sample.host_ns.saturating_sub(self.clock.now_ns())).unwrap_or(0);
            if left_ns == 0 {
                return true;
            }
            std::thread::sleep(LOOK.min(Duration::from_nanos(left_ns)));
        }
        false
    }

    fn take(&mut self, bytes: &[u8]) {
        let arrival_ns = self.clock.now_ns();
        match self.sample(bytes, arrival_ns) {
            Some(sample) => {
                if self.samples.try_send(sample).is_err() {
                    self.full += 1;
                    if self.full == 1 {
                        tracing::warn!("{}: currents come faster than they are logged; some are lost", self.name);
                    }
                }
            }
            None => {
                self.wrong += 1;
                if self.wrong == 1 {
                    let said = String::from_utf8_lossy(bytes.get(..bytes.len().min(60)).unwrap_or_default());
                    tracing::warn!(
                        "{}: `{}` is no sample of currents; expected {{\"current_a\":[0.1,0]}} or 0.1, 0; more are counted",
                        self.name,
                        said.escape_debug()
                    );
                }
            }
        }
    }

    fn sample(&self, bytes: &[u8], arrival_ns: i64) -> Option<CurrentSample> {
        let text = std::str::from_utf8(bytes).ok()?.trim();
        let sample = match (self.header, text.starts_with('{')) {
            (None, true) => {
                let Json { current_a, seq, host_ns } = serde_json::from_str(text).ok()?;
                CurrentSample { host_ns: host_ns.unwrap_or(arrival_ns), arrival_ns, seq, current_a }
            }
            (None, false) => {
                let numbers = text.split([',', ';', ' ', '\t']).filter(|cell| !cell.is_empty());
                let current_a = numbers.map(|cell| cell.parse().ok()).collect::<Option<_>>()?;
                CurrentSample { host_ns: arrival_ns, arrival_ns, seq: None, current_a }
            }
            (Some(header), _) => {
                let cells: Vec<&str> = text.split(',').map(str::trim).collect();
                let time = cells.get(header.time)?;
                let host_ns = match header.times {
                    Times::HostNs => time.parse().ok()?,
                    Times::UnixSeconds => parse_seconds_ns(time)?,
                    Times::RunSeconds => self.clock.started_ns().saturating_add(parse_seconds_ns(time)?),
                };
                let currents = cells.iter().enumerate().filter(|(column, _)| *column != header.time);
                let current_a = currents.map(|(_, cell)| cell.parse().ok()).collect::<Option<_>>()?;
                CurrentSample { host_ns, arrival_ns, seq: None, current_a }
            }
        };
        let sound =
            (1..=MOST_COILS).contains(&sample.current_a.len()) && sample.current_a.iter().all(|a| a.is_finite());
        sound.then_some(sample)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write as _;

    fn taker(header: Option<Header>) -> (Taker, Receiver<CurrentSample>) {
        let (samples, line) = sync_channel(16);
        let clock = HostClock::start();
        (Taker { name: "test".to_owned(), clock, samples, header, wrong: 0, full: 0 }, line)
    }

    #[test]
    fn samples_as_json_and_as_bare_numbers() {
        let (taker, _line) = taker(None);
        let of = |text: &str| taker.sample(text.as_bytes(), 99);
        let full = of(r#"{"current_a":[0.1,-0.2],"seq":7,"host_ns":5}"#).unwrap();
        assert_eq!(full, CurrentSample { host_ns: 5, arrival_ns: 99, seq: Some(7), current_a: vec![0.1, -0.2] });
        let bare = of(" 0.1, 0 -3e-2\n").unwrap();
        assert_eq!(bare, CurrentSample { host_ns: 99, arrival_ns: 99, seq: None, current_a: vec![0.1, 0.0, -0.03] });
    }

    #[test]
    fn what_is_no_sample_is_counted_and_the_rest_goes_on() {
        let (mut taker, line) = taker(None);
        let many = vec!["0"; 65].join(",");
        for wrong in ["", "amps", "0.1, NaN", "inf", "{\"current_a\":[]}", "{\"amps\":[1]}", "{", "1,,x", &many] {
            taker.take(wrong.as_bytes());
        }
        taker.take(&[0xff, 0xfe, 0x00]);
        assert_eq!(taker.wrong, 10);
        taker.take(b"0.5");
        assert_eq!(line.try_recv().unwrap().current_a, [0.5]);
        assert!(line.try_recv().is_err());
    }

    #[test]
    fn a_table_is_followed_as_it_grows() {
        let mut table = tempfile::NamedTempFile::new().unwrap();
        table.write_all(b"host_ns,i1_a,i2_a\n1000,0.1,0.2\n20").unwrap();
        let stop = Arc::new(AtomicBool::new(false));
        let source = CurrentSource::File(table.path().to_owned());
        let samples = source.open(HostClock::start(), &stop).unwrap();
        let next = || samples.recv_timeout(Duration::from_secs(10)).unwrap();
        let first = next();
        assert_eq!((first.host_ns, first.current_a), (1000, vec![0.1, 0.2]));
        table.write_all(b"00,0.3,0.4\r\nnonsense\n3000,0.5,0.6\n").unwrap();
        assert_eq!((next().host_ns, next().host_ns), (2000, 3000));
        stop.store(true, Ordering::Relaxed);
    }

    #[test]
    fn a_table_without_times_is_refused() {
        let mut table = tempfile::NamedTempFile::new().unwrap();
        table.write_all(b"i1,i2\n0.1,0.2\n").unwrap();
        let source = CurrentSource::File(table.path().to_owned());
        let error = source.open(HostClock::start(), &Arc::default()).unwrap_err().to_string();
        assert!(error.contains("`i1,i2`") && error.contains("host_ns"), "{error}");
        assert_eq!(Header::of("unix_s, i1"), Ok(Header { time: 0, times: Times::UnixSeconds }));
    }

    #[test]
    fn a_table_of_excitation_is_logged_as_its_times_come() {
        let mut table = tempfile::NamedTempFile::new().unwrap();
        table.write_all(b"t_s,current_a\r\n0.000000000,0.1\r\n0.400000000,0.2\r\n3600.000000000,0.3\r\n").unwrap();
        let stop = Arc::new(AtomicBool::new(false));
        let clock = HostClock::start();
        let samples = CurrentSource::File(table.path().to_owned()).open(clock, &stop).unwrap();
        let next = || samples.recv_timeout(Duration::from_secs(10)).unwrap();
        let (first, second) = (next(), next());
        assert_eq!((first.host_ns, second.host_ns), (clock.started_ns(), clock.started_ns() + 400_000_000));
        assert!(second.arrival_ns >= second.host_ns && second.current_a == [0.2]);
        stop.store(true, Ordering::Relaxed);
        // The row whose time has not come is no sample, and holds nothing up.
        assert!(samples.recv_timeout(Duration::from_secs(10)).is_err());
    }

    #[test]
    fn datagrams_are_taken_whatever_comes_between() {
        let stop = Arc::new(AtomicBool::new(false));
        let probe = UdpSocket::bind("127.0.0.1:0").unwrap();
        let port = UdpSocket::bind("0.0.0.0:0").unwrap().local_addr().unwrap().port();
        let samples = CurrentSource::Udp(port).open(HostClock::start(), &stop).unwrap();
        for bytes in [b"garbage".as_slice(), b"", &[0; 60_000], b"0.25, -0.25"] {
            probe.send_to(bytes, ("127.0.0.1", port)).unwrap();
        }
        assert_eq!(samples.recv_timeout(Duration::from_secs(10)).unwrap().current_a, [0.25, -0.25]);
        stop.store(true, Ordering::Relaxed);
    }

    #[test]
    fn sources_as_people_write_them() {
        assert_eq!("udp:5006".parse(), Ok(CurrentSource::Udp(5006)));
        assert_eq!("serial:/dev/ttyUSB0".parse(), Ok(CurrentSource::Serial("/dev/ttyUSB0".into(), 115_200)));
        assert_eq!("serial:/dev/ttyACM0@9600".parse(), Ok(CurrentSource::Serial("/dev/ttyACM0".into(), 9600)));
        assert_eq!("file:i.csv".parse(), Ok(CurrentSource::File("i.csv".into())));
        for wrong in ["udp:70000", "udp", "serial:", "serial:/dev/x@fast", "tcp:5", "i.csv"] {
            assert!(wrong.parse::<CurrentSource>().unwrap_err().contains("udp:PORT"), "{wrong}");
        }
    }
}
