//! Coil currents as they come: datagrams, a serial line, or a table that another program writes.
//!
//! A sample is one line: JSON (`{"current_a":[0.1,0,-0.1],"seq":7,"host_ns":1700000000123456789}`, the last two
//! optional) or bare numbers (`0.1, 0, -0.1`), amperes. A sample without `host_ns` has the time of its arrival. The
//! table has a header with `host_ns` (nanoseconds since 1970) or `unix_s` and one column per coil, and is followed as
//! it grows. With `t_s` instead, as `catoptra excite` writes it, times count from the beginning of the run, and each
//! row is a sample when its time has come: for an amplifier that is started together with the run. So it is with the
//! `.play` lists of the laboratory's amplifier.
//!
//! From ROS 2 comes a `sensor_msgs/JointState`: the effort of each joint is the current of a coil, and the stamp,
//! unless it is 0, the host's time.
//!
//! A line that is no sample is counted and the first of them is named; nothing here can hold up or end a run. A
//! source that fails is told, and the run has failed at its end.
//!
//! A serial device is mostly opened while it sends: bare numbers whose beginning was not seen (`5, 0.3` of `-0.125,
//! 0.3`) would be a wrong current, and are left out.

mod bursts;
mod datagrams;
mod delays;
mod followed;
mod parser;
mod sample;
mod senders;
#[cfg(unix)]
mod serial;
mod whole_numbers;

pub(crate) use parser::currents_of;

use super::listener::Listener;
use crate::sink::CurrentSample;
use crate::source::host::HostClock;
use datagrams::Datagrams;
use followed::Followed;
use parser::{Parser, Start};
use std::fmt;
use std::io::{self, Cursor};
use std::net::{Ipv4Addr, SocketAddr, ToSocketAddrs as _};
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::sync::mpsc::{Receiver, sync_channel};
use std::thread::Builder;
use std::time::Duration;
use tracing::Span;

/// Samples that may wait to be logged.
const MAX_WAITING: usize = 4096;
/// How often a silent source looks whether the run has ended.
const STOP_POLL_INTERVAL: Duration = Duration::from_millis(100);
/// How often it is looked whether a message has come.
const POLL_INTERVAL: Duration = Duration::from_millis(2);
/// Speed of a serial line when none is given.
const BAUD: u32 = 115_200;

/// Where currents come from: `udp:PORT` or `udp:HOST:PORT`, `serial:DEVICE[@BAUD]`, `file:TABLE.csv`, `ros2:/TOPIC`,
/// `LIST.play`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum CurrentSource {
    /// Datagrams to this address of this computer.
    Udp(SocketAddr),
    /// Lines on a serial device, at so many baud.
    Serial(PathBuf, u32),
    /// A table that grows.
    File(PathBuf),
    /// A list of the laboratory's amplifier.
    Play {
        /// The file.
        list: PathBuf,
        /// Its rows as a table with `t_s`, put here by whoever has read it.
        table: String,
    },
    /// A topic of ROS 2.
    Ros2 {
        /// Its whole name.
        topic: String,
        /// The domain it is in.
        domain: u16,
        /// Whether it may come from other computers.
        everywhere: bool,
    },
}

impl FromStr for CurrentSource {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = |what: &str| {
            let forms = "udp:PORT, udp:HOST:PORT, serial:DEVICE@BAUD, file:TABLE.csv, LIST.play or ros2:/TOPIC";
            Err(format!("`{text}`: {what}; write {forms}"))
        };
        let list = Path::new(text.strip_prefix("file:").unwrap_or(text));
        if list.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("play")) {
            return Ok(Self::Play { list: list.to_owned(), table: String::new() });
        }
        match text.split_once(':') {
            // Other computers can send only to an address that is named.
            Some(("udp", place)) => {
                let here = place.parse().ok().map(|port: u16| SocketAddr::from((Ipv4Addr::LOCALHOST, port)));
                let named = || place.to_socket_addrs().ok().and_then(|mut found| found.next());
                match here.or_else(named).filter(|address| address.port() != 0) {
                    Some(address) => Ok(Self::Udp(address)),
                    None => wrong("the port is a number from 1 to 65535, the host one of this computer's addresses"),
                }
            }
            Some(("serial", device)) if !device.is_empty() => match device.split_once('@') {
                None => Ok(Self::Serial(device.into(), BAUD)),
                Some((device, baud)) => match baud.parse() {
                    Ok(baud) => Ok(Self::Serial(device.into(), baud)),
                    Err(_) => wrong("the speed of the line is a whole number, such as 115200"),
                },
            },
            Some(("file", table)) if !table.is_empty() => Ok(Self::File(table.into())),
            Some(("ros2", topic)) if topic.len() > 1 && topic.starts_with('/') && !topic.ends_with('/') => {
                Ok(Self::Ros2 { topic: topic.to_owned(), domain: 0, everywhere: false })
            }
            Some(("ros2", _)) => wrong("the topic has its whole name, such as /coil/joint_states"),
            _ => wrong("no source of currents"),
        }
    }
}

impl fmt::Display for CurrentSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Udp(address) => write!(f, "udp:{address}"),
            Self::Serial(device, baud) => write!(f, "serial:{}@{baud}", device.display()),
            Self::File(table) => write!(f, "file:{}", table.display()),
            Self::Play { list, .. } => write!(f, "{}", list.display()),
            Self::Ros2 { topic, .. } => write!(f, "ros2:{topic}"),
        }
    }
}

/// Samples as they come.
#[derive(Debug)]
pub struct Currents {
    /// Until the source is stopped.
    pub samples: Receiver<CurrentSample>,
    /// Whether they can wait until they are logged: rows of a table can.
    pub wait: bool,
}

