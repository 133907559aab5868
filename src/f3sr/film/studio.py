"""A played goal of a package filmed from the photo's camera: its scene at the film's size, background and renderer."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import Annotated, Self

import numpy as np
from annotated_types import Interval
from numpy.typing import NDArray

from f3sr.background import complete_background
from f3sr.core.resampling import resample
from f3sr.core.transforms import transform
from f3sr.errors import require_kind
from f3sr.film import make_film
from f3sr.film.deadband import Held
from f3sr.io.images import resized
from f3sr.play.goal_loop import Played
from f3sr.rendering import RenderConfig, Renderer
from f3sr.rendering.still_photo import vanished
from f3sr.scene import Photo, Scene, SceneObject, names_of
from f3sr.scene_package.package import Package
from f3sr.settings import settings

STANDS = 0.01
"""Height above the support plane up to which an object counts as on it [m]."""


@settings
class FilmConfig:
    """How a film is made."""

    longest: Annotated[int, Interval(ge=16, le=4096)] = 1920
    """Longer side of a film [px]. Larger photos are filmed smaller."""
    slow: Annotated[float, Interval(ge=0.125, le=100)] = 1.0
    """Slow-motion factor; where it is not 1 the picture says it."""
    still: Annotated[float, Interval(ge=0, le=1)] = 0.1
    """Least motion in the picture for which an object is drawn anew [px]. Engines creep and tremble at rest."""
    opening: Annotated[float, Interval(ge=0, le=10)] = 0.7
    """How long the film shows the scene of the photo before anything moves [s]: it is looked at first."""
    closing: Annotated[float, Interval(ge=0, le=10)] = 1.0
    """How long the film shows the end [s]: what came of it is seen."""
    nudged: Annotated[float, Interval(ge=0, le=10)] = 1.5
    """Largest motion in the picture, over a whole film, of what keeps the photo's own pixels [px]."""
    render: RenderConfig = field(default_factory=RenderConfig)


@dataclass(frozen=True, eq=False, kw_only=True)
class Filmed:
    """The files of a film by name, its number of frames, its size, and decisions for the user."""

    files: Mapping[str, bytes]
    frames: int
    size: tuple[int, int]
    """Width and height [px]."""
    decisions: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Studio:
    """A package's scene, light and background, prepared once for films of any number of goals."""

    scene: Scene
    """The package's scene at the film's size."""
    shown: Scene
    """What the photo shows, as in ``PackagePictures``: N objects of the scene and D that edits deleted."""
    renderer: Renderer
    """Of ``shown``."""
    config: FilmConfig
    told: tuple[str, ...]
    """Decisions for the user that hold for every film."""
    edited: NDArray[np.bool_]
    """(N + D,) which objects are not where the photo shows them: they are drawn, or gone, from the first frame on."""

    @classmethod
    def of(cls, package: Package, config: FilmConfig | None = None) -> Self:
        """Fit the light and complete the background if needed: about 1 s for ten objects.

        Raises InputError if a film file of the package is damaged or has another size than the photo.
        """
        require_kind("package", package, Package, accepted="f3sr.read_package(...)")
        config = config or FilmConfig()
        pictures = PackagePictures.of(package, config.longest)
        scene, shown, told = pictures.scene, pictures.shown, pictures.told
        width, height = scene.camera.width, scene.camera.height
        if (width, height) != (package.scene.camera.width, package.scene.camera.height):
            told += (f"filmed at {width}x{height}, as the photo is larger than {config.longest} pixels",)
        moved = moved_since(shown, scene, config.nudged) | pictures.scaled
        if moved.any():
            ids = [o.id for o, is_moved in zip(scene, moved, strict=True) if is_moved]
            told += (f"{names_of(ids)}: drawn where edits moved {'it' if len(ids) == 1 else 'them'}",)
        edited = ~left_of(shown, scene)
        edited[~edited] = moved
        renderer = Renderer.of(shown, pictures.background, config=config.render, kept=pictures.kept)
        return cls(scene, shown, renderer, config, (*told, *renderer.decisions), edited)

    def film(self, played: Played) -> Filmed:
        """Film a goal. Equal package, rollout and settings give equal bytes, whichever films came before."""
        require_kind("played", played, Played, accepted="a played goal, no refusal")
        slow = Fraction(self.config.slow).limit_denominator(1000)
        frames = FilmFrames(self, self.moving(played))

        files = make_film(self.scene, played.plan, played.rollout, played.verdict, frames.draw,
            slow=slow, opening=self.config.opening, closing=self.config.closing)  # fmt: skip
        width, height = self.scene.camera.width, self.scene.camera.height
        size = width + width % 2, height + height % 2  # films have even sides
        return Filmed(files=files, frames=frames.count, size=size, decisions=(*self.told, *self._beyond(played)))

    def moving(self, played: Played) -> NDArray[np.bool_]:
        """(N,) which objects leave their pose at rest in any frame, by more than a nudge."""
        rest = np.array([o.T_world_object for o in self.scene])
        held = Held(self.scene, max(self.config.nudged, self.config.still))
        return np.any([(held(T) != rest).any((1, 2)) for T in played.rollout.T_world_object], axis=0)

    def _beyond(self, played: Played) -> Iterator[str]:
        """Decisions on objects that end outside the visible support: the ground has no edge in physics."""
        support, camera = self.scene.ground_mask, self.scene.camera
        if support is None:
            return
        for o, T in zip(self.scene, played.rollout.T_world_object[-1], strict=True):
            corners = np.concatenate([transform(T, part.vertices) for part in o.solids])
            foot = corners[corners[:, 2] <= corners[:, 2].min() + STANDS]
            if foot[:, 2].min() > STANDS or np.allclose(T, o.T_world_object, atol=STANDS):
                continue
            (u, v), depth = (values[0] for values in camera.project(foot.mean(0)[None]))
            inside = depth > 0 and 0 <= u < camera.width and 0 <= v < camera.height
            if inside and not support[int(v), int(u)]:
                name = o.label or f"object {o.id}"
                yield f"{name} ends beyond the edge of its support in the photo: in physics the ground has no edge"


