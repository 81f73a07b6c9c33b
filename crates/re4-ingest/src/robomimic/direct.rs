//! Locates contiguous datasets without the HDF5 library, for files in the format that h5py writes by default.
//!
//! The library takes about 40 us to open a dataset, and only one at a time; a file of 200 demonstrations has 1,600 of them. This
//! module reads only the oldest and simplest part of the format: superblock 0, groups as symbol tables, object headers of version
//! 1, contiguous layout, attributes in the header. For everything else, and for anything unusual, functions return `None`, and
//! the caller uses the library, which also reports what is wrong. Source: "HDF5 File Format Specification Version 3.0", sections
//! II.A, III.A.1 to III.E, IV.A. All numbers are little-endian.

use std::collections::BTreeMap;
use std::fs::File;
use std::os::unix::fs::FileExt as _;
use std::sync::{Mutex, PoisonError};

/// Size of addresses and lengths in bytes, which the superblock must confirm.
const WORD: usize = 8;

/// Maximum size in bytes of one structure: an object header, the names of a group, a heap of strings.
const MAX_STRUCTURE: u64 = 64 << 20;

/// Maximum number of nodes in a group's tree, and of blocks and messages of an object header. It bounds the work on damaged files.
const MAX_NODES: usize = 65_536;

/// Bytes read at once for a small structure, because related structures are usually close together in the file.
const WINDOW: u64 = 8 << 10;

/// Access to a file without the library.
pub(super) struct Direct {
    length: u64,
    root: u64,
    /// Offset and bytes of the last window read.
    window: Mutex<(u64, Vec<u8>)>,
}

/// A contiguous dataset.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Contiguous {
    /// Its shape.
    pub(super) shape: Vec<usize>,
    /// Type of its elements.
    pub(super) element: Number,
    /// Offset of its data in the file.
    pub(super) offset: u64,
}

/// Supported element types; all others are read with the library.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Number {
    /// Little-endian double precision.
    F64,
    /// Little-endian single precision.
    F32,
    /// Little-endian signed 64-bit integers.
    I64,
    /// Bytes.
    U8,
}

impl Number {
    /// Size of an element in the file, in bytes.
    pub(super) fn size(self) -> u64 {
        match self {
            Self::F64 | Self::I64 => 8,
            Self::F32 => 4,
            Self::U8 => 1,
        }
    }
}

/// Members of a group: addresses of their headers by name.
pub(super) type Members = BTreeMap<String, u64>;

/// The relevant messages of an object header.
#[derive(Default)]
pub(super) struct Header {
    messages: Vec<(u16, Vec<u8>)>,
}

const DATASPACE: u16 = 0x01;
const DATATYPE: u16 = 0x03;
const EXTERNAL: u16 = 0x07;
const LAYOUT: u16 = 0x08;
const FILTERS: u16 = 0x0b;
const ATTRIBUTE: u16 = 0x0c;
const CONTINUATION: u16 = 0x10;
const ATTRIBUTE_INFO: u16 = 0x15;
const SYMBOL_TABLE: u16 = 0x11;

/// Complete datatype messages of the supported types.
const F64: [u8; 20] = [
    0x11, 0x20, 0x3f, 0, 8, 0, 0, 0, 0, 0, 64, 0, 52, 11, 0, 52, 0xff, 0x03, 0, 0,
];
const F32: [u8; 20] = [
    0x11, 0x20, 0x1f, 0, 4, 0, 0, 0, 0, 0, 32, 0, 23, 8, 0, 23, 0x7f, 0, 0, 0,
];
const I64: [u8; 12] = [0x10, 0x08, 0, 0, 8, 0, 0, 0, 0, 0, 64, 0];
const U8: [u8; 12] = [0x10, 0, 0, 0, 1, 0, 0, 0, 0, 0, 8, 0];

/// Class of fixed-length strings, in version 1 of the datatype message.
const FIXED_STRING: u8 = 0x13;

