"""What options of the commands accept, where no library has to be loaded to say so."""

from __future__ import annotations

from typing import Literal, get_args

SKIPPABLE = (
    *("level", "align", "align-camera", "align-objects", "relate", "decompose", "separate", "settle"),
    *("close", "refine", "coarsen", "describe", "uncertainty", "evaluate", "inpaint"),
)
"""Stages, and parts of ``align``, that ``--skip`` leaves out."""
Part = Literal["assets", "geometry", "ground", "scene_graph", "background", "materials"]
PARTS: tuple[str, ...] = get_args(Part)
"""Parts of a prompted-image folder that ``--ignore`` treats as absent."""
ASSET_FRAMES = ("auto", "opencv", "opengl", "pytorch3d", "unity", "blender", "unposed")
"""How meshes and poses of ``assets/`` are read, for ``--asset-frame``: by the masks, in camera axes with a name, or
without a pose. It also takes axes and conventions by their own names, see ``io/pose_conventions``."""
EDIT = "edit"
"""What a user changes in a finished scene, in motions and reports beside the stages."""
