//! `MimicGen`'s group `datagen_info` of a demonstration: poses of the end effector, its targets and the objects, as matrices.
//!
//! | dataset | shape | content |
//! |---|---|---|
//! | `eef_pose` | (N, 4, 4) | frame that the controller controls, world frame |
//! | `target_pose` | (N, 4, 4) | where the action asks this frame to go |
//! | `gripper_action` | (N, 1) | last column of `actions` |
//! | `object_poses/NAME` | (N, 4, 4) | root body of an object, world frame |
//! | `subtask_term_signals/NAME` | (N,) | not read |

use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};

use super::super::fault::Hdf5Fault;
use super::super::file::{File, Located};

/// Group of the datasets.
pub(crate) const GROUP: &str = "datagen_info";

/// Maximum deviation of the axes of a pose matrix from orthonormal ones. Matrices in single precision deviate by 1e-7.
const ORTHONORMAL: f64 = 1e-3;

const FIX: &str = "restore it, remove the group datagen_info if observations or states have the poses, or leave the demonstration out with a filter key or ingest.select";

/// What `datagen_info` of one demonstration contains. All poses are in the world frame, in metres.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Datagen {
    /// Pose of the controller's frame before each action.
    pub(in crate::robomimic) eef: Option<Vec<Isometry3<f64>>>,
    /// Its target by each action.
    pub(in crate::robomimic) target: Option<Vec<Isometry3<f64>>>,
    /// Gripper commands.
    pub(in crate::robomimic) gripper: Option<Vec<f64>>,
    /// Poses of the objects by name, in byte order of the names.
    pub(in crate::robomimic) objects: Vec<(String, Vec<Isometry3<f64>>)>,
}

impl Datagen {
    /// The poses of the object with this name.
    pub(in crate::robomimic) fn object(&self, name: &str) -> Option<&[Isometry3<f64>]> {
        let found = self.objects.iter().find(|(own, _)| own == name);
        found.map(|(_, poses)| poses.as_slice())
    }
}

/// A dataset of the group.
#[derive(Debug, Clone, PartialEq, Eq)]
enum Part {
    Eef,
    Target,
    Gripper,
    Object(String),
}

/// The located datasets.
pub(crate) struct FoundDatagen {
    parts: Vec<(Part, Located)>,
}

impl FoundDatagen {
    /// Names of the objects in the group of a demonstration; none if it has no such group.
    pub(crate) fn objects(file: &File, demo: &str) -> Result<Vec<String>, Hdf5Fault> {
        file.members_or_none(&format!("data/{demo}/{GROUP}/object_poses"))
    }

    /// Locates the datasets of an existing group and adds faults of their shapes.
    pub(crate) fn find(file: &File, demo: &str, faults: &mut Vec<Hdf5Fault>) -> Result<Self, Hdf5Fault> {
        let group = format!("{demo}/{GROUP}");
        let mut parts = Vec::new();
        let mut names = Vec::new();
        for member in file.members(&group)? {
            match member.as_str() {
                "eef_pose" => names.push((Part::Eef, member)),
                "target_pose" => names.push((Part::Target, member)),
                "gripper_action" => names.push((Part::Gripper, member)),
                "object_poses" => {
                    let objects = file.members(&format!("{group}/{member}"))?;
                    names.extend(
                        objects
                            .into_iter()
                            .map(|object| (Part::Object(object.clone()), format!("object_poses/{object}"))),
                    );
                }
                _ => {}
            }
        }
        for (part, name) in names {
            let located = file.locate(&format!("{group}/{name}")).and_then(|located| {
                let matrix = matches!(located.shape[..], [_, 4, 4]);
                let column = matches!(located.shape[..], [_] | [_, 1]);
                if if part == Part::Gripper { column } else { matrix } {
                    return Ok(located);
                }
                Err(Hdf5Fault::Shape {
                    object: located.name.clone(),
                    found: located.shape.clone(),
                    expected: if part == Part::Gripper { "(N, 1)" } else { "(N, 4, 4)" }.to_owned(),
                    fix: FIX,
                })
            });
            match located {
                Ok(located) => parts.push((part, located)),
                Err(fault) => file.note(faults, fault)?,
            }
        }
        Ok(Self { parts })
    }

    /// Adds a fault for each dataset without one row per frame.
    pub(crate) fn check_rows(&self, demo: &str, frames: usize, faults: &mut Vec<Hdf5Fault>) {
        for (_, located) in &self.parts {
            let rows = located.shape.first().copied().unwrap_or(0);
            if rows != frames {
                faults.push(Hdf5Fault::Length {
                    objects: vec![located.name.clone()],
                    found: rows,
                    other: format!("{demo}/actions"),
                    expected: frames,
                });
            }
        }
    }

