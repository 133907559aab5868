"""Writing a composition as a prompted-image folder: whole or not at all."""

from __future__ import annotations

import io
import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from f3sr.core.transforms import Array, quaternion_from_rotation
from f3sr.importing.composition import ComposedObject, Composition, DrawnView, LeftOut
from f3sr.io.gltf_writer import mesh_to_glb
from f3sr.io.images import encode_png
from f3sr.io.masks import MIN_PIXELS
from f3sr.io.sam3d import LOCAL_FROM_GLB, OPENCV_FROM_PYTORCH3D
from f3sr.runtime.unchanged_folder import FolderNote
from f3sr.segmentation.input_folder_writer import PNG, mask_name

NOTE = "import.json"
"""Says where a folder came from and what was written; only folders that have it are replaced."""
IMPORTED = FolderNote(name=NOTE, writer="f3sr import")


def write_imported(out: Path, composition: Composition, view: DrawnView) -> Path:
    """Write photo, masks, geometry, meshes and poses; returns the full path. Raises OutputError.

    Geometry only of an upright world: elsewhere the photo must tell gravity and the ground, and K alone is written."""
    full = Path(out).absolute().resolve()
    with IMPORTED.writing(full) as folder:
        folder.write(photo_name(view.photo), view.photo)
        seen = [o for o in composition.objects if o.id in view.masks]
        hidden = [o for o in composition.objects if o.id not in view.masks]
        names = {o.id: mask_name(o.id, o.label) for o in seen}
        for id, mask in view.masks.items():
            folder.write(f"masks/{names[id]}", grey(mask))
        if view.ground.sum() >= MIN_PIXELS:
            folder.write("ground.png", grey(view.ground))
        if composition.upright:
            folder.write("geometry.npz", _geometry(composition, view))
        else:
            folder.write("intrinsics.json", as_json(_intrinsics(composition)))
        poses = [_posed(o, composition, names[o.id]) for o in seen]
        for o in seen:
            folder.write(f"assets/{o.id:02d}.glb", mesh_to_glb(o.mesh, name=f"{o.id:02d}"))
        folder.write("assets/poses.json", as_json({"convention": "sam-3d-objects", "objects": poses}))
        reason = f"by {composition.source}"
        pairs = [pair for pair in composition.supports if names.keys() >= set(pair)]
        relations = [{"upper": upper, "lower": lower, "reason": reason} for upper, lower in pairs]
        if relations:
            folder.write("scene_graph.json", as_json({"support_relations": relations}))
        folder.end(lambda files: as_json({**_note(composition, hidden), "files": files}))
    return full


def left_out(composition: Composition, view: DrawnView) -> tuple[LeftOut, ...]:
    """What is not imported: what the program's reader left out, and what the camera does not see."""
    unseen = [o for o in composition.objects if o.id not in view.masks]
    return (*composition.left_out, *map(_unseen, unseen))


def _unseen(o: ComposedObject) -> LeftOut:
    return LeftOut(label=o.label, reason="the camera does not see it", id=o.id)


def _note(composition: Composition, hidden: list[ComposedObject]) -> dict[str, object]:
    missing = [*composition.left_out, *map(_unseen, hidden)]
    return {
        "source": composition.source,
        "masks": "given" if composition.masks else "drawn from the poses",
        "photo": "given" if composition.photo else "drawn from the meshes",
        "poses": "given",
        "left_out": [asdict(item) for item in missing],
        "remarks": list(composition.remarks),
    }


def _intrinsics(composition: Composition) -> dict[str, object]:
    camera = composition.camera
    return {"width": camera.width, "height": camera.height, "K": camera.K.tolist()}


def _posed(o: ComposedObject, composition: Composition, mask: str) -> dict[str, object]:
    """An entry of poses.json: for x_opencv = s R A v_glb + t, the quaternion of R' F and F t (docs: conventions)."""
    T = composition.camera.T_camera_world @ o.T_world_mesh
    R: Array = T[:3, :3] @ LOCAL_FROM_GLB.T
    quaternion = quaternion_from_rotation(R.T @ OPENCV_FROM_PYTORCH3D)
    return {
        "mask": mask,
        "mesh": f"{o.id:02d}.glb",
        "rotation": quaternion.tolist(),
        "translation": (OPENCV_FROM_PYTORCH3D @ T[:3, 3]).tolist(),
        "scale": [o.scale] * 3,
    }


def _geometry(composition: Composition, view: DrawnView) -> bytes:
    buffer = io.BytesIO()
    camera = composition.camera
    scale = np.diag([1 / camera.width, 1 / camera.height, 1.0])
    np.savez_compressed(
        buffer, points=view.points, mask=view.valid, intrinsics=scale @ camera.K, coordinate_system="opencv"
    )
    return buffer.getvalue()


def photo_name(photo: bytes) -> str:
    """What the bytes of a photo are called in an input folder."""
    return "image.png" if photo.startswith(PNG) else "image.jpg"


def grey(mask: NDArray[np.bool_]) -> bytes:
    """A mask (H, W) as a PNG."""
    return encode_png(mask.astype(np.uint8) * 255)


def as_json(value: object) -> bytes:
    """A value as a JSON file."""
    return json.dumps(value, indent=1, allow_nan=False).encode()
