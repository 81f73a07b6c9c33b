//! stand-in until merged
use crate::pipeline::TaskName;
use anyhow::Result;
use nalgebra::Isometry3;
use re4_artifact::{Artifact, Writer};
use serde_json::{Value, json};
pub(super) fn evaluate(
    _w: &Writer,
    _e: &Artifact,
    _m: &Artifact,
    _p: &[Vec<Isometry3<f64>>],
    _t: &[bool],
    _k: TaskName,
) -> Result<Value> {
    Ok(json!({}))
}
