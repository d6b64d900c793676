"""Which options of the commands the page shows, in which section and with which label."""

from __future__ import annotations

import re
from dataclasses import dataclass

from cagemap.errors import use_option_names
from cagemap.files import IMAGE_SUFFIXES
from cagemap.files.gltf.document import SCENE_SUFFIXES
from cagemap.files.meshes.formats import MESH_SUFFIXES
from cagemap.files.usd.stages import USD_SUFFIXES
from cagemap.studio.finish import SHARED_OPTIONS
from cagemap.studio.workspace import TABLE_SUFFIXES
from cagemap.tasks.requests.catalogue import Key, Options

# Among suffixes: also folders with such files.
FOLDER_SUFFIX = "/"


@dataclass(frozen=True)
class Field:
    """An option on the page."""

    key: Key
    label: str
    suffixes: tuple[str, ...] = ()  # of the files to choose from
    hint: str = ""  # '' for the help text of the command line
    step: float = 1.0  # step of a number's input


@dataclass(frozen=True)
class Section:
    """A collapsible group of options."""

    title: str
    fields: tuple[Field, ...]


def _fields(command: str, *fields: tuple[object, ...]) -> tuple[Field, ...]:
    return tuple(Field((command, str(name)), *others) for name, *others in fields)  # type: ignore[arg-type]


