"""Shapes from masks: known solids are found again, rest on their support, and are closed."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import trimesh

from f3sr import proxies
from f3sr.backends.protocols import PromptedImage
from f3sr.core.camera import Camera
from f3sr.core.mesh import ConvexPart, Mesh, signed_volume
from f3sr.core.srgb import srgb
from f3sr.core.transforms import UP, Array, pose, rotation_about
from f3sr.lifting import boxes
from f3sr.lifting.balls import fit_ball
from f3sr.lifting.boxes import fit_boxes, fit_carved
from f3sr.lifting.choice import EDGED, Choice, carries, choose, head
from f3sr.lifting.cylinders import fit_cylinder
from f3sr.lifting.fits import FittedShape
from f3sr.lifting.hollows import Usual, fit_hollow
from f3sr.lifting.inner_edges import near_rim
from f3sr.lifting.lifted_assets import LiftedAssets
from f3sr.lifting.many_starts import cost, refined
from f3sr.lifting.outline_fit import fitted_to_outline
from f3sr.lifting.outlined import Outlined
from f3sr.lifting.revolutions import fit_revolution
from f3sr.lifting.silhouettes import fit_lying, fit_standing
from f3sr.lifting.solids import BOX_FACES, CORNERS, Solid, common, is_stable, joined, revolved, subdivided
from f3sr.lifting.texture import textured
from f3sr.lifting.turned_texture import quilted
from f3sr.lifting.unshaded import LIGHT, PhotoLight, SeenSolid, light_of, placed_as_seen
from f3sr.metrics.measures import full_silhouette
from f3sr.metrology.camera_estimate import attitude
from f3sr.photo_inputs import read_inputs
from f3sr.pipeline import as_given
from f3sr.rendering.evidence import ground_points
from f3sr.rendering.light_fit import TYPICAL
from f3sr.rendering.renderer import Renderer, poses_at_rest
from f3sr.rendering.shadow_maps import Caster
from f3sr.rendering.textures import LINEAR
from f3sr.scene import GROUND, Geometry, Instance, Photo, Scene, SceneObject
from f3sr.stages.align import align
from f3sr.stages.assemble import assemble
from f3sr.stages.level import level
from f3sr.vision import rasterizer
from f3sr.vision.image_supports import below
from f3sr.vision.regions import grown, shrunk, without_strays
from f3sr.vision.silhouette import iou, union_of
from folders import part_of_example, photographed
from scenes import box

PITCH = math.radians(35)
R = attitude(PITCH, 0.0).T
CAMERA = Camera(
    width=640,
    height=480,
    K=np.array([[600.0, 0, 320], [0, 600, 240], [0, 0, 1]]),
    T_world_camera=pose(R, [0, 0, 0.6]),
)
FOOT = np.array([0.02, 0.85, 0.0])


def block(foot: Array, size: Sequence[float], yaw: float) -> Solid:
    c, s = math.cos(yaw), math.sin(yaw)
    turned = CORNERS * np.array(size) @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    return Solid(vertices=turned + foot, faces=BOX_FACES)


def can(foot: Array, radius: float, height: float) -> Solid:
    return revolved(foot, np.array([[0, 0], [radius, 0], [radius, height], [0, height]]), sectors=64)


def ball(foot: Array, radius: float) -> Solid:
    t = np.linspace(0, np.pi, 33)
    return revolved(foot, np.column_stack([radius * np.sin(t), radius * (1 - np.cos(t))]), sectors=64)


def bowl(foot: Array, rim: float, height: float, *, upside_down: bool = False) -> Solid:
    t = np.linspace(0, 1, 12)
    outer = np.column_stack([rim * (0.5 + 0.5 * t**0.6), height * t])
    made = revolved(foot, np.concatenate([[[0, 0]], outer, [[0, height]]]), sectors=64)
    if not upside_down:
        return made
    return Solid(vertices=made.vertices * [1, 1, -1] + height * UP, faces=made.faces[:, ::-1])


def mask_of(solid: Solid, camera: Camera = CAMERA) -> np.ndarray:
    return rasterizer.silhouette(camera.to_camera(solid.vertices), solid.faces, camera.K, camera.width, camera.height)


def seen(solid: Solid) -> Outlined:
    return Outlined.of(mask_of(solid), CAMERA)


def fit_box(outlined: Outlined, floor: float) -> FittedShape | None:
    return next(iter(fit_boxes(outlined, floor)), None)


def fit_rounded(outlined: Outlined, floor: float) -> FittedShape | None:
    return next((fit for fit in fit_boxes(outlined, floor) if fit.family == "rounded box"), None)


def found(fit: FittedShape | None) -> FittedShape:
    assert fit is not None
    return fit


@pytest.mark.parametrize("yaw", [0.1, 0.5, 1.0])
@pytest.mark.parametrize("size", [(0.2, 0.12, 0.07), (0.1, 0.07, 0.2), (0.08, 0.08, 0.08)])
def test_a_box_is_found_by_its_outline(size: tuple[float, ...], yaw: float):
    true = block(FOOT, size, yaw)
    fit = found(fit_box(seen(true), 0.0))
    assert fit.overlap > 0.98
    assert np.allclose(np.ptp(fit.solid.vertices, axis=0), np.ptp(true.vertices, axis=0), rtol=0.12)
    assert np.linalg.norm(fit.solid.vertices.mean(0) - true.vertices.mean(0)) < 0.01


def tin(foot: Array, size: Sequence[float], yaw: float, rounding: float) -> Solid:
    """A box with rounded upright edges, their radius a share of half its shorter side."""
    radius = rounding * min(size[:2]) / 2
    turns = np.pi * np.concatenate([1 + k / 2 + np.linspace(0, 0.5, 12) for k in range(4)])
    middles = np.repeat([[-1, -1], [1, -1], [1, 1], [-1, 1]], 12, axis=0) * (np.array(size[:2]) / 2 - radius)
    ring = middles + radius * np.column_stack([np.cos(turns), np.sin(turns)])
    c, s = math.cos(yaw), math.sin(yaw)
    points = np.concatenate([np.column_stack([ring @ [[c, s], [-s, c]], np.full(48, z)]) for z in (0, size[2])])
    hull = ConvexPart.hull_of(points + foot)
    return Solid(vertices=hull.vertices, faces=hull.faces)


@pytest.mark.parametrize(("rounding", "yaw"), [(0.55, 0.8), (0.75, 0.3)])
def test_a_tin_has_rounded_edges(rounding: float, yaw: float):
    true = tin(FOOT, (0.1, 0.06, 0.085), yaw, rounding)
    choice = chosen_for(true, "potted meat can")
    assert choice.best.family == "rounded box"
    extents = np.ptp(found(fit_rounded(seen(true), 0.0)).solid.vertices, axis=0)
    assert np.allclose(extents, np.ptp(true.vertices, axis=0), rtol=0.12)
    sharp = chosen_for(block(FOOT, (0.1, 0.06, 0.085), yaw), "potted meat can")
    assert sharp.best.family == "box"


@pytest.mark.parametrize(
    ("label", "word"),
    [
        ("tomato_soup_can", "can"),
        ("Lemon juice bottle", "bottle"),
        ("a bowl of apples", "bowl"),
        ("apple box", "box"),
        ("glass bowl", "bowl"),
        ("tomatoes", "tomato"),
        ("cup with a spoon", "cup"),
        ("thing", ""),
    ],
)
def test_a_label_names_by_its_head_noun(label: str, word: str):
    """A tomato soup can was kept from being a can: fruit has no edges."""
    assert head(label) == word


def test_nothing_that_fruit_are_has_edges():
    for true in (can(FOOT, 0.03, 0.06), block(FOOT, (0.06, 0.06, 0.05), 0.5), ball(FOOT, 0.03)):
        assert chosen_for(true, "lemon").best.family not in EDGED


TILTED = CAMERA.moved(
    CAMERA.T_world_camera @ pose(rotation_about([1, 0, 0], math.radians(2.5)) @ rotation_about([0, 0, 1], 0.02))
)
"""A camera that a photo's edges tell 2.5 degrees too steep, and a little rolled."""


