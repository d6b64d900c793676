"""FBX files as GLB, converted in a child process, so that a crash of the library becomes an error message."""

from __future__ import annotations

import importlib.util
import json
import logging
import re
import subprocess
import sys
from pathlib import Path

from cagemap.errors import FormatError
from cagemap.files.text import find_image, read_bytes

_log = logging.getLogger(__name__)

_REMEDY = "Export it again as binary FBX 7.4, or as GLB."
# Time limit in seconds: a fixed part, and a part for each megabyte.
_SECONDS, _SECONDS_A_MEGABYTE = 50.0, 1.0
# The child imports from the same paths as this process.
_CHILD = "import json, sys; sys.path[:] = json.loads(sys.argv[1]); from cagemap.files.fbx.convert import main; main()"
_IMAGE_SUFFIX = re.compile(rb"(?i)\.(?:png|jpe?g|tga|tiff?|bmp|exr|hdr|dds|psd|gif|webp)")
_NO_PATH = re.compile(rb'[\x00-\x1f"*:<>?|]')  # characters that no path has
_LONGEST_PATH = 500
# Exit status of the child after it wrote an error message.
REFUSED = 3


def fbx_as_glb(path: Path) -> bytes:
    """An FBX file as GLB: in metres, Y up, with marked polygons (FB_ngon_encoding)."""
    content = read_bytes(path, "an FBX file")
    if importlib.util.find_spec("ufbx") is None:
        raise FormatError(f"{path}: FBX needs the package ufbx. Install cagemap[fbx], or export the file as GLB.")
    limit = _SECONDS + _SECONDS_A_MEGABYTE * len(content) / 1e6
    command = [sys.executable, "-P", "-c", _CHILD, json.dumps(sys.path), str(path)]
    try:
        done = subprocess.run(command, input=content, capture_output=True, timeout=limit, check=False)
    except subprocess.TimeoutExpired:
        raise FormatError(f"{path}: took more than {limit:.0f} s to read and was given up. {_REMEDY}") from None
    messages = done.stderr.decode(errors="replace").strip()
    if done.returncode == REFUSED:
        raise FormatError(f"{path}: cannot be read as FBX ({messages.splitlines()[-1]}). {_REMEDY}")
    if done.returncode != 0:
        _log.debug("%s: %s", path, messages)
        raise FormatError(f"{path}: the FBX library stopped while it read the file ({done.returncode}). {_REMEDY}")
    for line in messages.splitlines():
        _log.warning("%s: %s", path, line)
    return done.stdout


def find_textures(path: Path) -> list[Path]:
    """Existing textures whose names an FBX file contains; found without reading its scene."""
    content = read_bytes(path, "an FBX file")
    ends = (content[max(0, found.start() - _LONGEST_PATH) : found.end()] for found in _IMAGE_SUFFIX.finditer(content))
    names = dict.fromkeys(_NO_PATH.split(text)[-1].decode(errors="replace") for text in ends)
    return [file for name in names if (file := find_image(path, name)) is not None]
