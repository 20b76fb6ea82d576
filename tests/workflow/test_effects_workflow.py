"""What `snakemake -n` says of effects: rules of skipped ones are absent, simulated ones present."""

import json

import pytest

from tests.workflow.conftest import Checkout
from tests.workflow.test_layer_fields import check_hidden

SITE = "config/sites/tiny.yaml"
RULES = {
    "mount_tilt": ("tilt_mounts", "lidar: {mounting: normal}"),
    "rain": ("model_rain", "effects: {rain: simulate}"),
    "fog": ("model_fog", "conditions: {visibility_m: 80}"),
    "reflectivity": ("measure_reflectivity", "conditions: {target_reflectivity: 0.02}"),
    "moving_vehicles": ("trace_lanes", "conditions: {aadt: 50000}"),
}
"""The rule of each effect that has one, and what calls for it at the small site."""

OWN = {rule for rule, _ in RULES.values()}
AGAIN = {"build_detection_shard", "check_coverage", "solve_cover", "summarise_site"}


def ask(checkout, lines):
    checkout.edit(SITE, "  shards: 2\n", f"  shards: 2\n  {lines}\n")


def test_effects_file_has_a_reason_for_everything(finished):
    effects = json.loads((finished.folder / "results/tiny/effects.json").read_text())
    decisions = {effect["effect"]: effect["decision"] for effect in effects}
    assert {name for name, made in decisions.items() if made == "skip"} >= set(RULES)
    assert decisions["overhead_cover"] == "simulate"
    assert all(effect["reason"] for effect in effects)
    summary = json.loads((finished.folder / "results/tiny/summary.json").read_text())
    assert set(summary["effects"]) == set(decisions)


def test_skipped_effects_have_no_jobs(finished):
    result = finished.snakemake("-n", "--forceall")
    output = result.stdout + result.stderr
    assert result.returncode == 0, output
    assert "solve_cover" in output
    assert not [rule for rule in OWN if rule in output]


@pytest.mark.parametrize("effect", RULES)
def test_what_the_scene_calls_for_enters_the_dag(copy_of_finished, effect):
    rule, condition = RULES[effect]
    ask(copy_of_finished, condition)
    stale = copy_of_finished.stale_rules()
    assert stale & OWN == {rule}
    assert stale >= AGAIN
    # Denser candidates hang on the coverage; depth maps of the first ones only on the mounts.
    first = "results/tiny/placement/round-0/depth/OS1-64/0.parquet"
    rendered = "render_depth_maps" in copy_of_finished.stale_rules(first)
    assert rendered == (effect == "mount_tilt")


def test_a_site_may_decide_itself(copy_of_finished):
    ask(copy_of_finished, "effects: {rain: simulate, partial_hits: skip}")
    assert copy_of_finished.stale_rules() & OWN == {"model_rain"}


def test_before_the_profile_is_there_the_dry_run_says_what_is_open(finished, tmp_path):
    fresh = Checkout.copy_to(tmp_path / "fresh")
    ask(fresh, "conditions: {rain_mm_h: 40}")
    result = fresh.snakemake("-n")
    output = result.stdout + result.stderr
    assert result.returncode == 0, output
    assert "<TBD>" in output
    assert "model_rain" not in output
    # What a site decides itself needs no measurement.
    fresh.edit(SITE, "conditions: {rain_mm_h: 40}", "effects: {rain: simulate}")
    assert "model_rain" in fresh.stale_rules()


def test_rain_traffic_and_dark_targets_lower_what_is_seen(copy_of_finished):
    plain = json.loads((copy_of_finished.folder / "results/tiny/summary.json").read_text())
    ask(
        copy_of_finished,
        "conditions: {rain_mm_h: 80, aadt: 90000, truck_share: 0.4, target_reflectivity: 0.1}",
    )
    result = copy_of_finished.snakemake("--cores", "2")
    assert result.returncode == 0, result.stderr[-4000:]
    assert copy_of_finished.stale_rules() == set()
    summary = json.loads((copy_of_finished.folder / "results/tiny/summary.json").read_text())
    before, after = plain["placement"]["os-32"], summary["placement"]["os-32"]
    assert after["sensors"] + after["uncoverable_targets"] > (
        before["sensors"] + before["uncoverable_targets"]
    )
    folder = copy_of_finished.folder / "results/tiny/placement/os-32"
    solution = json.loads((folder / "solution.json").read_text())
    check_hidden(copy_of_finished.folder / "results/tiny", "os-32")
    assert 0.9 <= solution["availability"]["least"] <= solution["availability"]["mean"] < 1
