//! Formats the values of a column as text for display.

use arrow_array::Array;
use arrow_array::cast::AsArray as _;
use arrow_array::types::{Float32Type, Float64Type, Int32Type, Int64Type, UInt32Type, UInt64Type};
use arrow_schema::DataType;

/// The value of a column in one row. Floats have the minimum number of digits that identifies them; of bytes, only the number is
/// given; a null value is `null`.
///
/// # Panics
/// If the column has no such row.
pub fn cell_text(column: &dyn Array, row: usize) -> String {
    if column.is_null(row) {
        return "null".to_owned();
    }
    match column.data_type() {
        DataType::Boolean => column.as_boolean().value(row).to_string(),
        DataType::UInt32 => column.as_primitive::<UInt32Type>().value(row).to_string(),
        DataType::UInt64 => column.as_primitive::<UInt64Type>().value(row).to_string(),
        DataType::Int64 => column.as_primitive::<Int64Type>().value(row).to_string(),
        DataType::Float32 => column.as_primitive::<Float32Type>().value(row).to_string(),
        DataType::Float64 => column.as_primitive::<Float64Type>().value(row).to_string(),
        DataType::Utf8 => column.as_string::<i32>().value(row).to_owned(),
        DataType::Binary => format!("{} bytes", column.as_binary::<i32>().value(row).len()),
        DataType::Dictionary(..) => {
            let dictionary = column.as_dictionary::<Int32Type>();
            dictionary
                .key(row)
                .map_or_else(|| "null".to_owned(), |key| cell_text(dictionary.values().as_ref(), key))
        }
        DataType::List(_) => {
            let values = column.as_list::<i32>().value(row);
            let texts: Vec<String> = (0..values.len()).map(|i| cell_text(values.as_ref(), i)).collect();
            format!("[{}]", texts.join(", "))
        }
        // No table has columns of other types: see `ColumnKind`.
        other => format!("{other}"),
    }
}