impl CurrentSource {
    /// Begins to listen; samples come out until `stop` is set.
    ///
    /// # Errors
    /// When the port is taken, or device or table cannot be opened.
    pub fn open(&self, limit_a: f64, clock: HostClock, stop: &Arc<AtomicBool>) -> io::Result<Currents> {
        let (sender, samples) = sync_channel(MAX_WAITING);
        let mut parser = Parser::new(self.to_string(), clock, sender, limit_a);
        let stop = Arc::clone(stop);
        let receive: Box<dyn FnOnce() + Send> = match self {
            Self::Udp(address) => {
                let mut datagrams = Datagrams::open(*address, STOP_POLL_INTERVAL, clock)?;
                Box::new(move || parser.datagrams(&mut datagrams, &stop))
            }
            Self::Serial(device, baud) => {
                let line = serial(device, *baud)?;
                // Short, because what comes meanwhile is stamped late.
                Box::new(move || parser.lines(line, Start::Anywhere, POLL_INTERVAL, &stop))
            }
            Self::File(table) => {
                let reader = parser.headed(Followed::open(table.clone())?)?;
                Box::new(move || parser.lines(reader, Start::OfLine, STOP_POLL_INTERVAL, &stop))
            }
            Self::Play { table, .. } => {
                let reader = parser.headed(Cursor::new(table.clone()))?;
                Box::new(move || parser.lines(reader, Start::OfLine, STOP_POLL_INTERVAL, &stop))
            }
            Self::Ros2 { topic, domain, everywhere } => {
                let mut listener = Listener::open(topic, *domain, *everywhere)?;
                Box::new(move || parser.messages(&mut listener, &stop))
            }
        };
        // Its warnings belong to the caller's span.
        let span = Span::current();
        Builder::new().name("currents in".to_owned()).spawn(move || span.in_scope(receive))?;
        Ok(Currents { samples, wait: matches!(self, Self::File(_) | Self::Play { .. }) })
    }
}

#[cfg(unix)]
fn serial(device: &Path, baud: u32) -> io::Result<serial::SerialLine> {
    serial::SerialLine::open(device, baud)
}

#[cfg(not(unix))]
fn serial(_: &Path, _: u32) -> io::Result<std::fs::File> {
    Err(io::Error::other("serial lines are read on Linux and macOS only; send datagrams (udp:PORT) instead"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::{ErrorKind, Write as _};
    use std::net::UdpSocket;
    use std::sync::atomic::Ordering;

    #[test]
    fn a_file_without_lines_is_not_read_whole() {
        let error =
            CurrentSource::File("/dev/zero".into()).open(10.0, HostClock::start(), &Arc::default()).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::InvalidData);
    }

    #[test]
    fn a_table_is_followed_as_it_grows() {
        let mut table = tempfile::NamedTempFile::new().unwrap();
        table.write_all(b"host_ns,i1_a,i2_a\n1000,0.1,0.2\n20").unwrap();
        let stop = Arc::new(AtomicBool::new(false));
        let source = CurrentSource::File(table.path().to_owned());
        let samples = source.open(10.0, HostClock::start(), &stop).unwrap().samples;
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
        let error = source.open(10.0, HostClock::start(), &Arc::default()).unwrap_err().to_string();
        assert!(error.contains("`i1,i2`") && error.contains("host_ns"), "{error}");
    }

    #[test]
    fn a_table_of_excitation_is_logged_as_its_times_come() {
        let mut table = tempfile::NamedTempFile::new().unwrap();
        table.write_all(b"t_s,current_a\r\n0.000000000,0.1\r\n0.400000000,0.2\r\n3600.000000000,0.3\r\n").unwrap();
        let stop = Arc::new(AtomicBool::new(false));
        let clock = HostClock::start();
        let samples = CurrentSource::File(table.path().to_owned()).open(10.0, clock, &stop).unwrap().samples;
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
        let port = UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
        let samples =
            CurrentSource::Udp(([127, 0, 0, 1], port).into()).open(10.0, HostClock::start(), &stop).unwrap().samples;
        for bytes in [b"garbage".as_slice(), b"", &[0; 60_000], b"0.25, -0.25"] {
            probe.send_to(bytes, ("127.0.0.1", port)).unwrap();
        }
        assert_eq!(samples.recv_timeout(Duration::from_secs(10)).unwrap().current_a, [0.25, -0.25]);
        stop.store(true, Ordering::Relaxed);
    }

    #[test]
    fn sources_as_people_write_them() {
        // Only this computer can send unless an address is named.
        assert_eq!("udp:5006".parse(), Ok(CurrentSource::Udp(([127, 0, 0, 1], 5006).into())));
        assert_eq!("udp:0.0.0.0:5006".parse(), Ok(CurrentSource::Udp(([0, 0, 0, 0], 5006).into())));
        assert_eq!("serial:/dev/ttyUSB0".parse(), Ok(CurrentSource::Serial("/dev/ttyUSB0".into(), 115_200)));
        assert_eq!("serial:/dev/ttyACM0@9600".parse(), Ok(CurrentSource::Serial("/dev/ttyACM0".into(), 9600)));
        assert_eq!("file:i.csv".parse(), Ok(CurrentSource::File("i.csv".into())));
        let list = CurrentSource::Play { list: "a/i.PLAY".into(), table: String::new() };
        assert_eq!(("a/i.PLAY".parse(), "file:a/i.PLAY".parse()), (Ok(list.clone()), Ok(list)));
        for wrong in ["udp:70000", "udp", "udp:0", "serial:", "serial:/dev/x@fast", "tcp:5", "i.csv"] {
            assert!(wrong.parse::<CurrentSource>().unwrap_err().contains("udp:PORT"), "{wrong}");
        }
    }
}
