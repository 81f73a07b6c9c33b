//! Cells of one column, nullable cells, and arrays of cells.

use std::borrow::Cow;
use std::fmt;
use std::ops::{Deref, Range};
use std::sync::Arc;

use arrow_array::builder::{
    BinaryBuilder, BooleanBuilder, Float32Builder, Float64Builder, ListBuilder, PrimitiveBuilder, StringBuilder,
    StringDictionaryBuilder,
};
use arrow_array::types::{Float32Type, Float64Type, Int32Type, Int64Type, UInt32Type, UInt64Type};
use arrow_array::{
    Array as _, ArrayRef, BinaryArray, BooleanArray, DictionaryArray, ListArray, PrimitiveArray, StringArray,
};
use arrow_schema::{DataType, Field};
use re4_episode::{Mode, Segment};

use super::{Cell, ColumnSource, Place};
use crate::columns;
use crate::columns::{first_null, table_name};
use crate::error::ArtifactError;
use crate::spec::{ColumnKind, ColumnSpec};

/// Implements [`Cell`] for types that are stored in one Arrow array. The arguments of each type are its Arrow builder, its array,
/// the kind of the column, and the conversions of a value for the builder and from the array.
macro_rules! cells {
    ($($(#[doc = $doc:literal])* $type:ty: $builder:ty, $array:ty, $kind:ident, $into:expr, $out:expr;)*) => {$(
        $(#[doc = $doc])*
        impl Cell for $type {
            type Buffers = $builder;
            type View = $array;

            fn describe(at: &Place, columns: &mut Vec<ColumnSpec>) {
                columns.push(at.column(ColumnKind::$kind));
            }

            fn push(value: Option<&Self>, buffers: &mut Self::Buffers) {
                buffers.append_option(value.map($into));
            }

            fn finish(buffers: &mut Self::Buffers, arrays: &mut Vec<ArrayRef>) {
                arrays.push(Arc::new(buffers.finish()));
            }

            fn view(source: &mut ColumnSource<'_>, required: bool) -> Result<Self::View, ArtifactError> {
                Ok(source.next(required)?.0)
            }

            fn get(view: &Self::View, row: usize) -> Option<Self> {
                view.is_valid(row).then(|| $out(view.value(row)))
            }
        }
    )*};
}

cells! {
    u32: PrimitiveBuilder<UInt32Type>, PrimitiveArray<UInt32Type>, U32, |value| *value, |value| value;
    u64: PrimitiveBuilder<UInt64Type>, PrimitiveArray<UInt64Type>, U64, |value| *value, |value| value;
    i64: PrimitiveBuilder<Int64Type>, PrimitiveArray<Int64Type>, I64, |value| *value, |value| value;
    f64: PrimitiveBuilder<Float64Type>, PrimitiveArray<Float64Type>, F64, |value| *value, |value| value;
    bool: BooleanBuilder, BooleanArray, Bool, |value| *value, |value| value;
    /// Text with many distinct values; see [`Label`] for few.
    String: StringBuilder, StringArray, Text, |value| value, str::to_owned;
    /// Bytes, for example of an image file.
    Vec<u8>: BinaryBuilder, BinaryArray, Binary, |value| value, <[u8]>::to_vec;
}

/// Implements [`Cell`] for a type that is stored as another type, with the conversions to and from it.
macro_rules! stored_as {
    ($type:ty, $stored:ty, $to:expr, $from:expr) => {
        impl Cell for $type {
            type Buffers = <$stored as Cell>::Buffers;
            type View = <$stored as Cell>::View;

            fn describe(at: &Place, columns: &mut Vec<ColumnSpec>) {
                <$stored>::describe(at, columns);
            }

            fn push(value: Option<&Self>, buffers: &mut Self::Buffers) {
                let to: fn(&Self) -> $stored = $to;
                <$stored>::push(value.map(to).as_ref(), buffers);
            }

            fn finish(buffers: &mut Self::Buffers, arrays: &mut Vec<ArrayRef>) {
                <$stored>::finish(buffers, arrays);
            }

            fn view(source: &mut ColumnSource<'_>, required: bool) -> Result<Self::View, ArtifactError> {
                <$stored>::view(source, required)
            }

            fn get(view: &Self::View, row: usize) -> Option<Self> {
                let from: fn($stored) -> Self = $from;
                <$stored>::get(view, row).map(from)
            }
        }
    };
}

// Used for numbers of frames, rows and demonstrations, which are far below 2^32.
stored_as!(
    usize,
    u32,
    |number| u32::try_from(*number).unwrap_or(u32::MAX),
    |number| number as usize
);
stored_as!(
    Range<usize>,
    Frames,
    |range| Frames {
        first_frame: range.start,
        end_frame: range.end
    },
    |frames| frames.first_frame..frames.end_frame
);
stored_as!(
    Range<u32>,
    Frames,
    |range| Frames {
        first_frame: range.start as usize,
        end_frame: range.end as usize
    },
    |frames| frames.first_frame as u32..frames.end_frame as u32
);
stored_as!(
    Segment,
    ModeAndFrames,
    |segment| ModeAndFrames {
        mode: segment.mode,
        frames: segment.frames.clone()
    },
    |row| Segment {
        mode: row.mode,
        frames: row.frames
    }
);

columns! {
    /// A range of frames.
    pub struct Frames {
        /// First frame.
        pub first_frame: usize,
        /// Frame after the last one.
        pub end_frame: usize,
    }
}

columns! {
    /// A range of frames of one mode.
    pub struct ModeAndFrames {
        /// Manipulation mode: transit or transfer.
        pub mode: Mode,
        /// Frames of the range.
        #[prefix = ""]
        pub frames: Range<usize>,
    }
}

macro_rules! lists {
    ($($type:ty: $builder:ident, $buffers:ident, $arrow:ty, $data:ident, $kind:ident;)*) => {$(
        /// Builder of a column of lists, whose elements are never null.
        pub struct $buffers(ListBuilder<$builder>);

        impl Default for $buffers {
            fn default() -> Self {
                let field = Field::new("element", DataType::$data, false);
                Self(ListBuilder::new($builder::new()).with_field(field))
            }
        }

        impl Cell for Vec<$type> {
            type Buffers = $buffers;
            type View = ListArray;

            fn describe(at: &Place, columns: &mut Vec<ColumnSpec>) {
                columns.push(at.column(ColumnKind::$kind));
            }

            fn push(value: Option<&Self>, buffers: &mut Self::Buffers) {
                if let Some(value) = value {
                    buffers.0.values().append_slice(value);
                }
                buffers.0.append(value.is_some());
            }

            fn finish(buffers: &mut Self::Buffers, arrays: &mut Vec<ArrayRef>) {
                arrays.push(Arc::new(buffers.0.finish()));
            }

            fn view(source: &mut ColumnSource<'_>, required: bool) -> Result<Self::View, ArtifactError> {
                let (list, spec) = source.next::<ListArray>(required)?;
                if list.value_type() == DataType::$data {
                    Ok(list)
                } else {
                    let list: ArrayRef = Arc::new(list);
                    Err(crate::columns::wrong_kind(source.batch, spec.name, &list, spec.kind))
                }
            }

            fn get(view: &Self::View, row: usize) -> Option<Self> {
                let list = view.is_valid(row).then(|| view.value(row))?;
                let numbers = list.as_any().downcast_ref::<PrimitiveArray<$arrow>>()?;
                Some(numbers.values().to_vec())
            }
        }
    )*};
}

lists! {
    f64: Float64Builder, F64Lists, Float64Type, Float64, F64List;
    f32: Float32Builder, F32Lists, Float32Type, Float32, F32List;
}

/// A value of a fixed set, stored as a word in a dictionary column. See [`Label`] for words that are not of a fixed set.
pub trait Word: Copy + PartialEq + 'static {
    /// All values.
    const ALL: &'static [Self];

    /// The word of the value in tables.
    fn word(self) -> &'static str;
}

impl Word for Mode {
    const ALL: &'static [Self] = &Mode::ALL;

    fn word(self) -> &'static str {
        self.as_str()
    }
}

