//! A serial device, read as bytes come.

use rustix::fs::OFlags;
use rustix::termios::{OptionalActions, SpecialCodeIndex, tcgetattr, tcsetattr};
use std::fs::File;
use std::io::{self, Read};
use std::os::unix::fs::OpenOptionsExt as _;
use std::path::Path;

/// An open serial device. A read that finds nothing ends after a tenth of a second; of a device that is gone, it fails.
pub(super) struct SerialLine(File);

impl SerialLine {
    /// Opens the device at this speed.
    pub(super) fn open(device: &Path, baud: u32) -> io::Result<Self> {
        // Not as a terminal that ends the program when it is unplugged.
        let no_terminal = i32::try_from(OFlags::NOCTTY.bits()).unwrap_or(0);
        let line = File::options().read(true).write(true).custom_flags(no_terminal).open(device)?;
        let mut settings = tcgetattr(&line)?;
        settings.make_raw();
        settings.set_speed(baud)?;
        settings.special_codes[SpecialCodeIndex::VMIN] = 0;
        settings.special_codes[SpecialCodeIndex::VTIME] = 1;
        tcsetattr(&line, OptionalActions::Now, &settings)?;
        Ok(Self(line))
    }
}

impl Read for SerialLine {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let read = self.0.read(bytes)?;
        // One that was unplugged reads as one that is silent, but has no settings any more.
        if read == 0 {
            tcgetattr(&self.0)?;
        }
        Ok(read)
    }
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::super::CurrentSource;
    use crate::source::host::HostClock;
    use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
    use std::fs::File;
    use std::io::Write as _;
    use std::sync::Arc;
    use std::sync::atomic::AtomicBool;
    use std::sync::mpsc::RecvTimeoutError;
    use std::time::Duration;

    #[test]
    fn a_device_that_is_unplugged_ends_the_currents_and_one_that_is_silent_does_not() {
        let far = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY).unwrap();
        grantpt(&far).unwrap();
        unlockpt(&far).unwrap();
        let device = ptsname(&far, Vec::new()).unwrap().into_string().unwrap();
        let mut far = File::from(far);
        let source: CurrentSource = format!("serial:{device}").parse().unwrap();
        let stop = Arc::new(AtomicBool::new(false));
        let samples = source.open(10.0, HostClock::start(), &stop).unwrap().samples;
        far.write_all(b"{\"current_a\":[0.25,0]}\n").unwrap();
        assert_eq!(samples.recv_timeout(Duration::from_secs(10)).unwrap().current_a, [0.25, 0.0]);
        assert_eq!(samples.recv_timeout(Duration::from_millis(500)), Err(RecvTimeoutError::Timeout));
        drop(far);
        assert_eq!(samples.recv_timeout(Duration::from_secs(10)), Err(RecvTimeoutError::Disconnected));
    }
}
