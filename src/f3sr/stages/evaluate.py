"""evaluate: a scene and direct composition by the same measures (equations 12 to 14; docs: measures)."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from f3sr.core.transforms import pose
from f3sr.errors import require_kind
from f3sr.metrics.camera_fit import ForeignCameraConfig, fitted_camera
from f3sr.metrics.measures import Details, Measures, measure_with_details, seen_by
from f3sr.report import Decision, Report
from f3sr.runtime.daemon_thread import begun
from f3sr.scene import Scene
from f3sr.settings import settings

DIRECT, FITTED = "direct composition", "fitted camera"
"""In titles of rows."""


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
        """Decisions on fitted cameras."""
        fitted = (self.direct_fitted, self.result_fitted)
        return Report(stage="evaluate", decisions=tuple(f.decision for f in fitted if f))


def evaluate(
    scene: Scene,
    direct: Scene | None,
    config: EvaluateConfig | None = None,
    *,
    foreign: bool = False,
    true_scale: float = 1.0,
) -> Evaluation:
    """Measure ``scene`` and direct composition, made of ``direct``, with the same proxies.

    ``direct`` is the levelled input, None without one. Direct composition is measured twice: with its own camera, and
    with a camera fitted to its own masks. That is the report's protocol for scenes of others. So is ``scene`` if it
    is ``foreign``: its camera was not aligned. ``true_scale`` is the factor from the scene's lengths to true metres.
    Raises InputError for anything but scenes.
    """
    for where, value in (("scene", scene), ("direct", scene if direct is None else direct)):
        require_kind(where, value, Scene, accepted=f"f3sr.read_package(...).{where}")
    config = config or EvaluateConfig()
    beside = begun(_composed, direct, scene, config, true_scale) if direct else None
    result, result_details = measure_with_details(scene, true_scale=true_scale)
    result_fitted = _seen_by_its_own(scene, result, "the result", config) if foreign else None
    composed, details, fitted = beside.result() if beside else (None, None, None)
    return Evaluation(
        result=result,
        direct=composed,
        result_details=result_details,
        direct_details=details,
        result_fitted=result_fitted,
        direct_fitted=fitted,
    )


def _composed(
    direct: Scene, scene: Scene, config: EvaluateConfig, true_scale: float
) -> tuple[Measures, Details, FittedCameraMeasures]:
    """Measures, details and fitted-camera measures of direct composition."""
    composed = direct_composition(direct, scene)
    measures, details = measure_with_details(composed, true_scale=true_scale)
    return measures, details, _seen_by_its_own(composed, measures, DIRECT, config)


def _seen_by_its_own(scene: Scene, measures: Measures, name: str, config: EvaluateConfig) -> FittedCameraMeasures:
    camera, decision = fitted_camera(scene, config.foreign_camera)
    return FittedCameraMeasures(
        measures=seen_by(camera, scene, measures),
        T_world_camera=tuple(tuple(row) for row in camera.T_world_camera.tolist()),
        decision=replace(decision, choice=f"{name}: {decision.choice}"),
    )


def direct_composition(levelled: Scene, result: Scene) -> Scene:
    """The baseline: the levelled input, moved vertically until its lowest vertex touches the ground.

    It has the proxies of ``result``. Proxies are in the asset frame, so they fit the unmoved assets too.
    """
    lowest = min(float(o.bounds_world[0, 2]) for o in levelled)
    T = pose(t=[0, 0, -lowest])
    objects = tuple(replace(o, T_world_object=T @ o.T_world_object, parts=result[o.id].parts) for o in levelled)
    camera = levelled.camera.moved(T @ levelled.camera.T_world_camera)
    return replace(levelled, objects=objects, camera=camera)
