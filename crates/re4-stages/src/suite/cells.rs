//! The cells of a suite: which pipeline each one runs.

use std::path::{Path, PathBuf};

use re4_compare::Measure;
use re4_fault::{Fault, Remedy as _, fault};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::{Overrides, Suite, SuiteCell, SuiteColumn, SuiteRow};
use crate::inputs::sources::find_source;
use crate::notes::fault_of;
use crate::pipeline::{Pipeline, Seeds, read_pipeline, suggestion};

/// What the command line changes in a suite: the rows and columns that run (empty lists stand for all), seeds and settings.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct Selection {
    /// Names of rows.
    pub rows: Vec<String>,
    /// Names of columns.
    pub columns: Vec<String>,
    /// Seeds in place of those of the suite.
    pub seeds: Option<Seeds>,
    /// Overrides of all cells, as for `--set`.
    pub set: Vec<String>,
}

/// A policy under a pipeline.
#[derive(Debug, Clone)]
pub struct Cell {
    /// Name of the row.
    pub row: String,
    /// Name of the column.
    pub column: String,
    /// Path of the pipeline file as in the suite.
    pub named: PathBuf,
    /// Path of the pipeline file.
    pub file: PathBuf,
    /// Measures, the printed one first.
    pub measures: Vec<Measure>,
    /// Figure that is printed elsewhere.
    pub printed: Option<f64>,
    /// Overrides, as for `--set`, in the order in which they are applied.
    pub overrides: Vec<String>,
    /// The pipeline with its overrides, or why there is none, in one sentence.
    pub pipeline: Result<Pipeline, String>,
}

impl Cell {
    /// The files that the cell reads and that exist: the pipeline file and the datasets.
    pub fn inputs(&self) -> Vec<PathBuf> {
        let ingest = self.pipeline.as_ref().ok().map(|pipeline| &pipeline.ingest);
        let sources = ingest
            .into_iter()
            .flat_map(|ingest| ingest.source.paths().iter().chain(ingest.compare.as_ref()));
        let found = sources.filter_map(|source| find_source(source).ok());
        [self.file.clone()].into_iter().chain(found).collect()
    }
}

/// Measures of a column of Push-T that names none.
const PLANAR: [Measure; 3] = [Measure::Score, Measure::Coverage, Measure::Success];

impl Suite {
    /// The cells of the selected rows and columns, column by column, and every fault of the suite.
    pub(super) fn cells(&self, file: &Path, selection: &Selection) -> (Vec<Cell>, Vec<Fault>) {
        let mut faults = self.faults();
        for (what, names, selected) in [
            ("--rows", self.row_names(), &selection.rows),
            ("--columns", self.column_names(), &selection.columns),
        ] {
            faults.extend(unknown_names(&names, selected).map(|fault| fault.at(format!("{what}: "))));
        }
        let folder = file.parent().unwrap_or(Path::new(""));
        let mut cells = Vec::new();
        for column in self
            .column
            .iter()
            .filter(|column| wanted(&selection.columns, &column.name))
        {
            match self.base(column, folder) {
                Ok(base) => {
                    let rows = self.row.iter().filter(|row| wanted(&selection.rows, &row.name));
                    cells.extend(rows.filter_map(|row| self.cell(&base, row, column, selection)));
                }
                Err(fault) => faults.push(fault.at(format!("column {:?}: ", column.name))),
            }
        }
        if cells.is_empty() && faults.is_empty() {
            faults.push(fault!("no cell is left to run"; "select other rows and columns"));
        }
        (cells, faults)
    }

    fn row_names(&self) -> Vec<&str> {
        self.row.iter().map(|row| row.name.as_str()).collect()
    }

    fn column_names(&self) -> Vec<&str> {
        self.column.iter().map(|column| column.name.as_str()).collect()
    }

