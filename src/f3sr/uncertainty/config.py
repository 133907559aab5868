"""Constants of the uncertainty of poses: what no photo tells of its own errors."""

from __future__ import annotations

from f3sr.settings import constants


@constants
class UncertaintyConfig:
    outline: float = 3.0
    """Independent places in which an outline errs."""
    detail: float = 2.0
    """Independent places in which an object's detail errs."""
    pixel: float = 0.5
    """Least error of an outline [px of the window]."""
    least_mismatch: float = 0.05
    """Least 1 - correlation of detail that counts as noise."""
    fitting_outline: float = 0.03
    """Loss that the outline of a generated mesh leaves where it fits its mask."""
    fitting_detail: float = 1.0
    """1 - correlation of detail that it leaves: generated textures are nothing to rely on."""
    shape: float = 0.014
    """Standard deviation of a generated surface at a contact [share of the object's size]."""
    stretch: float = 0.02
    """Standard deviation of the proportions of a generated shape [share]: one side of it may be seen, another not."""
    turn: float = 1.8
    """Standard deviation of a turn that nothing shows, a uniform one's [rad]."""
    scale: float = 0.2
    """Standard deviation of the logarithm of a scale that nothing shows."""
    center: float = 0.0045
    """Standard deviation of an estimated principal point [longer image sides]: what ten rendered scenes have."""
    focal: float = 0.01
    """Standard deviation of the logarithm of an estimated focal length, once levelled."""
    ground: float = 0.05
    """Standard deviation of a ground that nothing measured: tilt [rad], height [share of the camera's]."""
    resolution: int = 192
    """Longer side [px] of the windows in which silhouettes are compared."""
    max_faces: int = 4000
    """Most faces of the meshes that silhouettes are drawn from."""
