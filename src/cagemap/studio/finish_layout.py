"""Which options of the command line the page shows, where and under which words, and which it does not, and why."""

from __future__ import annotations

import re
from dataclasses import dataclass

from cagemap.files.gltf.document import SCENE_SUFFIXES
from cagemap.files.usd.read import USD_SUFFIXES
from cagemap.studio.finish import SHARED
from cagemap.studio.workspace import IMAGES, MESHES, TABLES
from cagemap.tasks.requests.catalogue import Key, Options

# Stands for folders that hold files of the other endings.
FOLDERS = "/"


@dataclass(frozen=True)
class Field:
    """One option on the page.

    Attributes
    ----------
    key : (command, field)
    label : str
    suffixes : tuple of str
        Of the files to choose from.
    hint : str
        In place of the command line's own words.
    step : float
        By which a number changes.
    """

    key: Key
    label: str
    suffixes: tuple[str, ...] = ()
    hint: str = ""
    step: float = 1.0


@dataclass(frozen=True)
class Fold:
    """Options that are folded up together."""

    title: str
    fields: tuple[Field, ...]


def _of(command: str, *fields: tuple[object, ...]) -> tuple[Field, ...]:
    return tuple(Field((command, str(name)), *others) for name, *others in fields)  # type: ignore[arg-type]


