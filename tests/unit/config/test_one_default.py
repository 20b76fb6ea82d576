import ast
import inspect
from collections.abc import Iterator

import pytest

from roadsight.base.section import Section
from roadsight.base.sections.run import Sample
from roadsight.config.schema import Config
from tests.conftest import PROJECT

WORKFLOW = PROJECT / "workflow"
ABSENT = object()

OTHER = {
    "base/__init__.py": ("SEED", "where the default stands"),
    "base/shards.py": ("shards", "the whole, where nothing is shared out"),
    "evidence/costs.py": ("images shards rounds", "amounts of a mile"),
    "roadsight_hardcases": ("radius_m points", "what a hard case is made of"),
    "evidence/labelled_clouds.py": ("farthest_m", "points of a frame of real data"),
    "poles/alignment/landmarks.py": ("axis_px nearest_m farthest_m", "errors and reach of poles"),
    "poles/alignment/pose.py": ("height_m", "spread of a mount"),
    "poles/alignment/solve.py": ("height_m pixels", "error of a height; of the coarse search"),
    "poles/alignment/track.py": ("reach_m", "length of track that says a heading"),
    "poles/calibration": ("images rounds", "images that spoke so far; turns of a search"),
    "poles/images/pole_masks.py": ("kind", "what is looked for in a mask"),
    "poles/risk/changes.py": ("reach_m", "between two surveys"),
    "poles/risk/roads.py": ("offset_m", "from a road's axis"),
    "poles/sightings/distances.py": ("farthest_m", "feet on the ground"),
    "scene/curbs.py": ("reach_m nearest_m window_m shortest_m", "of kerbs beside a track"),
    "stages/scene/rasterise_lidar.py": ("reach_m", "of a place to pavement"),
    "scene/pavement/road_surface.py": ("window_m", "of a surface's own roughness"),
    "stages/scene/build_dem.py": ("points", "that were compared"),
    "setcover": (
        "gap at_least patience NEIGHBOURS PATIENCE",
        "of a library that knows no settings: the best cover, each target once, without an end",
    ),
    "api/covers.py": ("gap at_least", "the same"),
    "commands/cover.py": ("at_least", "the same"),
    "stages/placement/shared/plan_choices.py": ("mounting", "rules of mounting as JSON"),
    "roadsight_worlds/casting": (
        "slope width_m height_m radius_m length_m",
        "scenes of a single body",
    ),
    "roadsight_worlds/highway/highway_ground.py": ("lanes", "of a highway"),
    "roadsight_worlds/rendering": ("length_m", "of a road to train on"),
    "roadsight_worlds/rural/videolog.py": ("height_m", "how a camera shakes"),
}
"""Names that are those of settings and mean something else, by file or folder, and what."""


def defaults(model: type[Section]) -> dict[str, list[object]]:
    """Defaults of all settings with a name, wherever in the schema."""
    found: dict[str, list[object]] = {}
    for name, field in model.model_fields.items():
        if inspect.isclass(field.annotation) and issubclass(field.annotation, Section):
            for inside, values in defaults(field.annotation).items():
                found.setdefault(inside, []).extend(values)
        else:
            found.setdefault(name, []).append(field.get_default())
    return found


SETTINGS = defaults(Config)
for one, values in defaults(Sample).items():
    SETTINGS.setdefault(one, []).extend(values)


def literal(node: ast.expr | None) -> object:
    try:
        return ABSENT if node is None else ast.literal_eval(node)
    except ValueError:
        return ABSENT


def is_dataclass(node: ast.ClassDef) -> bool:
    return any("dataclass" in ast.unparse(part) for part in node.decorator_list)


def written(tree: ast.AST) -> Iterator[tuple[str, int, object]]:
    """Names, lines and values of defaults of parameters and fields, and of constants."""
    for node in ast.walk(tree):
        pairs: list[tuple[str, ast.expr | None]] = []
        if isinstance(node, ast.FunctionDef):
            places = node.args.posonlyargs + node.args.args
            given = node.args.defaults
            pairs += [(a.arg, d) for a, d in zip(places[::-1], given[::-1], strict=False)]
            pairs += [
                (a.arg, d) for a, d in zip(node.args.kwonlyargs, node.args.kw_defaults, strict=True)
            ]
        elif isinstance(node, ast.ClassDef) and is_dataclass(node):
            pairs += [
                (s.target.id, s.value)
                for s in node.body
                if isinstance(s, ast.AnnAssign) and isinstance(s.target, ast.Name)
            ]
        for name, value in pairs:
            told = literal(value)
            if told is not ABSENT and told != ():  # nothing given, whatever it is
                yield name, value.lineno, told


def constants(tree: ast.Module) -> Iterator[tuple[str, int, object]]:
    for node in tree.body:
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
            yield node.targets[0].id.lstrip("_"), node.lineno, literal(node.value)


def alike(value: object, default: object) -> bool:
    """Whether a value could be the setting's: numbers, words, switches, lists or pairs."""
    kinds = [
        "list" if isinstance(v, list | tuple) else bool if isinstance(v, bool) else type(v)
        for v in (value, default)
    ]
    return kinds[0] == kinds[1] or {*kinds} == {int, float}


def repeated(path: str, text: str) -> dict[str, str]:
    """What a file writes again: place and value, by name."""
    tree, found = ast.parse(text), {}
    for name, line, value in written(tree):
        if any(alike(value, default) for default in SETTINGS.get(name, ())):
            found[name] = f"{path}:{line}: {name} = {value!r}"
    for name, line, value in constants(tree):
        # Constants of another value are other quantities: they stand far from any parameter.
        if any(alike(value, d) and value == d for d in SETTINGS.get(name.lower(), ())):
            found[name] = f"{path}:{line}: {name} = {value!r}"
    return found


def allowed(path: str, name: str) -> str | None:
    """The entry that says what a name means there."""
    for place, (names, _) in OTHER.items():
        if (path == place or path.startswith(f"{place}/")) and name in names.split():
            return f"{place} {name}"
    return None


@pytest.fixture(scope="module")
def found():
    """Name and place of all that is written again, by file."""
    return {
        name: repeated(name, file.read_text("utf-8"))
        for file in sorted(WORKFLOW.rglob("*.py"))
        if (name := str(file.relative_to(WORKFLOW)).removeprefix("roadsight/"))
        and "sections" not in file.parts
    }


def test_no_default_of_a_setting_is_written_again(found):
    twice = [
        place
        for path, names in found.items()
        for name, place in names.items()
        if not allowed(path, name)
    ]
    assert not twice, "take the section, or its default: Lidar().neighbours"


def test_every_exception_is_needed(found):
    used = {allowed(path, name) for path, names in found.items() for name in names}
    said = {f"{place} {name}" for place, (names, _) in OTHER.items() for name in names.split()}
    assert said <= used


@pytest.mark.parametrize(
    "text",
    [
        "def see(radius_m: float = 0.25): ...",
        "def fill(*, neighbours=9): ...",
        "@dataclass\nclass Reach:\n    farthest_m: float = 240.0\n",
        "_MIN_BEAMS = 8\n",
        "def scan(points: int = 3_500_000): ...",
        "def build(*, tunnel=True): ...",
    ],
)
def test_the_walk_finds(text):
    assert repeated("somewhere.py", text)


@pytest.mark.parametrize(
    "text",
    [
        "def see(radius_m: float = TARGETS.radius_m): ...",
        "def see(radius_m: float | None = None): ...",
        "def see(overlap: int = 0): ...",
        "_MIN_BEAMS = 9\n",
    ],
)
def test_the_walk_leaves_out(text):
    assert not repeated("somewhere.py", text)
