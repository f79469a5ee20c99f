//! A run from its log: `/catheter/estimate` and `/coil/current`, in the order of the file.

use super::{Current, Frame, OK, Place, Recording, SeriesError};
use crate::log::LogError;
use crate::log::decoder::MessageDecoder;
use crate::log::fields::{float, floats, inner, list, number, optional_number, optional_whole, text, whole, word, xyz};
use crate::log::records;
use crate::log::schema::Topic;
use crate::log::sequence::Sequence;
use crate::plural::plural;
use crate::sink::OutputFrame;
use mcap::records::Record;
use nalgebra::{Point3, Vector3};
use prost_reflect::DynamicMessage;
use std::cmp::Reverse;
use std::collections::BTreeMap;
use std::path::Path;

/// Reads the log at `path`, as far as it goes if it was cut off.
pub(super) fn read(path: &Path) -> Result<Recording, SeriesError> {
    let mut reader = Reader::default();
    let condition = records::each::<LogError>(path, |record| {
        reader.take(record);
        Ok(())
    })?;
    if !reader.decoder.channels().any(|(_, topic, _)| topic == Topic::Estimate.name()) {
        return Err(LogError::NotOurs { path: path.to_owned() }.into());
    }
    let lacking: Vec<String> = condition.summary().into_iter().chain(reader.undecoded).collect();
    let cut = (!lacking.is_empty()).then(|| lacking.join("; "));
    let Reader { clock, markers, frames, mut currents, sequence, reference, no_numbers, .. } = reader;
    let currents_lost = sequence.lost();
    if no_numbers > 0 {
        let frames = plural(no_numbers, "frame");
        let odd = "with status ok but without a finite θ or place: taken as not measured";
        tracing::warn!("{}: {frames} {odd}", path.display());
    }
    leave_out_odd(&mut currents, path);
    let mut recording =
        Recording { path: path.to_owned(), clock, reference, markers, frames, currents, cut, vetoed: 0, currents_lost };
    if let Some(clocks) = recording.clocks() {
        for current in &mut recording.currents {
            current.stamp_ns = current.host_ns.map(|host_ns| clocks.camera_ns(host_ns));
        }
    }
    Ok(recording)
}

#[derive(Default)]
struct Reader {
    decoder: MessageDecoder,
    clock: Option<String>,
    markers: Vec<String>,
    frames: Vec<Frame>,
    currents: Vec<Current>,
    /// The numbers that their sender gave them.
    sequence: Sequence,
    /// That of all that was measured: the base frame, if the rig had one.
    reference: Option<OutputFrame>,
    /// Frames that lack a number although its status is ok.
    no_numbers: u64,
    /// A message that does not match its schema.
    undecoded: Option<String>,
}

impl Reader {
    fn take(&mut self, record: &Record<'_>) {
        match record {
            Record::Message { header, data } => {
                let Some(topic) = self.decoder.topic(header.channel_id) else { return };
                let is_estimate = topic == Topic::Estimate.name();
                if !is_estimate && topic != Topic::Current.name() {
                    return;
                }
                let decoded = self.decoder.decode(header.channel_id, data.as_ref());
                let taken = decoded.and_then(|message| match is_estimate {
                    true => self.estimate(&message).ok_or_else(|| "it has no time".to_owned()),
                    false => {
                        if let Some(seq) = optional_whole(&message, "seq") {
                            self.sequence.take(seq);
                        }
                        self.currents.push(current(&message));
                        Ok(())
                    }
                });
                if let Err(why) = taken {
                    let what = format!("message {} cannot be decoded ({why}) and is left out", header.sequence);
                    self.undecoded.get_or_insert(what);
                }
            }
            other => self.decoder.learn(other),
        }
    }

    /// A frame; `None` when it has no time.
    fn estimate(&mut self, message: &DynamicMessage) -> Option<()> {
        let stamp_ns = number(message, "stamp_ns")?;
        let markers = list(message, "markers");
        let angles = inner(message, "deflection");
        let tangent = inner(message, "tangent");
        if self.frames.is_empty() {
            self.clock = text(message, "clock");
            self.markers = markers.iter().map(|marker| text(marker, "name").unwrap_or_default()).collect();
        }
        if self.reference.is_none() {
            self.reference = reference(&markers, tangent.as_ref());
        }
        let frame = Frame {
            seq: whole(message, "seq"),
            stamp_ns,
            host_ns: optional_number(message, "host_stamp_ns"),
            gap: whole(message, "gap"),
            theta_rad: angles.as_ref().and_then(|angles| float(angles, "theta_rad")),
            theta_sd_rad: angles.as_ref().and_then(|angles| float(angles, "theta_sd_rad")),
            theta_status: word(message, "deflection_status"),
            places: self.markers.iter().enumerate().map(|(k, name)| place_of(&markers, k, name)).collect(),
            tangent: tangent.as_ref().and_then(|tangent| in_either(tangent, "in_base", "in_camera")).map(Vector3::from),
            tangent_sd_rad: tangent.as_ref().and_then(|tangent| float(tangent, "sd_rad")),
            tick: optional_whole(message, "tick"),
        };
        let lacks = |place: &Place| place.status == OK && place.point.is_none();
        let lacks_theta = frame.theta_rad.is_none() && frame.theta_status.as_deref() == Some(OK);
        self.no_numbers += u64::from(lacks_theta || frame.places.iter().any(lacks));
        self.frames.push(frame);
        Some(())
    }
}

