"""Build the extension for Blender: one zip file for each platform and Python of Blender, with all wheels inside.

``python blender/build.py [-o FOLDER] [--python VERSION] [PLATFORM ...]`` needs pip and hatchling (`make blender`).
Wheels come from the package index that pip is set up for; cagemap's own is built from this tree.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import tomllib
import zipfile
from itertools import product
from pathlib import Path

ROOT = Path(__file__).parent.parent
EXTENSION = ROOT / "blender" / "cagemap_blender"
# What `cagemap_blender.worker` imports; the other dependencies read files, draw and serve the command line.
NEEDED = ("scipy", "numba", "rslab", "fast-simplification", "threadpoolctl")
# Blender's versions by their Python: the first one, and the first that has another Python; the oldest numpy among them,
# which Blender brings: packages are chosen for it, and it is not packed.
BLENDERS = {"3.11": ("4.2.0", "5.1.0", "numpy==1.24.3"), "3.13": ("5.1.0", None, "numpy==2.2.0")}
# Blender's names of platforms, and the tags of wheels that run there.
PLATFORMS = {
    "windows-x64": ("win_amd64",),
    "macos-arm64": ("macosx_11_0_arm64", "macosx_12_0_arm64"),
    "macos-x64": tuple(f"macosx_{version}_x86_64" for version in ("10_9", "10_12", "10_13", "10_14", "10_15", "11_0")),
    "linux-x64": tuple(f"manylinux{version}_x86_64" for version in ("2014", "_2_17", "_2_24", "_2_27", "_2_28")),
}


def requirements() -> list[str]:
    """The needed dependencies, as pyproject.toml asks for them."""
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["dependencies"]
    found = [line.partition(";")[0].strip() for line in declared]
    return [line for name in NEEDED for line in found if line.startswith(name)]


def download(platform: str, python: str, folder: Path) -> None:
    """Put the wheels of one platform and Python into a folder."""
    tags = [word for tag in PLATFORMS[platform] for word in ("--platform", tag)]
    version = ["--python-version", python, "--implementation", "cp", "--only-binary=:all:"]
    _pip("download", "-d", str(folder), *tags, *version, *requirements(), BLENDERS[python][2])
    for wheel in folder.glob("numpy-*.whl"):
        wheel.unlink()


def build(platform: str, python: str, own: Path, folder: Path) -> Path:
    """Write the zip file of one platform and Python; returns its path."""
    manifest = (EXTENSION / "blender_manifest.toml").read_text(encoding="utf-8")
    version = tomllib.loads(manifest)["version"]
    first, end, _ = BLENDERS[python]
    output = folder / f"cagemap-{version}-blender-{first[:3]}-{platform}.zip"
    with tempfile.TemporaryDirectory() as scratch:
        download(platform, python, Path(scratch))
        wheels = [own, *sorted(Path(scratch).glob("*.whl"))]
        listed = ",\n".join(f'  "./wheels/{wheel.name}"' for wheel in wheels)
        versions = f'blender_version_min = "{first}"\n' + (f'blender_version_max = "{end}"\n' if end else "")
        whole = f'platforms = ["{platform}"]\nwheels = [\n{listed},\n]\n{versions}{manifest}'
        with zipfile.ZipFile(output.with_suffix(".part"), "w", zipfile.ZIP_DEFLATED) as made:
            made.writestr("blender_manifest.toml", whole)
            made.write(ROOT / "LICENSE", "LICENSE")
            for file in sorted(EXTENSION.glob("*.py")):
                made.write(file, file.name)
            for wheel in wheels:
                made.write(wheel, f"wheels/{wheel.name}", zipfile.ZIP_STORED)
    output.with_suffix(".part").replace(output)
    return output


def _pip(*words: str) -> None:
    subprocess.run([sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check", *words], check=True)


def main() -> None:
    """Build what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("platforms", nargs="*", choices=[*PLATFORMS, []], metavar="PLATFORM", help=", ".join(PLATFORMS))
    parser.add_argument("--python", choices=BLENDERS, help="of one kind of Blender only")
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "dist")
    asked = parser.parse_args()
    asked.output.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as scratch:
        _pip("wheel", "--no-deps", "-w", scratch, str(ROOT))
        (own,) = Path(scratch).glob("cagemap-*.whl")
        for python, platform in product([asked.python] if asked.python else BLENDERS, asked.platforms or PLATFORMS):
            output = build(platform, python, own, asked.output)
            print(f"{output}: {output.stat().st_size / 1e6:.0f} MB")


if __name__ == "__main__":
    main()
