"""Packs the Python package, the extension module and the native command into a wheel. Needs only Python 3.11's standard library; with
the package zopfli, the wheel is smaller.

    python3 pack_wheel.py COMMAND EXTENSION FOLDER [NOTICES]

COMMAND is the program re4-pipe and EXTENSION the library libre4_python.so; both should be stripped. NOTICES has the licences of the
software that they contain. The path of the wheel is printed. The same files and the same compressor give the same bytes.

The command and the extension are built by one call of cargo, so that they share the dependencies. A build tool for extension
modules would compile them a second time, with other features.
"""

import base64
import hashlib
import re
import struct
import sys
import zlib
from pathlib import Path

import tomllib

HERE = Path(__file__).resolve().parent


def version() -> str:
    workspace = tomllib.loads((HERE / "../../Cargo.toml").read_text())
    return workspace["workspace"]["package"]["version"]


def platform(binaries: list[bytes]) -> str:
    """The tag of the oldest system on which the binaries run, by the versions of glibc's functions that they use."""
    minors = [int(minor) for binary in binaries for minor in re.findall(rb"GLIBC_2\.(\d+)", binary)]
    return f"manylinux_2_{max(minors)}_x86_64"


def metadata(project: dict) -> str:
    lines = [
        "Metadata-Version: 2.4",
        f"Name: {project['name']}",
        f"Version: {version()}",
        f"Summary: {project['description']}",
        f"License-Expression: {project['license']}",
        "License-File: LICENSE-APACHE",
        "License-File: LICENSE-MIT",
        f"Keywords: {','.join(project['keywords'])}",
        f"Requires-Python: {project['requires-python']}",
        *(f"Requires-Dist: {need}" for need in project["dependencies"]),
    ]
    for extra, needs in project["optional-dependencies"].items():
        lines.append(f"Provides-Extra: {extra}")
        lines += [f'Requires-Dist: {need}; extra == "{extra}"' for need in needs]
    lines.append("Description-Content-Type: text/markdown")
    return "\n".join(lines) + "\n\n" + (HERE / project["readme"]).read_text()


def deflated(content: bytes) -> bytes:
    """The content as a stream of deflate, without header and checksum."""
    try:
        from zopfli.zopfli import compress
    except ImportError:
        return zlib.compress(content, 9)[2:-4]
    # On the first 4 MB of the command, 15 iterations made it 0.2 % smaller.
    return compress(content, numiterations=1)[2:-4]


class Wheel:
    """A zip file. The module zipfile of Python has no choice of compressors."""

    def __init__(self, path: Path) -> None:
        self.file = path.open("wb")
        self.directory: list[bytes] = []
        self.record: list[str] = []

    def add(self, name: str, content: bytes, mode: int = 0o644) -> None:
        digest = base64.urlsafe_b64encode(hashlib.sha256(content).digest()).rstrip(b"=").decode()
        self.record.append(f"{name},sha256={digest},{len(content)}")
        self.write(name, content, mode)

    def write(self, name: str, content: bytes, mode: int) -> None:
        offset = self.file.tell()
        data = deflated(content)
        path = name.encode("ascii")
        # Version 2.0, no flags, deflate, and a fixed time (1980-01-01), so that the same files give the same wheel.
        common = struct.pack("<5H3I2H", 20, 0, 8, 0, 0x21, zlib.crc32(content), len(data), len(content), len(path), 0)
        self.file.write(b"PK\x03\x04" + common + path + data)
        # Written on Unix: the upper half of the attributes is the mode of a regular file.
        rest = struct.pack("<3H2I", 0, 0, 0, (0o100000 | mode) << 16, offset)
        self.directory.append(b"PK\x01\x02" + struct.pack("<H", 3 << 8 | 20) + common + rest + path)

    def close(self) -> None:
        offset = self.file.tell()
        directory = b"".join(self.directory)
        count = len(self.directory)
        end = struct.pack("<4H2IH", 0, 0, count, count, len(directory), offset, 0)
        self.file.write(directory + b"PK\x05\x06" + end)
        self.file.close()


def main() -> None:
    command, extension, folder, *notices = map(Path, sys.argv[1:])
    project = tomllib.loads((HERE / "pyproject.toml").read_text())["project"]
    binaries = [command.read_bytes(), extension.read_bytes()]
    minor = project["requires-python"].removeprefix(">=3.")
    tag = f"cp3{minor}-abi3-{platform(binaries)}"
    name = project["name"].replace("-", "_")
    stem = f"{name}-{version()}"
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{stem}-{tag}.whl"
    # An incomplete wheel never has the name of one.
    part = path.with_suffix(".part")
    wheel = Wheel(part)
    package = HERE / "python"
    for file in sorted((package / name).rglob("*")):
        if file.is_file() and "__pycache__" not in file.parts and file.suffix != ".so":
            wheel.add(file.relative_to(package).as_posix(), file.read_bytes())
    wheel.add(f"{name}/_native.abi3.so", binaries[1], 0o755)
    wheel.add(f"{stem}.data/scripts/re4-pipe", binaries[0], 0o755)
    info = f"{stem}.dist-info"
    wheel.add(f"{info}/METADATA", metadata(project).encode())
    wheel.add(f"{info}/WHEEL", f"Wheel-Version: 1.0\nGenerator: pack_wheel\nRoot-Is-Purelib: false\nTag: {tag}\n".encode())
    for licence in ("LICENSE-APACHE", "LICENSE-MIT"):
        wheel.add(f"{info}/licenses/{licence}", (HERE / "../.." / licence).read_bytes())
    for file in notices:
        wheel.add(f"{info}/licenses/THIRD-PARTY.txt", file.read_bytes())
    wheel.write(f"{info}/RECORD", "\n".join([*wheel.record, f"{info}/RECORD,,", ""]).encode(), 0o644)
    wheel.close()
    part.replace(path)
    print(path)


if __name__ == "__main__":
    main()
