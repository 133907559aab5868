"""NormalEstimators of networks: their normals turned into camera axes, as points, the photo or the user tell these.

It stands here and not in ``neural/``, which knows no geometry: a network is asked for its map alone."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from f3sr.backends.model_choice import ModelChoice, Need
from f3sr.backends.protocols import EstimatedNormals, PromptedImage
from f3sr.core.transforms import Array
from f3sr.errors import InputError
from f3sr.neural.normal_maps import DsineNetwork, NormalNetwork, OmnidataNetwork, assumed_camera
from f3sr.scene import Geometry
from f3sr.vision.normal_axes import LETTERS, AxisSigns, angle_to_points, axis_signs, signs_by_outlines, signs_by_points

COMMON = math.radians(2.0)
"""One standard error of a network's normals that is alike in all places. No weights were reachable to measure it:
networks made for gravity alone claim one to three degrees."""
OPTION = "--normals-axes"
ACCEPTED = f"three letters, one of each of {', '.join(LETTERS)}, as rdf for right, down, forwards"
MOST_OFF = math.radians(35)
"""Largest median angle between the normals and those of the points: beyond it no signs make them alike."""


class NetworkNormals:
    """A NormalEstimator of a TorchScript file."""

    takes_model: ClassVar[bool] = True
    network_class: ClassVar[type[NormalNetwork]]

    def __init__(self, choice: ModelChoice | None = None) -> None:
        choice = choice or ModelChoice()
        self.stated = axis_signs(choice.axes) if choice.axes else None
        if choice.axes and self.stated is None:
            raise InputError(OPTION, found=choice.axes, accepted=ACCEPTED)
        self.network = self.network_class(choice)

    @property
    def provenance(self) -> Mapping[str, str]:
        """Of the network."""
        return self.network.provenance

    def needs(self) -> tuple[Need, ...]:
        """Of the network."""
        return self.network.needs()

    def normals(self, image: PromptedImage, geometry: Geometry | None, K: Array | None) -> EstimatedNormals:
        """Normals of the whole photo in camera axes. Raises InputError where nothing tells an axis, and where they do
        not follow the points of a geometry that has some of its own."""
        focal, centre = (image.focal.pixels, image.focal.centre) if image.focal else (None, None)
        values = self.network.predict(image.photo, assumed_camera(image.photo, focal, centre) if K is None else K)
        seen, by = signs_by_outlines(values, [i.mask for i in image.instances], image.ground_mask), "the photo"
        known = geometry if geometry is not None and geometry.source != "ground" else None
        if known is not None:
            seen, by = signs_by_points(values, known.points, known.valid).or_else(seen), "points"
        axes, source, warning = self._chosen(seen, by)
        values = values * axes.signs.astype(np.float32)
        off = "" if known is None else self._agreement(values, known, axes, seen)
        told = f"normals of {self.network.name}, axes {axes.letters} {source}{off}"
        return EstimatedNormals(values=values, error=COMMON, told=told, warning=warning)

    def _chosen(self, seen: AxisSigns, by: str) -> tuple[AxisSigns, str, str]:
        """The axes, who tells them, and a warning where others are seen. What is stated wins; then what is seen."""
        documented = axis_signs(self.network.documented)
        if self.stated is not None:
            against = _against(seen, self.stated)
            return self.stated, f"by {OPTION}", f"axes {seen.letters} by {by}" if against else ""
        if documented is not None:
            against = _against(seen, documented)
            source = f"by {by}" if "?" not in seen.letters else f"as documented, {seen.letters} by {by}"
            return seen.or_else(documented), source, f"axes {self.network.documented} are documented" if against else ""
        if "?" in seen.letters:
            accepted = f"{OPTION} with {ACCEPTED}; all photos of a network have the same"
            raise InputError(self.network.name, found=f"normals with axes {seen.letters}, by {by}", accepted=accepted)
        return seen, f"by {by}", ""

    def _agreement(self, values: NDArray[np.float32], known: Geometry, axes: AxisSigns, seen: AxisSigns) -> str:
        """How far normals (h, w, 3) are off those of points. Raises InputError where they do not follow them."""
        off = angle_to_points(values, known.points, known.valid)
        if off > MOST_OFF:  # NaN without a smooth surface is not
            found = f"normals {math.degrees(off):.0f} degrees off those of the points, median, with axes {axes.letters}"
            accepted = f"at most {math.degrees(MOST_OFF):.0f} degrees"
            more = f"; the points show {seen.letters}" if _against(seen, axes) else ""
            raise InputError(self.network.name, found=found + more, accepted=accepted)
        return f", {math.degrees(off):.1f} degrees off those of the points, median"


class OmnidataNormals(NetworkNormals):
    """The NormalEstimator ``omnidata``."""

    network_class: ClassVar[type[NormalNetwork]] = OmnidataNetwork


class DsineNormals(NetworkNormals):
    """The NormalEstimator ``dsine``."""

    network_class: ClassVar[type[NormalNetwork]] = DsineNetwork


def _against(seen: AxisSigns, other: AxisSigns) -> bool:
    return bool((seen.signs * other.signs < 0).any())
