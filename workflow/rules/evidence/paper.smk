"""Tables and figures of both studies: published, ours as published, ours by default.

REQUIRED INPUTS  finished results of the sites in config/sites/paper; config/published.yaml
OUTPUTS          results/paper/: short.csv, short.html; long.csv, long.html
"""


rule measure_paper:
    input:
        base=base_of_paper,
        code=sources("measure_paper"),
    output:
        run="results/paper/runs/{size}/{run}.json",
    log:
        "logs/paper/{size}/{run}.log",
    benchmark:
        "results/paper/benchmarks/{size}/{run}.tsv"
    conda:
        ENVIRONMENT
    resources:
        mem_mb=4000,
    params:
        site=lambda wildcards: site_of_paper(wildcards),
        config=lambda wildcards: config_of_paper(wildcards),
        changes=lambda wildcards: json.dumps(changes_of_paper(wildcards)),
        plans=lambda wildcards: run_of_paper(wildcards).plans,
        targets=lambda wildcards: run_of_paper(wildcards).targets,
        work="results/paper/variants/{size}/{run}",
    shell:
        "python -m roadsight.stages.evidence.measure_paper --site {params.site}"
        " --config {params.config:q} --changes {params.changes:q} --plans {params.plans}"
        " --targets {params.targets} --cores {threads} --work {params.work}"
        " --out {output.run} > {log} 2>&1"


rule write_paper:
    input:
        runs=runs_of_paper,
        assets=REPORT_ASSETS,
        code=sources("write_paper"),
    output:
        csv="results/paper/{size}.csv",
        page="results/paper/{size}.html",
    log:
        "logs/paper/{size}/write_paper.log",
    benchmark:
        "results/paper/benchmarks/{size}/write_paper.tsv"
    conda:
        ENVIRONMENT
    shell:
        "python -m roadsight.stages.evidence.write_paper --size {wildcards.size}"
        " --runs {input.runs} --csv {output.csv} --page {output.page} > {log} 2>&1"
