//! What a dataset is, in words.

use std::fmt;

use crate::dataset::Dataset;
use crate::fault::LerobotError;
use crate::info::{Content, Version};
use crate::video::{Codec, Color};

/// A camera of a dataset.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CameraSummary {
    /// Name of the feature.
    pub name: String,
    /// Pixels of a row, from the first image.
    pub width: usize,
    /// Rows of pixels, from the first image.
    pub height: usize,
    /// How its images are stored.
    pub stored: String,
}

/// How the images of a camera are stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Coding {
    /// PNG images, without loss.
    Png,
    /// Videos, with loss.
    Video {
        /// The codec.
        codec: Codec,
        /// How decoded frames are converted to RGB.
        color: Color,
    },
}

impl Coding {
    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Png => "PNG",
            Self::Video { codec, .. } => codec.name(),
        }
    }

    /// Whether images differ from those that were recorded.
    pub fn is_lossy(self) -> bool {
        self != Self::Png
    }
}

/// What a dataset is.
#[derive(Debug, Clone, PartialEq)]
pub struct Summary {
    /// The format and its version.
    pub format: String,
    /// Type of the robot, if stated.
    pub robot: Option<String>,
    /// Frames per second.
    pub fps: f64,
    /// Number of episodes.
    pub episodes: usize,
    /// Number of frames of all episodes.
    pub frames: usize,
    /// Frames of the shortest and of the longest episode.
    pub lengths: (usize, usize),
    /// The tasks in words.
    pub tasks: Vec<String>,
    /// Features with numbers or text: name, type, shape and names of the elements.
    pub features: Vec<String>,
    /// The cameras.
    pub cameras: Vec<CameraSummary>,
    /// Statements that are wrong but not used.
    pub notes: Vec<String>,
}

impl Dataset {
    /// Describes the dataset. Decodes the first image of each camera.
    ///
    /// # Errors
    /// An image cannot be decoded.
    pub fn summary(&self) -> Result<Summary, LerobotError> {
        let info = self.info();
        let lengths = || self.episodes().iter().map(|episode| episode.length);
        let numbers = info
            .features
            .iter()
            .filter(|feature| matches!(feature.content, Content::Numbers | Content::Text));
        let feature = |feature: &crate::info::Feature| {
            let names = match feature.names.as_slice() {
                [] => String::new(),
                names => format!(" ({})", names.join(", ")),
            };
            format!("{}: {} {:?}{names}", feature.name, feature.dtype, feature.shape)
        };
        let format = match info.version {
            Version::V2 => "LeRobot v2",
            Version::V3 => "LeRobot v3",
        };
        Ok(Summary {
            format: format!(
                "{format} ({})",
                if info.stated_version.is_empty() {
                    "no version stated"
                } else {
                    &info.stated_version
                }
            ),
            robot: info.robot_type.clone(),
            fps: info.fps,
            episodes: self.episodes().len(),
            frames: self.frames(),
            lengths: (lengths().min().unwrap_or(0), lengths().max().unwrap_or(0)),
            tasks: self.tasks().values().cloned().collect(),
            features: numbers.map(feature).collect(),
            cameras: self
                .cameras()
                .iter()
                .map(|camera| self.camera(camera))
                .collect::<Result<_, _>>()?,
            notes: self.notes().to_vec(),
        })
    }

    /// How the images of a camera are stored in an episode. Decodes the first frame of a video.
    ///
    /// # Errors
    /// There is no such image, or it cannot be decoded.
    pub fn coding(&self, camera: &str, episode: usize) -> Result<Coding, LerobotError> {
        match self.info().feature(camera).map(|feature| feature.content) {
            Some(Content::Video) => {
                let (video, first) = self.video(camera, episode)?;
                let planes = video.frame(first).map_err(|fault| self.error(fault))?;
                Ok(Coding::Video {
                    codec: video.codec(),
                    color: planes.color,
                })
            }
            _ => Ok(Coding::Png),
        }
    }

    fn camera(&self, name: &str) -> Result<CameraSummary, LerobotError> {
        let image = if self.episodes().is_empty() {
            None
        } else {
            Some(self.image(name, 0, 0)?)
        };
        let stored = match self.info().feature(name).map(|feature| feature.content) {
            Some(Content::Video) if image.is_some() => {
                let (video, _) = self.video(name, 0)?;
                let codec = video.codec().name();
                format!(
                    "{codec} video, {} of {} frames of the first file are key frames",
                    video.key_frames(),
                    video.frames()
                )
            }
            Some(Content::Video) => "video".to_owned(),
            _ => "PNG images".to_owned(),
        };
        Ok(CameraSummary {
            name: name.to_owned(),
            width: image.as_ref().map_or(0, |image| image.width),
            height: image.as_ref().map_or(0, |image| image.height),
            stored,
        })
    }
}

impl fmt::Display for Summary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "format    {}", self.format)?;
        if let Some(robot) = &self.robot {
            writeln!(f, "robot     {robot}")?;
        }
        writeln!(f, "rate      {} frames per second", self.fps)?;
        let (shortest, longest) = self.lengths;
        writeln!(
            f,
            "episodes  {} with {} frames, {shortest} to {longest} each",
            self.episodes, self.frames
        )?;
        for task in &self.tasks {
            writeln!(f, "task      {task}")?;
        }
        for feature in &self.features {
            writeln!(f, "feature   {feature}")?;
        }
        for camera in &self.cameras {
            writeln!(
                f,
                "camera    {}: {} x {} pixels, {}",
                camera.name, camera.width, camera.height, camera.stored
            )?;
        }
        for note in &self.notes {
            writeln!(f, "note      {note}")?;
        }
        Ok(())
    }
}
