//! Weights files: those of torchvision's ResNet-18 as initial weights, and the encoder's own.
//!
//! Both use torchvision's names (`conv1.weight`, `layer2.0.downsample.1.running_var`), so Python can read the encoder's trunk
//! with `safetensors` and `torchvision.models.resnet.ResNet.load_state_dict(..., strict=False)`. The encoder's own layers are
//! `embedding` and `head`, in `PyTorch`'s layout `[out, in]`.

use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::{fs, io};

use burn::module::{Module, RunningState};
use burn::store::pytorch_reader::{DType, PytorchReader, Tensor as TorchTensor};
use burn::tensor::{Device, Tensor, TensorData};
use re4_fault::{Fault, fault};
use re4_train::tensors;
use safetensors::{Dtype, SafeTensorError, SafeTensors};

use crate::EncoderError;
use crate::config::Network;
use crate::keypoints::is_valid_width;
use crate::network::Encoder;
use crate::resnet::Slot;

/// Maximum size of a weights file, in bytes. A ResNet-18 with 64 channels has 45 MB; a larger file is refused before it is read.
const MAXIMUM_SIZE: u64 = 1 << 30;

/// Maximum number of channels after the first convolution; more would exceed [`MAXIMUM_SIZE`].
const MAXIMUM_WIDTH: usize = 256;

/// Name of the first tensor of a keypoint network.
const FIRST_OF_KEYPOINTS: &str = "keypoints.conv0.weight";

/// Prefixes of the tensor names in a file: none, or those that training programs add.
const PREFIXES: [&str; 4] = ["", "state_dict.", "module.", "state_dict.module."];

/// Loads torchvision's ResNet-18 as initial weights: a `.pth` file of `torch.save`, or `.safetensors` with the same names.
/// The running statistics are included. torchvision's last layer `fc` is ignored, and the encoder's own layers stay unchanged.
///
/// # Errors
/// If the file cannot be read, is not a weights file, or contains another network. The presence, shape, data type and
/// range of every tensor are checked before the encoder is changed.
pub fn load_torchvision(encoder: Encoder, path: &Path) -> Result<Encoder, EncoderError> {
    File::open(path, Origin::Torchvision)
        .and_then(|file| fill(encoder, &file, Origin::Torchvision))
        .map_err(|why| weights_error(path, why))
}

/// Reads an encoder that [`save`] wrote. The file determines the number of channels.
///
/// # Errors
/// If the file cannot be read, or is not an encoder's weights file.
pub fn load(path: &Path, device: &Device) -> Result<Encoder, EncoderError> {
    let origin = Origin::Own;
    let load = || {
        let file = File::open(path, origin)?;
        let (network, width) = file.network(origin)?;
        fill(Encoder::new(network, width, device), &file, origin)
    };
    load().map_err(|why| weights_error(path, why))
}

/// Serialises an encoder to safetensors, with the tensors sorted by name: equal weights give equal bytes.
///
/// # Errors
/// If the weights cannot be read from their device.
pub fn to_bytes(encoder: &Encoder) -> Result<Vec<u8>, EncoderError> {
    let pack = || -> Result<Vec<u8>, Fault> {
        let mut tensors = BTreeMap::new();
        for (name, slot) in encoder.clone().slots() {
            let (shape, values) =
                values_of(slot).map_err(|why| fault!("{name} cannot be read from its device ({why})"))?;
            tensors.insert(name, (shape, values));
        }
        tensors::to_bytes(&tensors)
    };
    pack().map_err(|why| weights_error(Path::new("of the trained encoder"), why))
}

/// Writes an encoder to a file, in the format of [`to_bytes`]. The write is not atomic; if others may read the file at the same
/// time, write a sibling file and rename it.
///
/// # Errors
/// If the file cannot be written.
pub fn save(encoder: &Encoder, path: &Path) -> Result<(), EncoderError> {
    fs::write(path, to_bytes(encoder)?).map_err(|error| {
        let why = match error.kind() {
            io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => {
                fault!("the file cannot be written ({error})"; "free some space")
            }
            _ => fault!("the file cannot be written ({error})"; "choose a writable folder"),
        };
        weights_error(path, why)
    })
}

fn weights_error(path: &Path, why: Fault) -> EncoderError {
    EncoderError::Weights {
        path: path.to_owned(),
        why,
    }
}

