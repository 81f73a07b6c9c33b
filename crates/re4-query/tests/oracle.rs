//! Answers are compared with direct reads of the tables and with aggregation by hand.
#![allow(clippy::unwrap_used, reason = "helpers of tests fail by panicking")]

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use proptest::prelude::*;
use re4_artifact::{
    Artifact, ArtifactSummary, ColumnKind, ColumnSpec, Columns, Key, Label, Recipe, Row as _, Stage, Store, TableSpec,
    table,
};
use re4_fault::{Fault, Remedy as _};
use re4_query::{Preview, Sources, write_csv, write_json};
use serde_json::{Value, json};

table! {
    /// One row per trial: a column of every kind, with and without nulls.
    #[table("trials", version = 2)]
    pub struct Trial {
        /// Number of the trial.
        pub trial: u32,
        /// A count.
        pub count: u64,
        /// A number with a sign.
        pub offset: i64,
        /// A measurement.
        pub value: f64,
        /// A flag.
        pub passed: bool,
        /// A text.
        pub note: String,
        /// A label.
        pub label: Label,
        /// Bytes.
        pub bytes: Vec<u8>,
        /// A list.
        pub list: Vec<f64>,
        /// A list of short floats.
        pub short: Vec<f32>,
        /// A measurement that may be absent.
        #[since = 2]
        pub extra: Option<f64>,
        /// A label that may be absent.
        #[since = 2]
        pub maybe: Option<Label>,
    }
}

table! {
    /// One row per demonstration.
    #[table("demos", version = 1)]
    pub struct Demo {
        /// Number of the demonstration.
        pub demo: u32,
        /// Name.
        pub name: String,
    }
}

/// The first version of [`Trial`], with some of its columns and a former name.
const OLD: TableSpec = TableSpec {
    name: "trials",
    version: 1,
    domain: "",
    formerly: "",
    description: "One row per trial.",
    columns: &[
        ColumnSpec::new("trial", ColumnKind::U32, "A number."),
        ColumnSpec::new("count", ColumnKind::U64, "A number."),
        ColumnSpec::new("offset", ColumnKind::I64, "A number."),
        ColumnSpec::new("value", ColumnKind::F64, "A number."),
        ColumnSpec::new("passed", ColumnKind::Bool, "A flag."),
        ColumnSpec::new("note", ColumnKind::Text, "A text."),
        ColumnSpec::new("label", ColumnKind::Category, "A label."),
        ColumnSpec::new("bytes", ColumnKind::Binary, "Bytes."),
        ColumnSpec::new("list", ColumnKind::F64List, "A list."),
        ColumnSpec::new("short", ColumnKind::F32List, "A list."),
    ],
};

fn specs() -> Vec<&'static TableSpec> {
    vec![Trial::table(), Demo::table()]
}

/// Publishes an artifact whose key depends on its number, made from the `episodes` artifact with the key `dataset`.
fn publish(store: &Store, number: usize, dataset: [u8; 32], rows: Vec<Trial>, group: usize) -> Artifact {
    let kind = ["re4", "paper"][number % 2];
    let recipe = Recipe::new(Stage::Rollout, 1)
        .config(&json!({ "policy": { "kind": kind, "number": number, "none": null } }))
        .unwrap()
        .input("episodes", &Key::from_bytes(dataset));
    let writer = store.begin(&recipe).unwrap();
    let mut table = writer.rows_in_groups::<Trial>(group).unwrap();
    table.extend(rows).unwrap();
    table.finish().unwrap();
    writer
        .publish(ArtifactSummary {
            summary: json!({ "score": number }),
            ..ArtifactSummary::default()
        })
        .unwrap()
}

struct Place {
    folder: tempfile::TempDir,
    artifacts: Vec<Artifact>,
}

