"""Run a job on a disk of its own that fills up, and again with room, in a mount namespace.

Prints what both runs said, and what lay on the disk after each, as JSON. The disk is a tmpfs that nobody else sees and
that is gone with the process.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

from typer.testing import CliRunner

from cagemap.cli.app import app
from cagemap.errors import CagemapError
from cagemap.files.result import read_result


def state(disk: Path) -> dict[str, Any]:
    """What lies on the disk: which results are whole, and files that only a write in progress has."""
    whole = {}
    for folder in sorted(disk.glob("night/*/RESULT")):
        try:
            whole[folder.parent.name] = read_result(folder).image().ravel()[:3000].tolist()
        except CagemapError as error:
            whole[folder.parent.name] = str(error)
    return {"results": whole, "temporary": [str(p) for p in disk.rglob(".*.part*")]}


def run(job: Path) -> dict[str, Any]:
    """The job's exit code and words."""
    said = CliRunner().invoke(app, ["run", str(job), "--workers", "2"])
    return {"code": said.exit_code, "said": said.output}


def main(folder: Path, size: str, room: int) -> None:
    """Mount the disk, leave so many bytes free, run, make room, run again."""
    disk = folder / "disk"
    disk.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(disk)], check=True)
    ballast = disk / "ballast"
    free = int(
        subprocess.run(["df", "-B1", "--output=avail", str(disk)], check=True, capture_output=True).stdout.split()[1]
    )
    ballast.write_bytes(b"\1" * (free - room))
    full = run(folder / "job.toml") | state(disk)
    ballast.unlink()
    roomy = run(folder / "job.toml") | state(disk)
    Path(folder / "said.json").write_text(json.dumps({"full": full, "roomy": roomy}))


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2], int(sys.argv[3]))
