//! Weights files of the encoder and of torchvision, and comparison of the features with torchvision's.
//!
//! `tests/torchvision_reference.py` writes the files in `data`.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "helpers of tests may fail like tests"
)]

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use burn::module::Module;
use burn::tensor::{Device, Tensor, TensorData};
use re4_encoder::Network;
use re4_encoder::network::Encoder;
use re4_encoder::weights::{load, load_torchvision, save};
use re4_fault::Remedy as _;
use safetensors::tensor::TensorView;
use safetensors::{Dtype, SafeTensors};
use serde_json::Value;
use tempfile::TempDir;

/// Shape and bytes.
type Stored = (Vec<usize>, Vec<u8>);

fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name)
}

fn json(name: &str) -> Value {
    serde_json::from_slice(&fs::read(data(name)).unwrap()).unwrap()
}

fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(!0, |crc, byte| {
        (0..8).fold(crc ^ u32::from(*byte), |crc, _| {
            if crc & 1 == 1 { crc >> 1 ^ 0xEDB8_8320 } else { crc >> 1 }
        })
    })
}

/// The same as `numbers` of `tests/torchvision_reference.py`.
fn numbers(name: &str, count: usize) -> Vec<f32> {
    let start = crc32(name.as_bytes());
    let number = |index: usize| {
        let mut x = (index as u32).wrapping_mul(2_654_435_761).wrapping_add(start);
        for multiplier in [0x7FEB_352D_u32, 0x846C_A68B] {
            x ^= x >> 15;
            x = x.wrapping_mul(multiplier);
        }
        x ^= x >> 16;
        (f64::from(x >> 8) / f64::from(1 << 23) - 1.0) as f32
    };
    (0..count).map(number).collect()
}

/// The same as `tensor` of `tests/torchvision_reference.py`.
fn values(name: &str, shape: &[usize]) -> Vec<f32> {
    let mut values = numbers(name, shape.iter().product());
    for value in &mut values {
        *value = if shape.len() == 4 {
            *value * (6.0 / shape[1..].iter().product::<usize>() as f64).sqrt() as f32
        } else if name.ends_with(".running_var") {
            1.0 + 0.5 * *value
        } else if name.ends_with(".weight") && shape.len() == 1 {
            1.0 + 0.25 * *value
        } else {
            0.125 * *value
        };
    }
    values
}

fn write_safetensors(path: &Path, tensors: &BTreeMap<String, Stored>) {
    let views = tensors
        .iter()
        .map(|(name, (shape, bytes))| (name, TensorView::new(Dtype::F32, shape.clone(), bytes).unwrap()));
    fs::write(path, safetensors::serialize(views, None).unwrap()).unwrap();
}

fn read_safetensors(path: &Path) -> BTreeMap<String, Stored> {
    let bytes = fs::read(path).unwrap();
    let file = SafeTensors::deserialize(&bytes).unwrap();
    file.iter()
        .map(|(name, view)| (name.to_owned(), (view.shape().to_vec(), view.data().to_vec())))
        .collect()
}

/// The names and shapes of torchvision's ResNet-18, with computed values.
fn computed() -> BTreeMap<String, Stored> {
    let reference = json("resnet18.json");
    let shapes = reference["shapes"].as_object().unwrap().clone();
    let tensor = |(name, shape): (String, Value)| {
        let shape: Vec<usize> = serde_json::from_value(shape).unwrap();
        let bytes = values(&name, &shape)
            .iter()
            .flat_map(|value| value.to_le_bytes())
            .collect();
        (name, (shape, bytes))
    };
    shapes.into_iter().map(tensor).collect()
}

/// The largest difference from the fixture's features, relative to the largest feature.
fn difference(encoder: &Encoder, reference: &Value) -> f64 {
    let expected: Vec<Vec<f64>> = serde_json::from_value(reference["features"].clone()).unwrap();
    let (count, side) = (expected.len(), 76);
    let images: Vec<f32> = (0..count)
        .flat_map(|k| numbers(&format!("picture.{k}"), 3 * side * side))
        .map(|value| 2.0 * value)
        .collect();
    let images = Tensor::from_data(TensorData::new(images, [count, 3, side, side]), &Device::flex());
    let features: Vec<f32> = encoder
        .resnet()
        .unwrap()
        .features(images)
        .into_data()
        .try_into_vec()
        .unwrap();
    let expected = expected.concat();
    assert_eq!(features.len(), expected.len());
    let largest = expected
        .iter()
        .fold(0.0, |largest: f64, value| largest.max(value.abs()));
    features
        .iter()
        .zip(&expected)
        .fold(0.0, |largest: f64, (value, expected)| {
            largest.max((f64::from(*value) - expected).abs())
        })
        / largest
}

