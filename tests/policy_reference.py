"""Writes outputs of PyTorch networks and of diffusers' samplers as references for the tests of re4-generative, which then need
no Python.

    python tests/policy_reference.py [crates/re4-generative/tests/data]

Made with torch 2.9.0 and diffusers 0.35.2 on Python 3.11 (pip install torch==2.9.0 diffusers==0.35.2).

The networks are written here with PyTorch's own layers, after the description of Diffusion Policy's conditional 1-D U-Net and of
Streaming Flow Policy's version of it for chunks of one or two actions. Weights are not stored: both sides compute them from the
tensors' names with `numbers`. `networks.json` has, for every network, the names and shapes of its state dict and its output for
computed inputs. `samplers.json` has the result of a chain of DDPM and of DDIM with the U-Net, with computed noise.
"""

import json
import math
import pathlib
import sys
import zlib

import numpy as np
import torch
from torch import nn

BATCH = 2
CONDITION = 36
CHANNELS = 2
LEVELS = [64, 128, 256]
TIME = 128


def numbers(name: str, count: int) -> np.ndarray:
    """`count` numbers in [-1, 1) with 24 bits each, exact in float32: a hashed counter that starts at the name's CRC-32."""
    x = (np.arange(count, dtype=np.uint64) * 2654435761 + zlib.crc32(name.encode())) & 0xFFFFFFFF
    for multiplier in (0x7FEB352D, 0x846CA68B):
        x ^= x >> 15
        x = (x * multiplier) & 0xFFFFFFFF
    x ^= x >> 16
    return ((x >> 8).astype(np.float64) / 2**23 - 1).astype(np.float32)


def tensor(name: str, shape: tuple[int, ...]) -> np.ndarray:
    """Values of a parameter: weights of matrices keep the variance of the activations."""
    u = numbers(name, int(np.prod(shape)))
    if len(shape) > 1:
        values = u * np.float32(np.sqrt(3.0 / np.prod(shape[1:])))
    elif name.endswith(".weight"):
        values = 1 + np.float32(0.25) * u
    else:
        values = np.float32(0.125) * u
    return values.astype(np.float32).reshape(shape)


def fill(network: nn.Module) -> nn.Module:
    network.load_state_dict(
        {name: torch.from_numpy(tensor(name, tuple(value.shape))) for name, value in network.state_dict().items()}
    )
    return network.eval()


class Sinusoids(nn.Module):
    def forward(self, time: torch.Tensor) -> torch.Tensor:
        half = TIME // 2
        rates = torch.exp(torch.arange(half) * (-math.log(10000) / (half - 1)))
        angles = time[:, None] * rates[None]
        return torch.cat([angles.sin(), angles.cos()], dim=1)


class ConvBlock(nn.Module):
    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.block = nn.Sequential(nn.Conv1d(inputs, outputs, 5, padding=2), nn.GroupNorm(8, outputs), nn.Mish())

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return self.block(x)


class ResidualBlock(nn.Module):
    def __init__(self, inputs: int, outputs: int, condition: int) -> None:
        super().__init__()
        self.blocks = nn.ModuleList([ConvBlock(inputs, outputs), ConvBlock(outputs, outputs)])
        self.cond_encoder = nn.Sequential(nn.Mish(), nn.Linear(condition, 2 * outputs))
        self.residual_conv = nn.Conv1d(inputs, outputs, 1) if inputs != outputs else nn.Identity()

    def forward(self, x: torch.Tensor, condition: torch.Tensor) -> torch.Tensor:
        scale, shift = self.cond_encoder(condition).unsqueeze(2).chunk(2, dim=1)
        hidden = self.blocks[1](self.blocks[0](x) * scale + shift)
        return hidden + self.residual_conv(x)


class Resample(nn.Module):
    """Halves or doubles the length by a convolution, or keeps it by a linear layer over all numbers."""

    def __init__(self, conv: nn.Module) -> None:
        super().__init__()
        self.conv = conv

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        if isinstance(self.conv, nn.Linear):
            # The numbers are ordered by time, then by channel.
            flat = self.conv(x.transpose(1, 2).flatten(1))
            return flat.reshape(x.shape[0], x.shape[2], x.shape[1]).transpose(1, 2)
        return self.conv(x)


class UNet(nn.Module):
    def __init__(self, length: int) -> None:
        super().__init__()
        condition = TIME + CONDITION
        flat = length < 4

        def resample(channels: int, down: bool) -> nn.Module:
            if flat:
                return Resample(nn.Linear(length * channels, length * channels))
            if down:
                return Resample(nn.Conv1d(channels, channels, 3, stride=2, padding=1))
            return Resample(nn.ConvTranspose1d(channels, channels, 4, stride=2, padding=1))

        self.diffusion_step_encoder = nn.Sequential(
            Sinusoids(), nn.Linear(TIME, 4 * TIME), nn.Mish(), nn.Linear(4 * TIME, TIME)
        )
        pairs = list(zip([CHANNELS, *LEVELS[:-1]], LEVELS))
        self.down_modules = nn.ModuleList()
        for level, (inputs, outputs) in enumerate(pairs):
            modules = [ResidualBlock(inputs, outputs, condition), ResidualBlock(outputs, outputs, condition)]
            if level + 1 < len(pairs):
                modules.append(resample(outputs, down=True))
            self.down_modules.append(nn.ModuleList(modules))
        self.mid_modules = nn.ModuleList([ResidualBlock(LEVELS[-1], LEVELS[-1], condition) for _ in range(2)])
        self.up_modules = nn.ModuleList(
            nn.ModuleList(
                [
                    ResidualBlock(2 * outputs, inputs, condition),
                    ResidualBlock(inputs, inputs, condition),
                    resample(inputs, down=False),
                ]
            )
            for inputs, outputs in reversed(pairs[1:])
        )
        self.final_conv = nn.Sequential(ConvBlock(LEVELS[0], LEVELS[0]), nn.Conv1d(LEVELS[0], CHANNELS, 1))

    def forward(self, chunks: torch.Tensor, time: torch.Tensor, condition: torch.Tensor) -> torch.Tensor:
        x = chunks.transpose(1, 2)
        condition = torch.cat([self.diffusion_step_encoder(time), condition], dim=1)
        skips = []
        for modules in self.down_modules:
            x = modules[1](modules[0](x, condition), condition)
            skips.append(x)
            if len(modules) == 3:
                x = modules[2](x)
        for module in self.mid_modules:
            x = module(x, condition)
        for first, second, up in self.up_modules:
            x = torch.cat([x, skips.pop()], dim=1)
            x = up(second(first(x, condition), condition))
        return self.final_conv(x).transpose(1, 2)


