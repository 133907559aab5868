"""The film's renderer: objects at any poses over the completed photo, lit as the photo is, with their shadows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from f3sr.core.camera import Camera
from f3sr.core.transforms import Array, pose
from f3sr.errors import InputError
from f3sr.rendering.canvas import Canvas, StillScene
from f3sr.rendering.config import RenderConfig
from f3sr.rendering.ground import ground_seen, light_shown
from f3sr.rendering.layers import Things
from f3sr.rendering.light import Light
from f3sr.rendering.lighting import lit_as_photo
from f3sr.rendering.shadow_maps import MARGIN
from f3sr.rendering.still_photo import StillPhoto
from f3sr.scene import Scene, SceneObject
from f3sr.vision.regions import Mask
from f3sr.vision.silhouette import union_of

OTHER_LIGHT = (
    "shadows: the background is not lit as the photo is; drawn as the light makes them, not as the photo shows"
)


OUT_OF_SIGHT = 1e3
"""Where the scene at rest has what the photo does not show [radii of the scene]: aside, above the ground."""


class Renderer:
    """Draws frames; made by ``Renderer.of``. It keeps what it drew last, so one thread at a time may use it."""

    def __init__(
        self,
        canvas: Canvas,
        decisions: tuple[str, ...],
        rest_light: NDArray[np.float32] | None = None,
        *,
        photo_lit: bool = False,
    ) -> None:
        self._canvas = canvas
        self._photo_lit = photo_lit
        self.decisions = decisions
        self.rest_light = rest_light
        """(h, w, 3): the share of its light that the ground keeps with the scene at rest, in the photo's camera.

        None for another camera and without shadows."""

    @classmethod
    def of(
        cls,
        scene: Scene,
        background: NDArray[np.uint8],
        camera: Camera | None = None,
        config: RenderConfig | None = None,
        *,
        kept: NDArray[np.float32] | None = None,
        also: Sequence[SceneObject] = (),
    ) -> Renderer:
        """A renderer of the objects of a finished ``scene`` over ``background`` (h, w, 3) uint8 sRGB.

        The light is fitted to the photo with the scene at rest, for any ``camera`` (default: the photo's own). With
        the photo's camera, ``background`` is the photo completed behind its objects. ``kept`` (h, w) is then the depth
        [m] of its pixels that may hide objects, inf elsewhere. ``also`` are drawn after the scene's own objects: the
        photo does not show them, and they tell nothing of its light. Raises InputError if sizes do not agree.
        """
        config = config or RenderConfig()
        view = camera or scene.camera
        _check_size(background, view)
        things = Things.of(scene.objects, config)
        ball = ball_around(scene)
        light, exposures, decisions = lit_as_photo(scene, background if camera is None else None, things, ball, config)
        if also:
            things = Things.of((*scene.objects, *also), config)
            common = exposures.mean(0) if len(exposures) else np.eye(3)
            exposures = np.concatenate([exposures, np.tile(common, (len(also), 1, 1))])
        setting = StillScene(
            camera=view,
            background=np.ascontiguousarray(background),
            light=light,
            exposures=exposures,
            config=config,
            things=things,
            ball=ball,
            receives=ground_seen(view, scene.ground_mask if camera is None else None, ball),
            kept=_nothing(view) if kept is None or camera is not None else kept,
        )
        canvas = Canvas(setting)
        if camera is not None or not config.shadows.enabled:
            return cls(canvas, decisions)
        away = pose(t=ball[0] + OUT_OF_SIGHT * ball[1] * np.array([1, 1, 0]))
        at_rest = np.concatenate([poses_at_rest(scene), np.tile(away, (len(also), 1, 1))])
        light = canvas.light_left(at_rest)
        objects = union_of([o.mask for o in scene.objects], background.shape[:2])
        shown, told = light_shown(light, scene.photo.rgb, background, objects)
        canvas.rests(light, shown)
        return cls(canvas, decisions if told else (*decisions, OTHER_LIGHT), light, photo_lit=told)

    def beside_photo(self, scene: Scene, moving: Mask) -> StillPhoto | None:
        """Frames that keep the pixels of the ``scene``'s photo beside the objects that move, ``moving`` (N,).

        None where the photo says nothing of the drawn light: for another camera, without shadows, and for a background
        in another light. It draws on this renderer's canvas."""
        return StillPhoto.of(self._canvas, scene, moving) if self._photo_lit else None

    @property
    def setting(self) -> StillScene:
        return self._canvas.setting

    def seen_from(self, camera: Camera, background: NDArray[np.uint8]) -> Renderer:
        """A renderer of the same objects and light for another camera, over a picture of its size.

        It is quick: side views and turntables need no new fit of the light."""
        _check_size(background, camera)
        setting = replace(
            self.setting,
            camera=camera,
            background=np.ascontiguousarray(background),
            receives=ground_seen(camera, None, self.setting.ball),
            kept=_nothing(camera),
        )
        return Renderer(Canvas(setting), self.decisions)

    def varied(self, light: Light, camera: Camera) -> Renderer:
        """A renderer of the same objects in another light, from another place, over the same background: shadows are
        as the light makes them."""
        setting = replace(
            self.setting, light=light, camera=camera, receives=ground_seen(camera, None, self.setting.ball)
        )
        return Renderer(Canvas(setting), self.decisions)

    def frame(self, T_world_object: ArrayLike) -> NDArray[np.uint8]:
        """The picture (h, w, 3) uint8 sRGB with the objects at poses T_world_object (N, 4, 4), in the scene's order.

        Raises InputError for another shape or values that are not finite."""
        poses = np.array(T_world_object, np.float64)
        expected = (len(self.setting.things.vertices), 4, 4)
        if poses.shape != expected or not np.isfinite(poses).all():
            raise InputError("poses", found=f"shape {poses.shape}", accepted=f"finite ones of shape {expected}")
        return self._canvas.drawn(poses)


def poses_at_rest(scene: Scene) -> Array:
    """T_world_object (N, 4, 4) of a scene's objects, in its order."""
    return np.array([o.T_world_object for o in scene.objects]).reshape(-1, 4, 4)


def ball_around(scene: Scene) -> tuple[Array, float]:
    """Middle (3,) in the world and radius [m] of the ball that light maps cover; the unit ball for no objects."""
    if not scene.objects:
        return np.zeros(3), 1.0
    corners = np.concatenate([o.bounds_world for o in scene.objects])
    low, high = corners.min(0), corners.max(0)
    return (low + high) / 2, MARGIN * max(float(np.linalg.norm(high - low)) / 2, 1e-3)


def _nothing(camera: Camera) -> NDArray[np.float32]:
    """(h, w) depths at which nothing hides anything."""
    return np.full((camera.height, camera.width), np.inf, np.float32)


def _check_size(background: NDArray[np.uint8], camera: Camera) -> None:
    wanted = camera.height, camera.width, 3
    if background.shape != wanted or background.dtype != np.uint8:
        found = f"{background.dtype} of shape {background.shape}"
        raise InputError("background", found=found, accepted=f"uint8 of shape {wanted}, the camera's")
