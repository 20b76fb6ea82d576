"""What all rules share: one line runs every stage. No step by itself."""


rule step:
    conda:
        ENVIRONMENT
    params:
        command=command,
        settings="",
    shell:
        STEP


# Steps that send rays, or hold all surfels.
use rule step as step_on_surfels with:
    resources:
        **holding_cloud(250),