/// torchvision's own rounding error is up to 6e-7 of the largest feature (`float64` of the fixtures). The sums here have the same
/// length but another order.
const TOLERANCE: f64 = 3e-6;

fn narrow() -> Encoder {
    load_torchvision(
        Encoder::new(Network::Resnet18, 2, &Device::flex()),
        &data("narrow18.pth"),
    )
    .unwrap()
}

fn refusal<T>(result: Result<T, re4_encoder::EncoderError>, folder: &Path) -> String {
    let sentence = result.err().expect("the file should be refused").sentence();
    assert!(!sentence.contains("the reader panicked"), "{sentence}");
    sentence
        .replace(folder.to_str().unwrap(), "[folder]")
        .replace(data("").to_str().unwrap(), "[data]/")
}

#[test]
fn features_equal_those_of_torchvision() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("resnet18.safetensors");
    write_safetensors(&path, &computed());
    let encoder = load_torchvision(Encoder::new(Network::Resnet18, 64, &Device::flex()), &path).unwrap();
    let error = difference(&encoder, &json("resnet18.json"));
    assert!(error < TOLERANCE, "{error}");
    // The comparison detects a change of a single running statistic.
    let mut tensors = computed();
    let (_, bytes) = tensors.get_mut("layer3.1.bn2.running_mean").unwrap();
    bytes[..4].copy_from_slice(&0.5_f32.to_le_bytes());
    write_safetensors(&path, &tensors);
    let encoder = load_torchvision(encoder, &path).unwrap();
    assert!(difference(&encoder, &json("resnet18.json")) > 10.0 * TOLERANCE);
}

#[test]
fn torch_files_are_read() {
    for file in ["narrow18.pth", "narrow18_checkpoint.pth"] {
        let encoder = load_torchvision(Encoder::new(Network::Resnet18, 2, &Device::flex()), &data(file)).unwrap();
        let error = difference(&encoder, &json("narrow18.json"));
        assert!(error < TOLERANCE, "{file}: {error}");
    }
    // Neither the file extension nor a device with gradients matters.
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("weights");
    fs::copy(data("narrow18.pth"), &path).unwrap();
    let device = Device::flex().autodiff();
    let encoder = load_torchvision(Encoder::new(Network::Resnet18, 2, &device), &path).unwrap();
    assert!(difference(&encoder.valid(), &json("narrow18.json")) < TOLERANCE);
    let loss = encoder
        .resnet()
        .unwrap()
        .features(Tensor::ones([2, 3, 76, 76], &device))
        .sum();
    let gradients = burn::optim::GradientsParams::from_grads(loss.backward(), &encoder);
    // All parameters except the running statistics, the embedding and the head.
    assert_eq!(gradients.len(), 60, "loaded weights must be trainable");
}

#[test]
fn saved_weights_are_loaded_bit_exactly_with_torchvision_names() {
    let folder = TempDir::new().unwrap();
    let (first, second) = (folder.path().join("a.safetensors"), folder.path().join("b.safetensors"));
    let encoder = narrow();
    save(&encoder, &first).unwrap();
    let again = load(&first, &Device::flex()).unwrap();
    assert_eq!(again.width(), 2);
    save(&again, &second).unwrap();
    assert_eq!(fs::read(&first).unwrap(), fs::read(&second).unwrap());

    let stored = read_safetensors(&first);
    let names = json("resnet18.json")["shapes"].as_object().unwrap().clone();
    let trunk = |name: &&String| !name.starts_with("fc.") && !name.ends_with(".num_batches_tracked");
    for name in names.keys().filter(trunk) {
        let shape = &stored[name].0;
        let bytes: Vec<u8> = values(name, shape)
            .iter()
            .flat_map(|value| value.to_le_bytes())
            .collect();
        assert!(
            stored[name].1 == bytes,
            "{name} differs from the value that Python computed"
        );
    }
    let own: Vec<&String> = stored.keys().filter(|name| !names.contains_key(*name)).collect();
    assert_eq!(own, ["embedding.bias", "embedding.weight", "head.bias", "head.weight"]);
    assert_eq!(stored.len(), 4 + names.keys().filter(trunk).count());
    assert_eq!(stored["embedding.weight"].0, [256, 16]);
    assert_eq!(stored["head.weight"].0, [9, 256]);

    // PyTorch's layout: the head output is weight x embedding + bias.
    let (embedding, pose) = encoder
        .resnet()
        .unwrap()
        .forward(Tensor::ones([1, 3, 76, 76], &Device::flex()));
    let embedding: Vec<f32> = embedding.into_data().try_into_vec().unwrap();
    let pose: Vec<f32> = pose.into_data().try_into_vec().unwrap();
    let floats = |name: &str| -> Vec<f32> {
        let chunks = stored[name].1.as_chunks().0.iter();
        chunks.map(|bytes| f32::from_le_bytes(*bytes)).collect()
    };
    let (weight, bias) = (floats("head.weight"), floats("head.bias"));
    for ((row, bias), pose) in weight.chunks(256).zip(bias).zip(pose) {
        let expected: f32 = row.iter().zip(&embedding).map(|(a, b)| a * b).sum::<f32>() + bias;
        assert!((expected - pose).abs() < 1e-4 * (1.0 + pose.abs()), "{expected} {pose}");
    }
}

