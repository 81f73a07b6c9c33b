//! Element types of arrays.

use serde_json::Value;

/// Declares the element types: the Rust type and its names in formats 2 (`<f4`) and 3 (`float32`).
macro_rules! elements {
    ($($variant:ident $type:ident $dtype:literal $name:literal)*) => {
        /// Supported element types.
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        pub(crate) enum Element {
            $($variant),*
        }

        impl Element {
            /// The type with this name in format 2.
            pub(super) fn from_dtype(dtype: &str) -> Option<Self> {
                match dtype.trim_start_matches(['<', '>', '|']) {
                    $($dtype => Some(Self::$variant),)*
                    _ => None,
                }
            }

            /// The type with this name in format 3.
            pub(super) fn from_data_type(name: &str) -> Option<Self> {
                match name {
                    $($name => Some(Self::$variant),)*
                    _ => None,
                }
            }

            /// Size of an element in bytes.
            pub(crate) fn size(self) -> usize {
                match self {
                    $(Self::$variant => size_of::<$type>(),)*
                }
            }

            /// Converts a number in metadata to the bytes of an element in native order; `None` if it is not a number or out of
            /// range.
            pub(super) fn bytes_of(self, value: &Value) -> Option<Vec<u8>> {
                Some(match self {
                    $(Self::$variant => $type::of(value)?.to_ne_bytes().to_vec(),)*
                })
            }

            /// Converts the bytes of one element, in native order, to a float.
            pub(crate) fn float(self, bytes: &[u8]) -> f64 {
                match self {
                    $(Self::$variant => $type::from_ne_bytes(array(bytes)).float(),)*
                }
            }

            /// Converts the bytes of one element, in native order, to an integer; `None` if the value is not an integer.
            pub(super) fn integer(self, bytes: &[u8]) -> Option<i128> {
                match self {
                    $(Self::$variant => $type::from_ne_bytes(array(bytes)).whole(),)*
                }
            }
        }
    };
}

elements! {
    F32 f32 "f4" "float32"
    F64 f64 "f8" "float64"
    U8 u8 "u1" "uint8"
    U16 u16 "u2" "uint16"
    U32 u32 "u4" "uint32"
    U64 u64 "u8" "uint64"
    I8 i8 "i1" "int8"
    I16 i16 "i2" "int16"
    I32 i32 "i4" "int32"
    I64 i64 "i8" "int64"
}

impl Element {
    pub(crate) fn is_float(self) -> bool {
        matches!(self, Self::F32 | Self::F64)
    }
}

/// Conversions of a number from metadata, to an integer, and to a float.
trait Number: Sized {
    fn of(value: &Value) -> Option<Self>;
    fn whole(self) -> Option<i128>;
    fn float(self) -> f64;
}

macro_rules! integers {
    ($($type:ty)*) => {$(
        impl Number for $type {
            fn of(value: &Value) -> Option<Self> {
                let whole = value.as_f64().filter(|number| number.fract() == 0.0);
                let exact = value.as_i64().map(i128::from).or(value.as_u64().map(i128::from));
                exact.or(whole.map(|number| number as i128))?.try_into().ok()
            }

            fn whole(self) -> Option<i128> {
                Some(self.into())
            }

            #[allow(clippy::cast_lossless, reason = "not all of these types fit")]
            fn float(self) -> f64 {
                self as f64
            }
        }
    )*};
}

integers!(u8 u16 u32 u64 i8 i16 i32 i64);

impl Number for f32 {
    fn of(value: &Value) -> Option<Self> {
        // Format 3 may write floats as the hexadecimal digits of their bits.
        bits(value).map_or_else(
            || special(value).map(|number| number as Self),
            |bits| u32::from_str_radix(bits, 16).ok().map(Self::from_bits),
        )
    }

    fn whole(self) -> Option<i128> {
        f64::from(self).whole()
    }

    fn float(self) -> f64 {
        self.into()
    }
}

impl Number for f64 {
    fn of(value: &Value) -> Option<Self> {
        bits(value).map_or_else(
            || special(value),
            |bits| u64::from_str_radix(bits, 16).ok().map(Self::from_bits),
        )
    }

    fn whole(self) -> Option<i128> {
        (self.fract() == 0.0 && self.abs() < (1_u64 << 53) as Self).then_some(self as i128)
    }

    fn float(self) -> f64 {
        self
    }
}

fn bits(value: &Value) -> Option<&str> {
    value.as_str()?.strip_prefix("0x")
}

/// Parses a number, or a string that names a special value.
fn special(value: &Value) -> Option<f64> {
    match value.as_str() {
        Some("NaN") => Some(f64::NAN),
        Some("Infinity") => Some(f64::INFINITY),
        Some("-Infinity") => Some(f64::NEG_INFINITY),
        Some(_) => None,
        None => value.as_f64(),
    }
}

/// The bytes of one element. A slice of the wrong length, which `chunks_exact` never yields, would be read as zero.
fn array<const N: usize>(bytes: &[u8]) -> [u8; N] {
    bytes.try_into().unwrap_or([0; N])
}
