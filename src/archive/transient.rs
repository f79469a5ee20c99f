//! Transient failures: of disks and networks, not of the data.

use std::error::Error;
use std::io::{self, ErrorKind};

/// Error numbers of Linux that [`ErrorKind`] has no stable name for: input/output error, too many open files (in the
/// system, in the process).
#[cfg(target_os = "linux")]
const TRANSIENT_ERRORS: [i32; 3] = [5, 23, 24];
#[cfg(not(target_os = "linux"))]
const TRANSIENT_ERRORS: [i32; 0] = [];

/// Whether the same run may succeed another time: the chain of causes contains a full disk, or an unavailable network
/// or file system.
pub(crate) fn is_transient(error: &(dyn Error + 'static)) -> bool {
    let mut cause = Some(error);
    while let Some(this) = cause {
        if this.downcast_ref::<io::Error>().is_some_and(of_system) {
            return true;
        }
        // The system's error behind libav's.
        if let Some(ffmpeg_the_third::Error::Other { errno }) = this.downcast_ref() {
            return of_system(&io::Error::from_raw_os_error(*errno));
        }
        cause = this.source();
    }
    false
}

fn of_system(error: &io::Error) -> bool {
    let kind = matches!(
        error.kind(),
        ErrorKind::StorageFull
            | ErrorKind::QuotaExceeded
            | ErrorKind::ReadOnlyFilesystem
            | ErrorKind::StaleNetworkFileHandle
            | ErrorKind::TimedOut
            | ErrorKind::HostUnreachable
            | ErrorKind::NetworkUnreachable
            | ErrorKind::NetworkDown
            | ErrorKind::NotConnected
            | ErrorKind::ConnectionRefused
            | ErrorKind::ConnectionReset
            | ErrorKind::ConnectionAborted
            | ErrorKind::BrokenPipe
            | ErrorKind::Interrupted
            | ErrorKind::WouldBlock
            | ErrorKind::ResourceBusy
            | ErrorKind::OutOfMemory
            | ErrorKind::FileTooLarge
    );
    kind || error.raw_os_error().is_some_and(|number| TRANSIENT_ERRORS.contains(&number))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sink::SinkError;

    #[test]
    fn disks_and_networks_pass_and_what_was_read_does_not() {
        let full = || io::Error::from(ErrorKind::StorageFull);
        assert!(is_transient(&full()));
        assert!(is_transient(&SinkError::Io { path: "a".into(), source: full() }));
        assert!(!is_transient(&io::Error::from(ErrorKind::NotFound)));
        assert!(!is_transient(&io::Error::from(ErrorKind::InvalidData)));
        assert!(!is_transient(&SinkError::NoBaseFrame { path: "a".into() }));
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn numbers_of_the_system_are_known() {
        for (number, expected) in [(28, true), (5, true), (116, true), (122, true), (30, true), (2, false), (13, false)]
        {
            assert_eq!(is_transient(&io::Error::from_raw_os_error(number)), expected, "{number}");
            let source = ffmpeg_the_third::Error::Other { errno: number };
            let video = SinkError::Video { path: "a".into(), doing: "opening", source };
            assert_eq!(is_transient(&video), expected, "{number} from libav");
        }
    }
}
