"""Which physical effects each site simulates.

Decisions hang on what was measured: `profile_scene` is the one checkpoint of the placement job,
`profile_drive` that of the pole job. Before it has run, `snakemake -n` shows inputs that hang on a
decision as <TBD>; after it, the whole DAG.

REQUIRED INPUTS  results/{site}/scene/profile.json, frame.json, poles/drive.json; config/effects.yaml
OUTPUTS          results/{site}/effects.json
"""


use rule step as plan_effects with:
    input:
        profile="results/{site}/scene/profile.json",
        frame="results/{site}/scene/frame.json",
        drive=poles_only("results/{site}/poles/drive.json"),
        catalogue=CONFIG.effects_file,
    output:
        out="results/{site}/effects.json",
    params:
        settings=told(circumstances=circumstances_json),
