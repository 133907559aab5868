"""docs/limits.md says what the code says: limits and their reasons, read from the constants and the lines below them.

``python tests/test_limits.py`` writes the page anew.
"""

from __future__ import annotations

import ast
import importlib
from functools import cache
from itertools import pairwise
from pathlib import Path

PAGE = Path(__file__).parents[1] / "docs" / "limits.md"
LIMITS = {
    "Files": [
        ("size of a file [bytes]", "files.limited_file.MAX_FILE_BYTES"),
        ("size of a JSON document [bytes]", "files.limited_file.MAX_JSON_BYTES"),
        ("size of a file of settings [bytes]", "settings.MAX_BYTES"),
        ("length of a path in a document", "io.input_folder.MAX_PATH"),
        ("digits of a whole number in JSON", "files.strict_json.MAX_DIGITS"),
        ("relations of a kind in scene_graph.json", "io.answers.MAX_RELATIONS"),
        ("characters of a relation's reason", "io.answers.MAX_REASON"),
    ],
    "Photo and masks": [
        ("pixels of an image", "io.images.MAX_PIXELS"),
        ("shortest side of an image [px], at least", "io.images.MIN_SIDE"),
        ("masks", "io.masks.MAX_OBJECTS"),
        ("pixels of all masks together", "io.masks.MAX_MASK_PIXELS"),
        ("set pixels of a mask, at least", "io.masks.MIN_PIXELS"),
        ("overlap of two masks, below", "io.masks.MAX_OVERLAP"),
        ("digits of an id", "io.masks.MAX_ID_DIGITS"),
    ],
    "Page of masks": [
        ("body of a request [bytes]", "mask_page.loopback_server.MAX_BODY"),
        ("request before its body [bytes]", "mask_page.loopback_server.MAX_HEAD"),
        ("connections at once", "mask_page.loopback_server.MAX_CONNECTIONS"),
    ],
    "Geometry": [
        ("bytes of the arrays read from an npz file", "files.npz.MAX_ARRAY_BYTES"),
        ("arrays in an npz file", "files.npz.MAX_ENTRIES"),
        ("header of an array [bytes]", "files.npz.MAX_HEADER"),
        ("valid pixels, at least", "io.geometry.MIN_VALID"),
        ("median depth [m], at least", "io.geometry.MIN_DEPTH"),
        ("median depth [m]", "io.geometry.MAX_DEPTH"),
        ("depth of a point [m], at least", "io.geometry.MIN_NEAR"),
        ("coordinate of a point [m]", "io.geometry.MAX_FAR"),
        ("focal length [longer image sides], at least", "io.geometry.MIN_FOCAL"),
        ("focal length [longer image sides]", "io.geometry.MAX_FOCAL"),
        ("aspect over the photo's, either way, before a decision says so", "io.geometry.MAX_STRETCH"),
        ("principal point and skew [longer image sides]", "io.geometry.MAX_CENTER"),
    ],
    "Meshes": [
        ("faces of a file", "io.mesh_files.MAX_FACES"),
        ("texture pixels of a file", "io.mesh_files.MAX_TEXTURE_PIXELS"),
        ("coordinate in a file", "io.mesh_files.MAX_COORDINATE"),
        ("size of an OBJ or glTF file [bytes]", "io.mesh_files.MAX_TEXT_BYTES"),
        ("nodes, and primitives shown, of a file", "io.gltf_reader.MAX_PARTS"),
        ("bytes of a glTF file's JSON", "io.gltf_reader.MAX_TREE_BYTES"),
        ("bytes of packed views, once unpacked", "io.gltf_reader.MAX_UNPACKED_BYTES"),
        ("faces of all meshes together", "io.assets.MAX_SCENE_FACES"),
        ("texture pixels of all meshes together", "io.assets.MAX_SCENE_TEXTURE_PIXELS"),
        ("size of an object [m], at least", "io.assets.MIN_SIZE"),
        ("size of an object [m]", "io.assets.MAX_SIZE"),
        ("volume of a mesh's hull [cubes of its diagonal], at least", "io.assets.MIN_FILL"),
        ("area of a mesh [squares of its diagonal]", "io.assets.MAX_FOLDS"),
        ("distance of an object [its own sizes]", "io.inputs.MAX_DISTANCE"),
        ("asset depth over geometry depth, either way", "io.inputs.MAX_DISAGREEMENT"),
    ],
    "Packages": [
        ("size of scene.json [bytes]", "files.bounds.MAX_SCENE_BYTES"),
        ("size of a file of a convex part [bytes]", "files.bounds.MAX_PART_BYTES"),
        ("objects", "files.bounds.MAX_OBJECTS"),
        ("convex parts of an object", "files.bounds.MAX_OBJECT_PARTS"),
        ("convex parts of all objects", "files.bounds.MAX_SCENE_PARTS"),
        ("id", "files.bounds.MAX_ID"),
        ("length of a label or material", "files.bounds.MAX_LABEL"),
        ("coordinate of a pose, a centre of mass or the ground [m]", "files.bounds.FARTHEST"),
        ("size of an object [m], at least", "files.bounds.MIN_OBJECT"),
        ("size of an object [m]", "files.bounds.MAX_OBJECT"),
        ("distance of an object from the camera [its own sizes]", "files.bounds.MAX_SIZES_AWAY"),
        ("density [kg/m3], at least", "files.bounds.MIN_DENSITY"),
        ("density [kg/m3]", "files.bounds.MAX_DENSITY"),
        ("mass over density [m3], at least", "files.bounds.MIN_VOLUME"),
        ("mass over density [m3]", "files.bounds.MAX_VOLUME"),
        ("mass [kg], at least", "files.bounds.MIN_MASS"),
        ("mass [kg]", "files.bounds.MAX_MASS"),
        ("principal moment of inertia of what can move [kg m2], at least", "files.bounds.MIN_MOMENT"),
        ("sliding friction", "files.bounds.MAX_FRICTION"),
        ("rolling friction [m]", "files.bounds.MAX_ROLLING_FRICTION"),
        ("scale of a motion or of the input beside it, either way", "files.bounds.MAX_SCALE"),
        ("side of the photo [px]", "files.bounds.MAX_SIDE"),
        ("focal length [longer image sides], at least", "files.bounds.MIN_FOCAL_LENGTH"),
        ("focal length [longer image sides]", "files.bounds.MAX_FOCAL_LENGTH"),
        ("principal point and skew [longer image sides]", "files.bounds.MAX_PRINCIPAL"),
        ("rounding of rotations and unit vectors", "files.bounds.ROUNDING"),
    ],
    "Edits": [
        ("edits of a list", "edits.edit_list.MAX_EDITS"),
        ("size of edits.json [bytes]", "edits.edit_list.MAX_EDITS_BYTES"),
        ("shift along an axis [m]", "edits.edit_list.MAX_MOVE"),
        ("length of an axis of turning, at least", "edits.edit_list.MIN_AXIS"),
        ("factor on a size, either way", "edits.edit_list.MAX_FACTOR"),
    ],
    "Plans and rollouts": [
        ("time step [s], at least", "goals.plan.MIN_TIMESTEP"),
        ("steps of a rollout", "goals.plan.MAX_STEPS"),
        ("samples of a rollout", "goals.rollout.MAX_SAMPLES"),
        ("contacts of a rollout", "goals.rollout.MAX_CONTACTS"),
    ],
}
"""By section: what is limited, and the constant that holds the limit."""
HEAD = """# Limits

What enters is refused beyond these limits, with one error that names the file, before any work starts; what that looks
like is in [broken inputs](broken_inputs.md). All are at most unless the table says otherwise. The tests make this page
from the code's constants: `python tests/test_limits.py` writes it anew.
"""