@pytest.mark.parametrize("yaw", [0.5, 0.9])
def test_the_inner_edges_of_a_box_are_where_the_photo_has_them(yaw: float):
    true = block(FOOT, (0.1, 0.1, 0.1), yaw)
    mask, rgb = mask_of(true), faces_painted(true)
    near = np.argmin(np.where(CORNERS[:, 2] == 1, np.linalg.norm(true.vertices - CAMERA.center, axis=1), np.inf))
    corner = CAMERA.project(true.vertices[None, near])[0][0]

    def error(colours: np.ndarray | None) -> float:
        fit = found(fit_box(Outlined.of(mask, TILTED, colours), 0.0))
        assert fit.overlap > 0.96
        top = fit.solid.vertices[fit.solid.vertices[:, 2] > fit.solid.vertices[:, 2].max() - 1e-6]
        nearest = top[np.argmin(np.linalg.norm(top - TILTED.center, axis=1))]
        return float(np.linalg.norm(TILTED.project(nearest[None])[0][0] - corner))

    assert error(rgb) < 1.5
    assert error(None) > 2.5


def test_a_box_of_one_colour_keeps_the_edges_of_its_outline():
    true = block(FOOT, (0.1, 0.1, 0.1), 0.6)
    mask = mask_of(true)
    noise = np.random.default_rng(0).integers(118, 138, (*mask.shape, 3)).astype(np.uint8)
    plain, told = (found(fit_box(Outlined.of(mask, TILTED, c), 0.0)).solid.vertices for c in (noise, None))
    assert np.allclose(plain, told, atol=1e-9)


def faces_painted(box: Solid) -> np.ndarray:
    """A photo (h, w, 3) of a box: each of its sides has a colour."""
    rgb = np.full((CAMERA.height, CAMERA.width, 3), 128, np.uint8)
    colours = np.random.default_rng(3).integers(30, 220, (6, 3))
    for side in np.argsort(-np.linalg.norm(box.vertices[box.faces[::2]].mean(1) - CAMERA.center, axis=1)):
        part = Solid(vertices=box.vertices, faces=box.faces[2 * side : 2 * side + 2])
        rgb[mask_of(part)] = colours[side]
    return rgb


def test_a_can_has_a_flat_top_of_its_own_width():
    fit = found(fit_revolution(seen(can(FOOT, 0.04, 0.12)), 0.0))
    vertices = fit.solid.vertices
    assert fit.overlap > 0.96
    assert np.allclose(np.ptp(vertices, axis=0), [0.08, 0.08, 0.12], rtol=0.08)
    top = vertices[vertices[:, 2] > vertices[:, 2].max() - 1e-6]
    assert np.ptp(top[:, 0]) > 0.06


@pytest.mark.parametrize(("radius", "height"), [(0.04, 0.12), (0.06, 0.06), (0.05, 0.2)])
@pytest.mark.parametrize("hidden", [0.0, 0.4])
def test_a_cylinder_keeps_its_edges_and_goes_on_where_it_is_hidden(radius: float, height: float, hidden: float):
    """What stands before it hides the left part of its outline, the lower end included."""
    true = can(FOOT, radius, height)
    whole = mask_of(true)
    columns = np.flatnonzero(whole.any(0))
    before = np.zeros_like(whole)
    before[:, : round(columns[0] + hidden * len(columns))] = hidden > 0
    fit = found(fit_cylinder(Outlined.of(whole & ~before, CAMERA).behind(before), 0.0))
    assert fit.overlap > 0.97
    assert np.allclose(
        np.ptp(fit.solid.vertices, axis=0), [2 * radius, 2 * radius, height], rtol=0.1 if hidden else 0.05
    )
    for end in (0, height):
        rim = fit.solid.vertices[np.abs(fit.solid.vertices[:, 2] - end) < 0.05 * height]
        assert np.ptp(rim[:, 0]) > 1.8 * radius


def test_a_ball_is_round_at_both_ends():
    fit = found(fit_revolution(seen(ball(FOOT, 0.05)), 0.0))
    heights = fit.solid.vertices[:, 2]
    assert fit.overlap > 0.95
    assert np.allclose(np.ptp(fit.solid.vertices, axis=0), 0.1, rtol=0.12)
    for end in (heights.min(), heights.max()):
        rest = fit.solid.vertices[np.abs(heights - end) < 1e-6]
        assert np.ptp(rest[:, 0]) < 0.04


@pytest.mark.parametrize(("at", "radius"), [((0.02, 0.85), 0.05), ((-0.3, 1.2), 0.12), ((0.2, 0.6), 0.03)])
@pytest.mark.parametrize("floor", [0.0, 0.1])
def test_a_ball_is_where_its_outline_and_its_floor_put_it(at: tuple[float, float], radius: float, floor: float):
    foot = np.array([*at, floor])
    fit = found(fit_ball(seen(ball(foot, radius)), floor))
    middle = (fit.solid.vertices.min(0) + fit.solid.vertices.max(0)) / 2
    assert fit.overlap > 0.97
    assert np.linalg.norm(middle - foot - radius * UP) < 0.05 * radius
    assert np.allclose(np.ptp(fit.solid.vertices, axis=0), 2 * radius, rtol=0.03)
    assert abs(fit.solid.vertices[:, 2].min() - floor) < 1e-9


