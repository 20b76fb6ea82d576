"""From sightings to poles: pairs of rays, groups of rays, the choice among groups, errors."""