/// The shape in `PyTorch`'s layout, and the values.
fn values_of(slot: Slot<'_>) -> Result<(Vec<usize>, Vec<f32>), String> {
    let read = |data: TensorData| {
        let shape: Vec<usize> = data.shape().iter().copied().collect();
        let values = data
            .convert::<f32>()
            .try_into_vec::<f32>()
            .map_err(|error| format!("{error:?}"))?;
        Ok((shape, values))
    };
    match slot {
        Slot::Kernel(param) => read(param.val().into_data()),
        Slot::Matrix(param) => {
            let (shape, values) = read(param.val().into_data())?;
            let [inside, out] = [shape[0], shape[1]];
            Ok((vec![out, inside], transposed(&values, out)))
        }
        Slot::Vector(param) => read(param.val().into_data()),
        // burn applies the pending update of the last training step only in `valid`.
        Slot::Running(state) => read(state.valid().value().into_data()),
    }
}

/// Transposes a matrix with rows of `columns` values each.
fn transposed(values: &[f32], columns: usize) -> Vec<f32> {
    (0..columns)
        .flat_map(|column| values.iter().skip(column).step_by(columns).copied())
        .collect()
}

/// The origin of a file, which determines its contents and how to fix a wrong one.
#[derive(Clone, Copy)]
enum Origin {
    Torchvision,
    Own,
}

impl Origin {
    fn remedy(self) -> &'static str {
        match self {
            Self::Torchvision => "use torchvision's resnet18, which re4-pipe fetch resnet18 downloads",
            Self::Own => "train the encoder again",
        }
    }

    /// Whether a file may also contain this tensor, which is not loaded.
    fn ignores(self, name: &str) -> bool {
        matches!(self, Self::Torchvision) && (name.starts_with("fc.") || name.ends_with(".num_batches_tracked"))
    }

    /// Whether a file must contain this tensor.
    fn requires(self, name: &str) -> bool {
        matches!(self, Self::Own) || !(name.starts_with("embedding.") || name.starts_with("head."))
    }
}

fn fill(mut encoder: Encoder, file: &File, origin: Origin) -> Result<Encoder, Fault> {
    let expected = encoder.width();
    let mut slots: Vec<_> = encoder
        .slots()
        .into_iter()
        .filter(|(name, _)| origin.requires(name))
        .collect();
    file.check_names(slots.iter().map(|(name, _)| name.as_str()).collect(), origin)?;
    let (_, width) = file.network(origin)?;
    if width != expected {
        return Err(fault!(
            "conv1.weight has {width} channels, but the encoder's has {expected}";
            "set pose.encoder.width = {width}, or use weights with {expected} channels"
        ));
    }
    for (name, slot) in &slots {
        file.check_shape(name, &slot.shape(), origin)?;
    }
    // All tensors are read before the first one is set, because clones of the encoder share the batch normalisation statistics.
    let mut values = Vec::with_capacity(slots.len());
    for (name, _) in &slots {
        values.push(file.values(name, origin)?);
    }
    for ((_, slot), values) in slots.iter_mut().zip(values) {
        slot.put(values);
    }
    drop(slots);
    Ok(encoder)
}

impl Slot<'_> {
    /// The shape in `PyTorch`'s layout.
    fn shape(&self) -> Vec<usize> {
        let mut shape: Vec<usize> = match self {
            Self::Kernel(param) => param.lazy_shape().iter().copied().collect(),
            Self::Matrix(param) => param.lazy_shape().iter().copied().collect(),
            Self::Vector(param) => param.lazy_shape().iter().copied().collect(),
            Self::Running(state) => state.value().dims().to_vec(),
        };
        if matches!(self, Self::Matrix(_)) {
            shape.reverse();
        }
        shape
    }

    /// Sets the values, which are in `PyTorch`'s layout and match [`Slot::shape`].
    fn put(&mut self, values: Vec<f32>) {
        let shape = self.shape();
        match self {
            Self::Kernel(param) => {
                let tensor = Tensor::from_data(TensorData::new(values, shape), &param.lazy_device());
                **param = param.clone().transform_for_load(tensor, param.id);
            }
            Self::Matrix(param) => {
                let [out, inside] = [shape[0], shape[1]];
                let values = transposed(&values, inside);
                let tensor = Tensor::from_data(TensorData::new(values, [inside, out]), &param.lazy_device());
                **param = param.clone().transform_for_load(tensor, param.id);
            }
            Self::Vector(param) => {
                let tensor = Tensor::from_data(TensorData::new(values, shape), &param.lazy_device());
                **param = param.clone().transform_for_load(tensor, param.id);
            }
            // A new state, because a clone may share the old one, which may also have a pending update.
            Self::Running(state) => {
                let device = state.value().device();
                **state = RunningState::new(Tensor::from_data(TensorData::new(values, shape), &device));
            }
        }
    }
}

