"""How a button runs cagemap: in the background, stopped by Esc, or waited for from a script."""

import json
import os
import re
import shutil
import subprocess
from pathlib import Path

import bpy
import numpy as np

from .errors import RefusedError
from .incoming import require_rows
from .outgoing import TO_FILE, file_name


def command_path(context):
    """The cagemap command: as the add-on's preferences say, else the first on the PATH."""
    addon = context.preferences.addons.get(__package__)
    given = addon.preferences.command if addon else "cagemap"
    found = shutil.which(bpy.path.abspath(given)) or shutil.which(given)
    if found is None:
        raise RefusedError(
            f"{given}: no such command. Install cagemap and give its path in the preferences of this add-on."
        )
    return found


def sides(context):
    """Target and source, as they stand."""
    settings = context.scene.cagemap
    for role in ("target", "source"):
        thing = getattr(settings, role)
        if thing is None or thing.type != "MESH":
            raise RefusedError(f"Choose a mesh as {role}.")
        if thing.mode == "EDIT":  # what modifiers make of it is not known there, and groups cannot be written
            raise RefusedError(f"{thing.name}: is in Edit Mode. Leave it (Tab), and press the button again.")
    if settings.target.data == settings.source.data:
        raise RefusedError("Target and source are the same mesh. Choose two.")
    context.view_layer.update()
    return settings.target, settings.source


def pair_folder(context, made=False):
    """Where the files of this pair are; unless it is being made, both are as they were matched."""
    target, source = sides(context)
    place = context.scene.cagemap.folder or "//cagemap"
    if place.startswith("//") and not bpy.data.filepath:
        raise RefusedError("Save the .blend file first, or choose a folder: results lie beside it.")
    folder = Path(bpy.path.abspath(place)).resolve() / f"{file_name(source.name)}__{file_name(target.name)}"
    if not made:
        if not (folder / "RESULT" / "map.npz").is_file():
            raise RefusedError(f"{source.name} and {target.name}: are not matched yet. Press Match.")
        for thing, role in ((target, "target"), (source, "source")):
            require_rows(thing, written_vertices(folder / f"{role}.obj"))
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def written_vertices(path):
    """How many vertices an OBJ file has."""
    with path.open(encoding="utf-8") as lines:
        return sum(line.startswith("v ") for line in lines)


def write_placements(folder, things):
    """Note how objects stand as they are matched: what comes back is turned by that, wherever they stand then."""
    rows = {role: [list(row) for row in (TO_FILE @ thing.matrix_world).to_3x3()] for role, thing in things.items()}
    (folder / "placements.json").write_text(json.dumps(rows), encoding="utf-8")


def placement(folder, role):
    """(3, 3) turn and scale from an object to the files, as it was matched."""
    return np.array(json.loads((folder / "placements.json").read_text(encoding="utf-8"))[role])


@bpy.app.handlers.persistent
def stop(*_):
    """End what runs; another file that is opened would leave it to nobody."""
    if Work.running is not None and Work.running.poll() is None:
        Work.running.kill()
        Work.running.wait()
    Work.running = None


class Work:
    """A button: commands of cagemap one after another, in the background, and then their results into the scene."""

    bl_options = frozenset({"REGISTER", "UNDO"})
    running = None

    def commands(self, context):
        """Write what the commands read; arguments of each."""
        raise NotImplementedError

    def finish(self, context):
        """Take what they wrote; what to say, or None for what the last command said."""
        return None

    def execute(self, context):
        """From a script: wait for it."""
        return self._guarded(context, self._all)

    def invoke(self, context, event):
        """From a button: Blender goes on meanwhile; Esc stops it."""
        if Work.running is not None:
            self.report({"ERROR"}, "cagemap is at work already. Wait, or press Esc in the 3D view.")
            return {"CANCELLED"}
        return self._guarded(context, self._begin)

    def modal(self, context, event):
        """Look now and then whether the command is done."""
        if event.type == "ESC":
            self._end(context)
            self.report({"WARNING"}, "cagemap was stopped. What was written whole stays.")
            return {"CANCELLED"}
        if event.type != "TIMER" or self._process.poll() is None:
            return {"PASS_THROUGH"}
        answer = {"CANCELLED"}
        try:
            answer = self._guarded(context, self._next)
        finally:  # also after a fault of ours: without it the buttons would stay grey
            if answer != {"PASS_THROUGH"}:
                self._end(context)
        return answer

    def _guarded(self, context, step):
        try:
            return step(context)
        except (RefusedError, OSError) as error:
            context.scene.cagemap.said = ""
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}

    def _all(self, context):
        self._prepare(context)
        while self._waiting:
            self._start(self._waiting.pop(0)).wait()
            self._read()
        return self._take(context)

    def _begin(self, context):
        self._prepare(context)
        Work.running = self._start(self._waiting.pop(0))
        self._timer = context.window_manager.event_timer_add(0.2, window=context.window)
        context.window_manager.modal_handler_add(self)
        context.workspace.status_text_set(f"{self.bl_label}: cagemap is at work. Esc stops it.")
        return {"RUNNING_MODAL"}

    def _next(self, context):
        self._read()
        if self._waiting:
            Work.running = self._start(self._waiting.pop(0))
            return {"PASS_THROUGH"}
        return self._take(context)

    def _end(self, context):
        stop()
        context.workspace.status_text_set(None)
        context.window_manager.event_timer_remove(self._timer)

    def _prepare(self, context):
        self._waiting = [[command_path(context), *map(str, given)] for given in self.commands(context)]
        self._log = pair_folder(context, made=True) / "log.txt"
        self._pair = [thing.name for thing in sides(context)]

    def _start(self, command):
        with self._log.open("w", encoding="utf-8") as log:
            hidden = getattr(subprocess, "CREATE_NO_WINDOW", 0)  # no console on Windows
            words = {**os.environ, "PYTHONUTF8": "1"}  # names in the log as they are read from it
            self._process = subprocess.Popen(
                command, stdout=log, stderr=subprocess.STDOUT, creationflags=hidden, env=words
            )
        return self._process

    def _read(self):
        self._said = self._log.read_text(encoding="utf-8", errors="replace").strip()
        if self._process.returncode != 0:
            raise RefusedError(self._said or f"cagemap ended with {self._process.returncode}. See {self._log}.")

    def _take(self, context):
        if [thing.name for thing in sides(context)] != self._pair:
            raise RefusedError(
                f"Other objects were chosen meanwhile than {' and '.join(self._pair)}. Choose them again."
            )
        pair_folder(context)
        context.scene.cagemap.said = self.finish(context) or re.sub("; next: .*", "", self._said)
        for line in context.scene.cagemap.said.splitlines():
            self.report({"INFO"}, line)
        return {"FINISHED"}
