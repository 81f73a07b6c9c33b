//! Ingest of robosuite's tasks: an HDF5 file to `episodes`.

use std::path::Path;

use anyhow::Result;
use re4_artifact::{Columns, Facts, Recipe, Stage, Writer, tables};
use re4_ingest::robomimic::{Demo, DemoChoice, Interpreted, RobomimicReader, interpret};
use serde_json::json;

use super::super::{Built, Runner};
use super::find_source;

/// Raised whenever the same input gives other bytes.
const CODE_VERSION: u32 = 1;

impl Runner {
    /// The `episodes` artifact of a robosuite task.
    pub(super) fn ingest_robosuite(&self) -> Result<Built> {
        let section = &self.pipeline.ingest;
        let path = find_source(&section.source)?;
        let hash = hash(&path)?;
        let config = json!({
            "task": self.pipeline.task,
            "filter": section.filter,
            "images": section.images,
            "object": section.object,
            "select": section.select,
        });
        let recipe = Recipe::new(Stage::Ingest, CODE_VERSION)
            .config(&config)?
            .source(&hash, json!({ "format": "hdf5, robomimic" }));
        self.build(&recipe, |writer| self.ingest_hdf5(&path, writer))
    }

    fn ingest_hdf5(&self, path: &Path, writer: &Writer) -> Result<Facts> {
        let section = &self.pipeline.ingest;
        let choice = DemoChoice {
            filter: section.filter.clone(),
            select: section.select.clone(),
        };
        let reader = RobomimicReader::open(path, &choice)?;
        let mut episodes = Columns::new(&tables::EPISODES);
        let numbers: Vec<u32> = (0..reader.demos().len() as u32).collect();
        let mut lengths = Vec::new();
        let mut frames = writer.table(&tables::SPATIAL_FRAMES)?;
        let mut states = writer.table(&tables::STATES)?;
        let mut models: Vec<String> = Vec::new();
        let mut rows = Vec::new();
        for (episode, name) in (0..).zip(reader.demos()) {
            self.interrupt.check("ingest")?;
            let demo = reader.read(name)?;
            let interpreted =
                interpret(&demo).map_err(|fault| anyhow::anyhow!("cannot ingest {}: {fault}", path.display()))?;
            frames.write_columns(frame_columns(episode, &demo, &interpreted))?;
            if let Some(matrix) = &demo.states {
                states.write_columns(
                    Columns::new(&tables::STATES)
                        .u32("episode", vec![episode; demo.frames])
                        .u32("frame", (0..demo.frames as u32).collect())
                        .f64_list("state", matrix.values.chunks_exact(matrix.columns)),
                )?;
            }
            let model = demo.model.map(|text| {
                let place = models.iter().position(|model| *model == text);
                place.unwrap_or_else(|| {
                    models.push(text);
                    models.len() - 1
                }) as u32
            });
            rows.push((name.name.clone(), name.filter_keys.join(","), model));
            lengths.push(demo.frames as u32);
        }
        frames.finish()?;
        states.finish()?;
        let total: u64 = lengths.iter().map(|&length| u64::from(length)).sum();
        episodes = episodes
            .u32("episode", numbers.clone())
            .u32(
                "source_episode",
                reader.demos().iter().map(|demo| demo.number).collect(),
            )
            .u32("frames", lengths);
        let mut table = writer.table(&tables::EPISODES)?;
        table.write_columns(episodes)?;
        table.finish()?;
        let mut table = writer.table(&tables::DEMOS)?;
        let nothing = || vec![None; rows.len()];
        table.write_columns(
            Columns::new(&tables::DEMOS)
                .u32("episode", numbers)
                .text("demo", rows.iter().map(|row| &row.0))
                .text("filter_keys", rows.iter().map(|row| &row.1))
                .u32_or_null("model", rows.iter().map(|row| row.2).collect())
                .f64_or_null("goal_error_position", nothing())
                .f64_or_null("goal_error_rotation", nothing()),
        )?;
        table.finish()?;
        let mut table = writer.table(&tables::MODELS)?;
        table.write_columns(
            Columns::new(&tables::MODELS)
                .u32("model", (0..models.len() as u32).collect())
                .text("mjcf", &models),
        )?;
        table.finish()?;
        Ok(Facts {
            summary: json!({ "episodes": rows.len(), "frames": total }),
            warnings: Vec::new(),
        })
    }
}

/// Rows of table `spatial_frames`.
fn frame_columns(episode: u32, demo: &Demo, interpreted: &Interpreted) -> Columns {
    fn column<const N: usize>(rows: &[[f64; N]], i: usize) -> Vec<f64> {
        rows.iter().map(|row| row[i]).collect()
    }
    let frames = demo.frames;
    let mut columns = Columns::new(&tables::SPATIAL_FRAMES)
        .u32("episode", vec![episode; frames])
        .u32("frame", (0..frames as u32).collect());
    for (i, name) in ["eef_x", "eef_y", "eef_z"].into_iter().enumerate() {
        columns = columns.f64(name, column(&demo.eef_position, i));
    }
    for (i, name) in ["eef_qx", "eef_qy", "eef_qz", "eef_qw"].into_iter().enumerate() {
        columns = columns.f64(name, column(&demo.eef_quaternion, i));
    }
    let object = [
        "object_x",
        "object_y",
        "object_z",
        "object_qx",
        "object_qy",
        "object_qz",
        "object_qw",
    ];
    for (i, name) in object.into_iter().enumerate() {
        columns = columns.f64(name, column(&interpreted.object, i));
    }
    for (i, name) in ["finger_0", "finger_1"].into_iter().enumerate() {
        columns = columns.f64(name, column(&demo.fingers, i));
    }
    for (i, name) in ["delta_x", "delta_y", "delta_z", "delta_rx", "delta_ry", "delta_rz"]
        .into_iter()
        .enumerate()
    {
        columns = columns.f64(name, column(&interpreted.delta, i));
    }
    for (i, name) in ["goal_x", "goal_y", "goal_z", "goal_rx", "goal_ry", "goal_rz"]
        .into_iter()
        .enumerate()
    {
        columns = columns.f64(name, column(&interpreted.goal, i));
    }
    let optional = |values: &Option<Vec<f64>>| {
        values.as_ref().map_or_else(
            || vec![None; frames],
            |values| values.iter().copied().map(Some).collect(),
        )
    };
    columns
        .f64("gripper", column(&demo.actions, 6))
        .f64_or_null("reward", optional(&demo.rewards))
        .bool_or_null(
            "done",
            demo.dones.as_ref().map_or_else(
                || vec![None; frames],
                |values| values.iter().copied().map(Some).collect(),
            ),
        )
}

/// BLAKE3 of the file, which is mapped and hashed by all threads.
fn hash(path: &Path) -> Result<[u8; 32]> {
    let mut hasher = blake3::Hasher::new();
    hasher
        .update_mmap_rayon(path)
        .map_err(|error| anyhow::anyhow!("cannot ingest {}: {error}; check the path", path.display()))?;
    Ok(*hasher.finalize().as_bytes())
}