def page() -> str:
    parts = [HEAD]
    for section, limits in LIMITS.items():
        parts.append(f"\n## {section}\n\n| what | limit | why | constant |\n| --- | --- | --- | --- |\n")
        for what, constant in limits:
            parts.append(f"| {what} | {_number(constant)} | {_reason(constant)} | `{constant}` |\n")
    return "".join(parts)


def _number(constant: str) -> str:
    module, name = constant.rsplit(".", 1)
    value = getattr(importlib.import_module(f"f3sr.{module}"), name)
    return f"{value:,}" if isinstance(value, int) else f"{value:,g}" if 1e-3 <= value < 1e9 else f"{value:.0e}"


def _reason(constant: str) -> str:
    module, name = constant.rsplit(".", 1)
    return _constants(module)[name]


@cache
def _constants(module: str) -> dict[str, str]:
    """The names that a module assigns, and the string below each assignment as one paragraph."""
    body = ast.parse(Path(importlib.import_module(f"f3sr.{module}").__file__ or "").read_text()).body
    found: dict[str, str] = {}
    for statement, below in pairwise(body):
        if isinstance(statement, ast.Assign) and isinstance(below, ast.Expr) and isinstance(below.value, ast.Constant):
            reason = " ".join(str(below.value.value).split())
            found |= {n.id: reason for target in statement.targets for n in ast.walk(target) if isinstance(n, ast.Name)}
    return found


def test_the_page_of_limits_is_current():
    assert PAGE.read_text() == page(), "run: python tests/test_limits.py"


def test_every_limit_of_the_readers_is_on_the_page():
    listed = {constant for limits in LIMITS.values() for _, constant in limits}
    modules = {constant.rsplit(".", 1)[0] for constant in listed}
    found = {f"{m}.{n}" for m in modules for n in _constants(m) if n.startswith(("MAX_", "MIN_"))}
    assert found <= listed and listed - found == {"files.bounds.FARTHEST", "files.bounds.ROUNDING"}


if __name__ == "__main__":
    PAGE.write_text(page())
