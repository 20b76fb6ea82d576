"""The product on real data beside a peer: tables and a page.

REQUIRED INPUTS  the data under ROADSIGHT_DATA
OUTPUTS          results/truth/: truth.csv, index.html
"""


rule truth_ground:
    input:
        files=truth_files("ground"),
        code=sources("truth_ground"),
    output:
        figures="results/truth/ground/{dataset}.json",
    log:
        "logs/truth/ground-{dataset}.log",
    benchmark:
        "results/truth/benchmarks/ground-{dataset}.tsv"
    wildcard_constraints:
        dataset=truth_datasets("ground"),
    conda:
        ENVIRONMENT
    resources:
        mem_mb=4000,
    params:
        sha256=truth_checksums("ground"),
        missing=truth_missing("ground"),
    shell:
        "python -m roadsight.stages.truth.truth_ground --dataset {wildcards.dataset}"
        " --files {input.files:q} --missing {params.missing:q} --out {output.figures} > {log} 2>&1"


rule truth_pavement:
    input:
        files=truth_files("pavement"),
        code=sources("truth_pavement"),
    output:
        figures="results/truth/pavement/{dataset}.json",
    log:
        "logs/truth/pavement-{dataset}.log",
    benchmark:
        "results/truth/benchmarks/pavement-{dataset}.tsv"
    wildcard_constraints:
        dataset=truth_datasets("pavement"),
    conda:
        ENVIRONMENT
    resources:
        mem_mb=4000,
    params:
        sha256=truth_checksums("pavement"),
        missing=truth_missing("pavement"),
    shell:
        "python -m roadsight.stages.truth.truth_pavement --dataset {wildcards.dataset}"
        " --files {input.files:q} --missing {params.missing:q} --out {output.figures} > {log} 2>&1"


rule truth_edges:
    input:
        files=truth_files("edges"),
        code=sources("truth_edges"),
    output:
        figures="results/truth/edges/{dataset}.json",
    log:
        "logs/truth/edges-{dataset}.log",
    benchmark:
        "results/truth/benchmarks/edges-{dataset}.tsv"
    wildcard_constraints:
        dataset=truth_datasets("edges"),
    conda:
        ENVIRONMENT
    resources:
        mem_mb=4000,
    params:
        sha256=truth_checksums("edges"),
        missing=truth_missing("edges"),
    shell:
        "python -m roadsight.stages.truth.truth_edges --dataset {wildcards.dataset}"
        " --files {input.files:q} --missing {params.missing:q} --out {output.figures} > {log} 2>&1"


rule truth_depth:
    input:
        files=truth_files("depth"),
        code=sources("truth_depth"),
    output:
        figures="results/truth/depth/{dataset}.json",
    log:
        "logs/truth/depth-{dataset}.log",
    benchmark:
        "results/truth/benchmarks/depth-{dataset}.tsv"
    wildcard_constraints:
        dataset=truth_datasets("depth"),
    conda:
        ENVIRONMENT
    resources:
        mem_mb=4000,
    params:
        sha256=truth_checksums("depth"),
        missing=truth_missing("depth"),
    shell:
        "python -m roadsight.stages.truth.truth_depth --dataset {wildcards.dataset}"
        " --files {input.files:q} --missing {params.missing:q} --out {output.figures} > {log} 2>&1"


rule truth_alignment:
    input:
        files=truth_files("alignment"),
        code=sources("truth_alignment"),
    output:
        figures="results/truth/alignment/{dataset}.json",
    log:
        "logs/truth/alignment-{dataset}.log",
    benchmark:
        "results/truth/benchmarks/alignment-{dataset}.tsv"
    wildcard_constraints:
        dataset=truth_datasets("alignment"),
    conda:
        ENVIRONMENT
    resources:
        mem_mb=4000,
    params:
        sha256=truth_checksums("alignment"),
        missing=truth_missing("alignment"),
    shell:
        "python -m roadsight.stages.truth.truth_alignment --dataset {wildcards.dataset}"
        " --files {input.files:q} --missing {params.missing:q} --out {output.figures} > {log} 2>&1"


rule truth_sightings:
    input:
        files=truth_files("sightings"),
        code=sources("truth_sightings"),
    output:
        figures="results/truth/sightings/{dataset}.json",
    log:
        "logs/truth/sightings-{dataset}.log",
    benchmark:
        "results/truth/benchmarks/sightings-{dataset}.tsv"
    wildcard_constraints:
        dataset=truth_datasets("sightings"),
    conda:
        ENVIRONMENT
    resources:
        mem_mb=4000,
    params:
        sha256=truth_checksums("sightings"),
        missing=truth_missing("sightings"),
    shell:
        "python -m roadsight.stages.truth.truth_sightings --dataset {wildcards.dataset}"
        " --files {input.files:q} --missing {params.missing:q} --out {output.figures} > {log} 2>&1"


rule truth_cover:
    input:
        files=truth_files("cover"),
        code=sources("truth_cover"),
    output:
        figures="results/truth/cover/{dataset}.json",
    log:
        "logs/truth/cover-{dataset}.log",
    benchmark:
        "results/truth/benchmarks/cover-{dataset}.tsv"
    wildcard_constraints:
        dataset=truth_datasets("cover"),
    conda:
        ENVIRONMENT
    resources:
        mem_mb=4000,
    params:
        sha256=truth_checksums("cover"),
        missing=truth_missing("cover"),
    shell:
        "python -m roadsight.stages.truth.truth_cover --dataset {wildcards.dataset}"
        " --files {input.files:q} --missing {params.missing:q} --out {output.figures} > {log} 2>&1"


rule write_truth:
    input:
        figures=truth_figures(),
        assets=REPORT_ASSETS,
        code=sources("write_truth"),
    output:
        csv="results/truth/truth.csv",
        page="results/truth/index.html",
    log:
        "logs/truth/write_truth.log",
    benchmark:
        "results/truth/benchmarks/write_truth.tsv"
    conda:
        ENVIRONMENT
    shell:
        "python -m roadsight.stages.truth.write_truth --figures {input.figures}"
        " --csv {output.csv} --page {output.page} > {log} 2>&1"
