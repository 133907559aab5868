"""Settings of the uncertainty of poses."""

from __future__ import annotations

from typing import Annotated

from annotated_types import Interval

from f3sr.settings import settings


@settings
class UncertaintyConfig:
    outline: Annotated[float, Interval(gt=0, le=1000)] = 3.0
    """Independent places in which an outline errs."""
    detail: Annotated[float, Interval(ge=0, le=1000)] = 2.0
    """Independent places in which an object's detail errs."""
    pixel: Annotated[float, Interval(gt=0, le=10)] = 0.5
    """Least error of an outline [px of the window]."""
    least_mismatch: Annotated[float, Interval(gt=0, le=1)] = 0.05
    """Least 1 - correlation of detail that counts as noise."""
    shape: Annotated[float, Interval(gt=0, le=0.2)] = 0.014
    """Standard deviation of a generated surface at a contact [share of the object's size]."""
    stretch: Annotated[float, Interval(gt=0, le=0.2)] = 0.02
    """Standard deviation of the proportions of a generated shape [share]: one side of it may be seen, another not."""
    turn: Annotated[float, Interval(gt=0, le=4)] = 1.8
    """Standard deviation of a turn that nothing shows, a uniform one's [rad]."""
    scale: Annotated[float, Interval(gt=0, le=1)] = 0.2
    """Standard deviation of the logarithm of a scale that nothing shows."""
    center: Annotated[float, Interval(gt=0, le=0.1)] = 0.005
    """Standard deviation of an estimated principal point [longer image sides]."""
    focal: Annotated[float, Interval(gt=0, le=0.3)] = 0.01
    """Standard deviation of the logarithm of an estimated focal length, once levelled."""
    ground: Annotated[float, Interval(gt=0, le=1)] = 0.05
    """Standard deviation of a ground that nothing measured: tilt [rad], height [share of the camera's]."""
    resolution: Annotated[int, Interval(ge=64, le=1024)] = 192
    """Longer side [px] of the windows in which silhouettes are compared."""
    max_faces: Annotated[int, Interval(ge=100)] = 4000
    """Most faces of the meshes that silhouettes are drawn from."""
