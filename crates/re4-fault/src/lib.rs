//! What is wrong, and apart from it how to fix it.
//!
//! The text of an error ([`Display`](fmt::Display)) says what is wrong and with what; its [`Remedy`] says what to do about it.
//! Whoever prints an error joins the two, or keeps them apart. Library crates derive [`Remedy`] for their enums of errors;
//! the code above them makes a [`Fault`] with [`fault!`], [`bail!`] and [`ensure!`].

use std::borrow::Cow;
use std::error::Error;
use std::fmt;

#[doc(hidden)]
pub use anyhow;
pub use re4_fault_derive::Remedy;

/// An error that may know how to fix it.
pub trait Remedy: fmt::Display {
    /// What to do about it, in the imperative and without an end: `give a smaller --jobs`.
    fn remedy(&self) -> Option<Cow<'_, str>>;

    /// What is wrong and how to fix it in one sentence.
    fn sentence(&self) -> String {
        join(&self.to_string(), self.remedy().as_deref())
    }
}

impl<T: Remedy + ?Sized> Remedy for Box<T> {
    fn remedy(&self) -> Option<Cow<'_, str>> {
        (**self).remedy()
    }
}

/// What and remedy as one sentence.
pub fn join(what: &str, remedy: Option<&str>) -> String {
    match remedy {
        Some(remedy) if !remedy.is_empty() => [what, "; ", remedy].concat(),
        _ => what.to_owned(),
    }
}

/// What is wrong, how to fix it, and why.
#[derive(Debug)]
pub struct Fault {
    what: String,
    remedy: Option<String>,
    source: Option<anyhow::Error>,
}

impl Fault {
    /// What is wrong, and what to do about it where that is known.
    pub fn new(what: impl Into<String>, remedy: Option<impl Into<String>>) -> Self {
        Self {
            what: what.into(),
            remedy: remedy.map(Into::into),
            source: None,
        }
    }

    /// What another error says.
    pub fn of(error: &impl Remedy) -> Self {
        Self::new(error.to_string(), error.remedy())
    }

    /// The same, with words before it that say where: `{place}{what}`.
    #[must_use]
    pub fn at(self, place: impl fmt::Display) -> Self {
        Self {
            what: format!("{place}{}", self.what),
            ..self
        }
    }

    /// From a sentence as [`Remedy::sentence`] makes it, for what passed through a foreign parser, which knows texts alone.
    pub fn from_sentence(sentence: &str) -> Self {
        match sentence.split_once("; ") {
            Some((what, remedy)) => Self::new(what, Some(remedy)),
            None => Self::new(sentence, None::<String>),
        }
    }

    /// With the error that led to it.
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

/// Says of an error, or of nothing where there should be something, what it means.
pub trait OrFault<T> {
    /// The value, or the fault, which keeps the error as its source.
    ///
    /// # Errors
    /// Where there was one.
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

/// A [`Fault`]: `fault!("there is no file {}", path.display(); "give the path of one")`. The part after the semicolon is the
/// remedy, and may be left out.
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

/// Returns a [`fault!`] unless a condition holds.
#[macro_export]
macro_rules! ensure {
    ($holds:expr, $($fault:tt)*) => {
        if !$holds {
            $crate::bail!($($fault)*);
        }
    };
}

// What the derive writes is `::re4_fault::Remedy`.
#[cfg(test)]
extern crate self as re4_fault;

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, thiserror::Error, Remedy)]
    enum Broken {
        #[error("{name} is {size} px")]
        #[remedy("give {} to {most}", 1)]
        Size { name: &'static str, size: u32, most: u32 },
        #[error("no disk: {0}")]
        #[remedy(_0.remedy())]
        Disk(Box<Broken>),
        #[error("it is late")]
        Late,
    }

    #[test]
    fn each_variant_says_how_to_fix_it() {
        let size = || Broken::Size {
            name: "width",
            size: 9,
            most: 4,
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
        let said = |error: &anyhow::Error| error.downcast_ref::<Fault>().map(Remedy::sentence);
        let error = checked(0).unwrap_err();
        assert_eq!(said(&error).as_deref(), Some("0 jobs; give 1 or more"));
        let error = checked(1).unwrap_err();
        assert_eq!(said(&error).as_deref(), Some("cannot start; run again"));
        let cause = error.chain().nth(1).and_then(|cause| cause.downcast_ref::<Broken>());
        assert!(matches!(cause, Some(Broken::Late)));
    }
}
