//! A synthetic audit of pick-and-place demonstrations with errors, for tests of the audit page.

use re4_artifact::episodes::Convention;
use re4_audit::{AuditedEpisodeRow, CheckRow, FindingRow, Severity};
use re4_report::html::audit::{Audit, Flag, Grasp, Measure, Panel, Segment, Series};

/// A small deterministic random number generator.
struct Random(u64);

impl Random {
    /// In [0, 1).
    fn next(&mut self) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn about(&mut self, middle: f64, spread: f64) -> f64 {
        middle + spread * (self.next() + self.next() + self.next() - 1.5)
    }

    fn frames(&mut self, low: u32, high: u32) -> u32 {
        low + (self.next() * f64::from(high - low)) as u32
    }
}

const KINDS: [(&str, Severity, &str, f64, &str); 7] = [
    (
        "grasp_missed",
        Severity::Warning,
        "the fingers closed on nothing",
        0.004,
        "m",
    ),
    (
        "grasp_lost",
        Severity::Error,
        "the object slipped out before the command to open",
        0.02,
        "m",
    ),
    ("idle", Severity::Note, "neither arm nor fingers move", 12.0, "frames"),
    (
        "object_moves_in_transit",
        Severity::Warning,
        "the object moves though nothing holds it",
        0.003,
        "m/frame",
    ),
    (
        "long_demonstration",
        Severity::Note,
        "the demonstration is longer than usual",
        190.0,
        "frames",
    ),
    (
        "flicker",
        Severity::Error,
        "the segment is too short to be a grasp",
        3.0,
        "frames",
    ),
    ("duplicate", Severity::Error, "it equals another demonstration", 0.0, ""),
];

/// An audit of `count` demonstrations. Every tenth misses its first grasp and tries again; some lose the object.
pub(crate) fn audit(count: u32) -> Audit {
    let mut random = Random(7);
    let mut made = Builder::default();
    for number in 0..count {
        made.demo(number, &mut random);
    }
    made.finish()
}

#[derive(Default)]
struct Builder {
    demos: Vec<AuditedEpisodeRow>,
    findings: Vec<FindingRow>,
    segments: Vec<Segment>,
    grasps: Vec<Grasp>,
    closes: Vec<Option<bool>>,
    holds: Vec<Option<bool>>,
    fingers: Vec<f64>,
    height: [Vec<f64>; 2],
    speed: [Vec<f64>; 2],
    relative: Vec<f64>,
    distance: Vec<f64>,
}

impl Builder {
    fn demo(&mut self, number: u32, random: &mut Random) {
        let missed = number % 10 == 3;
        let lost = number % 37 == 5;
        let mut runs = vec![(false, random.frames(35, 60))];
        if missed {
            runs.extend([(true, random.frames(6, 14)), (false, random.frames(12, 25))]);
        }
        runs.extend([(true, random.frames(40, 90)), (false, random.frames(6, 18))]);
        let frames: u32 = runs.iter().map(|(_, length)| length).sum();
        let mut first = 0;
        for (i, &(transfer, length)) in runs.iter().enumerate() {
            let outcome = match (transfer, i, missed, lost) {
                (false, ..) => "",
                (true, 1, true, _) => "missed",
                (true, _, _, true) => "lost",
                _ => "held",
            };
            self.segment(number, i as u32, first, length, outcome, random);
            first += length;
        }
        let mut found = Vec::new();
        if missed {
            found.push((0, runs[0].1, runs[0].1 + runs[1].1));
        }
        if lost {
            found.push((1, frames - 30, frames - 12));
        }
        if random.next() < 0.3 {
            let at = random.frames(0, frames - 20);
            found.push((2, at, at + random.frames(12, 20)));
        }
        if random.next() < 0.06 {
            let at = random.frames(0, frames - 12);
            found.push((3, at, at + 4));
        }
        if frames > 175 {
            found.push((4, 0, frames));
        }
        if number % 199 == 17 {
            found.push((6, 0, frames));
        }
        found.sort_by_key(|&(kind, first, _)| (first, KINDS[kind].0));
        let transfer: u32 = runs
            .iter()
            .filter(|(transfer, _)| *transfer)
            .map(|(_, length)| length)
            .sum();
        let count = |severity| found.iter().filter(|(kind, ..)| KINDS[*kind].1 == severity).count() as u32;
        self.demos.push(AuditedEpisodeRow {
            episode: number,
            demo: format!("demo_{number}"),
            frames: frames as usize,
            transit_frames: (frames - transfer) as usize,
            transfer_frames: transfer as usize,
            segments: runs.len(),
            transfers: runs.iter().filter(|(transfer, _)| *transfer).count(),
            grasp_frame: Some(runs[0].1 as usize),
            object_displacement: random.about(0.4, 0.1),
            errors: count(Severity::Error),
            warnings: count(Severity::Warning),
            notes: count(Severity::Note),
        });
        for (kind, first_frame, end_frame) in found {
            let (code, severity, words, threshold, unit) = KINDS[kind];
            self.findings.push(FindingRow {
                finding: self.findings.len() as u32,
                demo_name: None,
                severity,
                code: code.into(),
                episode: number,
                frames: first_frame..end_frame,
                other_episode: None,
                other_demo: None,
                value: Some(random.about(threshold * 1.7, threshold * 0.2)),
                threshold: Some(threshold),
                unit: unit.into(),
                message: format!(
                    "demo_{number}, frames {first_frame} to {}: {words} </script> & more",
                    end_frame - 1
                ),
            });
        }
    }

