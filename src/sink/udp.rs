//! Datagrams for controllers: one JSON object per frame, sent as soon as it is known.
//!
//! ```json
//! {"seq":42,"stamp_ns":1234567890,"clock":"device","host_ns":1700000000123456789,"gap":0,"status":"ok",
//!  "theta_deg":12.34,"theta_sd_deg":0.11,"polar_deg":12.4,"azimuth_deg":3.1,
//!  "tip_mm":[1.2,0.1,44.0],"tip_sd_mm":0.05,"frame":"base"}
//! ```
//! `seq` counts the frames received, without holes: a missing one was lost on the way. `stamp_ns` is the camera's time
//! by `clock`, `host_ns` the same on the tracking computer's clock (nanoseconds since 1970; null if the source has
//! none). `gap`: camera frames lost before this one. `status`: `ok`, or why there is no angle; unknown numbers are
//! null. `tip_mm` is the last marker of the catheter, in `frame`.
//!
//! If the socket cannot send (nobody listens, a full buffer) the datagram is dropped and counted; it never waits.

use super::{OutputFrame, Sink, SinkError};
use crate::estimate::Estimate;
use crate::rig::Rig;
use crate::source::Picture;
use crate::tally::Tally;
use nalgebra::Isometry3;
use serde::Serialize;
use std::io::ErrorKind;
use std::net::{SocketAddr, UdpSocket};

/// Sends estimates to one address.
#[derive(Debug)]
pub struct UdpSink {
    socket: UdpSocket,
    frame: &'static str,
    frame_from_camera: Isometry3<f64>,
    views: Vec<String>,
    tip: usize,
    scratch: Vec<u8>,
    unsent: u64,
}

#[derive(Debug, Serialize)]
struct Datagram<'a> {
    seq: u64,
    stamp_ns: i64,
    clock: &'a str,
    host_ns: Option<i64>,
    gap: u32,
    status: &'a str,
    theta_deg: Option<f64>,
    theta_sd_deg: Option<f64>,
    polar_deg: Option<f64>,
    azimuth_deg: Option<f64>,
    tip_mm: Option<[f64; 3]>,
    tip_sd_mm: Option<f64>,
    frame: &'a str,
}

impl UdpSink {
    /// Sends to `to`, with positions in the base frame if the rig has one.
    ///
    /// # Errors
    /// When the system provides no socket.
    pub fn to(to: SocketAddr, rig: &Rig) -> std::io::Result<Self> {
        let own: SocketAddr = if to.is_ipv4() { ([0, 0, 0, 0], 0).into() } else { ([0_u16; 8], 0).into() };
        let socket = UdpSocket::bind(own)?;
        socket.set_broadcast(true)?;
        socket.connect(to)?;
        socket.set_nonblocking(true)?;
        let (frame, frame_from_camera) = match OutputFrame::Base.output_from_camera(rig) {
            Some(base_from_camera) => ("base", base_from_camera),
            None => ("camera", Isometry3::identity()),
        };
        Ok(Self {
            socket,
            frame,
            frame_from_camera,
            views: rig.views.iter().map(|v| v.name.clone()).collect(),
            tip: rig.tip(),
            scratch: Vec::new(),
            unsent: 0,
        })
    }

    /// Sends one frame.
    fn send(&mut self, estimate: &Estimate) {
        let views: Vec<&str> = self.views.iter().map(String::as_str).collect();
        let angles = estimate.deflection.as_ref();
        let status = angles.err().map_or_else(|| "ok".to_owned(), |miss| miss.word(&views));
        let angle = |of: fn(&crate::estimate::Deflection) -> f64| angles.ok().map(|d| of(d).to_degrees());
        let tip = estimate.markers.get(self.tip).and_then(|m| m.position.as_ref().ok());
        let datagram = Datagram {
            seq: estimate.seq,
            stamp_ns: estimate.stamp.ns,
            clock: estimate.stamp.clock.name(),
            host_ns: estimate.host.map(|host| host.stamp_ns),
            gap: estimate.gap,
            status: &status,
            theta_deg: angle(|d| d.theta_rad),
            theta_sd_deg: angle(|d| d.theta_sd_rad),
            polar_deg: angle(|d| d.polar_rad),
            azimuth_deg: angle(|d| d.azimuth_rad),
            tip_mm: tip.map(|p| ((self.frame_from_camera * p.point).coords * 1e3).into()),
            tip_sd_mm: tip.map(|p| p.sd_m() * 1e3),
            frame: self.frame,
        };
        self.scratch.clear();
        let written = serde_json::to_writer(&mut self.scratch, &datagram).is_ok();
        if !written || !self.sent() {
            self.unsent += 1;
            if self.unsent == 1 {
                tracing::warn!(
                    "a datagram could not be sent: nobody listens there, or not fast enough; more are counted"
                );
            }
        }
    }

