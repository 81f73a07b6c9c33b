//! Canonical JSON: one text per value, whatever order its fields were written in.

use serde::Serialize;
use serde_json::Value;

use crate::error::ArtifactError;

/// The value with the keys of every object in ascending byte order.
///
/// Numbers are printed by `serde_json`: integers as integers, floats as the shortest text that reads back to the same
/// bits. JSON has no NaN and no infinity, they become null; a configuration refuses them before it gets here.
///
/// # Errors
/// [`ArtifactError::Json`] when the value has no JSON form, for instance a map whose keys are not text.
pub fn canonical_json(value: &impl Serialize) -> Result<Value, ArtifactError> {
    let value = serde_json::to_value(value).map_err(|source| ArtifactError::Json { source })?;
    Ok(sorted(value))
}

/// The canonical text of a value: sorted keys, two-space indentation, a newline at the end.
pub fn canonical_text(value: &Value) -> String {
    // The alternate form of `Value` is the pretty printer's, and cannot fail.
    format!("{:#}\n", sorted(value.clone()))
}

/// The canonical text without white space, which is what gets hashed.
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
