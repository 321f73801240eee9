"""Materials: UsdPreviewSurface's constants, the material bound to a prim, displayColor where there is none."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from pxr import UsdShade

from footlight_server.usd.report import Report
from footlight_server.usd.sink import Rgb, SceneSink
from footlight_server.usd.values import BadValueError, read_color, read_number

_READERS = {"UsdPrimvarReader_float3": "displayColor", "UsdPrimvarReader_float": "displayOpacity"}
# Inputs that would change the image if they were connected, and are not used yet.
_UNUSED = ("normal", "displacement", "occlusion")


@dataclass(frozen=True, slots=True)
class Look:
    """A material of the scene, and what it reads from the mesh."""

    id: int
    reads_color: bool
    reads_opacity: bool
    opacity_threshold: float = 0.0
    is_emissive: bool = False


@dataclass(slots=True)
class Surface:
    """The arguments of SceneSink.add_material, with UsdPreviewSurface's defaults."""

    diffuse_color: Rgb = (0.18, 0.18, 0.18)
    diffuse_from_primvar: bool = False
    metallic: float = 0.0
    roughness: float = 0.5
    ior: float = 1.5
    specular_color: Rgb = (0.0, 0.0, 0.0)
    use_specular_workflow: bool = False
    clearcoat: float = 0.0
    clearcoat_roughness: float = 0.01
    emissive_color: Rgb = (0.0, 0.0, 0.0)
    opacity: float = 1.0
    opacity_from_primvar: bool = False

    def add_to(self, sink: SceneSink, path: str) -> int:
        """The id of the new material."""
        return sink.add_material(
            path=path,
            diffuse_color=self.diffuse_color,
            diffuse_from_primvar=self.diffuse_from_primvar,
            metallic=self.metallic,
            roughness=self.roughness,
            ior=self.ior,
            specular_color=self.specular_color,
            use_specular_workflow=self.use_specular_workflow,
            clearcoat=self.clearcoat,
            clearcoat_roughness=self.clearcoat_roughness,
            emissive_color=self.emissive_color,
            opacity=self.opacity,
            opacity_from_primvar=self.opacity_from_primvar,
        )


@dataclass(slots=True)
class Looks:
    """The looks of a scene, made when first asked for."""

    sink: SceneSink
    report: Report
    time: Any
    purpose: str
    has_emission: bool = False  # of a material that is on some mesh
    _by_path: dict[str, Look] = field(default_factory=dict)

    def of_prim(self, prim: Any) -> Look:
        """The look bound to a geometry prim or GeomSubset, for the purpose or, failing that, for all purposes."""
        material, _ = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial(self.purpose)
        look = self._bound_look(material) if material else self.unbound()
        self.has_emission |= look.is_emissive
        return look

    def bound_path(self, prim: Any) -> str:
        """Path of the material that the prim passes on to its descendants; empty without one."""
        material, _ = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial(self.purpose)
        return str(material.GetPath()) if material else ""

    def unbound(self) -> Look:
        """The primvars displayColor and displayOpacity on a plain diffuse surface."""
        return self._cached("", self._add_unbound)

    def _bound_look(self, material: Any) -> Look:
        return self._cached(str(material.GetPath()), lambda: self._translate(material))

    def _cached(self, path: str, make: Callable[[], Look]) -> Look:
        look = self._by_path.get(path)
        if look is None:
            look = make()
            self._by_path[path] = look
        return look

    def _translate(self, material: Any) -> Look:
        path = str(material.GetPath())
        shader = material.ComputeSurfaceSource()[0]
        if not shader:
            outputs = [output.GetBaseName() for output in material.GetSurfaceOutputs()]
            detail = f"; it has {', '.join(outputs)}" if any(o != "surface" for o in outputs) else ""
            self.report.leave_out(path, "Material", f"no surface shader of the universal render context{detail}")
            return self.unbound()
        name = shader.GetIdAttr().Get() or shader.GetImplementationSource()
        if name != "UsdPreviewSurface":
            self.report.leave_out(path, "Material", f"unknown shader {name} ({shader.GetPath()})")
            return self.unbound()
        return self._translate_preview_surface(path, shader)

    def _translate_preview_surface(self, path: str, shader: Any) -> Look:
        reader = _Inputs(shader, self.report, self.time)
        surface = Surface(
            diffuse_color=reader.color("diffuseColor", (0.18, 0.18, 0.18), reads="displayColor"),
            emissive_color=reader.color("emissiveColor", (0.0, 0.0, 0.0)),
            use_specular_workflow=reader.number("useSpecularWorkflow", 0.0, 0.0, 1.0) != 0,
            specular_color=reader.color("specularColor", (0.0, 0.0, 0.0)),
            metallic=reader.number("metallic", 0.0, 0.0, 1.0),
            roughness=reader.number("roughness", 0.5, 0.0, 1.0),
            clearcoat=reader.number("clearcoat", 0.0, 0.0, 1.0),
            clearcoat_roughness=reader.number("clearcoatRoughness", 0.01, 0.0, 1.0),
            ior=reader.number("ior", 1.5, 1e-3, 1e3),
            opacity=reader.number("opacity", 1.0, 0.0, 1.0, reads="displayOpacity"),
        )
        threshold = reader.number("opacityThreshold", 0.0, 0.0, 1.0)
        surface.diffuse_from_primvar = "displayColor" in reader.primvars
        surface.opacity_from_primvar = "displayOpacity" in reader.primvars
        if threshold > 0:
            surface.opacity = 1.0 if surface.opacity >= threshold else 0.0
        for unused in _UNUSED:
            reader.leave_out_connection(unused)
        try:
            look_id = surface.add_to(self.sink, path)
        except ValueError as error:
            self.report.leave_out(path, "Material", str(error))
            return self.unbound()
        self.report.counts["materials"] += 1
        return Look(
            look_id,
            reads_color=surface.diffuse_from_primvar,
            reads_opacity=surface.opacity_from_primvar,
            opacity_threshold=threshold,
            is_emissive=any(c > 0 for c in surface.emissive_color),
        )

    def _add_unbound(self) -> Look:
        self.report.assume("displayColor", "some geometry has no material that can be used; it gets a diffuse one")
        self.report.counts["materials"] += 1
        # Diffuse only: the specular workflow with a black specular colour reflects nothing.
        surface = Surface(
            use_specular_workflow=True, roughness=1.0, diffuse_from_primvar=True, opacity_from_primvar=True
        )
        return Look(surface.add_to(self.sink, ""), reads_color=True, reads_opacity=True)


