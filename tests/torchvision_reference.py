"""Writes outputs of torchvision's residual networks as references for the tests of re4-encoder, which then need no Python.

    python tests/torchvision_reference.py [crates/re4-encoder/tests/data]

Made with torch 2.9.0 and torchvision 0.24.0 on Python 3.11 (pip install torch==2.9.0 torchvision==0.24.0).

ResNet-18's weights are 45 MB, so they are not stored: both sides compute them from the tensors' names with `numbers` below,
including running statistics, so that batch normalisation is tested. The files are

* `resnet18.json`: names and shapes of the state dict, and for each of three computed images of 76 x 76 the 512 averaged
  features, from torchvision.models.resnet18 in inference mode; `float64` is their distance from the features in double
  precision, relative to the largest feature;
* `narrow18.pth`, `narrow18_checkpoint.pth`: state dicts of a ResNet-18 of 2 channels, as torch.save writes them, the second one
  as `state_dict` in a dictionary with other entries; `narrow18.json` has its 16 features;
* `narrow34.pth`, `narrow50.pth`: state dicts of a ResNet-34 and a ResNet-50 of 1 channel, which have to be refused.
"""

import json
import pathlib
import sys
import zlib

import numpy as np
import torch
import torchvision
from torchvision.models.resnet import BasicBlock, Bottleneck, ResNet

IMAGES = 3
SIDE = 76


def numbers(name: str, count: int) -> np.ndarray:
    """`count` numbers in [-1, 1) with 24 bits each, exact in float32: a hashed counter that starts at the name's CRC-32."""
    x = (np.arange(count, dtype=np.uint64) * 2654435761 + zlib.crc32(name.encode())) & 0xFFFFFFFF
    for multiplier in (0x7FEB352D, 0x846CA68B):
        x ^= x >> 15
        x = (x * multiplier) & 0xFFFFFFFF
    x ^= x >> 16
    return ((x >> 8).astype(np.float64) / 2**23 - 1).astype(np.float32)


def tensor(name: str, shape: tuple[int, ...]) -> np.ndarray:
    u = numbers(name, int(np.prod(shape)))
    if len(shape) == 4:
        # The variance 2 / (inputs per pixel) preserves the variance of the activations.
        values = u * np.float32(np.sqrt(6.0 / np.prod(shape[1:])))
    elif name.endswith(".running_var"):
        values = 1 + np.float32(0.5) * u
    elif name.endswith(".weight") and len(shape) == 1:
        values = 1 + np.float32(0.25) * u
    else:
        values = np.float32(0.125) * u
    return values.astype(np.float32).reshape(shape)


def fill(network: torch.nn.Module) -> torch.nn.Module:
    state = network.state_dict()
    for name, value in state.items():
        if not name.endswith("num_batches_tracked"):
            state[name] = torch.from_numpy(tensor(name, tuple(value.shape)))
    network.load_state_dict(state)
    return network.eval()


class Narrow(ResNet):
    """torchvision's network with another number of channels, which its constructor fixes at 64."""

    def __init__(self, block, layers: list[int], width: int) -> None:
        torch.nn.Module.__init__(self)
        self._norm_layer = torch.nn.BatchNorm2d
        self.inplanes, self.dilation, self.groups, self.base_width = width, 1, 1, 64
        self.conv1 = torch.nn.Conv2d(3, width, kernel_size=7, stride=2, padding=3, bias=False)
        self.bn1 = torch.nn.BatchNorm2d(width)
        self.relu = torch.nn.ReLU(inplace=True)
        self.maxpool = torch.nn.MaxPool2d(kernel_size=3, stride=2, padding=1)
        self.layer1 = self._make_layer(block, width, layers[0])
        self.layer2 = self._make_layer(block, 2 * width, layers[1], stride=2)
        self.layer3 = self._make_layer(block, 4 * width, layers[2], stride=2)
        self.layer4 = self._make_layer(block, 8 * width, layers[3], stride=2)
        self.avgpool = torch.nn.AdaptiveAvgPool2d((1, 1))
        self.fc = torch.nn.Linear(8 * width * block.expansion, 2)


def images() -> torch.Tensor:
    """Images with values of about -2 to 2, as normalised images have."""
    each = [2 * numbers(f"picture.{k}", 3 * SIDE * SIDE).reshape(3, SIDE, SIDE) for k in range(IMAGES)]
    return torch.from_numpy(np.stack(each))


@torch.no_grad()
def features(network: ResNet) -> dict:
    last, network.fc = network.fc, torch.nn.Identity()
    single = network(images())
    double = network.double()(images().double())
    network.float().fc = last
    away = float((single - double).abs().max() / double.abs().max())
    # The shortest decimal that gives the same float32.
    rows = [[float(str(value)) for value in row] for row in single.numpy()]
    return {"features": rows, "float64": away}


def write(path: pathlib.Path, summary: dict) -> None:
    versions = {"torch": torch.__version__.split("+")[0], "torchvision": torchvision.__version__.split("+")[0]}
    path.write_text(json.dumps(versions | summary) + "\n")


def main(folder: pathlib.Path) -> None:
    torch.set_num_threads(1)
    network = fill(torchvision.models.resnet18(weights=None))
    shapes = {name: list(value.shape) for name, value in network.state_dict().items()}
    write(folder / "resnet18.json", {"shapes": shapes} | features(network))

    narrow = fill(Narrow(BasicBlock, [2, 2, 2, 2], 2))
    write(folder / "narrow18.json", features(narrow))
    torch.save(narrow.state_dict(), folder / "narrow18.pth")
    torch.save({"epoch": 3, "state_dict": narrow.state_dict()}, folder / "narrow18_checkpoint.pth")
    torch.save(fill(Narrow(BasicBlock, [3, 4, 6, 3], 1)).state_dict(), folder / "narrow34.pth")
    torch.save(fill(Narrow(Bottleneck, [3, 4, 6, 3], 1)).state_dict(), folder / "narrow50.pth")


if __name__ == "__main__":
    default = pathlib.Path(__file__).resolve().parent.parent / "crates/re4-encoder/tests/data"
    main(pathlib.Path(sys.argv[1]) if len(sys.argv) > 1 else default)