impl Place {
    fn new(tables: Vec<Vec<Trial>>) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).unwrap();
        let artifacts = tables
            .into_iter()
            .enumerate()
            .map(|(number, rows)| publish(&store, number, [number as u8 % 2; 32], rows, 3))
            .collect();
        Self { folder, artifacts }
    }

    fn sources(&self) -> Sources {
        Sources::open(&[self.folder.path().to_path_buf()], specs()).unwrap()
    }

    fn json(&self, sql: &str) -> Value {
        answer_of(&self.sources(), sql)
    }

    fn rows(&self, sql: &str) -> Vec<Value> {
        self.json(sql)["rows"].as_array().unwrap().clone()
    }

    fn refused(&self, sql: &str) -> String {
        let error = match self.sources().query(sql) {
            Err(error) => error,
            Ok(answer) => write_json(answer, &mut Vec::new()).unwrap_err(),
        };
        sentence(&error).replace(&self.folder.path().display().to_string(), "[folder]")
    }

    /// The rows of all artifacts in the order of queries, which is that of their folders, each with the number of its artifact.
    fn direct(&self) -> Vec<(&Artifact, Trial)> {
        let mut sorted: Vec<&Artifact> = self.artifacts.iter().collect();
        sorted.sort_by_key(|artifact| artifact.path().to_path_buf());
        sorted
            .into_iter()
            .flat_map(|artifact| {
                artifact
                    .read::<Trial>()
                    .unwrap()
                    .into_iter()
                    .map(move |row| (artifact, row))
            })
            .collect()
    }
}

fn answer_of(sources: &Sources, sql: &str) -> Value {
    let mut text = Vec::new();
    write_json(sources.query(sql).unwrap(), &mut text).unwrap();
    serde_json::from_slice(&text).unwrap()
}

fn sentence(error: &anyhow::Error) -> String {
    match (
        error.downcast_ref::<Fault>(),
        error.downcast_ref::<re4_artifact::ArtifactError>(),
    ) {
        (Some(fault), _) => fault.sentence(),
        (_, Some(error)) => error.sentence(),
        _ => error.to_string(),
    }
}

fn name_of(artifact: &Artifact) -> String {
    format!("rollouts/{}", artifact.key().short())
}

/// A float as JSON: null if it is not finite.
fn float(value: f64) -> Value {
    serde_json::Number::from_f64(value).map_or(Value::Null, Value::Number)
}

fn expected(artifact: &Artifact, row: &Trial) -> Value {
    let hexadecimal: String = row
        .bytes
        .iter()
        .flat_map(|byte| format!("{byte:02x}").into_bytes())
        .map(char::from)
        .collect();
    json!({
        "artifact": name_of(artifact),
        "dataset": format!("episodes/{}", artifact.manifest().inputs["episodes"].short()),
        "trial": row.trial,
        "count": row.count,
        "offset": row.offset,
        "value": float(row.value),
        "passed": row.passed,
        "note": row.note,
        "label": row.label.0,
        "bytes": hexadecimal,
        "list": row.list.iter().copied().map(float).collect::<Vec<_>>(),
        "short": row.short.iter().map(|value| float(value.to_string().parse().unwrap())).collect::<Vec<_>>(),
        "extra": row.extra.map(float),
        "maybe": row.maybe.as_ref().map(|label| &label.0),
    })
}

fn any_trial() -> impl Strategy<Value = Trial> {
    let numbers = (
        any::<u32>(),
        0..=u64::MAX / 2,
        any::<i64>(),
        any::<f64>(),
        any::<bool>(),
    );
    let label = prop::sample::select(vec!["", "transit", "transfer", "a, \"b\"\n"]);
    let texts = (".{0,6}", label.clone(), prop::option::of(label));
    let lists = (
        prop::collection::vec(any::<u8>(), 0..5),
        prop::collection::vec(any::<f64>(), 0..4),
        prop::collection::vec(any::<f32>(), 0..4),
        prop::option::of(-1e3..1e3),
    );
    (numbers, texts, lists).prop_map(
        |((trial, count, offset, value, passed), (note, label, maybe), (bytes, list, short, extra))| Trial {
            trial,
            count,
            offset,
            value,
            passed,
            note,
            label: label.into(),
            bytes,
            list,
            short,
            extra,
            maybe: maybe.map(Into::into),
        },
    )
}

