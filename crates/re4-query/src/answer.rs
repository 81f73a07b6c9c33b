//! Planning and running a query.

use std::panic::{AssertUnwindSafe, catch_unwind, set_hook, take_hook};
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Once};

use anyhow::Result;
use polars::prelude::*;
use polars::sql::SQLContext;
use re4_fault::{bail, fault};

use crate::about;
use crate::faults::{Known, fault_of};
use crate::sources::Sources;
use crate::statement::Statement;

/// Rows per part of an answer, and per row group of a Parquet file.
const ROWS_PER_PART: usize = 65_536;

/// A planned query. Nothing has been read except the footers and hashes of the tables that it uses.
pub struct Answer {
    frame: LazyFrame,
    columns: Vec<OutputColumn>,
    known: Known,
}

/// A column of an answer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct OutputColumn {
    /// Name.
    pub name: String,
    /// Type: `bool`, `u32`, `f64`, `text`, `list of f64`, ...
    pub kind: String,
    /// Whether its values are numbers.
    pub numeric: bool,
}

impl Sources {
    /// Plans a `SELECT` statement.
    ///
    /// The order of the rows is always defined: a query that filters and computes the rows of one table keeps their order, which is that
    /// of the artifacts. Otherwise, rows that `ORDER BY` leaves equal are ordered by the columns of the answer, from left to right,
    /// except those with bytes or lists.
    ///
    /// # Errors
    /// If the text is not a valid `SELECT` statement, a table or column does not exist, or a table is damaged.
    pub fn query(&self, text: &str) -> Result<Answer> {
        let statement = Statement::parse(text)?;
        let known_name = |name: &str| about::TABLES.contains(&name) || self.has(name);
        if let Some(name) = statement.defined.iter().find(|name| known_name(name)) {
            bail!("the name {name} in WITH is that of a table"; "choose another name");
        }
        let mut context = SQLContext::new();
        let mut known = Known::default();
        for name in &statement.tables {
            let mut frame = match about::table(self, name)? {
                Some(frame) => frame,
                None if self.has(name) => self.table(name)?,
                None => return Err(self.no_table(name)),
            };
            let schema = frame.collect_schema().map_err(|error| fault_of(&error, &known))?;
            known.add(name, schema.iter_names().map(ToString::to_string).collect());
            context.register(name, frame);
        }
        let (frame, schema) = planned(&mut context, &statement.text()).map_err(|error| fault_of(&error, &known))?;
        let sorted = schema
            .iter()
            .enumerate()
            .filter(|(_, (_, kind))| !kind.is_nested() && !kind.is_binary());
        let sorted: Vec<(usize, &str)> = sorted.map(|(place, (name, _))| (place + 1, name.as_str())).collect();
        let frame = match statement.ordered(&sorted) {
            Some(ordered) => planned(&mut context, &ordered).map_or(frame, |(frame, _)| frame),
            None => frame,
        };
        // Types that only SQL functions create are printed as text.
        let foreign: Vec<Expr> = schema
            .iter()
            .filter(|(_, kind)| name_of(kind).is_none())
            .map(|(name, _)| col(name.clone()).cast(DataType::String))
            .collect();
        let columns = schema.iter().map(|(name, kind)| OutputColumn {
            name: name.to_string(),
            kind: name_of(kind).unwrap_or_else(|| "text".to_owned()),
            numeric: kind.is_primitive_numeric(),
        });
        Ok(Answer {
            columns: columns.collect(),
            frame: if foreign.is_empty() {
                frame
            } else {
                frame.with_columns(foreign)
            },
            known,
        })
    }
}

/// Plans a query and returns its columns. Some functions of the engine panic where a feature of it is not compiled.
fn planned(context: &mut SQLContext, text: &str) -> PolarsResult<(LazyFrame, SchemaRef)> {
    contained(|| {
        let mut frame = context.execute(text)?;
        let schema = frame.collect_schema()?;
        Ok((frame, schema))
    })
}

/// Number of calls of [`contained`] that are running.
static CONTAINED: AtomicUsize = AtomicUsize::new(0);

