//! Access to an HDF5 file: groups, attributes and datasets.
//!
//! The HDF5 library serializes all calls with one global lock, and opening a dataset is slow. Contiguous datasets are therefore
//! located without the library in files of the most common format (`direct.rs`), and by the library in all others. Their bytes
//! are read directly from the file, on any thread. Chunked and compressed datasets are decoded by the library. A file can be
//! opened without the library; anything that needs it is then [`Hdf5Fault::NeedsLibrary`].

use std::collections::BTreeMap;
use std::ops::Range;
use std::os::fd::AsRawFd as _;
use std::os::unix::fs::FileExt as _;
use std::sync::{Arc, Mutex, PoisonError};

use hdf5::dataset::Layout;
use hdf5::types::TypeDescriptor;
use hdf5::{Dataset, Hyperslab, SliceOrIndex};

use super::direct::{Direct, Header, Members, Number};
use super::fault::Hdf5Fault;
use super::library::{damaged, element, internal, message, texts};
use super::look::{inspect, unreadable};
use crate::error::Fault;
use crate::source::SourceFile;

/// Maximum size in memory of a dataset of numbers. It suffices for a day of control steps of a large state.
const MAX_BYTES: u64 = 1 << 30;

/// How a file may be read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Access {
    /// Without the HDF5 library, which can crash on a damaged file. Only files of the simplest format can be read.
    Direct,
    /// With the HDF5 library where it is needed.
    Library,
}

/// Type of an object in a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    Group,
    Dataset,
    /// Another type, or a dangling link.
    Other,
}

/// An opened file.
pub(crate) struct File {
    source: Arc<SourceFile>,
    /// `None` for [`Access::Direct`].
    library: Option<hdf5::File>,
    direct: Option<Direct>,
    /// Whether reading continues after a fault, to find all faults.
    continues: bool,
    /// Cache of group members by path.
    groups: Mutex<BTreeMap<String, Arc<Members>>>,
}

/// Maximum number of cached groups, a few kilobytes each: those of several thousand demonstrations.
const MAX_GROUPS: usize = 8192;

/// Type of the elements of a dataset.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Element {
    /// Little-endian double precision, which is read without conversion.
    F64,
    /// Single precision.
    F32,
    /// Little-endian signed 64-bit integers.
    I64,
    /// Bytes, as for images.
    U8,
    /// Another type that the library converts to double precision: other integers, booleans, or big-endian floats.
    Whole,
}

impl Element {
    /// Size in memory in bytes: images remain bytes, all other numbers are converted to double precision.
    fn size(self) -> u64 {
        if self == Self::U8 { 1 } else { 8 }
    }
}

/// A dataset of numbers that has been located but not read.
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
    /// Contiguous and little-endian at this offset of the file.
    Offset(u64),
    /// Read by the library.
    Library(Dataset),
}

impl File {
    /// Opens a file for reading.
    pub(crate) fn open(source: Arc<SourceFile>, access: Access, continues: bool) -> Result<Self, Fault> {
        if let Some(fault) = inspect(&source)? {
            return Err(fault.into());
        }
        let direct = Direct::open(source.file(), source.length());
        let root = direct.as_ref().and_then(|direct| direct.root(source.file()));
        let library = match access {
            Access::Direct if root.is_none() => return Err(Hdf5Fault::NeedsLibrary.into()),
            Access::Direct => None,
            // Opened through the existing handle, so that it is the hashed file even if the file at the path was replaced.
            Access::Library => {
                let handle = format!("/proc/self/fd/{}", source.file().as_raw_fd());
                let opened = hdf5::File::open(handle);
                Some(opened.map_err(|error| unreadable(&message(&error)))?)
            }
        };
        Ok(Self {
            source,
            library,
            direct: direct.filter(|_| root.is_some()),
            continues,
            groups: Mutex::new(root.into_iter().map(|root| (String::new(), Arc::new(root))).collect()),
        })
    }

