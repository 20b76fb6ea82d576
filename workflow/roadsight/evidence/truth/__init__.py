"""The product on real data beside a peer: what `snakemake truth` measures."""
