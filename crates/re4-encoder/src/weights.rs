//! Weights in files: those of torchvision's ResNet-18 to start from, and the encoder's own.
//!
//! Both have torchvision's names (`conv1.weight`, `layer2.0.downsample.1.running_var`), so that Python reads the encoder's trunk
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
use safetensors::tensor::TensorView;
use safetensors::{Dtype, SafeTensorError, SafeTensors};

use crate::EncoderError;
use crate::resnet::{Encoder, Slot};

/// A ResNet-18 with 64 channels has 45 MB; a file beyond this is none, and is not read into memory.
const LARGEST: u64 = 1 << 30;

/// More channels than this after the first convolution would be beyond [`LARGEST`].
const WIDEST: usize = 256;

/// Where dictionaries of weights are found in a file: at the top, or as trainings save them.
const PREFIXES: [&str; 4] = ["", "state_dict.", "module.", "state_dict.module."];

/// Starts an encoder from torchvision's ResNet-18: a `.pth` file of `torch.save`, or `.safetensors` with the same names.
/// Running statistics are included; `fc`, torchvision's last layer, is left out, and the encoder's own layers stay as they
/// are.
///
/// # Errors
/// When the file cannot be read, is not one of weights, or holds another network: every tensor's presence, shape, kind and
/// range is checked before the encoder is touched.
pub fn load_torchvision(encoder: Encoder, path: &Path) -> Result<Encoder, EncoderError> {
    File::open(path, Origin::Torchvision)
        .and_then(|file| fill(encoder, &file, Origin::Torchvision))
        .map_err(|why| weights_error(path, why))
}

/// Reads an encoder that [`save`] wrote. The number of channels is that of the file.
///
/// # Errors
/// When the file cannot be read, or holds something else.
pub fn load(path: &Path, device: &Device) -> Result<Encoder, EncoderError> {
    let origin = Origin::Own;
    let load = || {
        let file = File::open(path, origin)?;
        let width = file.width(origin)?;
        fill(Encoder::new(width, device), &file, origin)
    };
    load().map_err(|why| weights_error(path, why))
}

/// An encoder as the bytes of a safetensors file, tensors sorted by name: equal weights are equal bytes.
///
/// # Errors
/// When the weights cannot be had from their device.
pub fn to_bytes(encoder: &Encoder) -> Result<Vec<u8>, EncoderError> {
    let pack = || -> Result<Vec<u8>, Fault> {
        let mut tensors = BTreeMap::new();
        for (name, slot) in encoder.clone().slots() {
            let (shape, values) =
                values_of(slot).map_err(|why| fault!("{name} cannot be read from its device ({why})"))?;
            let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
            tensors.insert(name, (shape, bytes));
        }
        let views: Result<Vec<_>, _> = tensors
            .iter()
            .map(|(name, (shape, bytes))| Ok((name, TensorView::new(Dtype::F32, shape.clone(), bytes)?)))
            .collect();
        // No metadata: its keys would come in an order of their own.
        views
            .and_then(|views| safetensors::serialize(views, None))
            .map_err(|error: SafeTensorError| fault!("they cannot be packed ({error})"))
    };
    pack().map_err(|why| weights_error(Path::new("of the encoder in training"), why))
}

