//! The images of a camera, from PNG in the tables of data or from videos.

use std::io::Cursor;

use arrow_array::cast::AsArray as _;
use arrow_array::{Array, ArrayRef};
use arrow_schema::DataType;
use image::{ColorType, DynamicImage, ImageFormat, ImageReader, Limits};

use crate::column::Place;
use crate::contained::contained;
use crate::dataset::{Dataset, Episode};
use crate::fault::{Fault, Faults, Kind, LerobotError};
use crate::info::Content;
use crate::table::{self, Table};
use crate::video::{Stop, Video};

/// Maximum size of a block of images, in bytes. A block has at least one image.
const BLOCK: usize = 8 << 20;

/// Rows of encoded images that are in memory at once.
const ROWS: usize = 16;

/// Maximum memory for the decoding of an image, in bytes. A damaged header can claim any size.
const IMAGE_LIMIT: u64 = 256 << 20;

/// Consecutive images of an episode.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ImageBlock {
    /// Number of the episode.
    pub episode: usize,
    /// Frame of the first image.
    pub first: usize,
    /// Number of images.
    pub count: usize,
    /// Pixels of a row.
    pub width: usize,
    /// Rows of pixels.
    pub height: usize,
    /// RGB bytes, pixel by pixel, top row first, image by image.
    pub bytes: Vec<u8>,
}

/// Whether a column can hold images: binary values, or a struct with a field `bytes` of them.
pub(crate) fn is_image(data_type: &DataType) -> bool {
    match data_type {
        DataType::Binary | DataType::LargeBinary => true,
        DataType::Struct(fields) => fields.iter().any(|field| {
            field.name() == "bytes" && matches!(field.data_type(), DataType::Binary | DataType::LargeBinary)
        }),
        _ => false,
    }
}

/// The encoded image of each row.
fn encoded(array: &ArrayRef) -> Vec<Option<&[u8]>> {
    let all = array;
    let bytes = match array.data_type() {
        DataType::Struct(_) => array.as_struct().column_by_name("bytes"),
        _ => Some(array),
    };
    let Some(bytes) = bytes else {
        return vec![None; array.len()];
    };
    let there = |row: usize| !all.is_null(row) && !bytes.is_null(row);
    let value = |row: usize| match bytes.data_type() {
        DataType::Binary => Some(bytes.as_binary::<i32>().value(row)),
        DataType::LargeBinary => Some(bytes.as_binary::<i64>().value(row)),
        _ => None,
    };
    (0..array.len())
        .map(|row| there(row).then(|| value(row)).flatten())
        .collect()
}

/// Width, height and RGB bytes of a PNG image.
pub(crate) fn decode(png: &[u8]) -> Result<(usize, usize, Vec<u8>), (Kind, String)> {
    let jpeg = png.starts_with(&[0xff, 0xd8]);
    if !png.starts_with(b"\x89PNG") {
        let what = if jpeg {
            "the image is JPEG, not PNG"
        } else {
            "it is not a PNG image"
        };
        return Err((if jpeg { Kind::Unsupported } else { Kind::Damaged }, what.to_owned()));
    }
    let decoded = contained(|| {
        let mut reader = ImageReader::with_format(Cursor::new(png), ImageFormat::Png);
        let mut limits = Limits::default();
        limits.max_alloc = Some(IMAGE_LIMIT);
        reader.limits(limits);
        reader.decode().map_err(|error| error.to_string())
    });
    let image = decoded.map_err(|why| (Kind::Damaged, format!("the PNG image is damaged ({why})")))?;
    let (width, height) = (image.width() as usize, image.height() as usize);
    match image {
        DynamicImage::ImageRgb8(image) => Ok((width, height, image.into_raw())),
        DynamicImage::ImageLuma8(image) => Ok((
            width,
            height,
            image.into_raw().into_iter().flat_map(|gray| [gray; 3]).collect(),
        )),
        other => {
            let kind = match other.color() {
                ColorType::Rgba8 | ColorType::La8 => "a PNG image with transparency",
                _ => "a PNG image with more than 8 bits per channel",
            };
            Err((Kind::Unsupported, format!("it is {kind}")))
        }
    }
}