/// A dictionary column: a list of distinct words, and the index of each row's word in that list.
pub struct Words<W> {
    keys: PrimitiveArray<Int32Type>,
    words: Vec<W>,
}

/// Reads a column of words. In files of old versions and of other writers it may be a plain text column.
fn categories(source: &mut ColumnSource<'_>, required: bool) -> Result<(Words<String>, ColumnSpec), ArtifactError> {
    let (array, spec) = source.any(required)?;
    let wrong = || crate::columns::wrong_kind(source.batch, spec.name, array, ColumnKind::Category);
    let texts = |array: &dyn std::any::Any| -> Option<Vec<String>> {
        let array = array.downcast_ref::<StringArray>()?;
        Some(array.iter().map(|text| text.unwrap_or_default().to_owned()).collect())
    };
    if let Some(dictionary) = array.as_any().downcast_ref::<DictionaryArray<Int32Type>>() {
        let words = texts(dictionary.values().as_any()).ok_or_else(wrong)?;
        let keys = dictionary.keys().clone();
        return Ok((Words { keys, words }, spec));
    }
    let words = texts(array.as_any()).ok_or_else(wrong)?;
    let keys = (0..words.len())
        .map(|row| array.is_valid(row).then_some(row as i32))
        .collect();
    Ok((Words { keys, words }, spec))
}

