//! From bytes to samples of currents: datagrams, lines, rows of tables, messages; and what to say of those that are
//! none, or odd.

use super::super::listener::Listener;
use super::bursts::Bursts;
use super::datagrams::Datagrams;
use super::delays::Delays;
use super::sample::{columns, has_decimal_commas, sample};
use super::senders::Senders;
use super::whole_numbers::WholeNumbers;
use super::{POLL_INTERVAL, STOP_POLL_INTERVAL};
use crate::log::sequence::Sequence;
use crate::plural::plural;
use crate::sink::CurrentSample;
use crate::source::current_columns::{CurrentColumns, TimeColumn};
use crate::source::host::HostClock;
use crate::source::times::seconds;
use std::collections::VecDeque;
use std::io::{self, BufRead, BufReader, ErrorKind, Read};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{SyncSender, TrySendError, sync_channel};
use std::time::{Duration, Instant};

/// A sample further from its arrival is not of this run.
const MAX_SAMPLE_AGE_NS: i64 = 60_000_000_000;
/// Most rows of a table that are logged from before that: the last of them tells what the coils have.
const MOST_EARLIER: usize = 1000;
/// How long rows that are already in a table may take to be read when the run ends.
const LAST_LOOK: Duration = Duration::from_millis(500);
/// Longest header, bytes.
const LONGEST_HEADER: u64 = 1 << 16;

/// Where in a line the first byte is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Start {
    OfLine,
    /// Possibly within one, unless there was silence before.
    Anywhere,
}

/// Turns lines into samples.
pub(super) struct Parser {
    name: String,
    clock: HostClock,
    samples: SyncSender<CurrentSample>,
    /// Largest plausible current, amperes.
    limit_a: f64,
    /// Of a table.
    columns: Option<CurrentColumns>,
    wrong: u64,
    implausible: u64,
    full: u64,
    /// Number of coils of the first sample, and how many samples have another.
    coils: Option<usize>,
    other_coils: u64,
    /// Samples of a table whose time is that of their arrival, more or less; and those of other times.
    timely: u64,
    untimely: u64,
    /// The last rows of a table that are from before the run, not logged yet, and how many before them never are.
    earlier: VecDeque<CurrentSample>,
    left_out: u64,
    /// Time of the last sample, and how many have none later than the one before.
    last_ns: Option<i64>,
    not_later: u64,
    delays: Delays,
    bursts: Bursts,
    sequence: Sequence,
    whole_numbers: WholeNumbers,
    senders: Senders,
}

impl Parser {
    pub(super) fn new(name: String, clock: HostClock, samples: SyncSender<CurrentSample>, limit_a: f64) -> Self {
        Self {
            name,
            clock,
            samples,
            limit_a,
            columns: None,
            wrong: 0,
            implausible: 0,
            full: 0,
            coils: None,
            other_coils: 0,
            timely: 0,
            untimely: 0,
            earlier: VecDeque::new(),
            left_out: 0,
            last_ns: None,
            not_later: 0,
            delays: Delays::default(),
            bursts: Bursts::default(),
            sequence: Sequence::default(),
            whole_numbers: WholeNumbers::default(),
            senders: Senders::default(),
        }
    }

    /// Reads the header of a table; the rows are left.
    pub(super) fn headed<T: Read>(&mut self, table: T) -> io::Result<BufReader<T>> {
        let mut reader = BufReader::new(table);
        let mut header = String::new();
        // Of a file without lines not all is read.
        (&mut reader).take(LONGEST_HEADER).read_line(&mut header)?;
        self.columns = Some(columns(&header).map_err(|e| io::Error::new(ErrorKind::InvalidData, e))?);
        Ok(reader)
    }

