import uuid

import numpy as np
import pytest

from roadsight.base.shards import Shard, deal

PATTERNS = {
    "numbers": lambda n: f"{n + 1:04d}.jpg",
    "canon": lambda n: f"IMG_{n + 1234}.JPG",
    "sony": lambda n: f"DSC{n + 1:05d}.JPG",
    "gopro": lambda n: f"GOPR{n + 1:04d}.JPG",
    "times": lambda n: f"20240101_{120_000 + 2 * n}.jpg",
    "uuids": lambda n: f"{uuid.UUID(int=7919 * n**5 + n)}.png",
    "routes": lambda n: f"{881_000_952_181 + n // 3}{(1, 2, 5)[n % 3]}.jpg",
    "folders": lambda n: f"2021/07/{n // 10}/{n % 10}.jpg",
}


def names(pattern: str, count: int) -> list[str]:
    return [PATTERNS[pattern](n) for n in range(count)]


@pytest.mark.parametrize("pattern", PATTERNS)
def test_sizes_differ_by_one_at_most(pattern):
    """Hashing names modulo the shards left two of four empty for ten numbered images."""
    for count in range(1, 41):
        for shards in range(1, 9):
            dealt = deal(names(pattern, count), shards)
            assert set(dealt) == set(names(pattern, count))
            sizes = np.bincount(list(dealt.values()), minlength=shards)
            assert len(sizes) == shards
            assert sizes.max() - sizes.min() <= 1


def test_order_and_repetitions_do_not_matter(rng):
    given = names("canon", 30)
    dealt = deal(given, 4)
    assert deal([*rng.permutation(given), *given[:7]], 4) == dealt
    parts = [Shard(shard, 4).dealt(given) for shard in range(4)]
    assert parts == [{name for name in given if dealt[name] == shard} for shard in range(4)]


@pytest.mark.parametrize(("shards", "most"), [(1, 1.0), (2, 1.6), (4, 2.3), (8, 3.4)])
@pytest.mark.parametrize("pattern", ["numbers", "uuids"])
def test_an_image_more_or_fewer_changes_few_shards(pattern, shards, most):
    """Shards whose images are others, the new image's own included, over 3 to 40 images."""
    changed = []
    for count in range(3, 41):
        whole = names(pattern, count)
        for left_out in whole[:: max(count // 5, 1)]:
            before, after = deal(set(whole) - {left_out}, shards), deal(whole, shards)
            touched = {after[left_out]}
            for name in before:
                if before[name] != after[name]:
                    touched |= {before[name], after[name]}
            changed.append(len(touched))
    assert np.mean(changed) <= most


def test_nothing_is_dealt_to_nobody():
    assert deal([], 4) == {}
    assert Shard(2, 4).dealt([]) == set()
