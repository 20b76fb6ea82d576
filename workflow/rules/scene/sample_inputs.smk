"""Options of generated scenes."""


def rural_options(wildcards):
    """Options of a rural scene that are not as usual."""
    sample = SITES[wildcards.site].site.sample
    options = [f"--relief {sample.relief}"] if sample.relief != 1 else []
    options += [f"--hfov-deg {sample.hfov_deg}"] if sample.hfov_deg else []
    moved = sample.principal_point_px
    options += [f"--principal-point-px {moved}"] if moved else []
    return " ".join(options + ([] if sample.side_views else ["--side-views no"]))


def rural_survey(wildcards):
    """Options of a rural scene's scan and positions, of which its images know nothing."""
    sample = SITES[wildcards.site].site.sample
    options = [f"--gps-drift-m {sample.gps_drift_m}"] if sample.gps_drift_m else []
    options += [] if sample.pole_returns else ["--pole-returns no"]
    usual = sample.class_scheme == "usual"
    return " ".join(
        options + ([] if usual else [f"--class-scheme {sample.class_scheme}"])
    )


def rural_lens(wildcards):
    """Distortion of the lenses, where they have any."""
    sample = SITES[wildcards.site].site.sample
    return f"--k1 {sample.k1} --k2 {sample.k2}" if sample.k1 or sample.k2 else ""