/// Collects images into blocks.
struct Blocks<'a, F> {
    episode: &'a Episode,
    block: Option<ImageBlock>,
    next: usize,
    take: &'a mut F,
}

impl<E, F: FnMut(Result<ImageBlock, (usize, Faults)>) -> Result<(), E>> Blocks<'_, F> {
    fn add(&mut self, width: usize, height: usize, append: impl FnOnce(&mut Vec<u8>)) -> Result<(), E> {
        let block = self.block.get_or_insert_with(|| ImageBlock {
            episode: self.episode.index,
            first: self.next,
            count: 0,
            width,
            height,
            bytes: Vec::new(),
        });
        append(&mut block.bytes);
        block.count += 1;
        self.next += 1;
        let one = block.bytes.len() / block.count;
        if block.bytes.len() + one > BLOCK {
            self.flush()
        } else {
            Ok(())
        }
    }

    fn flush(&mut self) -> Result<(), E> {
        self.block.take().map_or(Ok(()), |block| (self.take)(Ok(block)))
    }
}

/// The video that stays open between the episodes of a camera, with the number of its file.
type Opened = Option<(u32, Video)>;

/// What stays open between the episodes of a camera with PNG images.
#[derive(Default)]
struct Pngs {
    /// Width and height of the first image.
    size: Option<(usize, usize)>,
    /// The file, and its rows from the next one on.
    rows: Option<(u32, table::Blocks)>,
}

/// A fault of an episode, or an error that ends the reading.
enum Halt<E> {
    Episode(Faults),
    All(E),
}

impl<E> From<Fault> for Halt<E> {
    fn from(fault: Fault) -> Self {
        Self::Episode(fault.into())
    }
}

impl Dataset {
    /// Reads the images of a camera and passes them to `take` block by block, episode by episode in the given order. An episode
    /// whose images cannot be decoded is passed on with its faults, after its blocks before the first fault.
    ///
    /// # Errors
    /// There is no such camera, an error that `take` returns, or a stop.
    pub fn images<E: From<LerobotError>>(
        &self,
        camera: &str,
        episodes: impl IntoIterator<Item = usize>,
        stop: Stop<'_>,
        mut take: impl FnMut(Result<ImageBlock, (usize, Faults)>) -> Result<(), E>,
    ) -> Result<(), E> {
        let content = self.info.feature(camera).map(|feature| feature.content);
        let mut pngs = Pngs::default();
        let mut opened: Opened = None;
        for number in episodes {
            let Some(episode) = self.episodes.get(number) else {
                let what = format!(
                    "episode {number} is requested, but there are {} episodes",
                    self.episodes.len()
                );
                return Err(self
                    .error(Fault::of_file(Kind::Missing, "", what, "request a smaller number"))
                    .into());
            };
            let all = 0..episode.length;
            let mut blocks = Blocks {
                episode,
                block: None,
                next: 0,
                take: &mut take,
            };
            let read = match content {
                Some(Content::Video) if self.videos.contains_key(camera) => {
                    self.video_images(camera, episode, all, &mut opened, stop, &mut blocks)
                }
                Some(Content::Images) => self.table_images(camera, episode, all, &mut pngs, stop, &mut blocks),
                _ => {
                    let what = format!("there is no camera {camera}");
                    return Err(self
                        .error(Fault::of_file(Kind::Missing, "", what, "choose one of the cameras"))
                        .into());
                }
            };
            match read {
                Ok(()) => {}
                Err(Halt::All(error)) => return Err(error),
                Err(Halt::Episode(faults)) if faults.stopped() => return Err(self.error(faults).into()),
                Err(Halt::Episode(faults)) => take(Err((episode.index, faults)))?,
            }
        }
        Ok(())
    }

