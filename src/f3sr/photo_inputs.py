"""Reading a photo with as much beside it as there is: what the folder lacks is made from the photo, and told."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

from f3sr.io import inputs
from f3sr.io.inputs import Fillers, Inputs
from f3sr.lifting.generators import ASSET_GENERATORS, DEFAULT_GENERATOR
from f3sr.metrology.estimators import DEFAULT_ESTIMATOR, GEOMETRY_ESTIMATORS


def read_inputs(
    folder: str | Path,
    *,
    ignore: Collection[str] = (),
    asset_frame: str = "auto",
    geometry_noise: float | None = None,
    fillers: Fillers | None = None,
) -> Inputs:
    """Read and validate a prompted-image folder, as ``io.inputs.read`` does, which explains the arguments.

    Without geometry, edges, rims and the ground in the photo tell the camera and the ground plane. Without assets, a
    simple solid is fitted to every mask. Both are fallbacks in the report. Raises InputError and BackendError likewise.
    """
    return inputs.read(
        folder,
        ignore=ignore,
        asset_frame=asset_frame,
        geometry_noise=geometry_noise,
        fillers=fillers,
        stand_ins=Fillers(
            geometry=GEOMETRY_ESTIMATORS.find(DEFAULT_ESTIMATOR), assets=ASSET_GENERATORS.find(DEFAULT_GENERATOR)
        ),
    )
