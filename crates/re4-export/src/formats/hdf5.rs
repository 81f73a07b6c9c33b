//! Writer of HDF5 files with the simplest parts of the format, which all versions of the HDF5 library read: superblock 0, groups as
//! symbol tables, object headers of version 1, contiguous datasets, attributes in the header.
//!
//! The HDF5 library stores times of modification in datasets, so two files with the same contents would differ. Here, equal input gives
//! equal bytes. Data is written as it comes, and each group after its members. Source: "HDF5 File Format Specification Version 3.0",
//! sections II.A, III.A.1 to III.E, IV.A. All numbers are little-endian.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufWriter, Seek as _, SeekFrom, Write};

/// An address that refers to nothing.
const NOWHERE: u64 = u64::MAX;
/// Half of the maximum number of entries of a symbol node, as the library's default.
const LEAF: usize = 4;
/// Half of the maximum number of children of a node of a tree, as the library's default.
const INTERNAL: usize = 16;
/// Smallest size of a collection of strings that the library reads.
const SMALLEST_HEAP: usize = 4096;
const SUPERBLOCK: usize = 96;

const F64: [u8; 20] = [
    0x11, 0x20, 0x3f, 0, 8, 0, 0, 0, 0, 0, 64, 0, 52, 11, 0, 52, 0xff, 0x03, 0, 0,
];
const I64: [u8; 12] = [0x10, 0x08, 0, 0, 8, 0, 0, 0, 0, 0, 64, 0];
const U8: [u8; 12] = [0x10, 0, 0, 0, 1, 0, 0, 0, 0, 0, 8, 0];
/// A string of variable length in UTF-8: a sequence of bytes.
const TEXT: [u8; 8] = [0x19, 0x01, 0x01, 0, 16, 0, 0, 0];

/// A value of an attribute.
pub(crate) enum Attribute<'a> {
    Integer(i64),
    Text(&'a str),
}

