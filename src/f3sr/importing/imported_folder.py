"""Writing a composition as a prompted-image folder: whole or not at all."""

from __future__ import annotations

import io
import json
import os
from pathlib import Path

import numpy as np

from f3sr.core.transforms import Array, quaternion_from_rotation
from f3sr.errors import OutputError
from f3sr.importing.composition import ComposedObject, Composition, DrawnView
from f3sr.io.gltf_writer import mesh_to_glb
from f3sr.io.images import encode_png
from f3sr.io.masks import MIN_PIXELS
from f3sr.io.sam3d import LOCAL_FROM_GLB, OPENCV_FROM_PYTORCH3D
from f3sr.runtime.atomic_folder import claimed
from f3sr.segmentation.input_folder_writer import PNG, mask_name

NOTE = "import.json"
"""Says where a folder came from; only folders that have it are replaced."""


def write_imported(out: Path, composition: Composition, view: DrawnView) -> Path:
    """Write photo, masks, geometry, meshes and poses; returns the full path. Raises OutputError."""
    full = Path(out).absolute().resolve()
    with claimed(full, _require_own) as claim:
        claim.write("image.png" if composition.photo.startswith(PNG) else "image.jpg", composition.photo)
        seen = [o for o in composition.objects if o.id in view.masks]
        hidden = [o for o in composition.objects if o.id not in view.masks]
        names = {o.id: mask_name(o.id, o.label) for o in seen}
        for id, mask in view.masks.items():
            claim.write(f"masks/{names[id]}", encode_png(mask.astype(np.uint8) * 255))
        if view.ground.sum() >= MIN_PIXELS:
            claim.write("ground.png", encode_png(view.ground.astype(np.uint8) * 255))
        claim.write("geometry.npz", _geometry(composition, view))
        poses = [_posed(o, composition, names[o.id]) for o in seen]
        for o in seen:
            claim.write(f"assets/{o.id:02d}.glb", mesh_to_glb(o.mesh, name=f"{o.id:02d}"))
        claim.write("assets/poses.json", _json({"convention": "sam-3d-objects", "objects": poses}))
        reason = f"by {composition.source}"
        pairs = [pair for pair in composition.supports if names.keys() >= set(pair)]
        relations = [{"upper": upper, "lower": lower, "reason": reason} for upper, lower in pairs]
        if relations:
            claim.write("scene_graph.json", _json({"support_relations": relations}))
        left_out = [{"id": o.id, "label": o.label, "reason": "the camera does not see it"} for o in hidden]
        note = {"source": composition.source, "masks": "drawn from the poses", "left_out": left_out}
        claim.write(NOTE, _json(note))
        claim.replace()
    return full


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


def _json(value: object) -> bytes:
    return json.dumps(value, indent=1, allow_nan=False).encode()


def _require_own(out: Path) -> None:
    """Raises OutputError unless there is nothing, or what f3sr imported."""
    if not os.path.lexists(out) or (out.is_dir() and ((out / NOTE).is_file() or not any(out.iterdir()))):
        return
    raise OutputError(f"{out}: found something else; accepted: a new or empty folder, or one that f3sr import wrote")
