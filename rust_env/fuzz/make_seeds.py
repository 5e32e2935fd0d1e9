"""Writes the seeds of the fuzz targets: tiny valid files, in each spelling that a reader knows. `python make_seeds.py` renews `seeds/`."""

from __future__ import annotations

import base64
import json
import struct
from pathlib import Path

SEEDS = Path(__file__).parent / "seeds"
QUAD = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (1.0, 1.0, 0.0), (0.0, 1.0, 0.5)]


def obj() -> dict[str, bytes]:
    return {
        "quad.obj": b"v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvn 0 0 1\ng a\nf 1/1/1 2//1 3/1 4\n",
        "relative.obj": b"# x\nmtllib a.mtl\nv 0 0 0 1.0\nv 1 0 0\nv 1 1 0\nusemtl b\nf -3 -2 \\\n -1\n",
    }


def ply() -> dict[str, bytes]:
    def header(kind: str, index: str) -> str:
        lists = f"property list uchar {index} vertex_indices"
        axes = "property float x\nproperty float y\nproperty float z\n"
        return f"ply\nformat {kind} 1.0\ncomment c\nelement vertex 4\n{axes}element face 1\n{lists}\nend_header\n"

    def binary(order: str) -> bytes:
        return b"".join(struct.pack(order + "3f", *v) for v in QUAD) + struct.pack(order + "B4i", 4, 0, 1, 2, 3)

    text = "".join("{} {} {}\n".format(*v) for v in QUAD) + "4 0 1 2 3\n"
    strips = header("ascii", "int").replace("element face 1", "element tristrips 1")
    return {
        "ascii.ply": (header("ascii", "int") + text).encode(),
        "little.ply": header("binary_little_endian", "int").encode() + binary("<"),
        "big.ply": header("binary_big_endian", "uint").encode() + binary(">"),
        "strips.ply": (strips + text.replace("4 0 1 2 3", "5 0 1 2 -1 3")).encode(),
    }


def stl() -> dict[str, bytes]:
    loop = "outer loop\n vertex 0 0 0\n vertex 1 0 0\n vertex 0 1e0 0\nendloop\n"
    text = f"solid a\nfacet normal 0 0 1\n{loop}endfacet\nendsolid a\n"
    facet = struct.pack("<12fH", 0, 0, 1, *QUAD[0], *QUAD[1], *QUAD[2], 0)
    return {"ascii.stl": text.encode(), "binary.stl": b"binary".ljust(80) + struct.pack("<I", 2) + facet * 2}


def gltf_json(uri: str | None) -> tuple[dict[str, object], bytes]:
    data = b"".join(struct.pack("<3f", *v) for v in QUAD) + struct.pack("<6H", 0, 1, 2, 0, 2, 3)
    buffer: dict[str, object] = {"byteLength": len(data)}
    if uri is not None:
        buffer["uri"] = uri + base64.b64encode(data).decode()
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"children": [1], "translation": [0, 0, 1]}, {"mesh": 0, "scale": [2, 1, 1], "rotation": [0, 0, 0, 1]}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "mode": 4}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5123, "count": 6, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteLength": 48, "byteStride": 12},
            {"buffer": 0, "byteOffset": 48, "byteLength": 12},
        ],
        "buffers": [buffer],
    }
    return document, data


def gltf() -> dict[str, bytes]:
    document, _ = gltf_json("data:application/octet-stream;base64,")
    return {"quad.gltf": json.dumps(document, separators=(",", ":")).encode()}


def glb() -> dict[str, bytes]:
    document, data = gltf_json(None)
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(data), b"BIN\0") + data
    return {"quad.glb": struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks}


def dae() -> dict[str, bytes]:
    numbers = " ".join(str(x) for v in QUAD for x in v)
    source = (
        f"<source id='s'><float_array id='a' count='12'>{numbers}</float_array><technique_common>"
        "<accessor source='#a' count='4' stride='3'/></technique_common></source>"
    )
    faces = (
        "<triangles count='1'><input semantic='VERTEX' source='#v' offset='0'/><p>0 1 2</p></triangles>"
        "<polylist count='1'><input semantic='VERTEX' source='#v' offset='1'/>"
        "<input semantic='NORMAL' source='#s' offset='0'/><vcount>4</vcount><p>0 0 0 1 0 2 0 3</p></polylist>"
        "<polygons count='1'><input semantic='VERTEX' source='#v' offset='0'/><p>0 1 2</p></polygons>"
    )
    text = (
        "<?xml version='1.0'?><COLLADA xmlns='http://www.collada.org/2005/11/COLLADASchema' version='1.4.1'>"
        "<asset><unit meter='0.1' name='m'/><up_axis>Y_UP</up_axis></asset>"
        f"<library_geometries><geometry id='g'><mesh>{source}"
        f"<vertices id='v'><input semantic='POSITION' source='#s'/></vertices>{faces}</mesh></geometry></library_geometries>"
        "<library_nodes><node id='n'><instance_geometry url='#g'/></node></library_nodes>"
        "<library_visual_scenes><visual_scene id='w'><node><translate>1 2 3</translate><rotate>0 0 1 90</rotate>"
        "<scale>1 2 1</scale><node><matrix>1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1</matrix><instance_node url='#n'/></node></node>"
        "</visual_scene></library_visual_scenes><scene><instance_visual_scene url='#w'/></scene></COLLADA>"
    )
    return {"quad.dae": text.encode()}


