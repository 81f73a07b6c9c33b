//! The HDF5 file: groups, attributes and datasets, through the HDF5 library, and numbers of contiguous datasets read beside
//! it.
//!
//! The library takes one lock for everything, and its time to open a dataset. So where a contiguous dataset lies is looked up
//! beside it in files of the usual format (`direct.rs`), by the library in all others; its bytes are read from the file
//! itself, in any thread. Chunked and compressed datasets are decoded by the library.

use std::ops::Range;
use std::os::unix::fs::FileExt as _;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

use hdf5::dataset::Layout;
use hdf5::datatype::ByteOrder;
use hdf5::types::{FixedAscii, FixedUnicode, FloatSize, IntSize, TypeDescriptor, VarLenAscii, VarLenUnicode};
use hdf5::{Container, Dataset, Datatype, Hyperslab, SliceOrIndex};

use super::direct::{Direct, Header, Members, Number};
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
    direct: Option<Direct>,
    /// Groups that were looked up last, by path; the root and `/data` stay.
    groups: Mutex<Vec<(String, Arc<Members>)>>,
}

/// Groups that are remembered: the root, `/data`, a demonstration and the groups in it.
const GROUPS: usize = 6;

/// Type of the elements of a dataset.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Element {
    /// Little-endian double precision: the only one that is read without conversion.
    F64,
    /// Single precision.
    F32,
    /// Little-endian signed 64-bit integers.
    I64,
    /// Bytes, as pictures have.
    U8,
    /// Another type that the library converts to double precision: other integers, truth values, the other byte order.
    Whole,
}

