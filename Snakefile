"""roadsight: roadside LiDAR placement and pole mapping on one road scene."""


configfile: "config/config.yaml"


include: "workflow/rules/common.smk"
include: "workflow/rules/step.smk"
include: "workflow/rules/placement/placement_inputs.smk"
include: "workflow/rules/poles/poles_inputs.smk"
include: "workflow/rules/poles/videolog_inputs.smk"
include: "workflow/rules/evidence/evidence_inputs.smk"
include: "workflow/rules/scene/scene_inputs.smk"
include: "workflow/rules/truth/truth_inputs.smk"
include: "workflow/rules/scene/scene.smk"
include: "workflow/rules/placement/placement.smk"
include: "workflow/rules/placement/cover.smk"
include: "workflow/rules/poles/videolog.smk"
include: "workflow/rules/poles/poles.smk"
include: "workflow/rules/evidence/report.smk"
include: "workflow/rules/evidence/evidence.smk"
include: "workflow/rules/truth/truth.smk"


rule all:
    default_target: True
    input:
        "results/report.html",
        printed_reports(),
        handovers(),
        asked(["results/{site}/summary.json"]),
    localrule: True


SCENE_RESULTS = ["results/{site}/scene/pavement.gpkg", "results/{site}/placement/edges.gpkg"]
POLE_RESULTS = [
    f"results/{{site}}/poles/{f}" for f in ("poles.gpkg", "hazard.parquet", "page.json")
]
TARGETS = {
    "scene": asked(SCENE_RESULTS, "scene", "placement"),
    "placement": placement_results(),
    "poles": asked(POLE_RESULTS, "poles"),
    "tradeoffs": rules.write_tradeoffs.output,
    "audit": rules.write_audit.output,
    "truth": rules.write_truth.output,
    "paper": expand("results/paper/short.{kind}", kind=["csv", "html"]),
    "paper_long": expand("results/paper/long.{kind}", kind=["csv", "html"]),
    "report": ["results/report.html", *printed_reports(), *handovers()],
    "hardcases": rules.run_hardcases.output,
}
for target, files in TARGETS.items():

    rule:
        name:
            target
        input:
            files,
        localrule: True


complete_steps()
state_parameters()
