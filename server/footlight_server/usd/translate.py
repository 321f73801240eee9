"""Walks a stage and hands what it finds to a SceneSink; the report says what was assumed and what was left out."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from pxr import Gf, Tf, Usd, UsdGeom, UsdShade

from footlight_server.usd.context import Context, Group, GroupLight, LoadImage, Part, Subdivide
from footlight_server.usd.diagnostics import plain_diagnostics
from footlight_server.usd.errors import StageLimitError, StageMalformedError
from footlight_server.usd.open import OpenedStage, check_layers, reason_of
from footlight_server.usd.placement import place, union
from footlight_server.usd.prims.camera import find_camera, frame_camera, leave_out_clipped, set_camera
from footlight_server.usd.prims.gprims import SHAPE_TYPES, translate_shape
from footlight_server.usd.prims.instances import read_placements
from footlight_server.usd.prims.lights import add_white_dome, is_light, translate_light
from footlight_server.usd.prims.materials import Looks
from footlight_server.usd.prims.mesh import translate_mesh
from footlight_server.usd.prims.settings import ImageSettings, read_settings
from footlight_server.usd.report import EffectHint, Report
from footlight_server.usd.request import TranslateRequest
from footlight_server.usd.sink import Doubles, SceneSink
from footlight_server.usd.values import BadValueError, to_matrix, why_singular

DEFAULT_SIZE = (1280, 720)
_DEFAULT_PURPOSES = ("default", "render")
_MAX_NESTING = 64  # of instances in instances

# From a geometry prim to (mesh id, transform from mesh to prim or None).
_GEOMETRY: dict[str, Callable[[Context, Any], Any]] = {"Mesh": translate_mesh}
_GEOMETRY.update(dict.fromkeys(SHAPE_TYPES, translate_shape))
_SHOWN = Usd.PrimIsActive & Usd.PrimIsLoaded & ~Usd.PrimIsAbstract & Usd.PrimHasDefiningSpecifier
_IDENTITY = Gf.Matrix4d(1.0)
_CHILDREN = Usd.TraverseInstanceProxies(_SHOWN)
_CARRIERS = ("SkelRoot", "Skeleton")  # they have bounds, and nothing to draw
_DRAW_MODES = ("origin", "bounds", "cards")
# What a prototype's geometry takes over from above it, besides its place.
_INHERITED = ("displayColor", "displayOpacity")


@dataclass(frozen=True, slots=True)
class _Place:
    """What a prim takes over from its ancestors: its group, its parent's place there, and the purpose."""

    group: Group
    parent: Doubles
    purpose: str


def translate(
    opened: OpenedStage,
    sink: SceneSink,
    request: TranslateRequest,
    *,
    load_image: LoadImage | None = None,
    subdivide: Subdivide | None = None,
) -> Report:
    """Hands the stage to the sink: camera, materials, meshes, instances, lights.

    Args:
        opened: the stage.
        sink: receives the scene.
        request: what to translate.
        load_image: reads the textures of domes; None leaves such domes out.
        subdivide: footlight_core.subdivide if None.

    Raises:
        CameraError: the camera asked for is missing or unusable.
        StageLimitError: the stage is beyond the request's budget.
        StageMalformedError: a file of the stage turns out to be damaged while it is read.
        StageUnreadableError: a file that is used outside the roots.
    """
    try:
        with plain_diagnostics(request.roots):
            report = _translate(opened, sink, request, load_image, subdivide)
        if request.roots:
            check_layers(opened.stage, request.roots)
    except Tf.ErrorException as error:
        raise StageMalformedError(
            f"{opened.stage.GetRootLayer().identifier}: {reason_of(error, request.roots)}"
        ) from None
    return report


def _translate(
    opened: OpenedStage,
    sink: SceneSink,
    request: TranslateRequest,
    load_image: LoadImage | None,
    subdivide: Subdivide | None,
) -> Report:
    stage = opened.stage
    report = Report(
        time_code=_time_code(stage, request),
        up_axis=str(UsdGeom.GetStageUpAxis(stage)),
        meters_per_unit=float(UsdGeom.GetStageMetersPerUnit(stage)),
    )
    time = Usd.TimeCode(report.time_code)
    for error in opened.composition_errors:
        report.leave_out("", "composition", error)
    settings = read_settings(stage, time, report)
    report.settings = settings.path
    report.width, report.height = request.size or settings.resolution or DEFAULT_SIZE
    if 0 < request.budget.pixels < report.width * report.height:
        size = f"{report.width} x {report.height}"
        raise StageLimitError(f"{settings.path}: {size} pixels, allowed are {request.budget.pixels} in all")
    purposes = set(_DEFAULT_PURPOSES if settings.purposes is None else (*settings.purposes, "default"))
    report.purposes = tuple(sorted(purposes if request.purposes is None else {*request.purposes, "default"}))
    material_purpose = request.material_purpose if request.material_purpose is not None else settings.material_purpose
    ctx = Context(
        stage=stage,
        sink=sink,
        report=report,
        request=request,
        time=time,
        looks=Looks(sink, report, time, UsdShade.Tokens.full if material_purpose is None else material_purpose),
        load_image=load_image,
        subdivide=subdivide or _core_subdivide(),
    )
    _Walk(ctx).run(settings)
    report.effects = [EffectHint("subdivision", why, tuple(paths)) for why, paths in ctx.refined.items()]
    report.finish()
    return report


