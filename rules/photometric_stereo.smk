rule photometric_stereo:
    input:
        calibration=calibration_of,
        illumination=illumination_of,
        surface=surface_of,
    output:
        product("captures/{capture}/{round}photometric.zarr/fov{view}"),
    log:
        f"{RESULTS}/logs/photometric_stereo/{{capture}}/{{round}}fov{{view}}.log",
    benchmark:
        f"{RESULTS}/benchmarks/photometric_stereo/{{capture}}/{{round}}fov{{view}}.tsv"
    threads: 1
    resources:
        mem_mb=memory_of(150),
        runtime=runtime_of(1, "led"),
    params:
        folder=folder_of,
        frames=frames_of_view,
        facts=facts_of,
        settings=settings("photometry"),
        code=code_digest("treadlight.commands.photometric_stereo"),
    message:
        "Photometric stereo of {wildcards.capture}, field of view {wildcards.view}"
    shell:
        "treadlight photometric-stereo {params.folder:q} --view {wildcards.view}"
        " --calibration {input.calibration:q} --illumination {input.illumination:q}"
        " --surface {input.surface:q} --settings {params.settings:q}"
        " --code {params.code} --threads {threads} --out {output:q} 2> {log:q}"
