"""The release protocol that measures rest: the scene starts with zero velocity, without damping."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from f3sr.core.transforms import Array, pose
from f3sr.physics.contact_margin import ContactMargin
from f3sr.physics.mujoco_model import (
    DEFAULT_PHYSICS,
    LEAST_MOMENT,
    MjData,
    MjModel,
    MjSpec,
    add_mesh,
    body_name,
    contact_options,
    empty_spec,
    engine,
    part_name,
    pose_of,
)
from f3sr.physics.near_pairs import NearPairs
from f3sr.scene import SceneObject

RELEASE_MARGIN = 2e-4
"""Contact distance of each body in the release protocol [m]."""
RELEASE_DENSITY = 600.0
"""Of all objects in the release protocol [kg/m3], whatever they are made of."""
RELEASE_FRICTION = (0.6, 0.005, 0.001)
"""Sliding, torsional [m] and rolling [m] friction of all contacts in the release protocol."""
RELEASE_PHYSICS = replace(DEFAULT_PHYSICS, contact=ContactMargin(body=RELEASE_MARGIN))


class Release(NamedTuple):
    """Result of the release protocol (equations 13 and 14)."""

    K_max: float
    """Largest total kinetic energy in the first second [J]."""
    D_max: float
    """Largest travel of a centre of mass [m]."""


def release(objects: Sequence[SceneObject], *, true_scale: float = 1.0, seconds: float = 5.0) -> Release:
    """Release the scene from rest, undamped, and measure it: one protocol for every method (docs: measures).

    Unlike in the product's own model, all objects have friction .6 and rolling friction .001. Their mass is 600 kg/m3
    of the visual volume, spread evenly over their parts. Lengths are multiplied by ``true_scale``. D is sampled every
    10 steps.
    """
    mujoco = engine()
    if not objects:
        return Release(0.0, 0.0)
    near = release_pairs(objects, true_scale=true_scale)
    model = near.model
    data = mujoco.MjData(model)
    K_max = D_max = 0.0
    mujoco.mj_forward(model, data)
    centers = data.xipos[1:].copy()
    for step in range(int(seconds / model.opt.timestep)):
        near.step(data)
        if step < 500:
            mujoco.mj_energyVel(model, data)
            K_max = max(K_max, float(data.energy[1]))
        if step % 10 == 9:
            D_max = max(D_max, float(np.linalg.norm(data.xipos[1:] - centers, axis=1).max()))
    return Release(K_max, D_max)


def filling(o: SceneObject) -> float:
    """Factor on the density of an object's parts that gives the mass of the release protocol.

    It is the solid's volume, at least 1 mm3, over the sum of the parts' volumes. The solid's volume is the least of
    three: the mesh's own if closed without welding (split vertices count as open), its hull's, and that sum.
    """
    parts = sum(p.volume for p in o.solids)
    return max(1e-9 / o.scale**3, min(o.mesh.stored_volume, o.mesh.hull.volume, parts)) / parts


def release_pairs(objects: Sequence[SceneObject], *, true_scale: float = 1.0) -> NearPairs:
    """The model of the release protocol, stepped with contacts of near parts."""
    return NearPairs(release_spec(objects, true_scale=true_scale), RELEASE_PHYSICS)


def release_spec(objects: Sequence[SceneObject], *, true_scale: float = 1.0, centred: bool = False) -> MjSpec:
    """The model of the release protocol: bodies in the order of their masks' names, at the origin, with their
    vertices in world coordinates, mass by density on the geoms.

    ``centred`` puts each body at the middle of its object instead: far from the origin what tumbles lands elsewhere, as
    Euler's steps turn it about its body's origin."""
    mujoco = engine()
    spec = empty_spec(RELEASE_PHYSICS, ground_friction=RELEASE_FRICTION[0])
    spec.compiler.boundinertia = LEAST_MOMENT  # of grains and needles, as MuJoCo takes none smaller
    for o in sorted(objects, key=lambda o: o.mask_name):
        name = body_name(o.id)
        origin = true_scale * o.middle if centred else np.zeros(3)
        body = spec.worldbody.add_body(name=name, pos=origin)
        if o.mobility != "fixed":
            body.add_freejoint(name=name)
        to_true = pose(t=-origin) @ np.diag([true_scale, true_scale, true_scale, 1.0]) @ o.T_world_asset
        for k, part in enumerate(o.solids):
            add_mesh(spec, part_name(name, k), part.moved(to_true))
            body.add_geom(
                type=mujoco.mjtGeom.mjGEOM_MESH,
                meshname=part_name(name, k),
                density=RELEASE_DENSITY * filling(o),
                friction=RELEASE_FRICTION,
                **contact_options(RELEASE_PHYSICS),
            )
    return spec


def released_pose(model: MjModel, data: MjData, o: SceneObject) -> Array:
    """The pose (4, 4) of an object in the model of the release protocol, at true scale 1."""
    if o.mobility == "fixed":
        return o.T_world_object
    return pose_of(model, data, o) @ pose(t=-model.body(body_name(o.id)).pos) @ o.T_world_object
