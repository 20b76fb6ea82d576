"""Physical effects of the placement job; a rule runs only where its effect is simulated.

REQUIRED INPUTS  candidates, DEM, edges, pavement, cloud; conditions in the settings
OUTPUTS          results/{site}/placement/effects/: rain, fog, reflectivity, lanes
                 results/{site}/placement/round-*/tilts.parquet
"""

from roadsight.base.sections.placement import Traffic


use rule step as tilt_mounts with:
    input:
        candidates="results/{site}/placement/round-{round}/candidates.parquet",
        dem=rules.build_dem.output.dem,
        frame=rules.ingest_cloud.output.frame,
    output:
        out=TILTS_OF_ROUND,
    params:
        settings=told(mounting=setting("lidar.mounting")),


use rule step as model_rain with:
    output:
        out="results/{site}/placement/effects/rain.json",
    params:
        settings=told(rain_mm_h=setting("conditions.rain_mm_h"), sensors=optical_names),


use rule step as model_fog with:
    output:
        out="results/{site}/placement/effects/fog.json",
    params:
        settings=told(
            visibility_m=setting("conditions.visibility_m"),
            wavelengths_nm=sensor_wavelengths,
        ),


use rule step as measure_reflectivity with:
    input:
        cloud=rules.ingest_cloud.output.cloud,
        frame=rules.ingest_cloud.output.frame,
        pavement=rules.extract_pavement.output.pavement,
    output:
        out="results/{site}/placement/effects/reflectivity.json",
        surfaces="results/{site}/placement/effects/surfaces.parquet",
    resources:
        mem_mb=megabytes(60),
    params:
        settings=told(
            sensors=CONFIG.sensors_file,
            names=sensor_names,
            target_reflectivity=setting("conditions.target_reflectivity"),
        ),
        definitions=site_sensors_seeing,


use rule step as trace_lanes with:
    input:
        edges=rules.build_edges.output.out,
        pavement=rules.extract_pavement.output.pavement,
        dem=rules.build_dem.output.dem,
        frame=rules.ingest_cloud.output.frame,
    output:
        out="results/{site}/placement/effects/lanes.parquet",
    params:
        settings=told(flags("conditions", Traffic), site=wildcard("site")),