def as_photographed(scene: Scene, before: Scene) -> Scene:
    """The scene with its objects where they were ``before`` all edits, and with those that edits deleted."""
    there = {o.id: replace(o, T_world_object=before[o.id].T_world_object) for o in scene}
    return replace(scene, objects=tuple(there.get(o.id, o) for o in before))


def left_of(shown: Scene, scene: Scene) -> NDArray[np.bool_]:
    """(N + D,) which objects that the photo shows are left in a scene."""
    ids = {o.id for o in scene}
    return np.array([o.id in ids for o in shown], np.bool_)


def moved_since(shown: Scene, scene: Scene, nudged: float) -> NDArray[np.bool_]:
    """(N,) which objects of a scene are more than ``nudged`` [px] in the picture from where another one shows them."""
    there = scene.with_objects(*(replace(o, T_world_object=shown[o.id].T_world_object) for o in scene))
    was, now = (np.array([o.T_world_object for o in s]) for s in (there, scene))
    return (Held(there, nudged)(now) != was).any((1, 2))


class FilmFrames:
    """The frames of one film, drawn in their order: an object keeps the photo's pixels until it first moves."""

    def __init__(self, studio: Studio, moving: NDArray[np.bool_]) -> None:
        self.count = 0
        self._studio, self._moves = studio, moving
        self._moving = left_of(studio.shown, studio.scene)
        self._moving[self._moving] = moving
        rest = np.array([o.T_world_object for o in studio.scene]).reshape(-1, 4, 4)
        shown = np.array([o.T_world_object for o in studio.shown]).reshape(-1, 4, 4)
        self._rest = np.where(studio.edited[:, None, None], with_deleted(rest, studio.scene, studio.shown), shown)
        self._held = Held(studio.scene, studio.config.still)
        self._departed = studio.edited
        self._drawn = self._beside(self._departed)

    def draw(self, poses: NDArray[np.float64]) -> NDArray[np.uint8]:
        """The next frame, with the objects at ``poses`` (N, 4, 4)."""
        self.count += 1
        now = self._rest.copy()
        now[self._moving] = self._held(poses)[self._moves]
        departed = self._departed | (now != self._rest).any((1, 2))
        if (departed != self._departed).any():
            self._departed, self._drawn = departed, self._beside(departed)
        return self._drawn(now)

    def _beside(self, departed: NDArray[np.bool_]) -> Callable[[NDArray[np.float64]], NDArray[np.uint8]]:
        still = self._studio.renderer.beside_photo(self._studio.shown, departed)
        return self._studio.renderer.frame if still is None else still.frame


