//! Conversion of panics in the Parquet decoder to errors.
//!
//! Every command compares a table's bytes with their published hash before it decodes them, so damaged files do not reach the
//! decoder. A table that was forged together with its hash does reach it, and the decoder of the `parquet` crate panics on some
//! of these tables. This module converts such a panic to the error that the crate should have returned. It does not limit the
//! work of the decoder: for a page header with a wrong length or count, the crate allocates up to 2 GiB and loops up to 2^32
//! times.

use std::cell::Cell;
use std::panic::{AssertUnwindSafe, catch_unwind, set_hook, take_hook};
use std::sync::Once;

use parquet::errors::ParquetError;

thread_local! {
    static CONTAINED: Cell<bool> = const { Cell::new(false) };
}

/// Runs `decode` and returns a panic as an error, without printing it.
///
/// After an error the reader may be in an inconsistent state and must be dropped.
pub(crate) fn contained<T>(decode: impl FnOnce() -> Result<T, ParquetError>) -> Result<T, ParquetError> {
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
        Err(ParquetError::General(format!("it is not a valid Parquet file ({why})")))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_becomes_an_error_and_later_panics_are_printed() {
        assert!(matches!(contained(|| Ok(1)), Ok(1)));
        let message = |decode: fn()| {
            contained(|| {
                decode();
                Ok(())
            })
            .unwrap_err()
            .to_string()
        };
        assert_eq!(
            message(|| panic!("a\nb")),
            "Parquet error: it is not a valid Parquet file (a)"
        );
        assert_eq!(
            message(|| assert!(std::hint::black_box(false), "{}", 7)),
            "Parquet error: it is not a valid Parquet file (7)"
        );
        assert!(!CONTAINED.get());
    }
}
