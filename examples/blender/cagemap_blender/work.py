"""How a button runs cagemap: in the background, stopped by Esc, or waited for from a script."""

import re
import shutil
import subprocess
from pathlib import Path

import bpy

from .errors import RefusedError
from .outgoing import file_name


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
    """Target and source, their meshes up to date."""
    settings = context.scene.cagemap
    for role in ("target", "source"):
        thing = getattr(settings, role)
        if thing is None or thing.type != "MESH":
            raise RefusedError(f"Choose a mesh as {role}.")
        if thing.mode == "EDIT":
            thing.update_from_editmode()
    if settings.target.data == settings.source.data:
        raise RefusedError("Target and source are the same mesh. Choose two.")
    context.view_layer.update()
    return settings.target, settings.source


def pair_folder(context, made=False):
    """Where the files of this pair are."""
    settings = context.scene.cagemap
    if settings.folder.startswith("//") and not bpy.data.filepath:
        raise RefusedError("Save the .blend file first, or choose a folder: results lie beside it.")
    names = [file_name(getattr(settings, role).name) for role in ("source", "target")]
    folder = Path(bpy.path.abspath(settings.folder)) / "__".join(names)
    if not made and not (folder / "RESULT" / "map.npz").is_file():
        raise RefusedError(f"{' and '.join(names)}: are not matched yet. Press Match.")
    folder.mkdir(parents=True, exist_ok=True)
    return folder


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
            Work.running.kill()
            Work.running.wait()
            self._end(context)
            self.report({"WARNING"}, "cagemap was stopped. What was written whole stays.")
            return {"CANCELLED"}
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        if Work.running.poll() is None:
            return {"RUNNING_MODAL"}
        answer = self._guarded(context, self._next)
        if answer != {"RUNNING_MODAL"}:
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
            return {"RUNNING_MODAL"}
        return self._take(context)

    def _end(self, context):
        Work.running = None
        context.workspace.status_text_set(None)
        context.window_manager.event_timer_remove(self._timer)

    def _prepare(self, context):
        self._waiting = [[command_path(context), *map(str, given)] for given in self.commands(context)]
        self._log = pair_folder(context, made=True) / "log.txt"

    def _start(self, command):
        with self._log.open("w", encoding="utf-8") as log:
            hidden = getattr(subprocess, "CREATE_NO_WINDOW", 0)  # no console on Windows
            self._process = subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT, creationflags=hidden)
        return self._process

    def _read(self):
        self._said = self._log.read_text(encoding="utf-8", errors="replace").strip()
        if self._process.returncode != 0:
            raise RefusedError(self._said or f"cagemap ended with {self._process.returncode}. See {self._log}.")

    def _take(self, context):
        context.scene.cagemap.said = self.finish(context) or re.sub("; next: .*", "", self._said)
        for line in context.scene.cagemap.said.splitlines():
            self.report({"INFO"}, line)
        return {"FINISHED"}