    pub(super) fn datagrams(&mut self, from: &mut Datagrams, stop: &AtomicBool) {
        let mut buffer = [0; 65_536];
        while !stop.load(Ordering::Relaxed) {
            match from.next(&mut buffer) {
                Ok(datagram) => {
                    self.senders.count(datagram.sender, &self.name);
                    self.take_at(datagram.bytes, datagram.arrival_ns);
                }
                Err(e) if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted) => {}
                Err(error) => {
                    tracing::error!("{}: {error}; no more currents are logged", self.name);
                    break;
                }
            }
        }
        self.report();
    }

    /// Reads lines; at the end of what there is it waits so long, and reads on. Of a table that is written meanwhile,
    /// what there is when the run ends is read as well.
    pub(super) fn lines(&mut self, mut from: impl Read, mut start: Start, idle: Duration, stop: &AtomicBool) {
        let (mut bytes, mut line) = ([0; 4096], Vec::new());
        let mut until = None;
        loop {
            if stop.load(Ordering::Relaxed) {
                let until = *until.get_or_insert_with(|| Instant::now() + LAST_LOOK);
                if self.columns.is_none() || self.is_timed_from_start() || Instant::now() > until {
                    break;
                }
            }
            match from.read(&mut bytes) {
                Ok(0) if until.is_some() => break,
                Ok(0) if line.is_empty() => {
                    self.send_earlier();
                    start = Start::OfLine;
                    std::thread::sleep(idle);
                }
                // A table that counts from the start was complete before it: its last line may lack an end.
                Ok(0) if self.is_timed_from_start() && !line.is_empty() => {
                    if self.wait_until_due(&line, stop) {
                        self.take(&line);
                        line.clear();
                    }
                }
                Ok(0) => {
                    self.send_earlier();
                    std::thread::sleep(idle);
                }
                Ok(length) => {
                    for &byte in bytes.iter().take(length) {
                        match byte {
                            b'\n' | b'\r' => {
                                // JSON shows its beginning.
                                let whole = start == Start::OfLine || line.first() == Some(&b'{');
                                if !whole {
                                    self.leave_out_rest(&line);
                                } else if !line.is_empty() && self.wait_until_due(&line, stop) {
                                    self.take(&line);
                                }
                                start = Start::OfLine;
                                line.clear();
                            }
                            // What is longer is no line of ours; what is kept of it will be refused.
                            _ if line.len() < bytes.len() => line.push(byte),
                            _ => {}
                        }
                    }
                }
                Err(e) if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => {}
                Err(error) => {
                    tracing::error!("{}: {error}; no more currents are logged", self.name);
                    break;
                }
            }
        }
        if self.columns.is_some() && !self.is_timed_from_start() && !line.is_empty() {
            let rest = String::from_utf8_lossy(&line);
            tracing::warn!("{}: the last line, `{}`, is not logged: it has no end", self.name, rest.escape_debug());
        }
        self.send_earlier();
        self.report();
    }

    /// Says that the line in which reading began is not taken.
    fn leave_out_rest(&self, line: &[u8]) {
        if !line.is_empty() {
            let rest = String::from_utf8_lossy(line.get(..line.len().min(60)).unwrap_or_default());
            tracing::info!("{}: `{}` may be the rest of a line and is not logged", self.name, rest.escape_debug());
        }
    }

    /// Takes messages as they come.
    pub(super) fn messages(&mut self, from: &mut Listener, stop: &AtomicBool) {
        while !stop.load(Ordering::Relaxed) {
            match from.next() {
                Some(line) => self.take(&line),
                None => std::thread::sleep(POLL_INTERVAL),
            }
        }
        self.report();
    }

    /// Whether it is a table whose times count from the beginning of the run.
    fn is_timed_from_start(&self) -> bool {
        self.columns.as_ref().is_some_and(|columns| columns.times == TimeColumn::StartSeconds)
    }

    /// Waits for the time of a row of a table that is counted from the beginning of the run; `false` when the run ends
    /// before.
    fn wait_until_due(&self, bytes: &[u8], stop: &AtomicBool) -> bool {
        if !self.is_timed_from_start() {
            return true;
        }
        let Some(sample) = self.sample(bytes, 0) else { return true };
        while !stop.load(Ordering::Relaxed) {
            let left_ns = u64::try_from(sample.host_ns.saturating_sub(self.clock.now_ns())).unwrap_or(0);
            if left_ns == 0 {
                return true;
            }
            std::thread::sleep(STOP_POLL_INTERVAL.min(Duration::from_nanos(left_ns)));
        }
        false
    }

    /// Takes what was just read.
    fn take(&mut self, bytes: &[u8]) {
        self.take_at(bytes, self.clock.now_ns());
    }

    fn take_at(&mut self, bytes: &[u8], arrival_ns: i64) {
        match self.sample(bytes, arrival_ns) {
            Some(sample) if !self.is_plausible(&sample) => {
                self.implausible += 1;
                if self.implausible == 1 {
                    tracing::warn!(
                        "{}: a sample is not plausible and is not logged: {:?} A, {:.3} s from its arrival; currents \
                         are up to {} A (--current-limit), times within {} s of their arrival; more are counted",
                        self.name,
                        sample.current_a,
                        seconds(sample.host_ns.saturating_sub(arrival_ns)),
                        self.limit_a,
                        seconds(MAX_SAMPLE_AGE_NS)
                    );
                }
            }
            Some(sample) => {
                self.count_coils(sample.current_a.len());
                if is_timely(&sample) {
                    self.timely += 1;
                } else {
                    self.untimely += 1;
                }
                self.note_order(&sample);
                self.note_sender(&sample);
                if self.columns.is_none() {
                    self.whole_numbers.take(bytes, &sample, &self.name);
                }
                self.send(sample);
            }
            None => {
                self.wrong += 1;
                if self.wrong == 1 {
                    let said = String::from_utf8_lossy(bytes.get(..bytes.len().min(60)).unwrap_or_default());
                    let why = if has_decimal_commas(&said) {
                        ": with `;` or blanks between the currents, a comma can only be a decimal comma: write \
                         decimal points"
                    } else if said.trim().contains('\n') {
                        ": it has several lines, and one sample is expected in a datagram"
                    } else {
                        ""
                    };
                    tracing::warn!(
                        "{}: `{}` is not a sample of currents{why}; expected {{\"current_a\":[0.1,0]}} or 0.1, 0; more \
                         are counted",
                        self.name,
                        said.escape_debug()
                    );
                }
            }
        }
    }

    /// Rows of a table wait until they are logged. Once nobody logs any more, the run is over.
    fn send(&mut self, sample: CurrentSample) {
        if self.columns.is_some() {
            let from_ns = self.clock.started_ns().saturating_sub(MAX_SAMPLE_AGE_NS);
            if sample.host_ns < from_ns && !self.is_timed_from_start() {
                self.earlier.push_back(sample);
                if self.earlier.len() > MOST_EARLIER {
                    self.earlier.pop_front();
                    self.left_out += 1;
                }
                return;
            }
            self.send_earlier();
            let _ = self.samples.send(sample);
        } else if let Err(TrySendError::Full(_)) = self.samples.try_send(sample) {
            self.full += 1;
            if self.full == 1 {
                tracing::warn!("{}: currents come faster than they are logged; some are lost", self.name);
            }
        }
    }

    /// Sends the last rows from before the run.
    fn send_earlier(&mut self) {
        for sample in std::mem::take(&mut self.earlier) {
            let _ = self.samples.send(sample);
        }
    }

    /// Counts samples that are not in the order of their times.
    fn note_order(&mut self, sample: &CurrentSample) {
        let last_ns = self.last_ns.replace(sample.host_ns);
        self.not_later += u64::from(last_ns.is_some_and(|last_ns| sample.host_ns <= last_ns));
    }

    /// Warns of a sender whose clock is another, or whose samples are lost. Of a table, rows of an earlier run say
    /// nothing of the clock, nor do times that count from the beginning of this one.
    fn note_sender(&mut self, sample: &CurrentSample) {
        if self.columns.is_some() && (self.is_timed_from_start() || !is_timely(sample)) {
            return;
        }
        if sample.host_ns == sample.arrival_ns {
            self.bursts.take(sample.arrival_ns);
        }
        let said = self.delays.take(sample).into_iter().chain(sample.seq.and_then(|seq| self.sequence.take(seq)));
        said.for_each(|said| tracing::warn!("{}: {said}", self.name));
    }

    fn count_coils(&mut self, coils: usize) {
        let before = *self.coils.get_or_insert(coils);
        if coils == before {
            return;
        }
        self.other_coils += 1;
        if self.other_coils == 1 {
            tracing::warn!(
                "{}: the number of currents in a sample changes from {before} to {coils}: it is logged, but one table \
                 cannot hold both; does more than one program send? More are counted",
                self.name
            );
        }
    }

    /// Whether the current is one that the amplifier can give, and its time one of this run. (The times of a table may
    /// be those of an earlier start of the program that writes it.)
    fn is_plausible(&self, sample: &CurrentSample) -> bool {
        (is_timely(sample) || self.columns.is_some()) && sample.current_a.iter().all(|a| a.abs() <= self.limit_a)
    }

    /// Says at the end what was left out, and what may be wrong with the rest.
    fn report(&self) {
        self.doubts().iter().for_each(|doubt| tracing::warn!("{}: {doubt}", self.name));
        let counts = [
            (self.wrong, "lines were no samples"),
            (self.implausible, "samples were not plausible"),
            (self.other_coils, "samples had another number of currents than the first"),
            (self.full, "samples came faster than they were logged"),
            (self.left_out, "rows are from more than 60 s before the run, and not logged"),
        ];
        for (count, what) in counts.into_iter().chain(self.sequence.report()) {
            if count > 1 {
                tracing::warn!("{}: {count} {what}", self.name);
            }
        }
        if let Some(each) = self.senders.report() {
            tracing::warn!("{}: {each}", self.name);
        }
    }

    /// What is odd in all samples together.
    fn doubts(&self) -> Vec<String> {
        let silent = self.coils.is_none() && !self.is_timed_from_start();
        let silent = silent.then(|| "no sample of currents was received in the whole run".to_owned());
        let untimely = (self.timely == 0 && self.untimely > 0).then(|| {
            format!(
                "none of {} samples has a time of this run: host_ns is in nanoseconds since 1970, unix_s in seconds",
                self.untimely
            )
        });
        let not_later = (self.not_later > 0).then(|| {
            format!(
                "the time of {} is not later than that of the one before: give all digits of the time, each sample \
                 once, and all in their order",
                plural(self.not_later, "sample")
            )
        });
        silent
            .into_iter()
            .chain(untimely)
            .chain(not_later)
            .chain(self.delays.doubt())
            .chain(self.bursts.doubt())
            .collect()
    }

    fn sample(&self, bytes: &[u8], arrival_ns: i64) -> Option<CurrentSample> {
        sample(bytes, self.columns.as_ref(), arrival_ns, self.clock.started_ns())
    }
}

