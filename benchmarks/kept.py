"""Hand-written readers beside libraries: ``python -m benchmarks.kept DATA`` (needs Pillow).

DATA is the folder of real data. Figures of docs/decisions/075-engines-and-kept-libraries.md.
"""

from __future__ import annotations

import io
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import laspy
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from PIL import Image
from sklearn.cluster import DBSCAN

from roadsight.base.errors import InputError
from roadsight.io.cloud.las_header import _stated, check_structure
from roadsight.io.images.exif import decoded_image, image_facts
from roadsight.scene.pavement.outline import euclidean_clusters

_DAMAGED = """
import sys, laspy, resource
resource.setrlimit(resource.RLIMIT_AS, (8 << 30, 8 << 30))
print(len(laspy.read(sys.argv[1])))
"""


def seconds(work: Callable[[], object]) -> float:
    """CPU seconds, the least of three."""
    times = []
    for _ in range(3):
        begun = time.process_time()
        work()
        times.append(time.process_time() - begun)
    return min(times)


def images(folder: Path) -> None:
    """Facts of images, of halved ones, and numbers of a small PNG."""
    contents = [file.read_bytes() for file in sorted(folder.glob("images/*"))]

    def pillow(content: bytes) -> tuple[object, ...]:
        with Image.open(io.BytesIO(content)) as image:
            return *image.size, image.getexif().get(274, 1)

    own = seconds(lambda: [image_facts(content) for content in contents])
    theirs = seconds(lambda: [pillow(content) for content in contents])
    facts = [image_facts(content) for content in contents]
    same = sum(
        (f.width_px, f.height_px) == pillow(c)[:2] for f, c in zip(facts, contents, strict=True)
    )
    print(f"images: {len(contents)}, ours {own:.4f} s, Pillow {theirs:.4f} s, same size {same}")
    halves = [content[: len(content) // 2] for content in contents]
    told = sum(not image_facts(content).complete for content in halves)
    opened = sum(bool(pillow(content)) for content in halves)
    print(f"  halved: {told} told by ours; Pillow opens {opened} without a word")
    values = np.arange(16, dtype=np.uint8).reshape(4, 4)
    stored = png_of_4_bits(values)
    print("  4-bit labels: ours", decoded_image(stored, cv2.IMREAD_UNCHANGED).ravel()[:4], end="")
    print(", Pillow", np.asarray(Image.open(io.BytesIO(stored))).ravel()[:4])


def png_of_4_bits(values: np.ndarray) -> bytes:
    """A grey PNG of 4 bits a pixel."""
    import zlib  # noqa: PLC0415

    rows = b"".join(b"\0" + bytes(a << 4 | b for a, b in row.reshape(-1, 2)) for row in values)
    head = struct.pack(">IIBBBBB", values.shape[1], values.shape[0], 4, 0, 0, 0, 0)
    parts = [b"\x89PNG\r\n\x1a\n"]
    for name, data in ((b"IHDR", head), (b"IDAT", zlib.compress(rows)), (b"IEND", b"")):
        check = struct.pack(">I", zlib.crc32(name + data))
        parts.append(struct.pack(">I", len(data)) + name + data + check)
    return b"".join(parts)


def headers(folder: Path) -> None:
    """A damaged count, and the CRS of real clouds."""
    content = bytearray((folder / "montpellier_street.laz").read_bytes())
    (points_at,) = struct.unpack_from("<I", content, 96)
    (table_at,) = struct.unpack_from("<q", content, points_at)
    struct.pack_into("<I", content, table_at + 4, 0xFFFFFFF0)
    with tempfile.TemporaryDirectory() as place:
        file = Path(place, "damaged.laz")
        file.write_bytes(content)
        begun = time.perf_counter()
        ended = subprocess.run(
            [sys.executable, "-c", _DAMAGED, str(file)], capture_output=True, text=True, check=False
        )
        took, last = time.perf_counter() - begun, (ended.stderr.strip().splitlines() or [""])[-1]
        print(f"damaged chunks: laspy exit {ended.returncode} after {took:.1f} s: {last[:90]}")
        begun = time.perf_counter()
        try:
            check_structure(file)
        except InputError as error:
            print(f"  ours after {time.perf_counter() - begun:.4f} s: {str(error)[-90:]}")
    for file in sorted(folder.rglob("*.la[sz]")):
        with laspy.open(file) as cloud:
            try:
                theirs = cloud.header.parse_crs()
            except Exception as error:
                theirs = type(error).__name__
            ours = _stated(cloud.header).crs
        print(f"  {file.name}: laspy {getattr(theirs, 'name', theirs)}; ours {ours and ours.name}")


def tiles(folder: Path) -> None:
    """Reading positions from LAZ and from Parquet as tiles are written."""
    file = folder / "junction_mls.laz"
    xyz = np.asarray(laspy.read(file).xyz, np.float32)
    with tempfile.TemporaryDirectory() as place:
        path = Path(place, "tiles.parquet")
        table = pa.table({axis: xyz[:, k] for k, axis in enumerate("xyz")})
        pq.write_table(
            table,
            path,
            compression="lz4",
            use_dictionary=False,
            column_encoding=dict.fromkeys("xyz", "BYTE_STREAM_SPLIT"),
        )
        parquet = seconds(lambda: pq.read_table(path))
        laz = seconds(lambda: laspy.read(file).xyz)
        sizes = path.stat().st_size / 2**20, file.stat().st_size / 2**20
    print(f"tiles: {len(xyz)} points, Parquet {parquet:.2f} s, LAZ {laz:.2f} s; MiB {sizes}")


def clusters() -> None:
    """Clusters of smooth ground by scikit-learn."""
    rng = np.random.default_rng(1)
    xyz = np.column_stack([rng.uniform(0, 60, (200_000, 2)), rng.normal(0, 0.01, 200_000)])
    euclidean_clusters(xyz[:500], 0.25)
    own = seconds(lambda: euclidean_clusters(xyz, 0.25))
    begun = time.process_time()
    labels = DBSCAN(eps=0.25, min_samples=1).fit_predict(xyz)
    theirs, ours = time.process_time() - begun, euclidean_clusters(xyz, 0.25)
    same = len(np.unique(np.column_stack([labels, ours]), axis=0)) == len(np.unique(ours))
    print(f"clusters: ours {own:.2f} s, DBSCAN of scikit-learn {theirs:.2f} s, same {same}")


if __name__ == "__main__":
    data = Path(sys.argv[1])
    images(data / "videolog" / "kitti_0009")
    headers(data / "clouds")
    tiles(data / "clouds")
    clusters()
