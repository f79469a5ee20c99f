//! A run from its log: `/catheter/estimate` and `/coil/current`, in the order of the file.

use super::{Current, Frame, Place, Recording, SeriesError};
use crate::log::LogError;
use crate::log::decoder::MessageDecoder;
use crate::log::fields::{float, floats, inner, list, number, optional_number, text, whole, word, xyz};
use crate::log::records;
use crate::log::schema::Topic;
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
    let condition = records::each(path, |record| {
        reader.take(record);
        Ok(())
    })?;
    if !reader.decoder.channels().any(|(_, topic, _)| topic == Topic::Estimate.name()) {
        return Err(LogError::NotOurs { path: path.to_owned() }.into());
    }
    let lacking: Vec<String> = condition.summary().into_iter().chain(reader.undecoded).collect();
    let cut = (!lacking.is_empty()).then(|| lacking.join("; "));
    let Reader { clock, markers, frames, mut currents, reference, .. } = reader;
    leave_out_odd(&mut currents, path);
    let mut recording =
        Recording { path: path.to_owned(), clock, reference, markers, frames, currents, cut, vetoed: 0 };
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
    /// That of all that was measured: the base frame, if the rig had one.
    reference: Option<OutputFrame>,
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
        self.frames.push(Frame {
            seq: whole(message, "seq"),
            stamp_ns,
            host_ns: optional_number(message, "host_stamp_ns"),
            gap: whole(message, "gap"),
            theta_rad: angles.as_ref().and_then(|angles| float(angles, "theta_rad")),
            theta_sd_rad: angles.as_ref().and_then(|angles| float(angles, "theta_sd_rad")),
            theta_status: word(message, "deflection_status"),
            places: markers.iter().map(place).collect(),
            tangent: tangent
                .as_ref()
                .and_then(|tangent| xyz(tangent, "in_base").or_else(|| xyz(tangent, "in_camera")))
                .map(Vector3::from),
            tangent_sd_rad: tangent.as_ref().and_then(|tangent| float(tangent, "sd_rad")),
            tick: optional_number(message, "tick").and_then(|tick| u64::try_from(tick).ok()),
        });
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

fn place(marker: &DynamicMessage) -> Place {
    let position = inner(marker, "position");
    let point = |position| xyz(position, "in_base_m").or_else(|| xyz(position, "in_camera_m"));
    Place {
        point: position.as_ref().and_then(point).map(Point3::from),
        sd_m: position.as_ref().and_then(|position| float(position, "sd_m")),
        status: word(marker, "status").unwrap_or_default(),
    }
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
