"""``scene.usda``: the props in their places, the ground, the photo's camera with its picture behind, and supports."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

import f3sr
from f3sr.core.camera import Camera
from f3sr.core.transforms import Array, box_corners, quaternion_from_rotation
from f3sr.exporters.export_names import export_text
from f3sr.exporters.exported_scene import ExportedObject, ExportedScene
from f3sr.exporters.usd_library import Layer, Prim, Stage, new_stage, pxr, text_of
from f3sr.exporters.usd_looks import add_unlit_surface
from f3sr.exporters.usd_prop import add_contact_material, bind_contact, prop_path
from f3sr.io.images import encode_png
from f3sr.scene import GRAVITY

ROOT = "/scene"
PHOTO, BACKGROUND = "photo", "background"
"""Pictures of the backplate: the photo, and the photo completed behind its objects."""
SENSOR = 0.36
"""Width of the camera's sensor [tenths of a metre], as USD measures it. Only its ratio to the focal length shows."""
BEHIND = 1.5
"""Distance of the backplate [greatest depth of the objects]."""
NEAR = 0.01
"""Distance of the camera's near plane [m]."""
FLIP = np.diag([1.0, -1, -1, 1])
"""From USD's camera axes (y up, looks along -z) to ours."""


def scene_pictures(exported: ExportedScene) -> Iterator[tuple[str, bytes]]:
    """The pictures of the backplate, beside ``scene.usda``."""
    yield f"textures/{PHOTO}.png", encode_png(exported.scene.photo.rgb)
    if exported.background is not None:
        yield f"textures/{BACKGROUND}.png", encode_png(exported.background)


def scene_layer(exported: ExportedScene) -> bytes:
    """The scene as ``.usda``."""
    usd = pxr()
    scene = exported.scene
    stage, _ = new_stage(ROOT[1:], kind=usd.Kind.Tokens.assembly)
    stage.GetRootLayer().customLayerData = {"f3sr": {"version": f3sr.__version__, "date": exported.date or "unknown"}}
    physics = usd.UsdPhysics.Scene.Define(stage, f"{ROOT}/physics")
    physics.CreateGravityDirectionAttr(usd.Gf.Vec3f(0, 0, -1))
    physics.CreateGravityMagnitudeAttr(GRAVITY)
    usd.UsdGeom.Scope.Define(stage, f"{ROOT}/materials")
    _add_ground(stage, exported)
    usd.UsdLux.DomeLight.Define(stage, f"{ROOT}/sky").CreateIntensityAttr(1.0)
    usd.UsdGeom.Xform.Define(stage, f"{ROOT}/objects")
    for o in exported.objects:
        _add_object(stage, o, exported)
    _add_camera(stage, scene.camera)
    depth = max(scene.camera.to_camera(box_corners(exported.bounds))[:, 2].max(), 1.0)
    _add_backplate(stage, scene.camera, BEHIND * float(depth), completed=exported.background is not None)
    return text_of(stage, lambda layer: _add_references(layer, exported))


def _add_references(layer: Layer, exported: ExportedScene) -> None:
    """The props that the objects are."""
    sdf = pxr().Sdf
    for o in exported.objects:
        prim = layer.GetPrimAtPath(f"{ROOT}/objects/{o.name}")
        prim.referenceList.Prepend(sdf.Reference(f"./{prop_path(o)}"))


def _add_ground(stage: Stage, exported: ExportedScene) -> None:
    """The plane where bodies touch, for collisions only: the backplate shows what the objects stand on."""
    usd = pxr()
    plane = usd.UsdGeom.Plane.Define(stage, f"{ROOT}/ground")
    plane.CreateAxisAttr(usd.UsdGeom.Tokens.z)
    ground = exported.ground_under(exported.bounds)
    x, y, _ = ground.middle
    side, _, _ = ground.sides
    plane.CreateWidthAttr(side)
    plane.CreateLengthAttr(side)
    plane.AddTranslateOp().Set(usd.Gf.Vec3d(x, y, exported.ground_height))
    half = side / 2
    plane.CreateExtentAttr([usd.Gf.Vec3f(-half, -half, 0), usd.Gf.Vec3f(half, half, 0)])
    plane.CreatePurposeAttr(usd.UsdGeom.Tokens.guide)
    usd.UsdPhysics.CollisionAPI.Apply(plane.GetPrim())
    friction = exported.scene.ground.friction
    bind_contact(plane.GetPrim(), add_contact_material(stage, f"{ROOT}/materials/ground", friction, 0.0))


