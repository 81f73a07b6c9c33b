//! Conversion of panics in libraries that decode files to errors.
//!
//! The Parquet, PNG and video decoders are written for valid files and panic on some damaged ones. Such a panic is an error of the
//! file. What this module cannot prevent is an abort, or a decoder that reserves much memory: the caller runs in a process of its own
//! with a memory limit, as for HDF5 files.

use std::cell::Cell;
use std::panic::{AssertUnwindSafe, catch_unwind, set_hook, take_hook};
use std::sync::Once;

thread_local! {
    static CONTAINED: Cell<bool> = const { Cell::new(false) };
}

/// Runs `decode` and returns a panic as the reason of an error, without printing it.
///
/// After an error, whatever `decode` borrowed mutably may be in an inconsistent state and must be dropped.
pub(crate) fn contained<T>(decode: impl FnOnce() -> Result<T, String>) -> Result<T, String> {
    // The panic hook is global. It is replaced once, by one that is silent only on threads that are inside this function.
    static HOOK: Once = Once::new();
    HOOK.call_once(|| {
        let previous = take_hook();
        set_hook(Box::new(move |panic| {
            if !CONTAINED.get() {
                previous(panic);
            }
        }));
    });
    let outer = CONTAINED.replace(true);
    let outcome = catch_unwind(AssertUnwindSafe(decode));
    CONTAINED.set(outer);
    outcome.unwrap_or_else(|panic| {
        let why = panic
            .downcast_ref::<String>()
            .map(String::as_str)
            .or_else(|| panic.downcast_ref::<&str>().copied())
            .unwrap_or("no reason given");
        let why = why.split('\n').next().unwrap_or(why);
        Err(format!("the decoder stopped ({why})"))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_becomes_a_reason() {
        assert_eq!(contained(|| Ok(1)), Ok(1));
        let stopped = contained(|| {
            if std::hint::black_box(true) {
                panic!("a\nb")
            } else {
                Ok(())
            }
        });
        assert_eq!(stopped, Err("the decoder stopped (a)".to_owned()));
        assert!(!CONTAINED.get());
    }
}
