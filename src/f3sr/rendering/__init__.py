"""Films and pictures of a scene: textured objects at any poses, lit as the photo is, over the completed photo."""

from f3sr.rendering.config import LightConfig, RenderConfig, ShadowConfig
from f3sr.rendering.renderer import Renderer

__all__ = ["LightConfig", "RenderConfig", "Renderer", "ShadowConfig"]
