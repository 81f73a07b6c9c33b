//! `re4-pipe schemas`: descriptions of everything on disk, generated from the code.

use std::collections::BTreeMap;
use std::fs;

use anyhow::Result;
use re4_artifact::{Manifest, json_description};
use re4_fault::{OrFault as _, fault};
use re4_stages::tables;
use serde_json::json;

use super::Outcome;
use crate::arguments::SchemasArguments;
use crate::console::Console;

/// Writes the folder, or compares it.
pub(crate) fn schemas(arguments: &SchemasArguments) -> Result<Outcome> {
    let console = Console::new(&arguments.common);
    let files = generate()?;
    let folder = &arguments.folder;
    if arguments.check {
        let stale: Vec<&str> = files
            .iter()
            .filter(|(name, text)| fs::read_to_string(folder.join(name)).ok().as_ref() != Some(text))
            .map(|(name, _)| name.as_str())
            .collect();
        console.answer(&json!({ "checked": files.len(), "stale": stale }))?;
        if stale.is_empty() {
            console.say(&format!("{} files in {} are up to date", files.len(), folder.display()))?;
            return Ok(Outcome::Done);
        }
        console.say(&format!(
            "out of date in {}: {}; run re4-pipe schemas",
            folder.display(),
            stale.join(", ")
        ))?;
        return Ok(Outcome::GateFailed);
    }
    fs::create_dir_all(folder)
        .or_fault(|| fault!("cannot make the folder {}", folder.display(); "name one that can be written"))?;
    for (name, text) in &files {
        let path = folder.join(name);
        fs::write(&path, text)
            .or_fault(|| fault!("cannot write {}", path.display(); "name a folder that can be written"))?;
    }
    console.answer(&json!({ "written": files.keys().collect::<Vec<_>>() }))?;
    console.say(&format!("wrote {} files to {}", files.len(), folder.display()))?;
    Ok(Outcome::Done)
}

fn generate() -> Result<BTreeMap<String, String>> {
    let mut files = BTreeMap::new();
    for (_, spec) in tables::all() {
        files.insert(format!("{}.json", spec.title()), json_description(spec));
    }
    files.insert("pipeline.schema.json".to_owned(), re4_stages::schema());
    files.insert(
        "manifest.schema.json".to_owned(),
        json!(schemars::schema_for!(Manifest)),
    );
    files
        .into_iter()
        .map(|(name, value)| Ok((name, serde_json::to_string_pretty(&value)? + "\n")))
        .collect()
}
