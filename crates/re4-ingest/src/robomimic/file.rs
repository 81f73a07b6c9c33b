//! The HDF5 file: groups, attributes and datasets, through the HDF5 library, and numbers of contiguous datasets read beside
//! it.
//!
//! The library takes one lock for everything. So it only says where a contiguous dataset lies ([`File::locate`]); its bytes
//! are read from the file itself, in any thread. Chunked and compressed datasets are decoded by the library.

use std::os::unix::fs::FileExt as _;
use std::path::Path;

use hdf5::datatype::ByteOrder;
use hdf5::types::{FixedAscii, FixedUnicode, FloatSize, IntSize, TypeDescriptor, VarLenAscii, VarLenUnicode};
use hdf5::{Container, Dataset, Datatype, Location};

use super::fault::Hdf5Fault;
use crate::error::Fault;

/// Most bytes that one dataset of numbers may have: a day of control steps of a wide state.
const MOST_BYTES: u64 = 1 << 30;

/// Names in `/mask` and the attributes' fixed-length texts are at most this long.
const LONGEST_NAME: usize = 256;

/// An opened file.
pub(crate) struct File {
    hdf5: hdf5::File,
    bytes: std::fs::File,
    length: u64,
}

/// Type of the elements of a dataset.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Element {
    /// Little-endian double precision: the only one that is read without conversion.
    F64,
    /// Single precision.
    F32,
    /// Another type that the library converts to double precision without loss of what is meant: integers, truth values.
    Whole,
}

/// A dataset of numbers that was found and not yet read.
pub(crate) struct Located {
    /// Path within the file.
    pub(crate) name: String,
    /// Its shape.
    pub(crate) shape: Vec<usize>,
    /// Type of its elements.
    pub(crate) element: Element,
    place: Place,
}

enum Place {
    /// At this offset of the file, contiguous.
    Offset(u64),
    /// Wherever the library finds it.
    Library(Dataset),
}

impl File {
    /// Opens a file for reading.
    pub(crate) fn open(path: &Path) -> Result<Self, Fault> {
        let metadata = std::fs::metadata(path).map_err(|error| match error.kind() {
            std::io::ErrorKind::NotFound => Fault::MissingPath,
            _ => Fault::io("read", path, error),
        })?;
        if metadata.is_dir() {
            return Err(Hdf5Fault::Other(
                "it is a folder, and robosuite's tasks are read from one HDF5 file; give the path of that file"
                    .to_owned(),
            )
            .into());
        }
        let bytes = std::fs::File::open(path).map_err(|error| Fault::io("read", path, error))?;
        let hdf5 = hdf5::File::open(path).map_err(|error| Hdf5Fault::Unreadable { why: words(&error) })?;
        Ok(Self {
            hdf5,
            bytes,
            length: metadata.len(),
        })
    }

    /// Names of the members of a group, in the byte order of the names; `None` where there is no such group.
    pub(crate) fn members(&self, group: &str) -> Result<Option<Vec<String>>, Hdf5Fault> {
        if !self.exists(group) {
            return Ok(None);
        }
        let damaged = damaged(group);
        let mut names = self
            .hdf5
            .group(group)
            .and_then(|group| group.member_names())
            .map_err(damaged)?;
        names.sort_unstable();
        Ok(Some(names))
    }

    /// Whether there is an object at this path, link by link.
    pub(crate) fn exists(&self, path: &str) -> bool {
        let path = path.trim_start_matches('/');
        let mut ends = path.match_indices('/').map(|(end, _)| end).chain([path.len()]);
        ends.all(|end| self.hdf5.link_exists(&path[..end]))
    }

    /// Text of an attribute of a group; `None` where it has none of this name.
    pub(crate) fn text_attribute(&self, group: &str, name: &'static str) -> Result<Option<String>, Hdf5Fault> {
        let group_of_file = self.hdf5.group(group).map_err(damaged(group))?;
        text_attribute(&group_of_file, group, name)
    }

    /// An attribute of a group that counts; `None` where it has none of this name.
    pub(crate) fn count_attribute(&self, group: &str, name: &'static str) -> Result<Option<i64>, Hdf5Fault> {
        let location = self.hdf5.group(group).map_err(damaged(group))?;
        if !has_attribute(&location, group, name)? {
            return Ok(None);
        }
        let object = || format!("attribute {name} of {group}");
        let attribute = location.attr(name).map_err(damaged(&object()))?;
        attribute.read_scalar::<i64>().map(Some).map_err(damaged(&object()))
    }

    /// Names in a dataset of texts.
    pub(crate) fn names(&self, path: &str) -> Result<Vec<String>, Hdf5Fault> {
        let dataset = self.hdf5.dataset(path).map_err(damaged(path))?;
        let size = dataset.size() as u64;
        if size.saturating_mul(4) > self.length {
            return Err(damaged(path)(hdf5::Error::Internal(format!(
                "it claims to hold {size} names"
            ))));
        }
        texts(&dataset, path)
    }

    /// Finds a dataset of numbers; `None` where there is none at this path.
    pub(crate) fn locate(&self, path: &str) -> Result<Option<Located>, Hdf5Fault> {
        if !self.exists(path) {
            return Ok(None);
        }
        let dataset = self.hdf5.dataset(path).map_err(damaged(path))?;
        let shape = dataset.get_shape().map_err(damaged(path))?;
        let dtype = dataset.dtype().map_err(damaged(path))?;
        let element = element(&dtype, path)?;
        let values = shape
            .iter()
            .try_fold(1_u64, |size, &side| size.checked_mul(side as u64));
        let bytes = values
            .and_then(|values| values.checked_mul(8))
            .filter(|bytes| *bytes <= MOST_BYTES);
        let Some(bytes) = bytes else {
            return Err(damaged(path)(hdf5::Error::Internal(format!(
                "it claims the shape {shape:?}"
            ))));
        };
        let offset = (element == Element::F64).then(|| dataset.offset()).flatten();
        let place = match offset {
            Some(offset) if offset.checked_add(bytes).is_none_or(|end| end > self.length) => {
                return Err(Hdf5Fault::Damaged {
                    object: format!("dataset {path}"),
                    why: "it leads beyond the end of the file".to_owned(),
                });
            }
            Some(offset) => Place::Offset(offset),
            None => Place::Library(dataset),
        };
        Ok(Some(Located {
            name: path.to_owned(),
            shape,
            element,
            place,
        }))
    }