def test_a_ball_half_hidden_is_as_large():
    foot, radius = np.array([0.0, 0.8, 0]), 0.06
    mask = mask_of(ball(foot, radius))
    columns = np.flatnonzero(mask.any(0))
    hidden = np.zeros_like(mask)
    hidden[:, (columns[0] + columns[-1]) // 2 :] = True
    half = Outlined.of(mask & ~hidden, CAMERA).behind(hidden)
    fit = found(fit_ball(half, 0.0))
    assert np.allclose(np.ptp(fit.solid.vertices, axis=0), 2 * radius, rtol=0.06)
    assert fit_ball(seen(ball(foot, radius)), 0.7) is None, "a floor above the camera"


def test_a_label_makes_a_ball_of_what_a_silhouette_leaves_open():
    true = ball(FOOT, 0.05)
    assert chosen_for(true, "tennis ball").best.family == "ball"
    assert chosen_for(true, "").best.family == "solid of revolution", "a ball rolls: no silhouette is enough for that"
    assert chosen_for(can(FOOT, 0.04, 0.12), "can").best.family == "cylinder"


@pytest.mark.parametrize(("rim", "height"), [(0.08, 0.06), (0.12, 0.03), (0.05, 0.09)])
def test_a_bowl_is_hollow_and_its_pieces_hold_it(rim: float, height: float):
    fit = found(fit_hollow(seen(bowl(FOOT, rim, height)), 0.0, usual=Usual(height / rim, 0.55, 0.06)))
    assert fit.overlap > 0.95
    assert np.allclose(np.ptp(fit.solid.vertices, axis=0)[:2], 2 * rim, rtol=0.08)
    mesh = mesh_of(fit.solid)
    made = proxies.decompose(mesh)
    assert made.method == "given" and len(made.parts) <= 45
    assert made.outside < 1e-6
    assert signed_volume(mesh.vertices, mesh.faces) < 0.6 * mesh.hull.volume
    middle = np.array([*FOOT[:2], height / 2])
    assert not any(is_inside(piece, middle) for piece in fit.solid.pieces)


def mesh_of(solid: Solid) -> Mesh:
    photo = Photo(rgb=np.zeros((CAMERA.height, CAMERA.width, 3), np.uint8))
    return textured(solid, np.zeros(3), photo, mask_of(solid), CAMERA)


def is_inside(corners: Array, point: Array) -> bool:
    from scipy.spatial import ConvexHull

    planes = ConvexHull(corners).equations
    return bool((planes[:, :3] @ point + planes[:, 3] < 0).all())


def test_a_bowl_upside_down_is_known_from_its_outline():
    for over, family in ((False, "bowl or cup"), (True, "bowl or cup upside down")):
        true = bowl(FOOT, 0.09, 0.08, upside_down=over)
        chosen = chosen_for(true, "red bowl")
        assert chosen.best.family == family
        assert chosen.best.overlap > 0.95


def chosen_for(true: Solid, label: str, carrier: Choice | None = None) -> Choice:
    instance = Instance(id=0, label=label, name="00.png", mask=mask_of(true))
    return choose(instance, seen(true), carrier, distance=1.0, loaded=False)


def test_a_pan_keeps_its_handle():
    handle = block(FOOT + np.array([0.17, 0, 0.03]), (0.2, 0.03, 0.015), 0.0)
    pan = joined(bowl(FOOT, 0.1, 0.04), handle)
    assert pan is not None
    fit = found(fit_hollow(seen(pan), 0.0, usual=Usual(0.4, 0.55, 0.06)))
    assert fit.overlap > 0.93
    assert np.ptp(fit.solid.vertices[:, 0]) > 0.34


FITS = {
    "ball": fit_ball,
    "box": fit_box,
    "carved": fit_carved,
    "revolution": fit_revolution,
    "cylinder": fit_cylinder,
    "standing": fit_standing,
    "lying": fit_lying,
    "hollow": lambda seen, floor: fit_hollow(seen, floor, usual=Usual(1.0, 0.55, 0.06)),
    "upside down": lambda seen, floor: fit_hollow(seen, floor, usual=Usual(1.0, 0.55, 0.06), upside_down=True),
}


@pytest.mark.parametrize("floor", [0.0, 0.1])
@pytest.mark.parametrize("family", FITS)
def test_every_shape_is_a_closed_solid_on_its_support(family: str, floor: float):
    true = can(FOOT + floor * UP, 0.05, 0.1)
    fit = found(FITS[family](seen(true), floor))
    mesh = mesh_of(fit.solid)
    assert mesh.is_solid
    assert abs(float(fit.solid.vertices[:, 2].min()) - floor) < 2e-3
    assert fit.overlap > 0.8


def test_what_something_before_it_cuts_in_two_is_one_body_that_stands():
    mask = mask_of(can(FOOT, 0.08, 0.3))
    rows = np.flatnonzero(mask.any(1))
    hidden = np.zeros_like(mask)
    hidden[rows[-1] - len(rows) // 3 : rows[-1] - len(rows) // 5] = True  # the larger part ends above the floor
    fit = found(fit_standing(Outlined.of(mask & ~hidden, CAMERA).behind(hidden), 0.0))
    assert float(fit.solid.vertices[:, 2].min()) == pytest.approx(0, abs=2e-3)
    assert fit.overlap > 0.9


def test_a_silhouette_whose_feet_are_lost_does_not_stand():
    mask = mask_of(can(FOOT, 0.08, 0.3))
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    mask[rows[-1] - len(rows) // 4 :] = False
    mask[rows[-1] - 6 : rows[-1], columns.mean().astype(int) + np.arange(6)] = True
    assert fit_standing(Outlined.of(mask, CAMERA), 0.0) is None


def test_what_lies_is_stable():
    fit = found(fit_lying(seen(block(FOOT, (0.25, 0.03, 0.02), 0.4)), 0.0))
    assert is_stable(fit.solid)
    assert not is_stable(ball(FOOT, 0.05))
    assert is_stable(block(FOOT, (0.1, 0.1, 0.1), 0.0))
    assert not is_stable(block(FOOT, (0.02, 0.02, 0.4), 0.0))


def test_what_stands_on_another_is_told_from_what_stands_behind_it():
    under = can(FOOT, 0.08, 0.08)
    on_top = block(FOOT + 0.08 * UP, (0.06, 0.05, 0.06), 0.3)
    behind = block(FOOT + np.array([0, 0.19, 0]), (0.12, 0.06, 0.09), 0.0)
    carrier = chosen_for(under, "can")
    for thing, stands in ((on_top, True), (behind, False)):
        shown = mask_of(thing) & (~mask_of(under) if not stands else True)
        masks = {0: mask_of(under) & ~(mask_of(thing) if stands else False), 1: shown}
        assert (below(masks)[1] == 0 and carries(Outlined.of(shown, CAMERA), carrier)) is stands
    assert (
        below({0: mask_of(under), 1: mask_of(block(FOOT + np.array([0.3, 0, 0]), (0.05, 0.05, 0.05), 0))})[1] == GROUND
    )


def test_many_starts_reach_the_same_minimum():
    target = np.array([0.3, -0.2, 0.1])

    def residuals(x: Array) -> Array:
        return np.concatenate([x - target, (x**2 - target**2)], axis=1)

    starts = np.random.default_rng(0).uniform(-0.5, 0.5, (6, 3))
    x, costs = refined(residuals, starts, iterations=40)
    assert np.allclose(costs, cost(residuals(x)))
    assert np.abs(x[np.argmin(costs)] - target).max() < 1e-3


LIFTED = ("03_bowl", "04_orange", "05_book", "06_dotted_mug")
"""A part of the example: things of every kind of fit, one of them in another."""


@pytest.fixture(scope="module")
def lifted(tmp_path_factory: pytest.TempPathFactory):
    folder = part_of_example(tmp_path_factory.mktemp("lifted") / "part", LIFTED)
    return read_inputs(folder, ignore=("assets", "geometry"))


@pytest.mark.slow
def test_a_photo_and_masks_are_enough_and_the_report_says_so(lifted):
    told = [d for d in lifted.decisions if d.fallback]
    assert any("geometry" in d.choice for d in told) and any("assets" in d.choice for d in told)
    assert {d.about for d in lifted.decisions if d.choice.startswith("mesh: ")} == {i.id for i in lifted.instances}
    assert lifted.geometry.source == "ground"


def test_things_each_of_which_seems_below_the_other_are_lifted(monkeypatch: pytest.MonkeyPatch):
    """In a ring none is lifted before all that is below it."""
    monkeypatch.setattr("f3sr.lifting.lifted_assets.below", lambda masks: {0: 1, 1: 0})
    camera = CAMERA.resized(CAMERA.width // 2, CAMERA.height // 2)
    masks = [mask_of(block(FOOT + np.array([x, 0, 0]), (0.1, 0.07, 0.15), 0.3), camera) for x in (-0.1, 0.1)]
    y, x = np.mgrid[: camera.height, : camera.width] + 0.5
    rays = np.stack([x, y, np.ones_like(x)], axis=-1) @ np.linalg.inv(camera.K).T
    down = rays @ camera.T_world_camera[2, :3]
    valid = (down < -0.05) & ~masks[0] & ~masks[1]
    points = rays * np.where(valid, -camera.center[2] / np.where(valid, down, -1), 1)[..., None]
    image = PromptedImage(
        photo=Photo(rgb=np.full((*valid.shape, 3), 128, np.uint8)),
        instances=tuple(Instance(id=k, label="", name=f"{k:02d}.png", mask=mask) for k, mask in enumerate(masks)),
    )
    geometry = Geometry(points=points.astype(np.float32), valid=valid, source="ground")
    assert LiftedAssets().generate(image, geometry, camera.K).keys() == {0, 1}


@pytest.mark.slow
def test_what_something_without_a_mask_hides_is_lifted_whole_where_a_geometry_shows_that():
    """A box behind a board that nobody outlined."""
    scene = photographed(
        box(0, size=(0.16, 0.005, 0.1), at=(0.05, -0.12, 0.05)), box(1, at=(0, 0, 0.05)), on_ground=True
    )
    geometry, mask = scene.geometry, scene[1].mask
    assert geometry
    whole = full_silhouette(scene[1], scene.camera)
    image = PromptedImage(
        photo=Photo(rgb=np.full((*mask.shape, 3), 128, np.uint8)),
        instances=(Instance(id=1, label="box", name="01.png", mask=mask),),
    )

    def lifted(geometry: Geometry) -> float:
        asset = LiftedAssets().generate(image, geometry, scene.camera.K)[1]
        T = scene.camera.T_world_camera @ asset.T_camera_object
        o = replace(scene[1], mesh=asset.mesh, T_world_object=T, scale=1.0)
        return iou(full_silhouette(o, scene.camera), whole)

    cut = lifted(replace(geometry, source="ground"))
    assert np.count_nonzero(mask) < 0.9 * np.count_nonzero(whole) and cut < 0.92
    assert lifted(geometry) > 0.96


def test_alignment_neither_tilts_lifted_things_nor_moves_the_camera(lifted):
    scene, _ = level(assemble(as_given(lifted))[0])
    aligned, told = align(scene)
    assert np.array_equal(aligned.camera.T_world_camera, scene.camera.T_world_camera)
    assert np.mean(list(told.after.values())) >= np.mean(list(told.before.values())) - 1e-3  # hidden pixels count here
    for o in aligned:
        turn = o.T_world_object[:3, :3] @ scene[o.id].T_world_object[:3, :3].T
        assert np.allclose(turn @ UP, UP, atol=1e-9)


def table(foot: Array, size: Sequence[float], yaw: float, leg: float = 0.05) -> Solid:
    """A board on four legs."""
    (w, d, h), c, n = size, math.cos(yaw), math.sin(yaw)
    made = block(foot + (h - leg) * UP, (w, d, leg), yaw)
    for x in (-0.5, 0.5):
        for y in (-0.5, 0.5):
            u, v = x * (w - leg), y * (d - leg)
            both = joined(made, block(foot + np.array([c * u - n * v, n * u + c * v, 0]), (leg, leg, h - leg / 2), yaw))
            assert both is not None
            made = both
    return made


LOW = Camera(
    width=640,
    height=480,
    K=np.array([[600.0, 0, 320], [0, 600, 240], [0, 0, 1]]),
    T_world_camera=pose(attitude(math.radians(6), 0.0).T, [0, 0, 1.1]),
)
"""A camera in a room: the ground's metres are few rows."""


@pytest.mark.parametrize("yaw", [0.3, 0.9])
def test_what_is_carved_is_as_deep_as_wide_has_legs_and_covers_the_mask(yaw: float):
    true = table(np.array([0.1, 3.2, 0]), (0.8, 0.6, 0.5), yaw)
    mask = rasterizer.silhouette(LOW.to_camera(true.vertices), true.faces, LOW.K, LOW.width, LOW.height)
    fit = found(fit_carved(Outlined.of(mask, LOW), 0.0))
    assert fit.overlap > 0.94
    wide, deep, high = np.ptp(fit.solid.vertices, axis=0)
    assert deep < 2 * wide and abs(high - 0.5) < 0.15
    assert is_stable(fit.solid)
    volume = signed_volume(fit.solid.vertices, fit.solid.faces)
    assert volume < 0.5 * wide * deep * high, "there is air between the legs"


def test_of_all_mirror_images_the_best_is_taken_though_few_are_intersected(monkeypatch: pytest.MonkeyPatch):
    true = table(np.array([0.1, 3.2, 0]), (0.8, 0.6, 0.5), 0.3)
    mask = rasterizer.silhouette(LOW.to_camera(true.vertices), true.faces, LOW.K, LOW.width, LOW.height)
    seen, tried = Outlined.of(mask, LOW), list[FittedShape]()

    def noted(a: Solid, b: Solid) -> Solid | None:
        made = common(a, b)
        tried.extend([FittedShape.of("", made, seen)] if made else [])
        return made

    monkeypatch.setattr(boxes, "common", noted)
    fast, few = found(fit_carved(seen, 0.0)), len(tried)
    monkeypatch.setattr(Outlined, "most_overlap", lambda *_: 1.0)
    every = found(fit_carved(seen, 0.0))
    best = max(fit.overlap for fit in tried[few:])
    assert len(tried) - few == 2 * len(boxes.TURNS) * len(boxes.SHIFTS) > 3 * few > 0
    assert every.overlap == fast.overlap == best
    assert np.array_equal(every.solid.vertices, fast.solid.vertices)
    assert np.array_equal(every.solid.faces, fast.solid.faces)


def painted(solid: Solid, colours: Sequence[tuple[float, tuple[int, int, int]]]) -> Photo:
    """A photo in which the columns from a share of the solid's width on have a colour."""
    mask = mask_of(solid)
    columns = np.flatnonzero(mask.any(0))
    rgb = np.full((*mask.shape, 3), 128, np.uint8)
    for share, colour in colours:
        rgb[:, round(columns[0] + share * (columns[-1] + 1 - columns[0])) :] = colour
    return Photo(rgb=rgb)


def colour_at(mesh: Mesh, point: Array) -> Array:
    """The texture's colour (3,) at the vertex that is nearest to a point (3,)."""
    assert mesh.uv is not None and mesh.materials[0].texture is not None
    texture = mesh.materials[0].texture
    u, v = mesh.uv[np.argmin(np.linalg.norm(mesh.vertices - point, axis=1))]
    return texture[int((1 - v) * (texture.shape[0] - 1)), int(u * (texture.shape[1] - 1))].astype(float)


def test_the_back_of_a_box_looks_as_its_front_turned_round():
    true = block(FOOT, (0.2, 0.06, 0.15), 0.0)
    fit = found(fit_box(seen(true), 0.0))
    red, blue = (220, 30, 30), (30, 30, 220)
    mesh = textured(fit.solid, np.zeros(3), painted(true, [(0, red), (0.5, blue)]), mask_of(true), CAMERA)
    low, high = mesh.bounds
    middle, z = (low + high) / 2, 0.6 * high[2]
    for share, colour in ((-0.3, red), (0.3, blue)):
        u = share * (high[0] - low[0])
        assert np.abs(colour_at(mesh, np.array([middle[0] + u, low[1], z])) - colour).max() < 40
        assert np.abs(colour_at(mesh, np.array([middle[0] - u, high[1], z])) - colour).max() < 40


def test_the_back_of_a_can_goes_on_from_its_sides_without_a_step():
    true = can(FOOT, 0.06, 0.15)
    fit = found(fit_revolution(seen(true), 0.0))
    red, blue = (220, 30, 30), (30, 30, 220)
    mesh = textured(fit.solid, np.zeros(3), painted(true, [(0, red), (0.5, blue)]), mask_of(true), CAMERA)
    low, high = mesh.bounds
    middle, radius = (low + high) / 2, (high[0] - low[0]) / 2
    for angle, colour in ((200, red), (160, red), (120, red), (60, blue), (20, blue), (-20, blue)):
        at = [middle[0] + radius * math.cos(math.radians(angle)), middle[1] + radius * math.sin(math.radians(angle))]
        assert np.abs(colour_at(mesh, np.array([*at, 0.5 * high[2]])) - colour).max() < 40, angle


@pytest.mark.parametrize("yaw", [0.0, 0.7])
def test_sides_of_a_box_that_no_photo_shows_look_as_its_front(yaw: float):
    """Seen straight on, a box shows its front and its top. Its other sides were a blur of both."""
    turn = pose(rotation_about([0, 0, 1], yaw), [0, 0, 0])
    camera = replace(CAMERA, T_world_camera=turn @ CAMERA.T_world_camera)
    foot, size = turn[:3, :3] @ [0, 0.85, 0], np.array([0.1, 0.06, 0.15])
    true = block(foot, size, yaw)
    K, w, h = camera.K, camera.width, camera.height
    mask = rasterizer.silhouette(camera.to_camera(true.vertices), true.faces, K, w, h)
    edge, _ = camera.project((foot + turn[:3, :3] @ [0, -0.03, 0.15])[None])
    rgb = np.full((h, w, 3), (30, 30, 200), np.uint8)
    rgb[: round(float(edge[0, 1]))] = 200, 30, 30
    solid = replace(subdivided(true), symmetry="box")
    mesh = textured(solid, np.zeros(3), Photo(rgb=rgb), mask, camera)
    for side in (-1, 1):
        at = foot + turn[:3, :3] @ [side * 0.05, 0.0225, 0.13125]
        assert np.abs(colour_at(mesh, at) - [30, 30, 200]).max() < 40


def test_print_goes_round_a_can_and_is_nowhere_a_mirror_image():
    """Columns of a label get brighter to the right in five panels: so they do all around, but at seams."""
    true = can(FOOT, 0.06, 0.15)
    mask = mask_of(true)
    columns = np.flatnonzero(mask.any(0))
    across = np.clip(np.arange(mask.shape[1]) - columns[0], 0, len(columns) - 1) / len(columns)
    rgb = np.repeat(np.tile(60 + 150 * (5 * across % 1), (mask.shape[0], 1))[..., None], 3, axis=2).astype(np.uint8)
    mesh = textured(found(fit_cylinder(seen(true), 0.0)).solid, np.zeros(3), Photo(rgb=rgb), mask, CAMERA)
    texture = mesh.materials[0].texture
    assert texture is not None
    row = texture[len(texture) // 3, :, 0].astype(float)
    rises = np.diff(row)
    assert (rises > 0).mean() > 0.75 and (row[:30].std() > 30 and row[-30:].std() > 30)


def test_the_upper_end_of_a_can_is_the_photos_also_where_it_is_seen_from_low():
    """Its lid became plain as soon as it moved."""
    low = replace(CAMERA, T_world_camera=pose(attitude(math.radians(10), 0.0).T, [0, 0, 0.25]))
    true = can(FOOT, 0.06, 0.1)
    K, w, h = low.K, low.width, low.height
    mask = rasterizer.silhouette(low.to_camera(true.vertices), true.faces, K, w, h)
    rgb = np.full((h, w, 3), 200, np.uint8)
    pixels, _ = low.project(FOOT + np.array([[0, 0, 0.1]]) + 0.06 * np.array([[-1, 0, 0], [1, 0, 0]]))
    top = int(np.flatnonzero(mask.any(1))[0])
    rim = round(float(pixels[:, 1].mean()))
    assert 4 < 2 * (rim - top) < 30, "a narrow ellipse"
    rgb[: 2 * rim - top] = 40
    mesh = textured(replace(true, symmetry="round"), np.zeros(3), Photo(rgb=rgb), mask, low)
    colours, above = texels(mesh)[:, 0], mesh.vertices[:, 2] > 0.0999
    inner = above & (np.hypot(*(mesh.vertices - FOOT)[:, :2].T) < 0.03)
    assert inner.any() and colours[inner].max() < 90


def test_a_seam_runs_where_copies_differ_least():
    rng = np.random.default_rng(3)
    known = np.repeat(rng.uniform(0, 255, (20, 60, 1)), 3, axis=2)
    known[:, [1, -2]] = 128.0
    made = quilted(known, 160)
    assert made.shape == (20, 160, 3) and np.array_equal(made[:, 8:52], known[:, 8:52])
    halves = np.zeros((4, 50, 3))
    halves[:, 25:] = 200.0
    steps = np.abs(np.diff(np.pad(quilted(halves, 150), ((0, 0), (0, 1), (0, 0)), mode="wrap")[..., 0], axis=1))
    assert (steps[0] > 100).sum() == 2, "a thing with two halves stays one"


def texels(mesh: Mesh) -> Array:
    """The texture's colour (n, 3) at every vertex."""
    texture = mesh.materials[0].texture
    assert texture is not None and mesh.uv is not None
    height, width = texture.shape[:2]
    x, y = (mesh.uv * [width, -height] + [0, height]).astype(int).T
    return texture[np.clip(y, 0, height - 1), np.clip(x, 0, width - 1)].astype(float)


def test_what_is_regular_stays_so_where_that_explains_the_mask():
    """A sphere half a pixel too small is not bent at all, and a box that is too small is stretched as a whole."""
    outlined = seen(ball(FOOT, 0.0605))
    fit = FittedShape.of("ball", ball(FOOT, 0.06), outlined)
    assert 0.97 < fit.overlap < 0.99
    assert np.array_equal(fitted_to_outline(fit, outlined, regular=True).solid.vertices, fit.solid.vertices)
    assert fitted_to_outline(fit, outlined).overlap > fit.overlap + 0.005
    outlined = seen(block(FOOT, (0.2, 0.16, 0.1), 0.4))
    fit = FittedShape.of("box", block(FOOT, (0.188, 0.15, 0.094), 0.4), outlined)
    stretched = fitted_to_outline(fit, outlined, regular=True)
    assert fit.overlap < 0.94 and stretched.overlap > 0.97
    before, after = (CAMERA.project(s.vertices)[0] for s in (fit.solid, stretched.solid))
    terms = np.column_stack([before, np.ones(len(before))])
    bent = after - terms @ np.linalg.lstsq(terms, after, rcond=None)[0]
    assert np.abs(bent).max() < 1.0


@pytest.mark.parametrize("shape", [(1, 1, 1), (1, 1, 1.3), (1, 1.3, 1)])
def test_a_ball_has_no_seam_where_the_photo_ends(shape: tuple[float, float, float]):
    """Its lower half is in shadow: where the photo ends, what is not seen goes on in the same colours."""
    true = Solid(vertices=(ball(FOOT, 0.05).vertices - FOOT) * shape + FOOT, faces=ball(FOOT, 0.05).faces)
    fit = fitted_to_outline(found(fit_ball(seen(true), 0.0)), seen(true))
    rows = np.flatnonzero(mask_of(true).any(1))
    shade = np.clip((np.arange(CAMERA.height) - rows[0]) / (rows[-1] - rows[0]), 0, 1)
    rgb = np.repeat((230 - 180 * shade)[:, None, None], CAMERA.width, 1) * np.ones(3)
    mesh = textured(fit.solid, np.zeros(3), Photo(rgb=rgb.astype(np.uint8)), mask_of(true), CAMERA)
    colours = texels(mesh)
    assert np.ptp(colours[mesh.faces], axis=1).max() < 35
    _, place = np.unique(np.round(mesh.vertices, 9), axis=0, return_inverse=True)
    for k in np.flatnonzero(np.bincount(place.ravel()) > 1):
        assert np.ptp(colours[place.ravel() == k], axis=0).max() < 12


def test_print_on_a_ball_is_faint_behind_and_is_nowhere_seen_along_the_rays():
    """A dot in the middle is in the middle of the back too, but faint. A ring at 80 degrees from the camera is left
    out."""
    true = ball(FOOT, 0.05)
    solid = found(fit_ball(seen(true), 0.0)).solid
    middle = (solid.vertices.min(0) + solid.vertices.max(0)) / 2
    towards = (CAMERA.center - middle) / np.linalg.norm(CAMERA.center - middle)
    (pixel,), _ = CAMERA.project(middle[None])
    y, x = np.mgrid[: CAMERA.height, : CAMERA.width] + 0.5
    out = np.hypot(x - pixel[0], y - pixel[1]) / math.sqrt(mask_of(true).sum() / np.pi)
    rgb = np.full((*out.shape, 3), 120, np.uint8)
    rgb[out < 0.15], rgb[(out > 0.95) & (out < 0.98)] = 250, 0
    mesh = textured(solid, np.zeros(3), Photo(rgb=rgb), mask_of(true), CAMERA)
    off = mesh.vertices - middle
    angle = np.degrees(np.arccos(np.clip(off @ towards / np.linalg.norm(off, axis=1), -1, 1)))
    shown = texels(mesh)[:, 0]
    assert shown[angle < 5].min() > 200
    assert 140 < shown[angle > 170].min() <= shown[angle > 170].max() < 180, "120 is plain, 250 the dot"
    assert (np.abs(shown[(angle > 60) & (angle < 140)] - 120) < 30).all()


def test_the_back_of_a_warped_box_looks_as_its_front_to_the_very_edge():
    """Its mask is that of a box that leans. What is hidden looks as the vertices opposite, none across an edge."""
    upright = block(FOOT, (0.12, 0.1, 0.15), 0.6)
    leaning = Solid(vertices=upright.vertices + 0.15 * upright.vertices[:, 2:] * [1, 0, 0], faces=BOX_FACES)
    outlined = seen(leaning)
    warped = fitted_to_outline(found(fit_box(outlined, 0.0)), outlined)
    mesh = textured(warped.solid, np.zeros(3), Photo(rgb=np.zeros((480, 640, 3), np.uint8)), mask_of(leaning), CAMERA)
    assert mesh.uv is not None
    assert len(np.unique(np.round(mesh.uv, 6), axis=0)) < 0.6 * len(warped.solid.vertices)


def test_a_ball_in_the_light_from_above_is_no_brighter_at_its_rim_than_in_the_photo():
    true = ball(FOOT, 0.05)
    mask = mask_of(true)
    rows, columns = (np.flatnonzero(mask.any(k)) for k in (1, 0))
    y, x = np.mgrid[: CAMERA.height, : CAMERA.width]
    down = (y - rows.mean()) / (0.5 * len(rows))
    out = np.clip(down**2 + ((x - columns.mean()) / (0.5 * len(columns))) ** 2, 0, 1)
    grey = np.clip(60 + 180 * (0.3 * np.sqrt(1 - out) + 0.35 * (1 - down)), 0, 255)
    rgb = (grey[..., None] * np.ones(3)).astype(np.uint8)
    fit = found(fit_ball(seen(true), 0.0))
    mesh = textured(replace(fit.solid, symmetry=""), np.zeros(3), Photo(rgb=rgb), mask, CAMERA)
    off = list[float]()
    for point in (p for p in mesh.vertices if 0.002 < p[2] < 0.02):
        (pixel,), _ = CAMERA.project(point[None])
        u, v = np.clip(pixel.astype(int), 0, [CAMERA.width - 1, CAMERA.height - 1])
        if mask[v, u]:
            off.append(colour_at(mesh, point)[0] - grey[v, u])
    assert len(off) > 50 and abs(float(np.median(off))) < 6


SUN = np.array([0.5, -0.35, 0.8]) / np.linalg.norm([0.5, -0.35, 0.8])
COLOURS = ((200, 60, 50), (90, 150, 70), (60, 80, 190))
TABLE = np.full((CAMERA.height, CAMERA.width, 3), 130, np.uint8)


@cache
def lit_photo(direct: float, sky: float) -> Photo:
    """Solids of one colour each on a grey table with their shadows, in the light of SUN and of an even sky."""
    shown = on_a_table()
    strength = np.array([0.0, direct, sky, 0.15])
    light = PhotoLight.of(strength, SUN, 0.0, [], (FOOT, 1.0))
    casters = [Caster(s.solid.vertices, s.solid.faces, closed=True) for s in shown]
    shaded = PhotoLight.of(strength, SUN, math.radians(5), casters, (FOOT, 0.6))
    rgb = TABLE.copy()
    pixels = np.argwhere(np.ones(TABLE.shape[:2], np.bool_))
    points = ground_points(CAMERA, pixels)
    near = np.linalg.norm(points - FOOT, axis=1) < 0.5
    here = shaded.on(points[near], np.tile(UP, (np.count_nonzero(near), 1)))
    open_table = float(strength @ [1, SUN[2], 1, 0])
    rgb[tuple(pixels[near].T)] = np.round(255 * srgb(LINEAR[130] * np.minimum(here / open_table, 1)))[:, None]
    for s, colour in zip(shown, COLOURS, strict=True):
        bright = LINEAR[list(colour)] * light.on(s.points[s.own], s.normals[s.own])[:, None]
        rgb[s.rows, s.columns][s.own] = np.round(255 * srgb(np.clip(bright, 0, 1)))
    return Photo(rgb=rgb)


def on_a_table() -> list[SeenSolid]:
    solids = (
        ball([-0.15, 0.9, 0], 0.05),
        can(FOOT, 0.045, 0.12),
        block(np.array([0.22, 0.95, 0]), (0.1, 0.1, 0.08), 0.6),
    )
    return [SeenSolid.of(solid, mask_of(solid), CAMERA) for solid in solids]


@cache
def found_light() -> PhotoLight:
    """Of the photo that most tests take."""
    return light_of(on_a_table(), lit_photo(0.6, 0.5).rgb, TABLE, CAMERA)


def test_the_light_is_taken_out_of_colours():
    """Solids of one colour each have one colour all over then, and the found light is the true one."""
    shown, photo, light = on_a_table(), lit_photo(0.6, 0.5), found_light()
    angle = math.degrees(math.acos(float(np.clip(light.direction @ SUN, -1, 1))))
    assert angle < 15
    for s in shown:
        inner = shrunk(s.own, 2)
        before = photo.rgb[s.rows, s.columns][inner].astype(float)
        after = light.removed(photo.rgb, s)[s.rows, s.columns][inner].astype(float)
        assert np.all(after.std(0) < 0.35 * before.std(0) + 1), (before.std(0), after.std(0))


def test_shadows_on_the_ground_tell_the_light_of_things_full_of_print():
    """Random colours all over three solids tell nothing of it."""
    shown = on_a_table()
    rgb = lit_photo(0.6, 0.5).rgb
    anywhere = union_of((s.mask for s in shown), TABLE.shape[:2])[..., None]
    print_ = np.random.default_rng(0).integers(20, 230, TABLE.shape).astype(np.uint8)
    for table, found in ((rgb, True), (TABLE, False)):
        light = light_of(shown, np.where(anywhere, print_, table), TABLE, CAMERA)
        assert (math.degrees(math.acos(float(np.clip(light.direction @ SUN, -1, 1)))) < 10) is found


@pytest.mark.parametrize(("weight", "least", "most"), [(0.0, 0.05, 1.0), (1e3, 0.0, 0.02)])
def test_usual_light_decides_where_it_weighs_more_than_the_photo(
    weight: float, least: float, most: float, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("f3sr.lifting.unshaded.LIGHT", replace(LIGHT, typical=weight))
    shown = on_a_table()
    light = light_of(shown, lit_photo(0.3, 0.8).rgb, TABLE, CAMERA)
    off = np.abs(light.strength / light.strength.sum() - TYPICAL / TYPICAL.sum()).max()
    assert least <= off <= most


def test_films_light_a_ball_alike_however_it_is_turned():
    """Its colours come from the photo, whose light stays where it is."""
    shown, photo, light = on_a_table(), lit_photo(0.6, 0.5), found_light()
    objects, middles = list[SceneObject](), list[Array]()
    for k, s in enumerate(shown):
        plain = Photo(rgb=light.removed(photo.rgb, s))
        middles.append((s.solid.vertices.min(0) + s.solid.vertices.max(0)) / 2)
        mesh = textured(s.solid, middles[k], plain, s.mask, CAMERA)
        T = pose(t=middles[k])
        objects.append(SceneObject(id=k, label="", mask_name="", mask=s.mask, mesh=mesh, T_world_object=T, lifted=True))
    scene = Scene(photo=photo, camera=CAMERA, objects=tuple(objects))
    table = np.full_like(photo.rgb, 130)
    renderer = Renderer.of(scene, table)
    at_rest = poses_at_rest(scene)
    rest = renderer.frame(at_rest).astype(float)
    inner = shrunk(shown[0].mask, 3)
    assert np.abs(rest - photo.rgb)[inner].mean() < 5
    for axis in (np.array([1.0, 0, 0]), np.array([0.6, 0, 0.8])):
        turned = at_rest.copy()
        turned[0] = pose(rotation_about(axis, np.pi), middles[0])
        frame = renderer.frame(turned).astype(float)
        assert np.abs(frame - rest)[inner].mean() < 6, axis


def box_behind(radius: float, *, share_white: float) -> Array:
    """Colours (n, 3) of a box on its top where a disc of a radius [px] hides its far corner. The top is chequered red
    and white, so much of it, the sides are pink."""
    true = block(FOOT, (0.2, 0.16, 0.1), 0.4)
    mask = mask_of(true)
    rows, columns = np.indices(mask.shape)
    rgb = np.full((CAMERA.height, CAMERA.width, 3), (230, 130, 130), np.uint8)
    top = rasterizer.silhouette(
        CAMERA.to_camera(true.vertices[4:]), np.array([[0, 1, 3], [0, 3, 2]], np.int32), CAMERA.K, 640, 480
    )
    white = np.random.default_rng(0).random((160, 214)) < share_white
    rgb[top] = np.where(white[rows // 3, columns // 3][top][:, None], (230, 230, 230), (230, 30, 30))
    far = min(CAMERA.project(true.vertices[4:])[0], key=lambda corner: corner[1])
    before = np.hypot(columns - far[0], rows - far[1]) < radius
    fit = found(fit_box(seen(true), 0.0))
    mesh = textured(fit.solid, np.zeros(3), Photo(rgb=rgb), mask & ~before, CAMERA)
    points = mesh.vertices[mesh.vertices[:, 2] > 0.098]
    hidden = points[np.hypot(*(CAMERA.project(points)[0] - far).T) < 0.75 * radius]
    return np.array([colour_at(mesh, point) for point in hidden])


def test_what_hides_a_part_of_a_box_is_replaced_by_patches_of_the_same_side():
    """Pink is no part of the top."""
    colours = box_behind(40, share_white=0.5)
    assert len(colours) > 10 and (np.abs(colours[:, 1] - 130) < 60).mean() < 0.5, colours


def test_a_side_of_a_box_that_is_hidden_for_the_most_part_has_its_commonest_colour():
    """Not the mean of red and white, which is pink."""
    colours = box_behind(90, share_white=0.3)
    assert len(colours) > 10 and np.median(colours[:, 1]) < 60, np.median(colours, axis=0)


def test_what_hides_a_part_of_a_ball_leaves_no_second_print():
    """A black word near what is hidden: patches of it came out below when the ball rolled."""
    true = found(fit_ball(seen(ball(FOOT, 0.06)), 0.0)).solid
    mask = mask_of(true)
    rows, columns = np.indices(mask.shape)
    bottom, middle = np.flatnonzero(mask.any(1))[-1], int(columns[mask].mean())
    size = int(np.ptp(rows[mask]))
    rgb = np.full((CAMERA.height, CAMERA.width, 3), (180, 220, 40), np.uint8)
    before = rows > bottom - 0.25 * size
    rgb[(np.abs(columns - middle) < 0.3 * size) & (np.abs(rows - bottom + 0.42 * size) < 0.07 * size)] = 10
    mesh = textured(true, np.zeros(3), Photo(rgb=rgb), mask & ~before, CAMERA)
    pixels = CAMERA.project(mesh.vertices)[0]
    front = ((CAMERA.center - mesh.vertices) * (mesh.vertices - mesh.vertices.mean(0))).sum(1) > 0
    hidden = mesh.vertices[front & (pixels[:, 1] > bottom - 0.12 * size)]
    colours = np.array([colour_at(mesh, point) for point in hidden])
    assert len(colours) > 10 and (colours[:, 1] > 150).mean() > 0.95, colours[:, 1].min()


def test_without_shading_colours_stay_as_they_are():
    shown = on_a_table()
    rgb = np.full((CAMERA.height, CAMERA.width, 3), 130, np.uint8)
    light = light_of(shown, rgb, TABLE, CAMERA)
    for s in shown:
        assert np.abs(light.removed(rgb, s).astype(int) - rgb).max() < 10


def test_light_that_neighbours_throw_on_a_ball_is_not_its_own():
    """A ball darker towards its foot, as in a dark pan: most of that goes, and print stays."""
    shown = on_a_table()
    photo = lit_photo(0.6, 0.5)
    shown[0] = SeenSolid.of(replace(shown[0].solid, symmetry="round"), shown[0].mask, CAMERA)
    own, z = shown[0].own, shown[0].normals[shown[0].own][:, 2]
    taken = photo.rgb.copy()
    there = taken[shown[0].rows, shown[0].columns]
    there[own] = np.round(there[own] * np.exp(0.8 * np.minimum(z, 0))[:, None])
    dots = own & (np.indices(own.shape).sum(0) % 12 < 2)
    there[dots] //= 3
    light = light_of(shown, taken, TABLE, CAMERA)
    after = light.removed(taken, shown[0])[shown[0].rows, shown[0].columns].astype(float)
    plain = shrunk(own, 2) & ~grown(dots, 1)
    was, is_now = (
        c[plain & (shown[0].normals[..., 2] < -0.5)].mean() / c[plain & (shown[0].normals[..., 2] > 0.5)].mean()
        for c in (there.astype(float), after)
    )
    assert was < 0.45 and is_now > 0.7, (was, is_now)
    assert after[dots & shrunk(own, 2)].mean() < 0.6 * after[plain].mean()


def test_a_shadow_that_lies_a_little_off_leaves_no_seam():
    """Its edge is two pixels aside in the model: there colours were 2.5 times too bright. Fine print stays as it is."""
    rows, columns = np.indices((80, 80))
    mask = np.hypot(rows - 40, columns - 40) < 38
    print_ = np.where(columns % 3 == 0, 0.3, 0.5)
    bright = (print_ * np.where(rows < 42, 1.0, 0.4))[mask]
    model = np.where(rows < 40, 1.0, 0.4)[mask]
    light = placed_as_seen(model, bright, mask)
    off, before = (bright / x / print_[mask] for x in (light, model))
    assert before.max() > 2.4 and off.max() < 1.6
    even = np.ones(np.count_nonzero(mask))
    assert np.abs(placed_as_seen(even, bright, mask) - 1).max() < 1e-9, "where the model has no shadow, nothing changes"


def test_a_large_thing_has_its_shadows_placed_as_a_small_one_and_soon():
    """A mask of 600 x 600 pixels took 15 s; one of 1,500 x 1,500 would have taken minutes."""
    rows, columns = np.indices((150, 150))
    mask = np.hypot(rows - 75, columns - 75) < 74
    bright, model = np.where(rows < 80, 1.0, 0.4), np.where(rows < 76, 1.0, 0.4)
    small = np.ones(mask.shape)
    small[mask] = placed_as_seen(model[mask], bright[mask], mask)
    wide, wide_bright, wide_model = (np.kron(a, np.ones((6, 6))) for a in (mask, bright, model))
    large, here = np.ones(wide.shape), wide > 0
    begun = time.process_time()
    large[here] = placed_as_seen(wide_model[here], wide_bright[here], here)
    assert time.process_time() - begun < 5
    assert np.median(np.abs(large - np.kron(small, np.ones((6, 6))))[here]) < 0.02
    seam = here & (np.indices(here.shape)[0] // 6 >= 76) & (np.indices(here.shape)[0] // 6 < 80)
    assert np.median((wide_bright / large)[seam]) < 1.4, "2.5 as the model has it"


def test_print_is_no_shading():
    """A can with a dark label about its middle: light from the side does not explain that."""
    shown = on_a_table()
    photo = lit_photo(0.6, 0.5)
    rgb = photo.rgb.copy()
    rows = slice(shown[1].rows.start + 30, shown[1].rows.start + 60)
    rgb[rows, shown[1].columns][shown[1].mask[rows, shown[1].columns]] //= 3
    plain, printed = found_light(), light_of(shown, rgb, TABLE, CAMERA)
    assert math.degrees(math.acos(float(np.clip(plain.direction @ printed.direction, -1, 1)))) < 15
    assert np.abs(plain.strength - printed.strength).max() < 0.25


def test_a_tapered_side_has_no_steps():
    """Where a row of cells ends one before the next, the side had a ledge of 26 degrees and more."""
    cone = revolved(FOOT, np.array([[0, 0], [0.05, 0], [0.03, 0.2], [0, 0.2]]), sectors=64)
    solid = found(fit_standing(seen(cone), 0.0)).solid
    corners = solid.vertices[solid.faces]
    middles, normals = corners.mean(1), np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    side = (middles[:, 2] > 0.02) & (middles[:, 2] < 0.17)
    out = middles[side] - (solid.vertices.min(0) + solid.vertices.max(0)) / 2
    out[:, 2] = 0.1 * np.linalg.norm(out[:, :2], axis=1)
    areas = np.linalg.norm(normals[side], axis=1)
    cosines = (out * normals[side]).sum(1) / np.maximum(areas * np.linalg.norm(out, axis=1), 1e-12)
    assert areas[cosines < math.cos(math.radians(20))].sum() < 0.005 * areas.sum()


def test_the_same_mask_gives_the_same_mesh():
    first, again = (mesh_of(chosen_for(bowl(FOOT, 0.09, 0.05), "bowl").best.solid) for _ in range(2))
    assert first.vertices.tobytes() == again.vertices.tobytes() and first.faces.tobytes() == again.faces.tobytes()


def test_what_stands_along_the_view_is_not_read_as_lying_away_from_it():
    """Its image is that of a body that lies and is far longer than it looks: that one is rare."""
    neck = np.array([[0, 0], [0.035, 0], [0.035, 0.13], [0.013, 0.17], [0.013, 0.21], [0, 0.21]])
    choice = chosen_for(revolved(FOOT, neck, sectors=64), "")
    assert choice.best.family != "lying silhouette"
    assert np.ptp(choice.best.solid.vertices, axis=0) == pytest.approx([0.07, 0.07, 0.21], rel=0.25)


def test_small_pieces_apart_are_no_part_of_a_mask_unless_something_hides_what_joins_them():
    mask = np.zeros((40, 60), np.bool_)
    mask[10:30, 5:25], mask[10:14, 40:44] = True, True
    between = np.zeros_like(mask)
    between[8:16, 24:41] = True
    nothing = np.zeros_like(mask)
    whole = mask.copy()
    whole[10:14, 40:44] = False
    assert np.array_equal(without_strays(mask, nothing, gap=4, share=0.1), whole)
    assert np.array_equal(without_strays(mask, between, gap=4, share=0.1), mask)
    assert np.array_equal(without_strays(mask, nothing, gap=20, share=0.1), mask), "a gap that a threshold may leave"
    assert np.array_equal(without_strays(mask, nothing, gap=4, share=0.02), mask), "as large as a part of the object"


@pytest.mark.parametrize("shape", [(1.15, 0.85, 1.0), (0.85, 1.1, 1.2), (1.0, 1.0, 1.15)])
def test_a_ball_is_warped_to_the_outline_of_what_is_nearly_a_ball(shape: tuple[float, float, float]):
    """It stays closed and on its support, and is as large as what it stands for."""
    first = ball(FOOT, 0.05)
    true = Solid(vertices=(first.vertices - FOOT) * shape + FOOT, faces=first.faces)
    outlined = seen(true)
    fit = found(fit_ball(outlined, 0.0))
    warped = fitted_to_outline(fit, outlined)
    assert fit.overlap < 0.96 < 0.985 < warped.overlap
    assert warped.overlap == outlined.overlap(warped.solid.vertices, warped.solid.faces)
    assert abs(warped.solid.vertices[:, 2].min()) < 1e-9
    volume = [signed_volume(s.vertices, s.faces) for s in (warped.solid, true)]
    assert volume[0] == pytest.approx(volume[1], rel=0.25)


def test_a_ball_whose_mask_lacks_its_lower_part_gets_no_spike():
    """Its lowest point stayed on the support while all around it moved up with the outline."""
    mask = mask_of(ball(FOOT, 0.05))
    rows = np.flatnonzero(mask.any(1))
    mask[rows[0] + round(0.75 * len(rows)) :] = False
    outlined = Outlined.of(mask, CAMERA)
    made = fitted_to_outline(found(fit_ball(outlined, 0.0)), outlined, on_a_point=True).solid
    assert abs(made.vertices[:, 2].min()) < 1e-9
    hull = trimesh.convex.convex_hull(made.vertices)
    assert signed_volume(made.vertices, made.faces) > 0.99 * hull.volume


def test_the_near_wall_of_a_pan_may_hide_what_is_in_it():
    """A ball in it is as large as it is, though its lower part is not seen."""
    true = bowl(FOOT, 0.12, 0.08)
    pan = mask_of(true)
    instance = Instance(id=0, label="pan", name="00.png", mask=pan)
    wall = choose(instance, seen(true), None, distance=1.0, loaded=True).near_wall(pan, CAMERA)
    pixels, _ = CAMERA.project(FOOT + np.array([[0, 0, 0.08], [0, -0.12, 0.08]]))
    (x, y), (_, edge) = pixels.round().astype(int)
    assert not wall[y, x], "the inside hides nothing"
    assert np.array_equal(wall[edge + 8 :], pan[edge + 8 :]) and wall.any(), "all below the rim's near edge does"
    first = ball(FOOT + np.array([0, -0.05, 0.005]), 0.03)
    shown = mask_of(first) & ~wall
    assert 0.4 < shown.sum() / mask_of(first).sum() < 0.85
    outlined = Outlined.of(shown, CAMERA).behind(wall)
    made = fitted_to_outline(found(fit_ball(outlined, 0.005)), outlined, on_a_point=True).solid
    assert np.ptp(made.vertices, axis=0) == pytest.approx([0.06, 0.06, 0.06], rel=0.08)


def test_the_near_rim_of_a_pan_is_where_the_photo_has_it():
    """The outline is as well that of a pan whose rim is lower: only colours inside it tell."""
    true = bowl(FOOT, 0.12, 0.06)
    pan = mask_of(true)
    turns = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    rim = FOOT + np.column_stack([0.12 * np.cos(turns), 0.12 * np.sin(turns), np.full(60, 0.06)])
    fan = np.array([[0, k, k + 1] for k in range(1, 59)], np.int32)
    opening = rasterizer.silhouette(CAMERA.to_camera(rim), fan, CAMERA.K, CAMERA.width, CAMERA.height)
    rgb = np.full((CAMERA.height, CAMERA.width, 3), 170, np.uint8)
    rgb[pan], rgb[pan & opening] = 90, 40
    edge = CAMERA.project(rim)[0][:, 1].max()
    for colours in (rgb, np.full_like(rgb, 90)):
        outlined = Outlined.of(pan, CAMERA, colours)
        fit = found(fit_hollow(outlined, 0.0, usual=Usual(0.3, 0.55, 0.03)))
        assert fit.solid.rim is not None
        low = fit.solid.rim - np.array([0, 0, 0.012])  # by some pixels
        near = near_rim(outlined, low)
        if colours is not rgb:
            assert near is None
            continue
        assert near is not None
        there = replace(fit, solid=replace(fit.solid, rim=low))
        made = fitted_to_outline(there, outlined)
        assert made.solid.rim is not None
        off = (CAMERA.project(r)[0][:, 1].max() - edge for r in (low, made.solid.rim))
        assert abs(next(off)) > 4 > 1.5 > abs(next(off))
        assert made.overlap > 0.96


@pytest.mark.parametrize("true", [block(FOOT, (0.1, 0.07, 0.15), 0.5), can(FOOT, 0.04, 0.12), bowl(FOOT, 0.08, 0.06)])
def test_a_shape_with_the_outline_of_its_mask_is_left_as_it_is(true: Solid):
    """Up to half a pixel of the window, that is less than a millimetre."""
    outlined = seen(true)
    fit = FittedShape.of("box", true, outlined)
    moved = fitted_to_outline(fit, outlined).solid.vertices - true.vertices
    assert np.abs(moved).max() < 1e-3


@pytest.mark.parametrize("hidden", [0.3, 0.5])
def test_a_warp_ignores_the_outline_of_what_stands_before(hidden: float):
    """A can that is 8 % too narrow meets the outline that is seen, and does not end at what hides the rest."""
    true, narrow = mask_of(can(FOOT, 0.05, 0.12)), can(FOOT, 0.046, 0.12)
    columns = np.flatnonzero(true.any(0))
    before = np.zeros_like(true)
    before[:, round(columns[-1] - hidden * len(columns)) :] = True
    outlined = Outlined.of(true & ~before, CAMERA).behind(before)
    warped = fitted_to_outline(FittedShape.of("cylinder", narrow, outlined), outlined)
    assert warped.overlap > 0.98
    assert np.ptp(warped.solid.vertices[:, 0]) > 0.09


def test_the_pieces_of_a_bowl_are_warped_with_its_surface():
    """A corner of a piece stays at the vertex where it is."""
    outlined = seen(bowl(FOOT, 0.08, 0.06))
    fit = found(fit_hollow(outlined, 0.0, usual=Usual(0.5, 0.55, 0.06)))
    wide = Outlined.of(mask_of(bowl(FOOT, 0.088, 0.06)), CAMERA)
    warped = fitted_to_outline(FittedShape.of(fit.family, fit.solid, wide), wide)
    assert warped.overlap > 0.98 > wide.overlap(fit.solid.vertices, fit.solid.faces)
    for before, after in zip(fit.solid.pieces, warped.solid.pieces, strict=True):
        apart = np.linalg.norm(before[:, None] - fit.solid.vertices[None], axis=2)
        shared = np.flatnonzero(apart.min(1) < 1e-9)
        assert np.allclose(after[shared], warped.solid.vertices[apart[shared].argmin(1)], atol=1e-9)
    assert fit.solid.rim is not None
    assert warped.solid.rim is not None
    assert np.ptp(warped.solid.rim[:, 0]) > 1.05 * np.ptp(fit.solid.rim[:, 0])
