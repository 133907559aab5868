"""Visual meshes and materials in USD: UsdPreviewSurface with a texture or one colour."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from f3sr.core.mesh import ConvexPart, area_vectors
from f3sr.core.transforms import Array
from f3sr.exporters.looks import ExportedLook
from f3sr.exporters.usd_library import Material, Prim, Stage, pxr
from f3sr.rendering.textures import linear

ROUGHNESS = 0.8
"""Of surfaces of which a photo tells no gloss."""


def add_visual(stage: Stage, path: str, look: ExportedLook) -> Prim:
    """The mesh of a look at ``path``, without faces of no area: they have no normal."""
    usd = pxr()
    seen = np.linalg.norm(area_vectors(look.vertices[look.faces]), axis=1) > 0
    faces, normals = look.faces[seen], look.normals[seen].reshape(-1, 3)
    mesh = usd.UsdGeom.Mesh.Define(stage, path)
    _set_shape(mesh, look.vertices, faces)
    _set_normals(mesh, normals, usd.UsdGeom.Tokens.faceVarying)
    if look.uv is not None:
        kind, vertex = usd.Sdf.ValueTypeNames.TexCoord2fArray, usd.UsdGeom.Tokens.vertex
        st = usd.UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", kind, vertex)
        st.Set(usd.Vt.Vec2fArray.FromNumpy(look.uv.astype(np.float32)))
    mesh.CreateDisplayColorPrimvar(usd.UsdGeom.Tokens.constant).Set([_color(look.mean_rgb)])
    return mesh.GetPrim()


def add_hull(stage: Stage, path: str, part: ConvexPart) -> Prim:
    """A convex collider at ``path``, which renderers leave out."""
    usd = pxr()
    mesh = usd.UsdGeom.Mesh.Define(stage, path)
    # Last vertex first: validators take a hull with the visual mesh's very arrays for a copy left by mistake.
    _set_shape(mesh, part.vertices[::-1], len(part.vertices) - 1 - part.faces)
    triangles = part.vertices[part.faces]
    normals, outward = area_vectors(triangles), triangles.mean(1) - part.centroid
    length, away = (np.linalg.norm(v, axis=1, keepdims=True) for v in (normals, outward))
    # A face of no area has no normal of its own.
    normals = np.where(length > 0, normals / np.where(length > 0, length, 1), outward / np.where(away > 0, away, 1))
    _set_normals(mesh, normals, usd.UsdGeom.Tokens.uniform)
    mesh.CreatePurposeAttr(usd.UsdGeom.Tokens.guide)
    prim = mesh.GetPrim()
    usd.UsdPhysics.CollisionAPI.Apply(prim)
    usd.UsdPhysics.MeshCollisionAPI.Apply(prim).CreateApproximationAttr(usd.UsdPhysics.Tokens.convexHull)
    return prim


def add_surface(stage: Stage, path: str, look: ExportedLook, texture: str | None) -> Material:
    """The material of a look at ``path``. ``texture`` is the picture's path relative to the layer."""
    usd = pxr()
    material, surface = _preview_surface(stage, path)
    surface.CreateInput("roughness", usd.Sdf.ValueTypeNames.Float).Set(ROUGHNESS)
    surface.CreateInput("metallic", usd.Sdf.ValueTypeNames.Float).Set(0.0)
    diffuse = surface.CreateInput("diffuseColor", usd.Sdf.ValueTypeNames.Color3f)
    if texture is not None:
        factor = _color(look.mesh.materials[look.number].base_color)
        diffuse.ConnectToSource(_texture(stage, path, texture, scale=factor), "rgb")
    else:
        diffuse.Set(_color(look.rgb))
    return material


