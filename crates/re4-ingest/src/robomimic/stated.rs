//! Rows of the table of conventions: proofs, and what a file or a setting states.

use re4_robosuite::conventions::{Basis, Proof};
use re4_robosuite::env_args::EnvArgs;

use super::from_states::FromStates;
use super::interpret::Reading;
use super::reader::Layout;
use super::relatives::Relative;
use crate::tables::Convention;

/// Converts a proof to a table row.
pub(super) fn convention(proof: &Proof) -> Convention {
    let candidates = &proof.evidence.candidates;
    let own = candidates.iter().find(|candidate| candidate.value == proof.value);
    let rival = candidates.iter().filter(|candidate| candidate.value != proof.value);
    let rival = rival.map(|candidate| candidate.median).min_by(f64::total_cmp);
    let measured = own.filter(|own| own.residual.is_finite());
    Convention {
        convention: proof.convention.clone().into(),
        value: proof.value.clone().into(),
        basis: match proof.basis {
            Basis::Data => "proven",
            Basis::Setting => "setting",
            Basis::Declared => "declared",
        }
        .into(),
        evidence: proof.evidence.test.clone(),
        residual: measured.map(|own| own.residual),
        runner_up: rival.filter(|rival| measured.is_some() && rival.is_finite()),
        threshold: measured.map(|_| proof.evidence.threshold),
        unit: proof.evidence.unit.clone().into(),
        frames: proof.evidence.frames,
    }
}

/// Conventions that are not proven from the numbers: settings, and declarations in the file.
pub(super) fn stated(
    layout: Layout,
    reading: &Reading,
    env: &EnvArgs,
    from_states: &FromStates,
    relative: &Relative,
) -> Vec<Convention> {
    let row = |name: &'static str, value: String, basis: &'static str, evidence: &str| Convention {
        convention: name.into(),
        value: value.into(),
        basis: basis.into(),
        evidence: evidence.to_owned(),
        residual: None,
        runner_up: None,
        threshold: None,
        unit: "".into(),
        frames: 0,
    };
    let (layout, poses) = match layout {
        Layout::Observed => ("robomimic", "the demonstrations have a group obs"),
        Layout::Raw => ("raw", "the demonstrations have states and actions, and no group obs"),
    };
    let mut rows = vec![row("layout", layout.to_owned(), "declared", poses)];
    rows.push(row(
        "environment",
        env.env_name.clone(),
        "declared",
        "attribute env_args or env of /data",
    ));
    if let Some(version) = &env.env_version {
        rows.push(row(
            "robosuite_version",
            version.clone(),
            "declared",
            "attribute env_args or repository_version of /data",
        ));
    }
    let (source, evidence) = match from_states {
        FromStates::Nothing => ("observations", "eef, fingers and object pose are copied from obs"),
        FromStates::Datagen(_) => (
            "datagen_info",
            "eef and fingers are copied from obs, the object's pose is that in datagen_info/object_poses",
        ),
        FromStates::Object(_) => (
            "states",
            "the object's pose is computed from states and model_file by forward kinematics",
        ),
        FromStates::All(_) => (
            "states",
            "eef, fingers and object pose are computed from states and model_file by forward kinematics",
        ),
    };
    rows.push(row("poses", source.to_owned(), "declared", evidence));
    if let FromStates::Object(object) | FromStates::All(object) | FromStates::Datagen(object) = from_states {
        let basis = if reading.object.is_some() {
            "setting"
        } else {
            "declared"
        };
        rows.push(row("object", object.clone(), basis, relative.object_source(reading)));
    }
    if reading.env_args.is_some() {
        rows.push(row(
            "env_args",
            "given".to_owned(),
            "setting",
            "ingest.env_args replaces the attribute of the file",
        ));
    }
    if reading.conventions.allow_actions_beyond_range {
        let evidence = "ingest.conventions.allow_actions_beyond_range; the controller clips them to its limits";
        rows.push(row("actions_beyond_range", "accepted".to_owned(), "setting", evidence));
    }
    rows
}