impl<W> Words<W> {
    fn get(&self, row: usize) -> Option<&W> {
        let key = self.keys.is_valid(row).then(|| self.keys.value(row))?;
        self.words.get(usize::try_from(key).ok()?)
    }
}

impl<W: Word> Cell for W {
    type Buffers = StringDictionaryBuilder<Int32Type>;
    type View = Words<Option<W>>;

    fn describe(at: &Place, columns: &mut Vec<ColumnSpec>) {
        columns.push(at.column(ColumnKind::Category));
    }

    fn push(value: Option<&Self>, buffers: &mut Self::Buffers) {
        buffers.append_option(value.map(|value| value.word()));
    }

    fn finish(buffers: &mut Self::Buffers, arrays: &mut Vec<ArrayRef>) {
        arrays.push(Arc::new(buffers.finish()));
    }

    fn view(source: &mut ColumnSource<'_>, required: bool) -> Result<Self::View, ArtifactError> {
        let (Words { keys, words }, spec) = categories(source, required)?;
        let of = |text: &String| W::ALL.iter().copied().find(|word| word.word() == text);
        let known: Vec<Option<W>> = words.iter().map(of).collect();
        // A dictionary may contain words that no row uses; only words of rows are checked.
        let unknown = |key: &i32| matches!(known.get(*key as usize), Some(None));
        if let Some(key) = keys.iter().flatten().find(unknown) {
            return Err(ArtifactError::UnknownWord {
                table: table_name(source.batch),
                column: spec.name.to_owned(),
                word: words.get(key as usize).cloned().unwrap_or_default(),
                known: W::ALL.iter().map(|word| word.word()).collect::<Vec<_>>().join(", "),
            });
        }
        let words = known;
        Ok(Words { keys, words })
    }

    fn get(view: &Self::View, row: usize) -> Option<Self> {
        view.get(row).copied().flatten()
    }
}