@dataclass(slots=True)
class _Inputs:
    """A shader's inputs: constants, or a primvar reader where that is allowed; anything else is reported."""

    shader: Any
    report: Report
    time: Any
    primvars: set[str] = field(default_factory=set)

    def color(self, name: str, default: Rgb, reads: str = "") -> Rgb:
        attribute = self._constant(name, reads)
        try:
            value = read_color(attribute, self.time, default)
        except BadValueError as error:
            self.report.leave_out(self.shader.GetPath(), f"inputs:{name}", str(error))
            return default
        if min(value) < 0:
            self.report.leave_out(self.shader.GetPath(), f"inputs:{name}", f"{value} is negative, 0 is used there")
        return max(value[0], 0.0), max(value[1], 0.0), max(value[2], 0.0)

    def number(self, name: str, default: float, low: float, high: float, reads: str = "") -> float:
        attribute = self._constant(name, reads)
        try:
            value = read_number(attribute, self.time, default)
        except BadValueError as error:
            self.report.leave_out(self.shader.GetPath(), f"inputs:{name}", str(error))
            return default
        if not low <= value <= high:
            nearest = min(max(value, low), high)
            reason = f"{value:g} is outside [{low:g}, {high:g}], {nearest:g} is used"
            self.report.leave_out(self.shader.GetPath(), f"inputs:{name}", reason)
            return nearest
        return value

    def leave_out_connection(self, name: str) -> None:
        """Reports an input that is connected to something."""
        shader_input = self.shader.GetInput(name)
        if shader_input and shader_input.HasConnectedSource():
            self.report.leave_out(self.shader.GetPath(), f"inputs:{name}", "is not rendered yet")

    def _constant(self, name: str, reads: str) -> Any:
        """The attribute that holds the value, None for the default; follows connections to interface inputs."""
        shader_input = self.shader.GetInput(name)
        if not shader_input:
            return None
        producers = shader_input.GetValueProducingAttributes()
        if not producers:
            return None
        attribute = producers[0]
        if UsdShade.Utils.GetType(attribute.GetName()) != UsdShade.AttributeType.Output:
            return attribute
        source = UsdShade.Shader(attribute.GetPrim())
        kind = str(source.GetIdAttr().Get() or "an unknown shader") if source else "an unknown node"
        if reads and _READERS.get(kind) == reads:
            if self._is_reader_of(source, reads):
                self.primvars.add(reads)
                fallback = source.GetInput("fallback")
                return fallback.GetAttr() if fallback else None
            kind = f"{kind} of another primvar than {reads}"
        self.report.leave_out(
            self.shader.GetPath(), f"inputs:{name}", f"connected to {kind} ({source.GetPath()}), which is not read yet"
        )
        return None

    def _is_reader_of(self, reader: Any, primvar: str) -> bool:
        varname = reader.GetInput("varname")
        producers = varname.GetValueProducingAttributes() if varname else []
        return bool(producers) and str(producers[0].Get(self.time)) == primvar
