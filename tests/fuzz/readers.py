"""Every reader of outside files: valid files to start from, and what reads them."""

import io
import struct
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import cv2
import geopandas as gpd
import numpy as np
import shapely
import yaml
from scipy import sparse

from roadsight.base.section import validated
from roadsight.base.texts import read_yaml
from roadsight.commands.register import read_pairs
from roadsight.config.load import load_config, load_site
from roadsight.config.plans import load_plans
from roadsight.effects.catalogue import load_catalogue
from roadsight.geometry.frames import Frame
from roadsight.geometry.reference import UnitChoice
from roadsight.io.cloud.clouds import iter_chunks
from roadsight.io.images.camera_tables import read_baselines, read_cameras
from roadsight.io.images.image_shards import LabelImages
from roadsight.io.images.models import open_model
from roadsight.io.images.videologs import ImageSource, read_videolog_table
from roadsight.io.records.matrices import read_element_list, read_matrix, read_set_list, read_vector
from roadsight.io.records.text_tables import read_sightings
from roadsight.io.vector.known import read_points
from roadsight.io.vector.vectors import read_lines, read_polygons
from roadsight.placement.sensors.sensors import load_sensors
from roadsight.poles.images.networks import LabelMap
from roadsight.stages.scene.ingest_cloud import survey
from tests.helpers.las_files import in_chunks, random_points, wkt_of, write_las
from tests.helpers.onnx_bytes import pointwise

ROOT = Path(__file__).resolve().parents[2]
FRAME = Frame((458_000.0, 5_428_000.0, 100.0), crs_wkt=wkt_of("EPSG:25832"))


@dataclass(frozen=True)
class Reader:
    """One reader of outside files.

    Parameters
    ----------
    suffixes : names that its files may end in. seeds : valid files, made in a folder.
    read : reads one file, given its path; raises nothing but InputError.
    """

    suffixes: tuple[str, ...]
    seeds: Callable[[Path], list[bytes]]
    read: Callable[[Path], object]


def _clouds(folder: Path) -> list[bytes]:
    xyz, wkt = random_points(300), wkt_of("EPSG:25832")
    files = [
        write_las(folder / "a.las", xyz, wkt),
        write_las(folder / "b.laz", xyz, wkt, point_format=7, red=7, green=8, blue=9),
        write_las(folder / "c.laz", xyz, point_format=3, version="1.2"),
        write_las(folder / "d.las", xyz[:40], point_format=1, version="1.2"),
        in_chunks(write_las(folder / "e.laz", xyz, wkt), 90),
        in_chunks(write_las(folder / "f.laz", xyz, point_format=1, version="1.2"), [120, 180]),
    ]
    return [file.read_bytes() for file in files]


def _read_cloud(path: Path) -> object:
    return survey([path], UnitChoice("EPSG:25832")), sum(len(chunk) for chunk in iter_chunks(path))


def _lines() -> gpd.GeoDataFrame:
    xy = FRAME.to_native(np.array([[0.0, 0], [50, 1], [90, 3], [0, 9], [60, 10], [90, 9]]))
    lines = [shapely.LineString(xy[:3]), shapely.LineString(xy[3:])]
    names = {"edge": ["left", "right"], "kind": ["edge", "median"]}
    return gpd.GeoDataFrame(names, geometry=lines, crs=25832)


def _polygons() -> gpd.GeoDataFrame:
    low, high = FRAME.to_native(np.array([[0.0, 0], [40, 9]]))
    return gpd.GeoDataFrame({"name": ["a"]}, geometry=[shapely.box(*low, *high)], crs=25832)


def _vectors(suffix: str, *drivers: str) -> Callable[[Path], list[bytes]]:
    def seeds(folder: Path) -> list[bytes]:
        found = []
        for features in (_lines(), _polygons()):
            for crs in (25832, 4326):
                file = folder / f"{len(found)}{suffix}"
                features.to_crs(crs).to_file(file, driver=drivers[0])
                found.append(file.read_bytes())
        return found

    return seeds


def _read_vectors(path: Path) -> None:
    """One of the readers of vector files, by the file's length."""
    readers = (read_lines, read_polygons, read_points)
    readers[path.stat().st_size % len(readers)](path, FRAME)


def _texts(*texts: str) -> Callable[[Path], list[bytes]]:
    return lambda folder: [text.encode() for text in texts]


