"""Variants of alignment side by side on the benchmark scenes, each measured right after ``align``.

All start from the same levelled scenes, so that a row differs from ``ours`` by what its name says and nothing else.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean, median

import looks
import poses
import staged
from f3sr.io import inputs
from f3sr.metrics.measures import full_silhouette, image_agreement
from f3sr.scene import Scene
from f3sr.stages.align import AlignConfig, align
from f3sr.stages.align.config import AppearanceConfig, DepthConfig, FacetConfig, OrientationConfig, TiltConfig
from f3sr.stages.assemble import as_given, assemble
from f3sr.stages.level import level
from f3sr.vision.occlusion import nearer_objects, visible_region
from f3sr.vision.silhouette import Mask, iou

Numbers = dict[str, float]
Step = Callable[[Scene], Scene]

WORSE = 0.005
"""Visible IoU that an object may lose before it counts as worse: less is a matter of pixels."""
FAR = 20.0
"""Error of yaw from which on it counts as wrong [deg]."""


def _configured(**overrides: object) -> Step:
    config = AlignConfig(**overrides)  # type: ignore[arg-type]
    return lambda scene: align(scene, config)[0]


VARIANTS: Mapping[str, Step] = {
    "raw": lambda scene: scene,
    "report": lambda scene: staged.align(scene)[0],
    "skip align-objects": _configured(objects=False),
    "ours": _configured(),
    "ours, equations 8 and 9": _configured(
        tilt=TiltConfig(enabled=False),
        appearance=AppearanceConfig(enabled=False),
        facets=FacetConfig(enabled=False),
        depth=DepthConfig(enabled=False),
        orientations=OrientationConfig(enabled=False),
    ),
    "ours, no camera": _configured(camera=False),
    "ours, no tilt": _configured(tilt=TiltConfig(enabled=False)),
    "ours, no detail": _configured(appearance=AppearanceConfig(enabled=False)),
    "ours, no facets": _configured(facets=FacetConfig(enabled=False)),
    "ours, no geometry": _configured(depth=DepthConfig(enabled=False)),
    "ours, no orientations": _configured(orientations=OrientationConfig(enabled=False)),
}
"""By name; another switch of ``AlignConfig`` is another line. ``report`` (``staged.py``) has four bounded freedoms, no
occlusion and no extension; ``skip align-objects`` is its row without differentiable rendering."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Prepared:
    """A levelled scene and what its variants are measured by."""

    scene: Scene
    folder: Path
    objects: Path
    regions: Mapping[int, Mask]
    """Where nearer objects leave each object visible, as the levelled scene tells."""
    visible: Sequence[float]
    """IoU of visible pixels by object, before alignment."""

    @classmethod
    def of(cls, folder: Path, objects: Path) -> Prepared:
        scene, _ = level(assemble(as_given(inputs.read(folder)))[0])
        nearer = nearer_objects(scene)
        return cls(
            scene=scene,
            folder=folder,
            objects=objects,
            regions={o.id: visible_region(o, nearer[o.id]) for o in scene},
            visible=image_agreement(scene)[1],
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class Row:
    """One variant on one scene."""

    mIoU_visible: float
    mIoU: float
    mIoU_valid: float
    """Of full silhouettes, where nearer objects leave them visible."""
    PSNR: float
    depth_mm: float
    yaws: Mapping[int, float]
    """Errors of labelled boxes and cans by object id [deg]."""
    worse: Sequence[int]
    """Ids of objects that came with a better visible IoU."""
    evaluations: int
    cpu_s: float


def measured(prepared: Prepared, step: Step) -> Row:
    with looks.counted() as work:
        scene = step(prepared.scene)
    full, visible, psnr = image_agreement(scene)
    changes = zip(scene, prepared.visible, visible, strict=True)
    return Row(
        mIoU_visible=fmean(visible),
        mIoU=fmean(full),
        mIoU_valid=fmean(iou(full_silhouette(o, scene.camera), o.mask, prepared.regions[o.id]) for o in scene),
        PSNR=psnr,
        depth_mm=1e3 * poses.depth_residual(scene),
        yaws=poses.yaw_errors(scene, prepared.folder, prepared.objects),
        worse=[o.id for o, was, now in changes if now < was - WORSE],
        evaluations=work.evaluations,
        cpu_s=work.cpu,
    )


def true_mIoU(prepared: Prepared) -> float | None:
    """The best mIoU there is: that of the true objects before the true camera."""
    true = poses.true_scene(prepared.scene, prepared.folder, prepared.objects)
    return None if true is None else fmean(image_agreement(true)[0])


def summary(rows: Sequence[Row]) -> dict[str, float]:
    """Means over scenes, and over labelled objects for yaw; totals of what should not be."""
    yaws = [yaw for row in rows for yaw in row.yaws.values()]
    means = ("mIoU_visible", "mIoU", "mIoU_valid", "PSNR", "depth_mm", "evaluations", "cpu_s")
    return {
        **{name: fmean(getattr(row, name) for row in rows) for name in means},
        "yaw_deg": median(yaws),
        "yaw_far": sum(yaw > FAR for yaw in yaws),
        "worse": sum(len(row.worse) for row in rows),
    }
