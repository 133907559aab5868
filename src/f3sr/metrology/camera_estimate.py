"""Focal length and gravity of one photo: evidence of edges, rims and EXIF weighed against what photos usually have."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from annotated_types import Interval
from numpy.typing import NDArray
from PIL import Image

from f3sr.backends.protocols import KnownFocal
from f3sr.core.transforms import Array, rotation_about
from f3sr.metrology.directions import DirectionModel, GroupedSegments, grouped, log_likelihoods
from f3sr.metrology.edges import edge_points, line_segments
from f3sr.metrology.ellipses import Ellipse, rims
from f3sr.metrology.posterior import PosteriorSample, sampled, weighted
from f3sr.settings import constants, settings
from f3sr.vision.ground_plane import POSE_LEAN, GroundNormal

LONGEST = 1600
"""Longer side of the photo in which edges are sought [px]: more adds noise, not directions."""
FOCALS = (0.5, 2.0)
"""Focal lengths searched [longer image sides]: from a wide phone lens to a portrait lens."""
PITCHES = (math.radians(-6), math.radians(74))
"""Pitches searched [rad]: steeper photos show no ground plane's direction."""
ROLLS = (math.radians(-4), 0.0, math.radians(4))
COARSE_FOCAL, COARSE_PITCH = 0.11, math.radians(4)
"""Steps of the first search, of the logarithm of the focal length and of the pitch [rad]."""
COARSE_BLUR, COARSE_TURN, FINE_TURN = math.radians(2), math.radians(2), math.radians(0.5)
BLURS = (math.radians(1), math.radians(0.3), 0.0, 0.0)
"""Widths of directions in the rounds of the second search [rad]."""
LEAST = np.array([0.0045, math.radians(0.15), math.radians(0.12)])
"""Least spread of its draws: logarithm of the focal length, pitch and roll [rad]."""
EXACT = 1e-3
"""Standard error of the logarithm of a focal length that is told as exact: draws need some spread."""
WINDOW = np.array([0.2, math.radians(4), math.radians(4)])
"""Size of a cluster of cameras, likewise: farther ones are another reading of the photo."""
SAMPLES, OF_NINE = np.linspace(0.1, 0.9, 9), 5
"""Places along a segment where the masks beside it are read, and how many must lie in one."""
HIGHEST = 0.01
"""Share of the ground's pixels above the row that counts as its upper end: masks have strays."""
MOST_SEGMENTS = 400
"""Most segments that are weighed, the longest first."""
BESIDE = 2.5
"""Distance of these places from the segment [px]."""


@settings
class CameraPriors:
    """What a photo's camera is before its picture tells."""

    focal: Annotated[float, Interval(ge=0.1, le=10)] = 0.9
    """Focal length [longer image sides]: main cameras of phones have .7 to .8, webcams and depth cameras .95."""
    focal_sigma: Annotated[float, Interval(gt=0, le=1)] = 0.25
    """One standard deviation of its logarithm."""
    pitch: Annotated[float, Interval(ge=-0.5, le=1.5)] = math.radians(25)
    """Angle of the optical axis below the horizon [rad]: rooms have 0 to 15 degrees, tables 20 to 60."""
    pitch_sigma: Annotated[float, Interval(gt=0, le=1)] = math.radians(20)
    roll_sigma: Annotated[float, Interval(gt=0, le=1)] = math.radians(2.5)
    """Standard deviation of the horizon's slope [rad]."""


@constants
class RimModel:
    """How an object's ellipse scatters about the image of a horizontal circle."""

    strange: float = 0.4
    """Share of ellipses that are no horizontal circle."""
    shape: float = 0.03
    """Standard deviation of a rim from a circle, of the logarithm of its axes' ratio."""
    edge: float = 1.0
    """Error of the minor axis [px]."""
    lean: float = math.radians(0.5)
    """Standard deviation of its plane's tilt [rad]: what is round is stiff, and leans less than boxes."""


@constants
class HorizonModel:
    """Where the horizon may lie: above the ground, and rarely far below the tops of what stands on it."""

    ratio: float = 2.5
    """Camera's height over an object's, the median: 1.4 m over .8 m in rooms, .5 m over .1 m at tables."""
    spread: float = 0.9
    """Standard deviation of its logarithm, of lower cameras only: of higher ones the pitch tells."""
    margin: float = 0.01
    """Width of the bound that ground lies below the horizon [longer image sides]."""


@constants
class GroundNormalModel:
    """How a network's normal of the ground scatters about the vertical."""

    strange: float = 0.1
    """Share of normals that are no ground's: a slope, or a wrong answer. They are even over the half sphere."""


