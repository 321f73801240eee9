"""From groups of groups to what the sink wants: every prototype with all its places in the world."""

import numpy as np

from footlight_server.usd.context import Context, Group, Part
from footlight_server.usd.sink import Doubles
from footlight_server.usd.values import determinants

# An implicit shape that appears this often in the world is instanced; below, copies are cheaper than a second level.
_SHARED = 8


def place(ctx: Context, root: Group) -> list[tuple[str, Doubles]]:
    """Hands all instances and lights to the sink; (path, bounds (2, 3)) of everything placed in the world."""
    bounds: list[tuple[str, Doubles]] = []
    places: dict[int, list[Doubles]] = {id(root): [np.eye(4)[None]]}
    groups = _parents_first(root)
    _check_instances(ctx, groups)
    for group in groups:
        world = places.pop(id(group))
        transforms = world[0] if len(world) == 1 else np.concatenate(world)
        if group is root:
            _place_world(ctx, root)
        else:
            transforms = _usable(ctx, group, transforms)
            _place_prototype(ctx, group, transforms)
        _place_lights(ctx, group, transforms)
        bounds += _bounds(ctx, group, transforms)
        for child, local in group.children:
            ctx.count("instances", len(local) * len(transforms), child.path)
            nested = (local[None, :] @ transforms[:, None]).reshape(-1, 4, 4)
            places.setdefault(id(child), []).append(nested)
    return bounds


def _check_instances(ctx: Context, groups: list[Group]) -> None:
    """Raises StageLimitError before a place is made for what is too much: ten groups can mean 10^10 places."""
    total = 0
    counts = dict.fromkeys(map(id, groups), 0)
    counts[id(groups[0])] = 1
    for group in groups:
        for child, local in group.children:
            placed = counts[id(group)] * len(local)
            counts[id(child)] += placed
            total += placed
            ctx.check("instances", total, child.path)


def union(boxes: list[Doubles]) -> Doubles | None:
    """The box (2, 3) around boxes; None around nothing."""
    if not boxes:
        return None
    corners = np.array(boxes)
    return np.stack([corners[:, 0].min(axis=0), corners[:, 1].max(axis=0)])


def _parents_first(root: Group) -> list[Group]:
    """Every group once, after all groups it is placed in. The order follows the stage."""
    order: list[Group] = []
    seen: set[int] = set()

    def visit(group: Group) -> None:  # as deep as instances are nested, which translate.py limits
        seen.add(id(group))
        for child, _ in reversed(group.children):
            if id(child) not in seen:
                visit(child)
        order.append(group)

    visit(root)
    return order[::-1]


def _usable(ctx: Context, group: Group, transforms: Doubles) -> Doubles:
    good = np.isfinite(transforms).all(axis=(1, 2)) & (determinants(transforms) != 0)
    bad = int(good.size - np.count_nonzero(good))
    if not bad:
        return np.ascontiguousarray(transforms)
    ctx.report.leave_out(
        group.path,
        "instances",
        f"{bad} of {good.size} have a transform in the world that is singular or not finite, "
        f"the first is {int(np.argmin(good))}",
    )
    return np.ascontiguousarray(transforms[good])


def _place_world(ctx: Context, root: Group) -> None:
    by_mesh: dict[int, list[Part]] = {}
    for part in root.parts:
        by_mesh.setdefault(part.mesh, []).append(part)
    identity = np.eye(4)[None]
    for mesh, parts in by_mesh.items():
        transforms = np.stack([part.transform for part in parts])
        if len(parts) >= _SHARED:
            _add_instances(ctx, parts[0].path, [mesh], identity, transforms)
            continue
        for part, transform in zip(parts, transforms, strict=True):
            _add_instances(ctx, part.path, [mesh], identity, transform[None])


def _place_prototype(ctx: Context, group: Group, transforms: Doubles) -> None:
    if group.parts and len(transforms):
        local = np.stack([part.transform for part in group.parts])
        _add_instances(ctx, group.path, [part.mesh for part in group.parts], local, transforms)


def _add_instances(ctx: Context, path: str, meshes: list[int], local: Doubles, transforms: Doubles) -> None:
    try:
        ctx.sink.add_instances(
            path=path, meshes=meshes, local_transforms=local, transforms=transforms, visible_to_camera=True
        )
    except ValueError as error:
        ctx.report.leave_out(path, "instances", str(error))


def _place_lights(ctx: Context, group: Group, transforms: Doubles) -> None:
    for light in group.lights:
        ctx.count("lights", len(transforms), light.path)
        for transform in transforms:
            try:
                reason = light.add(np.ascontiguousarray(light.transform @ transform))
            except ValueError as error:
                reason = str(error)
            if reason:
                ctx.report.counts["lights"] -= 1
                ctx.report.leave_out(light.path, "light", reason)


def _bounds(ctx: Context, group: Group, transforms: Doubles) -> list[tuple[str, Doubles]]:
    """Boxes around the group's own parts: each part of the world, all places of a prototype together."""
    boxes = [_moved_box(ctx.mesh_bounds[part.mesh], part.transform[None]) for part in group.parts]
    if len(transforms) == 1:
        moved = (_moved_box(box, transforms) for box in boxes)
        return [(part.path, box) for part, box in zip(group.parts, moved, strict=True)]
    own = union(boxes)
    return [] if own is None or not len(transforms) else [(group.path, _moved_box(own, transforms))]


def _moved_box(box: np.ndarray, transforms: Doubles) -> Doubles:
    """The box (2, 3) around a box in all its places (Arvo 1990: centre and half extent)."""
    centre, half = box.astype(np.float64).mean(axis=0), (box[1].astype(np.float64) - box[0]) / 2.0
    centres = centre @ transforms[:, :3, :3] + transforms[:, 3, :3]
    halves = half @ np.abs(transforms[:, :3, :3])
    return np.stack([(centres - halves).min(axis=0), (centres + halves).max(axis=0)])