/// A tensor of a file.
enum Content {
    Torch(TorchTensor),
    Safe {
        dtype: Dtype,
        shape: Vec<usize>,
        bytes: Vec<u8>,
    },
}

impl Content {
    fn shape(&self) -> &[usize] {
        match self {
            Self::Torch(tensor) => tensor.shape(),
            Self::Safe { shape, .. } => shape,
        }
    }
}

/// The tensors of a file by name, without their common prefix.
struct File {
    tensors: BTreeMap<String, Content>,
}

impl File {
    fn open(path: &Path, origin: Origin) -> Result<Self, Fault> {
        let metadata = fs::metadata(path).map_err(|error| match error.kind() {
            io::ErrorKind::NotFound => fault!("the file does not exist"; "{}", origin.remedy()),
            _ => cannot_read(&error),
        })?;
        if !metadata.is_file() {
            return Err(fault!("the path is not a file"; "give the path of the weights file"));
        }
        if metadata.len() == 0 {
            return Err(fault!("the file is empty"; "{}", origin.remedy()));
        }
        if metadata.len() > MAXIMUM_SIZE {
            let bytes = metadata.len();
            return Err(fault!("the file has {bytes} bytes, more than a ResNet-18 has"; "{}", origin.remedy()));
        }
        let mut tensors = if is_safetensors(path).map_err(|error| cannot_read(&error))? {
            read_safetensors(path, origin)?
        } else if matches!(origin, Origin::Own) {
            return Err(fault!("it is not a safetensors file"; "{}", origin.remedy()));
        } else {
            read_torch(path, origin)?
        };
        let prefix = PREFIXES
            .into_iter()
            .find(|prefix| tensors.contains_key(&format!("{prefix}conv1.weight")));
        if let Some(prefix) = prefix.filter(|prefix| !prefix.is_empty()) {
            tensors = tensors
                .into_iter()
                .filter_map(|(name, content)| Some((name.strip_prefix(prefix)?.to_owned(), content)))
                .collect();
        }
        Ok(Self { tensors })
    }

    fn get(&self, name: &str, origin: Origin) -> Result<&Content, Fault> {
        self.tensors
            .get(name)
            .ok_or_else(|| fault!("it has no tensor {name}, so it is not a ResNet-18"; "{}", origin.remedy()))
    }

    /// The network, and the number of channels after its first convolution.
    fn network(&self, origin: Origin) -> Result<(Network, usize), Fault> {
        if let (Origin::Own, Some(first)) = (origin, self.tensors.get(FIRST_OF_KEYPOINTS)) {
            return match *first.shape() {
                [width, 3, 5, 5] if (1..=MAXIMUM_WIDTH).contains(&width) && is_valid_width(width) => {
                    Ok((Network::Keypoints, width))
                }
                ref shape => Err(fault!(
                    "{FIRST_OF_KEYPOINTS} has the shape {shape:?}, but the network has [width, 3, 5, 5] with a width that is a multiple of 16 up to {MAXIMUM_WIDTH}";
                    "{}", origin.remedy()
                )),
            };
        }
        match *self.get("conv1.weight", origin)?.shape() {
            [width, 3, 7, 7] if (1..=MAXIMUM_WIDTH).contains(&width) => Ok((Network::Resnet18, width)),
            ref shape => Err(fault!(
                "conv1.weight has the shape {shape:?}, but a ResNet-18 has [width, 3, 7, 7] with a width of 1 to {MAXIMUM_WIDTH}";
                "{}", origin.remedy()
            )),
        }
    }

    /// Reports the first unexpected tensor, or else the first missing one.
    fn check_names(&self, mut expected: Vec<&str>, origin: Origin) -> Result<(), Fault> {
        expected.sort_unstable();
        let foreign = self
            .tensors
            .keys()
            .find(|name| expected.binary_search(&name.as_str()).is_err() && !origin.ignores(name));
        if let Some(name) = foreign {
            let what = if self.tensors.contains_key("layer1.0.conv3.weight") {
                "it is a ResNet-50 or deeper"
            } else if self.tensors.contains_key("layer1.2.conv1.weight") {
                "it is a ResNet-34 or similar"
            } else {
                "it is another network"
            };
            return Err(
                fault!("{what}: it has a tensor {name}, which a ResNet-18 does not have"; "{}", origin.remedy()),
            );
        }
        for name in expected {
            self.get(name, origin)?;
        }
        Ok(())
    }

