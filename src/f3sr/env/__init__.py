"""Scene packages as Gymnasium environments: ``import f3sr.env``, then ``gymnasium.make("f3sr/Scene-v0", package=...)``.

Needs ``pip install 'f3sr[gym]'``.
"""

from __future__ import annotations

from f3sr.backends.registry import BackendError

try:
    from gymnasium.envs.registration import register, registry
except ImportError:
    raise BackendError("gymnasium is not installed; pip install 'f3sr[gym]'") from None

ID = "f3sr/Scene-v0"
if ID not in registry:
    register(id=ID, entry_point="f3sr.env.scene_env:SceneEnv")