#[test]
fn the_last_step_of_a_training_is_saved() {
    let folder = TempDir::new().unwrap();
    let saved = |encoder: &Encoder, name: &str| {
        let path = folder.path().join(name);
        save(encoder, &path).unwrap();
        read_safetensors(&path)
    };
    let device = Device::flex().autodiff();
    let encoder = load_torchvision(Encoder::new(Network::Resnet18, 2, &device), &data("narrow18.pth")).unwrap();
    let before = saved(&encoder, "before");
    let _ = encoder
        .resnet()
        .unwrap()
        .features(Tensor::ones([2, 3, 76, 76], &device));
    let after = saved(&encoder, "after");
    assert!(before["bn1.running_var"] != after["bn1.running_var"]);
    assert!(before["bn1.weight"] == after["bn1.weight"]);
    assert!(after == saved(&encoder.valid(), "valid"));
    // A load discards a pending update of an earlier step.
    let encoder = load_torchvision(encoder, &data("narrow18.pth")).unwrap();
    assert!(before == saved(&encoder, "again"));
}

#[test]
fn equal_weights_give_equal_bytes_in_every_process() {
    const SAVE_TO: &str = "RE4_ENCODER_TEST_SAVE_TO";
    const SEED: &str = "RE4_ENCODER_TEST_SEED";
    if let (Some(path), Ok(seed)) = (std::env::var_os(SAVE_TO), std::env::var(SEED)) {
        let device = Device::flex();
        device.seed(seed.parse().unwrap());
        return save(&Encoder::new(Network::Resnet18, 2, &device), Path::new(&path)).unwrap();
    }
    let folder = TempDir::new().unwrap();
    let saved = |name: &str, seed: &str| {
        let path = folder.path().join(name);
        // The output is captured, so that the child's test summary does not appear in this run.
        let output = Command::new(std::env::current_exe().unwrap())
            .args(["--exact", "equal_weights_give_equal_bytes_in_every_process"])
            .env(SAVE_TO, &path)
            .env(SEED, seed)
            .output()
            .unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stdout));
        fs::read(path).unwrap()
    };
    let first = saved("first", "7");
    assert!(first == saved("second", "7"));
    assert!(first != saved("third", "8"));
}

/// Writes a copy of `good.safetensors` with a change.
fn changed(folder: &Path, name: &str, change: impl FnOnce(&mut BTreeMap<String, Stored>)) -> PathBuf {
    let path = folder.join(name);
    let mut tensors = read_safetensors(&folder.join("good.safetensors"));
    change(&mut tensors);
    write_safetensors(&path, &tensors);
    path
}

#[test]
fn other_networks_are_refused() {
    let folder = TempDir::new().unwrap();
    let folder = folder.path();
    let start = |width: usize, path: &Path| {
        refusal(
            load_torchvision(Encoder::new(Network::Resnet18, width, &Device::flex()), path),
            folder,
        )
    };
    let mut sentences = vec![
        start(1, &data("narrow34.pth")),
        start(1, &data("narrow50.pth")),
        start(64, &data("narrow18.pth")),
    ];
    // A ResNet-18 with two channels, at first with embedding and head, then without.
    let good = folder.join("good.safetensors");
    save(&narrow(), &good).unwrap();
    sentences.push(start(2, &good));
    let tensors = read_safetensors(&good)
        .into_iter()
        .filter(|(name, _)| !name.starts_with("embedding.") && !name.starts_with("head."))
        .collect();
    write_safetensors(&good, &tensors);
    load_torchvision(Encoder::new(Network::Resnet18, 2, &Device::flex()), &good).unwrap();

    let set = |tensors: &mut BTreeMap<String, Stored>, name: &str, value: f32| {
        tensors.get_mut(name).unwrap().1[4..8].copy_from_slice(&value.to_le_bytes());
    };
    let wrong = [
        changed(folder, "missing.safetensors", |tensors| {
            tensors.remove("layer2.0.downsample.1.running_var").unwrap();
        }),
        changed(folder, "no_conv1.safetensors", |tensors| {
            tensors.remove("conv1.weight").unwrap();
        }),
        changed(folder, "shape.safetensors", |tensors| {
            tensors.get_mut("layer4.1.conv2.weight").unwrap().0 = vec![8, 32, 3, 3];
        }),
        changed(folder, "first.safetensors", |tensors| {
            tensors.get_mut("conv1.weight").unwrap().0 = vec![2, 7, 7, 3];
        }),
        changed(folder, "nan.safetensors", |tensors| {
            set(tensors, "layer1.0.conv1.weight", f32::NAN);
        }),
        changed(folder, "variance.safetensors", |tensors| {
            set(tensors, "bn1.running_var", -0.5);
        }),
    ];
    sentences.extend(wrong.iter().map(|path| start(2, path)));
    let half = folder.join("half.safetensors");
    let text = fs::read(&good).unwrap();
    // The header declares another data type for the first tensor; the file is otherwise valid.
    let text = text
        .windows(3)
        .position(|window| window == b"F32")
        .map(|at| [&text[..at], b"I32", &text[at + 3..]].concat());
    fs::write(&half, text.unwrap()).unwrap();
    sentences.push(start(2, &half));
    // The encoder's own files must contain every tensor that training writes.
    sentences.push(refusal(load(&good, &Device::flex()), folder));
    sentences.push(refusal(load(&data("narrow18.pth"), &Device::flex()), folder));
    insta::assert_snapshot!(sentences.join("\n"));
}

