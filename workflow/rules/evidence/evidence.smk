"""What accuracy costs in time: the sweeps of config/tradeoffs.yaml through the rules themselves.

REQUIRED INPUTS  config/tradeoffs.yaml; finished results of the sites that it names
OUTPUTS          results/tradeoffs/: tradeoffs.csv, tradeoffs.md, index.html
"""


use rule step as measure_tradeoff with:
    input:
        base_files=base_of_study,
        code=sources_with(
            "measure_tradeoff",
            lambda wildcards: STUDIES[wildcards.study].levels[level_name(wildcards)],
        ),
    output:
        out="results/tradeoffs/levels/{study}-{level}.json",
    log:
        "logs/tradeoffs/{study}-{level}.log",
    benchmark:
        "results/tradeoffs/benchmarks/{study}-{level}.tsv"
    resources:
        mem_mb=4000,
    params:
        command=command_with("cores"),
        settings=told(
            site=site_of_study,
            config=lambda wildcards: config_of_study(wildcards),
            changes=lambda wildcards: json.dumps(changes_of_level(wildcards)),
            plan=plan_of_level,
            metrics=lambda wildcards: STUDIES[wildcards.study].metrics,
            stages=lambda wildcards: STUDIES[wildcards.study].stages,
            repeats=lambda wildcards: STUDIES[wildcards.study].repeats,
            work="results/tradeoffs/variants/{study}-{level}",
        ),


use rule step as measure_base with:
    input:
        base_files=lambda wildcards: base_at(TRADEOFFS.sites[wildcards.job]),
    output:
        out="results/tradeoffs/base/{job}.json",
    log:
        "logs/tradeoffs/base-{job}.log",
    benchmark:
        "results/tradeoffs/benchmarks/base-{job}.tsv"
    resources:
        mem_mb=4000,
    params:
        command=command_with("cores"),
        settings=told(
            site=lambda wildcards: site_of_job(wildcards.job),
            config=lambda wildcards: config_of_site(TRADEOFFS.sites[wildcards.job]),
            targets=lambda wildcards: targets_at(TRADEOFFS.sites[wildcards.job]),
            work="results/tradeoffs/variants/base-{job}",
        ),


use rule step as measure_precision with:
    input:
        cloud=f"results/{site_of_job('placement')}/sample/cloud.laz",
        frame=f"results/{site_of_job('placement')}/scene/frame.json",
    output:
        out="results/tradeoffs/precision.json",
    log:
        "logs/tradeoffs/measure_precision.log",
    benchmark:
        "results/tradeoffs/benchmarks/measure_precision.tsv"


use rule step as write_tradeoffs with:
    input:
        levels=measured_levels(),
        base=base_costs(),
        precision=rules.measure_precision.output.out,
        studies=CONFIG.tradeoffs_file,
        assets=REPORT_ASSETS,
    output:
        csv="results/tradeoffs/tradeoffs.csv",
        table="results/tradeoffs/tradeoffs.md",
        page="results/tradeoffs/index.html",
    log:
        "logs/tradeoffs/write_tradeoffs.log",
    benchmark:
        "results/tradeoffs/benchmarks/write_tradeoffs.tsv"
    params:
        settings=told(length_km=measured_length_km()),
