//! Formatting of numbers for readers.

/// A duration in microseconds.
pub(super) fn time(microseconds: f64) -> String {
    match microseconds {
        t if t < 100.0 => format!("{t:.1} µs"),
        t if t < 1e3 => format!("{t:.0} µs"),
        t if t < 1e5 => format!("{:.2} ms", t / 1e3),
        t if t < 1e6 => format!("{:.0} ms", t / 1e3),
        t => format!("{:.2} s", t / 1e6),
    }
}

/// A duration in seconds.
pub(super) fn span(seconds: f64) -> String {
    match seconds {
        s if s < 10.0 => format!("{s:.1} s"),
        s if s < 120.0 => format!("{s:.0} s"),
        s if s < 7200.0 => format!("{:.0} min", s / 60.0),
        s => format!("{:.1} h", s / 3600.0),
    }
}

/// A size in bytes.
pub(super) fn size(bytes: u64) -> String {
    match bytes as f64 {
        b if b < 1e3 => format!("{bytes} B"),
        b if b < 1e6 => format!("{:.0} kB", b / 1e3),
        b if b < 1e8 => format!("{:.1} MB", b / 1e6),
        b => format!("{:.0} MB", b / 1e6),
    }
}

/// A difference with its sign.
pub(super) fn signed(value: f64) -> String {
    let text = format!("{:.3}", value.abs());
    match text.as_str() {
        "0.000" => text,
        _ if value < 0.0 => format!("−{text}"),
        _ => format!("+{text}"),
    }
}

/// A probability.
pub(crate) fn probability(p: f64) -> String {
    if p < 0.001 {
        "< 0.001".to_owned()
    } else {
        format!("{p:.3}")
    }
}

/// A time of the clock in UTC, from seconds since 1970.
pub(super) fn date(seconds: u64) -> String {
    // Days are counted from 1 March of the year 0, so that the day that leap years add is the last one of a year. 400 years have
    // 146,097 days.
    let days = seconds / 86_400 + 719_468;
    let (era, day) = (days / 146_097, days % 146_097);
    let year = (day - day / 1460 + day / 36_524 - day / 146_096) / 365;
    let day = day - (365 * year + year / 4 - year / 100);
    let month = (5 * day + 2) / 153;
    let date = day - (153 * month + 2) / 5 + 1;
    let month = if month < 10 { month + 3 } else { month - 9 };
    let year = 400 * era + year + u64::from(month <= 2);
    let (hour, minute) = (seconds / 3600 % 24, seconds / 60 % 60);
    format!("{year:04}-{month:02}-{date:02} {hour:02}:{minute:02} UTC")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_units_and_signs() {
        assert_eq!(
            [time(3.12), time(812.4), time(4567.0), time(2.5e6)],
            ["3.1 µs", "812 µs", "4.57 ms", "2.50 s"]
        );
        assert_eq!(
            [span(3.0), span(90.0), span(600.0), span(9000.0)],
            ["3.0 s", "90 s", "10 min", "2.5 h"]
        );
        assert_eq!([size(12), size(4500), size(12_300_000)], ["12 B", "4 kB", "12.3 MB"]);
        assert_eq!(
            [signed(0.25), signed(-0.25), signed(-0.0001)],
            ["+0.250", "−0.250", "0.000"]
        );
        assert_eq!([probability(0.0001), probability(0.05)], ["< 0.001", "0.050"]);
    }

    #[test]
    fn dates_are_those_of_the_calendar() {
        // date -u -d @SECONDS
        assert_eq!(date(0), "1970-01-01 00:00 UTC");
        assert_eq!(date(951_782_399), "2000-02-28 23:59 UTC");
        assert_eq!(date(951_782_400), "2000-02-29 00:00 UTC");
        assert_eq!(date(1_709_251_199), "2024-02-29 23:59 UTC");
        assert_eq!(date(1_735_689_600), "2025-01-01 00:00 UTC");
        assert_eq!(date(4_107_542_400), "2100-03-01 00:00 UTC");
    }
}
