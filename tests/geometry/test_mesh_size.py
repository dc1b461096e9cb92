"""Small mesh files that expand without bound are refused before a reader takes the memory."""

import base64
import io
import json
import struct

import numpy as np
import pytest

from featherstone_gait.geometry.mesh import WHITE, mesh_parts, mesh_points
from featherstone_gait.geometry.mesh_size import MAX_INSTANCES, MAX_TRIANGLES

GEOMETRY = """
<geometry id="g"><mesh>
  <source id="s"><float_array id="a" count="9">0 0 0 1 0 0 0 1 0</float_array><technique_common>
    <accessor source="#a" count="3" stride="3"><param name="X" type="float"/><param name="Y" type="float"/>
    <param name="Z" type="float"/></accessor></technique_common></source>
  <vertices id="v"><input semantic="POSITION" source="#s"/></vertices>
  <triangles count="1"><input semantic="VERTEX" source="#v" offset="0"/><p>0 1 2</p></triangles>
</mesh></geometry>"""


def dae(levels, first='<instance_geometry url="#g"/>', geometry=GEOMETRY):
    """Nodes of which each places the one before twice: the first is there 2^levels times."""
    pairs = "".join(f'<node id="n{k + 1}">' + f'<instance_node url="#n{k}"/>' * 2 + "</node>" for k in range(levels))
    return (
        '<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">'
        f"<library_geometries>{geometry}</library_geometries>"
        f'<library_nodes><node id="n0">{first}</node>{pairs}</library_nodes><library_visual_scenes>'
        f'<visual_scene id="S"><node><instance_node url="#n{levels}"/></node></visual_scene></library_visual_scenes>'
        '<scene><instance_visual_scene url="#S"/></scene></COLLADA>'
    )


def gltf(nodes, triangles=1, parts=1, roots=None):
    """A mesh of triangles at nodes, whose parts share their points."""
    points = np.arange(9.0 * triangles).astype("f4").tobytes()
    uri = "data:application/octet-stream;base64," + base64.b64encode(points).decode()
    content = {
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": list(range(len(nodes))) if roots is None else roots}],
        "nodes": nodes,
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}] * parts}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3 * triangles, "type": "VEC3"}],
        "bufferViews": [{"buffer": 0, "byteLength": len(points)}],
        "buffers": [{"byteLength": len(points), "uri": uri}],
    }
    return json.dumps(content)


def glb(content):
    """Write the same mesh as a binary glTF file that refers to other files for its data."""
    text = content.encode() + b" " * (-len(content) % 4)
    return b"glTF" + struct.pack("<III", 2, 20 + len(text), len(text)) + b"JSON" + text


DOUBLED = [{"children": [k + 1, k + 1]} for k in range(24)] + [{"mesh": 0}]


@pytest.mark.parametrize(
    ("name", "text", "count"),
    [
        ("a.dae", dae(24), 2**24),
        ("empty.dae", dae(24, first=""), 2**24),
        ("points.dae", dae(10, geometry=GEOMETRY.replace("0 0 0 1", "0 " * 30_000 + "1")), MAX_TRIANGLES),
        ("a.gltf", gltf([{"mesh": 0}] * 20_000, triangles=1000), MAX_INSTANCES),
        ("doubled.gltf", gltf(DOUBLED, roots=[0]), 2**24),
        ("triangles.gltf", gltf([{"mesh": 0}] * 2000, triangles=1000), MAX_TRIANGLES),
        ("parts.gltf", gltf([{"mesh": 0}], triangles=1000, parts=2000), MAX_TRIANGLES),
        ("unplaced.gltf", gltf([{}], triangles=1000, parts=2000), MAX_TRIANGLES),
        ("a.glb", glb(gltf([{"mesh": 0}] * 20_000)), MAX_INSTANCES),
        ("circle.dae", dae(3, first='<instance_node url="#n3"/>'), None),
        ("circle.gltf", gltf([{"children": [1]}, {"children": [0]}], roots=[0]), None),
        ("rootless.gltf", gltf([{"children": [1]}, {"children": [0]}], roots=[]), None),
    ],
)
def test_what_expands_without_bound_is_refused(tmp_path, name, text, count):
    (tmp_path / name).write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(ValueError, match=name) as error:
        mesh_points(tmp_path / name)
    numbers = [int(word) for word in str(error.value).replace(";", " ").split() if word.isdigit()]
    assert "within itself" in str(error.value) if count is None else max(numbers) >= count


@pytest.mark.parametrize("bad", [{"mesh": 7}, {"mesh": "x"}, {"children": [9]}, {"children": 3}, 5])
def test_wrong_indices_of_nodes_are_refused(tmp_path, bad):
    (tmp_path / "bad.gltf").write_text(gltf([{"mesh": 0}, bad]))
    with pytest.raises(ValueError, match=r"bad\.gltf"):
        mesh_points(tmp_path / "bad.gltf")


def test_all_instances_of_a_plain_file_are_read(tmp_path):
    (tmp_path / "a.dae").write_text(dae(5))
    assert len(mesh_points(tmp_path / "a.dae")) == 3 * 2**5
    (tmp_path / "a.gltf").write_text(gltf([{"mesh": 0}] * 100, triangles=2))
    assert len(mesh_points(tmp_path / "a.gltf")) == 100 * 6


@pytest.mark.parametrize("kind", [".gltf", ".glb"])
def test_pictures_are_not_unpacked(tmp_path, monkeypatch, kind):
    """A picture of a hundred kilobytes may take a gigabyte, once for each instance of what it covers."""
    image = pytest.importorskip("PIL.Image")
    picture = io.BytesIO()
    image.new("L", (64, 64)).save(picture, "PNG")
    content = json.loads(gltf([{"mesh": 0}] * 3))
    uri = "data:image/png;base64," + base64.b64encode(picture.getvalue()).decode()
    content |= {"images": [{"uri": uri}], "textures": [{"source": 0}]}
    content["materials"] = [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]
    content["meshes"][0]["primitives"][0]["material"] = 0
    text = json.dumps(content)
    (tmp_path / f"a{kind}").write_bytes(glb(text) if kind == ".glb" else text.encode())
    opened = []
    monkeypatch.setattr(image, "open", lambda *given, **how: opened.append(given))
    (part,) = mesh_parts(tmp_path / f"a{kind}")
    assert part.color == WHITE
    assert len(part.points) == 9
    assert not opened
