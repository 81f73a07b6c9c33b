//! Weights files: safetensors with `PyTorch`'s layouts. The U-Net has the names of Diffusion Policy's parameters.

use std::collections::BTreeMap;
use std::path::Path;

use burn::tensor::{Device, Tensor, TensorData};
use re4_fault::{Fault, fault};
use re4_train::tensors;

use crate::GenerativeError;
use crate::layers::{Layout, Named, Slot};
use crate::network::{Network, Shape};

/// A matrix in a file.
struct Stored {
    /// Rows and columns of the matrix.
    rows: usize,
    columns: usize,
    layout: Layout,
}

impl Stored {
    /// The shape in a file: `[out, in]`, `[out, in, taps]`, or `[in, out, taps]` for a transposed convolution.
    fn shape(&self) -> Vec<usize> {
        match self.layout {
            Layout::Linear => vec![self.columns, self.rows],
            Layout::Conv(taps) => vec![self.columns, self.rows / taps, taps],
            Layout::Transposed(taps) => vec![self.rows, self.columns / taps, taps],
        }
    }

    /// Position in a file of the value at a row and a column.
    fn position(&self, row: usize, column: usize) -> usize {
        match self.layout {
            Layout::Linear => column * self.rows + row,
            Layout::Conv(taps) => {
                let inputs = self.rows / taps;
                let (tap, input) = (row / inputs, row % inputs);
                (column * inputs + input) * taps + tap
            }
            Layout::Transposed(taps) => {
                let outputs = self.columns / taps;
                let (tap, output) = (column / outputs, column % outputs);
                (row * outputs + output) * taps + tap
            }
        }
    }

    /// Positions in a file of all values, by row and column.
    fn positions(&self) -> impl Iterator<Item = usize> + '_ {
        (0..self.rows).flat_map(move |row| (0..self.columns).map(move |column| self.position(row, column)))
    }
}

/// Serialises a network to safetensors: equal weights give equal bytes.
///
/// # Errors
/// If the weights cannot be read from their device.
pub fn to_bytes(network: &Network) -> Result<Vec<u8>, GenerativeError> {
    let mut network = network.clone();
    let mut all = BTreeMap::new();
    let read = |data: TensorData| {
        data.convert::<f32>()
            .try_into_vec::<f32>()
            .map_err(|error| GenerativeError::Device(format!("{error:?}")))
    };
    for Named { name, slot, .. } in network.all() {
        let tensor = match slot {
            Slot::Matrix { param, layout } => {
                let [rows, columns] = param.val().dims();
                let stored = Stored { rows, columns, layout };
                let own = read(param.val().into_data())?;
                let mut values = vec![0.0; own.len()];
                for (position, value) in stored.positions().zip(own) {
                    values[position] = value;
                }
                (stored.shape(), values)
            }
            Slot::Vector(param) => {
                let values = read(param.val().into_data())?;
                (vec![values.len()], values)
            }
        };
        all.insert(name, tensor);
    }
    tensors::to_bytes(&all).map_err(|why| GenerativeError::Weights {
        path: "of the trained policy".into(),
        why,
    })
}

/// Reads a network that [`to_bytes`] wrote.
///
/// # Errors
/// If the file cannot be read, or contains another network. The name, shape and values of every tensor are checked.
pub fn load(path: &Path, shape: Shape, device: &Device) -> Result<Network, GenerativeError> {
    let read = || -> Result<Network, Fault> {
        let mut tensors = tensors::read(path)?;
        let mut network = Network::new(shape, device);
        for Named { name, slot, .. } in network.all() {
            let (dims, values) = tensors
                .remove(&name)
                .ok_or_else(|| fault!("it has no tensor {name}, so it is of another network"; "{RETRAIN}"))?;
            let check = |expected: &[usize]| {
                if dims == expected {
                    return Ok(());
                }
                Err(fault!("{name} has the shape {dims:?}, but should have {expected:?}"; "{RETRAIN}"))
            };
            match slot {
                Slot::Matrix { param, layout } => {
                    let [rows, columns] = param.val().dims();
                    let stored = Stored { rows, columns, layout };
                    check(&stored.shape())?;
                    let own: Vec<f32> = stored.positions().map(|position| values[position]).collect();
                    let own = Tensor::from_data(TensorData::new(own, [rows, columns]), device);
                    *param = param.clone().map(|_| own);
                }
                Slot::Vector(param) => {
                    let dims = param.val().dims();
                    check(&dims)?;
                    let own = Tensor::from_data(TensorData::new(values, dims), device);
                    *param = param.clone().map(|_| own);
                }
            }
        }
        match tensors.keys().next() {
            Some(name) => Err(fault!("it has a tensor {name}, so it is of another network"; "{RETRAIN}")),
            None => Ok(network),
        }
    };
    read().map_err(|why| GenerativeError::Weights {
        path: path.to_owned(),
        why,
    })
}

/// Remedy for a file of another network.
const RETRAIN: &str = "delete the policy artifact and train again";
