"""A project whose workflow takes a second: four steps and one that joins them."""

import shutil

from tests.conftest import PROJECT

ROOT = PROJECT
SNAKEFILE = """\
wildcard_constraints:
    n=r"\\d"


rule all:
    default_target: True
    input:
        "results/small/joined.txt",
    localrule: True


rule poles:
    input:
        expand("results/small/{n}.txt", n=range(4)),
    localrule: True


rule count_steps:
    input:
        "given.txt",
    output:
        "results/small/{n}.txt",
    log:
        "logs/small/count_steps_{n}.log",
    benchmark:
        "results/small/benchmarks/{n}/count_steps.tsv"
    params:
        word="first",
    shell:
        "(echo begins {wildcards.n};"
        " if [ -e fail ] && [ {wildcards.n} = 2 ]; then echo 'the <b>reason</b>'; false; fi;"
        " if [ -e slow ]; then sleep 60; fi; echo {params.word} > {output}) > {log} 2>&1"


rule join_steps:
    input:
        expand("results/small/{n}.txt", n=range(4)),
    output:
        "results/small/joined.txt",
    log:
        "logs/small/join_steps.log",
    benchmark:
        "results/small/benchmarks/join_steps.tsv"
    shell:
        "cat {input} > {output} 2> {log}"
"""
SITE = "site: small\ntitle: Small\njobs: [scene]\nclouds: [road.laz]\n"


def without_sites(folder):
    """Write a project that has the configuration, no site and no rule, and return its folder."""
    ignored = shutil.ignore_patterns("sites")
    shutil.copytree(ROOT / "config", folder / "config", ignore=ignored, dirs_exist_ok=True)
    (folder / "config" / "sites").mkdir()
    (folder / "Snakefile").touch()
    return folder


def small_project(folder):
    """Write the project into a folder, and return the folder."""
    without_sites(folder)
    (folder / "config" / "config.yaml").write_text("sites: [small]\n")
    (folder / "config" / "sites" / "small.yaml").write_text(SITE)
    (folder / "Snakefile").write_text(SNAKEFILE)
    (folder / "given.txt").write_text("given\n")
    return folder
