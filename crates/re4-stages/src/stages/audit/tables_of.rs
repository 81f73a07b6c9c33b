//! The tables of an `audit` artifact.

use anyhow::Result;
use re4_artifact::{Columns, Writer, tables};
use re4_audit::{Finding, Severity};
use re4_episode::Mode;

use super::{Audited, Listed, ListedGrasp, by_code};
use crate::inputs::poses::numbers as parts;

pub(super) fn findings(findings: &[Finding], writer: &Writer) -> Result<()> {
    let mut table = writer.table(&tables::FINDINGS)?;
    let column = |value: fn(&Finding) -> u32| findings.iter().map(value).collect::<Vec<_>>();
    table.write_columns(
        Columns::new(&tables::FINDINGS)
            .u32("finding", (0..findings.len() as u32).collect())
            .text("severity", findings.iter().map(|f| f.severity.as_str()))
            .text("code", findings.iter().map(|f| f.code))
            .u32("episode", column(|f| f.episode))
            .u32("first_frame", column(|f| f.frames.start))
            .u32("end_frame", column(|f| f.frames.end))
            .f64_or_null("value", findings.iter().map(|f| f.value).collect())
            .f64_or_null("threshold", findings.iter().map(|f| f.threshold).collect())
            .text("unit", findings.iter().map(|f| f.unit))
            .text("message", findings.iter().map(|f| &f.message))
            .text("demo_name", findings.iter().map(|f| &f.demo)),
    )?;
    table.finish()?;
    Ok(())
}

pub(super) fn checks(audited: &Audited, writer: &Writer) -> Result<()> {
    let counts = by_code(&audited.findings);
    let count = |code: &str| counts.get(code).copied().unwrap_or_default();
    let checks: Vec<_> = audited.thresholds.iter().collect();
    let planar = audited.thresholds.planar();
    let mut table = writer.table(&tables::CHECKS)?;
    table.write_columns(
        Columns::new(&tables::CHECKS)
            .text("code", checks.iter().map(|(check, _)| check.code))
            .text("severity", checks.iter().map(|(check, _)| check.severity.as_str()))
            .text("meaning", checks.iter().map(|(check, _)| check.meaning))
            .text("measure", checks.iter().map(|(check, _)| check.measure))
            .f64_or_null(
                "threshold",
                checks.iter().map(|(_, threshold)| threshold.value).collect(),
            )
            .text("unit", checks.iter().map(|(check, _)| check.unit_of(planar)))
            .text("origin", checks.iter().map(|(_, threshold)| threshold.origin.as_str()))
            .text("derivation", checks.iter().map(|(_, threshold)| &threshold.derivation))
            .u32(
                "findings",
                checks.iter().map(|(check, _)| count(check.code).0).collect(),
            )
            .u32(
                "episodes",
                checks.iter().map(|(check, _)| count(check.code).1).collect(),
            ),
    )?;
    table.finish()?;
    Ok(())
}

pub(super) fn episodes(audited: &Audited, writer: &Writer) -> Result<()> {
    let listed = &audited.listed;
    let column = |value: &dyn Fn(&Listed) -> usize| listed.iter().map(|l| value(l) as u32).collect::<Vec<_>>();
    let found = |severity: Severity| {
        let mut counts = vec![0; listed.len()];
        for finding in audited.findings.iter().filter(|finding| finding.severity == severity) {
            if let Some(count) = counts.get_mut(finding.episode as usize) {
                *count += 1;
            }
        }
        counts
    };
    let transfers = |l: &Listed| l.segments.iter().filter(|s| s.mode == Mode::Transfer).count();
    let grasp_frame = |l: &Listed| {
        let first = l.segments.iter().find(|s| s.mode == Mode::Transfer)?;
        Some(first.frames.start as u32)
    };
    let mut table = writer.table(&tables::AUDITED_EPISODES)?;
    table.write_columns(
        Columns::new(&tables::AUDITED_EPISODES)
            .u32("episode", (0..listed.len() as u32).collect())
            .text("demo", listed.iter().map(|l| &l.demo))
            .u32("frames", column(&|l| l.frames))
            .u32("transit_frames", column(&|l| l.frames_in(Mode::Transit)))
            .u32("transfer_frames", column(&|l| l.frames_in(Mode::Transfer)))
            .u32("segments", column(&|l| l.segments.len()))
            .u32("transfers", column(&transfers))
            .u32_or_null("grasp_frame", listed.iter().map(grasp_frame).collect())
            .f64("object_displacement", listed.iter().map(|l| l.displacement).collect())
            .u32("errors", found(Severity::Error))
            .u32("warnings", found(Severity::Warning))
            .u32("notes", found(Severity::Note)),
    )?;
    table.finish()?;
    Ok(())
}

pub(super) fn grasps(grasps: &[ListedGrasp], writer: &Writer) -> Result<()> {
    let column = |value: &dyn Fn(&ListedGrasp) -> usize| grasps.iter().map(|g| value(g) as u32).collect::<Vec<_>>();
    let number = |value: fn(&ListedGrasp) -> f64| grasps.iter().map(value).collect::<Vec<_>>();
    let mut columns = Columns::new(&tables::GRASPS)
        .u32("episode", grasps.iter().map(|g| g.episode).collect())
        .u32("segment", column(&|g| g.judged.segment))
        .u32("first_frame", column(&|g| g.judged.frames.start))
        .u32("end_frame", column(&|g| g.judged.frames.end))
        .text("outcome", grasps.iter().map(|g| g.judged.outcome.as_str()))
        .f64("finger_separation", number(|g| g.separation))
        .f64("rigidity_residual", number(|g| g.judged.residual))
        .f64("object_rise", number(|g| g.judged.rise));
    for (place, part) in ["x", "y", "z", "qx", "qy", "qz", "qw"].iter().enumerate() {
        let values = grasps.iter().map(|g| parts(&g.transform)[place]).collect();
        columns = columns.f64(&format!("grasp_{part}"), values);
    }
    let mut table = writer.table(&tables::GRASPS)?;
    table.write_columns(columns)?;
    table.finish()?;
    Ok(())
}
