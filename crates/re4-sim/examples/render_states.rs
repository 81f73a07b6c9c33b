//! Reads states from standard input, five numbers per line (agent x, y, block x, y, theta; pixels and radians), and writes
//! their images to standard output as raw RGB bytes: 96 x 96, or 512 x 512 with the argument `canvas`.
//!
//! `cargo run --release -p re4-sim --example render_states [canvas] < states.txt > images.bin`

use std::io::{BufWriter, Error, ErrorKind, Write, stdin, stdout};

use re4_geometry::{Point2, Pose2};
use re4_sim::Canvas;

fn main() -> Result<(), Error> {
    let whole = std::env::args().nth(1).is_some_and(|text| text == "canvas");
    let mut canvas = Canvas::new();
    let mut observation = Vec::new();
    let mut out = BufWriter::new(stdout().lock());
    for (number, line) in stdin().lines().enumerate() {
        let line = line?;
        let values: Vec<f64> = line.split_whitespace().filter_map(|word| word.parse().ok()).collect();
        let &[agent_x, agent_y, x, y, theta] = values.as_slice() else {
            let message = format!("line {}: expected five numbers, found {line:?}", number + 1);
            return Err(Error::new(ErrorKind::InvalidData, message));
        };
        canvas.render_state(Point2::new(agent_x, agent_y), Pose2::new(x, y, theta));
        if whole {
            out.write_all(canvas.bytes())?;
        } else {
            canvas.observation_into(&mut observation);
            out.write_all(&observation)?;
        }
    }
    out.flush()
}
