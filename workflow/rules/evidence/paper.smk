"""Tables and figures of both studies: published, ours as published, ours by default.

REQUIRED INPUTS  finished results of the sites in config/sites/paper; config/published.yaml
OUTPUTS          results/paper/: short.csv, short.html; long.csv, long.html
"""


use rule step as measure_paper with:
    input:
        base_files=base_of_paper,
    output:
        out="results/paper/runs/{size}/{run}.json",
    log:
        "logs/paper/{size}/{run}.log",
    benchmark:
        "results/paper/benchmarks/{size}/{run}.tsv"
    resources:
        mem_mb=4000,
    params:
        command=command_with("cores"),
        settings=told(
            site=lambda wildcards: site_of_paper(wildcards),
            config=lambda wildcards: config_of_paper(wildcards),
            changes=lambda wildcards: json.dumps(changes_of_paper(wildcards)),
            plans=lambda wildcards: run_of_paper(wildcards).plans,
            targets=lambda wildcards: run_of_paper(wildcards).targets,
            work="results/paper/variants/{size}/{run}",
        ),


use rule step as write_paper with:
    input:
        runs=runs_of_paper,
        assets=REPORT_ASSETS,
    output:
        csv="results/paper/{size}.csv",
        page="results/paper/{size}.html",
    log:
        "logs/paper/{size}/write_paper.log",
    benchmark:
        "results/paper/benchmarks/{size}/write_paper.tsv"
    params:
        settings=told(size=wildcard("size")),