def _add_object(stage: Stage, o: ExportedObject, exported: ExportedScene) -> None:
    """A reference to the prop in its pose, with what carries it. Fixed objects are no rigid bodies here."""
    usd = pxr()
    types = usd.Sdf.ValueTypeNames
    prim = usd.UsdGeom.Xform.Define(stage, f"{ROOT}/objects/{o.name}").GetPrim()
    _place(prim, o.object.T_world_object)
    if o.body.fixed:
        usd.UsdPhysics.RigidBodyAPI(prim).CreateRigidBodyEnabledAttr(False)
    prim.CreateAttribute("f3sr:id", types.Int, custom=True).Set(o.id)
    prim.CreateAttribute("f3sr:label", types.String, custom=True).Set(export_text(o.label))
    carriers = [_path(exported, s.id) for s in o.object.supports]
    prim.CreateRelationship("f3sr:restsOn", custom=True).SetTargets(carriers)
    shares = [float(s.share) for s in o.object.supports]
    prim.CreateAttribute("f3sr:restsOnShares", types.FloatArray, custom=True).Set(shares)
    if o.object.supported_by is not None:
        main = prim.CreateRelationship("f3sr:supportedBy", custom=True)
        main.SetTargets([_path(exported, o.object.supported_by)])


def _path(exported: ExportedScene, id: int) -> str:
    """The prim of an object, or of the ground."""
    name = exported.names[id]
    return f"{ROOT}/{name}" if id < 0 else f"{ROOT}/objects/{name}"


def _place(prim: Prim, T: Array) -> None:
    """The rigid pose T (4, 4) of a prim."""
    usd = pxr()
    place = usd.UsdGeom.Xformable(prim)
    double = usd.UsdGeom.XformOp.PrecisionDouble
    place.AddTranslateOp(double).Set(usd.Gf.Vec3d(*map(float, T[:3, 3])))
    w, x, y, z = map(float, quaternion_from_rotation(T[:3, :3]))
    place.AddOrientOp(double).Set(usd.Gf.Quatd(w, x, y, z))


def _add_camera(stage: Stage, camera: Camera) -> None:
    """The photo's camera with its principal point; USD has no skew."""
    usd = pxr()
    K = camera.K
    focal = SENSOR * K[0, 0] / camera.width
    made = usd.UsdGeom.Camera.Define(stage, f"{ROOT}/photo_camera")
    made.CreateFocalLengthAttr(float(focal))
    made.CreateHorizontalApertureAttr(float(focal * camera.width / K[0, 0]))
    made.CreateVerticalApertureAttr(float(focal * camera.height / K[1, 1]))
    made.CreateHorizontalApertureOffsetAttr(float(focal * (camera.width / 2 - K[0, 2]) / K[0, 0]))
    made.CreateVerticalApertureOffsetAttr(float(focal * (K[1, 2] - camera.height / 2) / K[1, 1]))
    made.CreateClippingRangeAttr(usd.Gf.Vec2f(NEAR, 1e5))
    _place(made.GetPrim(), camera.T_world_camera @ FLIP)


def _add_backplate(stage: Stage, camera: Camera, distance: float, *, completed: bool) -> None:
    """The picture behind the scene, which fills the camera's view: a variant each for the photo, the background and
    none."""
    usd = pxr()
    quad = usd.UsdGeom.Mesh.Define(stage, f"{ROOT}/photo_camera/backplate")
    corners = np.array([[0, camera.height], [camera.width, camera.height], [camera.width, 0], [0, 0]], float)
    rays = np.column_stack([corners, np.ones(4)]) @ np.linalg.inv(camera.K).T
    points = usd.Vt.Vec3fArray.FromNumpy((distance * rays * [1, -1, -1]).astype(np.float32))
    quad.CreatePointsAttr(points)
    quad.CreateFaceVertexCountsAttr([4])
    quad.CreateFaceVertexIndicesAttr([0, 1, 2, 3])
    quad.CreateExtentAttr(usd.UsdGeom.PointBased.ComputeExtent(points))
    quad.CreateSubdivisionSchemeAttr(usd.UsdGeom.Tokens.none)
    quad.CreateDoubleSidedAttr(True)
    primvars, types = usd.UsdGeom.PrimvarsAPI(quad), usd.Sdf.ValueTypeNames
    st = primvars.CreatePrimvar("st", types.TexCoord2fArray, usd.UsdGeom.Tokens.vertex)
    st.Set([usd.Gf.Vec2f(u, v) for u, v in ((0, 0), (1, 0), (1, 1), (0, 1))])
    normals = primvars.CreatePrimvar("normals", types.Normal3fArray, usd.UsdGeom.Tokens.constant)
    normals.Set([usd.Gf.Vec3f(0, 0, 1)])
    _add_pictures(stage, quad, [PHOTO, BACKGROUND] if completed else [PHOTO])


def _add_pictures(stage: Stage, quad: Any, names: list[str]) -> None:
    """The variants of the backplate; the last picture is shown."""
    usd = pxr()
    materials = {n: add_unlit_surface(stage, f"{ROOT}/materials/{n}", f"./textures/{n}.png") for n in names}
    usd.UsdShade.MaterialBindingAPI.Apply(quad.GetPrim())
    chosen = quad.GetPrim().GetVariantSets().AddVariantSet("picture")
    for name in (*names, "none"):
        chosen.AddVariant(name)
        chosen.SetVariantSelection(name)
        with chosen.GetVariantEditContext():
            if name == "none":
                quad.CreateVisibilityAttr(usd.UsdGeom.Tokens.invisible)
            else:
                usd.UsdShade.MaterialBindingAPI(quad.GetPrim()).Bind(materials[name])
    chosen.SetVariantSelection(names[-1])
