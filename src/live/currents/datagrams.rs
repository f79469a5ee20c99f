//! Datagrams, each with the time of its arrival.
//!
//! On Linux that is the system's own (`SO_TIMESTAMPNS`): one that waits while this program, or all of the computer's
//! programs, are held up is not late. Elsewhere it is the time at which it is read.

use crate::source::host::HostClock;
use std::io;
use std::net::{SocketAddr, UdpSocket};
use std::time::Duration;

/// A socket that receives them.
pub(super) struct Datagrams {
    socket: UdpSocket,
    clock: HostClock,
    /// Arrival of the last one.
    last_ns: i64,
}

/// What was received.
pub(super) struct Datagram<'a> {
    pub bytes: &'a [u8],
    pub sender: SocketAddr,
    /// Nanoseconds since 1970 on the host's clock.
    pub arrival_ns: i64,
}

impl Datagrams {
    /// Listens at an address of this computer; nothing is waited for longer than `timeout`.
    ///
    /// # Errors
    /// When the address is not this computer's, or taken.
    pub(super) fn open(address: SocketAddr, timeout: Duration, clock: HostClock) -> io::Result<Self> {
        let socket = UdpSocket::bind(address)?;
        socket.set_read_timeout(Some(timeout))?;
        // A system without them gives none.
        #[cfg(target_os = "linux")]
        let _ = nix::sys::socket::setsockopt(&socket, nix::sys::socket::sockopt::ReceiveTimestampns, &true);
        Ok(Self { socket, clock, last_ns: clock.now_ns() })
    }

    /// The next one.
    ///
    /// # Errors
    /// When there is none in time, or the socket fails.
    pub(super) fn next<'a>(&mut self, buffer: &'a mut [u8]) -> io::Result<Datagram<'a>> {
        let (length, sender, waited) = self.receive(buffer)?;
        let waited_ns = i64::try_from(waited.as_nanos()).unwrap_or(i64::MAX);
        // None came before the last one: the time of day was set forward while this one waited.
        let arrival_ns = self.clock.now_ns().saturating_sub(waited_ns).max(self.last_ns);
        self.last_ns = arrival_ns;
        Ok(Datagram { bytes: buffer.get(..length).unwrap_or_default(), sender, arrival_ns })
    }

    /// Its length, who sent it, and how long it waited.
    #[cfg(target_os = "linux")]
    fn receive(&self, buffer: &mut [u8]) -> io::Result<(usize, SocketAddr, Duration)> {
        use nix::sys::socket::{ControlMessageOwned, MsgFlags, SockaddrStorage, recvmsg};
        use nix::sys::time::TimeSpec;
        use std::os::fd::AsRawFd as _;
        use std::time::SystemTime;

        let mut control = nix::cmsg_space!(TimeSpec);
        let mut parts = [io::IoSliceMut::new(buffer)];
        let message =
            recvmsg::<SockaddrStorage>(self.socket.as_raw_fd(), &mut parts, Some(&mut control), MsgFlags::empty())?;
        let stamp = message.cmsgs().ok().and_then(|mut controls| {
            controls.find_map(|control| match control {
                ControlMessageOwned::ScmTimestampns(since_1970) => Some(Duration::from(since_1970)),
                _ => None,
            })
        });
        // By the computer's time of day; if that was set back meanwhile, nothing is known.
        let came = stamp.and_then(|stamp| SystemTime::UNIX_EPOCH.checked_add(stamp));
        let waited = came.and_then(|came| came.elapsed().ok()).unwrap_or_default();
        let sender = message.address.and_then(|address| {
            let four = address.as_sockaddr_in().map(|four| SocketAddr::V4((*four).into()));
            four.or_else(|| address.as_sockaddr_in6().map(|six| SocketAddr::V6((*six).into())))
        });
        let sender = sender.ok_or_else(|| io::Error::other("a datagram has no sender"))?;
        Ok((message.bytes, sender, waited))
    }

    #[cfg(not(target_os = "linux"))]
    fn receive(&self, buffer: &mut [u8]) -> io::Result<(usize, SocketAddr, Duration)> {
        let (length, sender) = self.socket.recv_from(buffer)?;
        Ok((length, sender, Duration::ZERO))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: i64 = 1_000_000;

    #[test]
    #[cfg(target_os = "linux")]
    fn one_that_waited_has_the_time_at_which_it_came() {
        for here in ["127.0.0.1:0", "[::1]:0"] {
            let clock = HostClock::start();
            let Ok(sender) = UdpSocket::bind(here) else { continue };
            let mut datagrams = Datagrams::open(here.parse().unwrap(), Duration::from_secs(10), clock).unwrap();
            let to = datagrams.socket.local_addr().unwrap();
            // The system begins to stamp a moment after it was told to.
            std::thread::sleep(Duration::from_millis(200));
            let before_ns = clock.now_ns();
            sender.send_to(b"0.1", to).unwrap();
            let after_ns = clock.now_ns();
            std::thread::sleep(Duration::from_millis(300));
            sender.send_to(b"0.2", to).unwrap();
            let mut buffer = [0; 16];
            let datagram = datagrams.next(&mut buffer).unwrap();
            assert_eq!((datagram.bytes, datagram.sender), (b"0.1".as_slice(), sender.local_addr().unwrap()));
            // Two clocks are read one after the other.
            let came = before_ns - 50 * MS..after_ns + 50 * MS;
            assert!(came.contains(&datagram.arrival_ns), "{} of {came:?}", datagram.arrival_ns);
            let first_ns = datagram.arrival_ns;
            assert!(datagrams.next(&mut buffer).unwrap().arrival_ns - first_ns > 250 * MS);
            // Whatever its stamp, none comes before the last.
            datagrams.last_ns = i64::MAX - 1;
            sender.send_to(b"0.3", to).unwrap();
            assert_eq!(datagrams.next(&mut buffer).unwrap().arrival_ns, i64::MAX - 1);
        }
    }

    #[test]
    fn silence_ends_at_the_time_limit() {
        let mut datagrams =
            Datagrams::open(([127, 0, 0, 1], 0).into(), Duration::from_millis(20), HostClock::start()).unwrap();
        let kind = datagrams.next(&mut [0; 16]).err().unwrap().kind();
        assert!(matches!(kind, io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut), "{kind}");
    }
}
