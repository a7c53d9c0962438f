"""Stages with instances of every kind, each with places apart: what they share is defined in another way in each."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from pxr import Gf, Sdf, Usd, UsdGeom

from tests.support.usd_stages import cloth_stage, define_cloth, skinned_stage


def instance(stage: Usd.Stage, path: str, file: str = "", prim: str = "", shift: float = 0.0) -> Usd.Prim:
    made = UsdGeom.Xform.Define(stage, path).GetPrim()
    made.GetReferences().AddReference(file, prim) if prim else made.GetReferences().AddReference(file)
    made.SetInstanceable(True)
    _move(made, shift)
    return made


def _move(prim: Usd.Prim, shift: float) -> None:
    if shift:
        UsdGeom.Xformable(prim).AddTranslateOp().Set(Gf.Vec3d(shift, 0, 0))


def _set(path: Path) -> Usd.Stage:
    stage = Usd.Stage.CreateNew(str(path))
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/Set").GetPrim())
    return stage


def of_a_class(path: Path) -> None:
    stage = cloth_stage(path)
    define_cloth(stage, "/Asset/Cloth")
    stage.GetPrimAtPath("/Asset").SetSpecifier(Sdf.SpecifierClass)
    for name, shift in (("First", 5.0), ("Second", 9.0)):
        instance(stage, f"/Root/{name}", "", "/Asset", shift)
    stage.Save()


def inheriting_a_class(path: Path) -> None:
    stage = cloth_stage(path)
    define_cloth(stage, "/_class/Cloth")
    stage.GetPrimAtPath("/_class").SetSpecifier(Sdf.SpecifierClass)
    for name, shift in (("A", 5.0), ("B", 9.0)):
        prim = UsdGeom.Xform.Define(stage, f"/Root/{name}").GetPrim()
        prim.GetInherits().AddInherit("/_class")
        prim.SetInstanceable(True)
        _move(prim, shift)
    stage.Save()


def of_a_prim_that_shows(path: Path) -> None:
    stage = cloth_stage(path)
    UsdGeom.Xform.Define(stage, "/Root/Asset")
    define_cloth(stage, "/Root/Asset/Cloth")
    instance(stage, "/Root/Copy", "", "/Root/Asset", 5.0)
    stage.Save()


def of_another_root(path: Path) -> None:
    stage = cloth_stage(path)
    define_cloth(stage, "/Library/Cloth")
    instance(stage, "/Root/Copy", "", "/Library", 5.0)
    stage.Save()


def of_another_file(path: Path) -> None:
    cloth_stage(path.with_name("tile.usda"))
    stage = _set(path)
    for name, shift in (("First", 5.0), ("Second", 9.0)):
        instance(stage, f"/Set/{name}", "./tile.usda", "", shift)
    stage.Save()


def in_each_other(path: Path) -> None:
    cloth_stage(path.with_name("tile.usda"))
    group = Usd.Stage.CreateNew(str(path.with_name("group.usda")))
    for name, shift in (("Left", 0.0), ("Right", 3.0)):
        instance(group, f"/Group/{name}", "./tile.usda", "", shift)
    group.SetDefaultPrim(group.GetPrimAtPath("/Group"))
    group.Save()
    stage = _set(path)
    for name, shift in (("A", 5.0), ("B", 12.0)):
        instance(stage, f"/Set/{name}", "./group.usda", "", shift)
    instance(stage, "/Set/Single", "./tile.usda")
    stage.Save()


def of_variants(path: Path) -> None:
    stage = _set(path)
    looks = UsdGeom.Xform.Define(stage, "/Set/Thing").GetPrim().GetVariantSets().AddVariantSet("look")
    for name, size in (("coarse", 4), ("fine", 6)):
        looks.AddVariant(name)
        looks.SetVariantSelection(name)
        with looks.GetVariantEditContext():
            define_cloth(stage, "/Set/Thing/Tile", size=size)
    looks.SetVariantSelection("coarse")
    for name, shift in (("Copy1", 5.0), ("Copy2", 9.0)):
        instance(stage, f"/Set/{name}", "", "/Set/Thing", shift).GetVariantSet("look").SetVariantSelection("fine")
    stage.Save()


def of_what_is_inactive(path: Path) -> None:
    stage = cloth_stage(path)
    define_cloth(stage, "/Off/Cloth")
    instance(stage, "/Root/On", "", "/Off", 5.0)
    stage.GetPrimAtPath("/Off").SetActive(False)
    stage.Save()


def meshes_themselves(path: Path) -> None:
    cloth_stage(path.with_name("tile.usda"))
    stage = _set(path)
    for name in ("A", "B"):
        made = stage.DefinePrim(f"/Set/{name}")
        made.GetReferences().AddReference("./tile.usda", "/Root/Cloth")
        made.SetInstanceable(True)
    stage.Save()


def skinned(path: Path) -> None:
    character = skinned_stage(path.with_name("char.usda"))
    character.SetDefaultPrim(character.GetPrimAtPath("/Char"))
    character.Save()
    stage = _set(path)
    for name in ("A", "B"):
        made = stage.DefinePrim(f"/Set/{name}")
        made.GetReferences().AddReference("./char.usda")
        made.SetInstanceable(True)
    stage.Save()


INSTANCES: dict[str, Callable[[Path], None]] = {
    make.__name__: make
    for make in (
        of_a_class, inheriting_a_class, of_a_prim_that_shows, of_another_root, of_another_file, in_each_other,
        of_variants, of_what_is_inactive, meshes_themselves, skinned,
    )
}  # fmt: skip
