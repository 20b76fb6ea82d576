"""roadsight: roadside LiDAR placement and pole mapping on one road scene."""


configfile: "config/config.yaml"


include: "workflow/rules/common.smk"
include: "workflow/rules/step.smk"
include: "workflow/rules/placement/placement_inputs.smk"
include: "workflow/rules/placement/targets_inputs.smk"
include: "workflow/rules/placement/poses_inputs.smk"
include: "workflow/rules/poles/poles_inputs.smk"
include: "workflow/rules/poles/videolog_inputs.smk"
include: "workflow/rules/poles/cameras_inputs.smk"
include: "workflow/rules/evidence/evidence_inputs.smk"
include: "workflow/rules/scene/effects_inputs.smk"
include: "workflow/rules/scene/pavement_inputs.smk"
include: "workflow/rules/evidence/audit_inputs.smk"
include: "workflow/rules/truth/truth_inputs.smk"
include: "workflow/rules/evidence/paper_inputs.smk"
include: "workflow/rules/scene/effects.smk"
include: "workflow/rules/scene/sample.smk"
include: "workflow/rules/scene/scene.smk"
include: "workflow/rules/scene/surfels.smk"
include: "workflow/rules/scene/road.smk"
include: "workflow/rules/placement/placement_effects.smk"
include: "workflow/rules/placement/placement.smk"
include: "workflow/rules/placement/depth_pairs.smk"
include: "workflow/rules/placement/poses.smk"
include: "workflow/rules/placement/cover.smk"
include: "workflow/rules/poles/videolog.smk"
include: "workflow/rules/poles/columns.smk"
include: "workflow/rules/poles/cameras.smk"
include: "workflow/rules/poles/poles.smk"
include: "workflow/rules/evidence/report.smk"
include: "workflow/rules/evidence/components.smk"
include: "workflow/rules/evidence/hardcases.smk"
include: "workflow/rules/evidence/evidence.smk"
include: "workflow/rules/evidence/audit.smk"
include: "workflow/rules/truth/truth.smk"
include: "workflow/rules/evidence/paper.smk"


rule all:
    default_target: True
    input:
        "results/report.html",
        printed_reports(),
        handovers(),
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


rule truth:
    input:
        rules.write_truth.output,
    localrule: True


rule paper:
    input:
        expand("results/paper/short.{kind}", kind=["csv", "html"]),
    localrule: True


rule paper_long:
    input:
        expand("results/paper/long.{kind}", kind=["csv", "html"]),
    localrule: True


rule report:
    input:
        "results/report.html",
        printed_reports(),
        handovers(),
    localrule: True


rule hardcases:
    input:
        "results/hardcases/hardcases.csv",
        "results/hardcases/index.html",
    localrule: True


complete_steps()
state_parameters()
