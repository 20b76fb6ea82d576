"""What accuracy costs in time: the sweeps of config/tradeoffs.yaml through the rules themselves.

REQUIRED INPUTS  config/tradeoffs.yaml; finished results of the sites that it names
OUTPUTS          results/tradeoffs/: tradeoffs.csv, tradeoffs.md, index.html
"""


rule measure_tradeoff:
    input:
        base=base_of_study,
        code=sources_with(
            "measure_tradeoff",
            lambda wildcards: STUDIES[wildcards.study].levels[level_name(wildcards)],
        ),
    output:
        level="results/tradeoffs/levels/{study}-{level}.json",
    log:
        "logs/tradeoffs/{study}-{level}.log",
    benchmark:
        "results/tradeoffs/benchmarks/{study}-{level}.tsv"
    conda:
        ENVIRONMENT
    resources:
        mem_mb=4000,
    params:
        site=site_of_study,
        config=lambda wildcards: config_of_study(wildcards),
        changes=lambda wildcards: json.dumps(changes_of_level(wildcards)),
        plan=plan_of_level,
        metrics=lambda wildcards: STUDIES[wildcards.study].metrics,
        stages=lambda wildcards: STUDIES[wildcards.study].stages,
        repeats=lambda wildcards: STUDIES[wildcards.study].repeats,
        work="results/tradeoffs/variants/{study}-{level}",
    shell:
        "python -m roadsight.stages.evidence.measure_tradeoff --site {params.site}"
        " --config {params.config:q} --changes {params.changes:q}"
        " --plan={params.plan:q} --metrics {params.metrics} --stages {params.stages}"
        " --repeats {params.repeats}"
        " --cores {threads} --work {params.work} --out {output.level} > {log} 2>&1"


rule measure_base:
    input:
        base=lambda wildcards: base_at(TRADEOFFS.sites[wildcards.job]),
        code=sources("measure_base"),
    output:
        costs="results/tradeoffs/base/{job}.json",
    log:
        "logs/tradeoffs/base-{job}.log",
    benchmark:
        "results/tradeoffs/benchmarks/base-{job}.tsv"
    conda:
        ENVIRONMENT
    resources:
        mem_mb=4000,
    params:
        site=lambda wildcards: site_of_job(wildcards.job),
        config=lambda wildcards: config_of_site(TRADEOFFS.sites[wildcards.job]),
        targets=lambda wildcards: targets_at(TRADEOFFS.sites[wildcards.job]),
        work="results/tradeoffs/variants/base-{job}",
    shell:
        "python -m roadsight.stages.evidence.measure_base --site {params.site}"
        " --config {params.config:q} --targets {params.targets} --cores {threads}"
        " --work {params.work} --out {output.costs} > {log} 2>&1"


rule measure_precision:
    input:
        cloud=f"results/{site_of_job('placement')}/sample/cloud.laz",
        frame=f"results/{site_of_job('placement')}/scene/frame.json",
        code=sources("measure_precision"),
    output:
        precision="results/tradeoffs/precision.json",
    log:
        "logs/tradeoffs/measure_precision.log",
    benchmark:
        "results/tradeoffs/benchmarks/measure_precision.tsv"
    conda:
        ENVIRONMENT
    shell:
        "python -m roadsight.stages.evidence.measure_precision --cloud {input.cloud}"
        " --frame {input.frame} --out {output.precision} > {log} 2>&1"


rule write_tradeoffs:
    input:
        levels=measured_levels(),
        base=base_costs(),
        precision=rules.measure_precision.output.precision,
        studies=CONFIG.tradeoffs_file,
        assets=REPORT_ASSETS,
        code=sources("write_tradeoffs"),
    output:
        csv="results/tradeoffs/tradeoffs.csv",
        table="results/tradeoffs/tradeoffs.md",
        page="results/tradeoffs/index.html",
    log:
        "logs/tradeoffs/write_tradeoffs.log",
    benchmark:
        "results/tradeoffs/benchmarks/write_tradeoffs.tsv"
    conda:
        ENVIRONMENT
    params:
        length_km=measured_length_km(),
    shell:
        "python -m roadsight.stages.evidence.write_tradeoffs --studies {input.studies}"
        " --levels {input.levels} --base {input.base} --precision {input.precision} --length-km {params.length_km} --csv {output.csv}"
        " --table {output.table} --page {output.page} > {log} 2>&1"
