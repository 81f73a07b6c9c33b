//! One demonstration: its arrays as they are in the file, checked.

use super::fault::Hdf5Fault;
use super::file::{Element, File, Located};

/// Rows of numbers, one after the other.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Matrix {
    /// Numbers of a row.
    pub columns: usize,
    /// All numbers.
    pub values: Vec<f64>,
}

impl Matrix {
    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.values.len().checked_div(self.columns).unwrap_or(0)
    }

    /// A row.
    pub fn row(&self, index: usize) -> &[f64] {
        &self.values[index * self.columns..(index + 1) * self.columns]
    }
}

/// What a file holds of one demonstration, bit for bit (single precision widened), every dataset with one row a frame and
/// without NaN or infinity. Rows of `obs` are the observations before the action of the same row.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Demo {
    /// Its group below `/data`, such as `demo_12`.
    pub name: String,
    /// Number of frames.
    pub frames: usize,
    /// `actions`: translation or position, rotation vector, gripper command.
    pub actions: Vec<[f64; 7]>,
    /// `obs/robot0_eef_pos`.
    pub eef_position: Vec<[f64; 3]>,
    /// `obs/robot0_eef_quat`.
    pub eef_quaternion: Vec<[f64; 4]>,
    /// `obs/robot0_gripper_qpos`.
    pub fingers: Vec<[f64; 2]>,
    /// `obs/object`.
    pub object: Matrix,
    /// `states`, where there are any.
    pub states: Option<Matrix>,
    /// `rewards`, where there are any.
    pub rewards: Option<Vec<f64>>,
    /// `dones`, where there are any.
    pub dones: Option<Vec<bool>>,
    /// Attribute `model_file`: the MJCF text; none where there is none.
    pub model: Option<String>,
    /// Datasets that hold single precision.
    pub single_precision: Vec<&'static str>,
}

/// The datasets of one demonstration, found and not yet read.
pub(crate) struct FoundDemo {
    pub(crate) name: String,
    pub(crate) frames: usize,
    pub(crate) model: Option<String>,
    datasets: [Option<Located>; DATASETS.len()],
}

/// Datasets of a demonstration that are read, and whether a file with observations has to have them.
const DATASETS: [(&str, bool); 8] = [
    ("actions", true),
    ("obs/robot0_eef_pos", true),
    ("obs/robot0_eef_quat", true),
    ("obs/robot0_gripper_qpos", true),
    ("obs/object", true),
    ("states", false),
    ("rewards", false),
    ("dones", false),
];

impl FoundDemo {
    /// Finds the datasets and checks their shapes against each other and against the attribute `num_samples`.
    pub(crate) fn find(file: &File, name: &str) -> Result<Self, Hdf5Fault> {
        let group = format!("data/{name}");
        if file.members(&group)?.is_none_or(|members| members.is_empty()) {
            return Err(Hdf5Fault::EmptyDemo { demo: name.to_owned() });
        }
        let mut datasets: [Option<Located>; DATASETS.len()] = Default::default();
        for (slot, (dataset, needed)) in datasets.iter_mut().zip(DATASETS) {
            let path = format!("{group}/{dataset}");
            *slot = file.locate(&path)?;
            if needed && slot.is_none() {
                return Err(Hdf5Fault::Missing {
                    object: path,
                    mend: "restore it, or leave the demonstration out by a filter key",
                });
            }
        }
        let frames = rows_of(&datasets)?;
        if let Some(samples) = file.count_attribute(&group, "num_samples")?
            && usize::try_from(samples) != Ok(frames)
        {
            return Err(Hdf5Fault::Count {
                object: format!("/{group}"),
                attribute: "num_samples",
                found: samples,
                expected: frames,
                what: format!("rows in {group}/actions"),
            });
        }
        Ok(Self {
            name: name.to_owned(),
            frames,
            model: file.text_attribute(&group, "model_file")?,
            datasets,
        })
    }

    /// Reads the datasets and checks their values.
    pub(crate) fn read(self, file: &File) -> Result<Demo, Hdf5Fault> {
        let mut demo = Demo {
            name: self.name,
            frames: self.frames,
            model: self.model,
            ..Demo::default()
        };
        for (located, (dataset, _)) in self.datasets.iter().zip(DATASETS) {
            let Some(located) = located else { continue };
            let values = file.read(located)?;
            if located.element == Element::F32 {
                demo.single_precision.push(dataset);
            }
            let columns = located.shape.get(1).copied().unwrap_or(1);
            if dataset != "dones" {
                finite(located, &values, columns)?;
            }
            match dataset {
                "actions" => demo.actions = rows(located, &values)?,
                "obs/robot0_eef_pos" => demo.eef_position = rows(located, &values)?,
                "obs/robot0_eef_quat" => demo.eef_quaternion = rows(located, &values)?,
                "obs/robot0_gripper_qpos" => demo.fingers = rows(located, &values)?,
                "obs/object" => demo.object = Matrix { columns, values },
                "states" => demo.states = Some(Matrix { columns, values }),
                "rewards" => demo.rewards = Some(values),
                _ => demo.dones = Some(flags(located, &values)?),
            }
        }
        Ok(demo)
    }
}

/// Rows that all datasets have.
fn rows_of(datasets: &[Option<Located>]) -> Result<usize, Hdf5Fault> {
    let length = |located: &Located| located.shape.first().copied().unwrap_or(0);
    let found: Vec<&Located> = datasets.iter().flatten().collect();
    // What most of them have is what the others are measured by.
    let common = found
        .iter()
        .map(|located| length(located))
        .max_by_key(|&rows| found.iter().filter(|other| length(other) == rows).count())
        .unwrap_or(0);
    for located in &found {
        if length(located) != common {
            let other = found.iter().find(|other| length(other) == common).unwrap_or(located);
            return Err(Hdf5Fault::Length {
                object: located.name.clone(),
                found: length(located),
                other: other.name.clone(),
                expected: common,
            });
        }
    }
    match found.first() {
        Some(first) if common == 0 => Err(Hdf5Fault::NoFrames {
            object: first.name.clone(),
        }),
        _ => Ok(common),
    }
}

fn rows<const WIDTH: usize>(located: &Located, values: &[f64]) -> Result<Vec<[f64; WIDTH]>, Hdf5Fault> {
    if located.shape.len() != 2 || located.shape[1] != WIDTH {
        return Err(Hdf5Fault::Shape {
            object: located.name.clone(),
            found: located.shape.clone(),
            expected: format!("(N, {WIDTH})"),
            mend: "give a file of one arm with a two-finger gripper under OSC_POSE",
        });
    }
    let (rows, _) = values.as_chunks::<WIDTH>();
    Ok(rows.to_vec())
}

fn finite(located: &Located, values: &[f64], columns: usize) -> Result<(), Hdf5Fault> {
    // Most arrays are finite: a sum that is finite says so without a branch a value, where it does not overflow.
    let Some(at) = values.iter().position(|value| !value.is_finite()) else {
        return Ok(());
    };
    Err(Hdf5Fault::NotFinite {
        object: located.name.clone(),
        row: at / columns.max(1),
        column: at % columns.max(1),
        value: values[at],
    })
}

fn flags(located: &Located, values: &[f64]) -> Result<Vec<bool>, Hdf5Fault> {
    let flag = |(row, &value): (usize, &f64)| match value {
        0.0 => Ok(false),
        1.0 => Ok(true),
        _ => Err(Hdf5Fault::NotAFlag {
            object: located.name.clone(),
            row,
            value,
        }),
    };
    values.iter().enumerate().map(flag).collect()
}
