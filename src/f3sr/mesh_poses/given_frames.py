"""Meshes of an input folder where they stand: by what the folder declares, else by the vote of the masks, else asked.

``--asset-frame`` or poses.json may say how files are read. Then that holds, and a warning tells where the masks see far
more in another reading. Otherwise the masks decide, and where they do not, an error names the readings that tie.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from f3sr.backends.protocols import CameraByPoses, GivenPose, ProducedMesh, PromptedImage
from f3sr.core.transforms import Array
from f3sr.errors import InputError, printable
from f3sr.io.given_meshes import GivenMeshes, PlacedMeshes
from f3sr.io.pose_conventions import ALL_AXES, CAMERAS, SAM3D, SignedAxes, all_conventions, camera_axes, parsed
from f3sr.io.sam3d import AssetPose
from f3sr.mesh_poses.camera_by_poses import camera_by_poses
from f3sr.mesh_poses.candidate_places import CandidatePlaces
from f3sr.mesh_poses.outline_votes import sieved
from f3sr.mesh_poses.placed_by_reading import about_its_middle, asset_of, placed_by_reading
from f3sr.mesh_poses.pose_by_mask import DEFAULT_SEARCH, MaskedPhoto
from f3sr.mesh_poses.poses_by_masks import poses_by_masks
from f3sr.mesh_poses.reading_votes import DEFAULT_VOTES, VoteConfig, Votes, voted
from f3sr.report import Decision
from f3sr.scene import Geometry

BELIEVED = 0.25
"""Mean of 1 - IoU up to which a declared reading is not doubted: poses that were never aligned miss as much."""
WARNED = 0.15
"""Gain of mean IoU from which on another reading is told of."""
UNPOSED = "unposed"
NAMED = 4
"""Most readings that a question names."""


@dataclass(frozen=True, eq=False, kw_only=True)
class MaskPlacer:
    """The ``MeshPlacer`` that asks the masks."""

    votes: VoteConfig = DEFAULT_VOTES

    @np.errstate(over="ignore", invalid="ignore", divide="ignore")
    def camera(self, image: PromptedImage, given: GivenMeshes) -> CameraByPoses | None:
        """The camera before which meshes show what the masks show, where they are posed; None if they are not."""
        if given.frame == UNPOSED:
            return None
        masks = {i.id: i.mask for i in image.instances}
        readings, declared = _readings(given), _declared(given)
        name = declared.names[0] if declared is not None else ""
        places = readings if declared is None or name in readings.names else declared
        return camera_by_poses(masks, given.meshes, places, units=given.poses is not None, declared=name)

    @np.errstate(over="ignore", invalid="ignore", divide="ignore")
    def place(self, image: PromptedImage, geometry: Geometry, K: Array, given: GivenMeshes) -> PlacedMeshes:
        """All meshes in OpenCV camera axes. Raises InputError where nothing decides.

        Absurd numbers in poses.json overflow here; what they lead to is refused as an asset of an odd size."""
        if given.frame == UNPOSED:
            return self._unposed(image, geometry, K, given, f"--asset-frame {UNPOSED}")
        view = MaskedPhoto.of(image, geometry, K)
        readings = _readings(given)
        if (declared := _declared(given)) is not None:
            return _as_declared(view, given, readings, declared)
        votes = voted(view, given.meshes, readings, units=given.poses is not None, config=self.votes)
        if not votes.usable:
            best = f"{votes.ious[0]:.2f}" if len(votes.places) else "0"
            return self._unposed(
                image, geometry, K, given, f"no reading shows what the masks show (IoU {best} at best)"
            )
        taken = _taken(given, votes)
        told = f"the vote of {len(given.meshes)} masks, mean IoU {votes.ious[taken]:.2f} once corrected"
        return _placed(view, given, votes.places, taken, _what(given), told)

    def _unposed(
        self, image: PromptedImage, geometry: Geometry, K: Array, given: GivenMeshes, reason: str
    ) -> PlacedMeshes:
        """Where the masks put the meshes. InputError where they do not decide, unless the user takes the likeliest."""
        view = MaskedPhoto.of(image, geometry, K)
        produced = {id: ProducedMesh(mesh=mesh) for id, mesh in given.meshes.items()}
        ranked = poses_by_masks(view, produced, DEFAULT_SEARCH)
        doubts = {id: doubt for id, p in ranked.items() if (doubt := p.doubt(self.votes))}
        if doubts and given.frame != UNPOSED:
            raise _undecided(given, view, doubts)
        what = "poses.json is not used: " if given.poses is not None else ""
        first = Decision(choice=f"assets: {what}meshes without a pose stand where their masks put them", reason=reason,
                         fallback=given.frame != UNPOSED)  # fmt: skip
        each = (
            Decision(choice=p.told, reason=doubts.get(id, "the mesh has no pose"), about=id, fallback=id in doubts)
            for id, p in ranked.items()
        )
        assets = {id: asset_of(view, p.object, p.told) for id, p in ranked.items()}
        return PlacedMeshes(assets=assets, decisions=(first, *each))


def _undecided(given: GivenMeshes, view: MaskedPhoto, doubts: Mapping[int, str]) -> InputError:
    named = [f"{_name(view, id)}: {doubt}" for id, doubt in list(doubts.items())[:NAMED]]
    more = f" and {len(doubts) - NAMED} more" if len(doubts) > NAMED else ""
    return InputError(
        given.place,
        found=f"no pose, and the masks do not decide it; {'; '.join(named)}{more}",
        accepted=f"poses.json, or --asset-frame {UNPOSED}, which takes the likeliest poses",
    )


def _name(view: MaskedPhoto, id: int) -> str:
    instance = view.instances[id]
    return printable(f"object {id} ({instance.label or instance.name})")


def _readings(given: GivenMeshes) -> CandidatePlaces:
    if given.poses is not None:
        return CandidatePlaces.of_poses(_written(given.poses), all_conventions())
    return CandidatePlaces.of_frames(list(given.meshes), _usual_first())


def _written(poses: Mapping[int, AssetPose]) -> Mapping[int, GivenPose]:
    return {id: p.given for id, p in poses.items()}


def _usual_first() -> list[SignedAxes]:
    named = list(CAMERAS.values())
    return named + [axes for axes in ALL_AXES if axes not in named]


def _declared(given: GivenMeshes) -> CandidatePlaces | None:
    """The one reading that the user or the folder names, if any. InputError for one of the wrong kind."""
    if given.frame == "auto":
        if given.poses is None or not given.declared:
            return None
        return CandidatePlaces.of_poses(_written(given.poses), [SAM3D])
    if given.poses is None:
        if (axes := camera_axes(given.frame)) is None:
            raise InputError("--asset-frame", found=given.frame, accepted="camera axes, as there is no poses.json")
        return CandidatePlaces.of_frames(list(given.meshes), [axes])
    if (convention := parsed(given.frame)) is None:
        accepted = f"a convention such as {SAM3D.name}, as there is poses.json"
        raise InputError("--asset-frame", found=given.frame, accepted=accepted)
    return CandidatePlaces.of_poses(_written(given.poses), [convention])


def _as_declared(
    view: MaskedPhoto, given: GivenMeshes, readings: CandidatePlaces, declared: CandidatePlaces
) -> PlacedMeshes:
    """By the declared reading, with a warning where the masks see far more in another."""
    units = given.poses is not None
    own, missed = sieved(view, given.meshes, declared, units=units)
    placed = _placed(view, given, own if len(own) else declared, 0, "", "")
    if len(missed) and missed[0] <= BELIEVED:
        return placed
    others, others_missed = sieved(view, given.meshes, readings, units=units)
    shown = 1 - float(missed[0]) if len(missed) else 0.0
    if not len(others) or 1 - others_missed[0] - shown <= WARNED:
        return placed
    warning = Decision(
        choice=f"assets: read as declared ({declared.names[0]}), which looks wrong",
        reason=f"mean IoU with the masks {shown:.2f}; --asset-frame {others.names[0]} would give "
        f"{1 - others_missed[0]:.2f}",
        fallback=True,
    )
    return replace(placed, decisions=(warning, *placed.decisions))


def _taken(given: GivenMeshes, votes: Votes) -> int:
    """The reading to take. InputError where the masks do not decide: it names those that tie."""
    tied = [0, *votes.rivals]
    if len(tied) == 1:
        return votes.likeliest
    if given.poses is None:
        # Axes that programs use are likelier than all others.
        usual = [k for k in tied if votes.places.names[k] in CAMERAS]
        if len(usual) == 1:
            return usual[0]
        tied = usual or tied
    shown = ", ".join(f"{votes.places.names[k]} (IoU {votes.ious[k]:.2f})" for k in tied[:NAMED])
    more = f" and {len(tied) - NAMED} more" if len(tied) > NAMED else ""
    options = " or ".join(f"--asset-frame {votes.places.names[k]}" for k in tied[:NAMED])
    raise InputError(
        given.place,
        found=f"{'poses' if given.poses is not None else 'meshes'} that the masks show alike as {shown}{more}",
        accepted=options,
    )


def _what(given: GivenMeshes) -> str:
    return "poses.json is read as" if given.poses is not None else "meshes are posed in camera axes"


def _placed(
    view: MaskedPhoto, given: GivenMeshes, places: CandidatePlaces, k: int, what: str, reason: str
) -> PlacedMeshes:
    """All meshes by one reading, in the geometry's unit."""
    decisions = [Decision(choice=f"assets: {what} {places.names[k]}", reason=reason)] if what else []
    placed = placed_by_reading(view, given.meshes, places, k)
    decisions += placed.decisions
    ratios = {float(f"{r:.3g}") for r in (places.scale[k] / _given_scales(given, places)).tolist()}
    if ratios - {1.0}:
        ratio = next(iter(ratios - {1.0}))
        decisions.append(
            Decision(choice=f"assets: meshes times {ratio:g}", reason="their unit is not that of their places")
        )
    assets = placed.assets
    if given.poses is None:
        assets = {id: about_its_middle(a) for id, a in assets.items()}
    return PlacedMeshes(assets=assets, decisions=tuple(decisions))


def _given_scales(given: GivenMeshes, places: CandidatePlaces) -> Array:
    if given.poses is None:
        return np.ones(len(places.ids))
    return np.array([given.poses[id].uniform_scale for id in places.ids])
