"""roadsight: roadside LiDAR placement and pole mapping on one road scene."""


configfile: "config/config.yaml"


include: "workflow/rules/common.smk"
include: "workflow/rules/placement_inputs.smk"
include: "workflow/rules/targets_inputs.smk"
include: "workflow/rules/poses_inputs.smk"
include: "workflow/rules/poles_inputs.smk"
include: "workflow/rules/videolog_inputs.smk"
include: "workflow/rules/cameras_inputs.smk"
include: "workflow/rules/evidence_inputs.smk"
include: "workflow/rules/effects_inputs.smk"
include: "workflow/rules/sample_inputs.smk"
include: "workflow/rules/audit_inputs.smk"
include: "workflow/rules/effects.smk"
include: "workflow/rules/sample.smk"
include: "workflow/rules/scene.smk"
include: "workflow/rules/placement_effects.smk"
include: "workflow/rules/placement.smk"
include: "workflow/rules/depth_pairs.smk"
include: "workflow/rules/poses.smk"
include: "workflow/rules/cover.smk"
include: "workflow/rules/road.smk"
include: "workflow/rules/videolog.smk"
include: "workflow/rules/cameras.smk"
include: "workflow/rules/report.smk"
include: "workflow/rules/poles.smk"
include: "workflow/rules/hardcases.smk"
include: "workflow/rules/evidence.smk"
include: "workflow/rules/audit.smk"


rule all:
    default_target: True
    input:
        "results/report.html",
        summaries(),
    localrule: True


rule scene:
    input:
        scene_results(),
    localrule: True


rule placement:
    input:
        placement_results(),
    localrule: True


rule poles:
    input:
        pole_results(),
    localrule: True


rule tradeoffs:
    input:
        rules.write_tradeoffs.output,
    localrule: True


rule audit:
    input:
        rules.write_audit.output,
    localrule: True


rule report:
    input:
        "results/report.html",
    localrule: True


rule hardcases:
    input:
        "results/hardcases/hardcases.csv",
        "results/hardcases/index.html",
    localrule: True
