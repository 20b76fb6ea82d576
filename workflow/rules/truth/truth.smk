"""The product on real data beside a peer: tables and a page.

REQUIRED INPUTS  the data under ROADSIGHT_DATA
OUTPUTS          results/truth/: truth.csv, index.html
"""


use rule step as truth_ground with:
    input:
        files=truth_files("ground"),
    output:
        out="results/truth/ground/{dataset}.json",
    log:
        "logs/truth/ground-{dataset}.log",
    benchmark:
        "results/truth/benchmarks/ground-{dataset}.tsv"
    wildcard_constraints:
        dataset=truth_datasets("ground"),
    resources:
        mem_mb=4000,
    params:
        settings=told(dataset=wildcard("dataset"), missing=truth_missing("ground")),
        sha256=truth_checksums("ground"),


use rule step as truth_pavement with:
    input:
        files=truth_files("pavement"),
    output:
        out="results/truth/pavement/{dataset}.json",
    log:
        "logs/truth/pavement-{dataset}.log",
    benchmark:
        "results/truth/benchmarks/pavement-{dataset}.tsv"
    wildcard_constraints:
        dataset=truth_datasets("pavement"),
    resources:
        mem_mb=4000,
    params:
        settings=told(dataset=wildcard("dataset"), missing=truth_missing("pavement")),
        sha256=truth_checksums("pavement"),


use rule step as truth_edges with:
    input:
        files=truth_files("edges"),
    output:
        out="results/truth/edges/{dataset}.json",
    log:
        "logs/truth/edges-{dataset}.log",
    benchmark:
        "results/truth/benchmarks/edges-{dataset}.tsv"
    wildcard_constraints:
        dataset=truth_datasets("edges"),
    resources:
        mem_mb=4000,
    params:
        settings=told(dataset=wildcard("dataset"), missing=truth_missing("edges")),
        sha256=truth_checksums("edges"),


use rule step as truth_depth with:
    input:
        files=truth_files("depth"),
    output:
        out="results/truth/depth/{dataset}.json",
    log:
        "logs/truth/depth-{dataset}.log",
    benchmark:
        "results/truth/benchmarks/depth-{dataset}.tsv"
    wildcard_constraints:
        dataset=truth_datasets("depth"),
    resources:
        mem_mb=4000,
    params:
        settings=told(dataset=wildcard("dataset"), missing=truth_missing("depth")),
        sha256=truth_checksums("depth"),


use rule step as truth_alignment with:
    input:
        files=truth_files("alignment"),
    output:
        out="results/truth/alignment/{dataset}.json",
    log:
        "logs/truth/alignment-{dataset}.log",
    benchmark:
        "results/truth/benchmarks/alignment-{dataset}.tsv"
    wildcard_constraints:
        dataset=truth_datasets("alignment"),
    resources:
        mem_mb=4000,
    params:
        settings=told(dataset=wildcard("dataset"), missing=truth_missing("alignment")),
        sha256=truth_checksums("alignment"),


use rule step as truth_sightings with:
    input:
        files=truth_files("sightings"),
    output:
        out="results/truth/sightings/{dataset}.json",
    log:
        "logs/truth/sightings-{dataset}.log",
    benchmark:
        "results/truth/benchmarks/sightings-{dataset}.tsv"
    wildcard_constraints:
        dataset=truth_datasets("sightings"),
    resources:
        mem_mb=4000,
    params:
        settings=told(dataset=wildcard("dataset"), missing=truth_missing("sightings")),
        sha256=truth_checksums("sightings"),


use rule step as truth_cover with:
    input:
        files=truth_files("cover"),
    output:
        out="results/truth/cover/{dataset}.json",
    log:
        "logs/truth/cover-{dataset}.log",
    benchmark:
        "results/truth/benchmarks/cover-{dataset}.tsv"
    wildcard_constraints:
        dataset=truth_datasets("cover"),
    resources:
        mem_mb=4000,
    params:
        settings=told(dataset=wildcard("dataset"), missing=truth_missing("cover")),
        sha256=truth_checksums("cover"),


use rule step as write_truth with:
    input:
        figures=truth_figures(),
        assets=REPORT_ASSETS,
    output:
        csv="results/truth/truth.csv",
        page="results/truth/index.html",
    log:
        "logs/truth/write_truth.log",
    benchmark:
        "results/truth/benchmarks/write_truth.tsv"