    fn segment(&mut self, episode: u32, number: u32, first: u32, length: u32, outcome: &str, random: &mut Random) {
        let transfer = !outcome.is_empty();
        let held = outcome == "held" || outcome == "lost";
        let closed = if held { 0.031 } else { 0.001 };
        for frame in 0..length {
            let t = f64::from(frame) / f64::from(length);
            let settle = (f64::from(frame) / 6.0).min(1.0);
            let separation = if transfer {
                0.078 + (closed - 0.078) * settle
            } else {
                0.078
            };
            let lift = if held {
                0.25 * (t * std::f64::consts::PI).sin()
            } else {
                0.0
            };
            let last = frame + 1 == length;
            self.closes.push(Some(transfer));
            self.holds.push(if last { None } else { Some(held && settle >= 1.0) });
            self.fingers.push(separation);
            self.height[0].push(random.about(1.0 - 0.1 * t + lift, 0.002));
            self.height[1].push(random.about(0.86 + lift, 0.0004));
            self.speed[0].push(if last {
                f64::NAN
            } else {
                random.about(0.012, 0.003).abs()
            });
            self.speed[1].push(if last {
                f64::NAN
            } else {
                random.about(if held { 0.012 } else { 0.0 }, 0.001).abs()
            });
            self.relative.push(if last {
                f64::NAN
            } else {
                random.about(if held { 0.0 } else { 0.011 }, 0.0009).abs()
            });
            self.distance.push(if transfer {
                random.about(0.01, 0.001)
            } else {
                0.25 * (1.0 - t) + 0.01
            });
        }
        self.segments.push(Segment {
            episode,
            number,
            transfer,
            first_frame: first,
            end_frame: first + length,
            settled_frame: transfer.then_some(first + 6),
            finger_separation: transfer.then_some(closed),
            residual: transfer.then(|| random.about(0.003, 0.001)),
            residual_rotation: transfer.then(|| random.about(0.03, 0.01)),
            object_displacement: if held { 0.4 } else { 0.0 },
            object_rise: Some(if held { 0.1 } else { 0.0 }),
        });
        if transfer {
            let off = if outcome == "missed" { 0.03 } else { 0.0 };
            self.grasps.push(Grasp {
                episode,
                segment: number,
                first_frame: first,
                end_frame: first + length,
                outcome: outcome.to_owned(),
                position: [
                    random.about(off, 0.006),
                    random.about(0.0, 0.01),
                    random.about(0.012 + off, 0.004),
                ],
            });
        }
    }

    fn finish(self) -> Audit {
        let checks = KINDS.map(|(code, severity, words, threshold, unit)| {
            let mut demos: Vec<u32> = self
                .findings
                .iter()
                .filter(|f| f.code == code)
                .map(|f| f.episode)
                .collect();
            let findings = demos.len() as u32;
            demos.dedup();
            CheckRow {
                code: code.into(),
                severity,
                meaning: format!("In these frames, {words}. Check them."),
                measure: "a synthetic value".to_owned(),
                threshold: Some(threshold),
                unit: unit.into(),
                origin: "data".into(),
                derivation: "synthetic".to_owned(),
                findings,
                episodes: demos.len() as u32,
            }
        });
        let measure = |unit: &str, factor| Measure {
            unit: unit.to_owned(),
            factor,
        };
        let panel = |title: &str, unit: &str, series: Vec<(&str, Vec<f64>)>| Panel {
            title: title.to_owned(),
            measure: measure(unit, 1000.0),
            series: series
                .into_iter()
                .map(|(label, values)| Series {
                    label: label.to_owned(),
                    values,
                })
                .collect(),
        };
        let [eef_height, object_height] = self.height;
        let [eef_speed, object_speed] = self.speed;
        Audit {
            tool_version: "0.0.0".to_owned(),
            dataset: "synthetic/low_dim.hdf5".to_owned(),
            task: "PickPlaceCan".to_owned(),
            command: "re4-pipe audit synthetic.toml".to_owned(),
            artifacts: ["audit", "modes", "episodes"]
                .map(|kind| (kind.to_owned(), "0123456789abcdef".repeat(4)))
                .to_vec(),
            frame_seconds: 0.05,
            length: measure("mm", 1000.0),
            demos: self.demos,
            checks: checks.to_vec(),
            findings: self.findings,
            segments: self.segments,
            grasps: self.grasps,
            object: true,
            outline: None,
            contacts: None,
            conventions: vec![Convention {
                convention: "quaternion_order".into(),
                value: "xyzw".into(),
                basis: "proven".into(),
                evidence: "The recorded relative pose equals the one that was computed.".into(),
                residual: Some(3.1e-8),
                runner_up: Some(0.41),
                threshold: Some(1e-5),
                unit: "m".into(),
                frames: 30_000,
            }],
            flags: vec![
                Flag {
                    label: "gripper closes".to_owned(),
                    values: self.closes,
                },
                Flag {
                    label: "evidence holds".to_owned(),
                    values: self.holds,
                },
            ],
            scores: Vec::new(),
            shots: Vec::new(),
            panels: vec![
                panel("Finger separation", "mm", vec![("", self.fingers)]),
                panel(
                    "Height",
                    "mm",
                    vec![("end effector", eef_height), ("object", object_height)],
                ),
                panel(
                    "Speed",
                    "mm/frame",
                    vec![("end effector", eef_speed), ("object", object_speed)],
                ),
                panel("Relative translation", "mm/frame", vec![("", self.relative)]),
                panel("Grip to object", "mm", vec![("", self.distance)]),
            ],
        }
    }
}
