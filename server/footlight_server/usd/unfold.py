"""How many prims a stage unfolds to, told before USD composes it: a few lines can ask for billions."""

import contextlib
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

from pxr import Sdf, Tf

from footlight_server.usd.errors import StageLimitError

# References in what is referred to: real stages stay below 30.
_MAX_NESTING = 256
# [1] Prims of which several layers speak, or of which another variant is chosen, are counted more than once here. What
# is below this many times the limit is left to the exact count, when the stage is open.
_SLACK = 4

# May a layer be opened: its identifier -> whether it may.
Allowed = Callable[[str], bool]


@dataclass(frozen=True, slots=True)
class _Arc:
    """A reference, payload, inherit or specialize: from a prim to one of a layer stack. `shared`: as an instance."""

    source: str
    layer: Any
    target: str
    shared: bool
    # "" or the variant it stands in, as `/prim{set` and `variant`.
    variant_set: str = ""
    variant: str = ""


@dataclass(slots=True)
class _Stack:
    """A layer with its sublayers: paths of its prims, sorted, and its arcs, sorted by where they start."""

    paths: list[str]
    arcs: list[_Arc]
    sources: list[str] = field(init=False)

    def __post_init__(self) -> None:
        self.arcs.sort(key=lambda arc: arc.source)
        self.sources = [arc.source for arc in self.arcs]

    def at(self, path: str) -> list[_Arc]:
        """Those that start at a prim."""
        return self.arcs[bisect_left(self.sources, path) : bisect_right(self.sources, path)]


