"""Full meshes in a page: what a browser unpacks, the limit of size, and what is drawn."""

import base64
import os
import zlib

import numpy as np
import pytest
from browser import found_in
from pages import data_of

from featherstone_gait import load_robot, show
from featherstone_gait.view.full_mesh import STEPS, packed
from featherstone_gait.view.shown import in_posture
from featherstone_gait.view.visuals import FACES, ROUND, pieces_of, read

INERTIA = '<inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>'
LIMIT = 0.08  # [MB], less than the ball takes


@pytest.fixture(scope="module")
def ball(tmp_path_factory):
    """A ball of 20480 triangles, and a box beside it."""
    trimesh = pytest.importorskip("trimesh")
    folder = tmp_path_factory.mktemp("ball")
    trimesh.creation.icosphere(5, 0.3).export(folder / "ball.stl")
    shapes = '<visual><geometry><mesh filename="ball.stl"/></geometry></visual>'
    shapes += '<visual><origin xyz="0 0 -0.5"/><geometry><box size="0.2 0.2 0.2"/></geometry></visual>'
    file = folder / "ball.urdf"
    file.write_text(f'<robot name="ball"><link name="base">{INERTIA}{shapes}</link></robot>', "utf-8")
    return load_robot(file)


def unpacked(full):
    """Points (n, 3) [m] and triangles (m, 3) of each piece, as the page reads them."""
    data, at, found = zlib.decompress(base64.b64decode(full["data"])), 0, []

    def take(count, width):
        nonlocal at
        planes = np.frombuffer(data, np.uint8, count * width, at).reshape(width, count).astype(np.uint64)
        at += count * width
        return sum(plane << np.uint64(8 * k) for k, plane in enumerate(planes)).astype(np.int64)

    for piece in full["pieces"]:
        steps = np.cumsum(take(3 * piece["points"], 2).reshape(3, -1), axis=1) % 65536
        corners = np.cumsum(take(3 * piece["triangles"], 4)) % 2**32
        found.append((np.array(piece["low"]) + np.array(piece["size"]) * steps.T / STEPS, corners.reshape(-1, 3)))
    assert at == len(data)
    return found


def test_packed_triangles_are_those_of_the_file_to_the_step_of_its_box(ball):
    pieces = pieces_of(read(ball, ROUND), 10**6)
    for piece, (points, triangles) in zip(pieces, unpacked(packed(pieces, ["base"])), strict=True):
        want, got = piece.points[piece.triangles], points[triangles]
        assert got.shape == want.shape
        assert np.abs(got - want).max() <= 0.51 * np.ptp(piece.points, axis=0).max() / STEPS
    assert sum(len(piece.triangles) for piece in pieces) == 20480 + 12


def test_meshes_are_full_up_to_the_limit_and_one_note_says_what_was_simplified(ball, tmp_path):
    sizes, counts = [], []
    for limit in (4.0, LIMIT, 0.0):
        page = show(in_posture(ball), ball, path=tmp_path / "page.html", mesh_limit=limit)
        (model,) = data_of(page.html)["models"]
        full, notes = model["full"], data_of(page.html)["notes"]
        sizes.append(0 if full is None else len(full["data"]))
        counts.append(0 if full is None else sum(piece["triangles"] for piece in full["pieces"]))
        assert len(notes) == (limit == LIMIT)
        assert limit != LIMIT or "20480" in notes[0]
        assert sum(len(body["faces"]) for body in model["bodies"]) <= FACES + 6
    assert counts[0] == 20492
    assert FACES < counts[1] < 20480
    assert counts[2] == 0
    assert sizes[1] <= 1e6 * LIMIT < sizes[0] < 1e6
    with pytest.raises(ValueError, match="mesh_limit"):
        show(in_posture(ball), ball, path=tmp_path / "page.html", mesh_limit=-1.0)


LOOK = """
const c = document.querySelector("#views canvas"), seen = () => {
  const copy = document.createElement("canvas"), g = copy.getContext("2d", {willReadFrequently: true});
  viewer.show();
  copy.width = c.width; copy.height = c.height; g.drawImage(c, 0, 0);
  return g.getImageData(0, 0, c.width, c.height).data;
};
if (!window.WebGL2RenderingContext || !gl) return "no WebGL";
const full = models[0].full;
return unpack(full).then(({vertices, order}) => {
  let far = 0, turned = 0;
  const steps = new Uint16Array(vertices.buffer);
  const first = full.pieces[0].points, piece = full.pieces[1];  // after the box
  for (let i = 0; i < piece.points; i++) {
    const at = 6 * (first + i), p = [0, 1, 2].map(k => piece.low[k] + piece.size[k] * steps[at + k] / 65535);
    far = Math.max(far, Math.abs(Math.hypot(...p) - 0.3));
    const along = [0, 1, 2].reduce((s, k) => s + p[k] * vertices[at + 3 + k], 0) / 0.3 / 32767;
    turned = Math.max(turned, Math.abs(1 - along));
  }
  return prepare(models[0]).then(() => {
    const fine = seen(); viewer.shown.meshes = false; const coarse = seen();
    let changed = 0, apart = 0;
    for (let k = 0; k < fine.length; k += 4) {
      const by = [k, k + 1, k + 2].reduce((s, j) => s + Math.abs(fine[j] - coarse[j]), 0);
      changed += by > 0; apart += by > 120;
    }
    return {far, turned, changed: 4 * changed / fine.length, apart: 4 * apart / fine.length};
  });
});
"""


def test_the_browser_draws_the_ball_that_was_packed(ball, tmp_path):
    page = show(in_posture(ball), ball, path=tmp_path / "page.html")
    flags = ("--enable-unsafe-swiftshader", "--use-angle=swiftshader")
    (found,), console = found_in(page.html, LOOK, tmp_path, *flags)
    assert [line for line in console if "GL Driver Message" not in line] == []  # of the copy that is read
    if found == "no WebGL":
        assert "FEATHERSTONE_GAIT_BROWSER" not in os.environ, "the browser that was asked for has no WebGL"
        pytest.skip("this browser has no WebGL, not even in software; .ci/run's Chromium has, and fails without")
    assert found["far"] < 1e-5  # [m]
    assert found["turned"] < 1e-3
    assert 0.01 < found["changed"] < 0.5  # of the picture: the ball in both is in one place
    assert found["apart"] < 0.004