#[test]
fn invalid_weights_files_are_refused() {
    let folder = TempDir::new().unwrap();
    let folder = folder.path();
    let file = |name: &str, bytes: &[u8]| {
        let path = folder.join(name);
        fs::write(&path, bytes).unwrap();
        path
    };
    let torch = fs::read(data("narrow18.pth")).unwrap();
    let good = folder.join("good.safetensors");
    save(&narrow(), &good).unwrap();
    let safe = fs::read(&good).unwrap();
    let header = u64::from_le_bytes(safe[..8].try_into().unwrap());
    let with_header_length = |length: u64| [&length.to_le_bytes(), &safe[8..]].concat();
    let noise: Vec<u8> = numbers("noise", 10_000)
        .iter()
        .flat_map(|value| value.to_le_bytes())
        .collect();
    let zip = {
        let mut bytes = torch[..30].to_vec();
        bytes.extend(&noise);
        bytes
    };
    let paths = [
        folder.to_owned(),
        folder.join("absent.pth"),
        file("empty.pth", b""),
        file("text.pth", b"<html>404 Not Found</html>\n"),
        file("noise.pth", &noise),
        file("noise.safetensors", &noise),
        file("zip.pth", &zip),
        file("cut.pth", &torch[..torch.len() / 2]),
        file("cut.safetensors", &safe[..safe.len() / 2]),
        file("short.safetensors", &safe[..5]),
        file("longer.safetensors", &with_header_length(header + 8)),
        file("shorter.safetensors", &with_header_length(header - 8)),
        file("endless.safetensors", &with_header_length(u64::MAX)),
        file("appended.safetensors", &[safe.as_slice(), b"x"].concat()),
    ];
    let sentences: Vec<String> = paths
        .iter()
        .map(|path| {
            refusal(
                load_torchvision(Encoder::new(Network::Resnet18, 2, &Device::flex()), path),
                folder,
            )
        })
        .collect();
    insta::assert_snapshot!(sentences.join("\n"));
    for path in &paths {
        refusal(load(path, &Device::flex()), folder);
    }
}

#[test]
fn damaged_files_are_refused_wherever_the_damage_is() {
    let folder = TempDir::new().unwrap();
    let folder = folder.path();
    let path = folder.join("damaged.pth");
    let torch = fs::read(data("narrow18.pth")).unwrap();
    let encoder = Encoder::new(Network::Resnet18, 2, &Device::flex());
    for length in (0..torch.len()).step_by(263).chain(torch.len() - 40..torch.len()) {
        fs::write(&path, &torch[..length]).unwrap();
        refusal(load_torchvision(encoder.clone(), &path), folder);
    }
    // Changed bytes may be where nothing depends on them; then the weights are correct.
    let choice = numbers("damage", 3 * 400);
    let expected = json("narrow18.json");
    let (mut accepted, mut refused) = (0, 0);
    for three in choice.chunks(3) {
        let at = (f32::midpoint(three[0], 1.0) * torch.len() as f32) as usize;
        let mut bytes = torch.clone();
        for (byte, number) in bytes[at..].iter_mut().zip(&three[1..]) {
            *byte = (number * 128.0) as i8 as u8;
        }
        fs::write(&path, bytes).unwrap();
        match load_torchvision(encoder.clone(), &path) {
            Ok(encoder) => {
                assert!(difference(&encoder, &expected) < TOLERANCE);
                accepted += 1;
            }
            Err(error) => {
                refusal::<()>(Err(error), folder);
                refused += 1;
            }
        }
    }
    assert!(refused > accepted, "{refused} refused, {accepted} accepted");
}
