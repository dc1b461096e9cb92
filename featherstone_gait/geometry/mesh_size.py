"""Count what a mesh file expands to before its reader takes the memory: DAE and glTF place a part many times.

A branch of the tree of nodes may be placed within others, each of which is placed many times: a file of some kilobytes
can ask for billions of triangles.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Hashable, Iterable, Mapping
from typing import Any
from xml.etree.ElementTree import Element

MAX_INSTANCES = 10_000  # nodes of a file with all repetitions; the reader takes a tenth of a millisecond for each
MAX_TRIANGLES = 5_000_000  # with points, of all instances together
PLACED = ("instance_geometry", "instance_controller")  # in a node of a DAE


def check_dae(root: Element) -> None:
    """Raise ValueError if a DAE has too many instances or triangles, or a node within itself."""
    sizes: dict[str, int] = defaultdict(int)  # of geometries, and of controllers that move them
    for geometry in _all(root, "geometry"):
        numbers = sum(len((part.text or "").split()) for tag in ("float_array", "p") for part in _all(geometry, tag))
        sizes[geometry.get("id", "")] = numbers // 3
    for controller in _all(root, "controller"):
        sizes[controller.get("id", "")] = sum(sizes[_target(part, "source")] for part in controller)
    scenes = _all(root, "visual_scene")
    nodes = [*scenes, *_all(root, "node")]
    by_id = {node.get("id", ""): node for node in nodes}
    inside, own = {}, {}
    for node in nodes:
        linked = (by_id.get(_target(child)) for child in node if tag_of(child) == "instance_node")
        inside[node] = [*(child for child in node if tag_of(child) == "node"), *(x for x in linked if x is not None)]
        placed = [sizes[_target(child)] for child in node if tag_of(child) in PLACED]
        own[node] = (1 + len(placed), sum(placed))
    _check(*_unfolded(scenes, inside, own))


def check_gltf(content: Mapping[str, Any]) -> None:
    """Raise ValueError if a glTF has too many instances or triangles, or a node within itself."""
    nodes, meshes = content.get("nodes", []), content.get("meshes", [])
    counts = [int(accessor["count"]) for accessor in content.get("accessors", [])]
    sizes = [sum(_primitive(part, counts) for part in mesh.get("primitives", [])) for mesh in meshes]
    inside = {k: [int(child) for child in node.get("children", [])] for k, node in enumerate(nodes)}
    own = {k: (1, sizes[int(node["mesh"])] if "mesh" in node else 0) for k, node in enumerate(nodes)}
    named = {child for children in inside.values() for child in children}
    stated = [int(node) for scene in content.get("scenes", []) for node in scene.get("nodes", [])]
    instances, triangles = _unfolded(stated, inside, own)
    rest, others = _unfolded([k for k in inside if k not in named] or [*inside], inside, own)
    _check(max(instances, rest), max(triangles, others, sum(sizes)))


def _primitive(part: Mapping[str, Any], counts: list[int]) -> int:
    """Return points and triangles of a part of a mesh."""
    points = counts[int(part["attributes"]["POSITION"])]
    return points + (counts[int(part["indices"])] if "indices" in part else points) // 3


def _unfolded(
    roots: Iterable[Hashable], inside: Mapping[Any, list[Any]], own: Mapping[Any, tuple[int, int]]
) -> tuple[int, int]:
    """Sum the pairs of numbers over a tree whose branches occur several times."""
    roots, total = list(roots), dict[Hashable, tuple[int, int]]()
    above: set[Hashable] = set()
    waiting = [(root, False) for root in roots]
    while waiting:
        node, complete = waiting.pop()
        if complete:
            parts = [own[node], *(total[child] for child in inside[node])]
            total[node] = (sum(n for n, _ in parts), sum(m for _, m in parts))
            above.discard(node)
        elif node in above:
            raise ValueError("has a node within itself; remove one of the two")
        elif node not in total:
            above.add(node)
            waiting += [(node, True), *((child, False) for child in inside[node])]
    return sum(total[root][0] for root in roots), sum(total[root][1] for root in roots)


def _check(instances: int, triangles: int) -> None:
    if instances > MAX_INSTANCES:
        raise ValueError(f"places {instances} parts; at most {MAX_INSTANCES} are read: join them in fewer")
    if triangles > MAX_TRIANGLES:
        raise ValueError(
            f"has {triangles} points and triangles with all instances; at most {MAX_TRIANGLES} are read: simplify it"
        )


def _all(root: Element, tag: str) -> list[Element]:
    return [element for element in root.iter() if tag_of(element) == tag]


def _target(element: Element, attribute: str = "url") -> str:
    return element.get(attribute, "").removeprefix("#")


def tag_of(element: Element) -> str:
    """Return the tag of an element without its namespace."""
    return str(element.tag).rpartition("}")[2]
