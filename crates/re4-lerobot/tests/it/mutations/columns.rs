//! Columns and images of the data.

use std::sync::Arc;

use arrow_array::builder::{
    BooleanBuilder, FixedSizeListBuilder, Float32Builder, Int64Builder, LargeListBuilder, ListBuilder,
};
use arrow_array::cast::AsArray as _;
use arrow_array::types::{Float32Type, Int64Type};
use arrow_array::{ArrayRef, BooleanArray, Float32Array, Float64Array, Int32Array, Int64Array, StringArray};

use super::super::support::{named, of_columns, rows, with_column, without};
use super::{AV1, DATA, IMAGE, Refused, Same, check, counts, images, pairs, singles};

fn lists(array: &ArrayRef, kind: &str) -> ArrayRef {
    let all = pairs(array);
    match kind {
        "fixed" => {
            let mut builder = FixedSizeListBuilder::new(Float32Builder::new(), 2);
            for pair in all {
                builder.values().append_slice(&pair);
                builder.append(true);
            }
            Arc::new(builder.finish())
        }
        "large" => {
            let mut builder = LargeListBuilder::new(Float32Builder::new());
            for pair in all {
                builder.values().append_slice(&pair);
                builder.append(true);
            }
            Arc::new(builder.finish())
        }
        // One row has one value, and the next one three.
        "ragged" => {
            let mut builder = ListBuilder::new(Float32Builder::new());
            for (row, pair) in all.into_iter().enumerate() {
                let count = [1, 3].get(row).copied().unwrap_or(2);
                builder.values().append_slice(&[pair[0], pair[1], pair[1]][..count]);
                builder.append(true);
            }
            Arc::new(builder.finish())
        }
        // A value is missing in row 200.
        "null" => {
            let mut builder = ListBuilder::new(Float32Builder::new());
            for (row, pair) in all.into_iter().enumerate() {
                builder.values().append_value(pair[0]);
                builder.values().append_option((row != 200).then_some(pair[1]));
                builder.append(true);
            }
            Arc::new(builder.finish())
        }
        _ => panic!("{kind}"),
    }
}