    /// The faults of the names in the suite.
    fn faults(&self) -> Vec<Fault> {
        let (rows, columns) = (self.row_names(), self.column_names());
        let mut faults = Vec::new();
        for (kind, names) in [("row", &rows), ("column", &columns)] {
            if names.is_empty() {
                faults.push(fault!("it has no {kind}"; "add a table [[{kind}]]"));
            }
            for (number, name) in names.iter().enumerate() {
                if names[..number].contains(name) {
                    faults.push(fault!("two {kind}s have the name {name:?}"; "rename one"));
                }
                if name.trim().is_empty() || name.contains([',', '\n']) {
                    faults.push(fault!("{kind} {} has the name {name:?}", number + 1; "give a name without commas"));
                }
            }
        }
        let baseline = self.baseline.iter().cloned().collect::<Vec<_>>();
        faults.extend(unknown_names(&rows, &baseline).map(|fault| fault.at("baseline: ")));
        for column in &self.column {
            let named: Vec<String> = column.printed.keys().cloned().collect();
            let place = format!("printed figures of column {:?}: ", column.name);
            faults.extend(unknown_names(&rows, &named).map(|fault| fault.at(&place)));
        }
        for (number, cell) in self.cell.iter().enumerate() {
            let place = format!("table [[cell]] number {}: ", number + 1);
            let unknown = unknown_names(&rows, &cell.rows).chain(unknown_names(&columns, &cell.columns));
            faults.extend(unknown.map(|fault| fault.at(&place)));
        }
        faults
    }

    /// The pipeline of a column without overrides.
    fn base(&self, column: &SuiteColumn, folder: &Path) -> Result<Base, Fault> {
        let named =
            column.pipeline.as_ref().or(self.pipeline.as_ref()).ok_or_else(
                || fault!("it has no pipeline"; "give it a key pipeline, or give one to the whole suite"),
            )?;
        let file = folder.join(named);
        let pipeline = read_pipeline(&file, &[]).map_err(|error| fault_of(&error))?;
        if let Some(error) = pipeline.policy().err().or_else(|| pipeline.rollout().err()) {
            return Err(fault_of(&error).at(format!("{}: ", file.display())));
        }
        let measures = [&column.measures, &self.measures]
            .into_iter()
            .find(|list| !list.is_empty());
        let planar = pipeline.task.is_planar();
        let usual = if planar {
            PLANAR.to_vec()
        } else {
            vec![Measure::Success]
        };
        let measures = measures.cloned().unwrap_or(usual);
        if let Some(measure) = measures.iter().find(|measure| measure.is_planar() && !planar) {
            return Err(fault!("the measure {:?} applies only to Push-T", measure.as_str(); "use \"success\""));
        }
        Ok(Base {
            named: named.clone(),
            file,
            pipeline,
            measures,
        })
    }

    /// The cell of a row and a column; `None` if it is left out.
    fn cell(&self, base: &Base, row: &SuiteRow, column: &SuiteColumn, selection: &Selection) -> Option<Cell> {
        let applies = |cell: &&SuiteCell| wanted(&cell.rows, &row.name) && wanted(&cell.columns, &column.name);
        let exceptions: Vec<&SuiteCell> = self.cell.iter().filter(applies).collect();
        if exceptions.iter().any(|cell| cell.leave_out) {
            return None;
        }
        let mut overrides = Vec::new();
        // The settings in the file's [policy] are those of its own kind and not valid for another one.
        if let Some(kind) = row.policy.as_ref().filter(|kind| base.kind() != Some(kind)) {
            overrides.push(format!("policy={{ kind = {} }}", toml::Value::from(kind.as_str())));
        }
        let seeds = selection.seeds.as_ref().or(self.seeds.as_ref());
        if let Some(seeds) = seeds.filter(|_| base.pipeline.scenes.is_none()) {
            let text = serde_json::to_value(seeds).unwrap_or(Value::Null);
            overrides.push(format!("rollout.seeds={text}"));
        }
        let sets = [&self.set, &column.set, &row.set].into_iter();
        for set in sets.chain(exceptions.iter().map(|cell| &cell.set)) {
            flatten(set, "", &mut overrides);
        }
        overrides.extend_from_slice(&selection.set);
        let pipeline = read_pipeline(&base.file, &overrides).map_err(|error| {
            let sentence = fault_of(&error).sentence();
            // The cell names the file already, and sentences without it are the same for all columns.
            let place = format!("cannot use the pipeline file {}: ", base.file.display());
            sentence.strip_prefix(&place).unwrap_or(&sentence).to_owned()
        });
        Some(Cell {
            row: row.name.clone(),
            column: column.name.clone(),
            named: base.named.clone(),
            file: base.file.clone(),
            measures: base.measures.clone(),
            printed: column.printed.get(&row.name).copied(),
            overrides,
            pipeline,
        })
    }

