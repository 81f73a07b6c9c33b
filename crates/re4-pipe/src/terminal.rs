//! Text wrapped and cut to the width of the terminal.

use std::io::IsTerminal as _;

/// Width of standard output in characters. `None` if standard output is a file or a pipe and `COLUMNS` gives no width, so that a
/// program that reads the output gets no line breaks that depend on the size of a window.
pub(crate) fn width() -> Option<usize> {
    if std::io::stdout().is_terminal() {
        return terminal_size::terminal_size().map(|(width, _)| usize::from(width.0));
    }
    std::env::var("COLUMNS").ok()?.parse().ok().filter(|width| *width > 0)
}

/// A paragraph wrapped to lines of at most `width` characters and indented by `indent` characters. Lines after the first are
/// indented by `hanging` further characters.
pub(crate) fn paragraph(text: &str, indent: usize, hanging: usize, width: Option<usize>) -> String {
    let first = " ".repeat(indent);
    let Some(width) = width else {
        return first + text;
    };
    let next = " ".repeat(indent + hanging);
    // In narrower lines, words would be broken.
    let width = width.max(indent + hanging + 20);
    textwrap::fill(
        text,
        textwrap::Options::new(width)
            .initial_indent(&first)
            .subsequent_indent(&next),
    )
}

/// A value truncated to `width` characters. A truncated value ends in an ellipsis.
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