@constants
class FacetModel:
    """How the vertical scatters about the directions that stable facets of posed meshes have."""

    strange: float = 0.3
    """Share of objects that rest on none of their facets, or lean, or whose hidden side is wrong."""
    lean: float = POSE_LEAN
    """Standard deviation about each axis [rad] of what rests on a facet."""


@dataclass(frozen=True, eq=False, kw_only=True)
class CameraEstimate:
    """A camera's focal length [px] and attitude [rad]; its principal point is in the middle unless told.

    All are means over the likeliest cameras: the single likeliest is less sure. ``errors`` are standard errors of the
    logarithm of the focal length, of pitch and of roll [rad].
    """

    focal: float
    pitch: float
    roll: float
    errors: tuple[float, float, float]
    segments: int
    """Line segments that were weighed, as the next."""
    rims: int
    normal_off: float | None = None
    """Angle of the network's normal of the ground to ``up`` [rad], where there is one."""

    @property
    def up(self) -> Array:
        """(3,), against gravity, in camera axes."""
        return attitude(self.pitch, self.roll)[:, 2]


@dataclass(frozen=True, eq=False, kw_only=True)
class _CameraEvidence:
    """What a photo shows, in pixels of ``side`` on its longer side, about its middle ``centre`` (2,)."""

    side: float
    centre: Array
    segments: GroupedSegments
    rims: Sequence[Ellipse]
    means: Array
    """Of the priors, (3,), as the next: logarithm of the focal length over ``side``, pitch, roll."""
    sigmas: Array
    standing: Array
    """Objects (n, 3): x of their middles, y of their tops and bottoms, about ``centre``, over ``side``."""
    farthest: Array
    """x and y (2,) of the ground farthest up in the picture, likewise."""
    directions: DirectionModel
    circles: RimModel
    horizon: HorizonModel
    ground: GroundNormal | None
    """By a network."""
    slopes: GroundNormalModel
    upward: Sequence[Array]
    """Of posed meshes, as a ``CameraByPoses`` has it."""
    facets: FacetModel

    def log_posterior(self, x: Array, *, turn: float, blur: float = 0.0) -> Array:
        """(t,) up to a constant, for cameras x (t, 3)."""
        focals = np.exp(x[:, 0]) * self.side
        rotations = np.array([attitude(pitch, roll) for pitch, roll in x[:, 1:]])
        lines = log_likelihoods(self.segments, focals, rotations, self.directions, step=turn, blur=blur).sum(1)
        prior = -0.5 * (((x - self.means) / self.sigmas) ** 2).sum(1)
        return (
            lines
            + self._circular(focals, rotations)
            + self._below(x)
            + prior
            + self._upright(rotations, blur)
            + self._resting(rotations, blur)
        )

    def _circular(self, focals: Array, rotations: Array) -> Array:
        """Log-likelihood (t,) of all rims as horizontal circles, over that of ellipses of any shape.

        The cone of rays Q through a conic cuts horizontal planes in circles where Q, restricted to horizontal
        directions, is a multiple of the identity."""
        total = np.zeros(len(focals))
        for rim in self.rims:
            K = np.zeros((len(focals), 3, 3))
            K[:, 0, 0] = K[:, 1, 1] = focals
            K[:, :2, 2], K[:, 2, 2] = self.centre, 1
            level = rotations[:, :, :2]
            B = level.swapaxes(1, 2) @ (K.swapaxes(1, 2) @ rim.conic @ K) @ level
            trace = B[:, 0, 0] + B[:, 1, 1]
            unequal = np.hypot(B[:, 0, 0] - B[:, 1, 1], 2 * B[:, 0, 1]) / trace
            rays = np.column_stack([(rim.centre - self.centre) / focals[:, None], np.ones(len(focals))])
            sine = np.abs((rays * rotations[:, :, 2]).sum(1)) / np.linalg.norm(rays, axis=1)
            # A plane seen at the angle e is foreshortened by sin e; a lean changes the logarithm of that by cot e.
            lean = self.circles.lean * np.sqrt(1 - sine**2) / np.maximum(sine, 1e-6)
            sigma = np.hypot(math.hypot(self.circles.shape, self.circles.edge / rim.minor), lean)
            strange = self.circles.strange
            inlier = (1 - strange) / (2 * sigma**2) * np.exp(-0.5 * (unequal / sigma) ** 2)
            total += np.log1p(inlier / strange)  # other ellipses are even over the unit disk
        return total

    def _upright(self, rotations: Array, blur: float) -> Array:
        """Log-likelihood (t,) of the network's normal of the ground, over that of normals that are no ground's."""
        if self.ground is None:
            return np.zeros(len(rotations))
        sigma = math.hypot(self.ground.error / 2, blur)
        # 2 (1 - cos) is the squared angle where it matters.
        far = (1 - rotations[:, :, 2] @ self.ground.normal) / sigma**2
        strange = self.slopes.strange
        return np.log1p((1 - strange) / strange / sigma**2 * np.exp(-far))

    def _resting(self, rotations: Array, blur: float) -> Array:
        """Log-likelihood (t,) of the stable facets of posed meshes, over that of facets on which nothing rests."""
        sigma, total = math.hypot(self.facets.lean, blur), np.zeros(len(rotations))
        for directions in self.upward:
            if len(directions):
                far = (1 - rotations[:, :, 2] @ directions.T) / sigma**2
                strange = self.facets.strange
                total += np.log1p((1 - strange) / strange / sigma**2 * np.exp(-far).mean(1))
        return total

    def _below(self, x: Array) -> Array:
        """Log-likelihood (t,) of the horizon's place: ground is below it, and the camera above much of what stands."""
        middle = -np.exp(x[:, 0]) * np.tan(x[:, 1]) / np.cos(x[:, 2])
        slope = np.tan(x[:, 2])
        over = middle + slope * self.farthest[0] - self.farthest[1]
        total = -0.5 * np.maximum(0, over / self.horizon.margin + 3) ** 2
        if len(self.standing):
            at, top, bottom = self.standing.T
            heights = (bottom - (middle[:, None] + slope[:, None] * at)) / (bottom - top)
            ratios = np.log(np.maximum(np.median(heights, axis=1), 1e-3) / self.horizon.ratio)
            total -= 0.5 * (np.minimum(0, ratios) / self.horizon.spread) ** 2
        return total


