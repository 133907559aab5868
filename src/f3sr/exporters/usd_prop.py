"""One object as a SimReady prop (NVIDIA SimReady Foundation, profile Robotics-Prop 4.0.0)."""

from __future__ import annotations

from typing import Any

import numpy as np

import f3sr
from f3sr.exporters.export_names import export_text
from f3sr.exporters.exported_scene import ExportedObject, ExportedScene
from f3sr.exporters.looks import ExportedLook
from f3sr.exporters.usd_library import Material, Prim, Stage, new_stage, pxr, text_of
from f3sr.exporters.usd_looks import add_hull, add_surface, add_visual
from f3sr.exporters.usd_variants import add_variants, variants_told
from f3sr.exporters.wikidata_classes import class_of

FOLDER = "simready_usd"
"""Between an asset's folder and its layer."""
PROFILE, PROFILE_VERSION = "Robotics-Prop", "4.0.0"
UNKNOWN_LICENSE = "not stated: that of the photo and of its mesh"


def prop_path(o: ExportedObject) -> str:
    """Where the prop of an object lies, relative to scene.usda."""
    return f"{o.name}/{FOLDER}/{o.name}.usda"


def texture_path(look: ExportedLook) -> str:
    """Where the texture of a look lies, relative to its prop."""
    return f"textures/visual_{look.number:02d}.png"


def prop_layer(o: ExportedObject, exported: ExportedScene) -> bytes:
    """The prop as ``.usda``."""
    usd = pxr()
    stage, root = new_stage(o.name, kind=usd.Kind.Tokens.component)
    stage.GetRootLayer().customLayerData = _metadata(o, exported)
    _set_body(root, o)
    _label(root, "class", o.label or "object")
    _label(root, "wikidata_qcode", class_of(o.label))
    path = str(root.GetPath())
    usd.UsdGeom.Xform.Define(stage, f"{path}/geometry")
    usd.UsdGeom.Xform.Define(stage, f"{path}/colliders")
    usd.UsdGeom.Scope.Define(stage, f"{path}/materials")
    for look in o.looks:
        name = f"visual_{look.number:02d}"
        texture = None if look.png is None else f"./{texture_path(look)}"
        material = add_surface(stage, f"{path}/materials/{name}", look, texture)
        _label(material.GetPrim(), "material", o.object.material)
        _bind(add_visual(stage, f"{path}/geometry/{name}", look), material)
    contact = add_contact_material(stage, f"{path}/materials/contact", o.body.friction[0], o.object.restitution)
    _label(contact.GetPrim(), "material", o.object.material)
    for k, part in enumerate(o.colliders):
        bind_contact(add_hull(stage, f"{path}/colliders/hull_{k:03d}", part), contact)
    return text_of(stage, lambda layer: add_variants(layer, o.name))


def add_contact_material(stage: Stage, path: str, friction: float, restitution: float) -> Material:
    """A material that only physics sees."""
    usd = pxr()
    material = usd.UsdShade.Material.Define(stage, path)
    contact = usd.UsdPhysics.MaterialAPI.Apply(material.GetPrim())
    contact.CreateStaticFrictionAttr(friction)
    contact.CreateDynamicFrictionAttr(friction)
    contact.CreateRestitutionAttr(restitution)
    return material


def bind_contact(prim: Prim, material: Material) -> None:
    """The contact material of a collider."""
    usd = pxr()
    binding = usd.UsdShade.MaterialBindingAPI.Apply(prim)
    binding.Bind(material, usd.UsdShade.Tokens.weakerThanDescendants, "physics")


def _bind(prim: Prim, material: Material) -> None:
    pxr().UsdShade.MaterialBindingAPI.Apply(prim).Bind(material)


def _set_body(root: Prim, o: ExportedObject) -> None:
    """A rigid body with its mass, centre, principal moments and axes."""
    usd = pxr()
    usd.UsdPhysics.RigidBodyAPI.Apply(root)
    mass = usd.UsdPhysics.MassAPI.Apply(root)
    moments, (w, x, y, z) = o.principal_inertia
    mass.CreateMassAttr(o.body.mass)
    mass.CreateCenterOfMassAttr(usd.Gf.Vec3f(*map(float, o.body.center)))
    mass.CreateDiagonalInertiaAttr(usd.Gf.Vec3f(*map(float, moments)))
    mass.CreatePrincipalAxesAttr(usd.Gf.Quatf(float(w), float(x), float(y), float(z)))


def _label(prim: Prim, taxonomy: str, text: str) -> None:
    """A semantic label of a prim."""
    labels = pxr().UsdSemantics.LabelsAPI.Apply(prim, taxonomy)
    labels.CreateLabelsAttr([export_text(text) or "unknown"])


def _metadata(o: ExportedObject, exported: ExportedScene) -> dict[str, Any]:
    """What a catalogue of assets wants to know, and what of the package the prop does not hold otherwise."""
    extents = np.ptp(o.bounds, axis=0)
    simready = {
        "author": f"f3sr {f3sr.__version__}",
        "asset_name": o.name,
        "asset_type": "prop",
        "asset_license": UNKNOWN_LICENSE,
        "category": export_text(o.label) or "object",
        "source_file": exported.mesh_files.get(o.id, "unknown"),
        "usd_date_generated": exported.date or "unknown",
        "qcode": class_of(o.label),
        "rigid_body_count": 1,
        "asset_extents": pxr().Gf.Vec3f(*map(float, extents)),
        "mass": float(o.body.mass),
        "validation": {"profile": PROFILE, "profile_version": PROFILE_VERSION},
        "Variants": {"Physics": variants_told(o.name)},
    }
    own = {
        "id": str(o.id),
        "label": export_text(o.label),
        "density": float(o.object.density),
        "material": export_text(o.object.material),
        "material_source": o.object.material_source,
        "material_reason": export_text(o.object.material_reason),
        "rolling_friction": float(o.object.rolling_friction),
        "damping": float(o.object.damping),
        "mass_from": "mesh" if o.body.from_mesh else "proxies",
    }
    # Older versions of the profile look for these beside the dictionary.
    beside = ("asset_name", "asset_type", "source_file", "usd_date_generated")
    return {"SimReady_Metadata": simready, "f3sr": own, **{name: simready[name] for name in beside}}
