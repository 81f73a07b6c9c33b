//! Images on disk, and batches of them made ahead.
//!
//! A training draws images in no order. So they are unpacked once, one after the other, into a file beside the artifact in
//! the making, and read from there one by one: memory does not grow with the dataset.

use std::fs::File;
use std::io::{BufWriter, Write as _};
use std::os::unix::fs::FileExt as _;
use std::path::Path;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::Scope;

use crate::batches::{Batch, Sample, Sampler};
use crate::{CROP, EncoderError, PICTURE_BYTES, SIDE};

/// Means and standard deviations of ImageNet's colours, red, green, blue, which ResNet's weights are for.
const MEAN: [f32; 3] = [0.485, 0.456, 0.406];
const DEVIATION: [f32; 3] = [0.229, 0.224, 0.225];

/// Batches that wait for the optimiser.
const AHEAD: usize = 3;

/// Unpacked images.
#[derive(Debug)]
pub struct ImageFile {
    file: File,
    count: u64,
}

impl ImageFile {
    /// Writes images of [`PICTURE_BYTES`] bytes one after the other; the file goes when it is dropped.
    ///
    /// # Errors
    /// When the disk is full, or an image has another size, or could not be had in the first place.
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
            if image.len() != PICTURE_BYTES {
                return Err(EncoderError::Image(image.len()).into());
            }
            out.write_all(&image).map_err(failed)?;
            count += 1;
        }
        out.flush().map_err(failed)?;
        drop(out);
        Ok(Self { file, count })
    }

    /// How many there are.
    pub fn count(&self) -> u64 {
        self.count
    }

    /// The image of this number.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub fn read(&self, number: u64, into: &mut [u8]) -> Result<(), EncoderError> {
        self.file
            .read_exact_at(into, number * PICTURE_BYTES as u64)
            .map_err(EncoderError::ScratchRead)
    }
}

/// Puts the crop of an image into a batch's numbers: channels first, normalised.
pub fn place(image: &[u8], crop: [u8; 2], into: &mut [f32]) {
    let [top, left] = crop.map(usize::from);
    for (channel, plane) in into.chunks_exact_mut(CROP * CROP).enumerate().take(3) {
        let (scale, shift) = (1.0 / (255.0 * DEVIATION[channel]), MEAN[channel] / DEVIATION[channel]);
        for (row, line) in plane.chunks_exact_mut(CROP).enumerate() {
            let start = ((top + row) * SIDE + left) * 3 + channel;
            for (out, pixel) in line.iter_mut().zip(image[start..].iter().step_by(3)) {
                *out = f32::from(*pixel) * scale - shift;
            }
        }
    }
}

/// First row and column of the crop in the middle.
pub const MIDDLE: [u8; 2] = [((SIDE - CROP) / 2) as u8; 2];

/// Numbers of an image in a batch.
pub const INPUTS: usize = 3 * CROP * CROP;

/// A batch with its images.
pub struct Loaded {
    /// Which they are.
    pub batch: Batch,
    /// `[samples, 3, 76, 76]`.
    pub inputs: Vec<f32>,
}

/// The images of samples.
pub(crate) fn load(images: &ImageFile, samples: &[Sample]) -> Result<Vec<f32>, EncoderError> {
    let mut inputs = vec![0.0; samples.len() * INPUTS];
    let mut image = vec![0; PICTURE_BYTES];
    for (sample, into) in samples.iter().zip(inputs.chunks_exact_mut(INPUTS)) {
        images.read(sample.image, &mut image)?;
        place(&image, sample.crop, into);
    }
    Ok(inputs)
}

/// The batches of an epoch in their order, made ahead by a thread that ends when nobody listens any more.
pub(crate) fn batches<'scope, 'env>(
    scope: &'scope Scope<'scope, 'env>,
    images: &'env ImageFile,
    sampler: &'env Sampler,
    epoch: u32,
    steps: u32,
) -> Receiver<Result<Loaded, EncoderError>> {
    let (sender, receiver) = sync_channel(AHEAD);
    scope.spawn(move || {
        for step in 0..steps {
            if !send(&sender, images, sampler.batch(epoch, step)) {
                return;
            }
        }
    });
    receiver
}

fn send(sender: &SyncSender<Result<Loaded, EncoderError>>, images: &ImageFile, batch: Batch) -> bool {
    let loaded = load(images, &batch.samples).map(|inputs| Loaded { batch, inputs });
    let good = loaded.is_ok();
    sender.send(loaded).is_ok() && good
}
