//! What the HDF5 library gives: texts of whatever kind, types of elements, and its words.

use hdf5::datatype::ByteOrder;
use hdf5::types::{FixedAscii, FixedUnicode, FloatSize, IntSize, TypeDescriptor, VarLenAscii, VarLenUnicode};
use hdf5::{Container, Datatype, H5Type};

use super::fault::Hdf5Fault;
use super::file::Element;

/// Names in `/mask` and the attributes' fixed-length texts are at most this long.
const LONGEST_NAME: usize = 256;

/// All texts of an attribute or dataset, of whatever kind.
pub(super) fn texts(container: &Container, object: &str) -> Result<Vec<String>, Hdf5Fault> {
    let damaged = damaged(object);
    let read = || -> hdf5::Result<Option<Vec<String>>> {
        // The library trusts the file that texts are UTF-8.
        fn all<T: H5Type>(container: &Container, bytes: fn(&T) -> &[u8]) -> hdf5::Result<Option<Vec<String>>> {
            let texts = container.read_raw::<T>()?;
            let texts = texts.iter().map(|text| String::from_utf8(bytes(text).to_vec()));
            texts
                .collect::<Result<_, _>>()
                .map(Some)
                .map_err(|error| hdf5::Error::Internal(format!("it is no text: {error}")))
        }
        match container.dtype()?.to_descriptor()? {
            TypeDescriptor::VarLenUnicode => all(container, |text: &VarLenUnicode| text.as_bytes()),
            TypeDescriptor::VarLenAscii => all(container, |text: &VarLenAscii| text.as_bytes()),
            TypeDescriptor::FixedAscii(length) if length <= LONGEST_NAME => {
                all(container, |text: &FixedAscii<LONGEST_NAME>| text.as_bytes())
            }
            TypeDescriptor::FixedUnicode(length) if length <= LONGEST_NAME => {
                all(container, |text: &FixedUnicode<LONGEST_NAME>| text.as_bytes())
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
            found: "no text".to_owned(),
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
        why: words(&error),
        others: 0,
    }
}

/// The library's words: those of the innermost call, which says what it met.
pub(super) fn words(error: &hdf5::Error) -> String {
    match error {
        hdf5::Error::Internal(text) => text.clone(),
        hdf5::Error::HDF5(_) => error
            .stack()
            .and_then(|stack| stack.iter().last().map(|frame| frame.desc().to_owned()))
            .unwrap_or_else(|| "the HDF5 library gives no reason".to_owned()),
    }
}