    fn check_shape(&self, name: &str, expected: &[usize], origin: Origin) -> Result<(), Fault> {
        let content = self.get(name, origin)?;
        let shape = content.shape();
        if shape != expected {
            return Err(fault!(
                "{name} has the shape {shape:?}, but should have {expected:?}, so it is another network";
                "{}", origin.remedy()
            ));
        }
        let kind = match content {
            Content::Torch(tensor) => (tensor.dtype() != DType::F32).then(|| format!("{:?}", tensor.dtype())),
            Content::Safe { dtype, .. } => (*dtype != Dtype::F32).then(|| format!("{dtype:?}")),
        };
        kind.map_or(Ok(()), |kind| {
            Err(fault!("{name} has the data type {kind}"; "save the weights as 32-bit floats"))
        })
    }

    /// Reads a tensor and checks that all values are finite and that variances are not negative.
    fn values(&self, name: &str, origin: Origin) -> Result<Vec<f32>, Fault> {
        let values: Vec<f32> = match self.get(name, origin)? {
            Content::Torch(tensor) => guarded(|| tensor.read().map_err(|error| error.to_string()))
                .map_err(|why| fault!("{name} cannot be read ({why}), so the file is damaged"; "{}", origin.remedy()))?
                .as_chunks()
                .0
                .iter()
                .map(|bytes| f32::from_ne_bytes(*bytes))
                .collect(),
            Content::Safe { bytes, .. } => {
                let chunks = bytes.as_chunks().0.iter();
                chunks.map(|bytes| f32::from_le_bytes(*bytes)).collect()
            }
        };
        let variance = name.ends_with(".running_var");
        match values
            .iter()
            .find(|value| !value.is_finite() || (variance && **value < 0.0))
        {
            Some(value) => Err(fault!(
                "{name} contains the value {value}, which is invalid in a trained network";
                "{}", origin.remedy()
            )),
            None => Ok(values),
        }
    }
}

fn cannot_read(error: &io::Error) -> Fault {
    fault!("the file cannot be read ({error})"; "check its permissions and the disk")
}

/// Whether a file is read as safetensors: by its extension, or because it begins with a length and an opening brace.
fn is_safetensors(path: &Path) -> io::Result<bool> {
    use io::Read;
    let mut start = Vec::new();
    fs::File::open(path)?.take(9).read_to_end(&mut start)?;
    Ok(path.extension().is_some_and(|extension| extension == "safetensors") || start.get(8) == Some(&b'{'))
}

fn read_safetensors(path: &Path, origin: Origin) -> Result<BTreeMap<String, Content>, Fault> {
    let bytes = fs::read(path).map_err(|error| cannot_read(&error))?;
    let file = SafeTensors::deserialize(&bytes).map_err(|error| {
        let what = match error {
            SafeTensorError::MetadataIncompleteBuffer | SafeTensorError::InvalidHeaderLength => {
                "it is truncated or has extra bytes"
            }
            _ => "it is not a valid safetensors file",
        };
        fault!("{what} ({error})"; "{}", origin.remedy())
    })?;
    let tensors = file.iter().map(|(name, view)| {
        let content = Content::Safe {
            dtype: view.dtype(),
            shape: view.shape().to_vec(),
            bytes: view.data().to_vec(),
        };
        (name.to_owned(), content)
    });
    Ok(tensors.collect())
}

fn read_torch(path: &Path, origin: Origin) -> Result<BTreeMap<String, Content>, Fault> {
    let reader = guarded(|| PytorchReader::new(path).map_err(|error| error.to_string())).map_err(|why| {
        let why = why.split('\n').next().unwrap_or_default();
        fault!("it is not a valid file of torch.save ({why})"; "{}", origin.remedy())
    })?;
    Ok(reader
        .into_tensors()
        .into_iter()
        .map(|(name, tensor)| (name, Content::Torch(tensor)))
        .collect())
}

/// Calls the reader of `PyTorch` files. It should return an error for every invalid file; if it panics, that is an error too.
fn guarded<T>(read: impl FnOnce() -> Result<T, String>) -> Result<T, String> {
    catch_unwind(AssertUnwindSafe(read)).unwrap_or_else(|_| Err("the reader panicked".to_owned()))
}
