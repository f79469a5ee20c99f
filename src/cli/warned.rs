//! Warnings that belong to one recording, or to one command: collected while they are printed.
//!
//! A span represents the work; a warning within it, in any thread, belongs to it. The threads of a run inherit the span
//! ([`crate::pipeline::run`]).

use parking_lot::{Mutex, MutexGuard};
use std::collections::HashMap;
use std::fmt::{self, Write as _};
use std::sync::LazyLock;
use tracing::field::{Field, Visit};
use tracing::span::{Attributes, Id};
use tracing::{Event, Level, Metadata, Span, Subscriber};
use tracing_subscriber::Layer;
use tracing_subscriber::filter::{FilterFn, LevelFilter, filter_fn};
use tracing_subscriber::layer::{Context, Filter};
use tracing_subscriber::registry::LookupSpan;

/// Warnings that are kept; more are counted.
const MAX_KEPT: usize = 100;
/// Target of the spans: nobody else is to see them.
pub(super) const TARGET: &str = "work";

/// Of the spans that are open.
static OPEN: LazyLock<Mutex<HashMap<u64, Warnings>>> = LazyLock::new(Mutex::default);

/// What was warned of.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct Warnings {
    /// The first ones.
    pub(super) warnings: Vec<String>,
    /// How many more.
    pub(super) more: u64,
}

/// A piece of work whose warnings are collected.
pub(super) struct Work(Span);

impl Work {
    pub(super) fn new() -> Self {
        Self(tracing::warn_span!(target: TARGET, "work"))
    }

    /// Does a part of it.
    pub(super) fn within<T>(&self, part: impl FnOnce() -> T) -> T {
        self.0.in_scope(part)
    }

    /// What was warned of so far.
    pub(super) fn warned(&self) -> Warnings {
        self.0.id().and_then(|id| open().get(&id.into_u64()).cloned()).unwrap_or_default()
    }
}

fn open() -> MutexGuard<'static, HashMap<u64, Warnings>> {
    OPEN.lock()
}

/// Collects; a part of the program's subscriber.
pub(super) struct Collector;

/// What the collector is to see: the spans, and our own warnings.
pub(super) fn seen() -> FilterFn<impl Fn(&Metadata<'_>) -> bool> {
    let seen = filter_fn(|metadata: &Metadata<'_>| {
        let ours = metadata.is_event() && *metadata.level() <= Level::WARN && metadata.target().starts_with("catoptra");
        ours || metadata.is_span() && metadata.target() == TARGET
    });
    // Without it every level counts as wanted by somebody.
    seen.with_max_level_hint(LevelFilter::WARN)
}

impl<S: Subscriber + for<'a> LookupSpan<'a>> Layer<S> for Collector {
    fn on_new_span(&self, _: &Attributes<'_>, id: &Id, _: Context<'_, S>) {
        open().insert(id.into_u64(), Warnings::default());
    }

    fn on_event(&self, event: &Event<'_>, context: Context<'_, S>) {
        let Some(span) = context.event_scope(event).and_then(|mut scope| scope.next()) else { return };
        let mut text = Text::default();
        event.record(&mut text);
        if let Some(warned) = open().get_mut(&span.id().into_u64()) {
            match warned.warnings.len() < MAX_KEPT {
                true => warned.warnings.push(text.0),
                false => warned.more += 1,
            }
        }
    }

    fn on_close(&self, id: Id, _: Context<'_, S>) {
        open().remove(&id.into_u64());
    }
}

/// The message, and other fields behind it.
#[derive(Default)]
struct Text(String);

impl Visit for Text {
    fn record_debug(&mut self, field: &Field, value: &dyn fmt::Debug) {
        // Writing to memory cannot fail.
        let _ = match field.name() {
            "message" => {
                let others = std::mem::take(&mut self.0);
                write!(self.0, "{value:?}{others}")
            }
            name => write!(self.0, " {name}={value:?}"),
        };
    }
}

/// Two filters of which both must agree.
pub(super) struct Both<A, B>(pub(super) A, pub(super) B);

impl<S, A: Filter<S>, B: Filter<S>> Filter<S> for Both<A, B> {
    fn enabled(&self, metadata: &Metadata<'_>, context: &Context<'_, S>) -> bool {
        self.0.enabled(metadata, context) && self.1.enabled(metadata, context)
    }

    fn event_enabled(&self, event: &Event<'_>, context: &Context<'_, S>) -> bool {
        self.0.event_enabled(event, context) && self.1.event_enabled(event, context)
    }

    fn max_level_hint(&self) -> Option<LevelFilter> {
        self.0.max_level_hint()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tracing_subscriber::layer::SubscriberExt as _;

    #[test]
    fn warnings_of_all_threads_are_collected_and_those_of_others_are_not() {
        let subscriber = tracing_subscriber::registry().with(Collector.with_filter(seen()));
        let dispatch = tracing::Dispatch::new(subscriber);
        tracing::dispatcher::with_default(&dispatch, || {
            let (one, other) = (Work::new(), Work::new());
            tracing::warn!(target: "catoptra", "of nobody");
            one.within(|| {
                tracing::warn!(target: "catoptra::a", stamp_ns = 3, "first {}", 1);
                tracing::warn!(target: "library", "not ours");
                tracing::info!(target: "catoptra", "no warning");
                let span = Span::current();
                std::thread::scope(|scope| {
                    scope.spawn(|| {
                        tracing::dispatcher::with_default(&dispatch, || {
                            span.in_scope(|| tracing::warn!(target: "catoptra", "second"));
                        });
                    });
                });
            });
            assert_eq!(
                one.warned(),
                Warnings { warnings: vec!["first 1 stamp_ns=3".into(), "second".into()], more: 0 }
            );
            other.within(|| (0..103).for_each(|k| tracing::warn!(target: "catoptra", "{k}")));
            assert_eq!((other.warned().warnings.len(), other.warned().more), (100, 3));
        });
    }
}
