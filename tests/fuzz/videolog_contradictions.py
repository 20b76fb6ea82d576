"""Tables of one drive as spreadsheets and recording computers write them, beside the clean one."""

from datetime import UTC, datetime, timedelta
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pandas as pd

from roadsight.io.images.videologs import ImageSource, read_videolog_table

KINDS = ("order", "direction", "times", "names", "separators", "everything")
_IMAGE = cv2.imencode(".png", np.zeros((2, 3), np.uint8))[1].tobytes()
_MOST = 12
"""Images of a drive, of which a number takes some."""
_MEASURES = ("milepost", "Mile Post", "chainage", "measure", "km")
_TIMES = ("%Y-%m-%dT%H:%M:%S.%fZ", "%Y-%m-%d %H:%M:%S.%f", "%Y:%m:%d %H:%M:%S.%f", "%H:%M:%S.%f")
_TIME_NAMES = ("time", "timestamp", "Capture Time", "gps_time", "DateTimeOriginal", "epoch")


@cache
def images(folder: Path) -> ImageSource:
    """Two runs of images, with the same names in both."""
    for run in ("run 1", "run 2"):
        (folder / run).mkdir(parents=True)
        for n in range(_MOST):
            (folder / run / f"p{n:02d}.jpg").write_bytes(_IMAGE)
    return ImageSource(folder)


def check_videolog(folder: Path, number: int) -> None:
    """Write the drive of that number otherwise than clean; it gives the same images in order."""
    rng = np.random.default_rng(number)
    kind, count = str(rng.choice(KINDS)), int(rng.integers(2, _MOST + 1))
    source = images(folder / "images")
    clean = drive(count, rng)
    path = folder / "other.csv"
    path.write_bytes(written(clean, kind, rng))
    found = read_videolog_table(path, source)
    order = np.argsort(found["sequence"].to_numpy())
    assert found["sequence"].is_unique
    assert [source.find(name) for name in found["image"].iloc[order]] == [*clean["image"]], kind
    for name in ("latitude", "longitude"):
        np.testing.assert_allclose(found[name].to_numpy()[order], clean[name], rtol=0, atol=1e-9)


def drive(count: int, rng: np.random.Generator) -> pd.DataFrame:
    """A clean table: images in the order of the drive, numbered."""
    names = [f"run 1/p{n:02d}.jpg" for n in rng.permutation(_MOST)[:count]]
    places = np.cumsum(rng.uniform(0.0001, 0.001, (count, 2)), axis=0) + rng.uniform(-60, 60, 2)
    return pd.DataFrame(
        {
            "image": names,
            "latitude": places[:, 0].round(7),
            "longitude": places[:, 1].round(7),
            "sequence": np.arange(count),
        }
    )


def written(clean: pd.DataFrame, kind: str, rng: np.random.Generator) -> bytes:
    """The same drive with one contradiction of a kind, or with all that go together."""
    table = clean.copy()
    everything = kind == "everything"
    if kind == "direction":
        table = _against(table, rng)
    elif kind == "times" or (everything and rng.integers(2)):
        table = _timed(table, rng)
    elif kind == "order" or everything:
        table = _numbered(table, rng).iloc[_mixed(len(table), rng)]
    if kind == "names" or everything:
        table["image"] = [_recorded(name, rng) for name in table["image"]]
    if kind in ("names", "separators") or everything:
        table = table[[*rng.permutation(table.columns)]]
    return _text(table, kind == "separators" or everything, rng)


def _numbered(table: pd.DataFrame, rng) -> pd.DataFrame:
    """Other numbers in the same order, with gaps, or mile posts that rise."""
    steps = np.cumsum(rng.integers(1, 30, len(table)))
    if rng.integers(2):
        return table.assign(sequence=steps)
    name = str(rng.choice(_MEASURES))
    return table.drop(columns="sequence").assign(**{name: steps / 1000})


def _mixed(count: int, rng) -> np.ndarray:
    """An order of rows that is no drive against the numbers, which would be another drive."""
    for _ in range(20):
        order = rng.permutation(count)
        if np.mean(np.diff(order) < 0) < 0.8:
            return order
    return np.arange(count)


def _against(table: pd.DataFrame, rng) -> pd.DataFrame:
    """A drive against its mile posts, which fall from row to row."""
    name = str(rng.choice(_MEASURES))
    posts = 50 - np.cumsum(rng.integers(1, 30, len(table))) / 1000
    return table.drop(columns="sequence").assign(**{name: posts.round(3)})


def _timed(table: pd.DataFrame, rng) -> pd.DataFrame:
    """Times of capture in some format, rows in any order; numbers are gone or contradict them."""
    seconds = np.cumsum(rng.uniform(0.1, 5, len(table)))
    style = int(rng.integers(len(_TIMES) + 1))
    start = datetime(2024, 2, 28, 23, 0, tzinfo=UTC) - timedelta(hours=12 * (style == 3))
    moments = [start + timedelta(seconds=float(second)) for second in seconds]
    if style < len(_TIMES):
        texts = [moment.strftime(_TIMES[style]) for moment in moments]
    else:
        texts = [f"{moment.timestamp() - 315_964_800:.3f}" for moment in moments]
    table = table.assign(**{str(rng.choice(_TIME_NAMES)): texts})
    if rng.integers(2):
        table["sequence"] = rng.permutation(len(table))
    else:
        table = table.drop(columns="sequence")
    return table.iloc[rng.permutation(len(table))]


def _recorded(name: str, rng) -> str:
    """An image's name as a recording computer or a spreadsheet has it."""
    windows = name.replace("/", "\\")
    return str(
        rng.choice(
            [
                name, f"C:\\data\\{windows}", f"\\\\server\\share\\{windows}", f"/data/2024/{name}",
                f"D:/video log/{name}", windows, name.upper(), name.replace(".jpg", ""),
                f"./{name}", f" {name} ",
            ]
        )
    )  # fmt: skip


def _text(table: pd.DataFrame, other: bool, rng) -> bytes:
    """The table's text: separators, decimal commas, cells at the end, line ends, encoding."""
    rows = [[*map(str, table.columns)], *([*map(str, row)] for row in table.to_numpy())]
    if not other:
        return ("\n".join(",".join(row) for row in rows) + "\n").encode()
    separator = str(rng.choice([",", ";", "\t"]))
    if separator != "," and rng.integers(2):
        numbers = {n for n, name in enumerate(rows[0]) if _is_number(table[name])}
        rows[1:] = [
            [cell.replace(".", ",") if n in numbers else cell for n, cell in enumerate(row)]
            for row in rows[1:]
        ]
    ends = separator * int(rng.integers(3))
    quote = '"' if rng.integers(3) == 0 else ""
    lines = [
        separator.join(f"{quote}{cell}{quote}" for cell in row) + ends * bool(rng.integers(2))
        for row in rows
    ]
    if rng.integers(4) == 0:
        lines.insert(0, f"sep={separator}")
    if rng.integers(4) == 0:
        lines.append(separator * len(rows[0]))
    end = str(rng.choice(["\n", "\r\n", "\r"]))
    return (end.join(lines) + end).encode(str(rng.choice(["utf-8", "utf-8-sig", "utf-16"])))


def _is_number(column: pd.Series) -> bool:
    return bool(pd.to_numeric(column, errors="coerce").notna().all())