/// Trials that are the same in every call.
fn trials(seed: u32, count: u32) -> Vec<Trial> {
    (0..count)
        .map(|number| Trial {
            trial: number,
            count: u64::from(seed * 100 + number),
            offset: i64::from(number) - 3,
            value: f64::from(seed * 7 + number * 13 % 11) * 0.1,
            passed: (seed + number).is_multiple_of(3),
            note: format!("note {number}"),
            label: ["transit", "transfer"][(number % 2) as usize].into(),
            bytes: vec![number as u8],
            list: vec![f64::from(number); (number % 3) as usize],
            short: vec![0.1; (number % 2) as usize],
            extra: (number % 2 == 0).then_some(f64::from(number)),
            maybe: (number % 4 == 0).then(|| "x".into()),
        })
        .collect()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, ..ProptestConfig::default() })]

    #[test]
    fn all_rows_and_values_equal_those_of_the_direct_reader(
        tables in prop::collection::vec(prop::collection::vec(any_trial(), 0..9), 1..5),
    ) {
        let place = Place::new(tables);
        let wanted: Vec<Value> = place.direct().iter().map(|(artifact, row)| expected(artifact, row)).collect();
        prop_assert_eq!(place.rows("select * from trials"), wanted);
    }

    #[test]
    fn filters_and_groups_equal_those_by_hand(
        tables in prop::collection::vec(prop::collection::vec(any_trial(), 0..9), 1..5),
    ) {
        let place = Place::new(tables);
        let direct = place.direct();
        let passed: Vec<Value> = direct
            .iter()
            .filter(|(_, row)| row.passed && row.offset < 0 && row.label.starts_with("trans"))
            .map(|(_, row)| json!({ "count": row.count, "note": row.note }))
            .collect();
        prop_assert_eq!(
            place.rows("select count, note from trials where passed and \"offset\" < 0 and label like 'trans%'"),
            passed
        );
        let mut groups: BTreeMap<(String, bool), (u64, u32, u32)> = BTreeMap::new();
        for (_, row) in &direct {
            let group = groups.entry((row.label.to_string(), row.passed)).or_insert((0, u32::MAX, 0));
            *group = (group.0 + 1, group.1.min(row.trial), group.2.max(row.trial));
        }
        let groups: Vec<Value> = groups
            .into_iter()
            .map(|((label, passed), (rows, least, most))| json!({ "label": label, "passed": passed, "n": rows, "least": least, "most": most }))
            .collect();
        prop_assert_eq!(
            place.rows("select label, passed, count(*) as n, min(trial) as least, max(trial) as most from trials group by label, passed"),
            groups
        );
    }
}

#[test]
fn joins_across_kinds_of_artifacts_follow_the_dataset() {
    let place = Place::new((0..4).map(|seed| trials(seed, 6)).collect());
    let store = Store::open(place.folder.path()).unwrap();
    // Two datasets, of which the rollouts were made in turn.
    for dataset in 0..2_u8 {
        let recipe = Recipe::new(Stage::Audit, 1)
            .config(&json!({ "dataset": dataset }))
            .unwrap()
            .input("episodes", &Key::from_bytes([dataset; 32]));
        let writer = store.begin(&recipe).unwrap();
        let demos = (0..6).map(|demo| Demo {
            demo,
            name: format!("demo {demo} of {dataset}"),
        });
        writer.write_rows(demos).unwrap();
        writer.publish(ArtifactSummary::default()).unwrap();
    }
    let found = place.rows(
        "select t.artifact, d.name, t.trial from trials t join demos d on t.dataset = d.dataset and t.trial = d.demo where t.passed",
    );
    let mut wanted: Vec<(String, String, u32)> = place
        .direct()
        .into_iter()
        .filter(|(_, row)| row.passed)
        .map(|(artifact, row)| {
            let dataset = artifact.manifest().inputs["episodes"].to_string()[..2]
                .parse::<u8>()
                .unwrap();
            (name_of(artifact), format!("demo {} of {dataset}", row.trial), row.trial)
        })
        .collect();
    wanted.sort();
    let wanted: Vec<Value> = wanted
        .into_iter()
        .map(|(artifact, name, trial)| json!({ "artifact": artifact, "name": name, "trial": trial }))
        .collect();
    assert_eq!(wanted.len(), 8);
    assert_eq!(found, wanted);
}

