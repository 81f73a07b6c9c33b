//! The tables of artifacts as lazily read frames.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use std::sync::Arc;

use anyhow::Result;
use polars::prelude::*;
use rayon::prelude::*;
use re4_artifact::{ArtifactError, ColumnKind, ColumnSpec, TableSpec};
use re4_fault::{OrFault as _, fault};

use crate::sources::{ARTIFACT, DATASET, Entry, Sources};

/// Column with the path of the file, from which [`ARTIFACT`] and [`DATASET`] are derived. It is not visible to queries.
const PATH: &str = "re4:path";

/// The files of a table that have the same columns.
struct Part {
    spec: &'static TableSpec,
    version: u32,
    paths: Vec<PlRefPath>,
}

/// A table in one artifact.
struct Found<'a> {
    entry: &'a Entry,
    spec: &'static TableSpec,
    version: u32,
    paths: Vec<PathBuf>,
}

impl Sources {
    /// The rows of a table in all artifacts that have it, in the order of the artifacts. Every byte of its files is compared with the
    /// manifests.
    ///
    /// # Errors
    /// If no artifact has the table, or a file of it is damaged or of a newer version.
    pub(crate) fn table(&self, name: &str) -> Result<LazyFrame> {
        let specs = self.specs_of(name);
        let opened: Vec<Option<Result<Found<'_>, ArtifactError>>> =
            self.entries.par_iter().map(|entry| find(entry, &specs)).collect();
        let mut parts: Vec<Part> = Vec::new();
        let mut origins = BTreeMap::new();
        for found in opened.into_iter().flatten() {
            let found = found?;
            let origin = (found.entry.name.clone(), found.entry.dataset.clone());
            let mut paths = Vec::with_capacity(found.paths.len());
            for path in &found.paths {
                let path = PlRefPath::try_from_path(path).or_fault(
                    || fault!("cannot query {}: its name is not UTF-8", path.display(); "rename its folder"),
                )?;
                origins.insert(path.as_str().to_owned(), origin.clone());
                paths.push(path);
            }
            match parts
                .iter_mut()
                .find(|part| std::ptr::eq(part.spec, found.spec) && part.version == found.version)
            {
                Some(part) => part.paths.extend(paths),
                None => parts.push(Part {
                    spec: found.spec,
                    version: found.version,
                    paths,
                }),
            }
        }
        if parts.is_empty() {
            return Err(self.no_table(name));
        }
        let columns = columns_of(&parts);
        let origins = Arc::new(origins);
        let mut frames = parts
            .into_iter()
            .map(|part| scan(part, &columns, &origins))
            .collect::<PolarsResult<Vec<_>>>()?;
        match (frames.pop(), frames.is_empty()) {
            (Some(single), true) => Ok(single),
            (last, _) => {
                frames.extend(last);
                Ok(concat(frames, UnionArgs::default())?)
            }
        }
    }
}

/// Opens and verifies a table of an artifact; `None` if the artifact does not have it. The file's domain decides between several
/// descriptions.
fn find<'a>(entry: &'a Entry, specs: &[&'static TableSpec]) -> Option<Result<Found<'a>, ArtifactError>> {
    let artifact = &entry.artifact;
    let mut refused = None;
    for spec in specs.iter().copied().filter(|spec| artifact.has_table(spec)) {
        match artifact.verify_table(spec).and_then(|()| artifact.table(spec)) {
            Ok(table) => {
                return Some(Ok(Found {
                    entry,
                    spec,
                    version: table.summary().schema_version,
                    paths: table.paths(),
                }));
            }
            Err(ArtifactError::OtherDomain { .. }) if specs.len() > 1 => {}
            Err(error) => refused = refused.or(Some(error)),
        }
    }
    refused.map(Err)
}

/// The columns of all parts, in the order in which they first occur.
fn columns_of(parts: &[Part]) -> Vec<&'static ColumnSpec> {
    let mut names = BTreeSet::new();
    let mut columns = Vec::new();
    for column in parts.iter().flat_map(|part| part.spec.columns_at(part.version)) {
        if names.insert(column.name) {
            columns.push(column);
        }
    }
    columns
}

/// The rows of the files of a part, with all the given columns. Columns that the files lack are null.
fn scan(
    part: Part,
    columns: &[&'static ColumnSpec],
    origins: &Arc<BTreeMap<String, (String, Option<String>)>>,
) -> PolarsResult<LazyFrame> {
    let arguments = ScanArgsParquet {
        glob: false,
        cache: false,
        include_file_paths: Some(PATH.into()),
        ..ScanArgsParquet::default()
    };
    let frame = LazyFrame::scan_parquet_files(part.paths.into(), arguments)?;
    let mut selected = vec![
        origin(ARTIFACT, origins, |(artifact, _)| Some(artifact)),
        origin(DATASET, origins, |(_, dataset)| dataset.as_deref()),
    ];
    for column in columns {
        let own = part.spec.columns_at(part.version).find(|own| own.name == column.name);
        selected.push(match own {
            Some(own) => {
                // Labels are compared and matched as text. Differences of unsigned integers would wrap around.
                col(part.spec.name_at(own, part.version))
                    .cast(type_of(own.kind))
                    .alias(column.name)
            }
            None => lit(NULL).cast(type_of(column.kind)).alias(column.name),
        });
    }
    Ok(frame.select(selected))
}

/// The type of a column in queries. Numbers above 2^63 - 1, which no table has, are an error.
fn type_of(kind: ColumnKind) -> DataType {
    match kind {
        ColumnKind::U32 | ColumnKind::U64 | ColumnKind::I64 => DataType::Int64,
        ColumnKind::F64 => DataType::Float64,
        ColumnKind::Bool => DataType::Boolean,
        ColumnKind::Text | ColumnKind::Category => DataType::String,
        ColumnKind::Binary => DataType::Binary,
        ColumnKind::F64List => DataType::List(Box::new(DataType::Float64)),
        ColumnKind::F32List => DataType::List(Box::new(DataType::Float32)),
    }
}

type Origin = (String, Option<String>);

/// A column computed from the path of the file. All rows of a file follow each other, so a path is looked up once per file.
fn origin(
    name: &'static str,
    origins: &Arc<BTreeMap<String, Origin>>,
    value: impl Fn(&Origin) -> Option<&str> + Send + Sync + 'static,
) -> Expr {
    let origins = Arc::clone(origins);
    let compute = move |paths: Column| -> PolarsResult<Column> {
        let mut values = StringChunkedBuilder::new(name.into(), paths.len());
        let mut last: (Option<&str>, Option<&str>) = (None, None);
        for path in paths.str()?.iter() {
            if path != last.0 {
                last = (path, path.and_then(|path| origins.get(path)).and_then(&value));
            }
            values.append_option(last.1);
        }
        Ok(values.finish().into_column())
    };
    col(PATH)
        .map(compute, move |_, _| Ok(Field::new(name.into(), DataType::String)))
        .alias(name)
}
