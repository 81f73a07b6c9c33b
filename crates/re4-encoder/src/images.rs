//! Images on disk.
//!
//! Training reads images in random order. They are therefore unpacked once, sequentially, to a file next to the artifact that is
//! being built, and read from there one by one, so that memory does not grow with the dataset.

use std::fs::File;
use std::io::{BufWriter, Write as _};
use std::os::unix::fs::FileExt as _;
use std::path::Path;

use crate::batches::{Batch, Sample};
use crate::conv::Layout;
use crate::{CROP, EncoderError, IMAGE_BYTES, SIDE};

/// Means and standard deviations of ImageNet's channels (red, green, blue), for which ResNet's weights are trained.
const MEAN: [f32; 3] = [0.485, 0.456, 0.406];
const DEVIATION: [f32; 3] = [0.229, 0.224, 0.225];

/// A file of unpacked images.
#[derive(Debug)]
pub struct ImageFile {
    file: File,
    count: u64,
}

impl ImageFile {
    /// Writes images of [`IMAGE_BYTES`] bytes to a temporary file, which is deleted when the value is dropped.
    ///
    /// # Errors
    /// If the disk is full, if an image has another size, or if the iterator returns an error.
    pub fn write<E: From<EncoderError>>(
        folder: &Path,
        images: impl Iterator<Item = Result<Vec<u8>, E>>,
    ) -> Result<Self, E> {
        let failed = |source| EncoderError::Scratch {
            folder: folder.to_path_buf(),
            source,
        };
        let file = tempfile::tempfile_in(folder).map_err(failed)?;
        let mut out = BufWriter::with_capacity(1 << 20, &file);
        let mut count = 0;
        for image in images {
            let image = image?;
            if image.len() != IMAGE_BYTES {
                return Err(EncoderError::Image(image.len()).into());
            }
            out.write_all(&image).map_err(failed)?;
            count += 1;
        }
        out.flush().map_err(failed)?;
        drop(out);
        Ok(Self { file, count })
    }

    /// Number of images.
    pub fn count(&self) -> u64 {
        self.count
    }

    /// Reads an image to `into`, which must have [`IMAGE_BYTES`] bytes.
    ///
    /// # Errors
    /// If the file cannot be read.
    pub fn read(&self, number: u64, into: &mut [u8]) -> Result<(), EncoderError> {
        self.file
            .read_exact_at(into, number * IMAGE_BYTES as u64)
            .map_err(EncoderError::ScratchRead)
    }
}

/// A part of an image, and its brightness.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Crop {
    /// First row and column.
    pub corner: [u8; 2],
    /// Factor of the values, and what is added to them as a fraction of the largest value.
    pub light: [f32; 2],
}

impl Crop {
    /// Factor and offset of a channel's bytes that give the network's input.
    fn affine(&self, channel: usize) -> [f32; 2] {
        let [factor, offset] = self.light;
        [
            factor / (255.0 * DEVIATION[channel]),
            (offset - MEAN[channel]) / DEVIATION[channel],
        ]
    }
}

/// Writes the crop of an image to the input of the network: channels first, normalised.
pub fn crop_and_normalise(image: &[u8], crop: Crop, into: &mut [f32]) {
    let [top, left] = crop.corner.map(usize::from);
    for (channel, plane) in into.chunks_exact_mut(CROP * CROP).enumerate().take(3) {
        let [scale, shift] = crop.affine(channel);
        for (row, line) in plane.chunks_exact_mut(CROP).enumerate() {
            let start = ((top + row) * SIDE + left) * 3 + channel;
            for (out, pixel) in line.iter_mut().zip(image[start..].iter().step_by(3)) {
                *out = f32::from(*pixel) * scale + shift;
            }
        }
    }
}

/// The same with the channels innermost, in a layout with padding.
pub(crate) fn crop_into(image: &[u8], crop: Crop, into: &mut [f32], layout: Layout) {
    let [top, left] = crop.corner.map(usize::from);
    let affine = [0, 1, 2].map(|channel| crop.affine(channel));
    for row in 0..CROP {
        let start = ((top + row) * SIDE + left) * 3;
        let line = into[layout.line(row)].chunks_exact_mut(3);
        for (out, pixel) in line.zip(image[start..].chunks_exact(3)) {
            for (channel, [scale, shift]) in affine.into_iter().enumerate() {
                out[channel] = f32::from(pixel[channel]) * scale + shift;
            }
        }
    }
}

/// First row and column of the centre crop.
pub const MIDDLE: [u8; 2] = [((SIDE - CROP) / 2) as u8; 2];

/// Numbers per image in the network's input.
pub const INPUTS: usize = 3 * CROP * CROP;

/// A batch with its images.
pub struct Loaded {
    /// The samples of the batch.
    pub(crate) batch: Batch,
    /// The images, of [`IMAGE_BYTES`] bytes each.
    pub(crate) images: Vec<u8>,
}

/// Reads the images of samples.
pub(crate) fn load(images: &ImageFile, samples: &[Sample]) -> Result<Vec<u8>, EncoderError> {
    let mut bytes = vec![0; samples.len() * IMAGE_BYTES];
    for (sample, into) in samples.iter().zip(bytes.chunks_exact_mut(IMAGE_BYTES)) {
        images.read(sample.image, into)?;
    }
    Ok(bytes)
}
