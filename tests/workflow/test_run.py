"""The whole way on a tiny archive: products, bits, refusals, recovery."""

import hashlib
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
import yaml


def stores(results: Path) -> dict[str, str]:
    """SHA-256 of every file of every zarr store, by name."""
    return {
        path.relative_to(results).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(results.rglob("*"))
        if path.is_file() and ".zarr/" in path.as_posix() and ".snakemake" not in path.name
    }


@pytest.fixture
def project(processed, tmp_path):
    return processed.copy(tmp_path / "p")


def test_every_product_of_the_contract_is_there(processed):
    results = processed.results
    calibration = next((results / "calibrations").iterdir())
    tire = next((results / "tires").iterdir())
    for path in (
        calibration / "calibration.json",
        calibration / "illumination.zarr/zarr.json",
        tire / "wear.zarr/zarr.json",
        tire / "trend.csv",
        tire / "report.html",
        results / "index.html",
        results / "products.json",
    ):
        assert path.is_file()
        provenance = path.parent if path.name == "zarr.json" else path
        assert (
            path.name in ("products.json", "index.html")
            or provenance.with_name(provenance.name + ".provenance.json").is_file()
        )
    for manifest in processed.archive.glob("**/capture.yaml"):
        facts = yaml.safe_load(manifest.read_text())
        if facts["kind"] == "measurement":
            folder = results / "captures" / facts["capture"]
            profile = xr.open_zarr(folder / "profile.zarr", consolidated=False)
            assert set(profile.dims) >= {"theta", "z"}
            assert np.isfinite(profile.r).any()
            assert json.loads((folder / "quality.json").read_text())["laser_points"] > 0
            assert (folder / "laser.zarr/zarr.json").is_file()
            assert (folder / "photometric.zarr/fov00/zarr.json").is_file()


def test_no_process_of_a_run_asks_for_a_network(processed, project):
    assert not processed.network_log.exists()
    asked = project.run(
        "python", "-c", "import socket; socket.create_connection(('127.0.0.1', 9))", check=False
    )
    assert "no network in this run" in asked.stderr
    assert "socket.getaddrinfo" in project.network_log.read_text()


def test_one_core_and_two_give_the_same_bits(processed, project):
    before = stores(project.results)
    assert len(before) > 50
    shutil.rmtree(project.results)
    project.snakemake("--cores", "1")
    assert stores(project.results) == before


def test_a_second_run_has_nothing_to_do(processed):
    done = processed.snakemake()
    assert "Nothing to be done" in done.stdout + done.stderr


def test_a_wrong_config_stops_everything_with_one_sentence(project):
    config = project.folder / "config/config.yaml"
    config.write_text(config.read_text() + "integrate: {held_out_evry: 4}\n")
    done = project.snakemake(check=False)
    assert done.returncode == 1
    text = done.stdout + done.stderr
    assert (
        "'integrate.held_out_evry' is no key of the config. Did you mean 'held_out_every'?" in text
    )
    assert "Traceback" not in text


def test_bad_captures_are_refused_and_the_others_finish(project):
    manifests = sorted(project.archive.glob("**/capture.yaml"))
    measured = [m for m in manifests if yaml.safe_load(m.read_text())["kind"] == "measurement"]
    bad = shutil.copytree(measured[0].parent, project.archive / "bad-manifest")
    text = (bad / "capture.yaml").read_text()
    (bad / "capture.yaml").write_text(text.replace("capture: ", "capture: bad-manifest #"))
    rows = (bad / "frames.csv").read_text().splitlines()
    fields = rows[1].split(",")
    fields[1] = "lazer"
    (bad / "frames.csv").write_text("\n".join([rows[0], ",".join(fields), *rows[2:]]))
    broken = shutil.copytree(measured[0].parent, project.archive / "bad-pixels")
    text = (broken / "capture.yaml").read_text()
    (broken / "capture.yaml").write_text(text.replace("capture: ", "capture: bad-pixels #"))
    image = next(iter(sorted(broken.glob("laser/*"))))
    image.write_bytes(image.read_bytes()[: image.stat().st_size // 2])

    done = project.snakemake()

    said = done.stdout + done.stderr
    page = (project.results / "index.html").read_text()
    status = project.run("treadlight", "status", "results", check=False)
    assert status.returncode == 1
    for place in (said, page, status.stdout):
        assert "bad-manifest" in place
        assert "bad-pixels" in place
        assert "lazer" in place
        assert image.name in place
    assert "Traceback" not in said + status.stdout + status.stderr
    good = yaml.safe_load(measured[0].read_text())["capture"]
    assert (project.results / "captures" / good / "profile.zarr/zarr.json").is_file()


def test_status_of_a_healthy_archive_is_0(processed):
    assert processed.run("treadlight", "status", "results").returncode == 0


def test_the_workflow_passes_snakemake_lint(processed):
    done = processed.snakemake("--lint", check=False)
    assert "Congratulations" in done.stdout + done.stderr, done.stdout + done.stderr


def test_the_budget_says_what_true_inputs_would_gain(processed, tmp_path):
    """Every source of one capture; true laser points and normals leave the least error."""
    calibration = next(path.name for path in (processed.results / "calibrations").iterdir())
    capture = min(path.name for path in (processed.results / "captures").glob("t*"))
    for name in (calibration, capture):
        shutil.copytree(processed.archive / name, tmp_path / name)
    done = processed.run("treadlight", "budget", str(tmp_path), "--json")
    report = json.loads(done.stdout)
    assert list(report["captures"]) == [capture]
    rows = report["captures"][capture]
    tops = {source: row["seen"]["top"]["median_abs_mm"] for source, row in rows.items()}
    assert set(tops) == {"measured", "calibration", "laser", "photometry", "both"}
    assert tops["both"] < tops["measured"]


def test_exports_are_made_on_request_only(processed, project):
    assert not (processed.results / "exports").exists()
    folder = next((project.results / "captures").glob("t*")).name
    wanted = [f"results/exports/{folder}/{name}" for name in ("height.x3p", "areal.csv")]
    project.snakemake(*wanted)
    assert all((project.folder / path).stat().st_size > 100 for path in wanted)
    planned = project.planned("export")
    captures = len([c for c in (project.results / "captures").iterdir() if c.name[0] == "t"])
    assert planned == {"export_profile": 7 * captures - 2, "export": 1}


def test_snakemakes_own_report_has_categories_captions_and_labels(project):
    project.snakemake("--report", "report.html")
    text = (project.folder / "report.html").read_text(encoding="utf-8")
    for part in ("Archive", "Tires", "Numbers", "every tire and capture", "depth, wear, rate"):
        assert part in text
    assert "Where, how fast and how evenly tire" in text