/// Runs a part of the engine, and returns a panic as an error, without printing it. The engine also panics on its own threads, so
/// panics of all threads are not printed in the meantime.
fn contained<T>(run: impl FnOnce() -> PolarsResult<T>) -> PolarsResult<T> {
    static HOOK: Once = Once::new();
    HOOK.call_once(|| {
        let previous = take_hook();
        set_hook(Box::new(move |panic| {
            if CONTAINED.load(Ordering::Relaxed) == 0 {
                previous(panic);
            }
        }));
    });
    CONTAINED.fetch_add(1, Ordering::Relaxed);
    let outcome = catch_unwind(AssertUnwindSafe(run));
    CONTAINED.fetch_sub(1, Ordering::Relaxed);
    outcome.unwrap_or_else(|panic| {
        let why = panic
            .downcast_ref::<String>()
            .map(String::as_str)
            .or_else(|| panic.downcast_ref::<&str>().copied())
            .unwrap_or("no reason given");
        let why = why.lines().next().unwrap_or(why);
        Err(PolarsError::ComputeError(
            format!("the engine does not support it ({why})").into(),
        ))
    })
}

/// Name of a type, in the words of the tables; `None` if no table has such values.
fn name_of(kind: &DataType) -> Option<String> {
    let name = match kind {
        DataType::Null => "null",
        DataType::Boolean => "bool",
        DataType::Int8 => "i8",
        DataType::Int16 => "i16",
        DataType::Int32 => "i32",
        DataType::Int64 => "i64",
        DataType::UInt8 => "u8",
        DataType::UInt16 => "u16",
        DataType::UInt32 => "u32",
        DataType::UInt64 => "u64",
        DataType::Float32 => "f32",
        DataType::Float64 => "f64",
        DataType::String => "text",
        DataType::Binary => "binary",
        DataType::List(inner) => return Some(format!("list of {}", name_of(inner)?)),
        _ => return None,
    };
    Some(name.to_owned())
}

impl Answer {
    /// The columns of the answer.
    pub fn columns(&self) -> &[OutputColumn] {
        &self.columns
    }

    /// Runs the query and passes its rows on in parts, in order. `take` returns whether it wants more rows. The memory does not depend on
    /// the number of rows.
    ///
    /// # Errors
    /// If the query fails, and errors of `take`.
    pub(crate) fn parts(self, mut take: impl FnMut(&DataFrame) -> Result<bool>) -> Result<()> {
        let Self { frame, known, .. } = self;
        let (send, receive): (SyncSender<DataFrame>, Receiver<DataFrame>) = sync_channel(1);
        // The engine keeps its copy of the callback until the query ends; the sender must not live longer.
        let stop_on_error = PlanCallback::new(move |part: DataFrame| Ok(send.send(part).is_err()));
        let frame = frame
            .sink_batches(stop_on_error, true, std::num::NonZeroUsize::new(ROWS_PER_PART))
            .map_err(|error| fault_of(&error, &known))?;
        std::thread::scope(|scope| {
            let engine = scope.spawn(move || contained(|| frame.collect_with_engine(Engine::Streaming)).map(drop));
            let mut outcome = Ok(());
            for part in &receive {
                match take(&part) {
                    Ok(true) => {}
                    Ok(false) => break,
                    Err(error) => {
                        outcome = Err(error);
                        break;
                    }
                }
            }
            drop(receive);
            let ran = engine
                .join()
                .unwrap_or_else(|_| Err(PolarsError::ComputeError("the engine stopped".into())));
            outcome.and(ran.map_err(|error| fault_of(&error, &known).into()))
        })
    }

    /// Runs the query and writes its rows to a Parquet file, compressed with zstd.
    ///
    /// # Errors
    /// If the query fails or the file cannot be written.
    pub fn write_parquet(self, path: &Path) -> Result<()> {
        let Self { frame, known, .. } = self;
        let target = PlRefPath::try_from_path(path)
            .map_err(|error| fault!("cannot write {}: {error}", path.display(); "give another path"))?;
        let options = ParquetWriteOptions {
            compression: ParquetCompression::Zstd(None),
            row_group_size: Some(ROWS_PER_PART),
            ..ParquetWriteOptions::default()
        };
        let written = contained(|| {
            frame
                .sink(
                    SinkDestination::File {
                        target: SinkTarget::Path(target),
                    },
                    FileWriteFormat::Parquet(Arc::new(options)),
                    UnifiedSinkArgs::default(),
                )?
                .collect_with_engine(Engine::Streaming)
        });
        written.map_err(|error| fault_of(&error, &known))?;
        Ok(())
    }
}
