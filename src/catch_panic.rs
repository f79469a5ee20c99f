//! Calls into libraries that panic on hostile input: a panic becomes `None`, without a message.

use std::cell::Cell;
use std::panic::{AssertUnwindSafe, catch_unwind, set_hook, take_hook};
use std::sync::Once;

thread_local! {
    static CATCHING: Cell<bool> = const { Cell::new(false) };
}

/// The result of `call`; `None` when it panics. Anything it was changing must not be used after that.
pub(crate) fn catch_panic<T>(call: impl FnOnce() -> T) -> Option<T> {
    static QUIET: Once = Once::new();
    // A caught panic prints nothing.
    QUIET.call_once(|| {
        let hook = take_hook();
        set_hook(Box::new(move |panic| {
            if !CATCHING.get() {
                hook(panic);
            }
        }));
    });
    let before = CATCHING.replace(true);
    let result = catch_unwind(AssertUnwindSafe(call));
    CATCHING.set(before);
    result.ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_is_none_and_what_follows_works() {
        assert_eq!(catch_panic(|| 3), Some(3));
        let empty: Vec<u8> = Vec::new();
        assert_eq!(catch_panic(|| empty[3]), None);
        assert_eq!(catch_panic(|| 4), Some(4));
        assert!(!CATCHING.get());
    }
}
