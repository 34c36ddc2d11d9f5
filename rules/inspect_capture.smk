rule inspect_capture:
    output:
        product("captures/{capture}/inventory.json"),
    log:
        f"{RESULTS}/logs/inspect_capture/{{capture}}.log",
    benchmark:
        f"{RESULTS}/benchmarks/inspect_capture/{{capture}}.tsv"
    threads: 1
    resources:
        mem_mb=500,
        runtime=runtime_of(0.02, *MEASUREMENT_KINDS, *CALIBRATION_KINDS),
    params:
        folder=folder_of,
        frames=lambda wildcards: DIGESTS.of_frames(
            CAPTURES[wildcards.capture], CAPTURES[wildcards.capture].frames
        ),
        facts=facts_of,
        code=code_digest("treadlight.commands.inspect_capture"),
    message:
        "Inspecting {wildcards.capture}"
    shell:
        "treadlight inspect {params.folder:q} --code {params.code} --out {output:q} 2> {log:q}"
