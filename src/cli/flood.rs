//! Keeps libraries from flooding the terminal: shows only the first few messages of each kind.

use parking_lot::Mutex;
use std::collections::HashMap;
use tracing::subscriber::Interest;
use tracing::{Event, Metadata, Subscriber};
use tracing_subscriber::layer::{Context, Filter};

/// Messages shown for each place in a library's code.
const MAX_PER_CALL_SITE: u64 = 5;

/// Passes the first few messages of each place in a library's code, and all of the program's own.
#[derive(Default)]
pub(super) struct Flood(Mutex<HashMap<(&'static str, Option<u32>), u64>>);

impl<S: Subscriber> Filter<S> for Flood {
    fn enabled(&self, _: &Metadata<'_>, _: &Context<'_, S>) -> bool {
        true
    }

    fn callsite_enabled(&self, _: &'static Metadata<'static>) -> Interest {
        Interest::sometimes()
    }

    fn event_enabled(&self, event: &Event<'_>, _: &Context<'_, S>) -> bool {
        let metadata = event.metadata();
        if metadata.target().starts_with("catoptra") {
            return true;
        }
        let mut shown = self.0.lock();
        let count = shown.entry((metadata.name(), metadata.line())).or_default();
        *count += 1;
        *count <= MAX_PER_CALL_SITE
    }
}

impl Flood {
    /// Number of messages not shown.
    #[cfg(test)]
    fn hidden(&self) -> u64 {
        let shown = self.0.lock();
        shown.values().map(|count| count.saturating_sub(MAX_PER_CALL_SITE)).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;
    use std::sync::Arc;
    use tracing_subscriber::Layer as _;
    use tracing_subscriber::layer::SubscriberExt as _;

    #[derive(Clone, Default)]
    struct Lines(Arc<Mutex<Vec<u8>>>);

    impl Write for Lines {
        fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
            self.0.lock().write(bytes)
        }

        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn of_a_library_s_message_the_first_few_are_shown_and_of_our_own_all() {
        let lines = Lines::default();
        let writer = lines.clone();
        let flood = Arc::new(Flood::default());
        struct Shared(Arc<Flood>);
        impl<S: Subscriber> Filter<S> for Shared {
            fn enabled(&self, metadata: &Metadata<'_>, context: &Context<'_, S>) -> bool {
                Filter::<S>::enabled(&*self.0, metadata, context)
            }
            fn event_enabled(&self, event: &Event<'_>, context: &Context<'_, S>) -> bool {
                Filter::<S>::event_enabled(&*self.0, event, context)
            }
        }
        let layer = tracing_subscriber::fmt::layer().with_writer(move || writer.clone());
        let layer = layer.with_filter(Shared(Arc::clone(&flood)));
        tracing::subscriber::with_default(tracing_subscriber::registry().with(layer), || {
            for k in 0..1000 {
                tracing::error!(target: "foxglove", "dropping client {k}");
                tracing::warn!(target: "catoptra::sink", "ours");
            }
        });
        let text = String::from_utf8(lines.0.lock().clone()).unwrap();
        let count = |what: &str| text.lines().filter(|line| line.contains(what)).count();
        assert_eq!((count("dropping client"), count("ours"), flood.hidden()), (5, 1000, 995));
    }
}
