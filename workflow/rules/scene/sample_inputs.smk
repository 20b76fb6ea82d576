"""Options of generated scenes."""


def rural_options(wildcards):
    """Options of a rural scene that are not as usual."""
    sample = SITES[wildcards.site].site.sample
    options = [f"--relief {sample.relief}"] if sample.relief != 1 else []
    options += [f"--hfov-deg {sample.hfov_deg}"] if sample.hfov_deg else []
    return " ".join(options + ([] if sample.side_views else ["--side-views no"]))


def rural_lens(wildcards):
    """Distortion of the lenses, where they have any."""
    sample = SITES[wildcards.site].site.sample
    return f"--k1 {sample.k1} --k2 {sample.k2}" if sample.k1 or sample.k2 else ""