/// Whether the time of a sample is near that of its arrival.
fn is_timely(sample: &CurrentSample) -> bool {
    sample.host_ns.abs_diff(sample.arrival_ns) <= MAX_SAMPLE_AGE_NS.unsigned_abs()
}

/// Takes bytes for datagrams, and for lines of tables.
pub(crate) fn currents_of(bytes: &[u8]) {
    for header in [None, Some("host_ns,i1"), Some("unix_s,i1,i2"), Some("i1,t_s")] {
        // Nobody takes them: rows of tables do not wait.
        let (samples, _) = sync_channel(1);
        let mut parser = Parser::new("bytes".to_owned(), HostClock::start(), samples, 10.0);
        parser.columns = header.and_then(|header| columns(header).ok());
        bytes.split(|byte| *byte == b'\n').for_each(|line| parser.take(line));
    }
    let _ = columns(&String::from_utf8_lossy(bytes));
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Cursor;
    use std::sync::Arc;
    use std::sync::mpsc::Receiver;

    fn parser(columns: Option<CurrentColumns>) -> (Parser, Receiver<CurrentSample>) {
        let (samples, line) = sync_channel(16);
        (Parser { columns, ..Parser::new("test".to_owned(), HostClock::start(), samples, 10.0) }, line)
    }

    #[test]
    fn silence_and_times_of_another_unit_are_told_at_the_end() {
        let (mut table, _line) = parser(columns("host_ns,i1").ok());
        assert!(table.doubts().concat().contains("no sample of currents was received"), "{:?}", table.doubts());
        let now = table.clock.now_ns();
        table.take(format!("{},0.1", now / 1000).as_bytes());
        assert!(table.doubts().concat().contains("none of 1 samples has a time of this run"), "{:?}", table.doubts());
        table.take(format!("{now},0.1").as_bytes());
        assert!(table.doubts().is_empty(), "{:?}", table.doubts());
        table.take(format!("{now},0.2").as_bytes());
        assert!(table.doubts().concat().contains("the time of 1 sample is not later"), "{:?}", table.doubts());
        table.take(format!("{},0.1", now + 1_000_000_000).as_bytes());
        assert!(table.delays.is_ahead());
    }

    #[test]
    fn a_sender_whose_clock_is_wrong_is_told() {
        let (mut parser, _line) = parser(None);
        let mut take = |before_ns: i64| {
            let host_ns = parser.clock.now_ns() - before_ns;
            parser.take(format!(r#"{{"current_a":[0.1],"host_ns":{host_ns}}}"#).as_bytes());
            parser.doubts().concat()
        };
        assert!(take(7_500_000_000).contains("every sample arrived 7.5"));
        assert_eq!(take(1_000_000), "");
        take(-7_500_000_000);
        assert!(parser.delays.is_ahead());
    }

    #[test]
    fn datagrams_whose_times_stand_still_are_told() {
        let (mut parser, _line) = parser(None);
        let now = parser.clock.now_ns();
        for host_ns in [now, now, now + 1] {
            parser.take(format!(r#"{{"current_a":[0.1],"host_ns":{host_ns}}}"#).as_bytes());
        }
        assert!(parser.doubts().concat().contains("the time of 1 sample is not later"), "{:?}", parser.doubts());
    }

    #[test]
    fn decimal_commas_are_not_taken_for_more_currents() {
        let (mut parser, line) = parser(None);
        for wrong in ["0,4; 0,2", "0,4;0", "1;0,5", "0,05 -0,1", "0,05\t1"] {
            parser.take(wrong.as_bytes());
        }
        assert_eq!((parser.wrong, line.try_recv().is_err()), (5, true));
        for right in ["0.4; 0.2", "0.4, 0.2", "0.4 0.2", "0.4,0.2 "] {
            parser.take(right.as_bytes());
            assert_eq!(line.try_recv().unwrap().current_a, [0.4, 0.2], "{right}");
        }
    }

    #[test]
    fn what_is_no_sample_is_counted_and_the_rest_goes_on() {
        let (mut parser, line) = parser(None);
        let many = vec!["0"; 65].join(",");
        for wrong in ["", "amps", "0.1, NaN", "inf", "{\"current_a\":[]}", "{\"amps\":[1]}", "{", "1,,x", &many] {
            parser.take(wrong.as_bytes());
        }
        parser.take(&[0xff, 0xfe, 0x00]);
        assert_eq!(parser.wrong, 10);
        parser.take(b"0.5");
        assert_eq!(line.try_recv().unwrap().current_a, [0.5]);
        assert!(line.try_recv().is_err());
    }

    #[test]
    fn what_is_not_plausible_is_not_logged_and_counted() {
        let (mut parser, line) = parser(None);
        let now = parser.clock.now_ns();
        for wrong in [
            r#"{"current_a":[1e308]}"#.to_owned(),
            "0.1, -10.5".to_owned(),
            r#"{"current_a":[0.1],"host_ns":5}"#.to_owned(),
            format!(r#"{{"current_a":[0.1],"host_ns":{}}}"#, now + 61_000_000_000),
            format!(r#"{{"current_a":[0.1],"host_ns":{}}}"#, i64::MIN),
        ] {
            parser.take(wrong.as_bytes());
        }
        assert_eq!((parser.implausible, parser.wrong), (5, 0));
        parser.take(format!(r#"{{"current_a":[-9.9],"host_ns":{}}}"#, now - 59_000_000_000).as_bytes());
        assert_eq!(line.try_recv().unwrap().current_a, [-9.9]);
        assert!(line.try_recv().is_err());
    }

    #[test]
    fn the_last_row_of_an_excitation_counts_without_a_line_end() {
        let (mut parser, samples) = parser(columns("t_s,i1").ok());
        let stop = Arc::new(AtomicBool::new(false));
        let ends = Arc::clone(&stop);
        let reading = std::thread::spawn(move || {
            parser.lines(Cursor::new("0,0.1\n0.05,0.2"), Start::OfLine, STOP_POLL_INTERVAL, &stop)
        });
        let next = || samples.recv_timeout(Duration::from_secs(10)).unwrap().current_a;
        assert_eq!((next(), next()), (vec![0.1], vec![0.2]));
        ends.store(true, Ordering::Relaxed);
        reading.join().unwrap();
    }

    /// Of a table that was begun long before the run the last rows are logged, and what is written when it ends.
    #[test]
    fn old_rows_of_a_long_table_are_left_out_and_the_last_ones_are_read() {
        struct Growing(Vec<Vec<u8>>, Arc<AtomicBool>);
        impl Read for Growing {
            fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
                let next = self.0.pop().unwrap_or_default();
                bytes[..next.len()].copy_from_slice(&next);
                // The run ends before the rest of it is read.
                self.1.fetch_or(self.0.len() == 1, Ordering::Relaxed);
                Ok(next.len())
            }
        }
        let (samples, line) = sync_channel(2 * MOST_EARLIER);
        let clock = HostClock::start();
        let new = Parser::new("test".to_owned(), clock, samples, 10.0);
        let mut parser = Parser { columns: columns("host_ns,i1").ok(), ..new };
        let old_ns = clock.started_ns() - 2 * MAX_SAMPLE_AGE_NS;
        let rows = |from: i64, count: i64, at_ns: i64| -> Vec<u8> {
            (from..from + count).flat_map(|k| format!("{},0.{k}\n", at_ns + k).into_bytes()).collect()
        };
        let mut parts: Vec<Vec<u8>> = (0..12).map(|k| rows(100 * k, 100, old_ns)).collect();
        parts.extend([rows(5000, 2, clock.started_ns()), rows(6000, 1, clock.started_ns())]);
        parts.reverse();
        let stop = Arc::new(AtomicBool::new(false));
        parser.lines(Growing(parts, Arc::clone(&stop)), Start::OfLine, Duration::from_millis(1), &stop);
        let logged: Vec<i64> = line.try_iter().map(|sample| sample.host_ns).collect();
        assert_eq!((logged.len(), parser.left_out), (MOST_EARLIER + 3, 200));
        assert_eq!((logged[0], logged[MOST_EARLIER + 2]), (old_ns + 200, clock.started_ns() + 6000));
    }

    /// A device that sends all the time, opened within a line.
    #[test]
    fn the_rest_of_a_line_is_no_sample() {
        for (text, expected) in [
            ("25, 0.3\n0.01, 0.02\n", [vec![0.01, 0.02]].as_slice()),
            ("\n0.01, 0.02\n", &[vec![0.01, 0.02]]),
            ("{\"current_a\":[0.5]}\n0.25\n", &[vec![0.5], vec![0.25]]),
        ] {
            let (mut parser, samples) = parser(None);
            let stop = Arc::new(AtomicBool::new(false));
            let ends = Arc::clone(&stop);
            let idle = Duration::from_millis(1);
            let reading = std::thread::spawn(move || {
                parser.lines(Cursor::new(text), Start::Anywhere, idle, &stop);
                parser.wrong
            });
            let taken: Vec<_> =
                expected.iter().map(|_| samples.recv_timeout(Duration::from_secs(10)).unwrap().current_a).collect();
            assert_eq!(taken, expected, "{text}");
            ends.store(true, Ordering::Relaxed);
            assert_eq!((reading.join().unwrap(), samples.try_recv().ok()), (0, None), "{text}");
        }
    }

    /// Silence before it shows that a line is whole.
    #[test]
    fn a_first_line_after_silence_is_a_sample() {
        struct Device(std::vec::IntoIter<&'static str>);
        impl Read for Device {
            fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
                let next = self.0.next().unwrap_or_default().as_bytes();
                bytes[..next.len()].copy_from_slice(next);
                Ok(next.len())
            }
        }
        for (reads, first) in [(vec!["", "0.1\n0.2\n"], 0.1), (vec!["0.1", "", "\n0.2\n"], 0.2)] {
            let (mut parser, samples) = parser(None);
            let stop = Arc::new(AtomicBool::new(false));
            let ends = Arc::clone(&stop);
            let device = Device(reads.into_iter());
            let idle = Duration::from_millis(1);
            let reading = std::thread::spawn(move || parser.lines(device, Start::Anywhere, idle, &stop));
            assert_eq!(samples.recv_timeout(Duration::from_secs(10)).unwrap().current_a, [first]);
            ends.store(true, Ordering::Relaxed);
            reading.join().unwrap();
        }
    }

    #[test]
    fn samples_of_another_number_of_coils_are_logged_and_counted() {
        let (mut parser, line) = parser(None);
        ["0.1, 0.2", "0.3", "0.4, 0.5"].iter().for_each(|text| parser.take(text.as_bytes()));
        assert_eq!((parser.coils, parser.other_coils, line.try_iter().count()), (Some(2), 1, 3));
    }
}
