rule wear:
    input:
        profiles=of_tire("profile.zarr"),
    output:
        wear=product("tires/{tire}/wear.zarr"),
        trend=report(
            product("tires/{tire}/trend.csv"),
            caption="../workflow/report/trend.rst",
            category="Numbers",
            labels={"tire": "{tire}", "shows": "depth, wear, rate"},
        ),
    log:
        f"{RESULTS}/logs/wear/{{tire}}.log",
    benchmark:
        f"{RESULTS}/benchmarks/wear/{{tire}}.tsv"
    threads: 1
    resources:
        mem_mb=of_largest(memory_of(1500)),
        runtime=of_largest(runtime_of(0.1, "laser", "led")),
    params:
        settings=settings("wear"),
        code=code_digest("treadlight.commands.wear"),
    message:
        "Comparing the mileages of tire {wildcards.tire}"
    shell:
        "treadlight wear {wildcards.tire} {input.profiles:q} --settings {params.settings:q}"
        " --code {params.code} --threads {threads}"
        " --out {output.wear:q} --trend {output.trend:q} 2> {log:q}"
