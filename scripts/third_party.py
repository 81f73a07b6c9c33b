"""Prints the licences of everything that is compiled into the wheel, for distribution with it: crates, HDF5 and Chipmunk.

    python3 scripts/third_party.py      (in the root of the repository, after the crates were fetched)

Packages with the same licence text are listed together, above the text. A package with several texts is listed above each, so every text
occurs once: repeated ones would be further apart than a compressor of wheels looks back. Texts that differ only in spaces and line ends are
the same.
"""

import json
import subprocess
from pathlib import Path

TREE = "cargo tree --locked -p re4-pipe -p re4-python --no-default-features --features re4-pipe/static-hdf5,re4-python/static-hdf5"
NAMES = ("license", "licence", "copying", "notice", "unlicense")
CHIPMUNK = Path("/usr/share/doc/libchipmunk-dev/copyright")


def output(call: list[str]) -> str:
    return subprocess.run(call, capture_output=True, text=True, check=True).stdout


def texts(folder: Path) -> list[str]:
    """The licence files of a package; HDF5's is in the package that contains its source."""
    found = [file for file in folder.iterdir() if file.name.lower().startswith(NAMES)]
    files = sorted(file for file in [*found, folder / "ext/hdf5/LICENSE"] if file.is_file())
    return [text for file in files if (text := file.read_text(errors="replace").strip())]


def main() -> None:
    tree = output([*TREE.split(), "--edges", "normal", "--prefix", "none", "--format", "{p}"])
    linked = {" ".join(line.split()[:2]) for line in tree.splitlines()}
    packages = json.loads(output(["cargo", "metadata", "--format-version", "1", "--locked", "--all-features"]))["packages"]
    by_text: dict[str, tuple[str, list[str]]] = {}

    def add(text: str, name: str) -> None:
        by_text.setdefault(" ".join(text.split()), (text, []))[1].append(name)

    for package in packages:
        if package["source"] and f"{package['name']} v{package['version']}" in linked:
            for text in texts(Path(package["manifest_path"]).parent) or [f"License: {package['license']}"]:
                add(text, f"{package['name']} {package['version']} ({package['license'] or 'see below'})")
    add(CHIPMUNK.read_text(), "Chipmunk 7 (MIT)")
    print("re4-pipe contains the following software.")
    # Versions of one licence have similar lengths, and neighbours are compressed well.
    for text, names in sorted(by_text.values(), key=lambda entry: (len(entry[0]), entry[1])):
        print("\n" + "=" * 80, "\n".join(names), "", text, sep="\n")


if __name__ == "__main__":
    main()
