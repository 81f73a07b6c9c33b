//! Text in capitals of 5 x 7 pixels, for the labels of a video.

const WIDTH: usize = 5;
const ADVANCE: usize = WIDTH + 1;

/// The rows of each glyph from the top. The highest of the five bits is the leftmost pixel.
const GLYPHS: [(char, [u8; 7]); 39] = [
    ('0', [0b01110, 0b10001, 0b10011, 0b10101, 0b11001, 0b10001, 0b01110]),
    ('1', [0b00100, 0b01100, 0b00100, 0b00100, 0b00100, 0b00100, 0b01110]),
    ('2', [0b01110, 0b10001, 0b00001, 0b00110, 0b01000, 0b10000, 0b11111]),
    ('3', [0b01110, 0b10001, 0b00001, 0b00110, 0b00001, 0b10001, 0b01110]),
    ('4', [0b00010, 0b00110, 0b01010, 0b10010, 0b11111, 0b00010, 0b00010]),
    ('5', [0b11111, 0b10000, 0b11110, 0b00001, 0b00001, 0b10001, 0b01110]),
    ('6', [0b00110, 0b01000, 0b10000, 0b11110, 0b10001, 0b10001, 0b01110]),
    ('7', [0b11111, 0b00001, 0b00010, 0b00100, 0b00100, 0b01000, 0b01000]),
    ('8', [0b01110, 0b10001, 0b10001, 0b01110, 0b10001, 0b10001, 0b01110]),
    ('9', [0b01110, 0b10001, 0b10001, 0b01111, 0b00001, 0b00010, 0b01100]),
    ('.', [0b00000, 0b00000, 0b00000, 0b00000, 0b00000, 0b01100, 0b01100]),
    ('-', [0b00000, 0b00000, 0b00000, 0b01110, 0b00000, 0b00000, 0b00000]),
    ('A', [0b01110, 0b10001, 0b10001, 0b11111, 0b10001, 0b10001, 0b10001]),
    ('B', [0b11110, 0b10001, 0b10001, 0b11110, 0b10001, 0b10001, 0b11110]),
    ('C', [0b01110, 0b10001, 0b10000, 0b10000, 0b10000, 0b10001, 0b01110]),
    ('D', [0b11110, 0b10001, 0b10001, 0b10001, 0b10001, 0b10001, 0b11110]),
    ('E', [0b11111, 0b10000, 0b10000, 0b11110, 0b10000, 0b10000, 0b11111]),
    ('F', [0b11111, 0b10000, 0b10000, 0b11110, 0b10000, 0b10000, 0b10000]),
    ('G', [0b01110, 0b10001, 0b10000, 0b10111, 0b10001, 0b10001, 0b01110]),
    ('H', [0b10001, 0b10001, 0b10001, 0b11111, 0b10001, 0b10001, 0b10001]),
    ('I', [0b01110, 0b00100, 0b00100, 0b00100, 0b00100, 0b00100, 0b01110]),
    ('J', [0b00111, 0b00010, 0b00010, 0b00010, 0b00010, 0b10010, 0b01100]),
    ('K', [0b10001, 0b10010, 0b10100, 0b11000, 0b10100, 0b10010, 0b10001]),
    ('L', [0b10000, 0b10000, 0b10000, 0b10000, 0b10000, 0b10000, 0b11111]),
    ('M', [0b10001, 0b11011, 0b10101, 0b10101, 0b10001, 0b10001, 0b10001]),
    ('N', [0b10001, 0b11001, 0b10101, 0b10011, 0b10001, 0b10001, 0b10001]),
    ('O', [0b01110, 0b10001, 0b10001, 0b10001, 0b10001, 0b10001, 0b01110]),
    ('P', [0b11110, 0b10001, 0b10001, 0b11110, 0b10000, 0b10000, 0b10000]),
    ('Q', [0b01110, 0b10001, 0b10001, 0b10001, 0b10101, 0b10010, 0b01101]),
    ('R', [0b11110, 0b10001, 0b10001, 0b11110, 0b10100, 0b10010, 0b10001]),
    ('S', [0b01111, 0b10000, 0b10000, 0b01110, 0b00001, 0b00001, 0b11110]),
    ('T', [0b11111, 0b00100, 0b00100, 0b00100, 0b00100, 0b00100, 0b00100]),
    ('U', [0b10001, 0b10001, 0b10001, 0b10001, 0b10001, 0b10001, 0b01110]),
    ('V', [0b10001, 0b10001, 0b10001, 0b10001, 0b10001, 0b01010, 0b00100]),
    ('W', [0b10001, 0b10001, 0b10001, 0b10101, 0b10101, 0b11011, 0b10001]),
    ('X', [0b10001, 0b10001, 0b01010, 0b00100, 0b01010, 0b10001, 0b10001]),
    ('Y', [0b10001, 0b10001, 0b01010, 0b00100, 0b00100, 0b00100, 0b00100]),
    ('Z', [0b11111, 0b00001, 0b00010, 0b00100, 0b01000, 0b10000, 0b11111]),
    ('_', [0b00000, 0b00000, 0b00000, 0b00000, 0b00000, 0b00000, 0b11111]),
];