#[test]
fn tables_of_older_versions_have_nulls() {
    let place = Place::new(vec![trials(0, 2)]);
    let store = Store::open(place.folder.path()).unwrap();
    let writer = store
        .begin(&Recipe::new(Stage::Rollout, 1).config(&json!("old")).unwrap())
        .unwrap();
    let mut table = writer.table(&OLD).unwrap();
    let columns = Columns::new(&OLD)
        .u32("trial", vec![7])
        .u64("count", vec![8])
        .i64("offset", vec![9])
        .f64("value", vec![0.5])
        .bool("passed", vec![true])
        .text("note", ["old"])
        .text("label", ["older"])
        .binary("bytes", [b"x"])
        .f64_list("list", [&[1.0][..]]);
    let columns = columns.f32_rows("short", vec![0.5], 1);
    table.write_columns(columns).unwrap();
    table.finish().unwrap();
    writer.publish(ArtifactSummary::default()).unwrap();
    let rows =
        place.rows("select trial, dataset is null as no_dataset, label, list, extra, maybe from trials order by trial");
    let old = json!({ "trial": 7, "no_dataset": true, "label": "older", "list": [1.0], "extra": null, "maybe": null });
    assert_eq!(rows.len(), 3);
    assert_eq!(rows[2], old);
    assert_eq!(rows[0]["extra"], json!(0.0));
    assert_eq!(
        place.rows("select count(*) as n from trials where extra is null"),
        [json!({ "n": 2 })]
    );
}

#[test]
fn artifacts_are_found_by_folder_root_and_pattern() {
    let place = Place::new((0..3).map(|seed| trials(seed, 2)).collect());
    let root = place.folder.path();
    let count = |arguments: &[PathBuf]| Sources::open(arguments, specs()).unwrap().len();
    let single = place.artifacts[0].path().to_path_buf();
    assert_eq!(count(std::slice::from_ref(&single)), 1);
    assert_eq!(count(&[single.clone(), single.clone()]), 1);
    assert_eq!(count(&[root.to_path_buf()]), 3);
    assert_eq!(count(&[root.join("rollouts")]), 3);
    assert_eq!(count(&[root.join("*/*")]), 3);
    assert_eq!(count(&[root.join("roll*"), single]), 3);
    let refused = |path: &Path| {
        let error = Sources::open(&[path.to_path_buf()], specs()).unwrap_err();
        sentence(&error).replace(&root.display().to_string(), "[folder]")
    };
    std::fs::create_dir(root.join("empty")).unwrap();
    std::fs::write(root.join("file"), "").unwrap();
    assert_eq!(
        refused(&root.join("empty")),
        "there is no artifact in [folder]/empty; give the folder of an artifact, or a folder of artifacts such as artifacts/rollouts"
    );
    assert_eq!(
        refused(&root.join("nothing/*")),
        "no artifact matches [folder]/nothing/*; give a pattern of folders such as 'artifacts/rollouts/*', in quotes"
    );
    assert_eq!(
        refused(&root.join("file")),
        "cannot query [folder]/file: it is not the folder of an artifact; give a folder such as artifacts/rollouts/KEY"
    );
    assert!(refused(&root.join("a***b")).contains("is not a valid pattern"));
    assert!(refused(&root.join("missing")).contains("the folder does not exist; check the path"));
}