class MlpBlock(nn.Module):
    def __init__(self, condition: int, width: int) -> None:
        super().__init__()
        self.film = nn.Linear(condition, 2 * width)
        self.first = nn.Linear(width, width)
        self.second = nn.Linear(width, width)

    def forward(self, x: torch.Tensor, condition: torch.Tensor) -> torch.Tensor:
        scale, shift = self.film(condition).chunk(2, dim=1)
        return x + self.second(torch.relu(self.first(x) * (1 + scale) + shift))


class Mlp(nn.Module):
    def __init__(self, length: int) -> None:
        super().__init__()
        width, numbers_ = 512, length * CHANNELS
        self.time = nn.Sequential(Sinusoids(), nn.Linear(TIME, 4 * TIME), nn.Mish(), nn.Linear(4 * TIME, TIME))
        self.input = nn.Linear(numbers_ + CONDITION, width)
        self.blocks = nn.ModuleList([MlpBlock(TIME + CONDITION, width) for _ in range(4)])
        self.output = nn.Linear(width, numbers_)

    def forward(self, chunks: torch.Tensor, time: torch.Tensor, condition: torch.Tensor) -> torch.Tensor:
        x = self.input(torch.cat([chunks.flatten(1), condition], dim=1))
        condition = nn.functional.mish(torch.cat([self.time(time), condition], dim=1))
        for block in self.blocks:
            x = block(x, condition)
        return self.output(torch.relu(x)).reshape(chunks.shape)


def inputs(length: int, times: list[float]) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    chunks = numbers("chunks", BATCH * length * CHANNELS).reshape(BATCH, length, CHANNELS)
    condition = numbers("condition", BATCH * CONDITION).reshape(BATCH, CONDITION)
    return torch.from_numpy(chunks), torch.tensor(times), torch.from_numpy(condition)


def flat(values: torch.Tensor) -> list[float]:
    return [float(value) for value in values.flatten()]


@torch.no_grad()
def networks() -> list[dict]:
    cases = []
    for name, make in [("small", UNet), ("mlp", Mlp)]:
        for length, times in [(16, [3.0, 77.0]), (1, [0.25, 0.8]), (2, [0.0, 0.5])]:
            network = fill(make(length))
            cases.append(
                {
                    "network": name,
                    "length": length,
                    "times": times,
                    "state": {key: list(value.shape) for key, value in network.state_dict().items()},
                    "output": flat(network(*inputs(length, times))),
                }
            )
    return cases


@torch.no_grad()
def samplers() -> dict:
    # Here, because benches/policy_rate.py uses the networks without diffusers.
    import diffusers.schedulers.scheduling_ddpm as ddpm
    from diffusers import DDIMScheduler, DDPMScheduler

    settings = {
        "num_train_timesteps": 100,
        "beta_schedule": "squaredcos_cap_v2",
        "clip_sample": True,
        "prediction_type": "epsilon",
    }
    network = fill(UNet(16))
    _, _, condition = inputs(16, [0.0, 0.0])
    count = BATCH * 16 * CHANNELS
    results = {}
    chains = {
        "ddpm": (DDPMScheduler(variance_type="fixed_small", **settings), 100),
        "ddim": (DDIMScheduler(set_alpha_to_one=True, steps_offset=0, **settings), 10),
    }
    for name, (scheduler, steps) in chains.items():
        scheduler.set_timesteps(steps)
        # Noise of the start is numbered 0, and that of later steps from 1.
        calls = iter(range(1, 200))
        ddpm.randn_tensor = lambda shape, **_: torch.from_numpy(numbers(f"noise{next(calls)}", count).reshape(shape))
        x = torch.from_numpy(numbers("noise0", count).reshape(BATCH, 16, CHANNELS))
        for time in scheduler.timesteps:
            noise = network(x, torch.full((BATCH,), float(time)), condition)
            x = scheduler.step(noise, time, x).prev_sample
        results[name] = flat(x)
    return results


def main() -> None:
    folder = pathlib.Path(sys.argv[1] if len(sys.argv) > 1 else "crates/re4-generative/tests/data")
    folder.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(1)
    (folder / "networks.json").write_text(json.dumps(networks()) + "\n")
    (folder / "samplers.json").write_text(json.dumps(samplers()) + "\n")


if __name__ == "__main__":
    main()
