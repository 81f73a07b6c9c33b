//! Errors with remedies.
//!
//! The text of an error ([`Display`](fmt::Display)) says what is wrong, in which file and with which object. Its [`Remedy`] says
//! how to fix it. They are separate, so that text output can join them and JSON output can keep them in two fields.
//!
//! Library crates derive [`Remedy`] for their error enums. The crates above them create a [`Fault`] with [`fault!`], [`bail!`]
//! and [`ensure!`].
//!
//! ```
//! use re4_fault::{Fault, Remedy as _, fault};
//!
//! let error: Fault = fault!("there is no file {}", "a.zarr"; "check the path");
//! assert_eq!(error.to_string(), "there is no file a.zarr");
//! assert_eq!(error.sentence(), "there is no file a.zarr; check the path");
//! ```

use std::borrow::Cow;
use std::error::Error;
use std::fmt;

#[doc(hidden)]
pub use anyhow;
pub use re4_fault_derive::Remedy;

/// An error that may have a remedy.
pub trait Remedy: fmt::Display {
    /// How to fix the error, in the imperative, in lower case and without a full stop: `give a smaller --jobs`.
    fn remedy(&self) -> Option<Cow<'_, str>>;

    /// What is wrong and how to fix it, joined by a semicolon.
    fn sentence(&self) -> String {
        join(&self.to_string(), self.remedy().as_deref())
    }
}

impl<T: Remedy + ?Sized> Remedy for Box<T> {
    fn remedy(&self) -> Option<Cow<'_, str>> {
        (**self).remedy()
    }
}

/// Joins the text of an error and its remedy by a semicolon.
pub fn join(what: &str, remedy: Option<&str>) -> String {
    match remedy {
        Some(remedy) if !remedy.is_empty() => [what, "; ", remedy].concat(),
        _ => what.to_owned(),
    }
}

/// An error made of what is wrong, a remedy and a cause.
#[derive(Debug)]
pub struct Fault {
    what: String,
    remedy: Option<String>,
    source: Option<anyhow::Error>,
}

impl Fault {
    /// Creates a fault from what is wrong and, if there is one, the remedy.
    pub fn new(what: impl Into<String>, remedy: Option<impl Into<String>>) -> Self {
        Self {
            what: what.into(),
            remedy: remedy.map(Into::into),
            source: None,
        }
    }

    /// Creates a fault with the text and remedy of another error.
    pub fn of(error: &impl Remedy) -> Self {
        Self::new(error.to_string(), error.remedy())
    }

    /// Puts the place of the fault in front of its text: `{place}{what}`.
    #[must_use]
    pub fn at(self, place: impl fmt::Display) -> Self {
        Self {
            what: format!("{place}{}", self.what),
            ..self
        }
    }

    /// Splits a sentence of [`Remedy::sentence`] at its first semicolon. For errors that passed through the parser of another
    /// crate, which keeps only their text.
    pub fn from_sentence(sentence: &str) -> Self {
        match sentence.split_once("; ") {
            Some((what, remedy)) => Self::new(what, Some(remedy)),
            None => Self::new(sentence, None::<String>),
        }
    }

    /// Sets the error that caused the fault.
    #[must_use]
    pub fn because(self, source: impl Into<anyhow::Error>) -> Self {
        Self {
            source: Some(source.into()),
            ..self
        }
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.what)
    }
}

impl Error for Fault {
    fn source(&self) -> Option<&(dyn Error + 'static)> {
        self.source.as_ref().map(AsRef::as_ref)
    }
}

impl Remedy for Fault {
    fn remedy(&self) -> Option<Cow<'_, str>> {
        self.remedy.as_deref().map(Cow::Borrowed)
    }
}

/// Converts an error or a missing value to a [`Fault`].
pub trait OrFault<T> {
    /// Returns the value, or `fault()` with the original error as its source.
    ///
    /// # Errors
    /// If the result is an error or the option is `None`.
    fn or_fault(self, fault: impl FnOnce() -> Fault) -> anyhow::Result<T>;
}

impl<T, E: Into<anyhow::Error>> OrFault<T> for Result<T, E> {
    fn or_fault(self, fault: impl FnOnce() -> Fault) -> anyhow::Result<T> {
        self.map_err(|error| fault().because(error).into())
    }
}

impl<T> OrFault<T> for Option<T> {
    fn or_fault(self, fault: impl FnOnce() -> Fault) -> anyhow::Result<T> {
        self.ok_or_else(|| fault().into())
    }
}

/// Creates a [`Fault`]: `fault!("there is no file {}", path.display(); "check the path")`. The part after the semicolon is the
/// remedy and is optional.
#[macro_export]
macro_rules! fault {
    ($what:literal $(, $part:expr)* $(,)?) => {
        $crate::Fault::new(::std::format!($what $(, $part)*), ::std::option::Option::None::<::std::string::String>)
    };
    ($what:literal $(, $part:expr)* ; $remedy:literal $(, $of:expr)* $(,)?) => {
        $crate::Fault::new(
            ::std::format!($what $(, $part)*),
            ::std::option::Option::Some(::std::format!($remedy $(, $of)*)),
        )
    };
}

/// Returns a [`fault!`] as an [`anyhow::Error`].
#[macro_export]
macro_rules! bail {
    ($($fault:tt)*) => {
        return ::std::result::Result::Err($crate::anyhow::Error::from($crate::fault!($($fault)*)))
    };
}

/// Returns a [`fault!`] as an [`anyhow::Error`] if a condition is false.
#[macro_export]
macro_rules! ensure {
    ($condition:expr, $($fault:tt)*) => {
        if !$condition {
            $crate::bail!($($fault)*);
        }
    };
}

// The derive macro generates the path `::re4_fault::Remedy`, which must also resolve in the tests of this crate.
#[cfg(test)]
extern crate self as re4_fault;

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, thiserror::Error, Remedy)]
    enum Broken {
        #[error("{name} is {size} px")]
        #[remedy("give {} to {maximum}", 1)]
        Size {
            name: &'static str,
            size: u32,
            maximum: u32,
        },
        #[error("no disk: {0}")]
        #[remedy(_0.remedy())]
        Disk(Box<Broken>),
        #[error("it is late")]
        Late,
    }

    #[test]
    fn each_variant_has_its_remedy() {
        let size = || Broken::Size {
            name: "width",
            size: 9,
            maximum: 4,
        };
        assert_eq!(size().sentence(), "width is 9 px; give 1 to 4");
        assert_eq!(
            Broken::Disk(Box::new(size())).sentence(),
            "no disk: width is 9 px; give 1 to 4"
        );
        assert_eq!(
            (Broken::Late.remedy(), Broken::Late.sentence()),
            (None, "it is late".to_owned())
        );
    }

    fn checked(jobs: u32) -> anyhow::Result<u32> {
        ensure!(jobs > 0, "{} jobs", jobs; "give {} or more", 1);
        Err(Broken::Late).or_fault(|| fault!("cannot start"; "run again"))
    }

    #[test]
    fn a_fault_keeps_its_cause() {
        let sentence = |error: &anyhow::Error| error.downcast_ref::<Fault>().map(Remedy::sentence);
        let error = checked(0).unwrap_err();
        assert_eq!(sentence(&error).as_deref(), Some("0 jobs; give 1 or more"));
        let error = checked(1).unwrap_err();
        assert_eq!(sentence(&error).as_deref(), Some("cannot start; run again"));
        let cause = error.chain().nth(1).and_then(|cause| cause.downcast_ref::<Broken>());
        assert!(matches!(cause, Some(Broken::Late)));
    }
}
