"""Meshes where one reading of their poses puts them, all times the factor by which they agree with the geometry.

A producer's places have a unit of their own. Where depths are known, they tell it. Where only the ground is, the
objects that stand on it in the picture do: all poses together move along their viewing rays until these touch it.
"""

from __future__ import annotations

from collections.abc import Mapping
from statistics import median

from f3sr.backends.protocols import GeneratedAsset
from f3sr.core.handedness import in_axes
from f3sr.core.mesh import Mesh
from f3sr.core.transforms import pose, transform
from f3sr.io.given_meshes import PlacedMeshes
from f3sr.mesh_poses.candidate_places import CandidatePlaces
from f3sr.mesh_poses.pose_by_mask import MaskedPhoto
from f3sr.report import Decision
from f3sr.scene import GROUND, SceneObject
from f3sr.vision.image_supports import below

LARGER: Mapping[float, str] = {100.0: "hundreds", 1000.0: "thousands"}
"""Units of places that are larger than the geometry's: it may be in centimetres or millimetres, and not in metres."""
UNITS: Mapping[float, str] = {0.01: "centimetres", 0.001: "millimetres", **LARGER}
"""Units of places other than the geometry's, in its own."""
WITHIN = 2.0
"""Largest factor between depths of poses and of the geometry that is no other unit, and from one of UNITS."""


def placed_by_reading(view: MaskedPhoto, meshes: Mapping[int, Mesh], places: CandidatePlaces, k: int) -> PlacedMeshes:
    """All meshes by reading ``k``, in the geometry's unit, and what was decided about that."""
    if view.geometry is None:
        factor, reason = _onto_the_ground(view, meshes, places, k)
    else:
        factor, reason = _to_measured_depths(view, meshes, places, k)
    choice = f"assets: all places and sizes times {factor:.4g}"
    decisions = [Decision(choice=choice, reason=reason, fallback=factor in LARGER)] if reason else []
    assets = {id: _asset(meshes[id], places, k, v, factor) for v, id in enumerate(places.ids)}
    return PlacedMeshes(assets=assets, decisions=tuple(decisions))


def asset_of(view: MaskedPhoto, o: SceneObject, told: str) -> GeneratedAsset:
    """An object of the photo's world as an asset in the camera's frame."""
    T = view.camera.T_camera_world @ o.T_world_object
    return GeneratedAsset(mesh=o.mesh, T_camera_object=T, scale=o.scale, told=told)


def about_its_middle(asset: GeneratedAsset) -> GeneratedAsset:
    """The same asset, whose mesh has its middle at the origin."""
    middle = asset.mesh.bounds.mean(0)
    T = asset.T_camera_object @ pose(t=asset.scale * middle)
    mesh = asset.mesh.with_vertices(asset.mesh.vertices - middle)
    return GeneratedAsset(mesh=mesh, T_camera_object=T, scale=asset.scale)


def _to_measured_depths(
    view: MaskedPhoto, meshes: Mapping[int, Mesh], places: CandidatePlaces, k: int
) -> tuple[float, str]:
    """1, or the unit of the places where measured depths show one; the reason, if any."""
    depths = list[float]()
    for v, id in enumerate(places.ids):
        z = float((places.scale[k, v] * places.R[k, v] @ meshes[id].bounds.mean(0) + places.t[k, v])[2])
        if z > 0:
            depths.append(view.distance(view.instances[id]) / z)
    ratio = median(depths) if depths else 1.0
    unit = next((u for u in UNITS if 1 / WITHIN <= ratio / u <= WITHIN), 1.0)
    if unit == 1.0 or 1 / WITHIN <= ratio <= WITHIN:
        return 1.0, ""
    doubt = "; geometry is read in metres: is it in a smaller unit?" if unit in LARGER else ""
    return unit, f"in {UNITS[unit]} they agree with the geometry's depths{doubt}"


def _onto_the_ground(
    view: MaskedPhoto, meshes: Mapping[int, Mesh], places: CandidatePlaces, k: int
) -> tuple[float, str]:
    """The factor about the camera by which objects with ground below them in the picture stand on it; the reason.

    A homothety by f about an eye of height h takes a height z to h + f (z - h), and no silhouette changes."""
    height = float(view.camera.center[2])
    factors = dict[int, float]()
    for v, id in enumerate(places.ids):
        in_camera = meshes[id].vertices @ (places.scale[k, v] * places.R[k, v]).T + places.t[k, v]
        low = float(transform(view.camera.T_world_camera, in_camera)[:, 2].min())
        if low < height:
            factors[id] = height / (height - low)
    under = below({id: i.mask for id, i in view.instances.items()})
    standing = [f for id, f in factors.items() if under[id] == GROUND]
    if not factors:
        return 1.0, ""
    told = f"{len(standing)} objects then stand on the ground, which is all that the geometry knows"
    return (
        (median(standing), told) if standing else (min(factors.values()), "the lowest object then stands on the ground")
    )


def _asset(mesh: Mesh, places: CandidatePlaces, k: int, v: int, factor: float) -> GeneratedAsset:
    """A mesh in the axes that its reading keeps it in, and its rotation and place in the camera."""
    scale = factor * float(places.scale[k, v])
    own = places.own[k]
    T = pose(places.R[k, v] @ own.T, factor * places.t[k, v])
    return GeneratedAsset(mesh=in_axes(mesh, own), T_camera_object=T, scale=scale)
