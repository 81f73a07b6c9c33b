//! The vocabulary of the documentation: words that a reader of the field would not expect in the sense in which earlier versions of
//! this project used them.

use std::fs;
use std::path::{Path, PathBuf};

use crate::cli::COMMANDS;
use crate::support::{Place, repository};

/// A word, and what to write instead. A word ends where no letter follows.
const REPLACED: [(&str, &str); 30] = [
    ("picture", "image"),
    ("pictures", "images"),
    ("film", "video"),
    ("films", "videos"),
    ("mend", "fix"),
    ("mends", "fixes"),
    ("mended", "fixed"),
    ("drawn", "rendered, or sampled"),
    ("redrawn", "rendered again"),
    ("told", "observed, reported or known"),
    ("share of", "fraction of"),
    ("shares of", "fractions of"),
    ("a turn", "a rotation"),
    ("turns of", "rotations of"),
    ("half a turn", "180 degrees"),
    ("turned by", "rotated by"),
    ("turns by", "rotates by"),
    ("way home", "return to the home pose"),
    ("in space", "in SE(3)"),
    ("greatest", "maximum"),
    ("the least", "the minimum"),
    ("least of", "minimum of"),
    ("to the bit", "bit-exact"),
    ("way-point", "waypoint"),
    ("way-points", "waypoints"),
    ("like poses", "symmetry-equivalent poses"),
    ("manieth", "every n-th"),
    ("that is none", "not a valid one"),
    ("anew", "again"),
    ("whoever", "the caller"),
];

/// Names of formats and earlier versions, which stay: options that are still accepted, and columns of older tables.
const KEPT: [&str; 3] = ["`film`", "`--picture`", "`--pictures`"];

fn files(folder: &Path, endings: &[&str], found: &mut Vec<PathBuf>) {
    let mut entries: Vec<PathBuf> = fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    entries.sort();
    for path in entries {
        if path.is_dir() {
            files(&path, endings, found);
        } else if endings
            .iter()
            .any(|ending| path.extension().is_some_and(|found| found == *ending))
        {
            found.push(path);
        }
    }
}

/// The replaced words in a text, one line for each.
fn replaced(place: &str, text: &str) -> Vec<String> {
    let mut found = Vec::new();
    for (number, line) in text.lines().enumerate() {
        let mut line = line.to_lowercase();
        for kept in KEPT {
            line = line.replace(kept, "");
        }
        for (word, instead) in REPLACED {
            let stands_alone = |at: usize| {
                let letter = |c: Option<char>| c.is_some_and(|c| c.is_alphanumeric() || c == '_');
                !letter(line[..at].chars().next_back()) && !letter(line[at + word.len()..].chars().next())
            };
            if line.match_indices(word).any(|(at, _)| stands_alone(at)) {
                found.push(format!(
                    "{place}:{}: \"{word}\", write {instead}: {}",
                    number + 1,
                    line.trim()
                ));
            }
        }
    }
    found
}

#[test]
fn documentation_help_and_schemas_use_the_terms_of_the_field() {
    let root = repository();
    let mut pages = vec![
        root.join("README.md"),
        root.join("ARCHITECTURE.md"),
        root.join("CONTRIBUTING.md"),
    ];
    files(&root.join("docs"), &["md"], &mut pages);
    files(&root.join("schemas"), &["json"], &mut pages);
    files(&root.join("pipelines"), &["toml"], &mut pages);
    let mut found = Vec::new();
    for path in &pages {
        let name = path.strip_prefix(&root).unwrap().display().to_string();
        // Former names of columns are data.
        let text: String = fs::read_to_string(path)
            .unwrap()
            .lines()
            .map(|line| {
                if line.contains("\"formerly\"") {
                    "\n".to_owned()
                } else {
                    format!("{line}\n")
                }
            })
            .collect();
        found.extend(replaced(&name, &text));
    }
    let place = Place::empty();
    for command in [""].into_iter().chain(COMMANDS) {
        let help = place.run(format!("{command} --help").trim()).done().stdout;
        found.extend(replaced(&format!("re4-pipe {command} --help"), &help));
    }
    assert!(pages.len() > 60, "{} pages", pages.len());
    assert!(found.is_empty(), "{}", found.join("\n"));
}

#[test]
fn public_documentation_uses_the_terms_of_the_field() {
    let root = repository();
    let mut sources = Vec::new();
    files(&root.join("crates"), &["rs"], &mut sources);
    let mut found = Vec::new();
    for path in sources
        .iter()
        .filter(|path| path.components().any(|part| part.as_os_str() == "src"))
    {
        let name = path.strip_prefix(&root).unwrap().display().to_string();
        let text: String = fs::read_to_string(path)
            .unwrap()
            .lines()
            .map(|line| {
                let line = line.trim_start();
                let documentation = line.starts_with("///") || line.starts_with("//!");
                if documentation {
                    format!("{line}\n")
                } else {
                    "\n".to_owned()
                }
            })
            .collect();
        found.extend(replaced(&name, &text));
    }
    assert!(sources.len() > 200, "{} files", sources.len());
    assert!(found.is_empty(), "{}", found.join("\n"));
}

#[test]
fn words_are_found_as_words() {
    assert_eq!(replaced("x", "a filmed `film` overmend pictured").len(), 0);
    assert_eq!(replaced("x", "Least squares, at least two, a return").len(), 0);
    assert_eq!(replaced("x", "the film of a picture\nhalf a turn").len(), 4);
}