    /// Sends what was written. A port that is closed is told of the datagram before, instead of sending this one.
    fn sent(&self) -> bool {
        match self.socket.send(&self.scratch) {
            Err(error) if error.kind() == ErrorKind::ConnectionRefused => {
                _ = self.socket.send(&self.scratch);
                false
            }
            sent => sent.is_ok(),
        }
    }
}

impl Sink for UdpSink {
    /// Never waits, and never fails.
    fn write(&mut self, estimate: &Estimate, _: Option<&Picture>) -> Result<(), SinkError> {
        self.send(estimate);
        Ok(())
    }

    fn finish(&mut self, _: &Tally) -> Result<(), SinkError> {
        if self.unsent > 1 {
            tracing::warn!("{} datagrams could not be sent", self.unsent);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimate::Miss;
    use crate::source::HostTime;
    use crate::testing::fixture;
    use std::time::Duration;

    fn receiver() -> (UdpSocket, UdpSink) {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        socket.set_read_timeout(Some(Duration::from_secs(2))).unwrap();
        let sink = UdpSink::to(socket.local_addr().unwrap(), &fixture::rig()).unwrap();
        (socket, sink)
    }

    fn received(socket: &UdpSocket) -> serde_json::Value {
        let mut bytes = [0; 2048];
        let length = socket.recv(&mut bytes).unwrap();
        serde_json::from_slice(&bytes[..length]).unwrap()
    }

    #[test]
    fn a_datagram_says_what_was_measured() {
        let (socket, mut sink) = receiver();
        let mut estimate = fixture::complete(9, 42);
        estimate.host = Some(HostTime { arrival_ns: 1_000_100, stamp_ns: 1_000_000 });
        sink.send(&estimate);
        let said = received(&socket);
        assert_eq!((&said["seq"], &said["stamp_ns"], &said["host_ns"]), (&9.into(), &42.into(), &1_000_000.into()));
        assert_eq!((&said["status"], &said["frame"], &said["gap"]), (&"ok".into(), &"base".into(), &0.into()));
        let theta_deg = estimate.deflection.unwrap().theta_rad.to_degrees();
        assert!((said["theta_deg"].as_f64().unwrap() - theta_deg).abs() < 1e-12);
        // The fixture's tip is 50 mm from the base's origin.
        let tip: Vec<f64> = said["tip_mm"].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect();
        assert!((tip.iter().map(|v| v * v).sum::<f64>().sqrt() - 50.0).abs() < 1e-9, "{tip:?}");
    }

    #[test]
    fn what_is_not_known_is_null_and_says_why() {
        let (socket, mut sink) = receiver();
        let mut estimate = fixture::complete(0, 0);
        estimate.deflection = Err(Miss::SkippedOverload);
        estimate.markers[2].position = Err(Miss::SkippedOverload);
        sink.send(&estimate);
        let said = received(&socket);
        assert_eq!(said["status"], "skipped_overload");
        assert!(said["theta_deg"].is_null() && said["tip_mm"].is_null() && said["host_ns"].is_null());
    }

    #[test]
    fn a_closed_port_costs_nothing_and_is_counted() {
        let (socket, mut sink) = receiver();
        drop(socket);
        for seq in 0..50 {
            sink.send(&fixture::complete(seq, 0));
            std::thread::sleep(Duration::from_millis(1));
        }
        // What became of the last one is not known yet. (Where the system does not tell, all were sent.)
        assert!((45..50).contains(&sink.unsent) || !cfg!(target_os = "linux") && sink.unsent > 0, "{}", sink.unsent);
    }
}
