//! Reads a pipeline file with overrides. An input is the text of the file, except that lines that begin with `--set ` are overrides.

/// Reads the pipeline. Returns the first error. An accepted pipeline has to be accepted again after serialization.
pub(crate) fn run(input: &[u8]) -> Result<(), String> {
    let text = String::from_utf8_lossy(input);
    let (mut file, mut overrides) = (String::new(), Vec::new());
    for line in text.split_inclusive('\n') {
        match line.strip_prefix("--set ") {
            Some(setting) => overrides.push(setting.trim_end_matches('\n').to_owned()),
            None => file.push_str(line),
        }
    }
    let written = re4_stages::fuzzing::pipeline(&file, &overrides)?;
    let set: Vec<String> = serde_json::from_str::<serde_json::Map<String, serde_json::Value>>(&written)
        .unwrap()
        .into_iter()
        .filter(|(key, _)| key == "task" || key == "variant")
        .map(|(key, value)| format!("{key}={value}"))
        .collect();
    assert_eq!(
        re4_stages::fuzzing::pipeline(&file, &[overrides, set].concat()).as_ref(),
        Ok(&written)
    );
    Ok(())
}
