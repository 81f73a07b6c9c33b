//! Random damage of single files. Nothing panics or aborts, every refusal names a file, and what is read has the counts of the original.
//!
//! Formats without checksums cannot reveal a changed number or pixel. Contents may therefore differ where such a value was changed:
//! in tables of data and in videos, never because of the metadata.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use super::support::{Contents, contents, samples};

/// Number of damaged copies, unless `RE4_MUTATIONS` sets another one. Copy `n` has the seed `n`.
const COPIES: u64 = 500;

const SAMPLES: [&str; 6] = [
    "pusht-v3.0-video-av1",
    "pusht-v3.0-image",
    "pusht-v3.0-multifile",
    "pusht-v2.1-image",
    "pusht-v2.1-video-h264",
    "pusht-v3.0-keypoints",
];

/// The generator splitmix64.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut value = self.0;
        value = (value ^ (value >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        value = (value ^ (value >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        value ^ (value >> 31)
    }

    fn below(&mut self, end: usize) -> usize {
        (self.next() % end.max(1) as u64) as usize
    }
}

fn files(folder: &Path, found: &mut Vec<PathBuf>) {
    let mut entries: Vec<PathBuf> = fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    entries.sort();
    for path in entries {
        if path.is_dir() {
            files(&path, found);
        } else {
            found.push(path);
        }
    }
}

/// Changes bytes: flips, other values, runs of zeros, cuts, repetitions, numbers in text.
fn damage(bytes: &mut Vec<u8>, random: &mut Random) {
    for _ in 0..=random.below(3) {
        if bytes.is_empty() {
            return;
        }
        // Headers, tables and footers are at the ends of files.
        let length = bytes.len();
        let at = match random.below(3) {
            0 => random.below(length.min(600)),
            1 => length - 1 - random.below(length.min(3000)),
            _ => random.below(length),
        };
        let run = (1 + random.below(24)).min(length - at);
        match random.below(8) {
            0 | 1 => bytes[at] ^= 1 << random.below(8),
            2 => bytes[at] = random.next() as u8,
            3 => bytes[at..at + run].fill(if random.below(2) == 0 { 0 } else { 0xff }),
            4 if random.below(3) == 0 => bytes.truncate(at),
            4 => drop(bytes.drain(at..at + run)),
            5 => {
                let piece = bytes[at..at + run].to_vec();
                drop(bytes.splice(at..at, piece));
            }
            6 => {
                let from = random.below(length - run + 1);
                let piece = bytes[from..from + run].to_vec();
                bytes[at..at + run].copy_from_slice(&piece);
            }
            _ => {
                let digits: Vec<usize> = (0..length).filter(|&at| bytes[at].is_ascii_digit()).collect();
                if let Some(&at) = digits.get(random.below(digits.len())) {
                    bytes[at] = b'0' + random.below(10) as u8;
                }
            }
        }
    }
}

/// A copy of a sample in links, except one file.
fn with_file(sample: &Path, all: &[PathBuf], changed: &Path, bytes: &[u8]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for path in all {
        let copy = folder.path().join(path.strip_prefix(sample).unwrap());
        fs::create_dir_all(copy.parent().unwrap()).unwrap();
        if path == changed {
            fs::write(copy, bytes).unwrap();
        } else {
            std::os::unix::fs::symlink(path, copy).unwrap();
        }
    }
    folder
}

#[test]
fn damaged_files_are_refused_or_read() {
    let Some(folder) = samples() else { return };
    let mut originals: Vec<(PathBuf, Vec<PathBuf>, Contents)> = Vec::new();
    for sample in SAMPLES {
        let path = folder.canonicalize().unwrap().join(sample);
        let mut all = Vec::new();
        files(&path, &mut all);
        originals.push((path.clone(), all, contents(&path, true).unwrap()));
    }
    let mut outcomes: BTreeMap<(String, &str), usize> = BTreeMap::new();
    let mut wrong = Vec::new();
    let number = std::env::var("RE4_MUTATIONS").ok();
    let copies = number.map_or(COPIES, |number| number.parse().unwrap());
    for seed in 0..copies {
        let mut random = Random(seed);
        let (sample, all, original) = &originals[random.below(originals.len())];
        let changed = &all[random.below(all.len())];
        let name = changed.strip_prefix(sample).unwrap().to_str().unwrap().to_owned();
        let mut bytes = fs::read(changed).unwrap();
        damage(&mut bytes, &mut random);
        let copy = with_file(sample, all, changed, &bytes);
        let holds_images =
            name.starts_with("videos") || (name.starts_with("data") && sample.ends_with("pusht-v3.0-image"));
        let payload = name.starts_with("videos") || name.starts_with("data");
        let outcome = match contents(copy.path(), holds_images) {
            Ok(found) => {
                let same =
                    found.numbers == original.numbers && (found.images.is_none() || found.images == original.images);
                if found.lengths != original.lengths || !(same || payload) {
                    wrong.push(format!(
                        "seed {seed}, {name} of {}: read with other contents",
                        sample.display()
                    ));
                }
                if same { "same" } else { "other values" }
            }
            Err(faults) => {
                let vague = faults.iter().any(|fault| fault.file.is_empty() || fault.fix.is_empty());
                if vague || faults.is_empty() {
                    wrong.push(format!("seed {seed}, {name} of {}: {faults:?}", sample.display()));
                }
                "refused"
            }
        };
        let kind = name.split('/').next().unwrap_or_default().to_owned();
        *outcomes.entry((kind, outcome)).or_default() += 1;
    }
    for ((kind, outcome), count) in outcomes {
        println!("{kind}: {outcome} {count}");
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