# Titles of the sections that the form adds to, and of the last one, see `sections`.
MORE_IMAGES, WRAP, FILES, ADVANCED = "More images", "Wrap", "Files", "Advanced"
# Suffixes of files to choose from.
_IMAGES, _MESHES, _TABLES = IMAGE_SUFFIXES, MESH_SUFFIXES, TABLE_SUFFIXES
_RIGS = (*USD_SUFFIXES, *SCENE_SUFFIXES)
_VALUES = (*_TABLES, ".json", *USD_SUFFIXES)
_BASES_HINT = (
    "the target's own, kept outside the masks: FILE under the texture, NAME=FILE under another (normal map, ao)"
)
_MASK_HINT = "match and bake only this part or mask file; not:... for all except it"
SECTIONS = (
    Section(
        MORE_IMAGES,
        _fields(
            "transfer",
            ("normal_map", "Normal map", _IMAGES, "of the source; its directions are rotated with the map"),
            ("space", "Space", (), "of normals and vectors: tangent (MikkTSpace) or object"),
            ("green", "Green", (), "of normal maps: up (OpenGL, Blender) or down (DirectX)"),
            ("displacement", "Displacement", _IMAGES, "height along the source's normal"),
            ("vector_displacement", "Vectors", _IMAGES, "vector displacement of the source"),
            ("scale", "Height scale", (), "in the source's units: height between the values 0 and 1", 0.001),
            ("midlevel", "Mid level", (), "value that means no height; empty: 0.5 for integers, 0 for floats"),
            ("material_colors", "Material colours", (), "those of the source's materials, as an image"),
            ("as_color", "As a picture", (), "transfer it as colours, also if it looks like a normal map"),
            ("filter", "Sharpness", (), "smooth or linear; nearest for labels and ID maps, whose colours must not mix"),
        ),
    ),
    Section(
        "Detailed mesh",
        _fields(
            "transfer",
            (
                "detail",
                "Mesh",
                _MESHES,
                "a scan or sculpt at the source's place; without it: ao and colors of the source",
            ),
            ("detail_texture", "Its image", _IMAGES, "the detailed mesh's own image, for texture"),
            ("bake", "Bake", (), "from the detailed mesh into the target's layout"),
            ("rays", "Rays", (), "for ambient occlusion, per vertex of the mesh; more is smoother"),
        ),
    ),
    Section(
        "Rig",
        _fields(
            "transfer",
            ("weights", "Skin weights", (".csv", ".npz", *_RIGS), "of the source's cage, one column per joint"),
            ("influences", "Influences", (), "most joints per vertex; 0: all"),
            ("only", "Joints carried", (), "names, separated by commas; all others keep the target's weights"),
            ("mirror", "Both sides alike", (), "make weights symmetric, by left and right in the joints' names"),
            ("joints", "Joints", (".json", *_RIGS), "skeleton of the source"),
            ("blend_shapes", "Blend shapes", (".obj", ".npz", *_RIGS, FOLDER_SUFFIX), "of the source's cage"),
            ("passenger", "Passenger", (".obj", ".ply", *_RIGS), "clothes, eyes, hair or a prop on the source"),
            ("kind", "Keeps shape", (), "cloth bends, rigid does not, similarity also scales; empty: by its pieces"),
            ("attribute", "Attribute", _VALUES, "values at the source's vertices, faces or corners; vertex groups"),
        ),
    ),
    Section(
        WRAP,
        _fields(
            "wrap",
            ("amount", "Amount", (), "0: the target's own shape, 1: the source's", 0.05),
            ("fit_level", "Fit level", (), "0: fit the control mesh; 1 or more: fit that subdivision level"),
            ("fairness", "Fairness", (), "larger: a smoother mesh; smaller: closer to the source", 1e-5),
            ("symmetric", "Symmetric", (), "keep a mirror symmetric cage symmetric"),
            ("weights", "Follow", _TABLES, "how far each control vertex may follow, 0 to 1"),
            ("displacement", "Displacement", (), "image of the remaining distance along the normal"),
            ("vector_displacement", "Vectors", (), "image of the remaining offset, as vectors"),
            ("normal_map", "Normal map", (), "image of the source's normals, or the detailed mesh's"),
            ("occlusion", "Occlusion", (), "image of the source's ambient occlusion, or the detailed mesh's"),
            ("colors", "Vertex colours", (), "image of the source's vertex colours, or the detailed mesh's"),
            ("baked", "Texture", (), "the detailed mesh's image if there is one, else the open texture"),
            ("mhclo", "MakeHuman file", (), "the mesh then follows the source in MakeHuman and MPFB"),
        ),
    ),
    Section(
        "Masks and UV sets",
        _fields(
            "match",
            ("target_mask", "Target mask", (*_TABLES, *_IMAGES), _MASK_HINT),
            ("source_mask", "Source mask", (*_TABLES, *_IMAGES), "the same for the source"),
            ("mask_edge", "Soft edge", (), "of a mask's border, in model sizes; empty: 0.02 for sets of faces, else 0"),
        )
        + _fields("transfer", ("bases", "Own images", (*_IMAGES, *_TABLES), _BASES_HINT))
        + _fields(
            "match",
            ("target_uv_set", "Target UV set", (), "to bake into, by name; empty: the first"),
            ("source_uv_set", "Source UV set", (), "that the source's images belong to; empty: the first"),
        ),
    ),
    Section(
        "Match",
        _fields(
            "match",
            ("level", "Level", (), "subdivision level of both, in place of Vertices"),
            ("trust_landmarks", "Trust landmarks", (), "use every landmark, also those that look wrong"),
            ("boundary", "Boundary"),
            ("uv_interpolation", "UVs linear"),
            ("creasing", "Creases"),
        ),
    ),
    Section(
        FILES,
        _fields(
            "transfer",
            ("bits", "Bits", (), "per channel of every image: 8, 16 or 32 (float); usual: as the source's image"),
            ("source_uvs", "UVs of the source", (), "also the target with the source's UVs, so that its image fits"),
            ("usd", "USD layer", (), "also textures, attributes, weights and shapes as a layer over the target"),
        )
        + _fields("match", ("force", "Overwrite", (), "also files that were changed or that cagemap did not write")),
    ),
)
# Keys of the options above the sections.
VERTICES_KEY, SIZE_KEY = ("match", "vertices"), ("transfer", "size")
_SIDE_PREFIXES = ("target_", "source_")
_UNDER_MODELS = "chosen under Models"
_BASIS_RESEARCH = "how the spectral basis is computed: for research"
_METHOD_RESEARCH = "other methods than the elastic one: for research"
_SAME_FOR_BOTH = "one number is used for both models"
_BASIS_FIELDS = ("schedule", "laplacian", "accuracy", "literal")
_PAGE_NAMES_OUTPUT = "the page names what it writes"
# Options that are not on the page, and the reason.
OMITTED_OPTIONS: dict[Key, str] = {
    **{("match", f"{side}{name}"): _BASIS_RESEARCH for side in ("", *_SIDE_PREFIXES) for name in _BASIS_FIELDS},
    **{("match", f"{side}k"): _BASIS_RESEARCH for side in ("", *_SIDE_PREFIXES)},
    **{("match", name): _METHOD_RESEARCH for name in ("method", "symmetry")},
    ("match", "parameter"): _BASIS_RESEARCH,
    **{("match", f"{side}{name}"): _SAME_FOR_BOTH for side in _SIDE_PREFIXES for name in ("level", "vertices")},
    **{(command, "level"): "maps of single levels: for research" for command in ("transfer", "report")},
    **{("match", f"{side}symmetry"): "self-maps as lists of vertices: for research" for side in _SIDE_PREFIXES},
    **{("match", name): _UNDER_MODELS for name in ("target", "source", "scheme", "target_scheme", "source_scheme")},
    **{("match", name): _UNDER_MODELS for name in ("part", "target_part", "source_part")},
    **{(command, f"{side}weld"): _UNDER_MODELS for command in ("match", "wrap") for side in ("", *_SIDE_PREFIXES)},
    **{("match", name): "under Landmarks" for name in ("landmarks", "target_points", "source_points", "curves")},
    ("match", "exchange_landmarks"): "landmarks on the page are always those of this direction",
    ("match", "answer"): "Answer, under Map",
    ("match", "cache"): "for many pairs, see jobs.md",
    **{(command, "output"): _PAGE_NAMES_OUTPUT for command in ("match", "transfer", "wrap", "report")},
    ("transfer", "texture"): _UNDER_MODELS,
    **{
        (command, name): "the masks of the match are used for everything"
        for command in ("transfer", "wrap")
        for name in ("target_mask", "source_mask", "mask_edge")
    },
    ("transfer", "write_map"): "Map file, under Files",
    ("transfer", "unwrap"): "a target without UVs gets a layout by itself",
    **{
        ("wrap", name): "the pair that is open is wrapped"
        for name in ("target", "source", "landmarks", "map", "scheme")
    },
    **{("wrap", f"{side}scheme"): _UNDER_MODELS for side in _SIDE_PREFIXES},
    ("wrap", "blend_shapes"): "one pair is open; several results become shapes on the command line",
    ("wrap", "texture"): "Texture, under Wrap",
    ("report", "texture"): "the report shows what was baked",
    ("report", "up"): _UNDER_MODELS,
}


