# Treadlight: from captures of a tire to its profile, its wear and a report.
# Rules hold wiring only; each stage's code is the package folder of the same name.
from snakemake.utils import min_version

min_version("9.0")


configfile: "config/config.yaml"


container: "docker://debian:12"


report: "workflow/report/workflow.rst"


include: "rules/common.smk"
include: "rules/inspect_capture.smk"
include: "rules/calibrate.smk"
include: "rules/detect_laser_pixels.smk"
include: "rules/triangulate.smk"
include: "rules/register_to_cylinder.smk"
include: "rules/photometric_stereo.smk"
include: "rules/integrate.smk"
include: "rules/wear.smk"
include: "rules/report.smk"
include: "rules/index.smk"
include: "rules/export.smk"


localrules:
    all,
    export,
    list_archive,


rule all:
    default_target: True
    input:
        f"{RESULTS}/index.html",


onsuccess:
    say_result()


onerror:
    say_failure(log)