    /// Reads the datasets, and adds faults of their values.
    pub(crate) fn read(self, file: &File, faults: &mut Vec<Hdf5Fault>) -> Result<Datagen, Hdf5Fault> {
        let mut datagen = Datagen::default();
        for (part, located) in self.parts {
            let values = match file.read(&located) {
                Ok(values) => values,
                Err(fault) => {
                    file.note(faults, fault)?;
                    continue;
                }
            };
            if part == Part::Gripper {
                match values.iter().position(|value| !value.is_finite()) {
                    Some(row) => faults.push(not_finite(&located, row, 0, values[row])),
                    None => datagen.gripper = Some(values),
                }
                continue;
            }
            let poses = match poses(&located, &values) {
                Ok(poses) => poses,
                Err(fault) => {
                    faults.push(fault);
                    continue;
                }
            };
            match part {
                Part::Eef => datagen.eef = Some(poses),
                Part::Target => datagen.target = Some(poses),
                Part::Object(name) => datagen.objects.push((name, poses)),
                Part::Gripper => {}
            }
        }
        datagen.objects.sort_by(|a, b| a.0.cmp(&b.0));
        Ok(datagen)
    }
}

fn not_finite(located: &Located, row: usize, column: usize, value: f64) -> Hdf5Fault {
    Hdf5Fault::NotFinite {
        object: located.name.clone(),
        row,
        column,
        value,
    }
}

/// Converts rows of 16 numbers to poses. A matrix must be finite, rigid and right-handed.
fn poses(located: &Located, values: &[f64]) -> Result<Vec<Isometry3<f64>>, Hdf5Fault> {
    let mut poses = Vec::with_capacity(values.len() / 16);
    for (row, matrix) in values.as_chunks::<16>().0.iter().enumerate() {
        if let Some(column) = matrix.iter().position(|value| !value.is_finite()) {
            return Err(not_finite(located, row, column, matrix[column]));
        }
        let pose = pose(matrix).map_err(|why| {
            Hdf5Fault::Other(format!(
                "dataset {} has in row {row} a matrix that is not the pose of a rigid body: {why}; {FIX}",
                located.name
            ))
        })?;
        poses.push(pose);
    }
    Ok(poses)
}

/// The pose of a homogeneous matrix, row by row; the error says why it is none.
fn pose(matrix: &[f64; 16]) -> Result<Isometry3<f64>, String> {
    let rotation = Matrix3::from_fn(|row, column| matrix[4 * row + column]);
    let deviation = (rotation.transpose() * rotation - Matrix3::identity()).amax();
    if deviation > ORTHONORMAL {
        return Err(format!("its axes deviate from orthonormal ones by {deviation:.2e}"));
    }
    if rotation.determinant() < 0.0 {
        return Err("its axes are left-handed".to_owned());
    }
    let last = [matrix[12], matrix[13], matrix[14], matrix[15] - 1.0];
    if last.iter().any(|value| value.abs() > ORTHONORMAL) {
        return Err("its last row is not 0, 0, 0, 1".to_owned());
    }
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation));
    Ok(Isometry3::from_parts(
        Translation3::from(Vector3::new(matrix[3], matrix[7], matrix[11])),
        UnitQuaternion::new_normalize(rotation.into_inner()),
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn matrix(pose: &Isometry3<f64>) -> [f64; 16] {
        let homogeneous = pose.to_homogeneous();
        std::array::from_fn(|i| homogeneous[(i / 4, i % 4)])
    }

    #[test]
    fn poses_survive_the_matrix() {
        for k in 0..50 {
            let k = f64::from(k);
            let axis = Vector3::new(k.sin(), (2.0 * k).cos(), (3.0 * k).sin()) * 3.0;
            let known = Isometry3::new(Vector3::new(k, -k, 0.1 * k), axis);
            let found = pose(&matrix(&known)).unwrap();
            assert!((found.translation.vector - known.translation.vector).norm() < 1e-15);
            assert!(found.rotation.angle_to(&known.rotation) < 1e-7, "{k}");
        }
    }

    #[test]
    fn matrices_of_no_rigid_body_are_refused() {
        let known = matrix(&Isometry3::new(
            Vector3::new(0.1, 0.2, 0.3),
            Vector3::new(0.4, 0.5, 0.6),
        ));
        let change = |place: usize, factor: f64| {
            let mut changed = known;
            changed[place] *= factor;
            pose(&changed).unwrap_err()
        };
        assert!(change(0, 1.01).contains("orthonormal"));
        assert!(change(15, 0.5).contains("last row"));
        let mut mirrored = known;
        (0..3).for_each(|row| mirrored[4 * row] *= -1.0);
        assert!(pose(&mirrored).unwrap_err().contains("left-handed"));
        assert!(pose(&[0.0; 16]).is_err());
    }
}