/// Text with few distinct values that are not of a fixed set, stored in a dictionary column. See [`Word`] for a fixed set.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
pub struct Label(pub Cow<'static, str>);

impl Deref for Label {
    type Target = str;

    fn deref(&self) -> &str {
        &self.0
    }
}

impl fmt::Display for Label {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl From<&'static str> for Label {
    fn from(word: &'static str) -> Self {
        Self(Cow::Borrowed(word))
    }
}

impl From<String> for Label {
    fn from(word: String) -> Self {
        Self(Cow::Owned(word))
    }
}

impl PartialEq<str> for Label {
    fn eq(&self, other: &str) -> bool {
        self.0 == other
    }
}

impl PartialEq<&str> for Label {
    fn eq(&self, other: &&str) -> bool {
        self.0 == *other
    }
}

impl Cell for Label {
    type Buffers = StringDictionaryBuilder<Int32Type>;
    type View = Words<String>;

    fn describe(at: &Place, columns: &mut Vec<ColumnSpec>) {
        columns.push(at.column(ColumnKind::Category));
    }

    fn push(value: Option<&Self>, buffers: &mut Self::Buffers) {
        buffers.append_option(value.map(|value| &*value.0));
    }

    fn finish(buffers: &mut Self::Buffers, arrays: &mut Vec<ArrayRef>) {
        arrays.push(Arc::new(buffers.finish()));
    }

    fn view(source: &mut ColumnSource<'_>, required: bool) -> Result<Self::View, ArtifactError> {
        Ok(categories(source, required)?.0)
    }

    fn get(view: &Self::View, row: usize) -> Option<Self> {
        view.get(row).map(|word| Self(Cow::Owned(word.clone())))
    }
}

impl<T: Cell> Cell for Option<T> {
    type Buffers = T::Buffers;
    type View = T::View;

    const DOMAIN: &'static str = T::DOMAIN;

    fn describe(at: &Place, columns: &mut Vec<ColumnSpec>) {
        let nullable = true;
        T::describe(&Place { nullable, ..at.clone() }, columns);
    }

    fn push(value: Option<&Self>, buffers: &mut Self::Buffers) {
        T::push(value.and_then(Option::as_ref), buffers);
    }

    fn finish(buffers: &mut Self::Buffers, arrays: &mut Vec<ArrayRef>) {
        T::finish(buffers, arrays);
    }

    fn view(source: &mut ColumnSource<'_>, _required: bool) -> Result<Self::View, ArtifactError> {
        T::view(source, false)
    }

    fn get(view: &Self::View, row: usize) -> Option<Self> {
        Some(T::get(view, row))
    }
}

/// Builders of numbered columns.
pub struct Numbered<B, const N: usize>([B; N]);

impl<B: Default, const N: usize> Default for Numbered<B, N> {
    fn default() -> Self {
        Self(std::array::from_fn(|_| B::default()))
    }
}

impl<T: Cell, const N: usize> Cell for [T; N] {
    type Buffers = Numbered<T::Buffers, N>;
    type View = Vec<T::View>;

    const DOMAIN: &'static str = T::DOMAIN;

    fn describe(at: &Place, columns: &mut Vec<ColumnSpec>) {
        for i in 0..N {
            T::describe(&at.part(&i.to_string(), &format!("number {i}")), columns);
        }
    }

    fn push(value: Option<&Self>, buffers: &mut Self::Buffers) {
        for (i, buffers) in buffers.0.iter_mut().enumerate() {
            T::push(value.map(|value| &value[i]), buffers);
        }
    }

    fn finish(buffers: &mut Self::Buffers, arrays: &mut Vec<ArrayRef>) {
        for buffers in &mut buffers.0 {
            T::finish(buffers, arrays);
        }
    }

    fn view(source: &mut ColumnSource<'_>, required: bool) -> Result<Self::View, ArtifactError> {
        (0..N).map(|_| T::view(source, required)).collect()
    }

    fn get(view: &Self::View, row: usize) -> Option<Self> {
        let values: Vec<T> = view.iter().map(|view| T::get(view, row)).collect::<Option<_>>()?;
        values.try_into().ok()
    }
}

/// Returns the name of the first column of a batch that has a null, and the row of the null, counted from the start of the batch.
pub(super) fn missing(batch: &arrow_array::RecordBatch) -> (String, usize) {
    let found = batch
        .schema_ref()
        .fields()
        .iter()
        .zip(batch.columns())
        .find_map(|(field, array)| Some((field.name().clone(), first_null(array.as_ref())?)));
    found.unwrap_or_default()
}