impl Direct {
    /// Checks the superblock.
    pub(super) fn open(file: &File, length: u64) -> Option<Self> {
        let block = bytes(file, length, 0, 96)?;
        // All versions are 0, addresses and lengths have 8 bytes, and there is no user block.
        let plain = block.starts_with(b"\x89HDF\r\n\x1a\n")
            && block[8..12] == [0; 4]
            && block[12] == 0
            && block[13..15] == [8, 8]
            && word(&block, 24)? == 0;
        let end = word(&block, 40)?;
        (plain && end <= length).then_some(())?;
        let root = word(&block, 64)?;
        Some(Self {
            length,
            root,
            window: Mutex::default(),
        })
    }

    /// Bytes of the file; `None` if the range is not completely inside the file.
    fn bytes(&self, file: &File, at: u64, size: u64) -> Option<Vec<u8>> {
        if size > WINDOW / 2 {
            return bytes(file, self.length, at, size);
        }
        let end = at.checked_add(size).filter(|end| *end <= self.length)?;
        let mut window = self.window.lock().unwrap_or_else(PoisonError::into_inner);
        let (start, known) = &mut *window;
        if at < *start || end > *start + known.len() as u64 {
            *known = bytes(file, self.length, at, WINDOW.min(self.length - at))?;
            *start = at;
        }
        let from = usize::try_from(at - *start).ok()?;
        Some(known.get(from..from + usize::try_from(size).ok()?)?.to_vec())
    }

    /// Members of the root group.
    pub(super) fn root(&self, file: &File) -> Option<Members> {
        self.members(file, &self.header(file, self.root)?)
    }

    /// Reads the header at an address.
    pub(super) fn header(&self, file: &File, address: u64) -> Option<Header> {
        let prefix = self.bytes(file, address, 16)?;
        (prefix[0] == 1).then_some(())?;
        let mut left = usize::from(u16::from_le_bytes([prefix[2], prefix[3]]));
        let size = u64::from(u32::from_le_bytes(prefix[8..12].try_into().ok()?));
        let mut blocks = vec![(address + 16, size)];
        let mut header = Header::default();
        while let Some((start, size)) = blocks.pop() {
            let block = self.bytes(file, start, size)?;
            let mut at = 0;
            while left > 0 && at + 8 <= block.len() {
                let kind = u16::from_le_bytes([block[at], block[at + 1]]);
                let size = usize::from(u16::from_le_bytes([block[at + 2], block[at + 3]]));
                let shared = block[at + 4] & 0b10 != 0;
                let body = block.get(at + 8..at + 8 + size)?;
                let wanted = [
                    DATASPACE,
                    DATATYPE,
                    EXTERNAL,
                    LAYOUT,
                    FILTERS,
                    ATTRIBUTE,
                    ATTRIBUTE_INFO,
                    SYMBOL_TABLE,
                ];
                match kind {
                    CONTINUATION => blocks.push((word(body, 0)?, word(body, WORD)?)),
                    kind if wanted.contains(&kind) && shared => return None,
                    kind if wanted.contains(&kind) => header.messages.push((kind, body.to_vec())),
                    _ => {}
                }
                at += 8 + size;
                left -= 1;
            }
            (blocks.len() + header.messages.len() < MAX_NODES).then_some(())?;
        }
        Some(header)
    }

    /// Reads the members of a group from its header.
    pub(super) fn members(&self, file: &File, header: &Header) -> Option<Members> {
        let table = header.only(SYMBOL_TABLE)?;
        let heap = self.bytes(file, word(table, WORD)?, 32)?;
        heap.starts_with(b"HEAP\0").then_some(())?;
        let names = self.bytes(file, word(&heap, 24)?, word(&heap, 8)?)?;
        let mut members = Members::new();
        let mut nodes = vec![word(table, 0)?];
        let mut seen = 0;
        while let Some(address) = nodes.pop() {
            seen += 1;
            (seen < MAX_NODES).then_some(())?;
            let head = self.bytes(file, address, 24)?;
            if head.starts_with(b"TREE\0") {
                let entries = u64::from(u16::from_le_bytes([head[6], head[7]]));
                let body = self.bytes(file, address + 24, (2 * entries + 1) * WORD as u64)?;
                let children = (0..entries as usize).map(|entry| word(&body, (2 * entry + 1) * WORD));
                nodes.extend(children.collect::<Option<Vec<_>>>()?);
            } else if head.starts_with(b"SNOD\x01") {
                let entries = u64::from(u16::from_le_bytes([head[6], head[7]]));
                let body = self.bytes(file, address + 8, entries * 40)?;
                for entry in body.chunks_exact(40) {
                    // Soft links refer to another object by name, which only the library resolves.
                    (entry[16..20] != [2, 0, 0, 0]).then_some(())?;
                    let name = names.get(usize::try_from(word(entry, 0)?).ok()?..)?;
                    let name = name.split(|byte| *byte == 0).next()?;
                    members.insert(String::from_utf8(name.to_vec()).ok()?, word(entry, WORD)?);
                }
            } else {
                return None;
            }
        }
        Some(members)
    }