def sections(options: Options) -> tuple[Section, ...]:
    """All sections of the page; options missing in `SECTIONS` form the last one."""
    listed = {field.key for section in SECTIONS for field in section.fields}
    listed |= {VERTICES_KEY, SIZE_KEY, *OMITTED_OPTIONS, *SHARED_OPTIONS}
    others = [option for key, option in options.items() if key not in listed]
    if not others:
        return SECTIONS
    suffixes = (*_TABLES, *_IMAGES)
    fields = [Field(option.key, option.name.replace("_", " ").capitalize(), suffixes) for option in others]
    return *SECTIONS, Section(ADVANCED, tuple(fields))


_CHOOSE_PART = "press Open… and choose it under Part"
# What to press on the page in place of options in messages; longer texts first.
PAGE_WORDS = {
    "--part selects another": f"To open another piece, {_CHOOSE_PART}",
    "--part NAME, largest, or each; the check lists them": _CHOOSE_PART,
    "--part NAME": _CHOOSE_PART,
    "--part": "Open…, Part",
    "--scheme none (of a source alone: --source-scheme none)": "Do not subdivide (Open…, Options)",
    "--target-scheme": "Open…, Options, Subdivide target",
    "--trust-landmarks": "Bake, Match, Trust landmarks",
    "--texture:": "Bake, More images, Maps:",
    "--force": "Bake, Files, Overwrite",
    "--answer 1": "the other button above Match again",
    "`transfer --bake colors`": "Bake, Detailed mesh, Bake, colors",
    "`transfer --material-colors`": "Bake, More images, Material colours",
    "carry with `cagemap transfer --unwrap`, which makes another layout": "give it a layout without overlaps",
    "--unwrap": "the studio does this when it bakes",
}


def in_page_words(text: str) -> str:
    """A message with Python names and options replaced by what to press on the page."""
    text = use_option_names(text)
    for option, words in PAGE_WORDS.items():
        text = re.sub(rf"(?<![\w-]){re.escape(option)}(?![\w-])", words, text)
    return text


def explain_flags(options: Options, text: str) -> str:
    """Append the labels of the options that a command's message names."""
    labels: dict[str, str] = {}
    for section in sections(options):
        for field in section.fields:
            flag = options[field.key].flag
            if re.search(rf"(?<![\w-]){re.escape(flag)}(?![\w-])", text):
                labels.setdefault(flag, f"{flag}: {field.label}, under {section.title}")
    return text if not labels else f"{text} (On this page {'; '.join(labels.values())}.)"
