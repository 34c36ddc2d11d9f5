rule report:
    input:
        wear=product("tires/{tire}/wear.zarr"),
        trend=product("tires/{tire}/trend.csv"),
        profiles=of_tire("profile.zarr"),
        quality=of_tire("quality.json"),
        calibration_files=calibration_files_of_tire,
    output:
        report(
            product("tires/{tire}/report.html"),
            caption="../workflow/report/tire.rst",
            category="Tires",
            labels={"tire": "{tire}", "shows": "maps, trend, irregular wear, quality"},
        ),
    log:
        f"{RESULTS}/logs/report/{{tire}}.log",
    benchmark:
        f"{RESULTS}/benchmarks/report/{{tire}}.tsv"
    threads: 1
    resources:
        mem_mb=of_largest(memory_of(100, fixed_mb=1500)),
        runtime=60,
    params:
        calibrations=lambda wildcards: [
            ARCHIVE.calibration_of[capture]
            for capture in ARCHIVE.tires[wildcards.tire]
        ],
        facts=lambda wildcards: facts_of_tire(wildcards.tire),
        settings=settings("wear"),
        code=code_digest("treadlight.commands.report"),
    message:
        "Writing the report of tire {wildcards.tire}"
    shell:
        "treadlight report {wildcards.tire} --wear {input.wear:q} --trend {input.trend:q}"
        " --profiles {input.profiles:q} --quality {input.quality:q}"
        " --calibrations {params.calibrations:q} --calibration-files {input.calibration_files:q}"
        " --facts {params.facts:q} --settings {params.settings:q} --code {params.code}"
        " --out {output:q} 2> {log:q}"