    /// Reads a string attribute of variable length.
    pub(super) fn text(&self, file: &File, header: &Header, name: &str) -> Option<String> {
        let (datatype, data) = header.attribute(name)?;
        // Class 9 (variable length), type 1 (string).
        (datatype.first()? & 0x0f == 9 && datatype.get(1)? & 0x0f == 1).then_some(())?;
        let length = usize::try_from(u32::from_le_bytes(data.get(..4)?.try_into().ok()?)).ok()?;
        let index = u32::from_le_bytes(data.get(12..16)?.try_into().ok()?);
        let address = word(&data, 4)?;
        let head = self.bytes(file, address, 16)?;
        head.starts_with(b"GCOL\x01").then_some(())?;
        let heap = self.bytes(file, address, word(&head, WORD)?)?;
        let mut at = 16;
        while at + 16 <= heap.len() {
            let object = u32::from(u16::from_le_bytes([heap[at], heap[at + 1]]));
            let size = usize::try_from(word(&heap, at + WORD)?).ok()?;
            if object == index {
                (length <= size).then_some(())?;
                let text = heap.get(at + 16..)?.get(..length)?;
                let text = text.split(|byte| *byte == 0).next()?;
                return String::from_utf8(text.to_vec()).ok();
            }
            (object != 0).then_some(())?;
            at = at.checked_add(16)?.checked_add(size.checked_next_multiple_of(8)?)?;
        }
        None
    }
}

impl Header {
    /// The message of a kind; `None` unless there is exactly one.
    fn only(&self, kind: u16) -> Option<&[u8]> {
        let mut found = self.messages.iter().filter(|message| message.0 == kind);
        let first = found.next()?;
        found.next().is_none().then_some(&first.1)
    }

    fn has(&self, kind: u16) -> bool {
        self.messages.iter().any(|message| message.0 == kind)
    }

    /// Shape, type and offset of a contiguous dataset of numbers.
    pub(super) fn contiguous(&self) -> Option<Contiguous> {
        let element = number(self.only(DATATYPE)?)?;
        let (shape, offset) = self.place(element.size())?;
        Some(Contiguous { shape, element, offset })
    }

    /// The strings of a contiguous dataset of fixed-length strings, which h5py pads with zeros.
    pub(super) fn texts(&self, file: &File, file_length: u64) -> Option<Vec<String>> {
        let datatype = self.only(DATATYPE)?;
        // Terminated by or padded with zeros, not padded with spaces.
        let plain = *datatype.first()? == FIXED_STRING && datatype.get(1)? & 0x0f < 2;
        plain.then_some(())?;
        let length = u32::from_le_bytes(datatype.get(4..8)?.try_into().ok()?);
        let (shape, offset) = self.place(length.into())?;
        let size = shape.iter().map(|&side| side as u64).product::<u64>() * u64::from(length);
        let all = bytes(file, file_length, offset, size)?;
        let text = |bytes: &[u8]| {
            let text = bytes.split(|byte| *byte == 0).next()?;
            String::from_utf8(text.to_vec()).ok()
        };
        all.chunks_exact(length as usize).map(text).collect()
    }

    /// Whether the header belongs to a group.
    pub(super) fn is_group(&self) -> bool {
        self.has(SYMBOL_TABLE)
    }

    /// Shape and offset of a contiguous dataset with elements of `element` bytes.
    fn place(&self, element: u64) -> Option<(Vec<usize>, u64)> {
        (!self.has(FILTERS) && !self.has(EXTERNAL)).then_some(())?;
        let shape = shape(self.only(DATASPACE)?)?;
        let layout = self.only(LAYOUT)?;
        (layout.get(..2)? == [3, 1]).then_some(())?;
        let (offset, size) = (word(layout, 2)?, word(layout, 2 + WORD)?);
        let bytes = shape
            .iter()
            .try_fold(element, |size, &side| size.checked_mul(side as u64))?;
        (bytes == size && bytes > 0).then_some((shape, offset))
    }

