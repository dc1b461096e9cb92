"""Pack the triangles of a robot's meshes for a page, in full or simplified to a limit of size.

Points are whole numbers, 1/65535 of the box of their piece.  Points and corners of triangles are differences from the
one before, by planes of bytes, lowest first, and deflated (RFC 1950), which leaves about ten bytes a triangle.
"""

from __future__ import annotations

import base64
import zlib
from collections.abc import Sequence
from typing import Any

import numpy as np

from .visuals import Piece, Read, pieces_of

STEPS = 65535  # along each edge of the box of a piece
FEWER = 0.9  # of the triangles that would just fit
PASSES = 8  # of simplifying more and more, until a limit is met


def full_meshes(read: Read, links: Sequence[str], coarse: int, limit: float) -> tuple[dict[str, Any] | None, str]:
    """Pack the meshes of a robot to at most `limit` bytes; return them, and a note if they had to be simplified for it.

    None where the page has as much anyway, which shows up to `coarse` triangles.
    """
    total = most = read.triangles
    if total <= coarse or not limit > 0:
        return None, ""
    found: dict[str, Any] | None = None
    first = 0  # the size of all
    for _ in range(PASSES):
        pieces = pieces_of(read, most)
        tried = packed(pieces, links)
        size, left = len(tried["data"]), sum(len(piece.triangles) for piece in pieces)
        first = first or size
        if size <= limit:
            found = tried
            break
        most = int(FEWER * most * limit / size)
        if most <= coarse:
            break
    if most == total:
        return found, ""
    left = left if found else coarse
    had = f"{read.source}: meshes of {total} triangles, {first / 1e6:.2g} MB, are simplified to {left}"
    return found, f"{had}: mesh_limit is {limit / 1e6:.2g} MB"


def packed(pieces: Sequence[Piece], links: Sequence[str]) -> dict[str, Any]:
    """Pack pieces, each on one of some links: their numbers in one text, and what belongs to each."""
    described, numbers = [], []
    for piece in pieces:
        corners = piece.triangles.reshape(-1)
        used, first = np.unique(corners, return_index=True)
        order = used[np.argsort(first)]  # as the triangles come to them
        place = np.zeros(len(piece.points), np.int64)
        place[order] = np.arange(len(order))
        points = piece.points[order]
        low, size = points.min(axis=0), np.maximum(np.ptp(points, axis=0), 1e-9)
        steps = np.round(STEPS * (points - low) / size).astype(np.int64)
        numbers += [_planes(np.diff(steps, axis=0, prepend=0), 2), _planes(np.diff(place[corners], prepend=0), 4)]
        described.append(
            {
                "body": links.index(piece.link),
                "color": list(piece.color),
                "low": [float(f"{x:.7g}") for x in low],
                "size": [float(f"{x:.7g}") for x in size],
                "points": len(order),
                "triangles": len(piece.triangles),
            }
        )
    return {"pieces": described, "data": base64.b64encode(zlib.compress(b"".join(numbers), 6)).decode("ascii")}


def _planes(differences: np.ndarray, width: int) -> bytes:
    """Write whole numbers by planes: the lowest bytes of all, then the next; columns one after the other."""
    flat = np.ascontiguousarray(differences.T).reshape(-1).astype("<i8")
    return np.ascontiguousarray(flat.view(np.uint8).reshape(-1, 8)[:, :width].T).tobytes()