    /// Reads one image of a camera.
    ///
    /// # Errors
    /// There is no such image, or it cannot be decoded.
    pub fn image(&self, camera: &str, episode: usize, frame: usize) -> Result<ImageBlock, LerobotError> {
        let none = || {
            let what = format!("there is no image of {camera} for frame {frame} of episode {episode}");
            self.error(Fault::of_file(Kind::Missing, "", what, "request an image that exists"))
        };
        let place = self
            .episodes
            .get(episode)
            .filter(|episode| frame < episode.length)
            .ok_or_else(none)?;
        let mut found = None;
        let mut take = |block: Result<ImageBlock, (usize, Faults)>| {
            found = block.ok();
            Ok::<(), LerobotError>(())
        };
        let mut blocks = Blocks {
            episode: place,
            block: None,
            next: frame,
            take: &mut take,
        };
        let one = frame..frame + 1;
        let read = match self.info.feature(camera).map(|feature| feature.content) {
            Some(Content::Video) if self.videos.contains_key(camera) => {
                self.video_images(camera, place, one, &mut None, &|| false, &mut blocks)
            }
            Some(Content::Images) => {
                self.table_images(camera, place, one, &mut Pngs::default(), &|| false, &mut blocks)
            }
            _ => return Err(none()),
        };
        match read {
            Ok(()) => found.ok_or_else(none),
            Err(Halt::All(error)) => Err(error),
            Err(Halt::Episode(faults)) => Err(self.error(faults)),
        }
    }

    fn video_images<E: From<LerobotError>, F: FnMut(Result<ImageBlock, (usize, Faults)>) -> Result<(), E>>(
        &self,
        camera: &str,
        episode: &Episode,
        frames: std::ops::Range<usize>,
        opened: &mut Opened,
        stop: Stop<'_>,
        blocks: &mut Blocks<'_, F>,
    ) -> Result<(), Halt<E>> {
        let place = episode.videos.get(camera).copied();
        let (video, first) = match (opened.take(), place) {
            (Some((file, video)), Some((same, first))) if file == same => (video, first),
            _ => self
                .video(camera, episode.index)
                .map_err(|error| Halt::Episode(error.faults))?,
        };
        // After an error, the video is not put back, so that it is opened again.
        video.decode(first + frames.start..first + frames.end, stop, |_, planes| {
            blocks
                .add(planes.width, planes.height, |bytes| planes.append_rgb(bytes))
                .map_err(Halt::All)
        })?;
        *opened = place.map(|(file, _)| (file, video));
        blocks.flush().map_err(Halt::All)
    }

    fn table_images<E, F: FnMut(Result<ImageBlock, (usize, Faults)>) -> Result<(), E>>(
        &self,
        camera: &str,
        episode: &Episode,
        frames: std::ops::Range<usize>,
        pngs: &mut Pngs,
        stop: Stop<'_>,
        blocks: &mut Blocks<'_, F>,
    ) -> Result<(), Halt<E>> {
        let (file, row) = episode.data;
        let name = self.data.names.get(file as usize).map_or("", String::as_str);
        let rows = row + frames.start..row + frames.end;
        // After an error, the rows are not put back: their reader may be in an inconsistent state.
        let mut read = match pngs.rows.take() {
            Some((open, read)) if open == file && read.next() == rows.start => read,
            _ => Table::open(&self.root, name)?.blocks(&[camera], rows.start, ROWS)?,
        };
        while read.next() < rows.end {
            if stop() {
                return Err(Fault::stopped().into());
            }
            let place = Place {
                file: name,
                column: camera,
                first: read.next(),
            };
            let block = read.take(rows.end - read.next())?;
            let Some(array) = block.column_by_name(camera) else {
                return Err(Fault::column(Kind::Missing, name, camera, "it is missing", "restore the column").into());
            };
            for (at, png) in encoded(array).into_iter().enumerate() {
                let Some(png) = png else {
                    let fix = "write the images into the column, or remove the episode";
                    return Err(place.fault(Kind::Value, at, "the image is missing (null)", fix).into());
                };
                let (width, height, bytes) = decode(png).map_err(|(kind, what)| {
                    place.fault(kind, at, what, "write the image again as PNG with 8 bits per channel")
                })?;
                let (w, h) = *pngs.size.get_or_insert((width, height));
                if (width, height) != (w, h) {
                    let what = format!("the image has {width} x {height} pixels, the first one has {w} x {h}");
                    return Err(place
                        .fault(Kind::Value, at, what, "write all images of a camera with one size")
                        .into());
                }
                blocks
                    .add(width, height, |all| all.extend_from_slice(&bytes))
                    .map_err(Halt::All)?;
            }
        }
        pngs.rows = Some((file, read));
        blocks.flush().map_err(Halt::All)
    }
}