def _of_project(*patterns: str) -> Callable[[Path], list[bytes]]:
    return lambda folder: [
        file.read_bytes() for pattern in patterns for file in sorted(ROOT.glob(pattern))
    ]


@cache
def _image_bytes() -> tuple[bytes, ...]:
    image = np.random.default_rng(0).integers(0, 255, (24, 32, 3), np.uint8)
    jpeg = cv2.imencode(".jpg", image)[1].tobytes()
    exif = b"Exif\0\0II*\0\x08\0\0\0\x01\0" + struct.pack("<HHII", 0x8825, 4, 1, 26) + bytes(4)
    exif += b"\x02\0" + struct.pack("<HHII", 1, 2, 2, 0x4E) + struct.pack("<HHII", 2, 5, 3, 56)
    exif += bytes(4) + struct.pack("<6I", 50, 1, 30, 1, 0, 1)
    tagged = jpeg[:2] + b"\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif + jpeg[2:]
    png = cv2.imencode(".png", image[..., 0])[1].tobytes()
    deep = cv2.imencode(".png", image[..., 0].astype(np.uint16) * 200)[1].tobytes()
    return jpeg, tagged, png, deep


def _read_image(path: Path) -> None:
    """Both readers of images: of a videolog, and of labels or depth."""
    source = ImageSource(path.parent)
    table = read_videolog_table(path.parent, source)
    failures = []
    for call in (
        lambda: source.facts(path.name),
        lambda: source.read(path.name),
        lambda: LabelImages(path.parent).read(path.with_suffix(".jpg").name),
    ):
        try:
            call()
        except Exception as error:
            failures.append(error)
    assert len(table) == 1
    _raise_worst(failures)


def _raise_worst(failures: list[Exception]) -> None:
    for error in sorted(failures, key=lambda e: type(e).__name__ == "InputError"):
        raise error


def _zips(folder: Path) -> list[bytes]:
    found = []
    for kind in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        buffer = io.BytesIO()
        with zipfile.ZipFile(buffer, "w", kind) as archive:
            for name, content in zip(("a/1.jpg", "a/2.jpg", "b.png"), _image_bytes(), strict=False):
                archive.writestr(name, content)
        found.append(buffer.getvalue())
    return found


def _read_zip(path: Path) -> None:
    source = ImageSource(path)
    read_videolog_table(path, source)
    for name in source.names():
        source.read(name)


def _read_table_of_images(path: Path) -> None:
    images = path.parent / "images"
    images.mkdir(exist_ok=True)
    source = ImageSource(images)
    for name in read_videolog_table(path, source)["image"]:
        if name:
            source.find(name)


def _read_config(path: Path) -> None:
    content = read_yaml(path)
    load_config(content if isinstance(content, dict) else {"sites": content})


def _read_site(path: Path) -> None:
    load_site(str(path), load_config(read_yaml(ROOT / "config/config.yaml")))


def _model_folder(path: Path) -> None:
    manifest = path.with_name("manifest.yaml")
    manifest.write_text(yaml.safe_dump(_manifest(path.name)))
    open_model(manifest)


def _manifest(file: str) -> dict:
    return {
        "task": "classes",
        "file": file,
        "labels": 3,
        "classes": {0: "road", 2: "pole"},
        "input": {"colour": "RGB", "size": {"height_px": 8, "width_px": 12}},
        "output": {"kind": "logits"},
    }


def _networks(folder: Path) -> list[bytes]:
    weights = np.arange(9, dtype=np.float32).reshape(3, 3)
    return [pointwise(weights, (8, 12)), pointwise(weights, (8, 12), labels=True)]


def _read_manifest(path: Path) -> None:
    path.with_name("tiny.onnx").write_bytes(_networks(path)[0])
    open_model(path)


def _matrices(folder: Path) -> list[bytes]:
    found = []
    matrix = sparse.random(12, 20, 0.3, random_state=0)
    for kind in ("csr", "csc", "coo"):
        for compressed in (True, False):
            buffer = io.BytesIO()
            sparse.save_npz(buffer, matrix.asformat(kind), compressed=compressed)
            found.append(buffer.getvalue())
    return found


def _vector_seeds(folder: Path) -> list[bytes]:
    found = []
    for values in (np.arange(9.0), np.arange(5)):
        buffer = io.BytesIO()
        np.save(buffer, values)
        found.append(buffer.getvalue())
    return found


