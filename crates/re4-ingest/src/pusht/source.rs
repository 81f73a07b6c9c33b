//! A Push-T dataset as a source of demonstrations.

use std::ops::Range;
use std::path::Path;

use re4_geometry::Point2;
use serde_json::{Map, json};

use super::reader::{PushtOptions, PushtReader, PushtReading};
use crate::demos::{DemoName, DemoSource, Episode, Frames, ImageBlock, Info, Tally};
use crate::error::IngestError;
use crate::name::SourceName;
use crate::selection::Selection;
use crate::tables::{LeftOut, PlanarColumns};
use crate::warning::Warning;

/// Name of the camera of `data/img`.
const CAMERA: &str = "img";

/// An opened dataset with its numbers read and checked. All numbers are in memory, because the checks of conventions need the
/// whole dataset; images are streamed.
pub struct PushtSource {
    reader: PushtReader,
    reading: PushtReading,
    info: Info,
    demos: Vec<DemoName>,
}

impl PushtSource {
    /// The requested demonstrations, in order.
    pub fn demos(&self) -> &[DemoName] {
        &self.demos
    }

    /// Reads the numbers of the selected episodes.
    ///
    /// # Errors
    /// Same as [`PushtReader::read`].
    pub fn read(reader: PushtReader, select: &Selection, options: &PushtOptions<'_>) -> Result<Self, IngestError> {
        let reading = reader.read(select, options)?;
        let name = |name: SourceName| DemoName {
            number: name.number().and_then(|number| u32::try_from(number).ok()),
            name: name.to_string(),
            filter_keys: Vec::new(),
        };
        let kept = reading
            .episodes
            .sources
            .iter()
            .map(|&number| SourceName::episode(number));
        let left = reading.left_out.iter().map(|left| SourceName::new(&left.demo));
        let mut names: Vec<SourceName> = kept.chain(left).collect();
        names.sort_unstable();
        let mut details = Map::new();
        if options.conventions != super::PushtConventions::default() {
            let explained = reading.explained.map(|fraction| (1000.0 * fraction).round() / 1000.0);
            let settings = json!({ "settings": options.conventions, "motion_explained_by_targets": explained });
            details.insert("conventions".to_owned(), settings);
        }
        let info = Info {
            details,
            cameras: reader
                .image_shape()
                .filter(|_| options.images)
                .map(|_| CAMERA.to_owned())
                .into_iter()
                .collect(),
            ..reader.info()
        };
        Ok(Self {
            demos: names.into_iter().map(name).collect(),
            info,
            reading,
            reader,
        })
    }
}

impl PushtReading {
    /// Passes the demonstrations to `take`, in order: those that were read, and those that were left out.
    ///
    /// # Errors
    /// An error that `take` returns.
    pub(crate) fn each<E>(
        &self,
        demos: &[DemoName],
        range: Range<usize>,
        mut take: impl FnMut(usize, Result<Episode, LeftOut>) -> Result<(), E>,
    ) -> Result<(), E> {
        let mut left = self.left_out.iter().peekable();
        let mut number = 0;
        for (place, name) in demos.iter().enumerate() {
            let own = range.contains(&place);
            if let Some(left) = left.next_if(|left| left.demo == name.name) {
                if own {
                    take(place, Err(left.clone()))?;
                }
            } else {
                if own {
                    take(place, Ok(self.episode(name, number)))?;
                }
                number += 1;
            }
        }
        Ok(())
    }

    fn episode(&self, name: &DemoName, number: usize) -> Episode {
        let episodes = &self.episodes;
        let frame = |i: usize| PlanarColumns {
            eef: episodes.agent(i),
            object: episodes.recorded.block.then(|| episodes.block(i)),
            action: Point2::new(episodes.action[i][0], episodes.action[i][1]),
            contacts: episodes.contacts.as_ref().map(|contacts| contacts[i]),
            keypoints: (episodes.keypoint.as_ref()).map(|points| points[i].map(|[x, y]| Point2::new(x, y))),
        };
        Episode {
            name: name.clone(),
            frames: Frames::Planar(episodes.frames[number].clone().map(frame).collect()),
            states: None,
            model: None,
            goal_errors: None,
            contradiction: None,
            single_precision: Vec::new(),
            skipped: Vec::new(),
        }
    }
}

impl DemoSource for PushtSource {
    /// Accepts a folder or a zip file.
    fn probe(path: &Path) -> bool {
        let zip = || path.extension().is_some_and(|end| end.eq_ignore_ascii_case("zip"));
        path.is_dir() || zip()
    }

    fn info(&self) -> &Info {
        &self.info
    }

    fn count(&self) -> usize {
        self.demos().len()
    }

    /// The arrays are those of the whole dataset.
    fn can_be_read_in_parts(&self) -> bool {
        false
    }

    fn episodes<E: From<IngestError> + Send>(
        &self,
        range: Range<usize>,
        take: impl FnMut(usize, Result<Episode, LeftOut>) -> Result<(), E>,
    ) -> Result<(), E> {
        self.reading.each(&self.demos, range, take)
    }

    fn images<E: From<IngestError>>(
        &self,
        _camera: &str,
        _of: &[(DemoName, usize)],
        mut take: impl FnMut(Result<ImageBlock, LeftOut>) -> Result<(), E>,
    ) -> Result<(), E> {
        let [height, width, _] = self.reader.image_shape().unwrap_or_default();
        let rows = &self.reading.episodes.rows;
        let mut episode = 0;
        for block in self.reader.image_blocks_of(&self.reading.episodes)? {
            let block = block?;
            let place = |row: usize| {
                while rows.get(episode).is_some_and(|rows| !rows.contains(&row)) {
                    episode += 1;
                }
                let first = rows.get(episode).map_or(0, |rows| rows.start);
                (episode as u32, (row - first) as u32)
            };
            take(Ok(ImageBlock {
                places: block.frames.map(place).collect(),
                height,
                width,
                bytes: block.bytes,
            }))?;
        }
        Ok(())
    }

    fn warnings(&self, tally: &Tally) -> Result<Vec<Warning>, IngestError> {
        let left_out = tally.left_out_warning(self.demos.len());
        Ok(self.reading.warnings.iter().cloned().chain(left_out).collect())
    }

    fn unchanged(&self) -> Result<(), IngestError> {
        self.reader.unchanged()
    }
}
