import base64
import json
import re

import cv2
import numpy as np
import pytest

from roadsight.io.images.image_shards import ImageShard, ImageShardWriter
from roadsight.io.records.atomic import read_json, write_json
from roadsight.io.records.tables import read_table, write_table
from roadsight.poles.images.kinds import PixelClass
from roadsight.stages.evidence import write_poles_page, write_report, write_site_page
from tests.helpers.report_poles import REASON, PolesSite, changed_validation, without
from tests.helpers.report_site import ReportSite
from tests.unit.report.test_report_document import Elements

TITLE = 'Valley <script>alert(1)</script> & "quotes"'


@pytest.fixture(scope="module")
def sites(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sites")
    return [
        PolesSite(folder, "valley", length_m=176.0, poles=6, points=500, title=TITLE),
        PolesSite(folder, "local", length_m=80.0, poles=3, crs=None, known=0, points=500),
    ]


@pytest.fixture(scope="module")
def pages(sites):
    for site in sites:
        assert write_poles_page.main(site.poles_arguments) == 0
    return [site.poles_page for site in sites]


@pytest.fixture(scope="module")
def valley(pages):
    return read_json(pages[0])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("report")


@pytest.fixture(scope="module")
def html(sites, pages, folder):
    """A site with both jobs, one with its scene alone, one with poles alone."""
    bare = ReportSite(folder, "bare", placed=False)
    scenes = [bare, sites[0]]
    for site in scenes:
        assert write_site_page.main(site.arguments) == 0
    given = [str(site.path("page.json")) for site in scenes]
    return report(folder, *given, poles=pages)


@pytest.fixture(scope="module")
def elements(html):
    return Elements(html)


def report(folder, *scenes, poles):
    out = folder / "report.html"
    arguments = ["--poles-pages", *map(str, poles), "--out", str(out)]
    assert write_report.main([*(["--pages", *scenes] if scenes else []), *arguments]) == 0
    return out.read_text(encoding="utf-8")


def rendered(page, folder):
    """Visible text of the report of one page of poles."""
    write_json(folder / "given.json", page)
    return Elements(report(folder, poles=[folder / "given.json"])).text


class TestPage:
    def test_same_artifacts_give_the_same_bytes(self, sites, pages, tmp_path):
        again = tmp_path / "page.json"
        arguments = [str(again) if a == str(pages[0]) else a for a in sites[0].poles_arguments]
        assert write_poles_page.main(arguments) == 0
        assert again.read_bytes() == pages[0].read_bytes()

    def test_counts_agree_with_the_tables(self, sites, valley):
        site = sites[0]
        assert valley["counts"] == {
            "images": len(site.frames), "aligned": int(site.cameras["accepted"].sum()),
            "rejected": int((~site.cameras["accepted"]).sum()), "sightings": len(site.sightings),
            "kept": int(site.sightings["kept"].sum()), "poles": len(site.poles), "routes": 1,
            "length_m": pytest.approx(8.0 * (len(site.frames) - 1)),
        }  # fmt: skip
        assert valley["rejections"]["images"] == [
            [REASON, valley["counts"]["rejected"]],
            ["has no place", 1],
            ["stands still", 1],
        ]

    def test_each_pole_has_its_picture_without_plates(self, sites, tmp_path):
        """Of masks that show vehicles everywhere, nothing is recognisable."""
        site = sites[0]
        shards = [ImageShard(path) for path in site.shards("masks", "zip")]
        hidden = [str(tmp_path / f"{n}.zip") for n in range(len(shards))]
        for shard, path in zip(shards, hidden, strict=True):
            with ImageShardWriter(path, shard.about) as archive:
                for name in shard.names:
                    archive.write(name, np.full_like(shard.read(name), PixelClass.VEHICLE))
        plain, found = [], {}
        for blur in ("False", "True"):
            out = tmp_path / f"{blur}.zip"
            arguments = without(site.poles_arguments, "out", "masks")
            rest = ["--masks", *hidden, "--blur", blur, "--out", str(tmp_path / "page.json")]
            assert write_poles_page.main([*arguments, *rest, "--pictures", str(out)]) == 0
            found[blur] = ImageShard(out)
            plain.append(read_json(tmp_path / "page.json")["pictures"])
        assert found["True"].names == found["False"].names == site.poles["id"].tolist()
        assert [one["id"] for one in plain[0]] == [one["id"] for one in plain[1]]
        for name in found["True"].names:
            seen, unseen = (found[blur].read(name).astype(float) for blur in ("False", "True"))
            assert seen.shape == unseen.shape
            across = [np.abs(np.diff(image, axis=1)).max() for image in (seen, unseen)]
            assert across[1] < 0.7 * across[0]  # a pole of 3 px is no line any more

    def test_images_without_a_mask_are_hidden_whole(self, sites, tmp_path, caplog):
        site = sites[0]
        empty = [str(tmp_path / f"{n}.zip") for n in range(len(site.shards("masks", "zip")))]
        for path in empty:
            with ImageShardWriter(path):
                pass
        arguments = without(site.poles_arguments, "out", "masks", "depth", "dem")
        for masks in (["--masks", *empty], []):
            page = tmp_path / "page.json"
            caplog.clear()
            assert write_poles_page.main([*arguments, *masks, "--out", str(page)]) == 0
            assert "no mask" in caplog.text
            for one in read_json(page)["images"]:
                raw = np.frombuffer(base64.b64decode(one["jpeg"]), np.uint8)
                image = cv2.imdecode(raw, cv2.IMREAD_COLOR).astype(float)
                assert np.abs(np.diff(image, axis=1)).max() < 60  # poles are 100 and more

    def test_side_views_of_a_bent_lens_have_pictures(self, sites, tmp_path):
        """Each pole seen in the left view alone, through a lens with distortion."""
        site = sites[0]
        frames = site.frames.assign(left_path=site.frames["path"])
        write_table(tmp_path / "frames.parquet", frames)
        shards = [
            tmp_path / f"s{n}.parquet" for n in range(len(site.shards("sightings", "parquet")))
        ]
        for old, new in zip(site.shards("sightings", "parquet"), shards, strict=True):
            write_table(new, read_table(old).assign(view="left"))
        sizes = frames[["route", "width_px", "height_px"]].drop_duplicates().to_dict("records")
        lens = {"k1": -0.1, "k2": 0.0, "scale_px": 500.0}
        write_json(tmp_path / "drive.json", {"lenses": [size | lens for size in sizes]})
        rest = without(site.poles_arguments, "out", "frames", "sightings")
        rest += ["--frames", str(tmp_path / "frames.parquet"), "--sightings", *map(str, shards)]
        rest += ["--drive", str(tmp_path / "drive.json"), "--pictures", str(tmp_path / "p.zip")]
        assert write_poles_page.main([*rest, "--out", str(tmp_path / "page.json")]) == 0
        assert ImageShard(tmp_path / "p.zip").names == site.poles["id"].tolist()
        assert {one["view"] for one in read_json(tmp_path / "page.json")["pictures"]} == {"left"}

    def test_images_of_unknown_place_are_not_on_the_map(self, valley):
        layer = valley["layers"]["cameras"]
        assert "lost.jpg" not in layer["images"]
        assert len(layer["images"]) == valley["counts"]["images"] - 1

    def test_poles_know_their_images_and_sightings(self, sites, valley):
        names = valley["layers"]["cameras"]["images"]
        for pole, row in zip(valley["layers"]["poles"], sites[0].poles.itertuples(), strict=True):
            assert [names[camera] for camera in pole["cameras"]] == row.images.split(";")
            assert pole["sightings"] == row.score
            longitude, latitude = pole["lon_lat_deg"]
            assert (latitude, longitude) == pytest.approx((row.latitude, row.longitude))

    def test_rejected_images_are_shown_with_their_reason(self, valley):
        rejected = [image for image in valley["images"] if image["state"] == 1]
        assert rejected
        assert all(image["reason"] == REASON for image in rejected)
        assert all(image["lidar"]["count"] > 0 for image in valley["images"])

    def test_projected_edge_lies_on_the_edge_in_the_image(self, valley):
        from tests.unit.report.test_report_poles import unpacked

        image = next(image for image in valley["images"] if image["state"] == 0)
        lidar, found = (unpacked(image[key]).reshape(-1, 2) / 8 for key in ("lidar", "edges"))
        nearest = [abs(lidar - point).sum(axis=1).min() for point in found]
        assert max(nearest) < 20

    def test_depth_fit_follows_its_samples(self, valley):
        fit = valley["depth_fit"]
        said = [fit["c1"] / z + fit["c2"] for z in fit["distance_m"]]
        apart = sorted(abs(a - b) for a, b in zip(said, fit["relative"], strict=True))
        assert apart[len(apart) // 2] < 0.03
        assert set(valley["depth_checks"]) == {"network", "ground"}

    def test_page_stays_small(self, pages):
        assert pages[0].stat().st_size < 3e6

    def test_job_without_what_is_optional(self, sites, tmp_path):
        optional = ("hazard", "images", "dem", "masks", "depth", "files", "validation")
        arguments = without(sites[0].poles_arguments, *optional, "out")
        out = tmp_path / "page.json"
        given = ["--validation", "--hazard", "--out", str(out)]
        assert write_poles_page.main([*arguments, *given]) == 0
        page = read_json(out)
        assert page["depth_fit"] is None
        assert {image["jpeg"] for image in page["images"]} == {None}
        text = rendered(page, tmp_path)
        for absent in ("From relative depth", "Against known", "Roadside hazard", "Files of the"):
            assert (absent in text) == (absent == "From relative depth")

    def test_job_that_found_nothing(self, sites, tmp_path):
        site, arguments = sites[1], []
        empty = {"poles": "poles.parquet", "hazard": "hazard.parquet"}
        for path in site.shards("sightings", "parquet"):
            write_table(tmp_path / path.rpartition("/")[2], read_table(path).iloc[:0])
        for name in empty.values():
            write_table(tmp_path / name, read_table(site.path("poles", name)).iloc[:0])
        arguments = without(site.poles_arguments, "sightings", "out", *empty)
        shards = [str(tmp_path / f"{n}.parquet") for n in range(2)]
        given = [part for k, v in empty.items() for part in (f"--{k}", str(tmp_path / v))]
        out = str(tmp_path / "page.json")
        assert (
            write_poles_page.main([*arguments, *given, "--sightings", *shards, "--out", out]) == 0
        )
        text = rendered(read_json(out), tmp_path)
        assert "No pole was located." in text
        assert "Only 0 sightings" in text

    def test_lack_of_an_artifact_is_one_message(self, sites, tmp_path, capsys):
        arguments = without(sites[0].poles_arguments, "top", "out")
        given = ["--top", str(tmp_path / "none.tif"), "--out", str(tmp_path / "page.json")]
        assert write_poles_page.main([*arguments, *given]) == 2
        assert "cannot be read as an overhead view" in capsys.readouterr().err


class TestReport:
    def test_same_pages_give_the_same_bytes(self, pages, tmp_path):
        first = report(tmp_path, poles=pages)
        assert report(tmp_path, poles=pages) == first

    def test_sites_have_the_sections_of_their_jobs(self, elements):
        anchors = [a["href"][1:] for t, a in elements.tags if t == "a" and "sections" not in a]
        by_site = {
            n: {a.partition(f"site-{n}-")[2] for a in anchors if a.startswith(f"site-{n}-")}
            for n in range(3)
        }
        common = {"parameters", "provenance"}
        scene = {"map", "scene3d", "scene"}
        found = {"poles", "pictures", "images", "alignment", "depth", "hazard", "files"}
        checked = {"checked", "components"}
        assert by_site == {
            0: common | scene | {"results"},  # its files lie beside the report
            1: common | scene | found | checked,
            2: common | found,
        }

    def test_every_anchor_leads_somewhere(self, elements, folder):
        identifiers = [a["id"] for _, a in elements.tags if "id" in a]
        assert len(identifiers) == len(set(identifiers))
        addresses = {a["href"] for t, a in elements.tags if t == "a"}
        within = {address[1:] for address in addresses if address.startswith("#")}
        assert within <= set(identifiers)
        files = {address for address in addresses if not address.startswith("#")}
        assert {"bare/scene/dem.tif", "bare/summary.json"} <= files
        assert all((folder / address).is_file() for address in files)

    def test_nothing_is_loaded_from_elsewhere(self, elements):
        for tag, attributes in elements.tags:
            assert tag not in ("link", "iframe", "object", "embed")
            assert attributes.get("src", "data:image/jpeg;").startswith("data:image/jpeg;")
            assert ":" not in attributes.get("href", "#")

    def test_texts_from_data_are_escaped(self, html, elements):
        assert "<script>alert" not in html
        assert TITLE in elements.text
        assert "No <edges> in the image" in elements.text
        assert "My <own>" in elements.text

    def test_key_texts(self, elements):
        for text in (
            "Poles located",
            "Images aligned",
            "Mean error",
            "The known poles cover half of the route.",
            "No known poles for this site",
            "6 known poles within reach of an image (25",
            "Ratings: 3 high, 3 low",
            "Poles withheld",
            "Near a building",
            "Three quarters within",
            "6.3",
            "Curved road",
            "Intersection",
            "paper",
            "F1",
            "0.35",
            "Side-view stitching",
            "essential for objects that only side views show",
            "results/valley/poles/poles.gpkg",
            "WGS 84",
            "Clear zone",
            "2021/00000.jpg",
        ):
            assert text in elements.text, text

    def test_every_plot_says_what_it_shows(self, elements):
        plots = [a for t, a in elements.tags if t == "svg"]
        assert len(plots) == 3 + 3 + 3 + 3 + 4 + 1 + 4  # the last are cross-sections
        assert all(a["role"] == "img" and a["aria-label"] for a in plots)

    def test_data_is_read_back(self, html, valley):
        found = re.findall(r'class="poles-data">(.*?)</script>', html, re.S)
        assert len(found) == 2
        assert json.loads(found[0])["layers"] == valley["layers"]

    def test_hazard_table_sorts_by_values_not_texts(self, elements, valley):
        values = [a["data-value"] for t, a in elements.tags if t == "td" and "data-value" in a]
        offset = valley["hazard"]["columns"].index("offset_m")
        assert {str(row[offset]) for row in valley["hazard"]["rows"]} <= set(values)

    def test_truth_of_other_shapes(self, sites, valley, tmp_path):
        few = {"errors": [], "thresholds": [], "ablation": [], "mean_m": None, "truth": {}}
        page = valley | {"validation": changed_validation(sites[0], **few)}
        text = rendered(page, tmp_path)
        assert "Against known poles" in text
        assert "What each component is worth" not in text

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"format": "roadsight.page/1"}, "no page of this version"),
            ({}, "two pages of one site"),
        ],
    )
    def test_wrong_pages_are_refused(self, pages, tmp_path, capsys, change, message):
        write_json(tmp_path / "page.json", read_json(pages[1]) | change)
        given = ["--poles-pages", str(pages[1]), str(tmp_path / "page.json")]
        assert write_report.main([*given, "--out", str(tmp_path / "r.html")]) == 2
        assert message in capsys.readouterr().err

    def test_report_of_nothing_is_refused(self, tmp_path, capsys):
        assert write_report.main(["--out", str(tmp_path / "r.html")]) == 2
        assert "no site to report" in capsys.readouterr().err
