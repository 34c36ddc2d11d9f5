rule integrate:
    input:
        calibration=calibration_of,
        surface=product("captures/{capture}/surface.zarr"),
        laser=product("captures/{capture}/laser.zarr"),
        views=views_of,
    output:
        profile=product("captures/{capture}/{round}profile.zarr"),
        quality=report(
            product("captures/{capture}/{round}quality.json"),
            caption="../workflow/report/quality.rst",
            category="Numbers",
            labels={"capture": "{capture}", "shows": "quality"},
        ),
    log:
        f"{RESULTS}/logs/integrate/{{capture}}/{{round}}integrate.log",
    benchmark:
        f"{RESULTS}/benchmarks/integrate/{{capture}}/{{round}}integrate.tsv"
    threads: 1
    resources:
        mem_mb=memory_of(2500, most_mb=memory_of_cells(350)),
        runtime=runtime_of(0.5, "laser", "led"),
    params:
        folder=folder_of,
        facts=facts_of,
        warnings=warnings_of,
        settings=settings("integrate"),
        code=code_digest("treadlight.commands.integrate"),
    message:
        "Integrating the surface of {wildcards.capture}"
    shell:
        "treadlight integrate {params.folder:q} --calibration {input.calibration:q}"
        " --surface {input.surface:q} --laser {input.laser:q} --views {input.views:q}"
        " {params.warnings:q} --settings {params.settings:q}"
        " --code {params.code} --threads {threads}"
        " --out {output.profile:q} --quality {output.quality:q} 2> {log:q}"
