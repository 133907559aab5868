"""Reading a photo with as much beside it as there is: what the folder lacks is made from the photo, and told."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from f3sr.errors import InputError
from f3sr.io import inputs
from f3sr.io.assets import PosedAsset, require_size
from f3sr.io.given_properties import MATERIALS
from f3sr.io.inputs import Fillers, Inputs
from f3sr.io.photo_hints import PhotoHints
from f3sr.language.grammar.materials import material_of, materials
from f3sr.lifting.generators import ASSET_GENERATORS, DEFAULT_GENERATOR, SAVED
from f3sr.mesh_poses.given_frames import MaskPlacer
from f3sr.metrology.estimators import DEFAULT_ESTIMATOR, GEOMETRY_ESTIMATORS
from f3sr.metrology.known_sizes import usual_size
from f3sr.metrology.scene_scale import LengthClue, SceneScale, scene_scale
from f3sr.metrology.tight_box import box_sides
from f3sr.report import Decision
from f3sr.runtime.kept_imports import kept_imports
from f3sr.runtime.result_store import digest

NAMED = 8
"""Most clues that a decision names."""
CUT = 2
"""Distance of a mask from the photo's border up to which its object may go on outside [px]."""


def read_inputs(
    folder: str | Path,
    *,
    ignore: Collection[str] = (),
    asset_frame: str = "auto",
    geometry_noise: float | None = None,
    mask_overlap: float | None = None,
    fillers: Fillers | None = None,
    hints: PhotoHints | None = None,
) -> Inputs:
    """Read and validate a prompted-image folder, as ``io.inputs.read`` does, which explains the arguments.

    Without geometry, edges, rims and the ground in the photo tell the camera and the ground plane. Without assets, a
    simple solid is fitted to every mask. Both are fallbacks in the report. Then known lengths, usual sizes of labelled
    objects and the camera's height tell the unit (docs: metrology). Raises InputError and BackendError likewise.
    """
    with kept_imports():
        stand_ins = Fillers(
            geometry=GEOMETRY_ESTIMATORS.find(DEFAULT_ESTIMATOR),
            assets=ASSET_GENERATORS.find(DEFAULT_GENERATOR),
            places=lambda folder: ASSET_GENERATORS.find(f"{SAVED}:{folder}"),
        )
    given = inputs.read(
        folder,
        ignore=ignore,
        asset_frame=asset_frame,
        geometry_noise=geometry_noise,
        mask_overlap=mask_overlap,
        fillers=fillers,
        stand_ins=stand_ins,
        hints=hints,
        placer=MaskPlacer(),
    )
    _require_known_materials(Path(folder) / MATERIALS, given)
    hints = hints or PhotoHints()
    if not given.geometry.guessed_unit and not hints.known:
        return given
    return _in_metres(given, hints)


def _require_known_materials(file: Path, given: Inputs) -> None:
    """Raises InputError for a material without a density that no word of the table names: it would change nothing."""
    for id, properties in given.properties.items():
        if properties.material and properties.density is None and not material_of(properties.material):
            names = ", ".join(s.name for s in materials().substances)
            accepted = f"{names}, a label such as 'tennis ball', or any name beside a density"
            raise InputError(file, found=f"object {id} of the material {properties.material!r:.60}", accepted=accepted)


def _in_metres(given: Inputs, hints: PhotoHints) -> Inputs:
    """The inputs with all lengths times one factor, and a decision that tells it."""
    lengths = hints.known_lengths(given.instances)
    clues = [*_given_clues(given, lengths), *(() if lengths else _usual_clues(given))]
    height_given = hints.camera_height is not None
    if not given.geometry.guessed_unit:  # an estimate that claims metres: the user's word alone changes its unit
        clues = [c for c in clues if c.given]
    scale = scene_scale(clues, height_given=height_given)
    scaled = _scaled(given, scale.factor) if clues else given
    decision = _decision(scaled, clues, scale, height_given=height_given)
    return replace(scaled, decisions=(*given.decisions, decision))


def _given_clues(given: Inputs, lengths: dict[int, float]) -> Iterator[LengthClue]:
    for i in given.instances:
        if i.id in lengths:
            name, found = i.label or f"object {i.id}", length_of(given.assets[i.id])
            yield LengthClue(id=i.id, name=name, found=found, true=lengths[i.id], given=True)


def _usual_clues(given: Inputs) -> Iterator[LengthClue]:
    """Of objects with a label that the table has, wholly in the photo."""
    for i in given.instances:
        inner = i.mask[CUT:-CUT, CUT:-CUT]
        size = usual_size(i.label)
        if size and np.count_nonzero(inner) == np.count_nonzero(i.mask):
            found = length_of(given.assets[i.id])
            yield LengthClue(id=i.id, name=i.label, found=found, true=size.metres, sigma=size.spread)


def length_of(asset: PosedAsset) -> float:
    """The longest side of the tightest box around an object's mesh, in the scene's unit.

    The mesh's outline is the mask's. The mask's own greatest width adds nothing but its errors: it is a diagonal of
    boxes, foreshortened where things lie, and pixels that lie apart widen it."""
    return float(asset.scale * box_sides(asset.mesh.vertices)[0])


def _scaled(given: Inputs, factor: float) -> Inputs:
    """All lengths times a factor, about the camera: the picture stays as it was."""
    assets = dict[int, PosedAsset]()
    for i in given.instances:
        asset = given.assets[i.id]
        T = asset.T_camera_object.copy()
        T[:3, 3] *= factor
        assets[i.id] = replace(asset, T_camera_object=T, scale=asset.scale * factor)
        require_size("--known", i.name, assets[i.id])
    geometry = replace(given.geometry, points=given.geometry.points * np.float32(factor))
    digests = {**given.digests, "scale": digest(factor)}
    return replace(given, geometry=geometry, assets=assets, digests=dict(sorted(digests.items())))


def _decision(given: Inputs, clues: list[LengthClue], scale: SceneScale, *, height_given: bool) -> Decision:
    """What the unit rests on: a fallback unless the user told it."""
    told = height_given or any(c.given for c in clues)
    low, high = np.exp([-2 * scale.error, 2 * scale.error])
    if clues:
        choice = f"unit: all lengths times {scale.factor:.3g} +- {100 * scale.error:.2g} %"
        parts = [f"{c.name} ({c.id}) is {c.true:.3g} m, found {c.found:.3g}" for c in clues[:NAMED]]
        more = f" and {len(clues) - NAMED} more" if len(clues) > NAMED else ""
        reason = f"{'--known' if clues[0].given else 'usual sizes'}: {'; '.join(parts)}{more}"
    elif told:
        choice, reason = f"unit: metres +- {100 * scale.error:.2g} %", "--camera-height"
    else:
        choice = "lengths are in an unknown unit: the camera's height is a guess"
        reason = "no known length, and no label of usual size; --known or --camera-height tells it"
    return Decision(
        choice=choice, reason=f"{reason}; true lengths are {low:.2g} to {high:.2g} times these", fallback=not told
    )