impl Element {
    /// Bytes in memory once read: pictures stay bytes, all other numbers become double precision.
    fn size(self) -> u64 {
        if self == Self::U8 { 1 } else { 8 }
    }
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
            return Err(Hdf5Fault::Folder.into());
        }
        let bytes = std::fs::File::open(path).map_err(|error| Fault::io("read", path, error))?;
        let hdf5 = hdf5::File::open(path).map_err(|error| Hdf5Fault::Unreadable { why: words(&error) })?;
        let length = metadata.len();
        let direct = Direct::open(&bytes, length);
        let root = direct.as_ref().and_then(|direct| direct.root(&bytes));
        Ok(Self {
            hdf5,
            bytes,
            length,
            direct: direct.filter(|_| root.is_some()),
            groups: Mutex::new(root.into_iter().map(|root| (String::new(), Arc::new(root))).collect()),
        })
    }

    /// The header of an object, found beside the library.
    fn header(&self, path: &str) -> Option<Header> {
        let (parent, name) = path.rsplit_once('/').unwrap_or(("", path));
        let address = *self.group(parent)?.get(name)?;
        self.direct.as_ref()?.header(&self.bytes, address)
    }

    /// The members of a group, found beside the library.
    fn group(&self, path: &str) -> Option<Arc<Members>> {
        let known = |groups: &[(String, Arc<Members>)]| {
            let found = groups.iter().find(|(known, _)| known == path);
            found.map(|(_, members)| Arc::clone(members))
        };
        if let Some(members) = known(&self.groups.lock().unwrap_or_else(PoisonError::into_inner)) {
            return Some(members);
        }
        if path.is_empty() {
            return None;
        }
        let header = self.header(path)?;
        let members = Arc::new(self.direct.as_ref()?.members(&self.bytes, &header)?);
        let mut groups = self.groups.lock().unwrap_or_else(PoisonError::into_inner);
        if groups.len() >= GROUPS {
            groups.remove(2);
        }
        groups.push((path.to_owned(), Arc::clone(&members)));
        Some(members)
    }

    /// Names of the members of a group that is there, in their byte order.
    pub(crate) fn members(&self, group: &str) -> Result<Vec<String>, Hdf5Fault> {
        if let Some(members) = self.group(group) {
            return Ok(members.keys().cloned().collect());
        }
        let object = format!("group /{group}");
        let found = self.hdf5.group(group).map_err(damaged(&object))?;
        self.own(&found, &object)?;
        let mut names = found.member_names().map_err(damaged(&object))?;
        names.sort_unstable();
        Ok(names)
    }

    /// Names of the members of a group, none where there is no such group.
    pub(crate) fn members_or_none(&self, group: &str) -> Result<Vec<String>, Hdf5Fault> {
        if self.exists(group) {
            self.members(group)
        } else {
            Ok(Vec::new())
        }
    }

    /// Whether there is an object at this path, link by link.
    pub(crate) fn exists(&self, path: &str) -> bool {
        let path = path.trim_start_matches('/');
        let mut ends = path.match_indices('/').map(|(end, _)| end).chain([path.len()]);
        ends.all(|end| self.hdf5.link_exists(&path[..end]))
    }

    /// A whole number in an attribute of a group that is there; `None` where it has none of this name.
    pub(crate) fn count(&self, group: &str, name: &str) -> Result<Option<i64>, Hdf5Fault> {
        if let Some(count) = self.header(group).and_then(|header| header.count(name)) {
            return Ok(Some(count));
        }
        let Some((attribute, object)) = self.attribute(group, name)? else {
            return Ok(None);
        };
        attribute.read_scalar::<i64>().map(Some).map_err(damaged(&object))
    }

    /// The text of an attribute of a group that is there; `None` where it has none of this name.
    pub(crate) fn text(&self, group: &str, name: &str) -> Result<Option<String>, Hdf5Fault> {
        let direct = self.direct.as_ref();
        if let Some(text) = direct.and_then(|direct| direct.text(&self.bytes, &self.header(group)?, name)) {
            return Ok(Some(text));
        }
        let Some((attribute, object)) = self.attribute(group, name)? else {
            return Ok(None);
        };
        if attribute.size() != 1 {
            return Err(damaged(&object)(internal(format!(
                "it holds {} texts",
                attribute.size()
            ))));
        }
        Ok(texts(&attribute, &object)?.pop())
    }

    /// Refuses an object that a link leads to in another file: the hash of the source would not hold it.
    fn own(&self, location: &hdf5::Location, object: &str) -> Result<(), Hdf5Fault> {
        if location.filename() == self.hdf5.filename() {
            return Ok(());
        }
        Err(Hdf5Fault::Elsewhere {
            object: object.to_owned(),
            place: location.filename(),
        })
    }

    /// The same of a dataset, whose numbers may lie in other files, too.
    fn own_numbers(&self, dataset: &Dataset, object: &str) -> Result<(), Hdf5Fault> {
        self.own(dataset, object)?;
        let list = dataset.create_plist().map_err(damaged(object))?;
        let external = list.external().into_iter().next().map(|file| file.name);
        let place = match dataset.layout() {
            Layout::Virtual => Some("other datasets (it is a virtual one)".to_owned()),
            _ => external,
        };
        place.map_or(Ok(()), |place| {
            Err(Hdf5Fault::Elsewhere {
                object: object.to_owned(),
                place,
            })
        })
    }

    /// An attribute of a group, by the library.
    fn attribute(&self, group: &str, name: &str) -> Result<Option<(hdf5::Attribute, String)>, Hdf5Fault> {
        let object = format!("group /{group}");
        let location = self.hdf5.group(group).map_err(damaged(&object))?;
        self.own(&location, &object)?;
        let names = location.attr_names().map_err(damaged(&object))?;
        if names.iter().all(|there| there != name) {
            return Ok(None);
        }
        let object = format!("attribute {name} of /{group}");
        let attribute = location.attr(name).map_err(damaged(&object))?;
        Ok(Some((attribute, object)))
    }

    /// Names in a dataset of texts.
    pub(crate) fn names(&self, path: &str) -> Result<Vec<String>, Hdf5Fault> {
        let dataset = self.hdf5.dataset(path).map_err(damaged(path))?;
        self.own_numbers(&dataset, &format!("dataset {path}"))?;
        let size = dataset.size() as u64;
        if size.saturating_mul(4) > self.length {
            return Err(damaged(path)(hdf5::Error::Internal(format!(
                "it claims to hold {size} names"
            ))));
        }
        texts(&dataset, path)
    }

    /// Finds a dataset of numbers that is there.
    pub(crate) fn locate(&self, path: &str) -> Result<Located, Hdf5Fault> {
        if let Some(found) = self.header(path).and_then(|header| header.contiguous()) {
            let bytes = found.shape.iter().map(|&side| side as u64).product::<u64>() * 8;
            if bytes <= MOST_BYTES && found.offset.checked_add(bytes).is_some_and(|end| end <= self.length) {
                return Ok(Located {
                    name: path.to_owned(),
                    shape: found.shape,
                    element: match found.element {
                        Number::F64 => Element::F64,
                        Number::I64 => Element::I64,
                    },
                    place: Place::Offset(found.offset),
                });
            }
        }
        let object = format!("dataset {path}");
        let damaged = || damaged(&object);
        let dataset = self.hdf5.dataset(path).map_err(damaged())?;
        self.own_numbers(&dataset, &object)?;
        let shape = dataset.get_shape().map_err(damaged())?;
        let dtype = dataset.dtype().map_err(damaged())?;
        let element = element(&dtype, path)?;
        let values = shape
            .iter()
            .try_fold(1_u64, |size, &side| size.checked_mul(side as u64));
        let bytes = values.and_then(|values| values.checked_mul(element.size()));
        let Some(bytes) = bytes.filter(|bytes| *bytes <= MOST_BYTES || element == Element::U8) else {
            return Err(damaged()(internal(format!("it claims the shape {shape:?}"))));
        };
        let direct = matches!(element, Element::F64 | Element::U8);
        let offset = direct.then(|| dataset.offset()).flatten();
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
        Ok(Located {
            name: path.to_owned(),
            shape,
            element,
            place,
        })
    }

    /// Whole pictures of a dataset of bytes with these rows, one after the other.
    pub(crate) fn read_bytes(&self, located: &Located, rows: Range<usize>) -> Result<Vec<u8>, Hdf5Fault> {
        let damaged = damaged(&format!("dataset {}", located.name));
        let row: usize = located.shape.iter().skip(1).product();
        match &located.place {
            Place::Offset(offset) => {
                let mut bytes = vec![0; rows.len() * row];
                self.bytes
                    .read_exact_at(&mut bytes, offset + (rows.start * row) as u64)
                    .map_err(|error| damaged(internal(error.to_string())))?;
                Ok(bytes)
            }
            Place::Library(dataset) => {
                let whole = located.shape.iter().skip(1).map(|&side| SliceOrIndex::from(0..side));
                let slices: Vec<SliceOrIndex> = std::iter::once(SliceOrIndex::from(rows)).chain(whole).collect();
                let pixels = dataset.read_slice::<u8, _, ndarray::IxDyn>(Hyperslab::from(slices));
                Ok(pixels.map_err(damaged)?.into_raw_vec_and_offset().0)
            }
        }
    }

    /// Rows that have to be decoded together: those of a chunk.
    pub(crate) fn chunk_rows(located: &Located) -> usize {
        let rows = located.shape.first().copied().unwrap_or(0);
        match &located.place {
            Place::Offset(_) => 1,
            Place::Library(dataset) => dataset.chunk().and_then(|chunk| chunk.first().copied()).unwrap_or(rows),
        }
    }

    /// The numbers of a dataset, row by row.
    pub(crate) fn read(&self, located: &Located) -> Result<Vec<f64>, Hdf5Fault> {
        let damaged = damaged(&format!("dataset {}", located.name));
        let values = located.shape.iter().map(|&side| side as u64).product::<u64>();
        if values > MOST_BYTES / 8 {
            return Err(damaged(internal(format!("it claims the shape {:?}", located.shape))));
        }
        match &located.place {
            Place::Library(dataset) => dataset.read_raw::<f64>().map_err(damaged),
            Place::Offset(_) if located.element == Element::U8 => {
                let rows = located.shape.first().copied().unwrap_or(0);
                Ok(self.read_bytes(located, 0..rows)?.into_iter().map(f64::from).collect())
            }
            Place::Offset(offset) => {
                let values: usize = located.shape.iter().product();
                let mut bytes = vec![0; values * 8];
                self.bytes
                    .read_exact_at(&mut bytes, *offset)
                    .map_err(|error| damaged(internal(error.to_string())))?;
                let (numbers, _) = bytes.as_chunks::<8>();
                Ok(if located.element == Element::I64 {
                    numbers
                        .iter()
                        .map(|number| i64::from_le_bytes(*number) as f64)
                        .collect()
                } else {
                    numbers.iter().map(|number| f64::from_le_bytes(*number)).collect()
                })
            }
        }
    }
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

