"""Helpers of the rules that measure on real data: which files each data set has."""

from roadsight.evidence.truth_catalogue import AREAS

DATA = os.environ.get("ROADSIGHT_DATA", "")


def data_folder():
    """Folder of the real data; without one there is nothing to measure on."""
    if not DATA or not Path(DATA).is_dir():
        refuse(
            "real data are needed",
            where="ROADSIGHT_DATA",
            found=DATA or "nothing",
            allowed="the folder that holds clouds/, street_scans/, sightings/, ...",
            hint="export ROADSIGHT_DATA=/path/to/data",
        )
    return Path(DATA)


def truth_data(area, wildcards):
    return list(map(str, area.files(wildcards.dataset, data_folder())[0]))


def truth_files(area):
    """Files of a data set: only their content can make figures stale."""
    return lambda wildcards: ancient(truth_data(area, wildcards))


def truth_checksums(area):
    return lambda wildcards: list(map(CHECKSUMS.of, truth_data(area, wildcards)))


def truth_missing(area):
    """Patterns of a data set that match no file; the table and the page say so."""
    return lambda wildcards: area.files(wildcards.dataset, data_folder())[1]


def truth_figures():
    """Figures of all data sets, where there are data at all."""
    return lambda wildcards: [
        f"results/truth/{area}/{dataset}.json"
        for area, about in AREAS.items()
        for dataset in about.datasets
        if data_folder()
    ]
