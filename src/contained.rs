//! Calls into libraries that panic on hostile input: a panic becomes `None`, and says nothing.

use std::cell::Cell;
use std::panic::{AssertUnwindSafe, catch_unwind, set_hook, take_hook};
use std::sync::Once;

thread_local! {
    static CONTAINED: Cell<bool> = const { Cell::new(false) };
}

/// What `call` gives; `None` when it panics. What it has changed by then must not be used any more.
pub(crate) fn contained<T>(call: impl FnOnce() -> T) -> Option<T> {
    static QUIET: Once = Once::new();
    // Of a panic that is contained, nobody need hear.
    QUIET.call_once(|| {
        let hook = take_hook();
        set_hook(Box::new(move |panic| {
            if !CONTAINED.get() {
                hook(panic);
            }
        }));
    });
    let before = CONTAINED.replace(true);
    let result = catch_unwind(AssertUnwindSafe(call));
    CONTAINED.set(before);
    result.ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_is_none_and_what_follows_works() {
        assert_eq!(contained(|| 3), Some(3));
        let empty: Vec<u8> = Vec::new();
        assert_eq!(contained(|| empty[3]), None);
        assert_eq!(contained(|| 4), Some(4));
        assert!(!CONTAINED.get());
    }
}
