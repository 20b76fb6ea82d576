"""How far decisions on effects were right: sites with `effects: audit` are run both ways.

REQUIRED INPUTS  finished results of the audited sites
OUTPUTS          results/audit/: one JSON a site, audit.csv, index.html
"""


use rule step as audit_effects with:
    input:
        solution_files=lambda wildcards: (
            f"results/{wildcards.site}/placement/{audited_plan(wildcards)}/solution.json"
        ),
        effects=rules.plan_effects.output.out,
        catalogue=CONFIG.effects_file,
    output:
        out="results/audit/{site}.json",
    log:
        "logs/audit/{site}.log",
    benchmark:
        "results/audit/benchmarks/{site}.tsv"
    params:
        settings=told(
            site=wildcard("site"),
            plan=audited_plan,
            config=config_of_audit,
            work="results/audit/variants/{site}",
        ),


use rule step as audit_pole_effects with:
    input:
        hazard_files="results/{site}/poles/hazard.parquet",
        effects=rules.plan_effects.output.out,
        catalogue=CONFIG.effects_file,
    output:
        out="results/audit/poles/{site}.json",
    log:
        "logs/audit/poles/{site}.log",
    benchmark:
        "results/audit/benchmarks/poles/{site}.tsv"
    params:
        settings=told(
            effects_of_one_way,
            site=wildcard("site"),
            config=config_of_audit,
            work="results/audit/variants/poles/{site}",
        ),


use rule step as write_audit with:
    input:
        rows=[
            *(f"results/audit/{site}.json" for site in audited_sites("placement")),
            *(f"results/audit/poles/{site}.json" for site in audited_sites("poles")),
        ],
        assets=REPORT_ASSETS,
    output:
        csv="results/audit/audit.csv",
        table="results/audit/audit.md",
        page="results/audit/index.html",
    log:
        "logs/audit/write_audit.log",
    benchmark:
        "results/audit/benchmarks/write_audit.tsv"