#[test]
fn artifacts_settings_inputs_and_columns_are_tables() {
    let place = Place::new((0..3).map(|seed| trials(seed, 2)).collect());
    assert_eq!(
        place.rows(
            "select s.value, count(*) as n, sum(t.trial) as trials from trials t join settings s using (artifact) \
             where s.name = 'policy.kind' group by s.value"
        ),
        [
            json!({ "value": "paper", "n": 2, "trials": 1 }),
            json!({ "value": "re4", "n": 4, "trials": 2 })
        ]
    );
    assert_eq!(
        place.rows("select a.kind, i.name, count(*) as n from artifacts a join inputs i using (artifact) group by a.kind, i.name"),
        [json!({ "kind": "rollouts", "name": "episodes", "n": 3 })]
    );
    assert_eq!(
        place.rows("select value from summaries where name = 'score' order by value"),
        [
            json!({ "value": "0" }),
            json!({ "value": "1" }),
            json!({ "value": "2" })
        ]
    );
    assert_eq!(
        place.rows("select \"column\", type from columns where \"table\" = 'trials' and nullable"),
        [
            json!({ "column": "extra", "type": "f64" }),
            json!({ "column": "maybe", "type": "category" })
        ]
    );
}

#[test]
fn rows_have_a_defined_order() {
    let place = Place::new((0..4).map(|seed| trials(seed, 50)).collect());
    // Many rows have the same label and flag, and every artifact has the same trials.
    for sql in [
        "select label, passed, trial, artifact from trials order by label desc limit 7",
        "select passed, trial from trials order by passed limit 30",
    ] {
        let direct = place.direct();
        let wanted: Vec<Value> = if sql.contains("label") {
            let mut rows: Vec<_> = direct
                .iter()
                .map(|(artifact, row)| {
                    (
                        std::cmp::Reverse(row.label.to_string()),
                        row.passed,
                        row.trial,
                        name_of(artifact),
                    )
                })
                .collect();
            rows.sort();
            rows.into_iter()
                .take(7)
                .map(|(label, passed, trial, artifact)| json!({ "label": label.0, "passed": passed, "trial": trial, "artifact": artifact }))
                .collect()
        } else {
            let mut rows: Vec<_> = direct.iter().map(|(_, row)| (row.passed, row.trial)).collect();
            rows.sort_unstable();
            rows.into_iter()
                .take(30)
                .map(|(passed, trial)| json!({ "passed": passed, "trial": trial }))
                .collect()
        };
        assert_eq!(place.rows(sql), wanted, "{sql}");
    }
    let distinct = place.rows("select distinct label from trials");
    assert_eq!(
        distinct,
        [json!({ "label": "transfer" }), json!({ "label": "transit" })]
    );
}

#[test]
fn differences_of_counts_and_numbers_do_not_wrap_around() {
    let place = Place::new(vec![trials(0, 3), trials(1, 3)]);
    let found = place.rows("select count(*) - 10 as a, count(extra) - count(*) as b, min(trial) - 7 as c, sum(count) - 1000 as d from trials");
    assert_eq!(found, [json!({ "a": -4, "b": -2, "c": -7, "d": -694 })]);
    // The rows of several statements, which the engine counts without reading them.
    let found = place.rows(
        "select count(*) as n from (select trial from trials union all select trial from trials) as both_of_them",
    );
    assert_eq!(found, [json!({ "n": 12 })]);
}

