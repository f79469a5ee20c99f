//! On which processors the tracker's threads run.

/// In a virtual machine, gives the thread of this number among `count` its own share of the processors, so that they
/// work side by side.
///
/// Linux wakes a thread on an idle processor, but takes a virtual one that has been idle for some milliseconds for one
/// that the host has taken away: all threads that a frame wakes then share one processor, and the frame takes half as
/// long again. On a real machine the system knows best.
pub(super) fn keep_apart(number: usize, count: usize) {
    #[cfg(target_os = "linux")]
    if is_virtual()
        && let Ok(allowed) = rustix::thread::sched_getaffinity(None)
    {
        let allowed: Vec<usize> = (0..rustix::thread::CpuSet::MAX_CPU).filter(|cpu| allowed.is_set(*cpu)).collect();
        if count > allowed.len() {
            return;
        }
        let mut own = rustix::thread::CpuSet::new();
        share(&allowed, number, count).iter().for_each(|cpu| own.set(*cpu));
        if let Err(error) = rustix::thread::sched_setaffinity(None, &own) {
            tracing::debug!("a thread keeps all processors: {error}");
        }
    }
    #[cfg(not(target_os = "linux"))]
    let _ = (number, count);
}

/// One of `count` equal shares.
#[cfg(target_os = "linux")]
fn share(all: &[usize], number: usize, count: usize) -> &[usize] {
    let bound = |k: usize| k * all.len() / count.max(1);
    all.get(bound(number)..bound(number + 1)).unwrap_or_default()
}

#[cfg(target_os = "linux")]
fn is_virtual() -> bool {
    let processors = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    processors.lines().any(|line| line.starts_with("flags") && line.split(' ').any(|flag| flag == "hypervisor"))
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;

    #[test]
    fn the_shares_are_apart_and_nothing_is_left() {
        let all: Vec<usize> = (3..14).collect();
        for count in 1..=all.len() {
            let shares: Vec<&[usize]> = (0..count).map(|number| share(&all, number, count)).collect();
            assert!(shares.iter().all(|share| !share.is_empty()), "{count}");
            assert_eq!(shares.concat(), all);
        }
    }
}
