//! Conversions from the HDF5 library: strings of any kind, element types, and error messages.

use hdf5::datatype::ByteOrder;
use hdf5::types::{FixedAscii, FixedUnicode, FloatSize, IntSize, TypeDescriptor, VarLenAscii, VarLenUnicode};
use hdf5::{Container, Datatype, H5Type};

use super::fault::Hdf5Fault;
use super::file::Element;

/// Buffer size for fixed-length strings: names in `/mask` and short attributes. Longer strings use a buffer of 1 MiB.
const MAX_NAME: usize = 256;

/// Reads all strings of an attribute or dataset, of any string type.
pub(super) fn texts(container: &Container, object: &str) -> Result<Vec<String>, Hdf5Fault> {
    let damaged = damaged(object);
    let read = || -> hdf5::Result<Option<Vec<String>>> {
        // The library does not check that strings are valid UTF-8.
        fn all<T: H5Type>(container: &Container, bytes: fn(&T) -> &[u8]) -> hdf5::Result<Option<Vec<String>>> {
            let texts = container.read_raw::<T>()?;
            let texts = texts.iter().map(|text| String::from_utf8(bytes(text).to_vec()));
            texts
                .collect::<Result<_, _>>()
                .map(Some)
                .map_err(|error| hdf5::Error::Internal(format!("it is not valid UTF-8: {error}")))
        }
        match container.dtype()?.to_descriptor()? {
            TypeDescriptor::VarLenUnicode => all(container, |text: &VarLenUnicode| text.as_bytes()),
            TypeDescriptor::VarLenAscii => all(container, |text: &VarLenAscii| text.as_bytes()),
            TypeDescriptor::FixedAscii(length) if length <= MAX_NAME => {
                all(container, |text: &FixedAscii<MAX_NAME>| text.as_bytes())
            }
            TypeDescriptor::FixedUnicode(length) if length <= MAX_NAME => {
                all(container, |text: &FixedUnicode<MAX_NAME>| text.as_bytes())
            }
            TypeDescriptor::FixedAscii(_) => all(container, |text: &FixedAscii<{ 1 << 20 }>| text.as_bytes()),
            TypeDescriptor::FixedUnicode(_) => all(container, |text: &FixedUnicode<{ 1 << 20 }>| text.as_bytes()),
            _ => Ok(None),
        }
    };
    match read() {
        Ok(Some(texts)) => Ok(texts),
        Ok(None) => Err(Hdf5Fault::Dtype {
            object: object.to_owned(),
            found: "data other than text".to_owned(),
            expected: "text",
        }),
        Err(error) => Err(damaged(error)),
    }
}

pub(super) fn element(dtype: &Datatype, path: &str) -> Result<Element, Hdf5Fault> {
    let descriptor = dtype.to_descriptor().map_err(damaged(path))?;
    match descriptor {
        TypeDescriptor::Float(FloatSize::U8) if dtype.byte_order() == ByteOrder::LittleEndian => Ok(Element::F64),
        TypeDescriptor::Float(FloatSize::U4) => Ok(Element::F32),
        TypeDescriptor::Unsigned(IntSize::U1) => Ok(Element::U8),
        TypeDescriptor::Integer(IntSize::U1 | IntSize::U2 | IntSize::U4 | IntSize::U8)
        | TypeDescriptor::Unsigned(_)
        | TypeDescriptor::Boolean
        | TypeDescriptor::Float(FloatSize::U8) => Ok(Element::Whole),
        other => Err(Hdf5Fault::Dtype {
            object: path.to_owned(),
            found: match other {
                TypeDescriptor::FixedAscii(_)
                | TypeDescriptor::FixedUnicode(_)
                | TypeDescriptor::VarLenAscii
                | TypeDescriptor::VarLenUnicode => "text".to_owned(),
                other => other.to_string(),
            },
            expected: "float64 or float32",
        }),
    }
}

pub(super) fn internal(text: String) -> hdf5::Error {
    hdf5::Error::Internal(text)
}

pub(super) fn damaged(object: &str) -> impl Fn(hdf5::Error) -> Hdf5Fault + use<> {
    let object = object.to_owned();
    move |error| Hdf5Fault::Damaged {
        object: object.clone(),
        why: message(&error),
        others: 0,
    }
}

/// The library's message: that of the innermost call, which is the most specific.
pub(super) fn message(error: &hdf5::Error) -> String {
    match error {
        hdf5::Error::Internal(text) => text.clone(),
        hdf5::Error::HDF5(_) => error
            .stack()
            .and_then(|stack| stack.iter().last().map(|frame| frame.desc().to_owned()))
            .unwrap_or_else(|| "the HDF5 library reports no reason".to_owned()),
    }
}
