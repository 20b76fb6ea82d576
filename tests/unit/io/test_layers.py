import logging
from pathlib import Path

import geopandas as gpd
import numpy as np
import pytest
import shapely

from roadsight.base.errors import InputError
from roadsight.geometry.frames import Frame
from roadsight.io.records.companions import (
    network_sha256,
    split_layer,
    weight_files,
    with_companions,
)
from roadsight.io.records.sources import sha256
from roadsight.io.vector.site_bounds import tell_near
from roadsight.io.vector.vector_sources import with_known_heights
from roadsight.io.vector.vectors import read_lines
from tests.helpers.las_files import wkt_of

FRAME = Frame((500_000.0, 5_400_000.0, 200.0), crs_wkt=wkt_of("EPSG:25832"))
UNDEFINED = (
    'ENGCRS["Undefined Cartesian SRS",EDATUM["Unknown engineering datum"],CS[Cartesian,2],'
    'AXIS["x",unspecified],AXIS["y",unspecified],LENGTHUNIT["metre",1]]'
)


def lines(crs=None, z=()):
    xyz = np.column_stack([np.arange(3) * 20 + 500_000, np.full(3, 5_400_004.0), *z])
    return gpd.GeoDataFrame({"edge": ["left"]}, geometry=[shapely.LineString(xyz)], crs=crs)


def test_a_layer_is_told_by_its_name(tmp_path):
    for number, layer in enumerate(("edges", "other")):
        moved = lines(25832)
        moved["geometry"] = moved.translate(0, 10 * number)
        moved.to_file(tmp_path / "a.gpkg", layer=layer)
    with pytest.raises(InputError, match=r"a\.gpkg\|layername=edges"):
        read_lines(tmp_path / "a.gpkg", FRAME)
    for number, layer in enumerate(("edges", "other")):
        found = read_lines(f"{tmp_path / 'a.gpkg'}|layername={layer}", FRAME)
        assert found.geometry[0].coords[0][1] == pytest.approx(4 + 10 * number)
    assert split_layer("a|b.gpkg") == ("a|b.gpkg", None)


@pytest.mark.parametrize("local", [False, True])
def test_an_undefined_crs_is_none(tmp_path, local):
    lines(UNDEFINED).to_file(tmp_path / "a.gpkg")
    frame = Frame(FRAME.origin) if local else FRAME
    found = read_lines(tmp_path / "a.gpkg", frame)
    np.testing.assert_allclose(found.geometry[0].coords[0], [0, 4])
    if not local:
        moved = read_lines(tmp_path / "a.gpkg", frame, "EPSG:32632")
        np.testing.assert_allclose(moved.geometry[0].coords[0], [0, 4], atol=1e-3)


@pytest.mark.parametrize("height", [0.0, -9999.0, -1e38, -1.797e308, np.nan])
def test_heights_that_mean_none(height):
    line = shapely.LineString(np.column_stack([np.arange(3), np.zeros(3), np.full(3, height)]))
    assert not with_known_heights(line).has_z
    assert with_known_heights(shapely.LineString([(0, 0, 0), (1, 0, 5)])).has_z


def test_heights_are_looked_at_as_stored(tmp_path):
    lines(4326 and 25832, [np.zeros(3)]).to_file(tmp_path / "a.gpkg")
    assert not read_lines(tmp_path / "a.gpkg", FRAME).geometry[0].has_z
    lines(25832, [np.full(3, 203.0)]).to_file(tmp_path / "b.gpkg")
    assert read_lines(tmp_path / "b.gpkg", FRAME).geometry[0].coords[0][2] == pytest.approx(3)


def test_layers_of_the_cases(cases):
    frame = Frame((500_000.0, 5_400_000.0, 199.98), crs_wkt=wkt_of("EPSG:32632"))
    folder = cases / "14-geopackage-with-undefined-cartesian-crs"
    assert len(read_lines(folder / "edges.gpkg", frame))
    assert len(read_lines(folder / "edges.gpkg", Frame((500_000.0, 5_400_000.0, 199.98))))
    line = cases / "19-zero-heights-of-digitised-lines" / "line.kml"
    assert not read_lines(line, frame).geometry[0].has_z
    two = cases / "24-geopackage-of-several-layers" / "two.gpkg"
    assert len(read_lines(f"{two}|layername=edges", frame))


def test_weights_beside_a_network(tmp_path):
    entry = b"\x0a\x08location\x12\x06w.data"
    (tmp_path / "a.onnx").write_bytes(b"head" + entry + b"tail")
    assert weight_files(tmp_path / "a.onnx") == []
    (tmp_path / "w.data").write_bytes(b"weights")
    found = weight_files(tmp_path / "a.onnx")
    assert found == [tmp_path / "w.data"]
    assert network_sha256(tmp_path / "a.onnx", []) == sha256(tmp_path / "a.onnx")
    assert network_sha256(tmp_path / "a.onnx", found) != sha256(tmp_path / "a.onnx")


ABOUT = FRAME.to_dict() | {"bounds_m": [0, 0, 0, 300, 60, 9]}


def test_lists_say_how_many_match(caplog):
    log = logging.getLogger("roadsight.test")
    with caplog.at_level(logging.INFO):
        tell_near(log, "zones", np.array([[5.0, 5], [9e3, 0], [9e3, 9]]), ABOUT, "z.gpkg")
    assert "1 of 3 zones lie at the site" in caplog.text
    assert caplog.records[0].levelno == logging.WARNING
    with pytest.raises(InputError, match="none of 1 zones"):
        tell_near(log, "zones", np.array([[9e3, 0.0]]), ABOUT, "z.gpkg")
    tell_near(log, "zones", np.empty((0, 2)), ABOUT, "z.gpkg")


def test_a_swap_of_axes_is_told():
    native = FRAME.to_native(np.array([[5.0, 5.0, 0]]))[:, :2]
    swapped = FRAME.to_local(native[:, ::-1])
    with pytest.raises(InputError, match="axes exchanged"):
        tell_near(logging.getLogger("x"), "poles", swapped, ABOUT, "p.csv")


def test_a_shapefile_comes_with_all_of_its_files(tmp_path):
    path = tmp_path / "rails.shp"
    geometry = [shapely.LineString([(0, 0), (9, 9)])]
    gpd.GeoDataFrame({"name": ["a"]}, geometry=geometry, crs="EPSG:25832").to_file(path)
    (tmp_path / "rails.dbf").rename(tmp_path / "rails.DBF")
    found = {Path(name).suffix for name in with_companions(path)}
    assert found == {".shp", ".DBF", ".shx", ".prj", ".cpg"}
    assert with_companions("roads.gpkg|layername=edges") == ["roads.gpkg"]