    /// The numbers of a dataset, row by row.
    pub(crate) fn read(&self, located: &Located) -> Result<Vec<f64>, Hdf5Fault> {
        let damaged = damaged(&format!("dataset {}", located.name));
        match &located.place {
            Place::Library(dataset) => dataset.read_raw::<f64>().map_err(damaged),
            Place::Offset(offset) => {
                let values: usize = located.shape.iter().product();
                let mut bytes = vec![0; values * 8];
                self.bytes
                    .read_exact_at(&mut bytes, *offset)
                    .map_err(|error| damaged(hdf5::Error::Internal(error.to_string())))?;
                let (numbers, _) = bytes.as_chunks::<8>();
                Ok(numbers.iter().map(|number| f64::from_le_bytes(*number)).collect())
            }
        }
    }
}

fn has_attribute(location: &Location, object: &str, name: &str) -> Result<bool, Hdf5Fault> {
    let names = location.attr_names().map_err(damaged(object))?;
    Ok(names.iter().any(|there| there == name))
}

fn text_attribute(location: &Location, object: &str, name: &'static str) -> Result<Option<String>, Hdf5Fault> {
    if !has_attribute(location, object, name)? {
        return Ok(None);
    }
    let object = format!("attribute {name} of {object}");
    let attribute = location.attr(name).map_err(damaged(&object))?;
    let mut texts = texts(&attribute, &object)?;
    Ok((texts.len() == 1).then(|| texts.pop()).flatten())
}

/// All texts of an attribute or dataset, of whatever kind.
fn texts(container: &Container, object: &str) -> Result<Vec<String>, Hdf5Fault> {
    let damaged = damaged(object);
    let read = || -> hdf5::Result<Option<Vec<String>>> {
        fn all<T: hdf5::H5Type + Bytes>(container: &Container) -> hdf5::Result<Option<Vec<String>>> {
            let texts = container.read_raw::<T>()?;
            let texts: Result<Vec<_>, _> = texts
                .iter()
                .map(|text| String::from_utf8(text.bytes().to_vec()))
                .collect();
            texts
                .map(Some)
                .map_err(|error| hdf5::Error::Internal(format!("it is no text: {error}")))
        }
        match container.dtype()?.to_descriptor()? {
            TypeDescriptor::VarLenUnicode => all::<VarLenUnicode>(container),
            TypeDescriptor::VarLenAscii => all::<VarLenAscii>(container),
            TypeDescriptor::FixedAscii(length) if length <= LONGEST_NAME => all::<FixedAscii<LONGEST_NAME>>(container),
            TypeDescriptor::FixedUnicode(length) if length <= LONGEST_NAME => {
                all::<FixedUnicode<LONGEST_NAME>>(container)
            }
            TypeDescriptor::FixedAscii(_) => all::<FixedAscii<{ 1 << 20 }>>(container),
            TypeDescriptor::FixedUnicode(_) => all::<FixedUnicode<{ 1 << 20 }>>(container),
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

/// Bytes of a text of the library, which trusts the file that they are UTF-8.
trait Bytes {
    fn bytes(&self) -> &[u8];
}

impl Bytes for VarLenUnicode {
    fn bytes(&self) -> &[u8] {
        self.as_bytes()
    }
}

impl Bytes for VarLenAscii {
    fn bytes(&self) -> &[u8] {
        self.as_bytes()
    }
}

impl<const N: usize> Bytes for FixedAscii<N> {
    fn bytes(&self) -> &[u8] {
        self.as_bytes()
    }
}

impl<const N: usize> Bytes for FixedUnicode<N> {
    fn bytes(&self) -> &[u8] {
        self.as_bytes()
    }
}

fn element(dtype: &Datatype, path: &str) -> Result<Element, Hdf5Fault> {
    let descriptor = dtype.to_descriptor().map_err(damaged(path))?;
    match descriptor {
        TypeDescriptor::Float(FloatSize::U8) if dtype.byte_order() == ByteOrder::LittleEndian => Ok(Element::F64),
        TypeDescriptor::Float(FloatSize::U8) => Ok(Element::Whole),
        TypeDescriptor::Float(FloatSize::U4) => Ok(Element::F32),
        TypeDescriptor::Integer(IntSize::U1 | IntSize::U2 | IntSize::U4 | IntSize::U8)
        | TypeDescriptor::Unsigned(_)
        | TypeDescriptor::Boolean => Ok(Element::Whole),
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

fn damaged(object: &str) -> impl Fn(hdf5::Error) -> Hdf5Fault + use<> {
    let object = object.to_owned();
    move |error| Hdf5Fault::Damaged {
        object: object.clone(),
        why: words(&error),
    }
}

/// The library's words: those of the innermost call, which says what it met.
fn words(error: &hdf5::Error) -> String {
    match error {
        hdf5::Error::Internal(text) => text.clone(),
        hdf5::Error::HDF5(_) => error
            .stack()
            .and_then(|stack| stack.iter().last().map(|frame| frame.desc().to_owned()))
            .unwrap_or_else(|| "the HDF5 library gives no reason".to_owned()),
    }
}
