"""The constants of relate."""

from __future__ import annotations

import math

from f3sr.physics.contact_margin import DEFAULT_MARGIN, ContactMargin
from f3sr.settings import constants


@constants
class RelateConfig:
    """Costs are negative log likelihoods: 1 is a third as likely, 3 one in twenty. ``vision.depth_prior`` says how well
    distances are known."""

    cells: int = 48
    """Grid cells along an object's longer horizontal side for height maps."""
    height_sigma: float = 0.04
    """Standard deviation of an object's height over its support by tilt and shape [size]."""
    max_gap: float = 0.25
    """Largest gap or depth left between an object and its support [size]; generated poses miss by up to a fifth."""
    min_overlap: float = 0.03
    """Least share of an object's footprint over a support."""
    full_overlap: float = 0.3
    """Share of the footprint over a support from which more overlap says nothing."""
    overlap_cost: float = 2.0
    """Cost where nothing of the footprint overlaps."""
    base: float = 0.06
    """Height of an object's base over its lowest point [size]."""
    through_cost: float = 3.0
    """Cost of standing with the whole base in the middle of something else."""
    order_cost: float = 1.0
    """Weight of the depth order: the photo must show the front one of two objects that overlap."""
    order_sigma: float = 0.015
    """Standard deviation of the depth difference of two surfaces in a pixel [share of their distance]."""
    seen_cost: float = 2.0
    """Cost where the photo shows nothing of a support just below the object."""
    below_pixels: float = 0.006
    """Distance below a mask's lower edge at which a support is looked for [share of the image height]."""
    edge_part: float = 0.4
    """Lowest part of a mask below whose edge a support is looked for [share of the mask's height]."""
    share_reach: float = 0.03
    """Largest gap under an object that rests at which something carries it too [size]."""
    share_overlap: float = 0.05
    """Least share of the footprint over a further support that balance does not need."""
    stable: float = 0.04
    """Largest distance of the centre of mass outside its contacts at which nothing else need carry [size]."""
    tilt: float = math.radians(3)
    """Error of an object's tilt [rad]: what a turn by it would bring into contact counts as touching."""
    needed_cost: float = 2.0
    """Largest cost of a support that is needed for balance."""
    refused_cost: float = 8.0
    """Largest extra cost of a given support against the likeliest one: 3000 times less likely."""
    unseen_scale: float = 0.08
    """Least move to the ground of an object on something unseen [share of its distance]. After alignment none of 535
    objects on the ground, of 129 scenes, is more than .042 away."""
    unseen_sigmas: float = 8.0
    """The same [standard deviations of its distance]."""
    unseen_height: float = 0.25
    """Least height over the ground of an object on something unseen [size]; poor meshes and masks lack up to .2."""
    unseen_cost: float = 5.0
    """Cost from which on another object is no likely support of it."""
    unseen_agreement: float = 0.25
    """Largest difference of its depth from the photo's geometry [share of the move to the ground]."""
    rim_depth: float = 0.25
    """Least height of the rim around an object that is inside, over the object's lowest point [its height]."""
    rim_share: float = 0.7
    """Least share of directions in which there is such a rim."""
    touch: float = 0.02
    """Largest gap of two objects that touch, where only surfaces are known [size of the smaller one]."""
    contact: ContactMargin = DEFAULT_MARGIN
    """Its ``reach`` is the largest gap between the proxies of two objects that touch once they rest."""
    beside: float = 0.5
    """Largest gap of two objects next to each other [size of the smaller one]."""
    same_level: float = 0.3
    """Least common height range of two objects next to each other [height of the lower one]."""
    lean_height: float = 0.25
    """Least height of a contact to lean on over the lowest contact [height of the object]."""
    common: float = 0.02
    """Least common share of the smaller silhouette for two objects to overlap in the picture."""
    in_view: float = 0.03
    """Largest gap of two silhouettes' boxes for one to be before the other [longer side of the picture]."""
    sure_order: float = 0.7
    """Least share of common pixels that must show the one of two objects that is in front."""