    /// The cells that cannot be compared with the baseline's cell in their column because their rollouts start elsewhere.
    pub(super) fn unpaired(&self, cells: &[Cell]) -> Vec<Fault> {
        let unequal = |(cell, other): (&Cell, &Cell)| {
            let (one, two) = (cell.pipeline.as_ref().ok()?, other.pipeline.as_ref().ok()?);
            let seeds = |pipeline: &Pipeline| Some(pipeline.rollout.as_ref()?.seeds.as_ref()?.as_slice().to_vec());
            let what = if one.scenes != two.scenes {
                "scenes"
            } else if seeds(one) != seeds(two) {
                "seeds"
            } else {
                return None;
            };
            Some(fault!(
                "in column {:?}, {} and the baseline {} start from different {what}, so no pairs can be compared",
                cell.column, cell.row, other.row;
                "give them the same {what}, or remove the baseline"
            ))
        };
        self.compared(cells).filter_map(unequal).collect()
    }

    /// One sentence for each cell whose protocol differs from that of the baseline's cell in its column.
    pub(crate) fn different_protocols(&self, cells: &[Cell]) -> Vec<String> {
        let differing = |(cell, other): (&Cell, &Cell)| {
            let protocol = |cell: &Cell| {
                let pipeline = cell.pipeline.as_ref().ok()?;
                let mut whole = serde_json::to_value(pipeline).ok()?;
                Some(["rollout", "ingest", "scenes", "task", "variant"].map(|table| (table, whole[table].take())))
            };
            let mut settings = Vec::new();
            for ((table, one), (_, two)) in protocol(cell)?.into_iter().zip(protocol(other)?) {
                unequal_settings(table, &one, &two, &mut settings);
            }
            let list = settings.join(", ");
            (!settings.is_empty()).then(|| {
                format!(
                    "in column {:?}, {} and the baseline {} have different protocols: {list}",
                    cell.column, cell.row, other.row
                )
            })
        };
        self.compared(cells).filter_map(differing).collect()
    }

    /// Every cell with the baseline's cell in its column.
    pub(crate) fn compared<'a>(&self, cells: &'a [Cell]) -> impl Iterator<Item = (&'a Cell, &'a Cell)> {
        let baseline = self.baseline.clone();
        let other = move |cell: &Cell| {
            let name = baseline.as_ref().filter(|name| **name != cell.row)?;
            cells
                .iter()
                .find(|other| other.column == cell.column && other.row == *name)
        };
        cells.iter().filter_map(move |cell| Some((cell, other(cell)?)))
    }
}

/// The pipeline of a column without overrides.
struct Base {
    named: PathBuf,
    file: PathBuf,
    pipeline: Pipeline,
    measures: Vec<Measure>,
}

impl Base {
    fn kind(&self) -> Option<&str> {
        self.pipeline.policy.as_ref().map(crate::pipeline::Policy::kind)
    }
}

/// Whether a name is in a list; an empty list stands for all names.
pub(super) fn wanted(list: &[String], name: &str) -> bool {
    list.is_empty() || list.iter().any(|listed| listed == name)
}

fn unknown_names<'a>(known: &'a [&'a str], named: &'a [String]) -> impl Iterator<Item = Fault> + 'a {
    let unknown = named.iter().filter(|name| !known.contains(&name.as_str()));
    unknown.map(|name| {
        fault!(
            "there is no {name:?}{}", suggestion(name, known.iter().copied());
            "the names are {}", known.join(", ")
        )
    })
}

/// Appends the settings of a table as overrides.
fn flatten(set: &Overrides, place: &str, overrides: &mut Vec<String>) {
    for (key, value) in set {
        let path = [place, key].concat();
        match value {
            toml::Value::Table(inner) => flatten(inner, &format!("{path}."), overrides),
            value => overrides.push(format!("{path}={value}")),
        }
    }
}

/// Appends the settings in which two tables differ, with both values.
fn unequal_settings(place: &str, one: &Value, two: &Value, found: &mut Vec<String>) {
    if let (Value::Object(a), Value::Object(b)) = (one, two) {
        let keys: std::collections::BTreeSet<&String> = a.keys().chain(b.keys()).collect();
        let of = |map: &serde_json::Map<String, Value>, key: &String| map.get(key).cloned().unwrap_or(Value::Null);
        for key in keys {
            unequal_settings(&format!("{place}.{key}"), &of(a, key), &of(b, key), found);
        }
    } else if one != two {
        let word = |value: &Value| {
            if value.is_null() {
                "not set".to_owned()
            } else {
                value.to_string()
            }
        };
        found.push(format!("{place} is {} and {}", word(one), word(two)));
    }
}
