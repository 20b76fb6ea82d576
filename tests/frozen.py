"""What must not change while code moves: ``python -m tests.frozen FILE``.

The first call keeps the digests of all results, the figures of `make truth` and the agreements of
`make bench` in FILE; later ones compare, print what differs and exit with 1. Times do not count.
Digests are those of one machine: processors round differently.
"""

import csv
import json
import sys
from pathlib import Path

from tests.faults.disturb import digests

TRUTH = ("ours", "peer", "published", "goal")


def state(folder: Path) -> dict[str, str]:
    """Digest or figure of everything that is kept, by name."""
    samples = ("results/sample/", "results/sample_rural/")
    found = {name: one for name, one in digests(folder).items() if name.startswith(samples)}
    truth, bench = folder / "results/truth/truth.csv", folder / "results/bench/bench.json"
    if truth.is_file():
        for row in csv.DictReader(truth.read_text().splitlines()):
            name = f"truth {row['area']} {row['dataset']} {row['metric']}"
            found[name] = " ".join(row[column] for column in TRUTH)
    if bench.is_file():
        for row in json.loads(bench.read_text()):
            name = f"bench {row['kernel']} against {row['against']}"
            found[name] = f"{row['agreement_metric']} {row['agreement']}"
    return found


def main(file: str) -> int:
    """Keep the state, or compare with the one that is kept: 1 where they differ."""
    found, path = state(Path()), Path(file)
    if not path.is_file():
        path.write_text(json.dumps(found, indent=0, sort_keys=True))
        print(f"{len(found)} kept in {file}")
        return 0
    kept = json.loads(path.read_text())
    different = sorted(name for name in kept | found if kept.get(name) != found.get(name))
    for name in different:
        print(f"{name}: {kept.get(name)} -> {found.get(name)}")
    print(f"{len(different)} of {len(kept)} differ")
    return 1 if different else 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