/// Values of a dataset, row by row.
pub(crate) enum Values<'a> {
    F64(&'a [f64]),
    I64(&'a [i64]),
    U8(&'a [u8]),
    /// Texts, stored as bytes of one length, padded with zeros.
    Names(&'a [String]),
}

/// A group or dataset that has been written.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Object {
    header: u64,
    /// Tree and heap of a group.
    group: Option<[u64; 2]>,
}

/// Members of a group by name.
pub(crate) type Members = BTreeMap<String, Object>;

/// A file that is being written.
pub(crate) struct Hdf5Writer {
    file: BufWriter<File>,
    end: u64,
}

impl Hdf5Writer {
    /// Starts a file.
    pub(crate) fn new(file: File) -> io::Result<Self> {
        let mut writer = Self {
            file: BufWriter::with_capacity(1 << 20, file),
            end: 0,
        };
        writer.put(&[0; SUPERBLOCK])?;
        Ok(writer)
    }

    /// Writes a dataset. The product of `shape` is the number of values.
    pub(crate) fn dataset(&mut self, values: &Values<'_>, shape: &[usize]) -> io::Result<Object> {
        let (data_type, bytes) = match values {
            Values::F64(values) => (
                F64.to_vec(),
                values.iter().flat_map(|value| value.to_le_bytes()).collect(),
            ),
            Values::I64(values) => (
                I64.to_vec(),
                values.iter().flat_map(|value| value.to_le_bytes()).collect(),
            ),
            Values::U8(values) => (U8.to_vec(), values.to_vec()),
            Values::Names(names) => fixed(names),
        };
        let address = self.put(&bytes)?;
        let mut layout = vec![3, 1];
        // An empty dataset has no place.
        layout.extend(if bytes.is_empty() { NOWHERE } else { address }.to_le_bytes());
        layout.extend((bytes.len() as u64).to_le_bytes());
        let fill = vec![2, 2, 2, 1, 0, 0, 0, 0];
        let header = self.header(&[(0x01, space(shape)), (0x03, data_type), (0x05, fill), (0x08, layout)])?;
        Ok(Object { header, group: None })
    }

    /// Writes a group of objects that have been written.
    pub(crate) fn group(&mut self, members: &Members, attributes: &[(&str, Attribute<'_>)]) -> io::Result<Object> {
        // The names, after an empty one.
        let mut names = vec![0_u8; 8];
        let mut entries = Vec::with_capacity(members.len());
        for (name, object) in members {
            entries.push((names.len() as u64, *object));
            names.extend(name.as_bytes());
            names.push(0);
            pad(&mut names);
        }
        let segment = self.put(&names)?;
        let mut heap = b"HEAP\0\0\0\0".to_vec();
        // No part of the heap is free, which the library writes as 1.
        for number in [names.len() as u64, 1, segment] {
            heap.extend(number.to_le_bytes());
        }
        let heap = self.put(&heap)?;
        let tree = self.tree(&entries)?;
        let mut messages = Vec::new();
        for (name, value) in attributes {
            messages.push((0x0c, self.attribute(name, value)?));
        }
        messages.push((0x11, [tree.to_le_bytes(), heap.to_le_bytes()].concat()));
        let header = self.header(&messages)?;
        Ok(Object {
            header,
            group: Some([tree, heap]),
        })
    }

    /// Writes the root group and completes the file.
    pub(crate) fn finish(mut self, root: &Members) -> io::Result<File> {
        let root = self.group(root, &[])?;
        let mut block = b"\x89HDF\r\n\x1a\n".to_vec();
        block.extend([0, 0, 0, 0, 0, 8, 8, 0]);
        block.extend([LEAF as u8, 0, INTERNAL as u8, 0, 0, 0, 0, 0]);
        for number in [0, NOWHERE, self.end, NOWHERE] {
            block.extend(number.to_le_bytes());
        }
        block.extend(entry(0, root));
        self.file.seek(SeekFrom::Start(0))?;
        self.file.write_all(&block)?;
        let file = self.file.into_inner().map_err(io::IntoInnerError::into_error)?;
        file.sync_all()?;
        Ok(file)
    }

    /// Appends a structure, padded to 8 bytes; returns its address.
    fn put(&mut self, bytes: &[u8]) -> io::Result<u64> {
        let address = self.end;
        let padding = bytes.len().next_multiple_of(8) - bytes.len();
        self.file.write_all(bytes)?;
        self.file.write_all(&[0; 8][..padding])?;
        self.end += (bytes.len() + padding) as u64;
        Ok(address)
    }

    /// Writes an object header.
    fn header(&mut self, messages: &[(u16, Vec<u8>)]) -> io::Result<u64> {
        let mut body = Vec::new();
        for (kind, data) in messages {
            let mut data = data.clone();
            pad(&mut data);
            let size =
                u16::try_from(data.len()).map_err(|_| io::Error::other("a message of an HDF5 header is too long"))?;
            body.extend(kind.to_le_bytes());
            body.extend(size.to_le_bytes());
            // Types of values never change, which the library states so.
            body.extend([u8::from(*kind == 0x03), 0, 0, 0]);
            body.extend(data);
        }
        let mut header = vec![1, 0];
        header.extend((messages.len() as u16).to_le_bytes());
        header.extend(1_u32.to_le_bytes());
        header.extend((body.len() as u32).to_le_bytes());
        header.extend([0; 4]);
        header.extend(body);
        self.put(&header)
    }

    /// An attribute. Texts are stored outside of the header, which is limited in size.
    fn attribute(&mut self, name: &str, value: &Attribute<'_>) -> io::Result<Vec<u8>> {
        let (data_type, data) = match value {
            Attribute::Integer(value) => (I64.to_vec(), value.to_le_bytes().to_vec()),
            Attribute::Text(text) => {
                let address = self.text(text)?;
                let mut data = (text.len() as u32).to_le_bytes().to_vec();
                data.extend(address.to_le_bytes());
                data.extend(1_u32.to_le_bytes());
                ([&TEXT[..], &U8].concat(), data)
            }
        };
        let space = space(&[]);
        let mut message = vec![1, 0];
        for size in [name.len() + 1, data_type.len(), space.len()] {
            message.extend((size as u16).to_le_bytes());
        }
        let mut name = name.as_bytes().to_vec();
        name.push(0);
        for mut part in [name, data_type, space, data] {
            pad(&mut part);
            message.extend(part);
        }
        Ok(message)
    }

    /// Writes a text to a collection of its own.
    fn text(&mut self, text: &str) -> io::Result<u64> {
        let used = 32 + text.len().next_multiple_of(8);
        // What is left is described as free, which needs 16 bytes.
        let size = (used + 16).max(SMALLEST_HEAP);
        let mut heap = b"GCOL\x01\0\0\0".to_vec();
        heap.extend((size as u64).to_le_bytes());
        heap.extend([1, 0, 1, 0, 0, 0, 0, 0]);
        heap.extend((text.len() as u64).to_le_bytes());
        heap.extend(text.as_bytes());
        pad(&mut heap);
        heap.extend([0; 8]);
        heap.extend(((size - used) as u64).to_le_bytes());
        heap.resize(size, 0);
        self.put(&heap)
    }

    /// Writes the tree of a group: the offsets of names in the heap, sorted by name, and their objects.
    fn tree(&mut self, entries: &[(u64, Object)]) -> io::Result<u64> {
        let mut nodes = Vec::new();
        for part in entries.chunks(2 * LEAF) {
            let mut node = b"SNOD\x01\0".to_vec();
            node.extend((part.len() as u16).to_le_bytes());
            for (name, object) in part {
                node.extend(entry(*name, *object));
            }
            node.resize(8 + 2 * LEAF * 40, 0);
            let last = part.last().map_or(0, |(name, _)| *name);
            nodes.push((self.put(&node)?, last));
        }
        let mut level = 0_u8;
        loop {
            nodes = self.level(&nodes, level)?;
            if let [(root, _)] = nodes.as_slice() {
                return Ok(*root);
            }
            level += 1;
        }
    }

    /// Writes the nodes above some nodes; each has an address and the last name below it.
    fn level(&mut self, below: &[(u64, u64)], level: u8) -> io::Result<Vec<(u64, u64)>> {
        let size = 24 + (4 * INTERNAL + 1) * 8;
        let start = self.end;
        let parts: Vec<&[(u64, u64)]> = if below.is_empty() {
            vec![&[]]
        } else {
            below.chunks(2 * INTERNAL).collect()
        };
        let address = |number: usize| start + (number * size) as u64;
        let mut nodes = Vec::with_capacity(parts.len());
        let mut first = 0;
        for (number, part) in parts.iter().enumerate() {
            let mut node = b"TREE\0".to_vec();
            node.push(level);
            node.extend((part.len() as u16).to_le_bytes());
            let left = number.checked_sub(1).map_or(NOWHERE, address);
            let right = if number + 1 < parts.len() {
                address(number + 1)
            } else {
                NOWHERE
            };
            for number in [left, right, first] {
                node.extend(number.to_le_bytes());
            }
            for (child, last) in *part {
                node.extend(child.to_le_bytes());
                node.extend(last.to_le_bytes());
            }
            node.resize(size, 0);
            let last = part.last().map_or(0, |(_, last)| *last);
            first = last;
            nodes.push((self.put(&node)?, last));
        }
        Ok(nodes)
    }
}

/// An entry of a symbol table.
fn entry(name: u64, object: Object) -> Vec<u8> {
    let mut entry = [name.to_le_bytes(), object.header.to_le_bytes()].concat();
    entry.extend(u64::from(object.group.is_some()).to_le_bytes());
    for number in object.group.unwrap_or_default() {
        entry.extend(number.to_le_bytes());
    }
    entry
}

/// The shape of a dataset; none for a single value.
fn space(shape: &[usize]) -> Vec<u8> {
    let mut space = vec![1, shape.len() as u8, 0, 0, 0, 0, 0, 0];
    for length in shape {
        space.extend((*length as u64).to_le_bytes());
    }
    space
}

/// Type and bytes of texts of one length.
fn fixed(names: &[String]) -> (Vec<u8>, Vec<u8>) {
    let length = names.iter().map(String::len).max().unwrap_or(0).max(1);
    let mut data_type = vec![0x13, 0x01, 0, 0];
    data_type.extend((length as u32).to_le_bytes());
    let mut bytes = Vec::with_capacity(names.len() * length);
    for name in names {
        let end = bytes.len() + length;
        bytes.extend(name.as_bytes());
        bytes.resize(end, 0);
    }
    (data_type, bytes)
}

fn pad(bytes: &mut Vec<u8>) {
    bytes.resize(bytes.len().next_multiple_of(8), 0);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_same_contents_give_the_same_bytes() {
        let write = || {
            let place = tempfile::tempdir().unwrap();
            let path = place.path().join("a.hdf5");
            let mut writer = Hdf5Writer::new(File::create(&path).unwrap()).unwrap();
            let mut members = Members::new();
            for number in 0..300 {
                let object = writer.dataset(&Values::F64(&[f64::from(number)]), &[1]).unwrap();
                members.insert(format!("demo_{number}"), object);
            }
            let long = "x".repeat(100_000);
            let attributes = [("a", Attribute::Text(&long)), ("n", Attribute::Integer(-1))];
            let data = writer.group(&members, &attributes).unwrap();
            writer.finish(&[("data".to_owned(), data)].into()).unwrap();
            std::fs::read(path).unwrap()
        };
        let first = write();
        assert_eq!(
            first.len() as u64,
            u64::from_le_bytes(first[40..48].try_into().unwrap())
        );
        assert_eq!(first, write());
    }
}