/// Writes an encoder to a file, as [`to_bytes`]. The file is written in place; where readers may look meanwhile, write a
/// sibling and rename it.
///
/// # Errors
/// When the file cannot be written.
pub fn save(encoder: &Encoder, path: &Path) -> Result<(), EncoderError> {
    fs::write(path, to_bytes(encoder)?).map_err(|error| {
        let why = match error.kind() {
            io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => {
                fault!("the file cannot be written ({error})"; "free some space")
            }
            _ => fault!("the file cannot be written ({error})"; "choose a folder that can be written to"),
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

/// Shape in `PyTorch`'s layout, and the values.
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
        // The last step of a training is pending in the state until it is asked for in this way.
        Slot::Running(state) => read(state.valid().value().into_data()),
    }
}

/// Rows of `columns` values each, turned into columns.
fn transposed(values: &[f32], columns: usize) -> Vec<f32> {
    (0..columns)
        .flat_map(|column| values.iter().skip(column).step_by(columns).copied())
        .collect()
}

/// Whose file it is, which decides what must be in it and how a wrong one is fixed.
#[derive(Clone, Copy)]
enum Origin {
    Torchvision,
    Own,
}

impl Origin {
    fn fix(self) -> &'static str {
        match self {
            Self::Torchvision => "give torchvision's resnet18, which re4-pipe fetch resnet18 downloads",
            Self::Own => "train the encoder again",
        }
    }

    /// Whether a file may hold this beside what is asked for.
    fn ignores(self, name: &str) -> bool {
        matches!(self, Self::Torchvision) && (name.starts_with("fc.") || name.ends_with(".num_batches_tracked"))
    }

    fn asks_for(self, name: &str) -> bool {
        matches!(self, Self::Own) || !(name.starts_with("embedding.") || name.starts_with("head."))
    }
}

fn fill(mut encoder: Encoder, file: &File, origin: Origin) -> Result<Encoder, Fault> {
    let expected = encoder.width();
    let mut slots: Vec<_> = encoder
        .slots()
        .into_iter()
        .filter(|(name, _)| origin.asks_for(name))
        .collect();
    file.check_names(slots.iter().map(|(name, _)| name.as_str()).collect(), origin)?;
    let width = file.width(origin)?;
    if width != expected {
        return Err(fault!(
            "conv1.weight has {width} channels and the encoder's has {expected}";
            "set pose.encoder.width = {width}, or start from weights of {expected} channels"
        ));
    }
    for (name, slot) in &slots {
        file.check_shape(name, &slot.shape(), origin)?;
    }
    // Everything is read before the first is put: batch normalisation shares its statistics between clones.
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
    /// In `PyTorch`'s layout.
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

    /// Puts values in `PyTorch`'s layout, as many as [`Slot::shape`] says.
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
            // A new state: the old one may be shared with a clone, and may have an update pending.
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

/// The tensors of a file by name, without the prefix that they share.
struct File {
    tensors: BTreeMap<String, Content>,
}

impl File {
    fn open(path: &Path, origin: Origin) -> Result<Self, Fault> {
        let metadata = fs::metadata(path).map_err(|error| match error.kind() {
            io::ErrorKind::NotFound => fault!("there is no such file"; "{}", origin.fix()),
            _ => cannot_read(&error),
        })?;
        if !metadata.is_file() {
            return Err(fault!("it is not a file"; "name the file of weights itself"));
        }
        if metadata.len() == 0 {
            return Err(fault!("the file is empty"; "{}", origin.fix()));
        }
        if metadata.len() > LARGEST {
            let bytes = metadata.len();
            return Err(fault!("{bytes} bytes are more than a ResNet-18 has"; "{}", origin.fix()));
        }
        let mut tensors = if is_safetensors(path).map_err(|error| cannot_read(&error))? {
            read_safetensors(path, origin)?
        } else if matches!(origin, Origin::Own) {
            return Err(fault!("it is not a safetensors file"; "{}", origin.fix()));
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
            .ok_or_else(|| fault!("it holds no tensor {name}, so it is not a ResNet-18"; "{}", origin.fix()))
    }

    /// Channels after the first convolution.
    fn width(&self, origin: Origin) -> Result<usize, Fault> {
        match *self.get("conv1.weight", origin)?.shape() {
            [width, 3, 7, 7] if (1..=WIDEST).contains(&width) => Ok(width),
            ref shape => Err(fault!(
                "conv1.weight has the shape {shape:?} where a ResNet-18 has [64, 3, 7, 7], or another width up to {WIDEST} in front";
                "{}", origin.fix()
            )),
        }
    }

    /// Names the first tensor that is missing, or that another network has and this one has not.
    fn check_names(&self, mut expected: Vec<&str>, origin: Origin) -> Result<(), Fault> {
        expected.sort_unstable();
        let foreign = self
            .tensors
            .keys()
            .find(|name| expected.binary_search(&name.as_str()).is_err() && !origin.ignores(name));
        if let Some(name) = foreign {
            let what = if self.tensors.contains_key("layer1.0.conv3.weight") {
                "it is a ResNet of 50 layers or more"
            } else if self.tensors.contains_key("layer1.2.conv1.weight") {
                "it is a ResNet-34 or the like"
            } else {
                "it is another network"
            };
            return Err(fault!("{what}: it holds a tensor {name}, which a ResNet-18 has not"; "{}", origin.fix()));
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
                "{name} has the shape {shape:?} and should have {expected:?}, so it is another network";
                "{}", origin.fix()
            ));
        }
        let kind = match content {
            Content::Torch(tensor) => (tensor.dtype() != DType::F32).then(|| format!("{:?}", tensor.dtype())),
            Content::Safe { dtype, .. } => (*dtype != Dtype::F32).then(|| format!("{dtype:?}")),
        };
        kind.map_or(Ok(()), |kind| {
            Err(fault!("{name} holds numbers of the kind {kind}"; "save the weights as 32-bit floats"))
        })
    }

    /// The values, all finite, and variances not negative.
    fn values(&self, name: &str, origin: Origin) -> Result<Vec<f32>, Fault> {
        let values: Vec<f32> = match self.get(name, origin)? {
            Content::Torch(tensor) => guarded(|| tensor.read().map_err(|error| error.to_string()))
                .map_err(|why| fault!("{name} cannot be read ({why}), so the file is damaged"; "{}", origin.fix()))?
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
                "{name} holds the value {value}, which no trained network has";
                "{}", origin.fix()
            )),
            None => Ok(values),
        }
    }
}

fn cannot_read(error: &io::Error) -> Fault {
    fault!("the file cannot be read ({error})"; "check its permissions and the disk")
}

/// Whether a file is to be read as safetensors: it is called so, or begins so, with a length and an opening brace.
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
                "it is cut short or has something appended"
            }
            _ => "it is not a safetensors file, or a damaged one",
        };
        fault!("{what} ({error})"; "{}", origin.fix())
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
        fault!("it is not a file that torch.save wrote, or a damaged one ({why})"; "{}", origin.fix())
    })?;
    Ok(reader
        .into_tensors()
        .into_iter()
        .map(|(name, tensor)| (name, Content::Torch(tensor)))
        .collect())
}

/// Runs the reader of `PyTorch`'s files, whose authors mean it to bear any file; should it stop on one, that is an error too.
fn guarded<T>(read: impl FnOnce() -> Result<T, String>) -> Result<T, String> {
    catch_unwind(AssertUnwindSafe(read)).unwrap_or_else(|_| Err("its reader stopped".to_owned()))
}
