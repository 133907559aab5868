"""The settings of relate."""

from __future__ import annotations

import math
from typing import Annotated

from annotated_types import Interval

from f3sr.physics.contact_margin import DEFAULT_MARGIN, ContactMargin
from f3sr.settings import settings

Share = Annotated[float, Interval(gt=0, le=1)]
Cost = Annotated[float, Interval(ge=0, le=20)]


@settings
class RelateConfig:
    """Costs are negative log likelihoods: 1 is a third as likely, 3 one in twenty."""

    cells: Annotated[int, Interval(ge=8, le=512)] = 48
    """Grid cells along an object's longer horizontal side for height maps."""
    ray_sigma: Annotated[float, Interval(gt=0, le=0.5)] = 0.03
    """How well the distance of an object from the camera is known, as a share of it (one standard deviation): that of
    generated assets' poses."""
    max_ray_scale: Annotated[float, Interval(gt=0, le=0.5)] = 0.12
    """How far an object is moved along its viewing rays, as a share of its distance, to see what it could rest on."""
    height_sigma: Annotated[float, Interval(gt=0, le=0.5)] = 0.04
    """How well the height of an object over what it rests on is known otherwise, as a share of its size (tilt, shape).
    """
    max_gap: Share = 0.25
    """Largest gap or depth between an object and its support that may be left after that, in object sizes: generated
    poses miss an object's place by up to a fifth of its size."""
    min_overlap: Annotated[float, Interval(gt=0, lt=1)] = 0.03
    """Share of the object's footprint that must lie over a support."""
    full_overlap: Share = 0.3
    """Share of the footprint over a support from which on more overlap says nothing."""
    overlap_cost: Cost = 2.0
    """Cost where nothing of the footprint overlaps."""
    base: Share = 0.06
    """What lies this near to an object's lowest point, in its sizes, is its base."""
    through_cost: Cost = 3.0
    """Cost of standing with the whole base in the middle of something else."""
    order_cost: Cost = 1.0
    """Weight of whether the photo shows that one of two overlapping objects that would be in front."""
    order_sigma: Annotated[float, Interval(gt=0, le=0.2)] = 0.015
    """How well the order of two surfaces in a pixel is known, as a share of their distance."""
    seen_cost: Cost = 2.0
    """Cost where the photo shows nothing of a support just below the object."""
    below_pixels: Annotated[float, Interval(gt=0, le=0.1)] = 0.006
    """How far below its mask's lower edge an object's support is looked for, as a share of the image height."""
    edge_part: Share = 0.4
    """The lowest part of a mask, as a share of its height, whose edge is looked below."""
    share_reach: Annotated[float, Interval(gt=0, le=0.5)] = 0.03
    """What lies within this distance under an object that rests, in its sizes, carries it too."""
    share_overlap: Share = 0.05
    """Share of the footprint that must lie over a further support that is not needed for balance."""
    stable: Annotated[float, Interval(ge=0, le=0.5)] = 0.04
    """How far outside what touches its support an object's middle of mass may seem to lie, in its sizes, before
    something else must carry too."""
    tilt: Annotated[float, Interval(ge=0, le=math.pi / 4)] = math.radians(3)
    """How well an object's tilt is known [rad]: what would touch if it were turned by this much counts as touching."""
    needed_cost: Cost = 2.0
    """Largest cost of a support that is needed for balance."""
    refused_cost: Cost = 8.0
    """How much more than the likeliest support a given one may cost before it is not followed: 3000 times less likely.
    """
    unseen_scale: Annotated[float, Interval(gt=0, le=2)] = 0.25
    """An object rests on something unseen when it would have to move farther than this share of its distance to reach
    the ground..."""
    unseen_height: Annotated[float, Interval(gt=0, le=10)] = 1.0
    """...hangs higher than this over it, in its sizes, over nothing else,..."""
    unseen_agreement: Annotated[float, Interval(gt=0, le=1)] = 0.1
    """...and its depth agrees with the photo's geometry to this share."""
    rim_depth: Share = 0.25
    """An object is inside another when the rim around it is this much of its height above its lowest point..."""
    rim_share: Share = 0.7
    """...in this share of the directions around it."""
    touch: Annotated[float, Interval(gt=0, le=0.5)] = 0.02
    """Largest distance of two objects that touch, in sizes of the smaller one, where only surfaces are known."""
    contact: ContactMargin = DEFAULT_MARGIN
    """Its ``reach`` is the largest gap between the proxies of two objects that touch once they rest."""
    beside: Annotated[float, Interval(gt=0, le=2)] = 0.5
    """Largest distance of two objects next to each other, in sizes of the smaller one."""
    same_level: Share = 0.3
    """Share of the lower one's height that two objects next to each other have in common."""
    lean_height: Share = 0.25
    """An object leans on what touches it this much of its height above its lowest contact, if it is needed for balance.
    """
    common: Annotated[float, Interval(gt=0, le=0.5)] = 0.02
    """Share of the smaller silhouette from which on two objects overlap in the picture."""
    in_view: Annotated[float, Interval(ge=0, le=1)] = 0.03
    """How far apart two silhouettes' boxes may be in the picture, as a share of it, for one to be before the other."""
    sure_order: Annotated[float, Interval(gt=0.5, le=1)] = 0.7
    """Share of the pixels in common that must show the same one of two objects, for it to be in front."""