def sdf() -> dict[str, bytes]:
    shapes = {
        "box": "<size>1 1 1</size>",
        "sphere": "<radius>1</radius>",
        "cylinder": "<radius>1</radius><length>2</length>",
        "capsule": "<radius>0.2</radius><length>1</length>",
        "ellipsoid": "<radii>1 2 3</radii>",
        "plane": "<normal>0 0 1</normal><size>9 9</size>",
        "mesh": "<uri>model://x/y.dae</uri><scale>1 1 1</scale>",
        "polyline": "<point>0 0</point><point>1 0</point><point>1 1</point><height>1</height>",
        "heightmap": "<uri>h.png</uri><size>1 1 1</size>",
    }
    visuals = "".join(f"<visual name='{k}'><geometry><{k}>{v}</{k}></geometry></visual>" for k, v in shapes.items())
    world = (
        "<?xml version='1.0'?><sdf version='1.6'><world name='w'><include><uri>model://sun</uri><pose>0 0 1 0 0 0</pose></include>"
        "<frame name='f'><pose relative_to='m'>1 0 0 0 0 0</pose></frame>"
        f"<model name='m'><pose frame='' degrees='true'>0 0 0 0 0 90</pose><link name='l'>{visuals}"
        "<collision name='c'><pose relative_to='f'>0 0 0 0 0 0</pose><geometry><box><size>1 2 3</size></box></geometry></collision></link>"
        "<model name='inner'><link name='k'><pose>0 0 1 0 0 0</pose></link></model></model>"
        "<state><model name='m'><pose>0 0 0 0 0 0</pose><scale>1 1 1</scale><link name='l'><pose>1 1 1 0 0 0</pose></link></model></state>"
        "<include><uri>fuzz.world</uri></include><actor name='a'/></world></sdf>"
    )
    box = "<geometry><box><size>1 1 1</size></box></geometry>"
    model = f"<sdf version='1.7'><model name='m'><link name='l'><visual name='v'>{box}</visual></link></model></sdf>"
    return {"world.sdf": world.encode(), "model.sdf": model.encode()}


#: OctoMap's trees are sixteen levels deep; the path of first children leads to one voxel.
DEPTH = 16


def octomap_header(binary: bool, kind: str, size: int) -> bytes:
    name = "# Octomap OcTree binary file" if binary else "# Octomap OcTree file"
    return f"{name}\n# c\nid {kind}\nsize {size}\nres 0.1\ndata\n".encode()


def bt() -> dict[str, bytes]:
    inner, last = struct.pack("<H", 3), struct.pack("<H", 0b10_01)
    # The last inner node has a free and an occupied child.
    return {"two.bt": octomap_header(True, "OcTree", DEPTH + 2) + inner * (DEPTH - 1) + last}


def ot() -> dict[str, bytes]:
    def tree(colour: bytes) -> bytes:
        inner = struct.pack("<f", 0.4) + colour + b"\x01"
        return inner * DEPTH + struct.pack("<f", -0.4) + colour + b"\x00"

    return {
        "one.ot": octomap_header(False, "OcTree", DEPTH + 1) + tree(b""),
        "colour.ot": octomap_header(False, "ColorOcTree", DEPTH + 1) + tree(b"abc"),
    }


def nbvmap() -> dict[str, bytes]:
    """One brick with a free and an occupied voxel; the target makes the checksums right."""

    def chunk(tag: bytes, payload: bytes) -> bytes:
        return tag + struct.pack("<Q", len(payload)) + payload + bytes(8)

    def file(limits: bytes) -> bytes:
        head = struct.pack("<d4f", 0.1, 0.85, -0.4, -2.0, 3.5) + limits + struct.pack("<I", 1)
        known, occupied = [3, *[0] * 7], [2, *[0] * 7]
        bricks = struct.pack("<3i", 0, -1, 2) + struct.pack("<16Q", *known, *occupied)
        odds = struct.pack("<2f", -0.4, 0.85)
        uncertainty = struct.pack("<B2f", 1, 1.0, 0.25)
        chunks = [(b"HEAD", head), (b"BRKS", bricks), (b"ODDS", odds), (b"UNCT", uncertainty), (b"END ", b"")]
        return b"NBVMAP\r\n" + struct.pack("<I", 1) + b"".join(chunk(*c) for c in chunks)

    return {
        "plain.nbvmap": file(struct.pack("<B", 0)),
        "limited.nbvmap": file(struct.pack("<B6i", 1, -16, -16, 0, 16, 16, 32)),
    }


def main() -> None:
    for target in (bt, dae, glb, gltf, nbvmap, obj, ot, ply, sdf, stl):
        folder = SEEDS / target.__name__
        folder.mkdir(parents=True, exist_ok=True)
        for name, content in target().items():
            (folder / name).write_bytes(content)


if __name__ == "__main__":
    main()
