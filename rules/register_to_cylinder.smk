rule register_to_cylinder:
    input:
        points=product("captures/{capture}/laser_points.zarr"),
        calibration=calibration_of,
    output:
        laser=product("captures/{capture}/laser.zarr"),
        surface=product("captures/{capture}/surface.zarr"),
    log:
        f"{RESULTS}/logs/register_to_cylinder/{{capture}}.log",
    benchmark:
        f"{RESULTS}/benchmarks/register_to_cylinder/{{capture}}.tsv"
    threads: 1
    resources:
        mem_mb=memory_of(800),
        runtime=runtime_of(0.1, "laser"),
    params:
        folder=folder_of,
        facts=facts_of,
        settings=settings("register_to_cylinder"),
        code=code_digest("treadlight.commands.register_to_cylinder"),
    message:
        "Registering the laser sections of {wildcards.capture} to the cylinder"
    shell:
        "treadlight register-to-cylinder {input.points:q} --capture {params.folder:q}"
        " --calibration {input.calibration:q} --settings {params.settings:q}"
        " --code {params.code} --threads {threads}"
        " --out {output.laser:q} --surface {output.surface:q} 2> {log:q}"