    /// Whether the header has an attribute with this name; `None` if the header does not determine it without other data.
    pub(super) fn has_attribute(&self, name: &str) -> Option<bool> {
        // If there are many attributes, they are stored elsewhere, and this message is present.
        (!self.has(ATTRIBUTE_INFO)).then_some(())?;
        for (_, body) in self.messages.iter().filter(|message| message.0 == ATTRIBUTE) {
            let start = match body.first()? {
                1 | 2 => 8,
                3 => 9,
                _ => return None,
            };
            let length = usize::from(u16::from_le_bytes([*body.get(2)?, *body.get(3)?]));
            let own = body.get(start..start + length)?;
            if own.split(|byte| *byte == 0).next()? == name.as_bytes() {
                return Some(true);
            }
        }
        Some(false)
    }

    /// An integer attribute with a single value.
    pub(super) fn count(&self, name: &str) -> Option<i64> {
        let (datatype, data) = self.attribute(name)?;
        (number(&datatype)? == Number::I64).then_some(())?;
        Some(i64::from_le_bytes(data.get(..8)?.try_into().ok()?))
    }

    /// Datatype and data of an attribute with a single value.
    fn attribute(&self, name: &str) -> Option<(Vec<u8>, Vec<u8>)> {
        for (_, body) in self.messages.iter().filter(|message| message.0 == ATTRIBUTE) {
            let size = |at: usize| Some(usize::from(u16::from_le_bytes([*body.get(at)?, *body.get(at + 1)?])));
            let sizes = [size(2)?, size(4)?, size(6)?];
            // Version 1 pads its parts to multiples of 8 bytes; version 3 adds the character set; flags indicate shared parts.
            let (start, padded) = match body.get(..2)? {
                [1, _] => (8, true),
                [2, 0] => (8, false),
                [3, 0] => (9, false),
                _ => return None,
            };
            let mut at = start;
            let mut part = |size: usize| {
                let part = body.get(at..at + size);
                at += if padded { size.next_multiple_of(8) } else { size };
                part
            };
            let own = part(sizes[0])?;
            let (datatype, space) = (part(sizes[1])?, part(sizes[2])?);
            if own.split(|byte| *byte == 0).next()? == name.as_bytes() {
                // Some writers store a single value as an array of one element.
                shape(space)?.iter().all(|&side| side == 1).then_some(())?;
                return Some((datatype.to_vec(), body.get(at..)?.to_vec()));
            }
        }
        None
    }
}

/// Dimensions of a dataspace; empty for a single value.
fn shape(message: &[u8]) -> Option<Vec<usize>> {
    let start = match message.first()? {
        1 => 8,
        2 if matches!(message.get(3)?, 0 | 1) => 4,
        _ => return None,
    };
    let rank = usize::from(*message.get(1)?);
    (0..rank)
        .map(|axis| usize::try_from(word(message, start + axis * WORD)?).ok())
        .collect()
}

fn number(datatype: &[u8]) -> Option<Number> {
    let known: [(&[u8], Number); 4] = [
        (&F64, Number::F64),
        (&F32, Number::F32),
        (&I64, Number::I64),
        (&U8, Number::U8),
    ];
    known
        .into_iter()
        .find_map(|(bytes, number)| datatype.starts_with(bytes).then_some(number))
}

fn word(bytes: &[u8], at: usize) -> Option<u64> {
    Some(u64::from_le_bytes(
        bytes.get(at..at.checked_add(WORD)?)?.try_into().ok()?,
    ))
}

/// Bytes of the file; `None` if the range is too large or not completely inside the file.
fn bytes(file: &File, length: u64, at: u64, size: u64) -> Option<Vec<u8>> {
    (size <= MAX_STRUCTURE && at.checked_add(size)? <= length).then_some(())?;
    let mut bytes = vec![0; usize::try_from(size).ok()?];
    file.read_exact_at(&mut bytes, at).ok()?;
    Some(bytes)
}
