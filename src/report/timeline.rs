//! The course of a run in bounded memory: values and misses over time in at most [`MAX_BINS`] bins.
//!
//! Every bin holds the same number of frames: one at first; when all bins are used, neighbours are merged and each
//! holds twice as many. A bin keeps the smallest and the largest value of every channel with their times, so no peak is
//! lost, however long the run. Runs of up to [`MAX_BINS`] frames are kept frame by frame.

/// More than the pixels across any plot.
const MAX_BINS: usize = 4096;

/// Smallest and largest value of one channel in one bin.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Extremes {
    /// Time and value.
    pub low: (f64, f64),
    pub high: (f64, f64),
}

/// Some consecutive frames.
#[derive(Debug, Clone, Default)]
pub(super) struct Bin {
    /// Time of the first and the last frame, seconds.
    pub from_s: f64,
    pub to_s: f64,
    /// Time of the frame before the first, seconds: where a gap began.
    pub before_s: f64,
    /// Frames in it.
    pub frames: u32,
    /// Camera frames lost before its first frame, and anywhere in it.
    pub lost_before: u64,
    pub lost: u64,
    /// One entry per channel; `None`: never measured in this bin.
    pub channels: Vec<Option<Extremes>>,
    /// Frames missed, by index of the reason.
    pub misses: Vec<u32>,
}

/// Values over time.
#[derive(Debug)]
pub(super) struct Timeline {
    bins: Vec<Bin>,
    frames_per_bin: u32,
}

impl Default for Timeline {
    fn default() -> Self {
        Self { bins: Vec::new(), frames_per_bin: 1 }
    }
}

impl Timeline {
    /// Adds a frame: its time, frames lost before it, the value of each channel, and the reasons of its misses.
    pub(super) fn push(&mut self, t_s: f64, lost: u64, values: &[Option<f64>], misses: &[usize]) {
        let mut counts = vec![0; misses.iter().max().map_or(0, |m| m + 1)];
        for miss in misses {
            if let Some(count) = counts.get_mut(*miss) {
                *count = 1;
            }
        }
        let channels = values.iter().map(|v| {
            let value = v.filter(|v| v.is_finite())?;
            Some(Extremes { low: (t_s, value), high: (t_s, value) })
        });
        let frame = Bin {
            from_s: t_s,
            to_s: t_s,
            before_s: self.bins.last().map_or(t_s, |b| b.to_s),
            frames: 1,
            lost_before: lost,
            lost,
            channels: channels.collect(),
            misses: counts,
        };
        match self.bins.last_mut() {
            Some(last) if last.frames < self.frames_per_bin => last.join(frame),
            _ => {
                if self.bins.len() >= MAX_BINS {
                    self.halve();
                }
                self.bins.push(frame);
            }
        }
    }

    pub(super) fn bins(&self) -> &[Bin] {
        &self.bins
    }

    /// Frames in every bin but the last.
    pub(super) fn frames_per_bin(&self) -> u32 {
        self.frames_per_bin
    }

    fn halve(&mut self) {
        let mut joined: Vec<Bin> = Vec::with_capacity(MAX_BINS);
        for (k, bin) in self.bins.drain(..).enumerate() {
            match joined.last_mut() {
                Some(last) if k % 2 == 1 => last.join(bin),
                _ => joined.push(bin),
            }
        }
        self.bins = joined;
        self.frames_per_bin = self.frames_per_bin.saturating_mul(2);
    }
}

impl Bin {
    fn join(&mut self, later: Self) {
        self.to_s = later.to_s;
        self.frames += later.frames;
        self.lost += later.lost;
        for (mine, theirs) in self.channels.iter_mut().zip(later.channels) {
            *mine = match (*mine, theirs) {
                (Some(a), Some(b)) => Some(Extremes {
                    low: if b.low.1 < a.low.1 { b.low } else { a.low },
                    high: if b.high.1 > a.high.1 { b.high } else { a.high },
                }),
                (a, b) => a.or(b),
            };
        }
        if self.misses.len() < later.misses.len() {
            self.misses.resize(later.misses.len(), 0);
        }
        for (mine, theirs) in self.misses.iter_mut().zip(later.misses) {
            *mine += theirs;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_peak_of_one_frame_survives_any_length() {
        let mut line = Timeline::default();
        let (n, peak) = (10 * MAX_BINS + 123, 23_457);
        for k in 0..n {
            let value = if k == peak { 99.0 } else { 1.0 };
            let lost = u64::from(k == 30_000) * 5;
            line.push(k as f64, lost, &[Some(value), None], if k == peak + 1 { &[2] } else { &[] });
        }
        assert!(line.bins().len() <= MAX_BINS && line.bins().len() > MAX_BINS / 2);
        assert_eq!(line.frames_per_bin(), 16);
        assert_eq!(line.bins().iter().map(|b| u64::from(b.frames)).sum::<u64>(), n as u64);
        assert_eq!(line.bins().iter().map(|b| b.lost).sum::<u64>(), 5);
        let found: Vec<_> = line.bins().iter().filter_map(|b| b.channels[0]).filter(|e| e.high.1 > 50.0).collect();
        assert_eq!(found.len(), 1);
        assert_eq!((found[0].high, found[0].low.1), ((peak as f64, 99.0), 1.0));
        assert!(line.bins().iter().all(|b| b.channels[1].is_none()));
        assert_eq!(line.bins().iter().map(|b| b.misses.get(2).copied().unwrap_or(0)).sum::<u32>(), 1);
    }

    #[test]
    fn what_is_no_number_counts_as_not_measured() {
        let mut line = Timeline::default();
        line.push(0.0, 0, &[Some(f64::NAN), Some(f64::INFINITY), Some(2.0)], &[]);
        assert!(line.bins()[0].channels[0].is_none() && line.bins()[0].channels[1].is_none());
        assert_eq!(line.bins()[0].channels[2].unwrap().low, (0.0, 2.0));
    }
}
