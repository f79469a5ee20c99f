//! Maps the host's clock to the camera's, with frames that have both times.

/// Camera time of any moment of the host's clock.
///
/// Linear between two frames; before the first and after the last with their offsets. If the camera's clock restarts,
/// the old offset applies up to the next frame. It cannot know the minimum delay from exposure to arrival, by which all
/// host times are late.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ClockMap {
    /// (host, camera), in order of host time, at least one.
    pairs: Vec<(i64, i64)>,
}

impl ClockMap {
    /// Of pairs (host, camera) in nanoseconds; `None` without any.
    pub(super) fn new(mut pairs: Vec<(i64, i64)>) -> Option<Self> {
        pairs.sort_unstable();
        (!pairs.is_empty()).then_some(Self { pairs })
    }

    /// Camera time of a moment of the host's clock, nanoseconds.
    pub fn camera_ns(&self, host_ns: i64) -> i64 {
        let after = self.pairs.partition_point(|(host, _)| *host <= host_ns);
        let before = after.checked_sub(1).and_then(|k| self.pairs.get(k));
        match (before, self.pairs.get(after)) {
            (Some(before), Some(after)) => between(*before, *after, host_ns),
            (Some(end), None) | (None, Some(end)) => end.1.saturating_add(host_ns.saturating_sub(end.0)),
            // There is at least one pair.
            (None, None) => host_ns,
        }
    }

    /// Host's times of the first and the last frame, nanoseconds.
    pub fn host_span_ns(&self) -> (i64, i64) {
        let first = self.pairs.first().map_or(0, |(host, _)| *host);
        (first, self.pairs.last().map_or(first, |(host, _)| *host))
    }
}

fn between(before: (i64, i64), after: (i64, i64), host_ns: i64) -> i64 {
    let (host, camera) = (after.0.saturating_sub(before.0), after.1.saturating_sub(before.1));
    let since = host_ns.saturating_sub(before.0);
    if host <= 0 || camera <= 0 {
        return before.1.saturating_add(since);
    }
    let along = i128::from(since) * i128::from(camera) / i128::from(host);
    before.1.saturating_add(i64::try_from(along).unwrap_or(since))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn between_frames_by_the_line_and_outside_by_the_offset() {
        let map = ClockMap::new(vec![(1000, 10), (2000, 1020), (3000, 2020)]).unwrap();
        assert_eq!([1000, 1500, 2000, 2500].map(|host| map.camera_ns(host)), [10, 515, 1020, 1520]);
        assert_eq!([900, 3100].map(|host| map.camera_ns(host)), [-90, 2120]);
        assert_eq!(map.host_span_ns(), (1000, 3000));
        assert_eq!(ClockMap::new(Vec::new()), None);
    }

    #[test]
    fn a_camera_clock_that_begins_anew_is_not_interpolated_across() {
        let map = ClockMap::new(vec![(1000, 5000), (2000, 0), (3000, 1000)]).unwrap();
        assert_eq!([1999, 2000, 2500].map(|host| map.camera_ns(host)), [5999, 0, 500]);
    }

    #[test]
    fn times_since_1970_keep_every_nanosecond() {
        let start = 1_700_000_000_123_456_789;
        let map = ClockMap::new(vec![(start, 7), (start + 16_666_667, 16_666_674)]).unwrap();
        assert_eq!(map.camera_ns(start + 1), 8);
        assert_eq!(map.camera_ns(start + 16_666_666), 16_666_673);
    }
}