MORE_IMAGES, DETAIL, RIG, WRAP, MATCH, MASKS, FILES, ADVANCED = (
    "More images",
    "Detailed mesh",
    "Rig",
    "Wrap",
    "Match",
    "Masks and UV sets",
    "Files",
    "Advanced",
)
_RIGGED = (*USD_SUFFIXES, *SCENE_SUFFIXES)
_VALUES = (*TABLES, ".json", *USD_SUFFIXES)
_HELD = "the target's own, kept outside the masks: FILE under the texture, NAME=FILE under another (normal map, ao)"
_MASK = "match and bake only this: a part's name, or a file; not:... for all but that"
FOLDS = (
    Fold(
        MORE_IMAGES,
        _of(
            "transfer",
            ("normal_map", "Normal map", IMAGES, "of the source; its directions turn with the map"),
            ("space", "Space", (), "of normals and vectors: tangent (MikkTSpace) or object"),
            ("green", "Green", (), "of normal maps: up (OpenGL, Blender) or down (DirectX)"),
            ("displacement", "Displacement", IMAGES, "height along the source's normal"),
            ("vector_displacement", "Vectors", IMAGES, "vector displacement of the source"),
            ("scale", "Height scale", (), "in the source's units: height between the values 0 and 1", 0.001),
            ("midlevel", "Mid level", (), "value that means no height; empty: 0.5 for integers, 0 for floats"),
            ("material_colors", "Material colours", (), "those of the source's materials, as an image"),
            ("as_color", "As a picture", (), "carry as colours what looks like a normal map"),
            ("filter", "Sharpness", (), "smooth or linear; nearest for labels and ID maps, whose colours must not mix"),
        ),
    ),
    Fold(
        DETAIL,
        _of(
            "transfer",
            ("detail", "Mesh", MESHES, "a scan or sculpt that lies on the source; without it its own ao and colors"),
            ("detail_texture", "Its image", IMAGES, "the detailed mesh's own image, for texture"),
            ("bake", "Bake", (), "from the detailed mesh into the target's layout"),
            ("rays", "Rays", (), "of ambient occlusion, for every vertex of the mesh"),
        ),
    ),
    Fold(
        RIG,
        _of(
            "transfer",
            ("weights", "Skin weights", (".csv", ".npz", *_RIGGED), "of the source's cage, a column a joint"),
            ("influences", "Influences", (), "joints a vertex at most; 0: all"),
            ("only", "Joints carried", (), "names with commas; the target's own weights stay for all others"),
            ("mirror", "Both sides alike", (), "by left and right in the joints' names"),
            ("joints", "Joints", (".json", *_RIGGED), "skeleton of the source"),
            ("blend_shapes", "Blend shapes", (".obj", ".npz", *_RIGGED, FOLDERS), "of the source's cage"),
            (
                "passenger",
                "Passenger",
                (".obj", ".ply", *_RIGGED),
                "clothes, eyes, hair or a prop that sit on the source",
            ),
            ("kind", "Keeps shape", (), "cloth, rigid or similarity; empty: as the passenger's pieces look"),
            ("attribute", "Attribute", _VALUES, "any values at the source's vertices, faces or corners; vertex groups"),
        ),
    ),
    Fold(
        WRAP,
        _of(
            "wrap",
            ("amount", "Amount", (), "0: the target's own shape, 1: the source's", 0.05),
            ("fit_level", "Fit level", (), "0 moves the control points, 1 or more the refined net of that level"),
            ("fairness", "Fairness", (), "larger keeps the net smoother, smaller lies closer", 1e-5),
            ("symmetric", "Symmetric", (), "keep a mirror symmetric cage symmetric"),
            ("weights", "Follow", TABLES, "how far each control vertex may follow, 0 to 1"),
            ("displacement", "Displacement", (), "image of what the cage still misses, along the normal"),
            ("vector_displacement", "Vectors", (), "image of what the cage still misses, as vectors"),
            ("normal_map", "Normal map", (), "image of the source's normals, or the detailed mesh's"),
            ("occlusion", "Occlusion", (), "image of the source's ambient occlusion, or the detailed mesh's"),
            ("colors", "Vertex colours", (), "image of the source's vertex colours, or the detailed mesh's"),
            ("baked", "Texture", (), "the detailed mesh's image if there is one, else the open texture"),
            ("mhclo", "MakeHuman file", (), "the mesh then follows the source in MakeHuman and MPFB"),
        ),
    ),
    Fold(
        MASKS,
        _of(
            "match",
            ("target_mask", "Target mask", (*TABLES, *IMAGES), _MASK),
            ("source_mask", "Source mask", (*TABLES, *IMAGES), "the same of the source"),
            ("mask_edge", "Soft edge", (), "share of the model's size; empty: 0.02 of sets of faces, else 0"),
        )
        + _of("transfer", ("bases", "Own images", (*IMAGES, *TABLES), _HELD))
        + _of(
            "match",
            ("target_uv_set", "Target UV set", (), "to bake into, by name; empty: the first"),
            ("source_uv_set", "Source UV set", (), "that the source's images belong to; empty: the first"),
        ),
    ),
    Fold(
        MATCH,
        _of(
            "match",
            ("method", "Method", (), "elastic meets landmarks exactly; hfm and paper are functional maps"),
            ("level", "Level", (), "subdivision level of both, in place of Vertices"),
            ("k", "Functions", (), "basis functions of each surface; empty: 100"),
            ("trust_landmarks", "Trust landmarks", (), "meet every landmark, also one that looks wrong"),
            ("symmetry", "Symmetry", (), "method paper: use mirror symmetry where both meshes have it"),
            ("boundary", "Boundary"),
            ("uv_interpolation", "UVs linear"),
            ("creasing", "Creases"),
        ),
    ),
    Fold(
        FILES,
        _of(
            "transfer",
            ("bits", "Bits", (), "a channel of every image: 8, 16 or 32 (float); usual: as the source's image"),
            ("source_uvs", "UVs of the source", (), "also the target with the source's UVs, so that its image fits"),
            ("usd", "USD layer", (), "also textures, attributes, weights and shapes as a layer over the target"),
        )
        + _of("match", ("force", "Overwrite", (), "also files that cagemap did not write, or that were changed since")),
    ),
)
# Shown above the folds.
VERTICES, SIZE = ("match", "vertices"), ("transfer", "size")
_SIDES = ("target_", "source_")
_OPENED = "chosen under Models"
_EIGEN = "how the spectral basis is computed: for research"
_ALIKE = "both models have about as many"
_SPECTRAL = ("schedule", "laplacian", "accuracy", "literal")
_PLACE = "the page names what it writes"
# Not on the page, and why.
LEFT_OUT: dict[Key, str] = {
    **{("match", f"{side}{name}"): _EIGEN for side in ("", *_SIDES) for name in _SPECTRAL},
    **{("match", f"{side}k"): _EIGEN for side in _SIDES},
    ("match", "parameter"): _EIGEN,
    **{("match", f"{side}{name}"): _ALIKE for side in _SIDES for name in ("level", "vertices")},
    **{(command, "level"): "maps of single levels: for research" for command in ("transfer", "report")},
    **{("match", f"{side}symmetry"): "self-maps as lists of vertices: for research" for side in _SIDES},
    **{("match", name): _OPENED for name in ("target", "source", "scheme", "target_scheme", "source_scheme")},
    **{("match", name): _OPENED for name in ("part", "target_part", "source_part")},
    **{(command, f"{side}weld"): _OPENED for command in ("match", "wrap") for side in ("", *_SIDES)},
    **{("match", name): "under Landmarks" for name in ("landmarks", "target_points", "source_points", "curves")},
    ("match", "exchange_landmarks"): "landmarks on the page are always those of this direction",
    ("match", "answer"): "Answer, under Map",
    ("match", "cache"): "for many pairs, see jobs.md",
    **{(command, "output"): _PLACE for command in ("match", "transfer", "wrap", "report")},
    ("transfer", "texture"): _OPENED,
    **{
        (command, name): "masks of the match, under Masks, hold for all that is made with it"
        for command in ("transfer", "wrap")
        for name in ("target_mask", "source_mask", "mask_edge")
    },
    ("transfer", "write_map"): "Map file, under Files",
    ("transfer", "unwrap"): "a target without UVs gets a layout by itself",
    **{
        ("wrap", name): "the pair that is open is wrapped"
        for name in ("target", "source", "landmarks", "map", "scheme")
    },
    **{("wrap", f"{side}scheme"): _OPENED for side in _SIDES},
    ("wrap", "blend_shapes"): "one pair is open; several results become shapes on the command line",
    ("wrap", "texture"): "Texture, under Wrap",
    ("report", "texture"): "the report shows what was baked",
    ("report", "up"): _OPENED,
}


def folds(options: Options) -> tuple[Fold, ...]:
    """All folds of the page; what has no place of its own yet is under the last one, in the command line's words."""
    known = {field.key for fold in FOLDS for field in fold.fields} | {VERTICES, SIZE} | {*LEFT_OUT} | {*SHARED}
    others = [option for key, option in options.items() if key not in known]
    if not others:
        return FOLDS
    plain = [Field(option.key, option.name.replace("_", " ").capitalize(), (*TABLES, *IMAGES)) for option in others]
    return *FOLDS, Fold(ADVANCED, tuple(plain))


def on_the_page(options: Options, text: str) -> str:
    """A message of a command, with what its options are called on the page."""
    found: dict[str, str] = {}
    for fold in folds(options):
        for field in fold.fields:
            flag = options[field.key].flag
            if re.search(rf"(?<![\w-]){re.escape(flag)}(?![\w-])", text):
                found.setdefault(flag, f"{flag}: {field.label}, under {fold.title}")
    return text if not found else f"{text} (On this page {'; '.join(found.values())}.)"
