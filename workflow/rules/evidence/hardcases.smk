"""Where naive ways fail: the catalogue of hard cases, run both ways.

REQUIRED INPUTS  none but the sources
OUTPUTS          results/hardcases/: hardcases.csv, index.html
"""


rule run_hardcases:
    input:
        assets=[
            path
            for path in REPORT_ASSETS
            if path.endswith((".css", "hardcases.html.j2"))
        ],
        code=sources("run_hardcases"),
    output:
        table="results/hardcases/hardcases.csv",
        page="results/hardcases/index.html",
    log:
        "logs/run_hardcases.log",
    benchmark:
        "results/benchmarks/run_hardcases.tsv"
    conda:
        ENVIRONMENT
    resources:
        mem_mb=1500,
    params:
        seed=CONFIG.seed,
    shell:
        "python -m roadsight.stages.evidence.run_hardcases --seed {params.seed}"
        " --table {output.table} --page {output.page} > {log} 2>&1"