/// The frame of reference of what was measured in a frame; `None` when that is nothing.
fn reference(markers: &[DynamicMessage], tangent: Option<&DynamicMessage>) -> Option<OutputFrame> {
    let place = markers.iter().find_map(|marker| inner(marker, "position"));
    let in_base = match (place, tangent) {
        (Some(place), _) => place.has_field_by_name("in_base_m"),
        (None, tangent) => tangent?.has_field_by_name("in_base"),
    };
    Some(if in_base { OutputFrame::Base } else { OutputFrame::Camera })
}

/// The place of the marker of a name, which mostly is the `k`-th; elsewhere it is found if it is the only one.
fn place_of(markers: &[DynamicMessage], k: usize, name: &str) -> Place {
    let is_it = |marker: &&DynamicMessage| text(marker, "name").unwrap_or_default() == name;
    let only = || {
        let mut named = markers.iter().filter(is_it);
        named.next().filter(|_| named.next().is_none())
    };
    let marker = markers.get(k).filter(is_it).or_else(only);
    marker.map_or_else(|| Place { point: None, sd_m: None, status: String::new() }, place)
}

fn place(marker: &DynamicMessage) -> Place {
    let position = inner(marker, "position");
    let point = |position| in_either(position, "in_base_m", "in_camera_m");
    Place {
        point: position.as_ref().and_then(point).map(Point3::from),
        sd_m: position.as_ref().and_then(|position| float(position, "sd_m")),
        status: word(marker, "status").unwrap_or_default(),
    }
}

/// In the base frame, if that is given: where it is not finite, what the camera's frame says is of another frame.
fn in_either(message: &DynamicMessage, base: &str, camera: &str) -> Option<[f64; 3]> {
    xyz(message, if message.has_field_by_name(base) { base } else { camera })
}

fn current(message: &DynamicMessage) -> Current {
    Current { host_ns: number(message, "host_ns"), stamp_ns: None, values_a: floats(message, "current_a") }
}

/// Leaves out samples with another number of coils than most have; of two such numbers, the smaller is kept.
fn leave_out_odd(currents: &mut Vec<Current>, path: &Path) {
    let mut counts: BTreeMap<usize, usize> = BTreeMap::new();
    for current in &*currents {
        *counts.entry(current.values_a.len()).or_default() += 1;
    }
    let usual = counts.iter().max_by_key(|(coils, count)| (**count, Reverse(**coils)));
    let Some((&coils, &count)) = usual.filter(|_| counts.len() > 1) else { return };
    let odd = plural((currents.len() - count) as u64, "sample");
    let usual = plural(coils as u64, "coil");
    tracing::warn!("{}: {odd} of currents left out: not of {usual}, as most are", path.display());
    currents.retain(|current| current.values_a.len() == coils);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sink::{McapSink, Sink as _};
    use crate::tally::Tally;
    use crate::testing::fixture;

    #[test]
    fn markers_are_known_by_their_names_in_any_order() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log.mcap");
        let mut log = McapSink::create(&path, &fixture::rig(), "# rig", "").unwrap();
        for stamp_ns in 0..2 {
            log.write(&fixture::complete(0, stamp_ns), None).unwrap();
        }
        log.finish(&Tally::default()).unwrap();
        let mut reader = Reader::default();
        records::each::<LogError>(&path, |record| {
            reader.take(record);
            if reader.frames.len() == 1 {
                reader.markers = ["tip", "other", "base"].map(str::to_owned).to_vec();
            }
            Ok(())
        })
        .unwrap();
        let [first, second] = [0, 1].map(|k| reader.frames[k].places.clone());
        assert_eq!((&second[0].point, &second[2].point), (&first[2].point, &first[0].point));
        assert!(second[1].point.is_none() && first[1].point.is_some());
    }
}
