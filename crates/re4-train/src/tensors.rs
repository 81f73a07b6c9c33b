//! Safetensors files of 32-bit floats.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use re4_fault::{Fault, fault};
use safetensors::tensor::TensorView;
use safetensors::{Dtype, SafeTensorError, SafeTensors};

/// Shape and values of tensors, by name.
pub type Tensors = BTreeMap<String, (Vec<usize>, Vec<f32>)>;

/// Maximum size of a file, in bytes; a larger file is refused before it is read.
const MAXIMUM_SIZE: u64 = 4 << 30;

/// Serialises tensors, sorted by name and without metadata, whose order is not deterministic: equal tensors give equal bytes.
///
/// # Errors
/// If a shape does not match its values.
pub fn to_bytes(tensors: &Tensors) -> Result<Vec<u8>, Fault> {
    let bytes: BTreeMap<&String, (&Vec<usize>, Vec<u8>)> = tensors
        .iter()
        .map(|(name, (shape, values))| {
            (
                name,
                (shape, values.iter().flat_map(|value| value.to_le_bytes()).collect()),
            )
        })
        .collect();
    let views: Result<Vec<_>, _> = bytes
        .iter()
        .map(|(name, (shape, bytes))| Ok((*name, TensorView::new(Dtype::F32, (*shape).clone(), bytes)?)))
        .collect();
    views
        .and_then(|views| safetensors::serialize(views, None))
        .map_err(|error: SafeTensorError| fault!("the weights cannot be serialised ({error})"))
}

/// Reads tensors, and checks that all values are finite.
///
/// # Errors
/// If the file cannot be read, is not a complete safetensors file, or has a tensor of another type or with a value that is not
/// finite.
pub fn read(path: &Path) -> Result<Tensors, Fault> {
    let again = "train again";
    let cannot_read =
        |error: std::io::Error| fault!("the file cannot be read ({error})"; "check its permissions and the disk");
    let length = fs::metadata(path).map_err(cannot_read)?.len();
    if length > MAXIMUM_SIZE {
        return Err(fault!("the file has {length} bytes, more than any policy has"; "{again}"));
    }
    let bytes = fs::read(path).map_err(cannot_read)?;
    let file = SafeTensors::deserialize(&bytes).map_err(|error| {
        let what = match error {
            SafeTensorError::MetadataIncompleteBuffer | SafeTensorError::InvalidHeaderLength => {
                "it is truncated or has extra bytes"
            }
            _ => "it is not a valid safetensors file",
        };
        fault!("{what} ({error})"; "{again}")
    })?;
    let mut tensors = Tensors::new();
    for (name, view) in file.iter() {
        if view.dtype() != Dtype::F32 {
            return Err(fault!("{name} has the data type {:?}", view.dtype(); "save the weights as 32-bit floats"));
        }
        let values: Vec<f32> = view
            .data()
            .as_chunks()
            .0
            .iter()
            .map(|bytes| f32::from_le_bytes(*bytes))
            .collect();
        if let Some(value) = values.iter().find(|value| !value.is_finite()) {
            return Err(fault!("{name} contains the value {value}, which is invalid in a trained network"; "{again}"));
        }
        tensors.insert(name.to_owned(), (view.shape().to_vec(), values));
    }
    Ok(tensors)
}