def attitude(pitch: float, roll: float) -> Array:
    """The world's right, forward and up (3, 3) in camera axes, as columns, for a camera that looks ``pitch`` [rad]
    below the horizon, the picture turned by ``roll`` [rad] clockwise."""
    c, s = math.cos(pitch), math.sin(pitch)
    level = np.array([[1.0, 0, 0], [0, -s, -c], [0, c, -s]])
    return rotation_about([0, 0, 1], roll) @ level


def estimate_camera(
    rgb: NDArray[np.uint8],
    masks: Sequence[NDArray[np.bool_]],
    ground: NDArray[np.bool_] | None,
    *,
    focal: KnownFocal | None = None,
    priors: CameraPriors | None = None,
    normal: GroundNormal | None = None,
    upward: Sequence[Array] = (),
) -> CameraEstimate:
    """The camera of a photo (H, W, 3) with masks (H, W) of objects and of the ground.

    ``focal`` is what somebody tells of the focal length, and of the principal point. ``normal`` is a network's normal
    of the ground, in camera axes. ``upward`` is that of posed meshes, as a ``CameraByPoses`` has it. The posterior is
    searched on a grid and then sampled; the samples' spread gives the errors."""
    evidence, scale = _evidence(rgb, masks, ground, focal, priors or CameraPriors(), normal, upward)
    found = _posterior(evidence)
    best = found.centre(WINDOW)
    f, pitch, roll = map(float, np.sqrt(np.diag(found.covariance(best))))
    return CameraEstimate(
        focal=focal.pixels if focal and focal.sigma == 0 else float(np.exp(best[0]) * evidence.side * scale),
        pitch=float(best[1]),
        roll=float(best[2]),
        errors=(f, pitch, roll),
        segments=len(evidence.segments.sigmas),
        rims=len(evidence.rims),
        normal_off=None if normal is None else _angle(normal.normal, attitude(float(best[1]), float(best[2]))[:, 2]),
    )


def _evidence(
    rgb: NDArray[np.uint8],
    masks: Sequence[NDArray[np.bool_]],
    ground: NDArray[np.bool_] | None,
    focal: KnownFocal | None,
    priors: CameraPriors,
    normal: GroundNormal | None,
    upward: Sequence[Array],
) -> tuple[_CameraEvidence, float]:
    """What the photo shows, and its pixels per pixel of that."""
    scale = max(1.0, max(rgb.shape[:2]) / LONGEST)
    h, w = (round(n / scale) for n in rgb.shape[:2])
    if scale > 1:
        rgb = np.asarray(Image.fromarray(rgb).resize((w, h), Image.Resampling.BOX))
    rows, columns = (((np.arange(n) + 0.5) * scale).astype(int) for n in (h, w))
    small = [mask[rows][:, columns] for mask in masks]
    floor = None if ground is None else ground[rows][:, columns]
    edges = edge_points(rgb)
    segments = line_segments(edges)[:MOST_SEGMENTS]
    side = float(max(w, h))
    centre = np.array([w / 2, h / 2]) if focal is None or focal.centre is None else np.array(focal.centre) / scale
    model = DirectionModel()
    means, sigmas = (math.log(priors.focal), priors.focal_sigma), (priors.pitch_sigma, priors.roll_sigma)
    if focal:
        means = math.log(focal.pixels / scale / side), max(focal.sigma, EXACT)
    mean, sigma = means
    return _CameraEvidence(
        side=side,
        centre=centre,
        segments=grouped(segments, _groups(segments, small, floor), objects=len(small), centre=centre, model=model),
        rims=rims(small, edges),
        standing=np.array([_extent(mask, side, centre) for mask in small if mask.any()]).reshape(-1, 3),
        farthest=_farthest(floor, side, centre),
        means=np.array([mean, priors.pitch, 0.0]),
        sigmas=np.array([sigma, *sigmas]),
        directions=model,
        circles=RimModel(),
        horizon=HorizonModel(),
        ground=normal,
        slopes=GroundNormalModel(),
        upward=upward,
        facets=FacetModel(),
    ), scale


