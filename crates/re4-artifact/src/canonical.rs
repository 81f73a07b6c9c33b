//! Canonical JSON: one text per value, independent of the order in which its fields were written.

use serde::Serialize;
use serde_json::Value;

use crate::error::ArtifactError;

/// Converts a value to JSON with the keys of every object in ascending byte order.
///
/// Numbers are printed by `serde_json`: integers as integers, floats as the shortest text that parses to the same bits. JSON has
/// no NaN and no infinity, so both become null; configurations are checked for them before they are converted.
///
/// # Errors
/// [`ArtifactError::Json`] if the value cannot be represented in JSON, for example a map whose keys are not strings.
pub fn canonical_json(value: &impl Serialize) -> Result<Value, ArtifactError> {
    let value = serde_json::to_value(value).map_err(|source| ArtifactError::Json { source })?;
    Ok(sorted(value))
}

/// Returns the canonical text of a value: sorted keys, two-space indentation, a final newline.
pub fn canonical_text(value: &Value) -> String {
    // The alternate format of `Value` is that of the pretty printer; unlike the latter it cannot fail.
    format!("{:#}\n", sorted(value.clone()))
}

/// Returns the canonical text without white space, which is the input of all hashes.
pub(crate) fn canonical_compact(value: &Value) -> String {
    sorted(value.clone()).to_string()
}

fn sorted(value: Value) -> Value {
    match value {
        Value::Object(map) => {
            let mut entries: Vec<_> = map.into_iter().map(|(name, value)| (name, sorted(value))).collect();
            entries.sort_by(|a, b| a.0.cmp(&b.0));
            Value::Object(entries.into_iter().collect())
        }
        Value::Array(items) => Value::Array(items.into_iter().map(sorted).collect()),
        other => other,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use serde_json::json;

    #[test]
    fn the_order_of_fields_does_not_matter() {
        let a: Value = serde_json::from_str(r#"{"b": {"y": 1, "x": [{"q": 2, "p": 3}]}, "a": 0.1}"#).unwrap();
        let b: Value = serde_json::from_str(r#"{"a": 0.1, "b": {"x": [{"p": 3, "q": 2}], "y": 1}}"#).unwrap();
        assert_eq!(canonical_compact(&a), canonical_compact(&b));
        assert_eq!(canonical_compact(&a), r#"{"a":0.1,"b":{"x":[{"p":3,"q":2}],"y":1}}"#);
        assert_eq!(
            canonical_text(&json!({"b": 1, "a": []})),
            "{\n  \"a\": [],\n  \"b\": 1\n}\n"
        );
    }

    proptest! {
        #[test]
        fn floats_keep_their_bits(bits in any::<u64>()) {
            let x = f64::from_bits(bits);
            prop_assume!(x.is_finite());
            let text = canonical_compact(&canonical_json(&x).unwrap());
            prop_assert_eq!(serde_json::from_str::<f64>(&text).unwrap().to_bits(), bits);
        }
    }
}
