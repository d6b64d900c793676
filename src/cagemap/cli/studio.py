"""`cagemap studio`: checks options and serves the page."""

from __future__ import annotations

from pathlib import Path

from cagemap.cli.console import say
from cagemap.errors import ParameterError
from cagemap.studio.opening import BUILT_IN_FOLDER, built_in_files, command_line_files
from cagemap.tasks.progress import Stages, SummaryAndWarnings
from cagemap.tasks.requests.catalogue import all_options
from cagemap.tasks.requests.studio import StudioRequest


def run_studio(request: StudioRequest, stages: Stages) -> SummaryAndWarnings:
    """Serve the studio until interrupted."""
    try:
        from cagemap.studio.page.app import PageRequest, run_page
    except ModuleNotFoundError as error:
        raise ParameterError(
            f"the studio needs {error.name}, which is not installed. Run pip install 'cagemap[studio]'."
        ) from None
    paths = (request.target, request.source, request.landmarks, request.texture)
    for path in request.folder:
        if not path.is_dir():
            raise ParameterError(f"--folder {path}: expected a folder, found none. Check the name.")
    schemes = request.target_scheme or request.scheme, request.source_scheme or request.scheme
    parts = request.target_part or request.part, request.source_part or request.part
    files = command_line_files(*paths, request.result, schemes, parts)
    if files is None:
        folders = request.folder or (BUILT_IN_FOLDER, Path.cwd())
        if not request.folder:
            say(f"No models named: the built-in pair opens (in {BUILT_IN_FOLDER}); choose yours from here on the left.")
        files = built_in_files(folders[0]) if not request.folder else None
    else:
        for model in (files.target, files.source):
            if not model.is_file():
                raise ParameterError(f"{model}: expected a mesh file, found none. Check the name.")
        recorded = files.recorded_match.files if files.recorded_match else ()
        input_paths = (files.landmarks, files.target, files.source, files.texture, files.result, *recorded)
        folders = (*request.folder, *(path.parent for path in input_paths if path is not None))
    serving = request.host, request.port, request.vertices, not request.no_browser
    page = PageRequest(files, all_options(), folders, *serving)
    run_page(page, say)
    return "", []
