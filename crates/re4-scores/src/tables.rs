//! The table `scores`.

use re4_artifact::{columns, table};

columns! {
    /// The scores of a demonstration. A score is null if it is not defined, as without motion.
    #[derive(Copy)]
    pub struct Scores {
        /// Duration. Lower is better.
        #[unit = "s"]
        pub duration: Option<f64>,
        /// Path efficiency: the distances between the ends of the mode segments, summed, divided by the length of the end effector's
        /// path. Higher is better; 1 is straight.
        pub path_efficiency: Option<f64>,
        /// Log dimensionless jerk of the end effector (Balasubramanian, Melendez-Calderon and Burdet 2012). Higher is smoother.
        pub log_dimensionless_jerk: Option<f64>,
        /// Spectral arc length of the end effector's speed (SPARC; Balasubramanian et al. 2012 and 2015). Higher is smoother.
        pub spectral_arc_length: Option<f64>,
        /// Trajectory-envelope distance: area between the path and the best cubic curve of each mode segment, divided by the distances
        /// between the ends of the segments (after RINSE; Sojib and Begum 2026), in m, in px for Push-T. Lower is smoother.
        pub envelope_distance: Option<f64>,
        /// Idle share: fraction of the steps in which neither the end effector nor the fingers move at more than 5 % of their peak
        /// speed. Lower is better.
        pub idle_share: Option<f64>,
        /// Number of transfer segments after the first one. Lower is better. Null for Push-T.
        pub regrasps: Option<f64>,
        /// Contribution to the mutual information of states and actions, in nats (DemInf; Hejna et al. 2025). Higher is better.
        pub information: Option<f64>,
        /// Distance to the nearest other demonstration: root mean square distance of end effector and object at equal lengths along
        /// the path, in m, in px for Push-T. Higher is more novel, which is neither good nor bad.
        pub novelty: Option<f64>,
    }
}

columns! {
    /// The ranks of a demonstration's scores. Rank 1 is the best; equal scores share the mean of their ranks.
    #[derive(Copy)]
    pub struct Ranks {
        /// Rank by duration.
        pub duration: Option<f64>,
        /// Rank by path efficiency.
        pub path_efficiency: Option<f64>,
        /// Rank by log dimensionless jerk.
        pub log_dimensionless_jerk: Option<f64>,
        /// Rank by spectral arc length.
        pub spectral_arc_length: Option<f64>,
        /// Rank by trajectory-envelope distance.
        pub envelope_distance: Option<f64>,
        /// Rank by idle share.
        pub idle_share: Option<f64>,
        /// Rank by regrasps.
        pub regrasps: Option<f64>,
        /// Rank by information.
        pub information: Option<f64>,
        /// Rank by novelty; rank 1 is the most novel.
        pub novelty: Option<f64>,
    }
}

table! {
    /// One row per demonstration that could be read: its quality scores, each with its rank. Sorted by episode.
    /// docs/concepts/scores.md has the formulas.
    #[table("scores", version = 1)]
    #[derive(Copy)]
    pub struct ScoreRow {
        /// Number of the demonstration in this artifact, from 0.
        pub episode: u32,
        /// Mean, over all scores but novelty, of the fraction of the other demonstrations that rank lower. 1 is best in everything.
        pub quality: Option<f64>,
        /// The scores.
        #[prefix = ""]
        pub scores: Scores,
        /// The ranks.
        pub rank: Ranks,
        /// Number of the nearest other demonstration.
        pub nearest: Option<u32>,
    }
}

table! {
    /// One row per demonstration with a gripper: its own scores, and what the score information compares. Sorted by episode.
    #[table("sketches", version = 1)]
    pub struct SketchRow {
        /// Number of the demonstration, from 0.
        pub episode: u32,
        /// The scores that depend on the demonstration alone; information and novelty are null.
        #[prefix = ""]
        pub scores: Scores,
        /// Up to 64 chunks of 14 numbers, chunk after chunk: position of the end effector in m, of the object relative to it in m, distance of
        /// the fingers in m, then the sum of the actions of 0.4 s. World frame.
        pub chunks: Vec<f32>,
    }
}

table! {
    /// One row per demonstration: its path, which the score novelty compares. Sorted by episode.
    #[table("paths", version = 1)]
    pub struct PathRow {
        /// Number of the demonstration, from 0.
        pub episode: u32,
        /// 16 positions of end effector and object in m, world frame, at equal lengths along the path of both: x, y, z of the end effector, then
        /// of the object, position after position.
        pub knots: Vec<f32>,
    }
}

table! {
    /// One row per chunk that the chunks of all demonstrations are compared with for the score information, evenly spaced over all.
    #[table("reference", version = 1)]
    pub struct ReferenceRow {
        /// Number of the demonstration, from 0.
        pub episode: u32,
        /// The chunk: 14 numbers as in table sketches.
        pub chunk: Vec<f32>,
    }
}

/// Which values of a score are better.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Better {
    /// Higher values.
    Higher,
    /// Lower values.
    Lower,
    /// The score does not measure quality; it is ranked from high to low.
    Neither,
}

/// A score.
#[derive(Debug, Clone, Copy)]
pub struct Kind {
    /// Its column.
    pub column: &'static str,
    /// Its name on pages.
    pub title: &'static str,
    /// Which values are better.
    pub better: Better,
    /// Its value.
    pub value: fn(&Scores) -> Option<f64>,
    /// Its rank.
    pub rank: fn(&Ranks) -> Option<f64>,
    /// Where the rank is stored.
    pub(crate) place: fn(&mut Ranks) -> &mut Option<f64>,
}

macro_rules! kind {
    ($field:ident, $title:literal, $better:ident) => {
        Kind {
            column: stringify!($field),
            title: $title,
            better: Better::$better,
            value: |scores| scores.$field,
            rank: |ranks| ranks.$field,
            place: |ranks| &mut ranks.$field,
        }
    };
}

/// All scores, in the order of their columns.
pub const KINDS: [Kind; 9] = [
    kind!(duration, "duration", Lower),
    kind!(path_efficiency, "path efficiency", Higher),
    kind!(log_dimensionless_jerk, "log dimensionless jerk", Higher),
    kind!(spectral_arc_length, "spectral arc length", Higher),
    kind!(envelope_distance, "envelope distance", Lower),
    kind!(idle_share, "idle share", Lower),
    kind!(regrasps, "regrasps", Lower),
    kind!(information, "information", Higher),
    kind!(novelty, "novelty", Neither),
];
