"""Where naive ways fail: the catalogue of hard cases, run both ways.

REQUIRED INPUTS  none but the sources
OUTPUTS          results/hardcases/: hardcases.csv, index.html
"""


use rule step as run_hardcases with:
    input:
        assets=[path for path in REPORT_ASSETS if path.endswith((".css", "hardcases.html.j2"))],
    output:
        table="results/hardcases/hardcases.csv",
        page="results/hardcases/index.html",
    log:
        "logs/run_hardcases.log",
    benchmark:
        "results/benchmarks/run_hardcases.tsv"
    resources:
        mem_mb=1500,
    params:
        settings=told(seed=CONFIG.seed),
