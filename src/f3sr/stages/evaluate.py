"""evaluate: a scene and direct composition by the same measures (equations 12 to 14; docs: measures)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Self

from f3sr.core.camera import Camera
from f3sr.core.transforms import pose
from f3sr.errors import require_kind
from f3sr.metrics.camera_fit import ForeignCameraConfig, fitted_camera
from f3sr.metrics.measures import Details, Measures, MeshMeasures, image_measures, measure_with_details
from f3sr.report import Decision, Report
from f3sr.runtime.daemon_thread import begun
from f3sr.scene import Scene
from f3sr.settings import settings

DIRECT, FITTED = "direct composition", "fitted camera"
"""In titles of rows."""
MAX_TRAVEL = 1e-3
"""Largest travel of a centre of mass in the release protocol from which a scene counts as at rest [m]."""


@settings
class EvaluateConfig:
    foreign_camera: ForeignCameraConfig = field(default_factory=ForeignCameraConfig)
    """Of the camera that scenes which f3sr did not align are seen by in a second row."""


@dataclass(frozen=True, kw_only=True)
class FittedCameraMeasures:
    """The measures of a scene with a camera fitted to its own masks, inside bounds, and then held."""

    measures: Measures
    """Picture measures come from the fitted camera, the others are the scene's."""
    T_world_camera: tuple[tuple[float, ...], ...]
    """The fitted camera's pose (4, 4)."""
    decision: Decision


@dataclass(frozen=True, kw_only=True)
class Evaluation:
    """The measures of a result and of direct composition; those of direct composition are None without the input.

    Scenes whose camera f3sr did not align are measured twice: with their own camera, and with a fitted one. Details
    are per object and with places in the world.
    """

    result: Measures
    direct: Measures | None
    result_details: Details
    direct_details: Details | None
    result_fitted: FittedCameraMeasures | None = None
    """None where the result's camera is aligned."""
    direct_fitted: FittedCameraMeasures | None = None

    def rows(self, name: str = "f3sr") -> dict[str, Measures]:
        """Every row of the result table by its title, the result's own, ``name``, last."""
        rows: dict[str, Measures] = {}
        for title, measures, fitted in (
            (DIRECT, self.direct, self.direct_fitted),
            (name, self.result, self.result_fitted),
        ):
            rows |= {title: measures} if measures else {}
            rows |= {f"{title}, {FITTED}": fitted.measures} if fitted else {}
        return rows

    @property
    def report(self) -> Report:
        """Decisions on fitted cameras, and a fallback where the result moves in the release protocol."""
        fitted = (self.direct_fitted, self.result_fitted)
        travel = self.result.D_max_cm / 100
        reason = f"a centre of mass travels by {1000 * travel:.2f} mm in 5 s, of {1000 * MAX_TRAVEL:g} mm allowed"
        moves = Decision(choice="kept although it moves when it is released", reason=reason, fallback=True)
        return Report(
            stage="evaluate",
            decisions=(*(f.decision for f in fitted if f), *([] if travel <= MAX_TRAVEL else [moves])),
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class DirectView:
    """What is measured of direct composition without proxies: it is known as soon as the input is levelled."""

    meshes: MeshMeasures
    fitted: _FittedCamera

    @classmethod
    def of(cls, levelled: Scene, config: EvaluateConfig | None = None) -> Self:
        composed = _on_ground(levelled)
        fitted = _FittedCamera.of(composed, DIRECT, config or EvaluateConfig())
        return cls(meshes=MeshMeasures.of(composed), fitted=fitted)


@dataclass(frozen=True, eq=False, kw_only=True)
class _FittedCamera:
    camera: Camera
    decision: Decision
    image: Mapping[str, float]

    @classmethod
    def of(cls, scene: Scene, name: str, config: EvaluateConfig) -> Self:
        camera, decision = fitted_camera(scene, config.foreign_camera)
        told = replace(decision, choice=f"{name}: {decision.choice}")
        return cls(camera=camera, decision=told, image=image_measures(replace(scene, camera=camera)))

    def measures(self, measures: Measures) -> FittedCameraMeasures:
        """The ``measures`` of a scene, as this camera sees it."""
        return FittedCameraMeasures(
            measures=replace(measures, **self.image),
            T_world_camera=tuple(tuple(row) for row in self.camera.T_world_camera.tolist()),
            decision=self.decision,
        )


def evaluate(
    scene: Scene,
    direct: Scene | None,
    config: EvaluateConfig | None = None,
    *,
    foreign: bool = False,
    true_scale: float = 1.0,
    view: Callable[[], DirectView] | None = None,
) -> Evaluation:
    """Measure ``scene`` and direct composition, made of ``direct``, with the same proxies.

    ``direct`` is the levelled input, None without one. Direct composition is measured twice: with its own camera, and
    with a camera fitted to its own masks. That is the report's protocol for scenes of others. So is ``scene`` if it
    is ``foreign``: its camera was not aligned. ``true_scale`` is the factor from the scene's lengths to true metres.
    ``view`` gives the view of ``direct`` where it was begun before. Raises InputError for anything but scenes.
    """
    for where, value in (("scene", scene), ("direct", scene if direct is None else direct)):
        require_kind(where, value, Scene, accepted=f"f3sr.read_package(...).{where}")
    config = config or EvaluateConfig()
    composed = begun(_composed, direct, scene, config, true_scale, view) if direct else None
    of_meshes = begun(MeshMeasures.of, scene)
    result, result_details = measure_with_details(scene, true_scale=true_scale, of_meshes=of_meshes.result)
    result_fitted = _FittedCamera.of(scene, "the result", config).measures(result) if foreign else None
    direct_result, details, fitted = composed.result() if composed else (None, None, None)
    return Evaluation(
        result=result,
        direct=direct_result,
        result_details=result_details,
        direct_details=details,
        result_fitted=result_fitted,
        direct_fitted=fitted,
    )


def _composed(
    direct: Scene,
    scene: Scene,
    config: EvaluateConfig,
    true_scale: float,
    view: Callable[[], DirectView] | None,
) -> tuple[Measures, Details, FittedCameraMeasures]:
    """Measures, details and fitted-camera measures of direct composition."""
    known = view() if view else DirectView.of(direct, config)
    composed = direct_composition(direct, scene)
    measures, details = measure_with_details(composed, true_scale=true_scale, of_meshes=lambda: known.meshes)
    return measures, details, known.fitted.measures(measures)


def direct_composition(levelled: Scene, result: Scene) -> Scene:
    """The baseline: the levelled input, moved vertically until its lowest vertex touches the ground.

    It has the proxies of ``result``. Proxies are in the asset frame, so they fit the unmoved assets too.
    """
    composed = _on_ground(levelled)
    return composed.with_objects(*(replace(o, parts=result[o.id].parts) for o in composed))


def _on_ground(levelled: Scene) -> Scene:
    """The levelled input, moved vertically until its lowest vertex touches the ground."""
    lowest = min(float(o.bounds_world[0, 2]) for o in levelled)
    T = pose(t=[0, 0, -lowest])
    objects = tuple(replace(o, T_world_object=T @ o.T_world_object) for o in levelled)
    return replace(levelled, objects=objects, camera=levelled.camera.moved(T @ levelled.camera.T_world_camera))