    /// Adds a fault to those of a demonstration, or returns it as an error if reading ends at the first fault.
    pub(crate) fn note(&self, faults: &mut Vec<Hdf5Fault>, fault: Hdf5Fault) -> Result<(), Hdf5Fault> {
        if self.continues {
            faults.push(fault);
            return Ok(());
        }
        Err(fault)
    }

    /// Whether reading ends at the first fault, because the HDF5 library might crash after one.
    pub(crate) fn is_cautious(&self) -> bool {
        !self.continues
    }

    /// Whether reading ends at this fault.
    pub(crate) fn is_fatal(&self, fault: &Hdf5Fault) -> bool {
        !self.continues || matches!(fault, Hdf5Fault::NeedsLibrary)
    }

    fn library(&self) -> Result<&hdf5::File, Hdf5Fault> {
        self.library.as_ref().ok_or(Hdf5Fault::NeedsLibrary)
    }

    fn bytes(&self) -> &std::fs::File {
        self.source.file()
    }

    fn length(&self) -> u64 {
        self.source.length()
    }

    /// The header of an object, found without the library.
    fn header(&self, path: &str) -> Option<Header> {
        let (parent, name) = path.rsplit_once('/').unwrap_or(("", path));
        let address = *self.group(parent)?.get(name)?;
        self.direct.as_ref()?.header(self.bytes(), address)
    }

    /// The members of a group, found without the library.
    fn group(&self, path: &str) -> Option<Arc<Members>> {
        let groups = || self.groups.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(members) = groups().get(path) {
            return Some(Arc::clone(members));
        }
        if path.is_empty() {
            return None;
        }
        let header = self.header(path)?;
        let members = Arc::new(self.direct.as_ref()?.members(self.bytes(), &header)?);
        let mut groups = groups();
        if groups.len() >= MAX_GROUPS {
            // Demonstrations are read in order, so their groups are needed only for a short time; the root and /data are always
            // needed.
            groups.retain(|path, _| !path.contains('/'));
        }
        groups.insert(path.to_owned(), Arc::clone(&members));
        Some(members)
    }

    /// Names of the members of an existing group, in byte order.
    pub(crate) fn members(&self, group: &str) -> Result<Vec<String>, Hdf5Fault> {
        if let Some(members) = self.group(group) {
            return Ok(members.keys().cloned().collect());
        }
        let object = format!("group /{group}");
        let found = self.library()?.group(group).map_err(damaged(&object))?;
        self.check_same_file(&found, &object)?;
        let mut names = found.member_names().map_err(damaged(&object))?;
        names.sort_unstable();
        Ok(names)
    }

    /// Names of the members of a group; empty if the group does not exist.
    pub(crate) fn members_or_none(&self, group: &str) -> Result<Vec<String>, Hdf5Fault> {
        if self.exists(group)? {
            self.members(group)
        } else {
            Ok(Vec::new())
        }
    }

