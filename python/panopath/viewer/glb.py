"""Binary glTF 2.0 of one mesh with one picture on it, shown as bright as the picture is (``KHR_materials_unlit``).

Twelve bytes of header, then a chunk of JSON and a chunk of arrays, each filled up to a multiple of four bytes.
"""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np

from panopath.viewer.shapes import Mesh

_FLOAT, _UINT = 5126, 5125
_ARRAY, _ELEMENTS = 34962, 34963
_LINEAR, _SMALLER_COPIES, _CLAMP = 9729, 9987, 33071
_JSON, _BINARY = b"JSON", b"BIN\0"


def textured(mesh: Mesh, jpeg: bytes, *, is_small: bool = False) -> bytes:
    """Write a mesh that has texture coordinates; its far sides are not shown.

    Parameters
    ----------
    mesh
        What is shown.
    jpeg
        The picture, as the bytes of a JPEG file; ``uv`` counts from its upper left corner.
    is_small
        Whether it is shown smaller than it is. Only then are smaller copies of it used: at the poles of a panorama,
        which are drawn out along its rows, they would blur it.
    """
    if mesh.uv is None:
        raise ValueError("the mesh has no texture coordinates")
    arrays = (mesh.vertices.astype("<f4"), mesh.uv.astype("<f4"), mesh.faces.astype("<u4").ravel())
    blocks = [array.tobytes() for array in arrays] + [jpeg]
    starts = np.cumsum([0] + [len(_filled(block, b"\0")) for block in blocks]).tolist()
    views: list[dict[str, Any]] = [
        {"buffer": 0, "byteOffset": start, "byteLength": len(block)}
        for start, block in zip(starts[:-1], blocks, strict=True)
    ]
    for view, target in zip(views, (_ARRAY, _ARRAY, _ELEMENTS), strict=False):
        view["target"] = target
    low, high = arrays[0].min(axis=0), arrays[0].max(axis=0)
    content = {
        "asset": {"version": "2.0"},
        "extensionsUsed": ["KHR_materials_unlit"],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "indices": 2, "material": 0}]}],
        "materials": [
            {
                "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "metallicFactor": 0.0},
                "extensions": {"KHR_materials_unlit": {}},
            }
        ],
        "textures": [{"source": 0, "sampler": 0}],
        # the seam has corners of its own, so nothing wraps
        "samplers": [
            {"magFilter": _LINEAR, "minFilter": _SMALLER_COPIES if is_small else _LINEAR}
            | {"wrapS": _CLAMP, "wrapT": _CLAMP}
        ],
        "images": [{"bufferView": 3, "mimeType": "image/jpeg"}],
        "accessors": [
            {"bufferView": 0, "componentType": _FLOAT, "count": len(arrays[0]), "type": "VEC3"}
            | {"min": low.tolist(), "max": high.tolist()},
            {"bufferView": 1, "componentType": _FLOAT, "count": len(arrays[1]), "type": "VEC2"},
            {"bufferView": 2, "componentType": _UINT, "count": len(arrays[2]), "type": "SCALAR"},
        ],
        "bufferViews": views,
        "buffers": [{"byteLength": starts[-1]}],
    }
    chunks = _chunk(_JSON, _filled(json.dumps(content).encode("ascii"), b" "))
    chunks += _chunk(_BINARY, b"".join(_filled(block, b"\0") for block in blocks))
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def _filled(data: bytes, filling: bytes) -> bytes:
    return data + filling * (-len(data) % 4)


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack("<I4s", len(data), kind) + data
