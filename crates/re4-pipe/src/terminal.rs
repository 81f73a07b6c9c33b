//! Text that fits the terminal.

use std::io::IsTerminal as _;

/// Width of standard output in characters. `None` if it is a file or a pipe, unless `COLUMNS` gives a width: programs that read
/// the output should not see line breaks that depend on a window.
pub(crate) fn width() -> Option<usize> {
    if std::io::stdout().is_terminal() {
        return terminal_size::terminal_size().map(|(width, _)| usize::from(width.0));
    }
    std::env::var("COLUMNS").ok()?.parse().ok().filter(|width| *width > 0)
}

/// A paragraph behind `indent`, broken into lines of at most `width` characters. All lines after the first are indented
/// `hanging` characters further.
pub(crate) fn paragraph(text: &str, indent: usize, hanging: usize, width: Option<usize>) -> String {
    let first = " ".repeat(indent);
    let Some(width) = width else {
        return first + text;
    };
    let next = " ".repeat(indent + hanging);
    // Narrower than this, words are broken, and a line holds little besides its indentation.
    let width = width.max(indent + hanging + 20);
    textwrap::fill(
        text,
        textwrap::Options::new(width)
            .initial_indent(&first)
            .subsequent_indent(&next),
    )
}

/// A value cut to `width` characters, with an ellipsis if anything was cut.
pub(crate) fn cut(text: &str, width: usize) -> String {
    if text.chars().count() <= width {
        return text.to_owned();
    }
    text.chars().take(width.saturating_sub(1)).chain(['…']).collect()
}

#[cfg(test)]
mod tests {
    use super::{cut, paragraph};

    #[test]
    fn paragraphs_are_wrapped_with_a_hanging_indent() {
        let text = "one two three four five six seven";
        assert_eq!(paragraph(text, 2, 2, None), "  one two three four five six seven");
        assert_eq!(
            paragraph(text, 2, 2, Some(24)),
            "  one two three four\n    five six seven"
        );
        let narrow = paragraph(text, 2, 2, Some(1));
        assert!(narrow.lines().all(|line| line.chars().count() <= 24), "{narrow}");
    }

    #[test]
    fn long_values_end_in_an_ellipsis() {
        assert_eq!(cut("0.123456", 8), "0.123456");
        assert_eq!(cut("0.1234567", 8), "0.12345…");
        assert_eq!(cut("α≤β≤γ", 3), "α≤…");
    }
}