    /// Whether an object exists at this path. Every link of the path is checked.
    pub(crate) fn exists(&self, path: &str) -> Result<bool, Hdf5Fault> {
        let path = path.trim_start_matches('/');
        let ends = || path.match_indices('/').map(|(end, _)| end).chain([path.len()]);
        for end in ends() {
            let (parent, name) = path[..end].rsplit_once('/').unwrap_or(("", &path[..end]));
            let there = match self.group(parent) {
                Some(members) => members.contains_key(name),
                None => self.library()?.link_exists(&path[..end]),
            };
            if !there {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// Type of the existing object at a path.
    pub(crate) fn kind(&self, path: &str) -> Result<Kind, Hdf5Fault> {
        if let Some(header) = self.header(path) {
            return Ok(if header.is_group() { Kind::Group } else { Kind::Dataset });
        }
        let library = self.library()?;
        Ok(if library.group(path).is_ok() {
            Kind::Group
        } else if library.dataset(path).is_ok() {
            Kind::Dataset
        } else {
            Kind::Other
        })
    }

    /// Whether a group has an attribute of this name.
    pub(crate) fn has_attribute(&self, group: &str, name: &str) -> Result<bool, Hdf5Fault> {
        if let Some(has) = self.header(group).and_then(|header| header.has_attribute(name)) {
            return Ok(has);
        }
        Ok(self.attribute(group, name)?.is_some())
    }

    /// An integer attribute of an existing group; `None` if the attribute does not exist.
    pub(crate) fn count(&self, group: &str, name: &str) -> Result<Option<i64>, Hdf5Fault> {
        let header = self.header(group);
        if let Some(count) = header.as_ref().and_then(|header| header.count(name)) {
            return Ok(Some(count));
        }
        if header.and_then(|header| header.has_attribute(name)) == Some(false) {
            return Ok(None);
        }
        let Some((attribute, object)) = self.attribute(group, name)? else {
            return Ok(None);
        };
        let refuse = |why: String| damaged(&object)(internal(why));
        if attribute.size() != 1 {
            return Err(refuse(format!(
                "it contains {} numbers instead of one",
                attribute.size()
            )));
        }
        // Read as an array, which includes single values: some writers store an array of one element, a float or a string.
        let descriptor = attribute
            .dtype()
            .and_then(|dtype| dtype.to_descriptor())
            .map_err(damaged(&object))?;
        let count = match descriptor {
            TypeDescriptor::Integer(_) | TypeDescriptor::Unsigned(_) => {
                let values = attribute.read_raw::<i64>().map_err(damaged(&object))?;
                values.first().copied()
            }
            TypeDescriptor::Float(_) => {
                let values = attribute.read_raw::<f64>().map_err(damaged(&object))?;
                let whole = |value: &&f64| value.fract() == 0.0 && value.abs() < 9e15;
                values.first().filter(whole).map(|value| *value as i64)
            }
            _ => {
                let texts = texts(&attribute, &object)?;
                texts.first().and_then(|text| text.trim().parse().ok())
            }
        };
        count.map(Some).ok_or_else(|| refuse("it is not an integer".to_owned()))
    }

    /// A string attribute of an existing group; `None` if the attribute does not exist.
    pub(crate) fn text(&self, group: &str, name: &str) -> Result<Option<String>, Hdf5Fault> {
        let direct = self.direct.as_ref();
        if let Some(text) = direct.and_then(|direct| direct.text(self.bytes(), &self.header(group)?, name)) {
            return Ok(Some(text));
        }
        if self.header(group).and_then(|header| header.has_attribute(name)) == Some(false) {
            return Ok(None);
        }
        let Some((attribute, object)) = self.attribute(group, name)? else {
            return Ok(None);
        };
        if attribute.size() != 1 {
            return Err(damaged(&object)(internal(format!(
                "it contains {} strings instead of one",
                attribute.size()
            ))));
        }
        Ok(texts(&attribute, &object)?.pop())
    }

    /// Refuses an object that a link resolves to in another file, because the hash of the source would not include that file.
    fn check_same_file(&self, location: &hdf5::Location, object: &str) -> Result<(), Hdf5Fault> {
        let library = self.library()?;
        if location.filename() == library.filename() {
            return Ok(());
        }
        Err(Hdf5Fault::Elsewhere {
            object: object.to_owned(),
            place: location.filename(),
        })
    }

    /// Like [`Self::check_same_file`], for a dataset; its data may also be in other files (external or virtual storage).
    fn check_same_storage(&self, dataset: &Dataset, object: &str) -> Result<(), Hdf5Fault> {
        self.check_same_file(dataset, object)?;
        let list = dataset.create_plist().map_err(damaged(object))?;
        let external = list.external().into_iter().next().map(|file| file.name);
        let place = match dataset.layout() {
            Layout::Virtual => Some("other datasets (it is a virtual dataset)".to_owned()),
            _ => external,
        };
        place.map_or(Ok(()), |place| {
            Err(Hdf5Fault::Elsewhere {
                object: object.to_owned(),
                place,
            })
        })
    }

    /// An attribute of a group, read with the library.
    fn attribute(&self, group: &str, name: &str) -> Result<Option<(hdf5::Attribute, String)>, Hdf5Fault> {
        let object = format!("group /{group}");
        let location = self.library()?.group(group).map_err(damaged(&object))?;
        self.check_same_file(&location, &object)?;
        let names = location.attr_names().map_err(damaged(&object))?;
        if names.iter().all(|there| there != name) {
            return Ok(None);
        }
        let object = format!("attribute {name} of /{group}");
        let attribute = location.attr(name).map_err(damaged(&object))?;
        Ok(Some((attribute, object)))
    }

    /// Reads a dataset of strings.
    pub(crate) fn names(&self, path: &str) -> Result<Vec<String>, Hdf5Fault> {
        let direct = self
            .header(path)
            .and_then(|header| header.texts(self.bytes(), self.length()));
        if let Some(names) = direct {
            return Ok(names);
        }
        let dataset = self.library()?.dataset(path).map_err(damaged(path))?;
        self.check_same_storage(&dataset, &format!("dataset {path}"))?;
        let size = dataset.size() as u64;
        if size.saturating_mul(4) > self.length() {
            return Err(damaged(path)(hdf5::Error::Internal(format!(
                "it declares {size} names, more than fit in the file"
            ))));
        }
        texts(&dataset, path)
    }

    /// Locates an existing dataset of numbers.
    pub(crate) fn locate(&self, path: &str) -> Result<Located, Hdf5Fault> {
        if let Some(found) = self.header(path).and_then(|header| header.contiguous()) {
            let element = match found.element {
                Number::F64 => Element::F64,
                Number::F32 => Element::F32,
                Number::I64 => Element::I64,
                Number::U8 => Element::U8,
            };
            let values = found.shape.iter().map(|&side| side as u64).product::<u64>();
            let bytes = values * found.element.size();
            let fits = element == Element::U8 || values * 8 <= MAX_BYTES;
            if fits && found.offset.checked_add(bytes).is_some_and(|end| end <= self.length()) {
                return Ok(Located {
                    name: path.to_owned(),
                    shape: found.shape,
                    element,
                    place: Place::Offset(found.offset),
                });
            }
        }
        let object = format!("dataset {path}");
        let damaged = || damaged(&object);
        let dataset = self.library()?.dataset(path).map_err(damaged())?;
        self.check_same_storage(&dataset, &object)?;
        let shape = dataset.get_shape().map_err(damaged())?;
        let dtype = dataset.dtype().map_err(damaged())?;
        let element = element(&dtype, path)?;
        let values = shape
            .iter()
            .try_fold(1_u64, |size, &side| size.checked_mul(side as u64));
        let bytes = values.and_then(|values| values.checked_mul(element.size()));
        let Some(bytes) = bytes.filter(|bytes| *bytes <= MAX_BYTES || element == Element::U8) else {
            return Err(damaged()(internal(format!(
                "it declares the shape {shape:?}, which is too large"
            ))));
        };
        let direct = matches!(element, Element::F64 | Element::U8);
        let offset = direct.then(|| dataset.offset()).flatten();
        let place = match offset {
            Some(offset) if offset.checked_add(bytes).is_none_or(|end| end > self.length()) => {
                return Err(Hdf5Fault::Damaged {
                    object: format!("dataset {path}"),
                    why: "it extends past the end of the file".to_owned(),
                    others: 0,
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

    /// Reads whole images, those with these row numbers, of a dataset of bytes.
    pub(crate) fn read_bytes(&self, located: &Located, rows: Range<usize>) -> Result<Vec<u8>, Hdf5Fault> {
        let damaged = damaged(&format!("dataset {}", located.name));
        let row: usize = located.shape.iter().skip(1).product();
        match &located.place {
            Place::Offset(offset) => {
                let mut bytes = vec![0; rows.len() * row];
                self.bytes()
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

    /// Number of rows that must be decoded together: those of a chunk.
    pub(crate) fn chunk_rows(located: &Located) -> usize {
        let rows = located.shape.first().copied().unwrap_or(0);
        match &located.place {
            Place::Offset(_) => 1,
            Place::Library(dataset) => dataset.chunk().and_then(|chunk| chunk.first().copied()).unwrap_or(rows),
        }
    }

    /// Reads the numbers of a dataset, row by row.
    pub(crate) fn read(&self, located: &Located) -> Result<Vec<f64>, Hdf5Fault> {
        let damaged = damaged(&format!("dataset {}", located.name));
        let values = located.shape.iter().map(|&side| side as u64).product::<u64>();
        if values > MAX_BYTES / 8 {
            return Err(damaged(internal(format!(
                "it declares the shape {:?}, which is too large",
                located.shape
            ))));
        }
        match &located.place {
            Place::Library(dataset) => dataset.read_raw::<f64>().map_err(damaged),
            Place::Offset(_) if located.element == Element::U8 => {
                let rows = located.shape.first().copied().unwrap_or(0);
                Ok(self.read_bytes(located, 0..rows)?.into_iter().map(f64::from).collect())
            }
            Place::Offset(offset) => {
                let values: usize = located.shape.iter().product();
                let size = if located.element == Element::F32 { 4 } else { 8 };
                let mut bytes = vec![0; values * size];
                self.bytes()
                    .read_exact_at(&mut bytes, *offset)
                    .map_err(|error| damaged(internal(error.to_string())))?;
                let words = || bytes.as_chunks::<8>().0.iter();
                Ok(match located.element {
                    Element::F32 => {
                        let (numbers, _) = bytes.as_chunks::<4>();
                        numbers
                            .iter()
                            .map(|&number| f32::from_le_bytes(number).into())
                            .collect()
                    }
                    Element::I64 => words().map(|&number| i64::from_le_bytes(number) as f64).collect(),
                    _ => words().map(|&number| f64::from_le_bytes(number)).collect(),
                })
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Access without the library gives the same results as the library.
    #[test]
    fn direct_access_agrees_with_the_library() {
        let sample = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../data/can-sample.hdf5");
        let source = Arc::new(SourceFile::open(&sample).unwrap());
        let direct = File::open(Arc::clone(&source), Access::Direct, true).unwrap();
        let library = File {
            direct: None,
            groups: Mutex::default(),
            ..File::open(source, Access::Library, true).unwrap()
        };
        assert!(direct.group("data/demo_0/obs").is_some());
        assert!(library.group("data").is_none());
        let mut compared = 0;
        assert_eq!(direct.members("data").unwrap(), library.members("data").unwrap());
        for name in ["env_args", "nothing"] {
            assert_eq!(direct.text("data", name).unwrap(), library.text("data", name).unwrap());
            assert_eq!(
                direct.has_attribute("data", name).unwrap(),
                library.has_attribute("data", name).unwrap()
            );
        }
        for key in direct.members("mask").unwrap() {
            let path = format!("mask/{key}");
            assert_eq!(direct.names(&path).unwrap(), library.names(&path).unwrap());
        }
        for path in ["data", "data/demo_0/obs", "data/demo_0/actions"] {
            assert_eq!(direct.kind(path).unwrap(), library.kind(path).unwrap());
        }
        for path in [
            "data",
            "data/demo_0/obs/object",
            "data/demo_99/obs",
            "mask/nothing",
            "nowhere/x",
        ] {
            assert_eq!(direct.exists(path).unwrap(), library.exists(path).unwrap(), "{path}");
        }
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
