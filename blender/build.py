"""Build the extension for Blender: one zip file for each platform, with all wheels inside.

``python blender/build.py [-o FOLDER] [PLATFORM ...]`` needs pip and hatchling (`make blender`). Wheels come from the
package index that pip is set up for; cagemap's own is built from this tree.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import tomllib
import zipfile
from pathlib import Path

ROOT = Path(__file__).parent.parent
EXTENSION = ROOT / "blender" / "cagemap_blender"
# What `cagemap_blender.worker` imports; the other dependencies read files, draw and serve the command line.
NEEDED = ("scipy", "numba", "rslab", "fast-simplification", "threadpoolctl")
# Blender brings numpy; packages are chosen for that of its oldest version here, 4.2, and not packed.
BLENDERS_NUMPY = "numpy==1.24.3"
PYTHON = "3.11"  # of Blender 4.2 to 5.0
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


def download(platform: str, folder: Path) -> None:
    """Put the wheels of one platform into a folder."""
    tags = [word for tag in PLATFORMS[platform] for word in ("--platform", tag)]
    version = ["--python-version", PYTHON, "--implementation", "cp", "--only-binary=:all:"]
    _pip("download", "-d", str(folder), *tags, *version, *requirements(), BLENDERS_NUMPY)
    for wheel in folder.glob("numpy-*.whl"):
        wheel.unlink()


def build(platform: str, own: Path, folder: Path) -> Path:
    """Write the zip file of one platform; returns its path."""
    manifest = (EXTENSION / "blender_manifest.toml").read_text(encoding="utf-8")
    version = tomllib.loads(manifest)["version"]
    output = folder / f"cagemap-{version}-{platform}.zip"
    with tempfile.TemporaryDirectory() as scratch:
        download(platform, Path(scratch))
        wheels = [own, *sorted(Path(scratch).glob("*.whl"))]
        listed = ",\n".join(f'  "./wheels/{wheel.name}"' for wheel in wheels)
        whole = f'platforms = ["{platform}"]\nwheels = [\n{listed},\n]\n{manifest}'
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
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "dist")
    asked = parser.parse_args()
    asked.output.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as scratch:
        _pip("wheel", "--no-deps", "-w", scratch, str(ROOT))
        (own,) = Path(scratch).glob("cagemap-*.whl")
        for platform in asked.platforms or PLATFORMS:
            output = build(platform, own, asked.output)
            print(f"{output}: {output.stat().st_size / 1e6:.0f} MB")


if __name__ == "__main__":
    main()