_SETS = "4 3\n1.5 0 1\n2 1 2 3\n1 3\n"
_ELEMENTS = "3 4\n0 2 0 1\n1 1 2\n2 3 0 1 3\n"
_EDGES = "edge,x,y,z,kind\nleft,458000,5428000,101,edge\nleft,458050,5428001,101,edge\n"
_EDGES_LL = "edge,lon,lat\nl,8.42,49.0\nl,8.43,49.0\nr,8.42,49.01\nr,8.43,49.02\n"
_VIDEOLOG = "image,latitude,longitude,route,sequence,left_image\na.jpg,49.0,8.4,R 1,1,l/a.jpg\n"
_VIDEOLOG += "b.jpg,49.1,8.4,R 1,2,l/b.jpg\n"
_SIGHTINGS = (
    "image,lat,lon,bearing,depth,sigma_depth_m\na.jpg,35.1,-83,12,9.5,1\nb,35.1,-83,350,,\n"
)
_POLES = "id,lat,lon,kind\np1,49.0,8.42,utility\np2,49.001,8.42,sign\n"
_POLES_XY = "id,x,y\np1,458000,5428000\np2,458100,5428010\n"
_CAMERAS = (
    "image,easting_m,northing_m,height_m,heading_grid_deg,pitch_deg,roll_deg,focal_px,cx_px,cy_px\n"
    "a.jpg,458000,5428000,102,90,0,0,900,512,300\nb.jpg,458010,5428000,102,90,0,0,900,512,300\n"
)

_BASELINE = (
    '{"640x416": {"focal_px": 700.5, "yaw_deg": 0.5, "sigma": {"yaw_deg": 0.1}, "pairs": 12},'
    ' "all": {"hfov_deg": 90, "height_m": 2.1}}'
)
_PAIRS = (
    "image,pixel_x,pixel_y,x,y,z\na.jpg,10,20,458000,5428000,100\na.jpg,30,40,458010,5428000,\n"
)

READERS = {
    "cloud": Reader((".las", ".laz"), _clouds, _read_cloud),
    "geojson": Reader((".geojson",), _vectors(".geojson", "GeoJSON"), _read_vectors),
    "geopackage": Reader((".gpkg",), _vectors(".gpkg", "GPKG"), _read_vectors),
    "edges": Reader((".csv",), _texts(_EDGES, _EDGES_LL), lambda p: read_lines(p, FRAME)),
    "videolog": Reader((".csv",), _texts(_VIDEOLOG), _read_table_of_images),
    "sightings": Reader((".csv",), _texts(_SIGHTINGS), read_sightings),
    "poles": Reader((".csv",), _texts(_POLES, _POLES_XY), lambda p: read_points(p, FRAME)),
    "cameras": Reader((".csv",), _texts(_CAMERAS), lambda p: read_cameras(p, FRAME)),
    "baseline": Reader((".json",), _texts(_BASELINE), read_baselines),
    "pairs": Reader((".csv",), _texts(_PAIRS), lambda p: read_pairs(p, FRAME)),
    "config": Reader((".yaml",), _of_project("config/config.yaml"), _read_config),
    "site": Reader((".yaml",), _of_project("config/sites/*.yaml"), _read_site),
    "sensors": Reader((".yaml",), _of_project("config/sensors.yaml"), load_sensors),
    "plans": Reader(
        (".yaml",),
        _of_project("config/plans.yaml"),
        lambda p: load_plans(str(p), str(ROOT / "config/sensors.yaml")),
    ),
    "effects": Reader((".yaml",), _of_project("config/effects.yaml"), load_catalogue),
    "manifest": Reader((".yaml",), _texts(yaml.safe_dump(_manifest("tiny.onnx"))), _read_manifest),
    "label_map": Reader(
        (".yaml",),
        _texts("labels: 3\nclasses: {0: road, 2: pole}\nover: [other]\n"),
        lambda p: validated(LabelMap, read_yaml(p), str(p)),
    ),
    "network": Reader((".onnx",), _networks, _model_folder),
    "image": Reader((".jpg", ".png"), lambda folder: list(_image_bytes()), _read_image),
    "zip": Reader((".zip",), _zips, _read_zip),
    "matrix": Reader((".npz",), _matrices, read_matrix),
    "vector": Reader((".npy",), _vector_seeds, read_vector),
    "set_list": Reader((".txt",), _texts(_SETS), read_set_list),
    "element_list": Reader((".txt",), _texts(_ELEMENTS), read_element_list),
}
