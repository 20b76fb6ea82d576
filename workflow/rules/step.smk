"""What all rules share: one line runs every stage. No step by itself."""


rule step:
    conda:
        ENVIRONMENT
    params:
        command=command,
        settings="",
    shell:
        STEP
