//! Decodes edits of a file from the bytes of an input. Every input is valid, and small changes of an input change the edits little.

use serde_json::Value;

/// The bytes of an input that have not been used yet, followed by zeros.
pub(crate) struct Input<'a>(pub(crate) &'a [u8]);

impl<'a> Input<'a> {
    pub(crate) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    pub(crate) fn byte(&mut self) -> u8 {
        let Some((first, rest)) = self.0.split_first() else {
            return 0;
        };
        self.0 = rest;
        *first
    }

    pub(crate) fn number(&mut self) -> usize {
        usize::from(self.byte()) | usize::from(self.byte()) << 8
    }

    /// Takes `count` bytes, or all that are left.
    pub(crate) fn bytes(&mut self, count: usize) -> &'a [u8] {
        let (first, rest) = self.0.split_at(count.min(self.0.len()));
        self.0 = rest;
        first
    }
}

/// Reads one edit and applies it to the content of a file. `None` removes the file. `donor` is the content of another file.
///
/// An edit consists of its kind (one byte), the length of its payload (two bytes, little-endian) and the payload.
pub(crate) fn edit(input: &mut Input, content: &[u8], donor: &[u8]) -> Option<Vec<u8>> {
    let kind = input.byte() % 8;
    let length = input.number() % 2048;
    let mut payload = Input(input.bytes(length));
    let mut edited = content.to_vec();
    match kind {
        0 => edited = payload.0.to_vec(),
        1 => {
            let at = payload.number() % (edited.len() + 1);
            let new = payload.0;
            let end = edited.len().min(at + new.len());
            edited[at..end].copy_from_slice(&new[..end - at]);
        }
        2 => edited.truncate(payload.number()),
        3 => return None,
        4 => {
            let key = payload.byte();
            let value = std::str::from_utf8(payload.0).unwrap_or("");
            let value = serde_json::from_str(value).unwrap_or_else(|_| Value::String(value.to_owned()));
            edited = with_json(edited, |place| *place = value, usize::from(key));
        }
        5 => {
            let (key, axis) = (payload.byte(), payload.byte());
            let mut number = [0; 8];
            for byte in &mut number {
                *byte = payload.byte();
            }
            let number = u64::from_le_bytes(number);
            let set = |place: &mut Value| match place {
                Value::Array(items) if !items.is_empty() => {
                    let axis = usize::from(axis) % items.len();
                    items[axis] = number.into();
                }
                other => *other = number.into(),
            };
            edited = with_json(edited, set, usize::from(key));
        }
        6 => {
            let at = payload.number() % (edited.len() + 1);
            edited.splice(at..at, payload.0.iter().copied());
        }
        _ => edited = donor.to_vec(),
    }
    Some(edited)
}

/// Changes one value of a JSON text. Values are numbered with outer values before inner ones.
fn with_json(text: Vec<u8>, change: impl FnOnce(&mut Value), number: usize) -> Vec<u8> {
    let Ok(mut value) = serde_json::from_slice::<Value>(&text) else {
        return text;
    };
    let count = count(&value);
    if let Some(place) = nth(&mut value, number % count) {
        change(place);
    }
    serde_json::to_vec(&value).unwrap_or(text)
}

fn count(value: &Value) -> usize {
    1 + match value {
        Value::Array(items) => items.iter().map(count).sum(),
        Value::Object(map) => map.values().map(count).sum(),
        _ => 0,
    }
}

fn nth(value: &mut Value, number: usize) -> Option<&mut Value> {
    let Some(mut number) = number.checked_sub(1) else {
        return Some(value);
    };
    let inner: Vec<&mut Value> = match value {
        Value::Array(items) => items.iter_mut().collect(),
        Value::Object(map) => map.values_mut().collect(),
        _ => Vec::new(),
    };
    for item in inner {
        let here = count(item);
        if number < here {
            return nth(item, number);
        }
        number -= here;
    }
    None
}
