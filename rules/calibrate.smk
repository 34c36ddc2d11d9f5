rule calibrate_camera:
    output:
        product("calibrations/{calibration}/camera.json"),
    log:
        f"{RESULTS}/logs/calibrate_camera/{{calibration}}.log",
    benchmark:
        f"{RESULTS}/benchmarks/calibrate_camera/{{calibration}}.tsv"
    threads: 1
    resources:
        mem_mb=memory_of(100),
        runtime=runtime_of(0.5, "board", "reference_board", "dark"),
    params:
        folder=folder_of,
        frames=frames_of("board", "reference_board", "dark"),
        facts=facts_of,
        code=code_digest("treadlight.commands.calibrate_camera"),
    message:
        "Calibrating the camera of {wildcards.calibration}"
    shell:
        "treadlight calibrate-camera {params.folder:q}"
        " --code {params.code} --out {output:q} 2> {log:q}"


rule calibrate_laser_plane:
    input:
        camera=product("calibrations/{calibration}/camera.json"),
    output:
        product("calibrations/{calibration}/laser_plane.json"),
    log:
        f"{RESULTS}/logs/calibrate_laser_plane/{{calibration}}.log",
    benchmark:
        f"{RESULTS}/benchmarks/calibrate_laser_plane/{{calibration}}.tsv"
    threads: 1
    resources:
        mem_mb=memory_of(100),
        runtime=runtime_of(0.5, "board", "board_laser", "dark"),
    params:
        folder=folder_of,
        frames=frames_of("board", "board_laser", "dark"),
        facts=facts_of,
        code=code_digest("treadlight.commands.calibrate_laser_plane"),
    message:
        "Calibrating the laser plane of {wildcards.calibration}"
    shell:
        "treadlight calibrate-laser-plane {params.folder:q} --camera {input.camera:q}"
        " --code {params.code} --out {output:q} 2> {log:q}"


rule calibrate_axis:
    input:
        camera=product("calibrations/{calibration}/camera.json"),
    output:
        product("calibrations/{calibration}/axis.json"),
    log:
        f"{RESULTS}/logs/calibrate_axis/{{calibration}}.log",
    benchmark:
        f"{RESULTS}/benchmarks/calibrate_axis/{{calibration}}.tsv"
    threads: 1
    resources:
        mem_mb=memory_of(100),
        runtime=runtime_of(0.5, "axis_board", "dark"),
    params:
        folder=folder_of,
        frames=frames_of("axis_board", "dark"),
        facts=facts_of,
        code=code_digest("treadlight.commands.calibrate_axis"),
    message:
        "Calibrating the rotation axis of {wildcards.calibration}"
    shell:
        "treadlight calibrate-axis {params.folder:q} --camera {input.camera:q}"
        " --code {params.code} --out {output:q} 2> {log:q}"


rule calibrate_leds:
    input:
        camera=product("calibrations/{calibration}/camera.json"),
    output:
        product("calibrations/{calibration}/leds.json"),
    log:
        f"{RESULTS}/logs/calibrate_leds/{{calibration}}.log",
    benchmark:
        f"{RESULTS}/benchmarks/calibrate_leds/{{calibration}}.tsv"
    threads: 1
    resources:
        mem_mb=memory_of(400),
        runtime=runtime_of(0.5, "balls", "card", "dark"),
    params:
        folder=folder_of,
        frames=frames_of("balls", "card", "dark"),
        facts=facts_of,
        code=code_digest("treadlight.commands.calibrate_leds"),
    message:
        "Calibrating the LED positions of {wildcards.calibration}"
    shell:
        "treadlight calibrate-leds {params.folder:q} --camera {input.camera:q}"
        " --code {params.code} --out {output:q} 2> {log:q}"


rule calibrate:
    input:
        camera=product("calibrations/{calibration}/camera.json"),
        laser_plane=product("calibrations/{calibration}/laser_plane.json"),
        axis=product("calibrations/{calibration}/axis.json"),
        leds=product("calibrations/{calibration}/leds.json"),
    output:
        product("calibrations/{calibration}/calibration.json"),
    log:
        f"{RESULTS}/logs/calibrate/{{calibration}}.log",
    benchmark:
        f"{RESULTS}/benchmarks/calibrate/{{calibration}}.tsv"
    threads: 1
    resources:
        mem_mb=500,
        runtime=15,
    params:
        folder=folder_of,
        facts=facts_of,
        code=code_digest("treadlight.commands.calibrate"),
    message:
        "Gathering the calibration of {wildcards.calibration}"
    shell:
        "treadlight calibrate {params.folder:q} --camera {input.camera:q} --laser-plane {input.laser_plane:q}"
        " --axis {input.axis:q} --leds {input.leds:q}"
        " --code {params.code} --out {output:q} 2> {log:q}"


rule calibrate_illumination:
    input:
        calibration=product("calibrations/{calibration}/calibration.json"),
    output:
        product("calibrations/{calibration}/illumination.zarr"),
    log:
        f"{RESULTS}/logs/calibrate_illumination/{{calibration}}.log",
    benchmark:
        f"{RESULTS}/benchmarks/calibrate_illumination/{{calibration}}.tsv"
    threads: 1
    resources:
        mem_mb=memory_of(400),
        runtime=runtime_of(0.5, "card", "dark"),
    params:
        folder=folder_of,
        frames=frames_of("card", "dark"),
        facts=facts_of,
        code=code_digest("treadlight.commands.calibrate_illumination"),
    message:
        "Calibrating the illumination of {wildcards.calibration}"
    shell:
        "treadlight calibrate-illumination {params.folder:q} --calibration {input.calibration:q}"
        " --code {params.code} --out {output:q} 2> {log:q}"
