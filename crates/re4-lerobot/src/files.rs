//! Files below a folder of the dataset.

use std::fs;
use std::path::Path;

use crate::fault::{Fault, Kind};

/// Maximum depth of folders that are searched. The format has two or three levels; links can form loops.
const DEPTH: usize = 6;

/// Names of the files with an extension below a folder, relative to the dataset, in alphabetical order. A folder that does not exist
/// has none. Hidden files are those of version control and caches.
pub(crate) fn below(root: &Path, folder: &str, extension: &str) -> Result<Vec<String>, Fault> {
    let mut found = Vec::new();
    search(root, folder, extension, DEPTH, &mut found)?;
    found.sort();
    Ok(found)
}

fn search(root: &Path, folder: &str, extension: &str, depth: usize, found: &mut Vec<String>) -> Result<(), Fault> {
    let path = root.join(folder);
    if !path.is_dir() {
        return Ok(());
    }
    if depth == 0 {
        let what = "its folders are nested too deeply";
        return Err(Fault::of_file(
            Kind::Format,
            folder,
            what,
            "remove links to parent folders",
        ));
    }
    let entries = fs::read_dir(&path).map_err(|error| Fault::io(folder, "listed", &error))?;
    for entry in entries {
        let entry = entry.map_err(|error| Fault::io(folder, "listed", &error))?;
        let name = entry.file_name();
        let Some(name) = name.to_str().filter(|name| !name.starts_with('.')) else {
            continue;
        };
        let inner = format!("{folder}/{name}");
        // `is_dir` follows links, which the cache of the hub consists of.
        if entry.path().is_dir() {
            search(root, &inner, extension, depth - 1, found)?;
        } else if Path::new(name)
            .extension()
            .is_some_and(|end| end.eq_ignore_ascii_case(extension))
        {
            found.push(inner);
        }
    }
    Ok(())
}