def with_deleted(poses: NDArray[np.float64], scene: Scene, shown: Scene) -> NDArray[np.float64]:
    """Poses (N + D, 4, 4) of what the photo shows: those of a scene's objects (N, 4, 4), and of what edits deleted,
    which is not seen."""
    found = vanished(np.array([o.T_world_object for o in shown]).reshape(-1, 4, 4))
    found[left_of(shown, scene)] = poses
    return found


def film_played(package: Package, played: Played, config: FilmConfig | None = None) -> Filmed:
    """Film a played goal from the photo's camera: ``Studio.of(package, config).film(played)`` (docs: film).

    ``played`` must be a goal of the same package. Raises InputError if a film file of the package is damaged.
    """
    return Studio.of(package, config).film(played)


@dataclass(frozen=True, eq=False, kw_only=True)
class PackagePictures:
    """What pictures of a package begin with, at their size: its scene with the visible support as ground mask, the
    completed photo (h, w, 3), and the depth (h, w) [m] of its pixels that may hide objects."""

    scene: Scene
    shown: Scene
    """The objects of ``scene`` where they were before all edits, and those that edits deleted."""
    scaled: NDArray[np.bool_]
    """(N,) which objects of ``scene`` have another size since."""
    background: NDArray[np.uint8]
    kept: NDArray[np.float32] | None
    told: tuple[str, ...]
    """Decisions for the user."""

    @classmethod
    def of(cls, package: Package, longest: int) -> Self:
        """At most ``longest`` [px] wide or high. Raises InputError if a picture of the package is damaged."""
        before = package.unedited().scene
        background, told = _background(package, before)
        support = package.support()
        if support is None:
            told += ("the package has no support.png: shadows fall on all below the horizon, near the objects",)
        shown = replace(as_photographed(package.scene, before), ground_mask=support)
        shown, background, kept = _limited(shown, background, package.kept_depth(), longest)
        masks = {o.id: o.mask for o in shown}
        objects = tuple(replace(o, mask=masks[o.id]) for o in package.scene)
        sizes = ((before[o.id].mesh.bounds, o.mesh.bounds) for o in package.scene)
        scaled = np.array([not np.array_equal(was, now) for was, now in sizes], np.bool_)
        scene = replace(shown, objects=objects)
        return cls(scene=scene, shown=shown, scaled=scaled, background=background, kept=kept, told=told)


def _background(package: Package, before: Scene) -> tuple[NDArray[np.uint8], tuple[str, ...]]:
    background = package.background()
    if background is not None:
        return background, ()
    masks = [o.mask for o in before]
    completed = complete_background(package.scene.photo, masks, support=package.support())
    reasons = tuple(d.reason for d in completed.decisions)
    return completed.rgb, ("the package has no background.png: completed anew", *reasons)


def _limited(
    scene: Scene, background: NDArray[np.uint8], kept: NDArray[np.float32] | None, longest: int
) -> tuple[Scene, NDArray[np.uint8], NDArray[np.float32] | None]:
    """The scene, background and kept depths with at most ``longest`` pixels on the longer side."""
    camera = scene.camera.limited(longest)
    width, height = camera.width, camera.height
    if (width, height) == (scene.camera.width, scene.camera.height):
        return scene, background, kept

    def smaller(o: SceneObject) -> SceneObject:
        return replace(o, mask=resample(o.mask, width, height))

    ground = None if scene.ground_mask is None else resample(scene.ground_mask, width, height)
    small = replace(
        scene,
        photo=Photo(rgb=resized(scene.photo.rgb, width, height)),
        camera=camera,
        objects=tuple(smaller(o) for o in scene),
        ground_mask=ground,
        geometry=None,
    )
    return small, resized(background, width, height), None if kept is None else resample(kept, width, height)