#[test]
fn columns_of_the_data() {
    check(&[
        (
            "undeclared column",
            AV1,
            |c| {
                c.table(DATA, |t| {
                    with_column(&t, "extra", Arc::new(Int64Array::from(vec![0; 420])))
                });
            },
            Refused(DATA, "extra"),
        ),
        (
            "a feature removed from the metadata",
            AV1,
            |c| {
                c.info(|map| {
                    drop(map["features"].as_object_mut().unwrap().remove("action"));
                });
            },
            Refused(DATA, "action"),
        ),
        (
            "the index of pandas",
            AV1,
            |c| {
                c.table(DATA, |t| {
                    with_column(&t, "__index_level_0__", Arc::new(Int64Array::from_iter_values(0..420)))
                });
            },
            Same,
        ),
        (
            "a column missing",
            AV1,
            |c| c.table(DATA, |t| without(&t, |name| name == "action")),
            Refused(DATA, "action"),
        ),
        (
            "frame_index missing",
            AV1,
            |c| c.table(DATA, |t| without(&t, |name| name == "frame_index")),
            Refused(DATA, "frame_index"),
        ),
        (
            "columns in another order",
            AV1,
            |c| c.table(DATA, |t| of_columns(named(&t).into_iter().rev().collect())),
            Same,
        ),
        ("zstd, one row group, no metadata", AV1, |c| c.table(DATA, |t| t), Same),
        (
            "fixed-size lists",
            AV1,
            |c| c.column(DATA, "action", |a| lists(a, "fixed")),
            Same,
        ),
        (
            "large lists",
            AV1,
            |c| c.column(DATA, "action", |a| lists(a, "large")),
            Same,
        ),
        (
            "ragged lists",
            AV1,
            |c| c.column(DATA, "action", |a| lists(a, "ragged")),
            Refused(DATA, "action"),
        ),
        (
            "a missing value",
            AV1,
            |c| c.column(DATA, "action", |a| lists(a, "null")),
            Refused(DATA, "action"),
        ),
        (
            "timestamps in double precision",
            AV1,
            |c| {
                c.column(DATA, "timestamp", |a| {
                    let singles = a.as_primitive::<Float32Type>();
                    Arc::new(singles.iter().map(|time| time.map(f64::from)).collect::<Float64Array>())
                });
            },
            Same,
        ),
        (
            "indices of 32 bits",
            AV1,
            |c| {
                c.column(DATA, "frame_index", |a| {
                    let values = a.as_primitive::<Int64Type>();
                    Arc::new(
                        values
                            .iter()
                            .map(|value| value.map(|value| value as i32))
                            .collect::<Int32Array>(),
                    )
                });
            },
            Same,
        ),
        (
            "indices as floating point",
            AV1,
            |c| {
                c.column(DATA, "index", |a| {
                    let values = a.as_primitive::<Int64Type>();
                    Arc::new(
                        values
                            .iter()
                            .map(|value| value.map(|value| value as f64))
                            .collect::<Float64Array>(),
                    )
                });
            },
            Same,
        ),
        (
            "a scalar as a list of one",
            AV1,
            |c| {
                c.column(DATA, "next.done", |a| {
                    let mut builder = ListBuilder::new(BooleanBuilder::new());
                    for value in a.as_boolean() {
                        builder.values().append_option(value);
                        builder.append(true);
                    }
                    Arc::new(builder.finish())
                });
            },
            Same,
        ),
        (
            "an index as a list of one",
            AV1,
            |c| {
                c.column(DATA, "index", |a| {
                    let mut builder = ListBuilder::new(Int64Builder::new());
                    for value in a.as_primitive::<Int64Type>() {
                        builder.values().append_option(value);
                        builder.append(true);
                    }
                    Arc::new(builder.finish())
                });
            },
            Same,
        ),
        (
            "a scalar for two values",
            AV1,
            |c| c.column(DATA, "action", |_| Arc::new(Float32Array::from(vec![1.0; 420]))),
            Refused(DATA, "action"),
        ),
        (
            "index from 1000",
            AV1,
            |c| c.column(DATA, "index", |a| counts(a, |_, v| v + 1000)),
            Refused(DATA, "index"),
        ),
        (
            "frame_index off by one",
            AV1,
            |c| c.column(DATA, "frame_index", |a| counts(a, |row, v| v + i64::from(row > 170))),
            Refused(DATA, "frame_index"),
        ),
        (
            "episode_index wrong in a row",
            AV1,
            |c| c.column(DATA, "episode_index", |a| counts(a, |row, v| v + i64::from(row == 160))),
            Refused(DATA, "episode_index"),
        ),
        (
            "an unknown task",
            AV1,
            |c| c.column(DATA, "task_index", |a| counts(a, |_, _| 3)),
            Refused(DATA, "task_index"),
        ),
        (
            "a negative task",
            AV1,
            |c| c.column(DATA, "task_index", |a| counts(a, |row, _| -i64::from(row == 9))),
            Refused(DATA, "task_index"),
        ),
        (
            "timestamps shifted",
            AV1,
            |c| c.column(DATA, "timestamp", |a| singles(a, |_, v| v + 0.05)),
            Refused(DATA, "timestamp"),
        ),
        (
            "a timestamp not a number",
            AV1,
            |c| {
                c.column(DATA, "timestamp", |a| {
                    singles(a, |row, v| if row == 300 { f32::NAN } else { v })
                });
            },
            Refused(DATA, "timestamp"),
        ),
        (
            "timestamps by the wall clock",
            AV1,
            |c| {
                c.column(DATA, "timestamp", |a| {
                    singles(a, |row, v| v * 1.001 + row as f32 * 1e-4)
                });
            },
            Refused(DATA, "timestamp"),
        ),
        (
            "the last row missing",
            AV1,
            |c| c.table(DATA, |t| t.slice(0, 419)),
            Refused(DATA, ""),
        ),
        (
            "a row twice",
            AV1,
            |c| {
                let order: Vec<usize> = (0..420).map(|row| if row == 50 { 49 } else { row }).collect();
                c.table(DATA, |t| rows(&t, &order));
            },
            Refused(DATA, "frame_index"),
        ),
        (
            "two rows swapped",
            AV1,
            |c| {
                let order: Vec<usize> = (0..420)
                    .map(|row| match row {
                        50 => 51,
                        51 => 50,
                        row => row,
                    })
                    .collect();
                c.table(DATA, |t| rows(&t, &order));
            },
            Refused(DATA, "index"),
        ),
        (
            "two episodes swapped",
            AV1,
            |c| {
                let order: Vec<usize> = (161..279).chain(0..161).chain(279..420).collect();
                c.table(DATA, |t| rows(&t, &order));
            },
            Refused(DATA, "episode_index"),
        ),
        (
            "true and false as numbers",
            AV1,
            |c| {
                c.column(DATA, "next.done", |a| {
                    Arc::new(
                        a.as_boolean()
                            .iter()
                            .map(|value| value.map(i64::from))
                            .collect::<Int64Array>(),
                    )
                });
            },
            Same,
        ),
        (
            "text for true and false",
            AV1,
            |c| c.column(DATA, "next.done", |_| Arc::new(StringArray::from(vec!["no"; 420]))),
            Refused(DATA, "next.done"),
        ),
        (
            "numbers for images",
            IMAGE,
            |c| {
                c.column(DATA, "observation.image", |_| {
                    Arc::new(BooleanArray::from(vec![true; 420]))
                });
            },
            Refused(DATA, "observation.image"),
        ),
    ]);
}