def add_unlit_surface(stage: Stage, path: str, texture: str) -> Material:
    """A material that shows a picture as it is: it gives off the picture's light and reflects none."""
    usd = pxr()
    types = usd.Sdf.ValueTypeNames
    material, surface = _preview_surface(stage, path)
    surface.CreateInput("roughness", types.Float).Set(1.0)
    surface.CreateInput("diffuseColor", types.Color3f).Set(usd.Gf.Vec3f(0.0))
    emissive = surface.CreateInput("emissiveColor", types.Color3f)
    emissive.ConnectToSource(_texture(stage, path, texture, wrap="clamp"), "rgb")
    return material


def _preview_surface(stage: Stage, path: str) -> tuple[Material, Any]:
    usd = pxr()
    material = usd.UsdShade.Material.Define(stage, path)
    surface = usd.UsdShade.Shader.Define(stage, f"{path}/surface")
    surface.CreateIdAttr("UsdPreviewSurface")
    surface.CreateOutput("surface", usd.Sdf.ValueTypeNames.Token)
    material.CreateSurfaceOutput().ConnectToSource(surface.ConnectableAPI(), "surface")
    return material, surface


def _texture(stage: Stage, path: str, file: str, *, scale: Any = None, wrap: str = "repeat") -> Any:
    """What a shader connects to for the colours of a picture."""
    usd = pxr()
    types = usd.Sdf.ValueTypeNames
    reader = usd.UsdShade.Shader.Define(stage, f"{path}/coordinates")
    reader.CreateIdAttr("UsdPrimvarReader_float2")
    reader.CreateInput("varname", types.String).Set("st")
    reader.CreateOutput("result", types.Float2)
    texture = usd.UsdShade.Shader.Define(stage, f"{path}/texture")
    texture.CreateIdAttr("UsdUVTexture")
    texture.CreateInput("file", types.Asset).Set(usd.Sdf.AssetPath(file))
    texture.CreateInput("sourceColorSpace", types.Token).Set("sRGB")
    texture.CreateInput("wrapS", types.Token).Set(wrap)
    texture.CreateInput("wrapT", types.Token).Set(wrap)
    if scale is not None and scale != usd.Gf.Vec3f(1.0):
        texture.CreateInput("scale", types.Float4).Set(usd.Gf.Vec4f(*scale, 1.0))
    texture.CreateInput("st", types.Float2).ConnectToSource(reader.ConnectableAPI(), "result")
    texture.CreateOutput("rgb", types.Float3)
    return texture.ConnectableAPI()


def _set_shape(mesh: Any, vertices: Array, faces: Any) -> None:
    """Triangles (m, 3) of vertices (n, 3) [m], counter-clockwise from outside."""
    usd = pxr()
    points = usd.Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(vertices, np.float32))
    mesh.CreatePointsAttr(points)
    mesh.CreateFaceVertexCountsAttr(_ints(np.full(len(faces), 3)))
    mesh.CreateFaceVertexIndicesAttr(_ints(faces))
    mesh.CreateExtentAttr(usd.UsdGeom.PointBased.ComputeExtent(points))
    mesh.CreateSubdivisionSchemeAttr(usd.UsdGeom.Tokens.none)


def _set_normals(mesh: Any, normals: NDArray[Any], interpolation: str) -> None:
    """Unit normals (n, 3), each distinct one once."""
    usd = pxr()
    distinct, which = np.unique(normals.astype(np.float32), axis=0, return_inverse=True)
    kind = usd.Sdf.ValueTypeNames.Normal3fArray
    primvar = usd.UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("normals", kind, interpolation)
    primvar.Set(usd.Vt.Vec3fArray.FromNumpy(distinct))
    primvar.SetIndices(_ints(which))


def _ints(values: Any) -> Any:
    return pxr().Vt.IntArray.FromNumpy(np.ascontiguousarray(np.asarray(values).ravel(), np.int32))


def _color(rgb: Any) -> Any:
    """Linear light of sRGB values in [0, 1]."""
    return pxr().Gf.Vec3f(*map(float, linear(np.asarray(rgb, float))))