def _angle(a: Array, b: Array) -> float:
    """Between unit vectors (3,) [rad]."""
    return math.acos(min(1.0, float(a @ b)))


def _extent(mask: NDArray[np.bool_], side: float, centre: Array) -> tuple[float, float, float]:
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    x = (columns[0] + columns[-1] + 1) / 2
    return (x - centre[0]) / side, (rows[0] - centre[1]) / side, (rows[-1] + 1 - centre[1]) / side


def _farthest(ground: NDArray[np.bool_] | None, side: float, centre: Array) -> Array:
    """Where the ground reaches up in the picture, all but a hundredth of it; the bottom edge where none is outlined."""
    if ground is None or not ground.any():
        return np.array([0.0, centre[1] / side])
    rows, columns = np.nonzero(ground)
    top = np.quantile(rows, HIGHEST)
    return np.array([float(np.median(columns[rows <= top])) - centre[0], top - centre[1]]) / side


def _groups(segments: Array, masks: Sequence[NDArray[np.bool_]], ground: NDArray[np.bool_] | None) -> NDArray[np.int64]:
    """The group (n,) of each segment (n, 4): the object on one side of it, else the ground, else the rest."""
    n = len(segments)
    if not n:
        return np.zeros(0, np.int64)
    along = segments[:, 2:] - segments[:, :2]
    across = np.column_stack([-along[:, 1], along[:, 0]]) / np.linalg.norm(along, axis=1)[:, None]
    places = segments[:, None, :2] + SAMPLES[:, None] * along[:, None]
    votes = np.zeros((n, len(masks) + 2))
    votes[:, -1] = 0.5  # the rest: where no other has a vote
    regions = [*masks, *([] if ground is None else [ground])]
    for side in (-BESIDE, BESIDE):
        x, y = np.moveaxis((places + side * across[:, None]).astype(int), 2, 0)
        for k, region in enumerate(regions):
            h, w = region.shape
            hits = region[np.clip(y, 0, h - 1), np.clip(x, 0, w - 1)].sum(1)
            votes[:, k] += np.where(hits >= OF_NINE, hits * (1 if k < len(masks) else 0.01), 0)
    return np.argmax(votes, axis=1)


def _posterior(evidence: _CameraEvidence) -> PosteriorSample:
    """Cameras (n, 3): of a grid with widened directions, then drawn with ever sharper ones."""

    def sharpened(blur: float) -> Callable[[Array], Array]:
        return lambda x: evidence.log_posterior(x, turn=FINE_TURN, blur=blur)

    grid = _grid(evidence)
    start = weighted(grid, evidence.log_posterior(grid, turn=COARSE_TURN, blur=COARSE_BLUR))
    spacing = np.array([COARSE_FOCAL, COARSE_PITCH, ROLLS[2]]) / 2
    narrow = np.array([evidence.sigmas[0], np.inf, np.inf])
    return sampled(
        start, [sharpened(b) for b in BLURS], spacing=np.minimum(spacing, narrow), least=np.minimum(LEAST, narrow / 4)
    )


def _grid(evidence: _CameraEvidence) -> Array:
    """Cameras (t, 3) of the first search: within three standard deviations of the focal length, and of the rest all."""
    mean, sigma = evidence.means[0], evidence.sigmas[0]
    low, high = max(math.log(FOCALS[0]), mean - 3 * sigma), min(math.log(FOCALS[1]), mean + 3 * sigma)
    focals = np.linspace(low, high, max(1, round((high - low) / COARSE_FOCAL)) + 1) if low < high else [mean]
    return np.array(list(itertools.product(focals, np.arange(*PITCHES, COARSE_PITCH), ROLLS)))
