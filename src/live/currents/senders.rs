//! Who sends datagrams of currents: one program, or several.
//!
//! A program may send each datagram from another port. Several computers that send, and two programs that send by
//! turns, are told.

use std::collections::BTreeMap;
use std::net::SocketAddr;

/// Senders that are counted apart.
const MAX_SENDERS: usize = 64;

/// Senders, and how many datagrams each has sent.
#[derive(Debug, Default)]
pub(super) struct Senders {
    datagrams: BTreeMap<SocketAddr, u64>,
    last: Option<SocketAddr>,
    /// Whether several computers send, or programs that alternate.
    several: bool,
}

impl Senders {
    /// Counts a datagram; `name` of the currents, for messages.
    pub(super) fn count(&mut self, sender: SocketAddr, name: &str) {
        let last = self.last.replace(sender);
        let (here, many) = (sender.ip(), self.datagrams.len());
        let is_new = self.datagrams.keys().all(|known| known.ip() != here);
        match self.datagrams.get_mut(&sender) {
            Some(datagrams) => {
                *datagrams += 1;
                if let Some(other) = last.filter(|other| *other != sender && !self.several) {
                    self.several = true;
                    tracing::warn!(
                        "{name}: currents come from {other} and {sender} alternately: two programs send them"
                    );
                }
            }
            None if many == MAX_SENDERS => {}
            None => {
                match many {
                    0 => tracing::info!("{name}: currents come from {here}"),
                    _ if is_new => tracing::warn!("{name}: currents come from {here} too: several computers send them"),
                    _ => {}
                }
                self.several |= is_new && many > 0;
                self.datagrams.insert(sender, 1);
            }
        }
    }

    /// How many datagrams each has sent, if there are several.
    pub(super) fn report(&self) -> Option<String> {
        let each = self.datagrams.iter().map(|(who, n)| format!("{n} from {who}"));
        self.several.then(|| format!("datagrams: {}", each.collect::<Vec<_>>().join(", ")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_programs_that_send_by_turns_are_told_from_one() {
        let several = |ports: &[u16]| {
            let mut senders = Senders::default();
            ports.iter().for_each(|port| senders.count(([127, 0, 0, 1], *port).into(), "test"));
            senders.report().is_some()
        };
        assert!(several(&[5000, 5001, 5000]));
        // One that is started again, and one that takes another port each time.
        assert!(!several(&[5000, 5000, 5001, 5001]));
        assert!(!several(&(5000..5200).collect::<Vec<_>>()));
    }
}