def _core_subdivide() -> Subdivide:
    from footlight_core import subdivide

    function: Subdivide = subdivide
    return function


def _time_code(stage: Any, request: TranslateRequest) -> float:
    if request.time_code is not None:
        return request.time_code
    return float(stage.GetStartTimeCode()) if stage.HasAuthoredTimeCodeRange() else 0.0


class _Walk:
    """One pass over the stage; prototypes are walked once for everything they inherit."""

    def __init__(self, ctx: Context) -> None:
        self._ctx = ctx
        self._world = Group("/")
        self._prototypes: dict[tuple[object, ...], Group] = {}
        self._open: list[tuple[object, ...]] = []  # keys of the prototypes being walked
        self._bindings: dict[str, tuple[str, ...]] = {}  # path of a prim -> bindings on it and above
        self._lights_seen = 0
        self._other_purposes = 0

    def run(self, settings: ImageSettings) -> None:
        ctx = self._ctx
        camera = find_camera(ctx.stage, ctx.request.camera, settings, ctx)
        self._walk(
            list(ctx.stage.GetPseudoRoot().GetFilteredChildren(_CHILDREN)), _Place(self._world, np.eye(4), "default")
        )
        placed = place(ctx, self._world)
        if not placed:
            ctx.report.note("", "the stage has no geometry that can be rendered")
        if camera:
            world = to_matrix(UsdGeom.Xformable(camera).ComputeLocalToWorldTransform(ctx.time))
            seen = set_camera(ctx, camera, settings, world)
            leave_out_clipped(ctx, camera, world, seen, placed)
        else:
            frame_camera(ctx, settings, union([box for _, box in placed]))
        if not self._lights_seen and not ctx.looks.has_emission:
            add_white_dome(ctx)
        if self._other_purposes:
            shown = ", ".join(ctx.report.purposes)
            ctx.report.note("", f"{self._other_purposes} prims have another purpose than {shown}")

    def _walk(self, roots: list[Any], place_of_roots: _Place) -> None:
        """Depth first in the order of the stage, without recursion: real hierarchies are deep."""
        stack = [(prim, place_of_roots) for prim in reversed(roots)]
        while stack:
            prim, parent = stack.pop()
            self._ctx.count("prims", 1, prim.GetPath())
            here = self._visit(prim, parent)
            if here is not None:
                stack += [(child, here) for child in reversed(prim.GetFilteredChildren(_CHILDREN))]

    def _visit(self, prim: Any, parent: _Place) -> _Place | None:
        """Translates one prim; the place its children start from, None if they are not to be visited."""
        ctx = self._ctx
        imageable = UsdGeom.Imageable(prim)
        if not imageable:
            return self._visit_other(prim, parent)
        if str(imageable.GetVisibilityAttr().Get(ctx.time)) == "invisible":
            return None
        here = self._enter(prim, parent)
        if here is None:
            return None
        if here.purpose in ctx.report.purposes:
            if prim.IsA(UsdGeom.PointInstancer):
                self._visit_instancer(prim, here)
                return None
            self._visit_contents(prim, here)
        elif prim.IsA(UsdGeom.Boundable):
            self._other_purposes += 1
        if prim.IsInstance():
            self._visit_instance(prim, here)
            return None
        return here

    def _visit_other(self, prim: Any, parent: _Place) -> _Place | None:
        """A prim that is no Imageable: materials and the like are not entered, unknown types are reported."""
        if prim.IsA(UsdShade.Material) or prim.IsA(UsdShade.NodeGraph) or prim.IsA(UsdShade.Shader):
            return None
        name = str(prim.GetTypeName())
        if name and not Usd.SchemaRegistry().FindConcretePrimDefinition(name):
            self._ctx.report.leave_out(prim.GetPath(), name, "no schema of that name is known")
        if prim.IsInstance():
            self._visit_instance(prim, parent)
            return None
        return parent

    def _enter(self, prim: Any, parent: _Place) -> _Place | None:
        """The prim's own place; None if it cannot be placed."""
        ctx = self._ctx
        purpose = UsdGeom.Imageable(prim).GetPurposeAttr()
        here = parent
        if purpose.HasAuthoredValue():
            here = _Place(parent.group, parent.parent, str(purpose.Get(ctx.time)))
        xformable = UsdGeom.Xformable(prim)
        if not xformable:
            return here
        value = xformable.GetLocalTransformation(ctx.time)
        resets = xformable.GetResetXformStack()
        if value == _IDENTITY and not resets:
            return here
        local = to_matrix(value)
        if singular := why_singular(local):
            ctx.report.leave_out(prim.GetPath(), str(prim.GetTypeName()), f"{singular}: it and all below it")
            return None
        if resets:
            return _Place(self._world, local, here.purpose)
        return _Place(here.group, local @ here.parent, here.purpose)

    def _visit_contents(self, prim: Any, here: _Place) -> None:
        ctx = self._ctx
        name = str(prim.GetTypeName())
        geometry = _GEOMETRY.get(name)
        if geometry is not None:
            for mesh, local in geometry(ctx, prim):
                matrix = here.parent if local is None else local @ here.parent
                here.group.parts.append(Part(mesh, str(prim.GetPath()), np.ascontiguousarray(matrix)))
        if is_light(prim):
            self._lights_seen += 1
            add = translate_light(ctx, prim)
            if add is not None:
                here.group.lights.append(GroupLight(str(prim.GetPath()), here.parent, add))
        elif geometry is None and prim.IsA(UsdGeom.Boundable) and name not in _CARRIERS:
            ctx.report.leave_out(prim.GetPath(), name, "no geometry of that type can be rendered")
        if prim.HasRelationship("skel:skeleton"):
            ctx.report.leave_out(prim.GetPath(), "skel:skeleton", "skinning is not rendered, the points stay put")
        draw_mode = prim.GetAttribute("model:drawMode")
        if draw_mode and draw_mode.Get(ctx.time) in _DRAW_MODES:
            ctx.report.leave_out(prim.GetPath(), "model:drawMode", "stand-ins are not drawn, the geometry itself is")

    def _visit_instance(self, prim: Any, here: _Place) -> None:
        """A native instance: its prototype, walked under the first instance that inherits the same."""
        children = prim.GetFilteredChildren(_CHILDREN)
        if not children:
            return
        key = (str(prim.GetPrototype().GetPath()), here.purpose, *self._inherited(prim))
        self._place_prototype(key, children, str(prim.GetPath()), here, here.parent[None])

    def _visit_instancer(self, prim: Any, here: _Place) -> None:
        ctx = self._ctx
        try:
            placements = read_placements(ctx, prim)
        except BadValueError as error:
            ctx.report.leave_out(prim.GetPath(), "PointInstancer", str(error))
            return
        self._leave_out_instance_primvars(prim)
        for path, transforms in placements:
            prototype = ctx.stage.GetPrimAtPath(path)
            if not prototype:
                ctx.report.leave_out(prim.GetPath(), "prototypes", f"{path} is not on the stage")
            elif len(transforms):
                key = (str(path), here.purpose)
                self._place_prototype(key, [prototype], str(path), here, transforms @ here.parent)

    def _place_prototype(
        self, key: tuple[object, ...], roots: list[Any], path: str, here: _Place, transforms: Doubles
    ) -> None:
        ctx = self._ctx
        if key in self._open:
            ctx.report.leave_out(path, "prototype", "is placed inside itself")
            return
        if len(self._open) >= _MAX_NESTING:
            raise StageLimitError(f"{path}: instances are nested more than {_MAX_NESTING} deep", path)
        group = self._prototypes.get(key)
        if group is None:
            group = Group(path)
            self._prototypes[key] = group
            self._open.append(key)
            self._walk(roots, _Place(group, np.eye(4), here.purpose))
            self._open.pop()
        if not group.is_empty:
            here.group.children.append((group, np.ascontiguousarray(transforms)))

    def _inherited(self, prim: Any) -> tuple[object, ...]:
        """What makes instances of one prototype differ: primvars and material bindings that it takes over."""
        values: list[object] = []
        api = UsdGeom.PrimvarsAPI(prim)
        for name in _INHERITED:
            primvar = api.FindPrimvarWithInheritance(name)
            values.append(str(primvar.Get(self._ctx.time)) if primvar and primvar.HasValue() else None)
        bindings = self._bindings_at(prim)
        if any(name.startswith("material:binding:collection") for name in bindings):
            values.append(str(prim.GetPath()))  # a collection may name what is inside this very instance
        elif bindings:
            values.append(self._ctx.looks.bound_path(prim))
        return tuple(values)

    def _bindings_at(self, prim: Any) -> tuple[str, ...]:
        """Names of the material bindings authored on the prim and above it."""
        if prim.IsPseudoRoot():
            return ()
        parent = prim.GetParent()
        path = str(parent.GetPath())
        above = self._bindings.get(path)
        if above is None:
            above = self._bindings_at(parent)
            self._bindings[path] = above
        own = [str(found.GetName()) for found in prim.GetAuthoredPropertiesInNamespace("material")]
        return (*above, *(name for name in own if name.startswith("material:binding")))

    def _leave_out_instance_primvars(self, prim: Any) -> None:
        for name in _INHERITED:
            primvar = UsdGeom.PrimvarsAPI(prim).GetPrimvar(name)
            if primvar and primvar.HasValue() and str(primvar.GetInterpolation()) != "constant":
                self._ctx.report.leave_out(
                    prim.GetPath(), f"primvars:{name}", "colours per instance of a PointInstancer are not rendered yet"
                )
