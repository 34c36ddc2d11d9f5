rule detect_laser_pixels:
    output:
        product("captures/{capture}/laser_pixels.zarr"),
    log:
        f"{RESULTS}/logs/detect_laser_pixels/{{capture}}.log",
    benchmark:
        f"{RESULTS}/benchmarks/detect_laser_pixels/{{capture}}.tsv"
    threads: 1
    resources:
        mem_mb=memory_of(60),
        runtime=runtime_of(0.15, "laser"),
    params:
        folder=folder_of,
        frames=frames_of("laser", "dark"),
        facts=facts_of,
        code=code_digest("treadlight.commands.detect_laser_pixels"),
    message:
        "Detecting the laser pixels of {wildcards.capture}"
    shell:
        "treadlight detect-laser-pixels {params.folder:q}"
        " --code {params.code} --threads {threads} --out {output:q} 2> {log:q}"