#[test]
fn errors_are_sentences_with_remedies() {
    let place = Place::new(vec![trials(0, 3), trials(1, 3)]);
    assert_eq!(
        place.refused("select * from results"),
        "there is no table results in the artifacts; use one of trials, or one of artifacts, settings, summaries, inputs, columns about \
         the artifacts themselves, or give other artifacts"
    );
    let columns = "use one of the columns: trials has artifact, dataset, trial, count, offset, value, passed, note, label, bytes, list, \
                   short, extra, maybe";
    for sql in [
        "select sucess from trials",
        "select trials.sucess from trials",
        "select t.sucess from trials t",
        "select trial from trials where sucess",
        "select count(*) from trials group by sucess",
        "select trial from trials order by sucess",
        "select max(sucess) from trials",
    ] {
        assert_eq!(
            place.refused(sql),
            format!("there is no column sucess; {columns}"),
            "{sql}"
        );
    }
    for (sql, start) in [
        ("select from", "the query is not valid SQL: expected "),
        ("select * from trials where note > 3", "cannot run the query: "),
        ("select frobnicate(trial) from trials", "cannot run the query: "),
        (
            "with trials as (select 1) select * from trials",
            "the name trials in WITH is that of a table; choose another name",
        ),
    ] {
        let refused = place.refused(sql);
        assert!(
            refused.starts_with(start) && refused.contains("; ") && !refused.contains('\n'),
            "{refused}"
        );
    }
}

#[test]
fn a_damaged_table_is_named_and_other_tables_are_read() {
    let place = Place::new(vec![trials(0, 3), trials(1, 3)]);
    let file = place.artifacts[1].path().join("trials.parquet");
    let mut bytes = std::fs::read(&file).unwrap();
    bytes[40] ^= 1;
    std::fs::write(&file, &bytes).unwrap();
    let folder = format!("[folder]/rollouts/{}", place.artifacts[1].key().short());
    assert_eq!(
        place.refused("select * from trials"),
        format!(
            "artifact {folder} is damaged: the content of trials.parquet does not match its published hash; delete the folder {folder} and run again"
        )
    );
    assert_eq!(place.rows("select count(*) as n from artifacts"), [json!({ "n": 2 })]);
}

#[test]
fn answers_as_text_csv_and_parquet() {
    let place = Place::new(vec![trials(0, 4)]);
    let sources = place.sources();
    let sql = "select trial, value, note, list, bytes, extra from trials";
    let preview = |rows| Preview::of(sources.query(sql).unwrap(), rows).unwrap();
    assert_eq!(
        preview(2).text(None),
        "trial  value  note    list  bytes    extra\n    0      0  note 0  []    1 bytes      0\n    1    0.2  note 1  [1]   1 bytes   null\n\
         the first 2 rows; --rows N prints more, --csv and --json print all"
    );
    assert!(preview(4).text(Some(20)).ends_with("\n4 rows"));
    assert!(preview(9).text(Some(20)).lines().all(|line| line.chars().count() <= 20));
    let mut csv = Vec::new();
    write_csv(sources.query(sql).unwrap(), &mut csv).unwrap();
    assert_eq!(
        String::from_utf8(csv).unwrap(),
        "trial,value,note,list,bytes,extra\n0,0,note 0,[],00,0\n1,0.2,note 1,[1.0],01,\n2,0.4,note 2,\"[2.0,2.0]\",02,2\n3,0.6000000000000001,note 3,[],03,\n"
    );
    let mut empty = Vec::new();
    write_csv(
        sources
            .query("select trial, note from trials where trial > 99")
            .unwrap(),
        &mut empty,
    )
    .unwrap();
    assert_eq!(String::from_utf8(empty).unwrap(), "trial,note\n");
    let none = place.json("select trial from trials where trial > 99");
    assert_eq!(
        none,
        json!({ "columns": [{ "name": "trial", "type": "i64" }], "rows": [] })
    );
    let file = place.folder.path().join("out.parquet");
    sources
        .query("select * from trials")
        .unwrap()
        .write_parquet(&file)
        .unwrap();
    let read = std::fs::read(&file).unwrap();
    assert!(read.starts_with(b"PAR1") && read.ends_with(b"PAR1"));
}