#[test]
fn images_in_the_data() {
    check(&[
        (
            "paths missing",
            IMAGE,
            |c| c.column(DATA, "observation.image", |a| images(a, |_, png| Some(png.to_vec()))),
            Same,
        ),
        (
            "plain binary values",
            IMAGE,
            |c| {
                c.column(DATA, "observation.image", |a| {
                    Arc::clone(a.as_struct().column_by_name("bytes").unwrap())
                });
            },
            Same,
        ),
        (
            "an image missing",
            IMAGE,
            |c| {
                c.column(DATA, "observation.image", |a| {
                    images(a, |row, png| (row != 300).then(|| png.to_vec()))
                });
            },
            Refused(DATA, "observation.image"),
        ),
        (
            "an image cut off",
            IMAGE,
            |c| {
                c.column(DATA, "observation.image", |a| {
                    images(a, |row, png| {
                        Some(png[..if row == 7 { 500 } else { png.len() }].to_vec())
                    })
                });
            },
            Refused(DATA, "observation.image"),
        ),
        (
            "a byte of an image changed",
            IMAGE,
            |c| {
                c.column(DATA, "observation.image", |a| {
                    images(a, |row, png| {
                        let mut png = png.to_vec();
                        if row == 419 {
                            png[300] ^= 1;
                        }
                        Some(png)
                    })
                });
            },
            Refused(DATA, "observation.image"),
        ),
        (
            "JPEG",
            IMAGE,
            |c| {
                c.column(DATA, "observation.image", |a| {
                    images(a, |_, _| Some(vec![0xff, 0xd8, 0xff, 0xe0, 0, 16]))
                });
            },
            Refused(DATA, "observation.image"),
        ),
        (
            "an image of another size",
            IMAGE,
            |c| {
                c.column(DATA, "observation.image", |a| {
                    images(a, |row, png| {
                        let mut small = Vec::new();
                        let image = image::RgbImage::new(8, 8);
                        image
                            .write_to(&mut std::io::Cursor::new(&mut small), image::ImageFormat::Png)
                            .unwrap();
                        Some(if row == 200 { small } else { png.to_vec() })
                    })
                });
            },
            Refused(DATA, "observation.image"),
        ),
    ]);
}
