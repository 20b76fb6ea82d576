"""The product on real data beside a peer: tables and a page."""

for name, area in AREAS.items():

    rule:
        name:
            f"truth_{name}"
        input:
            files=truth_files(area),
        output:
            out=f"results/truth/{name}/{{dataset}}.json",
        log:
            f"logs/truth/{name}-{{dataset}}.log",
        wildcard_constraints:
            dataset="|".join(map(re.escape, area.datasets)),
        conda:
            ENVIRONMENT
        resources:
            mem_mb=4000,
        params:
            command=command,
            settings=told(dataset=wildcard("dataset"), missing=truth_missing(area)),
            sha256=truth_checksums(area),
        shell:
            STEP


use rule step as write_truth with:
    input:
        figures=truth_figures(),
        assets=REPORT_ASSETS,
    output:
        csv="results/truth/truth.csv",
        page="results/truth/index.html",
