"""Depth maps in pairs, to train a network on a site's own cloud; only where they are asked for.

REQUIRED INPUTS  results/{site}/scene/cloud.parquet and candidates
OUTPUTS          results/{site}/placement/pairs/
"""


use rule step as render_depth_pairs with:
    input:
        candidates="results/{site}/placement/round-0/candidates.parquet",
        cloud=rules.ingest_cloud.output.cloud,
        traffic=traffic_mask,
    output:
        out=ensure("results/{site}/placement/pairs/{site}.hybrid.npz", non_empty=True),
    resources:
        mem_mb=megabytes(250),
        runtime=minutes(),
    params:
        settings=told(seed=setting("seed")),
