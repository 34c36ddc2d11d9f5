rule list_archive:
    output:
        product("archive.json"),
    log:
        f"{RESULTS}/logs/list_archive.log",
    threads: 1
    params:
        state=archive_state(),
    message:
        "Listing the archive"
    run:
        # Too long for a command line where the archive is large.
        store.write_text(Path(output[0]), params.state)


rule index:
    input:
        state=product("archive.json"),
        reports=[product(f"tires/{tire}/report.html") for tire in ARCHIVE.tires],
        inventories=[
            product(f"captures/{capture}/inventory.json") for capture in CAPTURES
        ],
        calibrations=[
            product(f"calibrations/{calibration}/{name}")
            for calibration in ARCHIVE.calibrations
            for name in ("calibration.json", "illumination.zarr")
        ],
    output:
        index=report(
            product("index.html"),
            caption="../workflow/report/index.rst",
            category="Archive",
            labels={"shows": "every tire and capture"},
        ),
        products=product("products.json"),
    log:
        f"{RESULTS}/logs/index.log",
    benchmark:
        f"{RESULTS}/benchmarks/index.tsv"
    threads: 1
    resources:
        mem_mb=1000,
        runtime=60,
    params:
        results=lambda wildcards, input: os.path.dirname(input.state),
        code=code_digest("treadlight.commands.index"),
    message:
        "Writing the archive's page"
    shell:
        "treadlight index --results {params.results:q} --archive-state {input.state:q}"
        " --code {params.code} --out {output.index:q} --products {output.products:q} 2> {log:q}"
