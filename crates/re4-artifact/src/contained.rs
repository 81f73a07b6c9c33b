//! The Parquet decoder, kept from ending the program.
//!
//! Every command compares a table's bytes with their published hash before it decodes them, so that damage never gets here.
//! A table forged together with its hash does, and there the decoder of the library panics in places; the panic is turned
//! into the error that the library should have given. Of a page that claims a length or a count the library reserves up to
//! 2 GiB and counts to 2^32; that is not prevented.

use std::cell::Cell;
use std::panic::{AssertUnwindSafe, catch_unwind, set_hook, take_hook};
use std::sync::Once;

use parquet::errors::ParquetError;

thread_local! {
    static CONTAINED: Cell<bool> = const { Cell::new(false) };
}

/// Decodes; a panic is an error too, and not printed. What was being read may be in any state afterwards: drop it.
pub(crate) fn contained<T>(decode: impl FnOnce() -> Result<T, ParquetError>) -> Result<T, ParquetError> {
    static HUSHED: Once = Once::new();
    HUSHED.call_once(|| {
        let loud = take_hook();
        set_hook(Box::new(move |panic| {
            if !CONTAINED.get() {
                loud(panic);
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
        Err(ParquetError::General(format!("it is no valid Parquet file ({why})")))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_is_an_error_and_the_next_one_is_not_hushed() {
        assert!(matches!(contained(|| Ok(1)), Ok(1)));
        let said = |decode: fn()| {
            contained(|| {
                decode();
                Ok(())
            })
            .unwrap_err()
            .to_string()
        };
        assert_eq!(
            said(|| panic!("a\nb")),
            "Parquet error: it is no valid Parquet file (a)"
        );
        assert_eq!(
            said(|| assert!(std::hint::black_box(false), "{}", 7)),
            "Parquet error: it is no valid Parquet file (7)"
        );
        assert!(!CONTAINED.get());
    }
}