/// Returns the width of a text, in pixels.
pub(super) fn width(text: &str, scale: usize) -> usize {
    (text.chars().count() * ADVANCE * scale).saturating_sub(scale)
}

/// Returns the longest prefix of a text that is at most `max_width` pixels wide.
pub(super) fn fitting(text: &str, max_width: usize, scale: usize) -> String {
    text.chars()
        .take((max_width + scale) / (ADVANCE * scale).max(1))
        .collect()
}

/// Writes a text on rows of `side` pixels, with its top left corner at (x, y). Pixels outside of the rows are cut off. Characters
/// without a glyph are blank.
pub(super) fn write(pixels: &mut [u8], side: usize, (x, y): (usize, usize), scale: usize, text: &str, colour: u8) {
    for (position, letter) in text.chars().enumerate() {
        let Some((_, glyph)) = GLYPHS.iter().find(|(of, _)| *of == letter) else {
            continue;
        };
        for row in 0..glyph.len() * scale {
            for column in
                (0..WIDTH * scale).filter(|column| glyph[row / scale] >> (WIDTH - 1 - column / scale) & 1 == 1)
            {
                let at = x + position * ADVANCE * scale + column;
                if let Some(pixel) = pixels.get_mut((y + row) * side + at).filter(|_| at < side) {
                    *pixel = colour;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rendered(text: &str, side: usize, height: usize, scale: usize) -> Vec<String> {
        let mut pixels = vec![b'.'; side * height];
        write(&mut pixels, side, (0, 0), scale, text, b'#');
        let rows = pixels.chunks(side).map(|row| String::from_utf8(row.to_vec()).unwrap());
        rows.collect()
    }

    #[test]
    fn letters_are_placed_side_by_side_and_cut_at_the_border() {
        assert_eq!(
            rendered("T1?T", 17, 7, 1),
            [
                "#####...#........",
                "..#....##........",
                "..#.....#........",
                "..#.....#........",
                "..#.....#........",
                "..#.....#........",
                "..#....###.......",
            ]
        );
        let cut = rendered("LL", 8, 5, 1);
        assert_eq!(cut, ["#.....#."; 5]);
        assert_eq!(rendered("-", 10, 14, 2)[6], "..######..");
        assert_eq!((width("T1", 1), width("T1", 2), width("", 1)), (11, 22, 0));
        for (max_width, fits) in [(0, ""), (4, ""), (5, "D"), (10, "D"), (11, "DE"), (99, "DEM")] {
            assert_eq!(fitting("DEM", max_width, 1), fits, "{max_width}");
            assert_eq!(fitting("DEM", 2 * max_width, 2), fits, "{max_width}");
        }
    }

    #[test]
    fn all_characters_of_labels_have_a_glyph() {
        // Names of demonstrations can contain any of these.
        let words = "ABCDEFGHIJKLMNOPQRSTUVWXYZ 0123456789.-_";
        for letter in words.chars().filter(|letter| *letter != ' ') {
            assert!(GLYPHS.iter().any(|(of, _)| *of == letter), "{letter}");
        }
    }
}
