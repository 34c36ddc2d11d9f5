rule triangulate:
    input:
        pixels=product("captures/{capture}/laser_pixels.zarr"),
        calibration=calibration_of,
    output:
        product("captures/{capture}/laser_points.zarr"),
    log:
        f"{RESULTS}/logs/triangulate/{{capture}}.log",
    benchmark:
        f"{RESULTS}/benchmarks/triangulate/{{capture}}.tsv"
    threads: 1
    resources:
        mem_mb=memory_of(20),
        runtime=runtime_of(0.02, "laser"),
    params:
        folder=folder_of,
        facts=facts_of,
        code=code_digest("treadlight.commands.triangulate"),
    message:
        "Triangulating the laser sections of {wildcards.capture}"
    shell:
        "treadlight triangulate {input.pixels:q} --capture {params.folder:q}"
        " --calibration {input.calibration:q} --code {params.code} --threads {threads}"
        " --out {output:q} 2> {log:q}"
