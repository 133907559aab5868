"""From what a service gave to a mesh with readings of its pose, checked as files from outside are."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from f3sr.core.mesh import Mesh
from f3sr.errors import InputError
from f3sr.files import strict_json
from f3sr.hosted.hosted_service import UnexpectedReplyError
from f3sr.io.assets import require_solidity
from f3sr.io.mesh_files import mesh_of_glb
from f3sr.io.sam3d import AssetPose


def checked_mesh(data: bytes, name: str) -> Mesh:
    """The mesh of GLB bytes, in the file's axes. Raises UnexpectedReplyError for what no scene can hold."""
    try:
        mesh = mesh_of_glb(data, Path(name)).without_unused()
        require_solidity(name, mesh)
    except InputError as error:
        raise UnexpectedReplyError(str(error)) from None
    return mesh


def checked_pose(given: Mapping[str, Any], name: str) -> AssetPose:
    """rotation, translation and scale as SAM 3D Objects gives them. Raises UnexpectedReplyError for no pose."""
    try:
        return AssetPose.model_validate({**given, "mask": name, "mesh": name})
    except ValidationError as error:
        found, accepted = strict_json.problem(error, "rotation, translation and scale")
        raise UnexpectedReplyError(f"a pose with {found}; accepted: {accepted}") from None