fn internal(text: String) -> hdf5::Error {
    hdf5::Error::Internal(text)
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

#[cfg(test)]
mod tests {
    use super::*;

    /// What is found beside the library is what the library finds.
    #[test]
    fn both_ways_to_look_up_agree() {
        let sample = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../data/can-sample.hdf5");
        let direct = File::open(&sample).unwrap();
        let library = File {
            direct: None,
            groups: Mutex::default(),
            ..File::open(&sample).unwrap()
        };
        assert!(direct.group("data/demo_0/obs").is_some());
        assert!(library.group("data").is_none());
        let mut compared = 0;
        assert_eq!(direct.members("data").unwrap(), library.members("data").unwrap());
        assert_eq!(
            direct.text("data", "env_args").unwrap(),
            library.text("data", "env_args").unwrap()
        );
        for demo in direct.members("data").unwrap() {
            let group = format!("data/{demo}");
            for name in ["num_samples", "nothing"] {
                assert_eq!(
                    direct.count(&group, name).unwrap(),
                    library.count(&group, name).unwrap()
                );
            }
            for folder in [group.clone(), format!("{group}/obs")] {
                let names = direct.members(&folder).unwrap();
                assert_eq!(names, library.members(&folder).unwrap());
                for name in names.iter().filter(|name| *name != "obs") {
                    let path = format!("{folder}/{name}");
                    let [ours, theirs] = [&direct, &library].map(|file| file.locate(&path).unwrap());
                    assert!(matches!(ours.place, Place::Offset(_)), "{path}");
                    assert_eq!(ours.shape, theirs.shape, "{path}");
                    let [ours, theirs] = [(&direct, ours), (&library, theirs)].map(|(file, found)| {
                        let numbers = file.read(&found).unwrap();
                        numbers.into_iter().map(f64::to_bits).collect::<Vec<_>>()
                    });
                    assert_eq!(ours, theirs, "{path}");
                    compared += 1;
                }
            }
        }
        assert_eq!(compared, 19 * 8);
    }
}
