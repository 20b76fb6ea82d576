"""What the workflow says of itself: trade-offs, hard cases, audits of effects, both studies."""


# What accuracy costs in time: the sweeps of config/tradeoffs.yaml through the rules themselves.
use rule step as measure_tradeoff with:
    input:
        base_files=at_base(base_at),
        code=sources_with(
            "measure_tradeoff",
            lambda wildcards: study_of(wildcards).levels[level_name(wildcards)],
        ),
    output:
        out="results/tradeoffs/levels/{study}-{level}.json",
    log:
        "logs/tradeoffs/{study}-{level}.log",
    resources:
        mem_mb=4000,
    params:
        command=command_with("cores"),
        settings=told(
            site=at_base(site_named),
            config=at_base(config_of_site),
            changes=lambda wildcards: json.dumps(
                clearly(study_of(wildcards).changes, level_name(wildcards))
            ),
            plan=lambda wildcards: study_of(wildcards).plan(level_name(wildcards)),
            metrics=lambda wildcards: study_of(wildcards).metrics,
            stages=lambda wildcards: study_of(wildcards).stages,
            repeats=lambda wildcards: study_of(wildcards).repeats,
            work="results/tradeoffs/variants/{study}-{level}",
        ),


use rule measure_tradeoff as measure_base with:
    input:
        base_files=at_base(base_at),
    output:
        out="results/tradeoffs/base/{job}.json",
    log:
        "logs/tradeoffs/base-{job}.log",
    params:
        settings=told(
            site=at_base(site_named),
            config=at_base(config_of_site),
            targets=at_base(targets_at),
            work="results/tradeoffs/variants/base-{job}",
        ),


use rule step as measure_precision with:
    input:
        cloud=f"results/{site_of_job('placement')}/sample/cloud.laz",
        frame=f"results/{site_of_job('placement')}/scene/frame.json",
    output:
        out="results/tradeoffs/precision.json",


use rule step as write_tradeoffs with:
    input:
        levels=[
            f"results/tradeoffs/levels/{name}-{level}.json"
            for name, study in STUDIES.items()
            for level in range(len(study.levels))
        ],
        base=[
            f"results/tradeoffs/base/{job}.json"
            for job in dict.fromkeys(study.job for study in STUDIES.values())
        ],
        precision=rules.measure_precision.output.out,
        studies=CONFIG.tradeoffs_file,
        assets=REPORT_ASSETS,
    output:
        csv="results/tradeoffs/tradeoffs.csv",
        table="results/tradeoffs/tradeoffs.md",
        page="results/tradeoffs/index.html",
    params:
        settings=told(length_km=SITES[site_of_job("poles")].site.sample.length_m / 1000),


# Where naive ways fail: the catalogue of hard cases, run both ways.
use rule step as run_hardcases with:
    input:
        assets=[path for path in REPORT_ASSETS if path.endswith((".css", "hardcases.html.j2"))],
    output:
        table="results/hardcases/hardcases.csv",
        page="results/hardcases/index.html",
    log:
        "logs/run_hardcases.log",
    resources:
        mem_mb=1500,
    params:
        settings=told(seed=CONFIG.seed),


# How far decisions on effects were right: sites with `effects: audit` are run both ways.
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


# Tables and figures of both studies: published, ours as published, ours by default.
use rule measure_tradeoff as measure_paper with:
    input:
        base_files=base_of_paper,
    output:
        out="results/paper/runs/{size}/{run}.json",
    log:
        "logs/paper/{size}/{run}.log",
    params:
        settings=told(
            site=site_of_paper,
            config=config_of_paper,
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
    params:
        settings=told(size=wildcard("size")),
