rule export:
    input:
        [
            f"{RESULTS}/exports/{capture}/{name}"
            for capture in ARCHIVE.measurements
            for name in EXPORTS
        ],
    message:
        "Everything is exported"


rule export_profile:
    input:
        profile=product("captures/{capture}/profile.zarr"),
    output:
        f"{RESULTS}/exports/{{capture}}/{{export}}",
    log:
        f"{RESULTS}/logs/export/{{capture}}/{{export}}.log",
    benchmark:
        f"{RESULTS}/benchmarks/export/{{capture}}/{{export}}.tsv"
    threads: 1
    resources:
        mem_mb=memory_of(400, fixed_mb=4000),
        runtime=60,
    params:
        format=lambda wildcards: EXPORTS[wildcards.export],
        settings=settings("export"),
        code=code_digest("treadlight.commands.export"),
    message:
        "Exporting {wildcards.export} of {wildcards.capture}"
    shell:
        "treadlight export {params.format} {input.profile:q} {output:q}"
        " --settings {params.settings:q} --code {params.code} --threads {threads} 2> {log:q}"
