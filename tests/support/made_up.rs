//! A made-up run as a log and a table, with everything in it that a log can hold.

use super::fixture;
use catoptra::estimate::Estimate;
use catoptra::rig::Rig;
use catoptra::sink::{CsvSink, CurrentSample, McapSink, Sink as _};
use catoptra::source::HostTime;
use catoptra::tally::Tally;

/// Frames of the run.
pub(crate) const FRAMES: u64 = 200;
/// The host's time of a frame before its camera time.
const HOST_NS: i64 = 1_795_188_826_000_000_123;

/// Writes the run, from a negative stamp through 0, as containers have them; with what only a live run has, if it is
/// `live`: the host's times, and currents.
pub(crate) fn write_run(mut log: McapSink, mut table: CsvSink, rig: &Rig, live: bool) {
    let mut tally = Tally::new(rig);
    for seq in 0..FRAMES {
        let mut estimate: Estimate = fixture::eventful(seq, -3 * 16_666_667);
        if live {
            let stamp_ns = HOST_NS + estimate.stamp.ns;
            estimate.host = Some(HostTime { stamp_ns, arrival_ns: stamp_ns + 1_234_567 });
            let current_a = vec![0.1 * seq as f64, -0.25];
            let host_ns = stamp_ns - 5;
            log.write_current(&CurrentSample { host_ns, arrival_ns: host_ns + 9, seq: Some(seq), current_a }).unwrap();
        }
        log.write(&estimate, None).unwrap();
        if tally.add(&estimate) {
            log.write_totals(&tally.totals()).unwrap();
        }
        table.write(&estimate, None).unwrap();
    }
    log.finish(&tally).unwrap();
    table.finish(&tally).unwrap();
}