class Unfolding:
    """Counts by layer stack and path, each once."""

    def __init__(self, root: Any, most: int, allowed: Allowed) -> None:
        """`root`: the stage's root layer; `most` prims are allowed; `allowed` says which layers may be opened."""
        self._root = root
        self._most = most
        self._allowed = allowed
        self._variables = dict(root.expressionVariables)
        self._stacks: dict[str, _Stack] = {}
        self._counts: dict[tuple[str, str], int] = {}
        self._open: set[tuple[str, str]] = set()
        # Prototypes of instances, to be counted once: by layer and path.
        self._shared: dict[tuple[str, str], _Arc] = {}
        # By identifier; None: may not be or cannot be. They stay open until the stage is, so nothing is read twice.
        self._opened: dict[str, Any] = {root.identifier: root}

    def check(self) -> None:
        """Raises StageLimitError naming the prim whose references unfold to the most."""
        total = self._count(self._root, "/")
        counted: set[tuple[str, str]] = set()
        while todo := [key for key in self._shared if key not in counted]:
            counted.update(todo)
            total += sum(self._count(self._shared[key].layer, key[1]) for key in todo)
        if total > _SLACK * self._most:
            path = self._largest()
            message = f"{path}: what it refers to unfolds to about {total} prims, allowed are {self._most}"
            raise StageLimitError(message, path)

    def _largest(self) -> str:
        arcs = self._stack(self._root).arcs
        best = max(arcs, key=lambda arc: self._count(arc.layer, arc.target), default=None)
        return best.source if best is not None else "/"

    def _count(self, layer: Any, path: str) -> int:
        """Prims at and below a path, with all that they refer to, instances but for their prototypes."""
        key = (layer.identifier, path)
        if key in self._counts:
            return self._counts[key]
        if key in self._open:
            return 0  # a cycle, which USD reports
        if len(self._open) >= _MAX_NESTING:
            raise StageLimitError(f"{path}: references are nested more than {_MAX_NESTING} deep", path)
        self._open.add(key)
        stack = self._stack(layer)
        count = len(stack.paths[slice(*_below(stack.paths, path))])
        by_variant: dict[str, dict[str, int]] = {}
        for arc in stack.arcs[slice(*_below(stack.sources, path))]:
            if arc.shared:
                self._shared.setdefault((arc.layer.identifier, arc.target), arc)
                continue
            # The two roots become one prim.
            unfolded = max(0, self._count(arc.layer, arc.target) - 1)
            of_set = by_variant.setdefault(arc.variant_set, {})
            of_set[arc.variant] = of_set.get(arc.variant, 0) + unfolded
        count += sum(max(of_set.values()) for of_set in by_variant.values())
        # What comes from above: the prim may lie inside of what an ancestor refers to.
        for above in _ancestors(path):
            for arc in stack.at(above):
                count += self._count(arc.layer, arc.target + path[len(above) :])
        self._open.remove(key)
        self._counts[key] = count
        return count

    def _stack(self, layer: Any) -> _Stack:
        stack = self._stacks.get(layer.identifier)
        if stack is None:
            paths: set[str] = set()
            arcs: list[_Arc] = []
            for sublayer in self._sublayers(layer):
                found: list[Any] = []
                sublayer.Traverse(Sdf.Path.absoluteRootPath, found.append)
                for path in found:
                    name = str(path)
                    # Not a property, nor what it is connected to.
                    if "." not in name and name != "/" and (prim := sublayer.GetPrimAtPath(path)):
                        paths.add(str(path.StripAllVariantSelections()) if "{" in name else name)
                        if prim.hasReferences or prim.hasPayloads or prim.hasInheritPaths or prim.hasSpecializes:
                            arcs += self._arcs(layer, sublayer, prim)
            stack = _Stack(sorted(paths), arcs)
            self._stacks[layer.identifier] = stack
        return stack

    def _sublayers(self, root: Any) -> list[Any]:
        """The layer and its sublayers, each once."""
        found = {root.identifier: root}
        todo = [root]
        while todo:
            layer = todo.pop()
            for asset in layer.subLayerPaths:
                sublayer = self._layer(layer, asset)
                if sublayer is not None and sublayer.identifier not in found:
                    found[sublayer.identifier] = sublayer
                    todo.append(sublayer)
        return list(found.values())

    def _arcs(self, root: Any, layer: Any, prim: Any) -> Iterator[_Arc]:
        """Those of one prim spec of a layer in the stack of `root`."""
        files = (prim.referenceList, prim.payloadList)
        classes = (prim.inheritPathList, prim.specializesList)
        targets = [
            (self._layer(layer, item.assetPath) if item.assetPath else root, str(item.primPath))
            for listed in files
            for item in listed.GetAddedOrExplicitItems()
        ]
        targets += [(root, str(path)) for listed in classes for path in listed.GetAddedOrExplicitItems()]
        source, variant_set, variant = str(prim.path.StripAllVariantSelections()), "", ""
        if prim.path.ContainsPrimVariantSelection():
            variant_set, variant = _outermost_variant(prim.path)
        for target, path in targets:
            if target is not None and (path or target.HasDefaultPrim()):
                named = path or str(target.GetDefaultPrimAsPath())
                shared = _is_instance(prim, target.GetPrimAtPath(named))
                yield _Arc(source, target, named, shared, variant_set, variant)

    def _layer(self, anchor: Any, asset: str) -> Any:
        """The layer that `asset` names in the layer `anchor`; None if it cannot or may not be opened."""
        if Sdf.VariableExpression.IsExpression(asset):
            # Those of the root layer are stronger than those of the layers below it.
            variables = {**anchor.expressionVariables, **self._variables}
            asset = str(Sdf.VariableExpression(asset).Evaluate(variables).value or "")
        identifier = anchor.ComputeAbsolutePath(asset) if asset else ""
        if identifier not in self._opened:
            self._opened[identifier] = None
            if identifier and self._allowed(identifier):
                with contextlib.suppress(Tf.ErrorException):  # USD reports it where it is used
                    self._opened[identifier] = Sdf.Layer.FindOrOpen(identifier)
        return self._opened[identifier]


def _is_instance(prim: Any, target: Any) -> bool:
    """What the stronger of the two says."""
    for spec in (prim, target):
        if spec and spec.HasInfo("instanceable"):
            return bool(spec.instanceable)
    return False


def _outermost_variant(path: Any) -> tuple[str, str]:
    """The first variant on a path: its prim and set, and its name."""
    first = next(prefix for prefix in path.GetPrefixes() if prefix.IsPrimVariantSelectionPath())
    name, variant = first.GetVariantSelection()
    return f"{first.GetPrimPath()}{{{name}", variant


def _below(paths: list[str], path: str) -> tuple[int, int]:
    """Where, in sorted paths, those at and below a path begin and end: "/" is the last character before "0"."""
    if path == "/":
        return 0, len(paths)
    return bisect_left(paths, path), bisect_left(paths, path + "0")


def _ancestors(path: str) -> Iterator[str]:
    """Prims above a prim."""
    parts = path.split("/")
    yield from ("/".join(parts[:n]) for n in range(2, len(parts)))
