//! Times the reading of a Push-T dataset: `decode_rate DATASET [REPEATS]`. Prints one JSON object per repeat.

use std::path::Path;
use std::time::Instant;

use re4_ingest::Selection;
use re4_ingest::pusht::PushtReader;

#[expect(clippy::print_stdout, reason = "this program prints its measurements")]
fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let path = arguments.next().ok_or("usage: decode_rate DATASET [REPEATS]")?;
    let repeats: usize = arguments.next().map_or(Ok(3), |text| text.parse())?;
    for _ in 0..repeats {
        let start = Instant::now();
        let reader = PushtReader::open(Path::new(&path))?;
        let open_s = start.elapsed().as_secs_f64();

        let start = Instant::now();
        let (episodes, _) = reader.read_episodes(&Selection::All)?;
        let columns_s = start.elapsed().as_secs_f64();

        let start = Instant::now();
        let hash = reader.source_hash(&|| false)?;
        let hash_s = start.elapsed().as_secs_f64();

        let start = Instant::now();
        let mut image_bytes = 0;
        let mut checksum = 0u64;
        if reader.image_shape().is_some() {
            for block in reader.image_blocks(&Selection::All)? {
                let block = block?;
                image_bytes += block.bytes.len();
                // The sum keeps the compiler from removing the work; the benchmark compares it with that of the other reader.
                checksum += block.bytes.iter().map(|&byte| u64::from(byte)).sum::<u64>();
            }
        }
        let images_s = start.elapsed().as_secs_f64();
        let report = serde_json::json!({
            "frames": episodes.frame_count(),
            "threads": rayon::current_num_threads(),
            "source_hash": hash,
            "open_s": open_s,
            "columns_s": columns_s,
            "hash_s": hash_s,
            "images_s": images_s,
            "image_bytes": image_bytes,
            "image_sum": checksum,
        });
        println!("{report}");
    }
    Ok(())
}
