"""What a list of jobs costs grows with the jobs alone: counted in steps, whatever else runs."""

import json
import subprocess
import sys

import pytest

from tests.workflow.conftest import Checkout

COUNTED = """\
import inspect, json, sys
from collections import Counter
from snakemake import cli, dag, jobs, output_index

counts, looked_up, listed = Counter(), Counter(), set()


def counting(owner, name, note):
    real = getattr(owner, name)

    def counted(*arguments, **named):
        note(*arguments)
        return real(*arguments, **named)

    setattr(owner, name, counted)


def made(job, rule, *_):
    counts["made"] += 1


def listing(job, *_):
    listed.add((job.rule.name, *sorted(job.wildcards_dict.items())))


counting(jobs.Job, "__init__", made)
counting(jobs.Job, "log_info", listing)
counting(output_index.OutputIndex, "match", lambda index, file: looked_up.update([str(file)]))
counting(inspect, "_signature_from_function", lambda *_: counts.update(["signatures"]))
try:
    cli.main(sys.argv[1:])
except SystemExit as end:
    counts["status"] = end.code or 0
looked_up_again = sum(looked_up.values()) - len(looked_up)
slow = ("numba", "rasterio", "geopandas", "scipy.ndimage")
loaded = [name for name in slow if name in sys.modules]
found = {"listed": len(listed), "looked_up_again": looked_up_again, "loaded": loaded}
print(json.dumps({**counts, **found}))
"""


def steps(checkout: Checkout, shards: int) -> dict:
    """Steps of a dry run of the small site in so many shards a round."""
    overrides = json.dumps({"shards": shards, "coverage": {"shards": shards}})
    named = ["--config", "sites=[tiny]", f"overrides={overrides}"]
    result = subprocess.run(
        [sys.executable, "-c", COUNTED, "-n", *named], cwd=checkout.folder,
        env=checkout.environment(), capture_output=True, text=True, timeout=600, check=True,
    )  # fmt: skip
    return json.loads(result.stdout.splitlines()[-1])


@pytest.fixture(scope="module")
def few_and_many(tmp_path_factory):
    fresh = Checkout.copy_to(tmp_path_factory.mktemp("listed") / "fresh")
    return steps(fresh, 5), steps(fresh, 25)


def test_jobs_are_as_many_as_the_shards_call_for(few_and_many):
    few, many = few_and_many
    assert few["status"] == many["status"] == 0
    # Two sensors, two rounds, a depth map and detections each.
    assert many["listed"] - few["listed"] == 20 * 8


def test_a_job_is_made_once(few_and_many):
    few, many = few_and_many
    assert many["made"] - few["made"] == many["listed"] - few["listed"]


def test_who_makes_a_file_is_looked_up_once(few_and_many):
    assert [found["looked_up_again"] for found in few_and_many] == [0, 0]


def test_what_a_function_takes_is_read_once(few_and_many):
    """Snakemake's own functions, of which a job evaluates one or two, are read each time."""
    few, many = few_and_many
    assert many["signatures"] - few["signatures"] <= 10 * (many["listed"] - few["listed"])


def test_a_list_loads_neither_the_compiler_nor_readers_of_maps(few_and_many):
    """They take a quarter of the time that a small list takes, and each call begins with one."""
    assert few_and_many[0]["loaded"] == []
