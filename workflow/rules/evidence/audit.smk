"""How far decisions on effects were right: sites with `effects: audit` are run both ways.

REQUIRED INPUTS  finished results of the audited sites
OUTPUTS          results/audit/: one JSON a site, audit.csv, index.html
"""


rule audit_effects:
    input:
        solution=lambda wildcards: (
            f"results/{wildcards.site}/placement/{audited_plan(wildcards)}/solution.json"
        ),
        effects=rules.plan_effects.output.effects,
        catalogue=CONFIG.effects_file,
        code=sources("audit_effects"),
    output:
        rows="results/audit/{site}.json",
    log:
        "logs/audit/{site}.log",
    benchmark:
        "results/audit/benchmarks/{site}.tsv"
    conda:
        ENVIRONMENT
    params:
        plan=audited_plan,
        config=config_of_audit,
        work="results/audit/variants/{site}",
    shell:
        "python -m roadsight.stages.evidence.audit_effects --site {wildcards.site} --plan {params.plan}"
        " --effects {input.effects} --catalogue {input.catalogue} --config {params.config:q}"
        " --work {params.work} --out {output.rows} > {log} 2>&1"


rule audit_pole_effects:
    input:
        hazard="results/{site}/poles/hazard.parquet",
        effects=rules.plan_effects.output.effects,
        catalogue=CONFIG.effects_file,
        code=sources("audit_pole_effects"),
    output:
        rows="results/audit/poles/{site}.json",
    log:
        "logs/audit/poles/{site}.log",
    benchmark:
        "results/audit/benchmarks/poles/{site}.tsv"
    conda:
        ENVIRONMENT
    params:
        one_way=effects_of_one_way,
        config=config_of_audit,
        work="results/audit/variants/poles/{site}",
    shell:
        "python -m roadsight.stages.evidence.audit_pole_effects --site {wildcards.site}"
        " --effects {input.effects} --catalogue {input.catalogue:q} --config {params.config:q}"
        " {params.one_way} --work {params.work} --out {output.rows} > {log} 2>&1"


rule write_audit:
    input:
        rows=[
            *(f"results/audit/{site}.json" for site in audited_sites("placement")),
            *(f"results/audit/poles/{site}.json" for site in audited_sites("poles")),
        ],
        assets=REPORT_ASSETS,
        code=sources("write_audit"),
    output:
        csv="results/audit/audit.csv",
        table="results/audit/audit.md",
        page="results/audit/index.html",
    log:
        "logs/audit/write_audit.log",
    benchmark:
        "results/audit/benchmarks/write_audit.tsv"
    conda:
        ENVIRONMENT
    shell:
        "python -m roadsight.stages.evidence.write_audit --rows {input.rows} --csv {output.csv}"
        " --table {output.table} --page {output.page} > {log} 2>&1"
